"""Where clips come from: a corpus file, or a HumanML3D or KIT-ML folder. What is trained or judged sees this alone.

A dataset numbers its clips as networks see them: a mirror image is a clip of its own. F frames, J joints, D features.
"""

import hashlib
import os
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from moveset.data.corpus import Corpus
from moveset.data.humanml3d import Caption, HumanML3D, Item
from moveset.data.records import in_a_row
from moveset.data.splits import Split
from moveset.data.weights import corpus_weights
from moveset.errors import InputError
from moveset.io.manifest import sha256
from moveset.io.numpy_file import array_shape
from moveset.motion.clip import Motion
from moveset.motion.features import FeatureCodec, Normalizer, get_codec

_END = 4096  # bytes of a file that are looked at


@dataclass(frozen=True)
class Span:
    """Some consecutive frames of a clip, up to ``stop``, with the sentences that tell just them."""

    stop: int
    captions: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Clip:
    """A clip and what is known of it; motion and features are read when they are asked for.

    Args:
        name: unique in its dataset.
        frames: of its motion; some codecs make one row of features less. Of a folder, rows of features.
        captions: sentences for all of it.
        group: what it shows: clips of one group may answer each other's sentences.
        motion: itself; where a set holds features alone, what they decode to.
        features: its features (F, D) in a codec, not normalised; raises InputError where the set has none of it.
        joints: its joints (F, J, 3) in metres, in the axes of ``Motion``.
        contents: labels of what is shown; None where unknown. Clips of equal ones are never told apart.
        parts: where it shows one thing after another, each with sentences of its own.
        croppable: whether its sentences also hold for most of it, so that a window of it may be learned from.
        tagged: its sentences with their words' parts of speech, where these are known.
        stored: name of the codec of the features that are all a set holds of it; None where it holds the motion.
        take: the performance it is cut from, mirrored or not; None where unknown.
    """

    name: str
    frames: int
    fps: float
    skeleton: str
    captions: tuple[str, ...]
    group: Hashable
    motion: Callable[[], Motion]
    features: Callable[[FeatureCodec], Tensor]
    joints: Callable[[], Tensor]
    contents: tuple[str, ...] | None = None
    parts: tuple[Span, ...] = ()
    croppable: bool = False
    tagged: tuple[Caption, ...] = ()
    stored: str | None = None
    take: Hashable | None = None


class Dataset(Protocol):
    """Clips 0 … len - 1 with features, sentences and a split.

    ``name`` is that of the data, without its place; ``codec`` names the features that networks learn of it unless
    something else is asked for, ``published`` those of the papers, which an evaluator reads.
    """

    name: str
    codec: str
    published: str

    def __len__(self) -> int:
        """Number of clips, mirror images counted."""

    def split(
        self, name: Split, *, composed: bool = True, mirrored: bool = True, untold: bool = False
    ) -> tuple[int, ...]:
        """Clips of a split; without those that are composed, or without our mirrorings, if so asked.

        With ``untold`` also those about which no sentence tells, which are for learning motion alone.

        Raises:
            InputError: an unknown split.
        """

    def clip(self, item: int) -> Clip:
        """What is known of a clip."""

    def takes(self, name: Split) -> tuple[tuple[tuple[int, int], ...], ...]:
        """Told clips of a split that go on from each other in a take: two or more, each with its first frame."""

    def weights(self, items: Sequence[int], power: float, composed_share: float) -> Tensor:
        """(len(items),) float64 chances to be drawn, up to a factor; see ``corpus_weights``."""

    def normalizer(self, codec: FeatureCodec, features: Callable[[int], Tensor]) -> Normalizer:
        """Statistics to normalise by, given a function that gives each clip's features."""

    @property
    def fingerprint(self) -> str:
        """A hash of all clips' motions and splits, but not of their sentences, which are never kept."""

    def sha256(self, split: Split) -> str:
        """A hash of everything that a judgement by this split depends on, sentences included."""

    def left_out(self, split: Split) -> dict[str, int]:
        """How many motions of a split are no clips, by the reason."""

    def describe(self) -> str:
        """How much it is, for people."""


def open_dataset(path: Path) -> Dataset:
    """What a path holds: a folder is HumanML3D or KIT-ML, a file a corpus.

    Raises:
        InputError: it is missing, or parts of it are.
        FormatError: it is damaged.
    """
    return FolderDataset(HumanML3D.open(path)) if path.is_dir() else CorpusDataset(Corpus.open(path), path)


def open_for_training(path: Path) -> Dataset:
    """As ``open_dataset``.

    Raises:
        InputError: as there; there is nothing to train on or to validate with, or a folder has no statistics.
        FormatError: as there.
    """
    found = open_dataset(path)
    needed: tuple[Split, ...] = ("train", "val")
    for split in needed:
        if not found.split(split, composed=False):
            raise InputError(
                f"{path} has no usable clip of the {split} split; training needs some in train and in val: build a "
                f"corpus from more performers, or give a folder whose {split}.txt names motions with sentences"
            )
    if isinstance(found, FolderDataset):
        found.normalizer(get_codec(found.codec), lambda clip: torch.empty(0))
    return found


def choose_codec(dataset: Dataset, name: str) -> FeatureCodec:
    """The codec of that name, where "auto" is the dataset's own and "published" HumanML3D's, or KIT-ML's of its folder.

    Raises:
        InputError: an unknown name.
    """
    return get_codec({"auto": dataset.codec, "published": dataset.published}.get(name, name))


class CorpusDataset:
    """A corpus: clip 2i is record i, clip 2i + 1 its mirror image."""

    codec, published = "native", "hml"

    def __init__(self, corpus: Corpus, path: Path = Path("corpus")) -> None:
        self.corpus, self._path, self.name = corpus, path, path.name
        self._clips: dict[int, Clip] = {}
        # Sentences of labelled sets are shared by all takes of a label: those may answer each other's.
        users: dict[int, str] = {}
        self._shared = {
            caption
            for record in corpus.records
            if record.kind == "take"
            for caption in record.captions
            if users.setdefault(caption, record.group) != record.group
        }

    def __len__(self) -> int:
        return 2 * len(self.corpus)

    def split(
        self, name: Split, *, composed: bool = True, mirrored: bool = True, untold: bool = False
    ) -> tuple[int, ...]:
        records = self.corpus.indices(name, None if composed else False, None if untold else True)
        return tuple(2 * record + flip for record in records for flip in range(1 + mirrored))

    def takes(self, name: Split) -> tuple[tuple[tuple[int, int], ...], ...]:
        rows = in_a_row(self.corpus.records, self.corpus.indices(name, False, True))
        begins = [record.first_frame for record in self.corpus.records]
        return tuple(tuple((2 * k + flip, begins[k]) for k in row) for row in rows for flip in range(2))

    def clip(self, item: int) -> Clip:
        # Kept, because mirroring sentences takes long.
        if item not in self._clips:
            self._clips[item] = self._clip(item // 2, item % 2 == 1)
        return self._clips[item]

    def _clip(self, number: int, mirrored: bool) -> Clip:
        corpus = self.corpus
        record = corpus.records[number]
        captions, contents = corpus.captions(number, mirrored), corpus.contents(number, mirrored)
        parts: tuple[Span, ...] = ()
        own = bool(record.captions) and not self._shared.intersection(record.captions)
        recipe = record.recipe if record.kind == "in_time" else None
        if recipe is not None and len({part.clip for part in recipe.parts}) == 2:  # the second may go on
            stops = (recipe.seam, record.frames)
            said = (corpus.captions(part.clip, part.mirrored != mirrored) for part in recipe.parts[:2])
            parts = tuple(Span(stop, sentences) for stop, sentences in zip(stops, said, strict=True))
        return Clip(
            name=record.name + " mirrored" * mirrored,
            frames=record.frames,
            fps=record.fps,
            skeleton=corpus.skeleton.name,
            captions=captions,
            group=(record.group, mirrored) if own else contents,
            motion=lambda: corpus.motion(number, mirrored),
            features=lambda codec: codec.encode(corpus.motion(number, mirrored)),
            joints=lambda: corpus.motion(number, mirrored).joints,
            contents=contents,
            parts=parts,
            # A window of a clip that shows two things may miss half of what its caption says.
            croppable=len(contents) == 1 and record.kind in ("take", "going_on", "in_place", "paced"),
            take=record.group,
        )

    def weights(self, items: Sequence[int], power: float, composed_share: float) -> Tensor:
        records = list(dict.fromkeys(item // 2 for item in items))
        found = corpus_weights(self.corpus, records, power, composed_share)
        by_record = dict(zip(records, found.tolist(), strict=True))
        return torch.tensor([by_record[item // 2] for item in items], dtype=torch.float64)

    def normalizer(self, codec: FeatureCodec, features: Callable[[int], Tensor]) -> Normalizer:
        """From the takes of the training split and their mirror images."""
        clips = self.split("train", composed=False, untold=True)
        return Normalizer.fit((features(clip) for clip in clips), codec.groups)

    @property
    def fingerprint(self) -> str:
        return self.corpus.fingerprint

    def sha256(self, split: Split) -> str:
        return sha256(self._path)

    def left_out(self, split: Split) -> dict[str, int]:
        return {}

    def describe(self) -> str:
        return f"{len(self.corpus.indices(composed=False))} clips, {self.corpus.seconds / 3600:.2f} h"


class FolderDataset:
    """A HumanML3D or KIT-ML folder: its own features, statistics and splits.

    Clips are the items that the sets' own loaders draw from, all with the same chance: motions of 40 (KIT-ML: 24) to
    199 frames, and the parts of them that have sentences of their own. Mirrored motions are files of their own.

    Raises:
        InputError: files are missing.
        FormatError: a file is damaged.
    """

    def __init__(self, data: HumanML3D) -> None:
        self.data, self.name = data, data.folder.name
        self.codec = self.published = data.layout.codec
        self.items: list[Item] = []
        self._splits: dict[str, tuple[int, ...]] = {}
        for split in ("train", "val", "test"):
            start = len(self.items)
            self.items += data.items(split)
            self._splits[split] = tuple(range(start, len(self.items)))

    def __len__(self) -> int:
        return len(self.items)

    def split(
        self, name: Split, *, composed: bool = True, mirrored: bool = True, untold: bool = False
    ) -> tuple[int, ...]:
        if name not in self._splits:
            raise InputError(f"there is no split {name!r}; use 'train', 'val' or 'test'")
        return self._splits[name]

    def clip(self, item: int) -> Clip:
        first = max(clips[0] for clips in self._splits.values() if clips and clips[0] <= item)
        return _folder_clip(self.data, self.items[item], item - first)

    def takes(self, name: Split) -> tuple[tuple[tuple[int, int], ...], ...]:
        return ()  # nothing in a folder says what goes on from what

    def weights(self, items: Sequence[int], power: float, composed_share: float) -> Tensor:
        """All alike: nothing is known of their contents."""
        return torch.ones(len(items), dtype=torch.float64)

    def normalizer(self, codec: FeatureCodec, features: Callable[[int], Tensor]) -> Normalizer:
        """The folder's Mean.npy and Std.npy."""
        return Normalizer(self.data.mean, self.data.std)

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

    def sha256(self, split: Split) -> str:
        """Of the names, features and texts of a split."""
        sha = hashlib.sha256()
        for name in self.data.splits[split]:
            sha.update(name.encode())
            for part, suffix in (("new_joint_vecs", "npy"), ("texts", "txt")):
                path = self.data.folder / part / f"{name}.{suffix}"
                sha.update(path.read_bytes() if path.is_file() else b"")
        return sha.hexdigest()

    def left_out(self, split: Split) -> dict[str, int]:
        used, layout = {self.items[item].name for item in self._splits[split]}, self.data.layout
        unused = [name for name in self.data.splits[split] if name not in used]
        span = f"not of {layout.shortest} to {layout.too_long - 1} frames, or without a sentence for as many"
        return {span: len(unused)} if unused else {}

    def long_clips(self, split: Split) -> list[Clip]:
        """Motions of 200 rows or more with a sentence for the whole, which the sets' own loaders leave out."""
        found = []
        for name in self.data.splits[split]:
            rows = array_shape(self.data.folder / "new_joint_vecs" / f"{name}.npy")[0]
            whole = tuple(c for c in self.data.captions(name) if c.start == 0 and c.end == 0)
            if rows >= self.data.layout.too_long and whole:
                found.append(_folder_clip(self.data, Item(name, 0, rows, whole), len(found)))
        return found

    def describe(self) -> str:
        frames = sum(item.stop - item.start for item in self.items)
        return f"{len(self)} clips of {self.name}, {frames / self.data.layout.fps / 3600:.2f} h"


def _folder_clip(data: HumanML3D, item: Item, number: int) -> Clip:
    """Some rows of a motion of a folder with the sentences that tell just them.

    Sentences tell of one thing after another, and a window may miss some of it; nothing is known of what clips show.
    """
    layout = data.layout
    codec = get_codec(layout.codec)

    def features(wanted: FeatureCodec) -> Tensor:
        if wanted.name != layout.codec:
            has = f"{layout.codec!r} features ({layout.features} a frame), not {wanted.name!r} ones"
            raise InputError(f"{data.folder} holds {has}; leave the recipe's own choice, codec=auto")
        return data.features(item.name)[item.start : item.stop]

    return Clip(
        name=f"{number} {item.name}",
        frames=item.stop - item.start,
        captions=tuple(caption.text for caption in item.captions),
        fps=layout.fps,
        skeleton=codec.skeleton.name,
        group=item.name,
        motion=lambda: codec.decode(features(codec)),
        features=features,
        joints=lambda: codec.joints(features(codec)) * codec.reflection.float(),
        tagged=item.captions,
        stored=layout.codec,
    )
