"""Where clips come from: a corpus file, or a HumanML3D or KIT-ML folder. What comes after need not know which.

A source numbers its clips as networks see them: a mirror image is a clip of its own. F frames, D features.
"""

import hashlib
import os
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from moveset.data.corpus import Corpus
from moveset.data.humanml3d import Caption, HumanML3D
from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.motion.features import FeatureCodec, Normalizer

_END = 4096  # bytes of a file that are looked at


class ClipSource(Protocol):
    """Clips 0 … len - 1 with features, sentences and a split."""

    def __len__(self) -> int:
        """Number of clips, mirror images counted."""

    def clips(self, split: Split, plain: bool = False) -> tuple[int, ...]:
        """Clips of a split; with ``plain`` only those that stand for the captures: not composed, not our mirrorings.

        Raises:
            InputError: an unknown split.
        """

    @property
    def fingerprint(self) -> str:
        """A hash of all clips' motions and splits, but not of their sentences, which are never kept."""

    def frames(self, clip: int) -> int:
        """Frames of a clip's motion; some codecs make one row of features less."""

    def features(self, clip: int, codec: FeatureCodec) -> Tensor:
        """(F, D) features of a clip, not normalised.

        Raises:
            InputError: the source has no features of this codec, or a file is missing or damaged.
        """

    def normalizer(self, codec: FeatureCodec, features: Callable[[int], Tensor]) -> Normalizer:
        """Statistics to normalise by, given a function that gives each clip's features."""

    def captions(self, clip: int) -> tuple[str, ...]:
        """Sentences of a clip."""

    def label(self, clip: int) -> Hashable:
        """What a clip shows: clips of one label may answer each other's sentences."""

    def divisible(self, clip: int) -> bool:
        """Whether the sentences of a clip also hold for most of it, so that a window of it may be learned from."""

    def weights(self, clips: Sequence[int], power: float, composed_share: float) -> Tensor:
        """(len(clips),) float64 chances to be drawn, up to a factor; see ``clip_weights``."""


def open_clips(path: Path) -> ClipSource:
    """What a path holds: a folder is HumanML3D or KIT-ML, a file a corpus.

    Raises:
        InputError: it is missing, or parts of it are, or there is nothing to train on or to validate with.
        FormatError: it is damaged.
    """
    if path.is_dir():
        return FolderClips(HumanML3D.open(path))
    corpus = Corpus.open(path)
    needed: tuple[Split, ...] = ("train", "val")
    for split in needed:
        if not corpus.indices(split, composed=False):
            raise InputError(
                f"{path} has no take of the {split} split; training needs some in train and in val: build the corpus "
                "from more performers"
            )
    return CorpusClips(corpus)


def as_clips(source: Corpus | ClipSource) -> ClipSource:
    """A corpus as a source of clips; a source is returned as it is."""
    return CorpusClips(source) if isinstance(source, Corpus) else source


class CorpusClips:
    """A corpus: clip 2i is record i, clip 2i + 1 its mirror image."""

    def __init__(self, corpus: Corpus) -> None:
        self.corpus = corpus

    def __len__(self) -> int:
        return 2 * len(self.corpus)

    def clips(self, split: Split, plain: bool = False) -> tuple[int, ...]:
        if plain:
            return tuple(2 * record for record in self.corpus.indices(split, composed=False))
        return tuple(2 * record + mirrored for record in self.corpus.indices(split) for mirrored in (0, 1))

    @property
    def fingerprint(self) -> str:
        return self.corpus.fingerprint

    def frames(self, clip: int) -> int:
        return self.corpus.records[clip // 2].frames

    def features(self, clip: int, codec: FeatureCodec) -> Tensor:
        return codec.encode(self.corpus.motion(clip // 2, clip % 2 == 1))

    def normalizer(self, codec: FeatureCodec, features: Callable[[int], Tensor]) -> Normalizer:
        """From the takes of the training split and their mirror images."""
        fitted = (clip + mirrored for clip in self.clips("train", plain=True) for mirrored in (0, 1))
        return Normalizer.fit((features(clip) for clip in fitted), codec.groups)

    def captions(self, clip: int) -> tuple[str, ...]:
        return self.corpus.captions(clip // 2, clip % 2 == 1)

    def label(self, clip: int) -> Hashable:
        return self.corpus.contents(clip // 2, clip % 2 == 1)

    def divisible(self, clip: int) -> bool:
        """A window of a clip that shows two things may miss half of what its caption says."""
        return len(self.corpus.records[clip // 2].contents) == 1

    def weights(self, clips: Sequence[int], power: float, composed_share: float) -> Tensor:
        records = list(dict.fromkeys(clip // 2 for clip in clips))
        found = clip_weights(self.corpus, records, power, composed_share)
        by_record = dict(zip(records, found.tolist(), strict=True))
        return torch.tensor([by_record[clip // 2] for clip in clips], dtype=torch.float64)


class FolderClips:
    """A HumanML3D or KIT-ML folder: its own features, statistics and splits.

    Clips are the items that the sets' own loaders draw from, all with the same chance: motions of 40 (KIT-ML: 24) to
    199 frames, and the parts of them that have sentences of their own. Mirrored motions are files of their own.

    Raises:
        InputError: statistics are missing, or there is nothing to train on or to validate with.
        FormatError: a file is damaged.
    """

    def __init__(self, data: HumanML3D) -> None:
        self.data = data
        self._normalizer = Normalizer(data.mean, data.std)
        splits: tuple[Split, ...] = ("train", "val", "test")
        items = {split: data.items(split) for split in splits}
        for split in ("train", "val"):
            if not items[split]:
                raise InputError(
                    f"{data.folder}/{split}.txt names no motion of {data.layout.shortest} to "
                    f"{data.layout.too_long - 1} frames with a sentence; training needs some in train.txt and val.txt"
                )
        self.items = [item for split in splits for item in items[split]]
        self._splits, start = {}, 0
        for split in splits:
            self._splits[split] = tuple(range(start, start + len(items[split])))
            start += len(items[split])

    def __len__(self) -> int:
        return len(self.items)

    def clips(self, split: Split, plain: bool = False) -> tuple[int, ...]:
        if split not in self._splits:
            raise InputError(f"there is no split {split!r}; use 'train', 'val' or 'test'")
        return self._splits[split]

    @cached_property
    def fingerprint(self) -> str:
        """Files are known by their sizes and ends: the sets hold gigabytes."""
        counts = [len(clips) for clips in self._splits.values()]
        sha = hashlib.sha256(repr(counts).encode())
        for name in dict.fromkeys(item.name for item in self.items):
            with open(self.data.folder / "new_joint_vecs" / f"{name}.npy", "rb") as file:
                size = file.seek(0, os.SEEK_END)
                file.seek(max(0, size - _END))
                sha.update(f"{name} {size} ".encode() + file.read())
        for item in self.items:
            sha.update(repr((item.name, item.start, item.stop)).encode())
        for statistic in (self.data.mean, self.data.std):
            sha.update(statistic.numpy().data)
        return sha.hexdigest()

    def frames(self, clip: int) -> int:
        return self.items[clip].stop - self.items[clip].start

    def features(self, clip: int, codec: FeatureCodec) -> Tensor:
        if codec.name != self.data.layout.codec:
            raise InputError(
                f"{self.data.folder} holds {self.data.layout.codec!r} features ({self.data.layout.features} a frame), "
                f"not {codec.name!r} ones; train the vae with --set codec={self.data.layout.codec} "
                f"--set model.features={self.data.layout.features} --set loss=published"
            )
        item = self.items[clip]
        return self.data.features(item.name)[item.start : item.stop]

    def normalizer(self, codec: FeatureCodec, features: Callable[[int], Tensor]) -> Normalizer:
        """The folder's Mean.npy and Std.npy."""
        return self._normalizer

    def captions(self, clip: int) -> tuple[str, ...]:
        return tuple(caption.text for caption in self.items[clip].captions)

    def tagged(self, clip: int) -> tuple[Caption, ...]:
        """Sentences of a clip with their words' parts of speech."""
        return self.items[clip].captions

    def label(self, clip: int) -> Hashable:
        """The motion that it is a part of: nothing is known of what the clips show."""
        return self.items[clip].name

    def divisible(self, clip: int) -> bool:
        """Sentences tell of one thing after another, and a window may miss some of it."""
        return False

    def weights(self, clips: Sequence[int], power: float, composed_share: float) -> Tensor:
        """All alike: nothing is known of their contents."""
        return torch.ones(len(clips), dtype=torch.float64)


def clip_weights(corpus: Corpus, records: Sequence[int], power: float, composed_share: float) -> Tensor:
    """Sampling weights of records: each content by count^(1 - power), those that show two things together
    ``composed_share``."""
    chosen = [corpus.records[k] for k in records]
    counts: dict[tuple[str, ...], int] = {}
    for record in chosen:
        counts[record.contents] = counts.get(record.contents, 0) + 1
    weights = torch.tensor([counts[record.contents] ** -power for record in chosen], dtype=torch.float64)
    composed = torch.tensor([len(record.contents) > 1 for record in chosen])
    for part, share in ((composed, composed_share), (~composed, 1.0 - composed_share)):
        if part.any():
            weights[part] *= share / weights[part].sum()
    return weights
