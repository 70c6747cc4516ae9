"""What networks read: normalised features of every clip of a dataset in one memory-mapped file.

Shapes: B batch, F frames, D features.
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
from moveset.data.dataset import Dataset
from moveset.data.loader import in_order
from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.process import LOCKS, locked
from moveset.motion.features import FeatureCodec, Normalizer, get_codec
from moveset.motion.hml import HmlCodec
from moveset.motion.sides import SIDED, favoured

_VERSION = 2


@dataclass(frozen=True)
class Row:
    """One row of the index: where the frames of a clip lie."""

    start: int
    frames: int


@dataclass(frozen=True)
class Crop:
    """Some consecutive frames of a clip."""

    clip: int
    offset: int
    frames: int


class FeatureStore:
    """Normalised features of all clips of a dataset, by its numbers."""

    def __init__(self, folder: Path) -> None:
        index = json.loads((folder / "index.json").read_text())
        if index["version"] != _VERSION or "source" not in index:
            raise FormatError(f"{folder} was written by another version; delete it and it will be made again")
        self.clips = [Row(start, frames) for start, frames in index["clips"]]
        #: (clips, 3), as ``motion.sides.favoured`` has them; of a store that ``of`` opens in the axes of ``Motion``.
        self.sides = torch.tensor(index["sides"], dtype=torch.float32)
        #: ``Dataset.fingerprint`` of what it was made from.
        self.source: str = index["source"]
        self.features = np.load(folder / "features.npy", mmap_mode="r")
        mean, std = (torch.tensor(index[name]) for name in ("mean", "std"))
        self.normalizer = Normalizer(mean, std)
        self._resident: Tensor | None = None

    @classmethod
    def of(
        cls, dataset: Dataset, codec: FeatureCodec, folder: Path, progress: bool = False, workers: int = 0
    ) -> "FeatureStore":
        """Open the store in ``folder``, making it first where it is missing, with so many processes.

        Raises:
            InputError: the store there holds another dataset's clips, or the dataset cannot be read.
            MovesetError: the store could not be written.
        """
        if not (folder / "index.json").is_file():
            # Trainings that are started side by side share them: the second waits, and finds everything there.
            with locked(folder.parent):
                if not (folder / "index.json").is_file():
                    _make(dataset, codec, folder, progress, workers)
        store = cls(folder)
        if isinstance(codec, HmlCodec):
            # Files have turns in the features' axes, those of older versions too; KIT-ML's are a mirror image.
            store.sides[:, SIDED.index("turn")] *= float(codec.reflection[0])
        if store.source != dataset.fingerprint:
            raise InputError(
                f"{folder} was made from other clips; delete it and the latents-*.safetensors beside it, and they will "
                "be made anew, or train in another folder"
            )
        return store

    @classmethod
    def cached(
        cls, dataset: Dataset, codec: str, cache: Path, progress: bool = False, workers: int = 0
    ) -> "FeatureStore":
        """The store of a codec in a folder of caches, as ``of``."""
        return cls.of(dataset, get_codec(codec), cache / f"features-{codec}", progress, workers)

    def to(self, device: torch.device) -> "FeatureStore":
        """Gives batches on a device from now on, which holds all features where it is a GPU; returns itself."""
        if device.type != "cpu":
            self._resident = torch.from_numpy(np.array(self.features)).to(device)
        return self

    def whole(self, clip: int) -> Crop:
        """All of a clip, or its first 196 frames."""
        return Crop(clip, 0, min(self.clips[clip].frames, MAX_FRAMES))

    def of_clip(self, clip: int) -> np.ndarray:
        """(F, D) view of a clip's features."""
        row = self.clips[clip]
        found: np.ndarray = self.features[row.start : row.start + row.frames]
        return found

    def batch(self, crops: Sequence[Crop]) -> tuple[Tensor, Tensor]:
        """Features (B, F, D), zero beyond each clip's end, and lengths (B,)."""
        lengths = torch.tensor([crop.frames for crop in crops])
        if self._resident is not None:
            start = torch.tensor([self.clips[crop.clip].start + crop.offset for crop in crops])
            place = torch.arange(int(lengths.max()))
            valid, where = place < lengths[:, None], start[:, None] + place.minimum(lengths[:, None] - 1)
            device = self._resident.device
            return self._resident[where.to(device)] * valid[..., None].to(device), lengths.to(device)
        out = torch.zeros(len(crops), int(lengths.max()), self.features.shape[1])
        for row, crop in zip(out, crops, strict=True):
            shown = self.of_clip(crop.clip)[crop.offset : crop.offset + crop.frames]
            row[: crop.frames] = torch.from_numpy(np.array(shown))
        return out, lengths


def _make(dataset: Dataset, codec: FeatureCodec, folder: Path, progress: bool, workers: int) -> None:
    """Writes a store, which appears whole or not at all; whoever calls holds the lock, where there are any."""
    building = folder.with_name(f".{folder.name}.{os.getpid()}")
    # What a kill left takes room, and in a container the next training has the same number.
    for left in folder.parent.glob(f".{glob.escape(folder.name)}.*") if LOCKS else (building,):
        shutil.rmtree(left, ignore_errors=True)
    try:
        building.mkdir(parents=True)
        # By way of the disk: the features of a large data set may not fit in memory.
        frames, sides = [], []
        with open(building / "raw", "wb") as file:
            found = in_order(lambda clip: _encoded(dataset, clip, codec), range(len(dataset)), workers)
            for features, favours in tqdm(
                found, desc="features", total=len(dataset), disable=None if progress else True
            ):
                encoded = features.numpy()
                file.write(encoded.tobytes())
                frames.append(len(encoded))
                sides.append(favours.tolist())
        ends = np.cumsum([0, *frames])
        normalizer = _normalise(dataset, codec, building, ends)
        (building / "raw").unlink()
        rows = [[int(start), count] for start, count in zip(ends, frames, strict=False)]
        index = {"version": _VERSION, "source": dataset.fingerprint, "clips": rows, "sides": sides, **normalizer}
        (building / "index.json").write_text(json.dumps(index))
        building.rename(folder)
    except OSError as error:
        raise MovesetError(
            f"the features {folder} could not be written ({error.strerror or error}); make room or fix the "
            "permissions, then start again"
        ) from error
    finally:
        shutil.rmtree(building, ignore_errors=True)


def _encoded(dataset: Dataset, clip: int, codec: FeatureCodec) -> tuple[Tensor, Tensor]:
    """Features of a clip, and the sides that it favours."""
    features = dataset.clip(clip).features(codec).float()
    return features, favoured(codec.joints(features), codec.skeleton)


def _normalise(dataset: Dataset, codec: FeatureCodec, building: Path, ends: np.ndarray) -> dict[str, list[float]]:
    """From ``raw`` to ``features.npy``; the statistics."""
    shape = (int(ends[-1]), codec.dim)
    raw = np.memmap(building / "raw", np.float32, "r", shape=shape)
    normalizer = dataset.normalizer(codec, lambda clip: torch.tensor(raw[ends[clip] : ends[clip + 1]]))
    mean, std = normalizer.mean.numpy(), normalizer.std.numpy()
    # Not through a memory map: on a full disk that would be a signal, which ends the process without a word.
    with open(building / "features.npy", "wb") as file:
        header = {"descr": np.lib.format.dtype_to_descr(raw.dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        for start, stop in pairwise(ends):
            file.write(((raw[start:stop] - mean) / std).tobytes())
    return {"mean": mean.tolist(), "std": std.tolist()}
