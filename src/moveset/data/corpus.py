"""The corpus: one compact file with every clip, its captions and its split.

The file is a safetensors file. Tensors: ``rotations`` (F, J, 3) int16 (see ``quantize``), ``root`` (F, 3) float32
metres and ``offsets`` (J, 3) float32, F the frames of all runs one after the other. A run is what is kept of a take;
clips are spans of runs, which may overlap, put above the origin when they are read. The one metadata entry,
``moveset corpus``, is JSON: version, checksum, skeleton, strings, caption sets, runs and records. Compositions are
stored as recipes and made when asked for; mirrored clips are derived.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import accumulate
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.data.augment import bent, compose_body, compose_in_time, on_the_spot, stretched
from moveset.data.captions import mirror_text
from moveset.data.quantize import pack, unpack
from moveset.data.records import ClipRecord, Part, Recipe, Run, record_from_json, record_to_json, run_from_json
from moveset.data.splits import Split
from moveset.errors import FormatError, InputError
from moveset.io.manifest import json_object
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22, KIT21, Skeleton

VERSION = 2
_ENTRY = "moveset corpus"
_REMEDY = "build the corpus again"
_MAX_BYTES = 16 * 2**30
_SKELETONS = {"hml22": HML22, "kit21": KIT21}


@dataclass(eq=False, repr=False)
class Corpus:
    """Clips with captions, read from one file. Open one with ``Corpus.open``.

    ``motion``, ``captions`` and ``contents`` take the number of a clip, 0 … len - 1, and ``mirrored=True`` for its
    mirror image with left and right exchanged in motion, sentences and labels alike.
    """

    records: tuple[ClipRecord, ...]
    runs: tuple[Run, ...]
    strings: tuple[str, ...]
    skeleton: Skeleton
    _packed: Tensor
    _root: Tensor

    @classmethod
    def open(cls, path: str | Path) -> "Corpus":
        """Read a corpus.

        Raises:
            InputError: the file is missing.
            FormatError: it is not a corpus, of another version, or damaged (a checksum covers every byte).
        """
        index, tensors = _read(Path(path))
        try:
            skeleton = _SKELETONS[index["skeleton"]]
            strings = tuple(str(s) for s in index["strings"])
            sets = [tuple(int(k) for k in s) for s in index["caption_sets"]]
            runs = tuple(run_from_json(run) for run in index["runs"])
            records = tuple(record_from_json(r, sets) for r in index["records"])
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"the index of {path} is damaged ({error!r}); build the corpus again") from None
        if any(not 0 <= k < len(strings) for s in sets for k in s):
            raise FormatError(f"a caption number in {path} points nowhere; build the corpus again")
        packed, root, offsets = tensors["rotations"], tensors["root"], tensors["offsets"]
        frames = sum(run.frames for run in runs)
        joints = len(skeleton)
        shapes = {"rotations": (frames, joints, 3), "root": (frames, 3), "offsets": (joints, 3)}
        for name, shape in shapes.items():
            if tuple(tensors[name].shape) != shape:
                found = tuple(tensors[name].shape)
                raise FormatError(f"{path} holds {name} of shape {found}, not {shape}; build it again")
        if packed.dtype != torch.int16 or root.dtype != torch.float32 or not torch.isfinite(root).all():
            raise FormatError(f"{path} holds numbers of the wrong type or that are not finite; build it again")
        _check_spans(records, runs)
        _check_recipes(records)
        if not torch.allclose(offsets, skeleton.offsets, atol=1e-6):
            skeleton = replace(skeleton, offsets=offsets)
        return cls(records, runs, strings, skeleton, packed, root)

    def __len__(self) -> int:
        return len(self.records)

    @cached_property
    def fingerprint(self) -> str:
        """A hash of all motions, of what they show and of their splits, but not of their captions."""
        records = "\n".join(repr(replace(record, captions=())) for record in self.records) + repr(self.runs)
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
            span = self._span(record)
            turned, root = unpack(self._packed[span]), self._root[span].clone()
            motion = Motion(turned, root, record.fps, self.skeleton).canonical()
        else:
            motion = compose(record.kind, record.recipe, [self._part(p) for p in record.recipe.parts])
        return motion.mirrored() if mirrored else motion

    def lowest(self, i: int) -> float:
        """The lowest that the root of clip ``i`` is over the floor, metres; of a composition, of what it is made of."""
        record = self._record(i)
        if record.recipe is None:
            return float(self._root[self._span(record), 1].amin())
        spans = ((self._span(self.records[p.clip]).start, p) for p in record.recipe.parts)
        return min(float(self._root[start + p.start : start + p.stop, 1].amin()) for start, p in spans)

    def captions(self, i: int, mirrored: bool = False) -> tuple[str, ...]:
        """Sentences for clip ``i``."""
        sentences = tuple(self.strings[k] for k in self._record(i).captions)
        return tuple(mirror_text(s) for s in sentences) if mirrored else sentences

    def contents(self, i: int, mirrored: bool = False) -> tuple[str, ...]:
        """Content labels of clip ``i``: one, or two for a composition of two things."""
        labels = self._record(i).contents
        return tuple(mirror_text(c) for c in labels) if mirrored else labels

    def indices(
        self, split: Split | None = None, composed: bool | None = None, captioned: bool | None = None
    ) -> tuple[int, ...]:
        """Numbers of the clips of a split (None: all); only compositions, only takes, or both (None); likewise with or
        without captions.

        Raises:
            InputError: an unknown split.
        """
        if split not in (None, "train", "val", "test"):
            raise InputError(f"there is no split {split!r}; use 'train', 'val' or 'test'")
        return tuple(
            i
            for i, r in enumerate(self.records)
            if (split is None or r.split == split)
            and (composed is None or (r.kind != "take") == composed)
            and (captioned is None or bool(r.captions) == captioned)
        )

    @cached_property
    def seconds(self) -> float:
        """Total duration of the runs: shared frames are counted once, compositions not at all."""
        fps = {record.run: record.fps for record in self.records if record.run is not None}
        return sum(run.frames / fps[k] for k, run in enumerate(self.runs))

    @cached_property
    def _starts(self) -> tuple[int, ...]:
        return tuple(accumulate((run.frames for run in self.runs), initial=0))

    def _span(self, record: ClipRecord) -> slice:
        """Where the frames of a take's clip are."""
        assert record.run is not None
        start = self._starts[record.run] + record.first_frame - self.runs[record.run].first_frame
        return slice(start, start + record.frames)

    def _record(self, i: int) -> ClipRecord:
        if not 0 <= i < len(self.records):
            last = len(self.records) - 1
            raise InputError(f"there is no clip {i} in a corpus of {last + 1}; use 0 to {last}")
        return self.records[i]

    def _part(self, part: Part) -> Motion:
        motion = self.motion(part.clip)[part.start : part.stop]
        return motion.mirrored() if part.mirrored else motion


def compose(kind: str, recipe: Recipe, parts: Sequence[Motion]) -> Motion:
    if kind in ("in_time", "going_on", "rising"):
        return _in_turn(recipe, parts)
    if kind == "in_place":
        return on_the_spot(_in_turn(recipe, parts))
    if kind == "bent":
        return bent(parts[0], recipe.turn, recipe.sharp)
    if kind == "paced":
        return stretched(parts[0], max(2, round(len(parts[0]) / recipe.speed)))
    return compose_body(*parts, recipe.arms)


def _in_turn(recipe: Recipe, parts: Sequence[Motion]) -> Motion:
    return reduce(lambda first, second: compose_in_time(first, second, recipe.blend), parts)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The index and the tensors of a file, which match their checksum."""
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise InputError(f"there is no corpus at {path}; make one with 'moveset data build'")
    if path.stat().st_size > _MAX_BYTES:
        raise FormatError(f"{path} is not a corpus: it is larger than {_MAX_BYTES >> 30} GB; build it again")
    try:
        with safe_open(path, framework="pt") as file:
            entry = (file.metadata() or {}).get(_ENTRY)
            if entry is None:
                raise FormatError(f"{path} is not a moveset corpus; make one with 'moveset data build'")
            index = json_object(entry, path, _REMEDY)
            if index.get("version") != VERSION:
                version = index.get("version")
                raise FormatError(f"{path} is a corpus of version {version}, not {VERSION}; build it again")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, ValueError) as error:
        raise FormatError(f"{path} is not a corpus, or damaged ({error}); build the corpus again") from None
    digest = index.pop("sha256", None)
    if set(tensors) != {"rotations", "root", "offsets"} or _digest(tensors, index) != digest:
        raise FormatError(f"{path} is damaged: its contents do not match their checksum; build the corpus again")
    return index, tensors


def _digest(tensors: dict[str, Tensor], index: dict[str, Any]) -> str:
    sha = hashlib.sha256(json.dumps(index, sort_keys=True).encode())
    for name in sorted(tensors):
        sha.update(f"{name}{tuple(tensors[name].shape)}{tensors[name].dtype}".encode())
        sha.update(tensors[name].contiguous().numpy().reshape(-1).data)
    return sha.hexdigest()


def _check_spans(records: Sequence[ClipRecord], runs: Sequence[Run]) -> None:
    used = {record.run for record in records if record.run is not None}
    if used != set(range(len(runs))):
        raise FormatError("the corpus has runs without clips or clips without runs; build the corpus again")
    for record in records:
        if record.run is None:
            continue
        run = runs[record.run]
        if not run.first_frame <= record.first_frame <= run.first_frame + run.frames - record.frames:
            raise FormatError(f"clip {record.name!r} is not within its run; build the corpus again")


def _check_recipes(records: Sequence[ClipRecord]) -> None:
    for record in records:
        for part in record.recipe.parts if record.recipe is not None else ():
            if not part.clip < len(records) or records[part.clip].kind != "take":
                raise FormatError(f"clip {record.name!r} is composed of what is no take; build the corpus again")
            whole = records[part.clip]
            if not part.start < part.stop <= whole.frames or whole.split != record.split:
                raise FormatError(f"clip {record.name!r} is composed of frames it may not use; build the corpus again")


class CorpusWriter:
    """Collects runs and clips and writes a corpus; the same ones in the same order give the same bytes."""

    def __init__(self) -> None:
        self.records: list[ClipRecord] = []
        self._runs: list[Run] = []
        self._motions: list[Motion] = []
        self._strings: dict[str, int] = {}
        self._told: list[str] = []

    def add_run(self, take: str, motion: Motion, first_frame: int = 0) -> int:
        """Store frames of a take, which clips are to show; returns the run's number.

        Raises:
            InputError: it is on another skeleton than the runs before it.
        """
        if self._motions and motion.skeleton is not self._motions[0].skeleton:
            raise InputError(f"take {take!r} is not on {self._motions[0].skeleton.name!r} as the takes before it")
        self._runs.append(Run(take, first_frame, len(motion)))
        self._motions.append(motion)
        return len(self._runs) - 1

    def add_clip(self, record: ClipRecord, captions: Iterable[str]) -> int:
        """Store a clip, whose captions are given as sentences; returns its number.

        Raises:
            InputError: a take comes after compositions.
        """
        if record.kind == "take" and self.records and self.records[-1].kind != "take":
            raise InputError(f"clip {record.name!r} comes after compositions; add every take before composing")
        numbers = []
        for sentence in captions:
            if sentence not in self._strings:
                self._strings[sentence] = len(self._told)
                self._told.append(sentence)
            numbers.append(self._strings[sentence])
        self.records.append(replace(record, captions=tuple(numbers)))
        return len(self.records) - 1

    def sentences(self, record: ClipRecord) -> tuple[str, ...]:
        return tuple(self._told[k] for k in record.captions)

    @property
    def frames(self) -> int:
        return sum(run.frames for run in self._runs)

    def motion(self, record: ClipRecord) -> Motion:
        assert record.run is not None
        start = record.first_frame - self._runs[record.run].first_frame
        return self._motions[record.run][start : start + record.frames].canonical()

    def write(self, path: str | Path) -> Path:
        """Write the corpus; whole or not at all.

        Raises:
            InputError: there are no clips, or the path cannot be written.
        """
        from safetensors.torch import save

        from moveset.io.limits import atomic_write, make_folder

        if not self._motions:
            raise InputError("there are no clips to write; every take was rejected or none was given")
        _check_spans(self.records, self._runs)
        _check_recipes(self.records)
        sets: dict[tuple[int, ...], int] = {}
        records = [record_to_json(r, sets.setdefault(r.captions, len(sets))) for r in self.records]
        skeleton = self._motions[0].skeleton
        index = {
            "version": VERSION,
            "skeleton": skeleton.name,
            "strings": self._told,
            "caption_sets": [list(s) for s in sets],
            "runs": [[run.take, run.first_frame, run.frames] for run in self._runs],
            "records": records,
        }
        tensors = {
            "rotations": torch.cat([pack(m.rotations) for m in self._motions]),
            "root": torch.cat([m.root for m in self._motions]),
            "offsets": skeleton.offsets.clone(),
        }
        index["sha256"] = _digest(tensors, index)
        # One entry only: the order of several would differ from run to run.
        metadata = {_ENTRY: json.dumps(index, separators=(",", ":"))}
        path = Path(path)
        make_folder(path.parent)
        with atomic_write(path) as file:
            file.write(save(tensors, metadata=metadata))
        return path
