"""What a corpus says about each of its clips."""

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass
from typing import Any, Literal, get_args

from moveset.data.augment import MAX_FRAMES
from moveset.data.splits import Split
from moveset.errors import FormatError

_LEAST_NEW = 20  # frames: what goes on has more to show than the end of what was shown
Kind = Literal["take", "in_time", "body", "bent", "going_on", "in_place", "rising", "paced"]
# Of recipes; others have one.
_PARTS = {"in_time": (2, 100), "body": (2, 2), "going_on": (2, 100), "in_place": (1, 100), "rising": (2, 2)}


@dataclass(frozen=True)
class Part:
    """A piece of another clip: frames [start, stop) of record ``clip``, mirrored or not."""

    clip: int
    start: int
    stop: int
    mirrored: bool = False


@dataclass(frozen=True)
class Recipe:
    """How a composed clip is made from parts.

    Args:
        parts: two or more one after the other; or upper body and legs; or the one that is bent, or played at another
            pace.
        blend: frames of overlap, for compositions in time.
        arms: which arms the first part gives ("left", "right", "both"), for compositions of bodies.
        turn: radians to the left by which a way is bent in all.
        sharp: whether it is bent in its middle, like a corner, and not all along.
        speed: how many times as fast it is played.
    """

    parts: tuple[Part, ...]
    blend: int = 0
    arms: Literal["left", "right", "both"] = "both"
    turn: float = 0.0
    sharp: bool = False
    speed: float = 1.0

    @property
    def seam(self) -> int:
        """The frame, in time, from which on more is shown of the second part than of the first."""
        first = self.parts[0]
        return first.stop - first.start - self.blend // 2


@dataclass(frozen=True)
class Run:
    """Consecutive frames of a take that a corpus holds; clips are spans of runs, and may share frames.

    Args:
        first_frame: where the run starts in its take, in frames of the corpus.
    """

    take: str
    first_frame: int
    frames: int


@dataclass(frozen=True)
class ClipRecord:
    """One clip of a corpus.

    Args:
        name: unique name.
        take: name of the take it was cut from; of the first part's, for a composition.
        group: takes of one group show the same seconds of one performance, such as the two partners of a dance.
        kind: "take" as captured; composed "in_time", of two bodies ("body"), of one gait over and over ("going_on"),
            of one that gets nowhere ("in_place"),
            of somebody who gets up and then stands ("rising"), or of one clip "bent" or "paced".
        contents: what is shown, one label for each thing that its sentences tell; none where nothing is told. Two for
            compositions (first, second; upper body, legs) that do not show the same thing over and over.
        style: how it is performed, one label; None where unknown or mixed.
        split: "train", "val" or "test".
        captions: indices into the corpus's strings; none where nothing is told about the clip.
        first_frame: where the clip starts in its take.
        run: number of the run that holds its frames; None for compositions.
        weight: how often to draw it, against others of its contents: less for takes that are long and alike.
    """

    name: str
    take: str
    source: str
    subject: str
    group: str
    kind: Kind
    contents: tuple[str, ...]
    style: str | None
    split: Split
    fps: float
    frames: int
    captions: tuple[int, ...]
    first_frame: int = 0
    recipe: Recipe | None = None
    run: int | None = None
    weight: float = 1.0


def in_a_row(records: Sequence[ClipRecord], chosen: Iterable[int]) -> list[list[int]]:
    """Numbers of those records that go on from each other in one run, two or more in a row, each with new frames."""
    cut = [k for k in chosen if records[k].run is not None]
    rows: list[list[int]] = []
    end = 0
    for k in sorted(cut, key=lambda k: (records[k].run, records[k].first_frame)):
        begin, stop = records[k].first_frame, records[k].first_frame + records[k].frames
        if rows and records[rows[-1][0]].run == records[k].run and begin <= end:
            if stop < end + _LEAST_NEW:
                continue
            rows[-1].append(k)
        else:
            rows.append([k])
        end = stop
    return [row for row in rows if len(row) > 1]


def record_to_json(record: ClipRecord, caption_set: int) -> dict[str, Any]:
    """The record as plain JSON values, its captions replaced by the number of a shared set."""
    out = {**vars(record), "captions": caption_set}
    del out["recipe"]
    if record.recipe is not None:
        out["recipe"] = {**vars(record.recipe), "parts": [astuple(part) for part in record.recipe.parts]}
    return out


def record_from_json(data: Any, caption_sets: list[tuple[int, ...]]) -> ClipRecord:
    """Inverse of ``record_to_json``.

    Raises:
        FormatError: a field is missing, of the wrong type or out of its range.
    """
    try:
        if not 0 <= data["captions"] < len(caption_sets):
            raise ValueError("captions")
        recipe = None
        if "recipe" in data:
            recipe = Recipe(
                tuple(_part(p) for p in data["recipe"]["parts"]),
                int(data["recipe"]["blend"]),
                _one_of(data["recipe"]["arms"], ("left", "right", "both")),
                float(data["recipe"]["turn"]),
                bool(data["recipe"]["sharp"]),
                float(data["recipe"]["speed"]),
            )
        record = ClipRecord(
            **{name: _text(data[name]) for name in ("name", "take", "source", "subject", "group")},
            kind=_one_of(data["kind"], get_args(Kind)),
            contents=tuple(_text(c) for c in data["contents"]),
            style=None if data["style"] is None else _text(data["style"]),
            split=_one_of(data["split"], get_args(Split)),
            fps=float(data["fps"]),
            frames=_integers([data["frames"]])[0],
            captions=caption_sets[data["captions"]],
            first_frame=_integers([data["first_frame"]])[0],
            recipe=recipe,
            run=None if data["run"] is None else _integers([data["run"]])[0],
            weight=float(data["weight"]),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise FormatError(f"a clip record of the corpus is damaged ({error!r}); build the corpus again") from None
    told = bool(record.contents) or not record.captions
    if not (0 < record.fps <= 1000 and record.frames >= 1 and told and 0 < record.weight <= 1000):
        raise FormatError(f"clip {record.name!r} of the corpus has absurd numbers; build the corpus again")
    if not (record.kind == "take") == (recipe is None) == (record.run is not None) or (
        recipe is not None and record.frames > MAX_FRAMES
    ):
        raise FormatError(f"clip {record.name!r} of the corpus has no valid recipe; build the corpus again")
    if recipe is not None:
        least, most = _PARTS.get(record.kind, (1, 1))
        if not (least <= len(recipe.parts) <= most and abs(recipe.turn) <= 100 and 0.1 <= recipe.speed <= 10):
            raise FormatError(f"the recipe of clip {record.name!r} cannot be followed; build the corpus again")
    return record


def run_from_json(data: Any) -> Run:
    """A run from its list of take, first frame and number of frames.

    Raises:
        FormatError: a value is missing, of the wrong type or out of its range.
    """
    try:
        take, first, frames = data
        first, frames = _integers([first, frames])
        if not frames:
            raise ValueError("frames")
        return Run(_text(take), first, frames)
    except (TypeError, ValueError) as error:
        raise FormatError(f"a run of the corpus is damaged ({error!r}); build the corpus again") from None


def _part(value: Any) -> Part:
    clip, start, stop = _integers(value[:3])
    return Part(clip, start, stop, mirrored=bool(value[3]))


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not a string")
    return value


def _integers(values: Any) -> list[int]:
    if not all(isinstance(v, int) and not isinstance(v, bool) and 0 <= v < 2**31 for v in values):
        raise TypeError(f"{values!r} are not small integers")
    return list(values)


def _one_of(value: Any, known: tuple[str, ...]) -> Any:
    if value not in known:
        raise ValueError(f"{value!r} is not one of {known}")
    return value
