"""Which compositions a corpus gets: recipes out of its clips, each within one split, told by their parts' sentences.

One thing after another, joined where both are most alike; somebody who goes, and then stops and stands; arms of one on
the legs of another; a way that is bent onto a circle, round a corner or back; a gait that goes on, also of who stands
first; somebody who gets up; another pace. Every choice comes from a random generator seeded by a string, so that the
same clips give the same recipes.
"""

import math
import random
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial

import torch
from torch import Tensor

from moveset.data.augment import MAX_FRAMES, corner_radius, legs_differ
from moveset.data.captions import mirror_text
from moveset.data.corpus import CorpusWriter
from moveset.data.descriptions import without_person
from moveset.data.english import inflect
from moveset.data.passages import STRAIGHT, find_gait, find_rises
from moveset.data.records import ClipRecord, Kind, Part, Recipe
from moveset.data.verbs import LOCOMOTION, STANDING
from moveset.data.wordings import BACK, CIRCLE, CORNER, CURVE, HOW, SPOT, STARTS, STOPS, SUBJECTS, THEN, UP, WHILE
from moveset.motion import rotations
from moveset.motion.clip import Motion

_BLEND = 12
_SHORTEST = 24
_LEAST = 40  # frames that a gait takes to be seen for one
_WORDS = 12  # of a sentence that becomes half of another
_ORDER = re.compile(r"\b(then|after|before|while|finally|first|next|again|start|begin|end|stop)", re.IGNORECASE)
_FAR = 1.6  # metres of a way that can be bent
_LEFT = 0.15  # metres from where somebody stood who has set off
_PACES = (0.85, 0.9, 1.1, 1.15)
_ASIDE = re.compile(
    r"circle|turn|left|right|back|diagonal|curve|stop|start|steps|paces|side|stair|speeds|slows|few", re.IGNORECASE
)

_PLAIN = 7  # words of a sentence that says no more than that somebody walks, and where
_WAY = re.compile(r"straight|line|circle|turn|left|right|back|diagonal|curve", re.IGNORECASE)
_ONWARD = re.compile(_WAY.pattern + r"|forward|ahead|across|away|toward|along|around", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class _Clip:
    """A stored clip, possibly to be used mirrored."""

    writer: CorpusWriter
    number: int
    mirrored: bool

    @property
    def record(self) -> ClipRecord:
        return self.writer.records[self.number]

    @cached_property
    def sentences(self) -> tuple[str, ...]:
        sentences = self.writer.sentences(self.record)
        return tuple(mirror_text(s) for s in sentences) if self.mirrored else sentences

    @cached_property
    def motion(self) -> Motion:
        motion = self.writer.motion(self.record)
        return motion.mirrored() if self.mirrored else motion

    @cached_property
    def poses(self) -> Tensor:
        """(F - 1, D) poses and velocities in the body's own heading, metres and 0.2 m/s, to compare places to cut."""
        motion = self.motion
        facing = rotations.inv(rotations.heading(motion.rotations[:, 0]))[:, None]
        joints = motion.joints[:, [*motion.skeleton.feet, 0, 15, 20, 21]]
        place = rotations.rotate(facing, joints - motion.root[:, None] * torch.tensor((1.0, 0.0, 1.0)))
        speed = rotations.rotate(facing[:-1], joints[1:] - joints[:-1]) * motion.fps * 0.2
        return torch.cat((place[:-1], speed), dim=1).flatten(1)

    def short(self) -> list[str]:
        """Sentences that can be halves of one: short, and not about one thing after another."""
        return [s for s in self.sentences if len(s.split()) <= _WORDS and not _ORDER.search(s)]


@dataclass(frozen=True)
class _Made:
    kind: Kind
    recipe: Recipe
    frames: int
    contents: tuple[str, ...]
    captions: tuple[str, ...]


class _Pool:
    """The clips of training; ``records`` are those that have sentences."""

    def __init__(self, writer: CorpusWriter) -> None:
        self._writer = writer
        # One object a clip, for what is computed of it is kept there.
        self._clip = cache(partial(_Clip, writer))
        takes = [(k, r) for k, r in enumerate(writer.records) if r.kind == "take" and r.split == "train"]
        self._takes = [(k, r) for k, r in takes if r.frames >= _SHORTEST]
        self.records = [(k, r) for k, r in self._takes if r.captions]
        #: Rare things are drawn more often than their number of clips.
        counts = Counter(record.contents for _, record in self.records)
        self.weights = [record.weight * counts[record.contents] ** -0.5 for _, record in self.records]

    @cached_property
    def gaits(self) -> list[tuple[_Clip, int, int]]:
        """Clips of nothing but a gait, and the frames of each that can be repeated."""
        found = []
        for number, record in self.records:
            clip = self._clip(number, False)
            if len(record.contents) == 1 and record.contents[0] in LOCOMOTION and _ahead(clip):
                gait = find_gait(clip.motion, clip.poses, _BLEND)
                found += [(clip, *gait)] if gait else []
        return found

    @cached_property
    def rises(self) -> list[tuple[_Clip, int, int]]:
        """Clips, told or not, in which somebody gets up from rest, and the frames of each from there until upright."""
        found = [(k, span) for k, r in self._takes for span in find_rises(self._writer.motion(r))]
        return [(self._clip(k, mirrored), *span) for k, span in found for mirrored in (False, True)]

    def pick(self, chance: random.Random, wanted: Callable[[ClipRecord], bool] = lambda record: True) -> _Clip | None:
        """A clip of a wanted kind; None if none was found."""
        for number, record in chance.choices(self.records, self.weights, k=40) if self.records else ():
            if wanted(record):
                return self._clip(number, chance.random() < 0.5)
        return None


def add_compositions(writer: CorpusWriter, train: int = 3000, seed: int = 0, *, progress: bool = False) -> int:
    """Add about ``train`` compositions of training clips; returns how many.

    Validation and testing are by what was captured alone.
    """
    from tqdm import tqdm

    pool, chance = _Pool(writer), random.Random(f"compositions, seed {seed}")
    ways = [way for way, share in _WAYS.items() for _ in range(share)]
    seen: set[Recipe] = set()
    with tqdm(total=train, desc="compositions", unit="", disable=not progress) as bar:
        for attempt in range(8 * train if pool.records else 0):
            if len(seen) == train:
                break
            made = ways[attempt % len(ways)](pool, chance)
            if made is None or made.recipe in seen:
                continue
            seen.add(made.recipe)
            _add(writer, f"{made.kind}_{len(seen):05d}", made)
            bar.update()
    return len(seen)


def _add(writer: CorpusWriter, name: str, made: _Made) -> None:
    first = writer.records[made.recipe.parts[0].clip]
    record = ClipRecord(
        name=name,
        take=first.take,
        source="composed",
        subject=first.subject,
        group=name,
        kind=made.kind,
        contents=made.contents,
        style=None,
        split=first.split,
        fps=first.fps,
        frames=made.frames,
        captions=(),
        recipe=made.recipe,
    )
    writer.add_clip(record, made.captions)


def _joined(a: _Clip, b: _Clip, span: tuple[int, int] | None = None, since: int = 0) -> tuple[Recipe, int] | None:
    """``b`` after ``a`` where they are most alike, if they are alike enough.

    Args:
        span: first and last frame, exclusive, of ``a`` alone; by default all.
        since: first frame of ``b``.
    """
    (begin, end), frames_b = span or (0, a.record.frames), b.record.frames
    # Actions keep their beginnings, and most of themselves.
    stops = range(begin + max(_SHORTEST, round(0.7 * (end - begin))), end + 1)
    starts = range(since, since + max(1, round(0.2 * (frames_b - since))))
    if not len(stops):
        return None
    half = _BLEND // 2
    rows = torch.tensor(stops).sub(half).clamp(0, a.record.frames - 2)
    columns = torch.tensor(starts).add(half).clamp(0, frames_b - 2)
    apart = torch.cdist(a.poses[rows], b.poses[columns])
    best = int(apart.argmin())
    stop, start = stops[best // len(columns)], starts[best % len(columns)]
    if float(apart.flatten()[best]) > _ALIKE or not 1 <= _BLEND < min(stop - begin, frames_b - start):
        return None
    last = min(frames_b, start + MAX_FRAMES + _BLEND - (stop - begin))
    if last - start < max(_SHORTEST, 0.7 * (frames_b - start)):
        return None
    parts = (Part(a.number, begin, stop, a.mirrored), Part(b.number, start, last, b.mirrored))
    return Recipe(parts, blend=_BLEND), stop - begin + last - start - _BLEND


_ALIKE = 1.2  # root of the sum of squares over joints' places and velocities


def _then(pool: _Pool, chance: random.Random) -> _Made | None:
    room = MAX_FRAMES - _SHORTEST
    a = pool.pick(chance, lambda r: r.frames <= room and STANDING not in r.contents)
    if a is None:
        return None
    left = MAX_FRAMES - round(0.7 * a.record.frames)
    b = pool.pick(chance, lambda r: 0.7 * r.frames <= left and r.contents != a.record.contents)
    return _told(a, b, THEN, chance)


def _stop(pool: _Pool, chance: random.Random) -> _Made | None:
    a = pool.pick(chance, lambda r: r.frames <= 160 and STANDING not in r.contents)
    b = pool.pick(chance, lambda r: r.contents == (STANDING,))
    return _told(a, b, STOPS, chance)


def _start(pool: _Pool, chance: random.Random) -> _Made | None:
    a = pool.pick(chance, lambda r: r.contents == (STANDING,) and r.frames <= 80)
    b = pool.pick(chance, lambda r: r.frames <= 160 and STANDING not in r.contents)
    return _told(a, b, STARTS, chance)


def _told(a: _Clip | None, b: _Clip | None, ways: Sequence[str], chance: random.Random) -> _Made | None:
    """``a`` and ``b`` joined, told by halves of sentences."""
    if a is None or b is None:
        return None
    first, second = a.short(), [told for s in b.short() if (told := without_person(s))]
    if not first or not second or (found := _joined(a, b)) is None:
        return None
    said = []
    for way in chance.sample(ways, 3):
        halves = {"a": chance.choice(first).rstrip(". "), "b": chance.choice(second).rstrip(". ")}
        said.append(way.format(s=chance.choice(SUBJECTS), **halves))
    return _Made("in_time", *found, (*a.record.contents, *b.record.contents), tuple(dict.fromkeys(said)))


def _body(pool: _Pool, chance: random.Random) -> _Made | None:
    lower = pool.pick(chance, lambda r: len(r.contents) == 1 and r.contents[0] in (*LOCOMOTION, STANDING))
    upper = pool.pick(chance, lambda r: not {*r.contents} & {*LOCOMOTION, STANDING} and len(r.contents) <= 2)
    if lower is None or upper is None or not (arms := [told for s in upper.short() if (told := without_person(s))]):
        return None
    frames = min(lower.record.frames, upper.record.frames, MAX_FRAMES)
    legs = lower.motion[:frames]
    # The arms' own legs must stand upright: what a body does lying down or bent over is no business of the arms.
    if frames < 32 or legs_differ(upper.motion[:frames], legs):
        return None
    verb = lower.record.contents[0]
    way = inflect(verb, "ing") if verb != STANDING else "standing"
    said = (
        wording.format(a=way, b=f"{chance.choice(SUBJECTS)} {chance.choice(arms).rstrip('. ')}")
        for wording in chance.sample(WHILE, 2)
    )
    parts = (Part(upper.number, 0, frames, upper.mirrored), Part(lower.number, 0, frames, lower.mirrored))
    contents = (*upper.record.contents, verb)
    return _Made("body", Recipe(parts), frames, contents, tuple(dict.fromkeys(said)))


def _bent(pool: _Pool, chance: random.Random) -> _Made | None:
    clip = pool.pick(chance, lambda r: len(r.contents) == 1 and r.contents[0] in LOCOMOTION)
    if clip is None:
        return None
    motion, frames = clip.motion, min(clip.record.frames, MAX_FRAMES)
    path = motion.root[:frames, [0, 2]]
    way, reach = float(path.diff(dim=0).norm(dim=1).sum()), float((path[-1] - path[0]).norm())
    ahead = rotations.rotate(rotations.inv(rotations.heading(motion.rotations[0, 0])), motion.root[-1] - motion.root[0])
    if way < _FAR or reach < STRAIGHT * way or float(ahead[2]) < STRAIGHT * reach:
        return None
    radius = corner_radius(motion[:frames])
    choices = [(CURVE, 0.33, False)]
    choices += [(w, half, True) for w, half in ((CORNER, 0.5), (BACK, 1.0)) if 1.3 * half * math.pi * radius < way]
    if way > 2 * math.pi * radius:
        choices += [(CIRCLE, 2.0, False)] * 2
    wordings, half_turns, sharp = chance.choice(choices)
    told = [sentence.rstrip(". ") for sentence in clip.short() if not _WAY.search(sentence)]
    if any(len(sentence.split()) > _PLAIN for sentence in clip.sentences):
        wordings = HOW[wordings]
        if not told:
            return None
    left = chance.random() < 0.5
    side, clock = ("left", "counterclockwise") if left else ("right", "clockwise")
    verb = inflect(clip.record.contents[0], "present")
    said = (
        w.format(s=chance.choice(SUBJECTS), v=verb, a=chance.choice(told or [""]), side=side, clock=clock)
        for w in chance.sample(wordings, 3)
    )
    turn = math.pi * half_turns * (1.0 if left else -1.0)
    recipe = Recipe((Part(clip.number, 0, frames, clip.mirrored),), turn=turn, sharp=sharp)
    contents = (clip.record.contents[0], "circle" if half_turns == 2.0 else "turn")
    return _Made("bent", recipe, frames, contents, tuple(dict.fromkeys(said)))


def _paced(pool: _Pool, chance: random.Random) -> _Made | None:
    clip = pool.pick(chance)
    if clip is None:
        return None
    speed = chance.choice(_PACES)
    stop = min(clip.record.frames, int(MAX_FRAMES * speed))
    if stop < 0.9 * clip.record.frames:
        return None
    recipe = Recipe((Part(clip.number, 0, stop, clip.mirrored),), speed=speed)
    return _Made("paced", recipe, max(2, round(stop / speed)), clip.record.contents, clip.sentences)


def _going_on(pool: _Pool, chance: random.Random) -> _Made | None:
    """Who goes straight ahead goes on for as long as a clip lasts: takes end with the room."""
    if not pool.gaits:
        return None
    clip, start, stop = chance.choice(pool.gaits)
    longer = stop - start - _BLEND
    count = (MAX_FRAMES - _BLEND) // longer
    recipe = Recipe((Part(clip.number, start, stop),) * count, blend=_BLEND)
    return _Made("going_on", recipe, count * longer + _BLEND, clip.record.contents, tuple(_ahead(clip)))


def _in_place(pool: _Pool, chance: random.Random) -> _Made | None:
    """Who walks or runs and gets nowhere, which hardly anybody was asked to do."""
    if not pool.gaits:
        return None
    clip, start, stop = chance.choice(pool.gaits)
    longer = stop - start - _BLEND
    count = chance.randint(1, (MAX_FRAMES - _BLEND) // longer)
    told = [sentence.rstrip(". ") for sentence in _ahead(clip) if not _ONWARD.search(sentence)]
    wordings = SPOT if all(len(sentence.split()) <= _PLAIN for sentence in clip.sentences) else HOW[SPOT]
    frames = count * longer + _BLEND
    if frames < _LEAST or (wordings != SPOT and not told):
        return None
    verb = clip.record.contents[0]
    forms = {"v": inflect(verb, "present"), "g": inflect(verb, "ing")}
    said = (
        w.format(s=chance.choice(SUBJECTS), a=chance.choice(told or [""]), **forms) for w in chance.sample(wordings, 3)
    )
    recipe = Recipe((Part(clip.number, start, stop),) * count, blend=_BLEND)
    return _Made("in_place", recipe, frames, clip.record.contents, tuple(dict.fromkeys(said)))


def _setting_off(pool: _Pool, chance: random.Random) -> _Made | None:
    """Who stands goes straight ahead and goes on: of takes that begin so, much is told it that still stands."""
    still = pool.pick(chance, lambda r: r.contents == (STANDING,) and r.frames <= 80)
    if still is None or not pool.gaits:
        return None
    gait, start, stop = chance.choice(pool.gaits)
    told = [sentence for s in _ahead(gait) if (sentence := without_person(s))]
    path = gait.motion.root[:, [0, 2]]
    leaves = int(((path - path[0]).norm(dim=1) > _LEFT).int().argmax())
    if not told or (found := _joined(still, gait, since=max(0, leaves - _SHORTEST))) is None:
        return None
    standing, going = found[0].parts
    once, longer = stop - going.start, stop - start - _BLEND
    frames = standing.stop + once - _BLEND
    if once < _SHORTEST or frames > MAX_FRAMES:
        return None
    count = (MAX_FRAMES - frames) // longer
    parts = (standing, Part(gait.number, going.start, stop), *(Part(gait.number, start, stop),) * count)
    said = (way.format(s=chance.choice(SUBJECTS), b=chance.choice(told).rstrip(". ")) for way in STARTS)
    contents = (STANDING, *gait.record.contents)
    return _Made("in_time", Recipe(parts, blend=_BLEND), frames + count * longer, contents, tuple(dict.fromkeys(said)))


def _rising(pool: _Pool, chance: random.Random) -> _Made | None:
    """Who rests low gets up and stands: sentences say so seldom, and then of much else, too."""
    if not pool.rises:
        return None
    clip, start, stop = chance.choice(pool.rises)
    still = pool.pick(chance, lambda r: r.contents == (STANDING,))
    if still is None or (found := _joined(clip, still, (start, stop))) is None:
        return None
    said = (way.format(s=chance.choice(SUBJECTS)) for way in chance.sample(UP, 3))
    return _Made("rising", *found, ("rise", STANDING), tuple(dict.fromkeys(said)))


def _ahead(clip: _Clip) -> list[str]:
    """Sentences of somebody who goes on and on."""
    return [told for told in clip.short() if not _ASIDE.search(told)]


_WAYS = {
    _then: 6, _stop: 3, _start: 1, _body: 1, _bent: 4, _paced: 4, _going_on: 4, _in_place: 3, _setting_off: 6,
    _rising: 4,
}  # fmt: skip
