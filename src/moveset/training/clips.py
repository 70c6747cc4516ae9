"""What the networks read: features of every clip in one memory-mapped file, and batches of it.

Batches are a pure function of (seed, step): there is no sampler state to save, so a resumed run sees what an
uninterrupted one would have seen. Shapes: B batch, F frames, D features.
"""

import glob
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from moveset.data.augment import MAX_FRAMES
from moveset.data.corpus import Corpus
from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.process import LOCKS, locked
from moveset.motion.features import FeatureCodec, Normalizer
from moveset.training.clip_source import ClipSource, as_clips
from moveset.training.clip_source import clip_weights as clip_weights

_VERSION = 1


@dataclass(frozen=True)
class Clip:
    """One row of the index: where the frames of a clip lie."""

    start: int
    frames: int


class FeatureStore:
    """Normalised features of all clips of a source, by its numbers: clip 2i of a corpus is record i, clip 2i + 1 its
    mirror image."""

    def __init__(self, folder: Path) -> None:
        index = json.loads((folder / "index.json").read_text())
        if index["version"] != _VERSION:
            raise FormatError(f"{folder} was written by another version; delete it and it will be made again")
        self.clips = [Clip(start, frames) for start, frames in index["clips"]]
        #: ``ClipSource.fingerprint`` of what it was made from; "" where an earlier version made it.
        self.source: str = index.get("source", "")
        self.features = np.load(folder / "features.npy", mmap_mode="r")
        mean, std = (torch.tensor(index[name]) for name in ("mean", "std"))
        self.normalizer = Normalizer(mean, std)

    @classmethod
    def of(
        cls, source: Corpus | ClipSource, codec: FeatureCodec, folder: Path, progress: bool = False
    ) -> "FeatureStore":
        """Open the store in ``folder``, making it first where it is missing.

        Raises:
            InputError: the store there holds another source's clips, or the source cannot be read.
            MovesetError: the store could not be written.
        """
        source = as_clips(source)
        if not (folder / "index.json").is_file():
            # Trainings that are started side by side share them: the second waits, and finds everything there.
            with locked(folder.parent):
                if not (folder / "index.json").is_file():
                    _make(source, codec, folder, progress)
        store = cls(folder)
        if not store._is_of(source):
            raise InputError(
                f"{folder} was made from other clips; delete it and the latents-*.safetensors beside it, and they will "
                "be made anew, or train in another folder"
            )
        return store

    def _is_of(self, source: ClipSource) -> bool:
        if self.source:
            return self.source == source.fingerprint
        # An earlier version did not say; other clips would hardly have the same lengths one by one.
        if len(self.clips) != len(source):
            return False
        return {source.frames(k) - clip.frames for k, clip in enumerate(self.clips)} in ({0}, {1})

    def whole(self, clip: int) -> "Crop":
        """All of a clip, or its first 196 frames."""
        return Crop(clip, 0, min(self.clips[clip].frames, MAX_FRAMES))

    def batch(self, crops: Sequence["Crop"]) -> tuple[Tensor, Tensor]:
        """Features (B, F, D), zero beyond each clip's end, and lengths (B,)."""
        lengths = torch.tensor([crop.frames for crop in crops])
        out = torch.zeros(len(crops), int(lengths.max()), self.features.shape[1])
        for row, crop in zip(out, crops, strict=True):
            start = self.clips[crop.clip].start + crop.offset
            row[: crop.frames] = torch.from_numpy(np.array(self.features[start : start + crop.frames]))
        return out, lengths


@dataclass(frozen=True)
class Crop:
    """Some consecutive frames of a clip."""

    clip: int
    offset: int
    frames: int


class CropSampler:
    """Batches of crops of about equal length, drawn by weight.

    Clips are drawn in pools of 16 batches and sorted by length before they are cut into batches: half of the frames
    that a network would otherwise compute are padding.

    Args:
        clips: indices of clips in the store.
        weights: their sampling weights.
        whole: probability that a clip is taken whole instead of cropped to a random window.
        shortest: the least frames of a window, as a share of the clip and in frames.
    """

    pool = 16

    def __init__(
        self,
        store: FeatureStore,
        clips: Sequence[int],
        weights: Tensor,
        batch: int,
        seed: int,
        whole: float = 0.5,
        shortest: tuple[float, int] = (0.0, 32),
    ) -> None:
        self.store, self.clips, self.weights, self.batch = store, list(clips), weights, batch
        self.seed, self.whole, self.shortest = seed, whole, shortest

    def crops(self, step: int) -> list[Crop]:
        """The batch of a step."""
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + step // self.pool)
        count = self.pool * self.batch
        drawn = torch.multinomial(self.weights, count, replacement=True, generator=generator)
        share, keep, place = torch.rand(3, count, generator=generator)
        order = torch.randperm(self.pool, generator=generator)
        crops = []
        for k, whole, size, at in zip(drawn.tolist(), keep.tolist(), share.tolist(), place.tolist(), strict=True):
            clip = self.clips[k]
            total = self.store.clips[clip].frames
            least = min(total, max(self.shortest[1], int(self.shortest[0] * total)))
            frames = total if whole < self.whole else least + int(size * (total - least + 1))
            frames = min(frames, total, MAX_FRAMES)
            crops.append(Crop(clip, int(at * (total - frames + 1)), frames))
        crops.sort(key=lambda crop: crop.frames)
        start = int(order[step % self.pool]) * self.batch
        return crops[start : start + self.batch]


def _make(source: ClipSource, codec: FeatureCodec, folder: Path, progress: bool) -> None:
    """Writes a store, which appears whole or not at all; whoever calls holds the lock, where there are any."""
    building = folder.with_name(f".{folder.name}.{os.getpid()}")
    # What a kill left takes room, and in a container the next training has the same number.
    for left in folder.parent.glob(f".{glob.escape(folder.name)}.*") if LOCKS else (building,):
        shutil.rmtree(left, ignore_errors=True)
    try:
        building.mkdir(parents=True)
        # By way of the disk: the features of a large data set may not fit in memory.
        frames = []
        with open(building / "raw", "wb") as file:
            for clip in tqdm(range(len(source)), desc="features", disable=None if progress else True):
                encoded = source.features(clip, codec).float().numpy()
                file.write(encoded.tobytes())
                frames.append(len(encoded))
        ends = np.cumsum([0, *frames])
        normalizer = _normalise(source, codec, building, ends)
        (building / "raw").unlink()
        rows = [[int(start), count] for start, count in zip(ends, frames, strict=False)]
        index = {"version": _VERSION, "source": source.fingerprint, "clips": rows, **normalizer}
        (building / "index.json").write_text(json.dumps(index))
        building.rename(folder)
    except OSError as error:
        raise MovesetError(
            f"the features {folder} could not be written ({error.strerror or error}); make room or fix the "
            "permissions, then start again"
        ) from error
    finally:
        shutil.rmtree(building, ignore_errors=True)


def _normalise(source: ClipSource, codec: FeatureCodec, building: Path, ends: np.ndarray) -> dict[str, list[float]]:
    """From ``raw`` to ``features.npy``; the statistics."""
    shape = (int(ends[-1]), codec.dim)
    raw = np.memmap(building / "raw", np.float32, "r", shape=shape)
    normalizer = source.normalizer(codec, lambda clip: torch.tensor(raw[ends[clip] : ends[clip + 1]]))
    mean, std = normalizer.mean.numpy(), normalizer.std.numpy()
    # Not through a memory map: on a full disk that would be a signal, which ends the process without a word.
    with open(building / "features.npy", "wb") as file:
        header = {"descr": np.lib.format.dtype_to_descr(raw.dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        for start, stop in pairwise(ends):
            file.write(((raw[start:stop] - mean) / std).tobytes())
    return {"mean": mean.tolist(), "std": std.tolist()}
