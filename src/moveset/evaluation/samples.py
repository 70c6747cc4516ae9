"""What models are judged on: test items of a corpus, or of a HumanML3D or KIT-ML folder.

An item is a real motion with its sentences. A corpus's items also have a label (what is shown); a folder's have none,
but are cropped anew in every repeat, as the sets' own loaders do. F joints frames give F - 1 rows of features; J
joints, D features.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from moveset.data.dataset import Clip, FolderDataset, open_dataset
from moveset.data.humanml3d import Caption
from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.motion.clip import Motion
from moveset.motion.features import get_codec
from moveset.motion.hml import HmlCodec

SHORTEST = 24  # frames of an item of a corpus
LONGEST = 196  # rows of features of an item of a folder
TOKEN = 4  # rows that the evaluator reads as one
SINGLE = 2.0 / 3.0  # chance of a crop to whole tokens; else one token more is cut off ("double")


@dataclass(frozen=True, eq=False)
class Item:
    """A real motion with what is said of it.

    Args:
        name: unique in its set.
        rows: rows of features; one frame of joints more.
        captions: sentences that the evaluator reads, one drawn in each repeat.
        label: what is shown; None where unknown. Items of one label are never told apart.
        take: the performance it is cut from; None where unknown. Neither are items of one take.
        features: (rows, D) its features, not normalised.
        joints: (rows + 1, J, 3) its joints in metres (rows of them where only features are stored).
        motion: itself, if the set holds motions.
        cropped: whether every repeat takes another crop, of whole tokens.
    """

    name: str
    rows: int
    captions: tuple[Caption | str, ...]
    label: tuple[str, ...] | None
    take: Hashable | None
    codec: str
    features: Callable[[], Tensor]
    joints: Callable[[], Tensor]
    motion: Callable[[], Motion] | None = None
    cropped: bool = False

    @classmethod
    def of(cls, clip: Clip, codec: HmlCodec, cropped: bool) -> "Item":
        return cls(
            name=clip.name,
            rows=clip.frames - (clip.stored is None),
            captions=clip.tagged or clip.captions,
            label=clip.contents,
            take=clip.take,
            codec=codec.name,
            features=lambda: clip.features(codec),
            joints=clip.joints,
            motion=None if clip.stored else clip.motion,
            cropped=cropped,
        )


@dataclass(frozen=True, eq=False)
class Sample:
    """An item as one repeat uses it: which caption, and rows [start, start + rows) of its features."""

    item: Item
    caption: Caption | str
    start: int
    rows: int

    @property
    def prompt(self) -> str:
        return text_of(self.caption)

    @property
    def frames(self) -> int:
        """Frames of joints that a generated motion of this length needs."""
        return self.rows + 1

    def features(self) -> Tensor:
        """(rows, D) of the crop."""
        return self.item.features()[self.start : self.start + self.rows]

    def joints(self) -> Tensor:
        """(rows + 1, J, 3) of the crop, or a frame less at the end of what is stored."""
        return self.item.joints()[self.start : self.start + self.frames]


@dataclass(frozen=True, eq=False)
class TestSet:
    """All items of a split.

    Args:
        name: of the data, without its place.
        sha256: of the data: the whole file of a corpus; of the split's names, captions and features of a folder.
        codec: of the features, which says skeleton and frame rate too.
        dropped: how many were left out, by the reason.
    """

    items: tuple[Item, ...]
    name: str
    sha256: str
    codec: HmlCodec
    dropped: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.items)

    @cached_property
    def labels(self) -> list[Hashable] | None:
        """One an item, or None where not all have one."""
        return of_all([item.label for item in self.items])

    @cached_property
    def takes(self) -> list[Hashable] | None:
        """One an item, or None where not all have one."""
        return of_all([item.take for item in self.items])

    @cached_property
    def texts(self) -> int:
        return len({text_of(caption) for item in self.items for caption in item.captions})

    def limited(self, count: int) -> "TestSet":
        """``count`` of the items, drawn at random, always the same, in their order; for a quick look."""
        if count >= len(self.items):
            return self
        order = torch.randperm(len(self.items), generator=torch.Generator().manual_seed(0))[:count]
        kept = tuple(self.items[k] for k in sorted(order.tolist()))
        dropped = {**self.dropped, "left out at random": len(self.items) - count}
        return TestSet(kept, self.name, self.sha256, self.codec, dropped)

    def draw(self, generator: torch.Generator) -> list[Sample]:
        return [_draw(item, generator) for item in self.items]


def of_all(found: list[Hashable | None]) -> list[Hashable] | None:
    """What each of some items has; None where one lacks it."""
    return None if None in found else found


def text_of(caption: Caption | str) -> str:
    return caption if isinstance(caption, str) else caption.text


def open_test_set(
    path: Path, split: Split, *, long: bool = False, composed: bool = True, mirrored: bool = True
) -> TestSet:
    """The items of a split: whole clips of a corpus of at least 24 frames, or crops of a folder's by its own rules.

    Args:
        path: a corpus file, or a HumanML3D or KIT-ML folder.
        split: "val" or "test"; "train" works too.
        long: of a folder, the motions that are too long for the usual items instead, whole.
        composed, mirrored: of a corpus, take compositions and mirror images too.

    Raises:
        InputError: it is missing, there are no items, or they are on another skeleton or frame rate than those of the
            published features.
        FormatError: it is damaged.
    """
    dataset = open_dataset(path)
    codec, folder = get_codec(dataset.published), isinstance(dataset, FolderDataset)
    assert isinstance(codec, HmlCodec)
    if long and isinstance(dataset, FolderDataset):
        clips = dataset.long_clips(split)
    else:
        clips = [dataset.clip(item) for item in dataset.split(split, composed=composed, mirrored=mirrored)]
    for clip in clips:
        if (clip.skeleton, clip.fps) != (codec.skeleton.name, codec.fps):
            raise InputError(
                f"clip {clip.name!r} is on {clip.skeleton!r} at {clip.fps:g} fps; the evaluator judges "
                f"{codec.skeleton.name!r} at {codec.fps:g}"
            )
    kept = [clip for clip in clips if folder or clip.frames >= SHORTEST]
    if not kept:
        raise InputError(
            f"{dataset.name} has no {split} clips of {SHORTEST} or more frames; choose another split"
            if not folder
            else f"{path} has no {split} motion of a length that is judged; unpack the data set completely, or choose "
            f"another split{' (motions of 200 frames or more make rollouts: HumanML3D has none)' * long}"
        )
    dropped = dict(dataset.left_out(split)) if not long else {}
    if short := len(clips) - len(kept):
        dropped[f"fewer than {SHORTEST} frames"] = short
    items = tuple(Item.of(clip, codec, cropped=folder and not long) for clip in kept)
    return TestSet(items, dataset.name, dataset.sha256(split), codec, dropped)


def _draw(item: Item, generator: torch.Generator) -> Sample:
    # Every item takes as many numbers from the generator, whatever it needs.
    which, coin, where = torch.rand(3, generator=generator, dtype=torch.float64).tolist()
    caption = item.captions[int(which * len(item.captions))]
    if not item.cropped:
        return Sample(item, caption, 0, item.rows)
    tokens = item.rows // TOKEN - (0 if coin < SINGLE else 1)
    rows = min(tokens * TOKEN, LONGEST)
    return Sample(item, caption, int(where * (item.rows - rows + 1)), rows)
