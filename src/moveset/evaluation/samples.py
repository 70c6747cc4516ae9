"""What models are judged on: test items of a corpus, or of a HumanML3D or KIT-ML folder.

An item is a real motion with its sentences. A corpus's items also have a label (what is shown); a folder's have none,
but are cropped anew in every repeat, as the sets' own loaders do. F joints frames give F - 1 rows of features; J
joints, D features.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from moveset.data.corpus import Corpus
from moveset.data.humanml3d import Caption, HumanML3D
from moveset.data.humanml3d import Item as FolderItem
from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.io.numpy_file import array_shape
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
        codec: name of the features' codec.
        features: (rows, D) its features, not normalised.
        joints: (rows + 1, J, 3) its joints in metres (rows of them where only features are stored).
        motion: itself, if the set holds motions.
        cropped: whether every repeat takes another crop, of whole tokens.
    """

    name: str
    rows: int
    captions: tuple[Caption | str, ...]
    label: tuple[str, ...] | None
    codec: str
    features: Callable[[], Tensor]
    joints: Callable[[], Tensor]
    motion: Callable[[], Motion] | None = None
    cropped: bool = False


@dataclass(frozen=True, eq=False)
class Draw:
    """An item as one repeat uses it: which caption, and rows [start, start + rows) of its features."""

    item: Item
    caption: Caption | str
    start: int
    rows: int

    @property
    def prompt(self) -> str:
        """The sentence."""
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
class ItemSet:
    """All items of a split.

    Args:
        items: the items.
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
    def labels(self) -> list[tuple[str, ...]] | None:
        """One an item, or None where there are none."""
        found = [item.label for item in self.items if item.label is not None]
        return found if found and len(found) == len(self.items) else None

    @cached_property
    def texts(self) -> int:
        """Number of distinct sentences."""
        return len({text_of(caption) for item in self.items for caption in item.captions})

    def limited(self, count: int, seed: int = 0) -> "ItemSet":
        """``count`` of the items, drawn at random, in their order; for a quick look."""
        if count >= len(self.items):
            return self
        order = torch.randperm(len(self.items), generator=torch.Generator().manual_seed(seed))[:count]
        kept = tuple(self.items[k] for k in sorted(order.tolist()))
        dropped = {**self.dropped, "left out at random by --items": len(self.items) - count}
        return ItemSet(kept, self.name, self.sha256, self.codec, dropped)

    def draw(self, generator: torch.Generator) -> list[Draw]:
        """Caption and crop of every item for one repeat."""
        return [_draw(item, generator) for item in self.items]


def text_of(caption: Caption | str) -> str:
    """The sentence."""
    return caption if isinstance(caption, str) else caption.text


def open_items(
    path: Path, split: Split, *, long: bool = False, composed: bool = True, mirrored: bool = True
) -> ItemSet:
    """The items of a split: a folder is HumanML3D or KIT-ML, a file a corpus.

    Args:
        path: the data.
        split: "val" or "test"; "train" works too.
        long: of a folder, the motions that are too long for the usual items instead, whole.
        composed, mirrored: of a corpus, take compositions and mirror images too.

    Raises:
        InputError: it is missing, or there are no items.
        FormatError: it is damaged.
    """
    if path.is_dir():
        data = HumanML3D.open(path)
        return long_items(data, split) if long else folder_items(data, split)
    return corpus_items(Corpus.open(path), split, path, composed=composed, mirrored=mirrored)


def corpus_items(corpus: Corpus, split: Split, path: Path, *, composed: bool = True, mirrored: bool = True) -> ItemSet:
    """Clips of a corpus of at least 24 frames, whole; a mirror image is an item of its own, with mirrored sentences.

    Raises:
        InputError: there are none, or they are on another skeleton or frame rate than HumanML3D.
    """
    codec = get_codec("hml")
    assert isinstance(codec, HmlCodec)
    items, dropped = [], 0
    for k in corpus.indices(split, composed=None if composed else False):
        record = corpus.records[k]
        if record.frames < SHORTEST:
            dropped += 1 + mirrored
            continue
        if corpus.skeleton.name != codec.skeleton.name or record.fps != codec.fps:
            raise InputError(
                f"clip {record.name!r} is on {corpus.skeleton.name!r} at {record.fps:g} fps; the evaluator judges "
                f"{codec.skeleton.name!r} at {codec.fps:g}"
            )
        items += [_corpus_item(corpus, k, codec, bool(flip)) for flip in range(1 + mirrored)]
    if not items:
        raise InputError(f"{path.name} has no {split} clips of {SHORTEST} or more frames; choose another split")
    reasons = {f"fewer than {SHORTEST} frames": dropped} if dropped else {}
    return ItemSet(tuple(items), path.name, _sha256(path), codec, reasons)


def folder_items(data: HumanML3D, split: Split) -> ItemSet:
    """Motions of a HumanML3D or KIT-ML folder, and the parts of them with sentences of their own; without labels.

    The sets' own rules: 40 (KIT-ML: 24) to 199 rows; crops as in ``Item.cropped``.

    Raises:
        InputError: there are none, or files are missing.
        FormatError: a file is damaged.
    """
    found = data.items(split)
    if not found:
        raise InputError(
            f"{data.folder}/{split}.txt names no motion of {data.layout.shortest} to {data.layout.too_long - 1} frames "
            "with a sentence; unpack the data set completely, or choose another split"
        )
    codec = get_codec(data.layout.codec)
    assert isinstance(codec, HmlCodec)
    items = tuple(_folder_item(data, item, codec, k) for k, item in enumerate(found))
    used = {item.name for item in found}
    unused = [name for name in data.splits[split] if name not in used]
    span = f"not of {data.layout.shortest} to {data.layout.too_long - 1} frames, or without a sentence for the whole"
    reasons = {span: len(unused)} if unused else {}
    return ItemSet(items, data.folder.name, _folder_sha256(data, split), codec, reasons)


def long_items(data: HumanML3D, split: Split) -> ItemSet:
    """Motions of a HumanML3D or KIT-ML folder of 200 rows or more, which the sets' own loaders leave out; uncropped.

    Raises:
        InputError: there are none.
        FormatError: a file is damaged.
    """
    codec = get_codec(data.layout.codec)
    assert isinstance(codec, HmlCodec)
    found = []
    for name in data.splits[split]:
        rows = array_shape(data.folder / "new_joint_vecs" / f"{name}.npy")[0]
        whole = tuple(c for c in data.captions(name) if c.start == 0 and c.end == 0)
        if rows >= data.layout.too_long and whole:
            found.append(FolderItem(name, 0, rows, whole))
    if not found:
        raise InputError(
            f"{data.folder} has no {split} motion of {data.layout.too_long} frames or more, which a rollout takes; "
            "HumanML3D's are all shorter, KIT-ML has some"
        )
    items = (replace(_folder_item(data, item, codec, k), cropped=False) for k, item in enumerate(found))
    return ItemSet(tuple(items), data.folder.name, _folder_sha256(data, split), codec)


def _corpus_item(corpus: Corpus, k: int, codec: HmlCodec, mirrored: bool) -> Item:
    record, contents = corpus.records[k], corpus.contents(k, mirrored)
    return Item(
        name=record.name + " mirrored" * mirrored,
        rows=record.frames - 1,
        captions=corpus.captions(k, mirrored),
        label=contents,
        codec=codec.name,
        features=lambda: codec.encode(corpus.motion(k, mirrored)),
        joints=lambda: corpus.motion(k, mirrored).joints,
        motion=lambda: corpus.motion(k, mirrored),
    )


def _folder_item(data: HumanML3D, item: FolderItem, codec: HmlCodec, number: int) -> Item:
    def features() -> Tensor:
        return data.features(item.name)[item.start : item.stop]

    return Item(
        name=f"{number} {item.name}",
        rows=item.stop - item.start,
        captions=item.captions,
        label=None,
        codec=codec.name,
        features=features,
        joints=lambda: codec.joints(features()) * codec.reflection.float(),
        cropped=True,
    )


def _draw(item: Item, generator: torch.Generator) -> Draw:
    # Every item takes as many numbers from the generator, whatever it needs.
    which, coin, where = torch.rand(3, generator=generator, dtype=torch.float64).tolist()
    caption = item.captions[int(which * len(item.captions))]
    if not item.cropped:
        return Draw(item, caption, 0, item.rows)
    tokens = item.rows // TOKEN - (0 if coin < SINGLE else 1)
    rows = min(tokens * TOKEN, LONGEST)
    return Draw(item, caption, int(where * (item.rows - rows + 1)), rows)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _folder_sha256(data: HumanML3D, split: Split) -> str:
    """Of the names, features and texts of a split."""
    sha = hashlib.sha256()
    for name in data.splits[split]:
        sha.update(name.encode())
        for part, suffix in (("new_joint_vecs", "npy"), ("texts", "txt")):
            path = data.folder / part / f"{name}.{suffix}"
            sha.update(path.read_bytes() if path.is_file() else b"")
    return sha.hexdigest()
