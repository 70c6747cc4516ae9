"""Which compositions a corpus gets: thousands of recipes out of its takes, each within one split.

Every choice comes from a random generator seeded by a string, so that the same takes give the same recipes.
"""

import random
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Literal

import torch
from torch import Tensor

from moveset.data.augment import MAX_FRAMES
from moveset.data.captions import composed_captions, names_a_side, train_captions
from moveset.data.corpus import Corpus, CorpusWriter
from moveset.data.labels import mirror_label
from moveset.data.records import ClipRecord, Part, Recipe
from moveset.data.splits import Split
from moveset.motion import rotations
from moveset.motion.clip import Motion

#: Contents that travel and can be cut anywhere, and ones on the spot that have a beginning and an end.
TRAVELLING = ("walk", "run", "walk-turn-left", "walk-turn-right", "walk-back", "walk-left", "walk-right")
ON_THE_SPOT = (
    "wave-left-hand", "wave-right-hand", "wave-both-hands", "raise-up-left-hand", "raise-up-right-hand",
    "raise-up-both-hands", "bow", "bye", "byebye", "call", "respond", "guide", "punch", "kick", "slash",
)  # fmt: skip
#: What arms can do on walking legs, and which arms.
_ARMS: dict[str, Literal["left", "right", "both"]] = {
    "wave-left-hand": "left",
    "wave-right-hand": "right",
    "wave-both-hands": "both",
    "raise-up-left-hand": "left",
    "raise-up-right-hand": "right",
    "raise-up-both-hands": "both",
    "bye": "right",
    "byebye": "both",
    "respond": "left",
    "drink": "both",
}
_LEGS = ("walk", "walk", "walk", "run", "run", "walk-turn-left", "walk-turn-right", "walk-back")
#: How much more often than others a content is chosen: what people ask for, and what has takes enough to vary.
_OFTEN = {"walk": 4, "run": 3, "walk-turn-left": 2, "walk-turn-right": 2} | {
    c: 3 for c in ON_THE_SPOT if c.startswith(("wave", "raise"))
}
_KNOWN = {(content,) for content in (*TRAVELLING, *ON_THE_SPOT, *_ARMS, *_LEGS)}
_SPLITS: tuple[Split, ...] = ("train", "val", "test")
_BLEND = 12
_SHORTEST = 24
#: What may go on for as long as it is asked for. Raising a hand or bowing again and again would be another action.
ENDLESS = (
    *(content for content in TRAVELLING if "turn" not in content), "wave-left-hand", "wave-right-hand",
    "wave-both-hands", "bye", "byebye",
)  # fmt: skip
#: Frames of a clip in which one action goes on, and how many parts it may have.
_GOES_ON = (80, MAX_FRAMES)
_MOST_PARTS = 6


@dataclass(frozen=True, eq=False)
class _Clip:
    """A stored take, possibly to be used mirrored."""

    number: int
    record: ClipRecord
    motion: Motion
    content: str
    mirrored: bool


class _Pool:
    """The takes of one split by content, mirrored ones included."""

    def __init__(self, records: Iterable[ClipRecord], motions: Iterable[Motion], split: Split) -> None:
        self.by_content: dict[str, list[_Clip]] = defaultdict(list)
        self._poses: dict[tuple[int, bool], Tensor] = {}
        for number, (record, motion) in enumerate(zip(records, motions, strict=False)):
            if record.split != split or record.frames < _SHORTEST or record.contents[:1] not in _KNOWN:
                continue
            for mirrored in (False, True):
                content = mirror_label(record.contents[0]) if mirrored else record.contents[0]
                if mirrored and content == record.contents[0] and names_a_side(content):
                    continue  # mirrored, a "bye" is done by the other hand than its sentences say
                self.by_content[content].append(_Clip(number, record, motion, content, mirrored))

    def pick(self, content: str, style: str | None, chance: random.Random) -> _Clip:
        """A clip of a content, preferably of a style."""
        clips = self.by_content[content]
        same = [c for c in clips if c.record.style == style]
        return chance.choice(same if same and style is not None else clips)

    def poses(self, clip: _Clip) -> Tensor:
        """(F - 1, D) poses and velocities in the body's own heading, metres and 0.2 m/s, to compare places to cut."""
        key = (clip.number, clip.mirrored)
        if key not in self._poses:
            motion = clip.motion.mirrored() if clip.mirrored else clip.motion
            facing = rotations.inv(rotations.heading(motion.rotations[:, 0]))[:, None]
            feet = motion.joints[:, [*motion.skeleton.feet, 15, 20, 21]]
            place = rotations.rotate(facing, feet - motion.root[:, None] * torch.tensor((1.0, 0.0, 1.0)))
            speed = rotations.rotate(facing[:-1], feet[1:] - feet[:-1]) * motion.fps * 0.2
            self._poses[key] = torch.cat((place[:-1], speed), dim=1).flatten(1)
        return self._poses[key]


def add_compositions(writer: CorpusWriter, train: int = 3000, seed: int = 0, *, progress: bool = False) -> int:
    """Add about ``train`` training compositions, and in proportion ones for validation and test; returns how many."""
    from tqdm import tqdm

    pools, wanted = _pools(writer), _in_proportion(writer, train)
    added = 0
    with tqdm(total=sum(wanted.values()), desc="compositions", unit="", disable=not progress) as bar:
        for split in wanted:
            chance = random.Random(f"compositions of {split}, seed {seed}")
            seen: set[Recipe] = set()
            for attempt in range(6 * wanted[split]):
                if len(seen) == wanted[split]:
                    break
                made = _in_time(pools[split], chance) if attempt % 5 < 3 else _body(pools[split], chance)
                if made is None or made[1] in seen:
                    continue
                seen.add(made[1])
                _add(writer, split, len(seen), *made)
                bar.update()
            added += len(seen)
    return added


def add_continuations(writer: CorpusWriter, train: int, seed: int = 0) -> int:
    """Add ``train`` training clips in which one action goes on and on, and in proportion ones for validation and test.

    Few takes last as long as a clip may be asked to; these do, and are told by the sentences of their one content, one
    of ``ENDLESS``, drawn by the root of its number of takes. Returns how many were added.
    """
    pools, wanted = _pools(writer), _in_proportion(writer, train)
    added = 0
    for split in wanted:
        pool, chance = pools[split], random.Random(f"going on in {split}, seed {seed}")
        contents, weights = _by_takes(pool, ENDLESS)
        made: set[tuple[Part, ...]] = set()
        for _ in range(6 * wanted[split] if contents else 0):
            if len(made) == wanted[split]:
                break
            content = chance.choices(contents, weights)[0]
            clips, parts = _goes_on(pool, content, chance)
            if len(parts) < 2 or parts in made:
                continue
            made.add(parts)
            style = clips[0].record.style if len({clip.record.style for clip in clips}) == 1 else None
            frames = sum(part.stop - part.start for part in parts) - _BLEND * (len(parts) - 1)
            record = _record(
                writer, split, f"going_on_{split}_{len(made):04d}", "in_time", Recipe(parts, blend=_BLEND), frames,
                (content,), style,
            )  # fmt: skip
            writer.add_clip(record, train_captions(content, style))
        added += len(made)
    return added


def _pools(writer: CorpusWriter) -> dict[Split, _Pool]:
    records = [record for record in writer.records if record.kind == "take"]
    return {split: _Pool(records, [writer.motion(record) for record in records], split) for split in _SPLITS}


def _in_proportion(writer: CorpusWriter, train: int) -> dict[Split, int]:
    """As many for validation and test, of those for training, as there are takes."""
    takes = {split: sum(r.split == split and r.kind == "take" for r in writer.records) for split in _SPLITS}
    return {split: round(train * takes[split] / max(takes["train"], 1)) for split in _SPLITS}


def _add(
    writer: CorpusWriter, split: Split, number: int, kind: Literal["in_time", "body"], recipe: Recipe, frames: int,
    contents: tuple[str, str], style: str | None,
) -> None:  # fmt: skip
    name = f"{kind}_{split}_{number:04d}"
    record = _record(writer, split, name, kind, recipe, frames, contents, style)
    writer.add_clip(record, composed_captions(kind, contents, name))


def _record(
    writer: CorpusWriter, split: Split, name: str, kind: Literal["in_time", "body"], recipe: Recipe, frames: int,
    contents: tuple[str, ...], style: str | None,
) -> ClipRecord:  # fmt: skip
    first = writer.records[recipe.parts[0].clip]
    return ClipRecord(
        name=name,
        take=first.take,
        source="composed",
        subject=first.subject,
        group=first.group,
        kind=kind,
        contents=contents,
        style=style,
        split=split,
        fps=first.fps,
        frames=frames,
        captions=(),
        recipe=recipe,
    )


_Made = tuple[Literal["in_time", "body"], Recipe, int, tuple[str, str], str | None]


def _common_style(a: _Clip, b: _Clip) -> str | None:
    return a.record.style if a.record.style == b.record.style else None


def _available(pool: _Pool, contents: Sequence[str]) -> list[str]:
    return [c for c in contents if pool.by_content.get(c)]


def _in_time(pool: _Pool, chance: random.Random) -> _Made | None:
    travelling, spot = _available(pool, TRAVELLING), _available(pool, ON_THE_SPOT)
    kinds = chance.choices(("ts", "st", "tt", "ss"), (40, 25, 20, 15))[0]
    choices = [{"t": travelling, "s": spot}[k] for k in kinds]
    if not all(choices):
        return None
    first, second = (chance.choices(c, [_OFTEN.get(x, 1) for x in c])[0] for c in choices)
    return None if first == second else _sequence(pool, first, second, chance)


def _sequence(pool: _Pool, first: str, second: str, chance: random.Random) -> _Made | None:
    contents = (first, second)
    a = pool.pick(contents[0], None, chance)
    b = pool.pick(contents[1], a.record.style if chance.random() < 0.7 else None, chance)
    # Cuts: what travels may be cut anywhere, but a turn keeps all of itself; what is on the spot keeps its beginning,
    # and as a first part its end too, so that its action is over when the next begins.
    free_a, free_b = (c in TRAVELLING and "turn" not in c for c in contents)
    room_a, room_b = chance.randint(32, 110), chance.randint(40, 110)
    stops = range(min(room_a, a.record.frames) if free_a else a.record.frames, a.record.frames + 1)
    starts = range(max(1, b.record.frames - room_b + 1)) if free_b else range(1)
    a_stop, b_start, _ = _best_seam(pool.poses(a), pool.poses(b), stops, starts)
    a_start = max(0, a_stop - room_a) if free_a else 0
    b_stop = min(b.record.frames, b_start + MAX_FRAMES + _BLEND - (a_stop - a_start))
    if free_b:
        b_stop = min(b_stop, b_start + room_b)
    needed = 0.0 if free_b else 0.95 if contents[1] in TRAVELLING else 0.7
    if b_stop - b_start < max(needed * (b.record.frames - b_start), _BLEND + 12) or a_stop - a_start < _BLEND + 12:
        return None
    parts = (Part(a.number, a_start, a_stop, a.mirrored), Part(b.number, b_start, b_stop, b.mirrored))
    frames = a_stop - a_start + b_stop - b_start - _BLEND
    return "in_time", Recipe(parts, blend=_BLEND), frames, contents, _common_style(a, b)


def _corpus_pool(corpus: Corpus, split: Split) -> _Pool:
    takes = [record for record in corpus.records if record.kind == "take"]
    return _Pool(takes, (corpus.motion(k) for k in range(len(takes))), split)


def plan_continuations(corpus: Corpus, split: Split, count: int, seed: int = 0) -> list[tuple[str, Recipe]]:
    """``count`` recipes in which a content is followed by the same again, each with its content; all different.

    A stream goes on with one sentence for longer than any take lasts; no clip of the corpus shows what comes then.
    Contents are drawn by the root of their number of takes.
    """
    pool = _corpus_pool(corpus, split)
    contents, weights = _by_takes(pool, (*TRAVELLING, *ON_THE_SPOT))
    chance = random.Random(f"continuations of {split}, seed {seed}")
    made: dict[Recipe, str] = {}
    for _ in range(6 * count):
        if len(made) == count or not contents:
            break
        content = chance.choices(contents, weights)[0]
        planned = _sequence(pool, content, content, chance)
        if planned is not None:
            made.setdefault(planned[1], content)
    return [(content, recipe) for recipe, content in made.items()]


def _by_takes(pool: _Pool, contents: Sequence[str]) -> tuple[list[str], list[float]]:
    """Those of the contents that there are, with the root of their number of takes."""
    contents = _available(pool, contents)
    return contents, [len(pool.by_content[content]) ** 0.5 for content in contents]


def _goes_on(pool: _Pool, content: str, chance: random.Random) -> tuple[list[_Clip], tuple[Part, ...]]:
    """Takes of one content and, where it can be, of one style, and which frames of each follow each other.

    What travels is left and entered where it fits best, in the second half and the first, and keeps the end of its last
    take, in which people slow down, wherever there is room for it; anything else is whole.
    """
    free, wanted = content in TRAVELLING and "turn" not in content, chance.randint(*_GOES_ON)
    clips = [pool.pick(content, None, chance)]
    spans, frames = [[0, clips[0].record.frames]], clips[0].record.frames
    while frames < wanted and len(clips) < _MOST_PARTS:
        last, (start, stop) = clips[-1], spans[-1]
        # The next of three is the one that joins best.
        found = []
        for following in (pool.pick(content, clips[0].record.style, chance) for _ in range(3)):
            half = following.record.frames // 2
            stops = range(max(start + _BLEND + 12, (start + stop) // 2), stop + 1) if free else range(stop, stop + 1)
            starts = range(max(1, half - _BLEND - 12)) if free else range(1)
            seam = _best_seam(pool.poses(last), pool.poses(following), stops, starts)
            found.append((seam[2], len(found), seam, following))
        _, _, (a_stop, b_start, _), following = min(found)
        b_stop = following.record.frames
        total = frames - (stop - a_stop) + b_stop - b_start - _BLEND
        if free:
            b_stop -= max(0, total - MAX_FRAMES)
        elif total > MAX_FRAMES:
            break
        if b_stop - b_start < _BLEND + 12:
            break
        frames += a_stop - stop + b_stop - b_start - _BLEND
        spans[-1][1] = a_stop
        clips.append(following)
        spans.append([b_start, b_stop])
    parts = (Part(c.number, first, stop, c.mirrored) for c, (first, stop) in zip(clips, spans, strict=True))
    return clips, tuple(parts)


def plan_bodies(corpus: Corpus, split: Split, count: int, seed: int = 0) -> list[tuple[tuple[str, str], Recipe]]:
    """Up to ``count`` recipes by body part, each with its contents (arms, legs); all different.

    Pairs of contents take turns, so that what the corpus' own compositions have little of (turns, whose takes are
    seldom as long as what the arms do) comes as often as the rest, as far as its takes go.
    """
    pool = _corpus_pool(corpus, split)
    pairs = [
        (upper, legs)
        for legs in dict.fromkeys(_LEGS)
        for upper in _ARMS
        if _available(pool, (upper, legs)) == [upper, legs]
    ]
    chance = random.Random(f"bodies of {split}, seed {seed}")
    made: dict[Recipe, tuple[str, str]] = {}
    for pair in islice(cycle(pairs), count * len(pairs)):
        if len(made) == count:
            break
        tries = (_layered(pool, *pair, chance) for _ in range(6))
        new = next((planned[1] for planned in tries if planned is not None and planned[1] not in made), None)
        if new is not None:
            made[new] = pair
    return [(contents, recipe) for recipe, contents in made.items()]


def _best_seam(a: Tensor, b: Tensor, stops: range, starts: range) -> tuple[int, int, float]:
    """Where to leave ``a`` (one past its last frame) and enter ``b``, so that the overlap fades between like poses,
    and how unlike they are."""
    # The overlap is compared at its middle, where both count half.
    half = _BLEND // 2
    rows = torch.tensor(stops).sub(half).clamp(0, len(a) - 1)
    columns = torch.tensor(starts).add(half).clamp(0, len(b) - 1)
    apart = torch.cdist(a[rows], b[columns])
    best = int(apart.argmin())
    return stops[best // len(columns)], starts[best % len(columns)], float(apart.flatten()[best])


def _body(pool: _Pool, chance: random.Random) -> _Made | None:
    uppers, legs = _available(pool, tuple(_ARMS)), _available(pool, _LEGS)
    if not uppers or not legs:
        return None
    return _layered(pool, chance.choice(uppers), chance.choice(legs), chance)


def _layered(pool: _Pool, arms_do: str, legs_do: str, chance: random.Random) -> _Made | None:
    lower = pool.pick(legs_do, None, chance)
    upper = pool.pick(arms_do, lower.record.style if chance.random() < 0.5 else None, chance)
    whole = "turn" in legs_do
    # The arms keep their whole action where it fits; the legs give as many frames, sped up or slowed down by up to 1.3.
    wanted = round(min(upper.record.frames, MAX_FRAMES) / chance.uniform(0.85, 1.25))
    frames = lower.record.frames if whole else min(wanted, lower.record.frames, MAX_FRAMES)
    taken = min(upper.record.frames, round(frames * 1.3))
    if frames < 32 or frames > MAX_FRAMES or not 0.75 <= taken / frames <= 1.31:
        return None
    # A wave may be cut short, a raised arm must come up: both keep their beginning.
    at = chance.randint(0, lower.record.frames - frames)
    arms = _ARMS[arms_do]
    parts = (Part(upper.number, 0, taken, upper.mirrored), Part(lower.number, at, at + frames, lower.mirrored))
    return "body", Recipe(parts, arms=arms), frames, (arms_do, legs_do), _common_style(upper, lower)
