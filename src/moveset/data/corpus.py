"""The corpus: one compact file with every clip, its captions and its split.

The file is a safetensors file. Tensors: ``rotations`` (F, J, 3) int16 (see ``quantize``), ``root`` (F, 3) float32
metres and ``offsets`` (J, 3) float32, F the frames of all takes in the order of their records. The one metadata entry,
``moveset corpus``, is JSON: version, checksum, skeleton, strings, caption sets and records. Compositions are stored as
recipes and made when asked for; mirrored clips are derived.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.data.augment import compose_body, compose_in_time
from moveset.data.captions import mirror_text
from moveset.data.labels import mirror_label
from moveset.data.quantize import pack, unpack
from moveset.data.records import ClipRecord, Part, Recipe, record_from_json, record_to_json
from moveset.data.splits import Split
from moveset.errors import FormatError, InputError
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22, KIT21, Skeleton

VERSION = 1
_ENTRY = "moveset corpus"
_MAX_BYTES = 16 * 2**30
_MAX_HEADER = 100 * 2**20
_SKELETONS = {"hml22": HML22, "kit21": KIT21}


class Corpus:
    """Clips with captions, read from one file. Open one with ``Corpus.open``.

    ``motion``, ``captions`` and ``contents`` take the number of a clip, 0 … len - 1, and ``mirrored=True`` for its
    mirror image with left and right exchanged in motion, sentences and labels alike.
    """

    def __init__(
        self,
        records: tuple[ClipRecord, ...],
        strings: tuple[str, ...],
        skeleton: Skeleton,
        packed: Tensor,
        root: Tensor,
    ) -> None:
        self.records = records
        self.strings = strings
        self.skeleton = skeleton
        self._packed = packed
        self._root = root
        starts, total = [], 0
        for record in records:
            starts.append(total)
            total += record.frames if record.kind == "take" else 0
        self._starts = tuple(starts)

    @classmethod
    def open(cls, path: str | Path) -> "Corpus":
        """Read a corpus.

        Raises:
            InputError: the file is missing.
            FormatError: it is not a corpus, of another version, or damaged (a checksum covers every byte).
        """
        index = _checked_index(Path(path))
        tensors = _tensors(Path(path), index)
        try:
            skeleton = _SKELETONS[index["skeleton"]]
            strings = tuple(str(s) for s in index["strings"])
            sets = [tuple(int(k) for k in s) for s in index["caption_sets"]]
            records = tuple(record_from_json(r, sets) for r in index["records"])
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"the index of {path} is damaged ({error!r}); build the corpus again") from None
        if any(not 0 <= k < len(strings) for s in sets for k in s):
            raise FormatError(f"a caption number in {path} points nowhere; build the corpus again")
        packed, root, offsets = tensors["rotations"], tensors["root"], tensors["offsets"]
        frames = sum(r.frames for r in records if r.kind == "take")
        joints = len(skeleton)
        shapes = {"rotations": (frames, joints, 3), "root": (frames, 3), "offsets": (joints, 3)}
        for name, shape in shapes.items():
            if tuple(tensors[name].shape) != shape:
                found = tuple(tensors[name].shape)
                raise FormatError(f"{path} holds {name} of shape {found}, not {shape}; build it again")
        if packed.dtype != torch.int16 or root.dtype != torch.float32 or not torch.isfinite(root).all():
            raise FormatError(f"{path} holds numbers of the wrong type or that are not finite; build it again")
        _check_recipes(records)
        if not torch.allclose(offsets, skeleton.offsets, atol=1e-6):
            skeleton = replace(skeleton, offsets=offsets)
        return cls(records, strings, skeleton, packed, root)

    def __len__(self) -> int:
        return len(self.records)

    @cached_property
    def fingerprint(self) -> str:
        """A hash of all motions, of what they show and of their splits, but not of their captions."""
        records = "\n".join(repr(replace(record, captions=())) for record in self.records)
        sha = hashlib.sha256(records.encode())
        for stored in (self._packed, self._root, self.skeleton.offsets):
            sha.update(stored.contiguous().numpy().data)
        return sha.hexdigest()

    def motion(self, i: int, mirrored: bool = False) -> Motion:
        """Clip ``i``, starting above the origin and facing +Z.

        Raises:
            InputError: there is no clip ``i``.
        """
        record = self._record(i)
        if record.recipe is None:
            span = slice(self._starts[i], self._starts[i] + record.frames)
            motion = Motion(unpack(self._packed[span]), self._root[span].clone(), record.fps, self.skeleton)
        else:
            motion = compose(record.kind, record.recipe, [self._part(p) for p in record.recipe.parts])
        return motion.mirrored() if mirrored else motion

    def captions(self, i: int, mirrored: bool = False) -> tuple[str, ...]:
        """Sentences for clip ``i``."""
        sentences = tuple(self.strings[k] for k in self._record(i).captions)
        return tuple(mirror_text(s) for s in sentences) if mirrored else sentences

    def contents(self, i: int, mirrored: bool = False) -> tuple[str, ...]:
        """Content labels of clip ``i``: one, or two for a composition of two things."""
        labels = self._record(i).contents
        return tuple(mirror_label(c) for c in labels) if mirrored else labels

    def indices(self, split: Split | None = None, composed: bool | None = None) -> tuple[int, ...]:
        """Numbers of the clips of a split (None: all); only compositions, only takes, or both (None).

        Raises:
            InputError: an unknown split.
        """
        if split not in (None, "train", "val", "test"):
            raise InputError(f"there is no split {split!r}; use 'train', 'val' or 'test'")
        return tuple(
            i
            for i, r in enumerate(self.records)
            if (split is None or r.split == split) and (composed is None or (r.kind != "take") == composed)
        )

    @cached_property
    def seconds(self) -> float:
        """Total duration of the takes, compositions not counted."""
        return sum(r.frames / r.fps for r in self.records if r.kind == "take")

    def _record(self, i: int) -> ClipRecord:
        if not 0 <= i < len(self.records):
            last = len(self.records) - 1
            raise InputError(f"there is no clip {i} in a corpus of {last + 1}; use 0 to {last}")
        return self.records[i]

    def _part(self, part: Part) -> Motion:
        motion = self.motion(part.clip)[part.start : part.stop]
        return motion.mirrored() if part.mirrored else motion


def compose(kind: str, recipe: Recipe, parts: Sequence[Motion]) -> Motion:
    """The composition of its parts that a recipe describes."""
    if kind == "in_time":
        return reduce(lambda first, second: compose_in_time(first, second, recipe.blend), parts)
    return compose_body(*parts, recipe.arms)


# ------------------------------------------------------------------------------------------------------- checking


def _checked_index(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"there is no corpus at {path}; make one with 'moveset data build'")
    size = path.stat().st_size
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        if size > _MAX_BYTES or not 2 <= length <= min(_MAX_HEADER, size - 8):
            raise FormatError(f"{path} is not a corpus: its header claims {length} of {size} bytes; build it again")
        header = _json_object(file.read(length).decode("utf-8", "replace"), path)
    metadata = header.get("__metadata__")
    if not isinstance(metadata, dict) or not isinstance(metadata.get(_ENTRY), str):
        raise FormatError(f"{path} is not a moveset corpus; make one with 'moveset data build'")
    index = _json_object(metadata[_ENTRY], path)
    if index.get("version") != VERSION:
        raise FormatError(f"{path} is a corpus of version {index.get('version')}, not {VERSION}; build it again")
    return index


def _json_object(text: str, path: str | Path) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path} is damaged: its header is not JSON; build the corpus again") from error
    if not isinstance(value, dict):
        raise FormatError(f"{path} is damaged: its header is not a JSON object; build the corpus again")
    return value


def _tensors(path: Path, index: dict[str, Any]) -> dict[str, Tensor]:
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        tensors = load_file(path)
    except (SafetensorError, ValueError) as error:
        raise FormatError(f"{path} is damaged ({error}); build the corpus again") from None
    digest = index.pop("sha256", None)
    if set(tensors) != {"rotations", "root", "offsets"} or _digest(tensors, index) != digest:
        raise FormatError(f"{path} is damaged: its contents do not match their checksum; build the corpus again")
    return tensors


def _digest(tensors: dict[str, Tensor], index: dict[str, Any]) -> str:
    sha = hashlib.sha256(json.dumps(index, sort_keys=True).encode())
    for name in sorted(tensors):
        sha.update(f"{name}{tuple(tensors[name].shape)}{tensors[name].dtype}".encode())
        sha.update(tensors[name].contiguous().numpy().reshape(-1).data)
    return sha.hexdigest()


def _check_recipes(records: Sequence[ClipRecord]) -> None:
    for record in records:
        for part in record.recipe.parts if record.recipe is not None else ():
            if not part.clip < len(records) or records[part.clip].kind != "take":
                raise FormatError(f"clip {record.name!r} is composed of what is no take; build the corpus again")
            whole = records[part.clip]
            if not part.start < part.stop <= whole.frames or whole.split != record.split:
                raise FormatError(f"clip {record.name!r} is composed of frames it may not use; build the corpus again")


# -------------------------------------------------------------------------------------------------------- writing


@dataclass(frozen=True, eq=False)
class TakeEntry:
    """A clip to be stored: fields as in ``ClipRecord``, captions as sentences."""

    name: str
    take: str
    source: str
    content: str
    style: str | None
    captions: tuple[str, ...]
    split: Split
    subject: str
    motion: Motion
    first_frame: int = 0


class CorpusWriter:
    """Collects clips and writes a corpus; the same clips in the same order give the same bytes."""

    def __init__(self) -> None:
        self.records: list[ClipRecord] = []
        self.motions: list[Motion] = []
        self._strings: dict[str, int] = {}

    def add_take(self, entry: TakeEntry) -> int:
        """Store a clip; returns its number.

        Raises:
            InputError: it comes after a composition, or is on another skeleton than the clips before it.
        """
        if len(self.motions) != len(self.records):
            raise InputError(f"clip {entry.name!r} comes after compositions; add every take before composing")
        if self.motions and entry.motion.skeleton is not self.motions[0].skeleton:
            raise InputError(f"clip {entry.name!r} is not on {self.motions[0].skeleton.name!r} as the clips before it")
        self.motions.append(entry.motion)
        return self._add(
            ClipRecord(
                name=entry.name,
                take=entry.take,
                source=entry.source,
                subject=entry.subject,
                kind="take",
                contents=(entry.content,),
                style=entry.style,
                split=entry.split,
                fps=entry.motion.fps,
                frames=len(entry.motion),
                captions=self._numbers(entry.captions),
                first_frame=entry.first_frame,
            )
        )

    def add_composition(self, record: ClipRecord, captions: Iterable[str]) -> int:
        """Store a recipe with its sentences; returns its number."""
        return self._add(replace(record, captions=self._numbers(captions)))

    def write(self, path: str | Path) -> Path:
        """Write the corpus; whole or not at all.

        Raises:
            InputError: there are no clips, or the path cannot be written.
        """
        from safetensors.torch import save

        from moveset.io.limits import atomic_write

        if not self.motions:
            raise InputError("there are no clips to write; every take was rejected or none was given")
        _check_recipes(self.records)
        sets: dict[tuple[int, ...], int] = {}
        records = [record_to_json(r, sets.setdefault(r.captions, len(sets))) for r in self.records]
        skeleton = self.motions[0].skeleton
        index = {
            "version": VERSION,
            "skeleton": skeleton.name,
            "strings": list(self._strings),
            "caption_sets": [list(s) for s in sets],
            "records": records,
        }
        tensors = {
            "rotations": torch.cat([pack(m.rotations) for m in self.motions]),
            "root": torch.cat([m.root for m in self.motions]),
            "offsets": skeleton.offsets.clone(),
        }
        index["sha256"] = _digest(tensors, index)
        # One entry only: the order of several would differ from run to run.
        metadata = {_ENTRY: json.dumps(index, separators=(",", ":"))}
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(save(tensors, metadata=metadata))
        return path

    def _add(self, record: ClipRecord) -> int:
        self.records.append(record)
        return len(self.records) - 1

    def _numbers(self, captions: Iterable[str]) -> tuple[int, ...]:
        return tuple(self._strings.setdefault(s, len(self._strings)) for s in captions)
