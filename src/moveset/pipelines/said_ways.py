"""Circles, squares, figures of eight, zigzags, back and forth, in place: ways that captions do not tell of.

Each is taken out of the sentence ("walks in a circle" is told as "walks"). What does not say its side goes left.
"""

import math
import re

from moveset.motion.corners import Corners, FigureEight
from moveset.motion.steering import Circle, During, Stay, Steering
from moveset.pipelines.said import ON_THE_SPOT, THE, Plain, Said, names_object, side, sign, since_going
from moveset.pipelines.synonyms import BEFORE_VERBS, CLOCKWISE
from moveset.text.english import inflect
from moveset.text.familiarity import KnownPrompts
from moveset.text.stages import split_stages
from moveset.text.vocabulary import words_of

_SIZES = {"small": 0.8, "tight": 0.8, "little": 0.8, "big": 2.5, "large": 2.5, "wide": 2.5, "huge": 4.0}  # metres
_CORNERS = {"square": 4, "rectangle": 4, "triangle": 3, "pentagon": 5, "hexagon": 6}
_ADJECTIVES = (
    rf"(?P<adjectives>(?:(?:an?|one|the|full|complete|whole|perfect|slow|left|right|{'|'.join(CLOCKWISE)}"
    rf"|{'|'.join(_SIZES)})\s+)*)"
)
_WHERE = r"(?P<where>(?:(?:around|round|about)\s+)?(?:in|on|along)\s+)?"
_SHAPE = r"(?:[\s-]+(?:shaped?|pattern|path|line|course|way|fashion|manner))*"
_CIRCLE = re.compile(
    rf"{side('before')}\s+{_WHERE}{_ADJECTIVES}circle(?P<several>s)?\b(?!\s+of\b){side('after')}", re.I
)
_POLYGON = re.compile(
    rf"{side('before')}\s+(?:(?:around|round|about)\s+)?(?:in|along)\s+{_ADJECTIVES}"
    rf"(?P<shape>{'|'.join(_CORNERS)})s?{_SHAPE}\b(?!\s+of\b){side('after')}",
    re.I,
)
_EIGHT = re.compile(
    rf"{side('before')}\s+{_WHERE}{_ADJECTIVES}figures?[\s-]+(?:of[\s-]+)?(?:eights?|8s?){_SHAPE}\b{side('after')}",
    re.I,
)
_ZIGZAG = re.compile(
    rf"\s+(?:in\s+{_ADJECTIVES})?(?:zig-?\s?zag(?:s|ging)?|serpentines?|s[\s-](?:shapes?|curves?)){_SHAPE}\b", re.I
)
_ZIGZAGS = {"zigzags": "present", "zigzagging": "ing", "zigzagged": "past", "zigzag": "base"}
_WHO_ZIGZAGS = re.compile(r"\b(?P<verb>zig-?zag(?:s|ging|ged)?)\b", re.I)
_TO_AND_FRO = re.compile(
    r"\s+(?:back\s+and\s+forth|to\s+and\s+fro|backwards?\s+and\s+forwards?(?=\s+(?:between|across))"
    rf"|up\s+and\s+down\s+{THE}\s+(?:room|hall|hallway|corridor|street|path|aisle|floor))\b{side('after')}",
    re.I,
)
_IN_PLACE = re.compile(rf"\s+{ON_THE_SPOT}\b", re.I)


def ways_of(text: str, known: KnownPrompts) -> int:
    """How many stages of this somebody is on his way in."""
    return sum(since_going(stage, known) is not None for stage in split_stages(text))


def _without(found: re.Match[str], text: str, steering: Steering, known: KnownPrompts) -> Plain:
    """The sentence without what was found. Of several ways, one after the other, it is one."""
    plain = text[: found.start()] + text[found.end() :]
    before, ways = ways_of(text[: found.start()], known), ways_of(plain, known)
    if ways > 1 and before:
        steering = During(steering, (before - 1) / ways, before / ways)
    return plain, steering


def _size(adjectives: str) -> list[float]:
    return [_SIZES[word] for word in words_of(adjectives) if word in _SIZES][:1]


def _in_a_circle(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    since = since_going(text[: found.start()], known)
    if since is None or (since and not found["where"]):
        return None
    to = sign(found["before"], found["after"], found["adjectives"])
    return _without(found, text, Circle(to, not found["several"], *_size(found["adjectives"])), known)


def _round_corners(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    if since_going(text[: found.start()], known) is None:
        return None
    legs = _CORNERS[found["shape"].lower()]
    to = sign(found["before"], found["after"], found["adjectives"])
    leg = [1.5 * size for size in _size(found["adjectives"])]
    return _without(found, text, Corners(to, 2.0 * math.pi / legs, legs, *leg), known)


def _in_an_eight(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    since = since_going(text[: found.start()], known)
    if since is None or (since and not found["where"]):
        return None
    to = sign(found["before"], found["after"])
    return _without(found, text, FigureEight(to, *_size(found["adjectives"])), known)


def _in_a_zigzag(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    if since_going(text[: found.start()], known) is None:
        return None
    return _without(found, text, ZIGZAG, known)


def _zigzags(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    form = _ZIGZAGS[found["verb"].lower().replace("-", "")]
    *_, before = "", *words_of(text[: found.start()])
    if form == "base" and before not in BEFORE_VERBS:
        return None
    verb = inflect("walk", form)
    verb = verb.capitalize() if found["verb"][0].isupper() else verb
    return text[: found.start()] + verb + text[found.end() :], ZIGZAG


def _to_and_fro(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    since = since_going(text[: found.start()], known)
    if since is None or names_object(since):  # which may be what is moved to and fro
        return None
    return _without(found, text, Corners(sign(found["after"]), math.pi, 2, 3.0), known)


def _in_place(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    since = since_going(text[: found.start()], known)
    if since is None or names_object(since):  # which may be what is put in its place
        return None
    return _without(found, text, Stay(), known)


#: However it is said; a zigzag has no size.
ZIGZAG = Corners(1, math.pi / 2, 1, 1.0, zigzag=True)
WAYS: dict[re.Pattern[str], Said] = {
    _CIRCLE: _in_a_circle,
    _POLYGON: _round_corners,
    _EIGHT: _in_an_eight,
    _ZIGZAG: _in_a_zigzag,
    _WHO_ZIGZAGS: _zigzags,
    _TO_AND_FRO: _to_and_fro,
    _IN_PLACE: _in_place,
}
