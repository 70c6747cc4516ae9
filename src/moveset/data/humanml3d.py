"""HumanML3D and KIT-ML folders as researchers have them (Guo et al. 2022; Plappert et al. 2016).

A folder holds ``new_joint_vecs/NAME.npy`` (F, D) features, optionally ``new_joints/NAME.npy`` (F, J, 3) positions,
``texts/NAME.txt``, ``Mean.npy``, ``Std.npy`` and the split files ``train.txt``, ``val.txt`` and ``test.txt``.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor

from moveset.data.splits import Split
from moveset.errors import FormatError, InputError
from moveset.io.numpy_file import array_shape, read_array

_MAX_TEXT = 2**20
_MAX_SECONDS = 24 * 3600


@dataclass(frozen=True)
class Layout:
    """What distinguishes the two data sets.

    Args:
        name: "humanml3d" or "kit".
        codec: what ``motion.features.get_codec`` knows its features by.
        shortest: clips with fewer frames are left out.
    """

    name: str
    codec: str
    features: int
    fps: float
    shortest: int

    #: Clips with this many frames or more are left out, in both.
    too_long = 200
    #: Times in the text files are cut at this rate in both sets, as in published loaders, whatever ``fps`` is: KIT-ML's
    #: own are all zero, and who writes others has to write row / ``text_fps``.
    text_fps = 20


HUMANML3D = Layout("humanml3d", "hml", features=263, fps=20.0, shortest=40)
KIT = Layout("kit", "kit", features=251, fps=12.5, shortest=24)


@dataclass(frozen=True)
class Caption:
    """One line of a text file.

    Args:
        tokens: "lemma/PART_OF_SPEECH" tokens.
        start: seconds; start and end both 0 mean the whole clip.
        end: seconds.
    """

    text: str
    tokens: tuple[str, ...]
    start: float = 0.0
    end: float = 0.0


@dataclass(frozen=True)
class Item:
    """What a training set draws from: frames [start, stop) of a motion with the captions that describe just them."""

    name: str
    start: int
    stop: int
    captions: tuple[Caption, ...]


def parse_caption(line: str) -> Caption:
    """A line "caption#tokens#start#end"; times that are nan count as 0, as in the sets' own loaders.

    Raises:
        FormatError: the line has another form, or times that are none of a motion.

    >>> parse_caption("a man walks.#a/DET man/NOUN walk/VERB#0.0#nan").tokens
    ('a/DET', 'man/NOUN', 'walk/VERB')
    """
    fields = line.strip().split("#")
    if len(fields) != 4 or not fields[0].strip():
        raise FormatError(f"the text line {line.strip()[:80]!r} is not of the form caption#tokens#start#end")
    try:
        start, end = (float(t) for t in fields[2:])
    except ValueError:
        raise FormatError(f"the text line {line.strip()[:80]!r} has times that are not numbers") from None
    start, end = (0.0 if math.isnan(t) else t for t in (start, end))
    if not all(0 <= t <= _MAX_SECONDS for t in (start, end)):
        wrong = f"has times that are not within 0 and {_MAX_SECONDS} s"
        raise FormatError(f"the text line {line.strip()[:80]!r} {wrong}; restore the original")
    return Caption(fields[0].strip(), tuple(fields[1].split()), start, end)


@dataclass(eq=False, repr=False)
class HumanML3D:
    """A HumanML3D or KIT-ML folder. Open one with ``HumanML3D.open``; nothing but names is read until it is needed."""

    folder: Path
    layout: Layout
    splits: Mapping[str, tuple[str, ...]]

    @classmethod
    def open(cls, folder: str | Path) -> "HumanML3D":
        """Find out what a folder holds; the two sets are told apart by the number of features.

        Raises:
            InputError: parts of the data set are missing.
            FormatError: the features are of neither data set.
        """
        folder = Path(folder)
        for part in ("new_joint_vecs", "texts"):
            if not (folder / part).is_dir():
                raise InputError(f"{folder} has no folder {part!r}; give an unpacked HumanML3D or KIT-ML folder")
        present = {p.stem for p in (folder / "new_joint_vecs").glob("*.npy")}
        if not present:
            raise InputError(f"{folder}/new_joint_vecs holds no .npy files; unpack the data set completely")
        layout, splits = _layout_of(folder, min(present)), {}
        for split in ("train", "val", "test"):
            listed = dict.fromkeys(_lines(folder / f"{split}.txt"))
            splits[split] = tuple(name for name in listed if name in present)
            if listed and not splits[split]:
                raise InputError(f"none of the {len(listed)} motions of {folder}/{split}.txt is in new_joint_vecs")
            lost = [name for name in listed if name not in present]
            if lost:
                warnings.warn(
                    f"{len(lost)} of the motions that {folder}/{split}.txt names are not in new_joint_vecs and are "
                    f"left out, {lost[0]} for one; figures are comparable only with all of them",
                    stacklevel=2,
                )
        for one, other in combinations(splits, 2):
            if both := sorted({*splits[one]} & {*splits[other]}):
                warnings.warn(
                    f"{len(both)} motions are in both {one}.txt and {other}.txt of {folder}, {both[0]} for one; leave "
                    "each to one of them, or what was trained on is judged",
                    stacklevel=2,
                )
        return cls(folder, layout, splits)

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(n for names in self.splits.values() for n in names))

    def features(self, name: str) -> Tensor:
        """(F, D) features of a motion, not normalised.

        Raises:
            InputError: there is no such motion.
            FormatError: the file is damaged, of another shape, or holds numbers that are not finite.
        """
        path = self.folder / "new_joint_vecs" / f"{name}.npy"
        values = read_array(path)
        if values.ndim != 2 or values.shape[1] != self.layout.features or len(values) < 1:
            shape = ("F", self.layout.features)
            raise FormatError(f"{path} has the shape {tuple(values.shape)}, not {shape}; restore the original")
        if not torch.isfinite(values).all():
            raise FormatError(f"{path} holds numbers that are not finite; leave this motion out of the split files")
        return values

    def captions(self, name: str) -> tuple[Caption, ...]:
        """Sentences of a motion.

        Raises:
            InputError: there is no such motion.
            FormatError: a line has the wrong form.
        """
        path = self.folder / "texts" / f"{name}.txt"
        if not path.is_file():
            raise InputError(f"{path} is missing; unpack the data set completely")
        lines = _lines(path)
        try:
            return tuple(parse_caption(line) for line in lines)
        except FormatError as error:
            raise FormatError(f"{path}: {error}") from None

    def items(self, split: Split) -> tuple[Item, ...]:
        """What may be drawn from a split: whole motions and the parts that have sentences of their own.

        Only those with 40 (KIT-ML: 24) to 199 frames; a motion that is left out takes its parts with it, as in the
        sets' own loaders.

        Raises:
            InputError: files are missing.
            FormatError: a file is damaged.
        """
        items = []
        for name in self.splits[split]:
            frames = (array_shape(self.folder / "new_joint_vecs" / f"{name}.npy") or (0,))[0]
            if not self._fits(frames):
                continue
            captions = self.captions(name)
            whole = tuple(c for c in captions if c.start == 0 and c.end == 0)
            if whole:
                items.append(Item(name, 0, frames, whole))
            for caption in captions:
                start, stop = (int(t * self.layout.text_fps) for t in (caption.start, caption.end))
                stop = min(stop, frames)
                if (caption.start or caption.end) and self._fits(stop - start):
                    items.append(Item(name, start, stop, (caption,)))
        return tuple(items)

    @cached_property
    def mean(self) -> Tensor:
        """(D,) mean of the features, from ``Mean.npy``."""
        return self._statistic("Mean.npy")

    @cached_property
    def std(self) -> Tensor:
        """(D,) standard deviation by group of features, from ``Std.npy``."""
        std = self._statistic("Std.npy")
        if not (std > 0).all():
            raise FormatError(f"{self.folder}/Std.npy has values that are not above 0; restore the original file")
        return std

    def _fits(self, frames: int) -> bool:
        return self.layout.shortest <= frames < self.layout.too_long

    def _statistic(self, name: str) -> Tensor:
        values = read_array(self.folder / name)
        if tuple(values.shape) != (self.layout.features,) or not torch.isfinite(values).all():
            raise FormatError(
                f"{self.folder / name} holds {tuple(values.shape)} numbers, not {self.layout.features} finite ones"
            )
        return values


def _layout_of(folder: Path, name: str) -> Layout:
    source = folder / "Mean.npy"
    width = array_shape(source if source.is_file() else folder / "new_joint_vecs" / f"{name}.npy")[-1:]
    for layout in (HUMANML3D, KIT):
        if width == (layout.features,):
            return layout
    raise FormatError(
        f"{folder} has {width} features a frame; HumanML3D has {HUMANML3D.features} and KIT-ML {KIT.features}"
    )


def _lines(path: Path) -> list[str]:
    """Lines of a text file that are not empty; none where there is no file."""
    if not path.is_file():
        return []
    if path.stat().st_size > _MAX_TEXT:
        raise FormatError(f"{path} is larger than the limit of {_MAX_TEXT} bytes; it is no text of the data set")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise FormatError(f"{path} is not UTF-8 text; restore the original") from None
    # Not splitlines, which also parts a sentence at the line ends of Unicode.
    return [line.strip() for line in text.split("\n") if line.strip()]
