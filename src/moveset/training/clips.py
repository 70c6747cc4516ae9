"""What the networks read: features of every clip and of its mirror image in one memory-mapped file, and batches of it.

Batches are a pure function of (seed, step): there is no sampler state to save, so a resumed run sees what an
uninterrupted one would have seen. Shapes: B batch, F frames, D features.
"""

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from moveset.data.corpus import Corpus
from moveset.errors import FormatError
from moveset.motion.features import FeatureCodec, Normalizer

_VERSION = 1


@dataclass(frozen=True)
class Clip:
    """One row of the index: where the frames of a clip of the corpus, or of its mirror image, lie."""

    record: int
    mirrored: bool
    start: int
    frames: int


class FeatureStore:
    """Normalised features of a corpus: clip 2i is record i, clip 2i + 1 its mirror image."""

    def __init__(self, folder: Path) -> None:
        index = json.loads((folder / "index.json").read_text())
        if index["version"] != _VERSION:
            raise FormatError(f"{folder} was written by another version; delete it and it will be made again")
        self.clips = [Clip(k // 2, k % 2 == 1, start, frames) for k, (start, frames) in enumerate(index["clips"])]
        self.features = np.load(folder / "features.npy", mmap_mode="r")
        mean, std = (torch.tensor(index[name]) for name in ("mean", "std"))
        self.normalizer = Normalizer(mean, std)

    @classmethod
    def of(cls, corpus: Corpus, codec: FeatureCodec, folder: Path, progress: bool = False) -> "FeatureStore":
        """Open the store in ``folder``, making it first where it is missing (statistics from plain training takes)."""
        if (folder / "index.json").is_file():
            return cls(folder)
        building = folder.with_name(f".{folder.name}.{os.getpid()}")
        building.mkdir(parents=True)
        try:
            encoded: list[np.ndarray] = []
            for k in tqdm(range(len(corpus)), desc="features", disable=None if progress else True):
                encoded += [codec.encode(corpus.motion(k, mirrored)).numpy() for mirrored in (False, True)]
            fitted = [
                torch.from_numpy(encoded[2 * k + m]) for k in corpus.indices("train", composed=False) for m in (0, 1)
            ]
            normalizer = Normalizer.fit(fitted, codec.groups)
            frames = [len(clip) for clip in encoded]
            starts = np.concatenate(([0], np.cumsum(frames)))
            out = np.lib.format.open_memmap(
                building / "features.npy", mode="w+", dtype=np.float32, shape=(int(starts[-1]), codec.dim)
            )
            mean, std = normalizer.mean.numpy(), normalizer.std.numpy()
            for start, clip in zip(starts, encoded, strict=False):
                out[start : start + len(clip)] = (clip - mean) / std
            out.flush()
            rows = [[int(start), count] for start, count in zip(starts, frames, strict=False)]
            index = {"version": _VERSION, "clips": rows, "mean": mean.tolist(), "std": std.tolist()}
            (building / "index.json").write_text(json.dumps(index))
            building.rename(folder)
        finally:
            shutil.rmtree(building, ignore_errors=True)
        return cls(folder)

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


def clip_weights(corpus: Corpus, records: Sequence[int], power: float, composed_share: float) -> Tensor:
    """Sampling weights of records: each content by count^(1 - power), composed clips together ``composed_share``."""
    chosen = [corpus.records[k] for k in records]
    counts: dict[tuple[str, ...], int] = {}
    for record in chosen:
        counts[record.contents] = counts.get(record.contents, 0) + 1
    weights = torch.tensor([counts[record.contents] ** -power for record in chosen], dtype=torch.float64)
    composed = torch.tensor([record.kind != "take" for record in chosen])
    for part, share in ((composed, composed_share), (~composed, 1.0 - composed_share)):
        if part.any():
            weights[part] *= share / weights[part].sum()
    return weights


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
            frames = min(frames, total)
            crops.append(Crop(clip, int(at * (total - frames + 1)), frames))
        crops.sort(key=lambda crop: crop.frames)
        start = int(order[step % self.pool]) * self.batch
        return crops[start : start + self.batch]
