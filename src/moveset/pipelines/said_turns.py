"""About-turns and degrees: what sentences say of turns where a model was never told how far they go.

Captions of the shipped models turn left, turn right, and know no angle. So "turns around" is told as "turns to the
left". What does not say its side goes left.
"""

import math
import re

from moveset.motion.steering import Turn
from moveset.motion.way import side_of
from moveset.pipelines.said import CLAUSE, NO_LIMB, THE, Plain, Said, side, sign, told_of
from moveset.pipelines.synonyms import BEFORE_VERBS, TRAVELLING
from moveset.text.english import inflect, inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import words_of

#: In every form, what people do who turn.
TURN_FORMS = inflections("turn", "rotate", "pivot", "swivel")
_MAKES = inflections("make", "do", "take", "perform", "execute")
_LEAVES = inflections("head")
_WORDS = {
    "forty-five": 45, "ninety": 90, "one hundred eighty": 180, "one hundred and eighty": 180,
    "a hundred and eighty": 180, "two hundred seventy": 270, "two hundred and seventy": 270,
    "three hundred sixty": 360, "three hundred and sixty": 360,
}  # fmt: skip
_KINDS = {
    "u-turn": 180, "u turn": 180, "about-face": 180, "about face": 180, "about-turn": 180, "about turn": 180,
    "half turn": 180, "half-turn": 180, "quarter turn": 90, "quarter-turn": 90, "full turn": 360,
}  # fmt: skip
#: A pattern of "45 degrees" and the like; the group "degrees".
DEGREES = rf"(?P<degrees>\d{{1,3}}|{'|'.join(_WORDS)})(?:\s*°|[\s-]*degrees?\b)"
_HEADS = re.compile(rf"\b(?P<verb>{'|'.join(_LEAVES)})(?:\s+(?:off|out|over|away))?{side('after')[:-1]}", re.I)
# What an angle or "around" belongs to; "turns around the corner" and "turns around his hand" are other things.
_AROUND = re.compile(
    rf"\b(?P<verb>{'|'.join(TURN_FORMS)})(?:\s+(?:all\s+the\s+way|completely|fully|quickly|slowly|right))?\s+a?round\b"
    rf"(?!\s+(?:{THE}|an?|in|and\s+a?round|this|that|\w+sel(?:f|ves)|again|twice|\w+\s+times)\b){side('after')}",
    re.I,
)
_BYDEGREES = re.compile(
    rf"\b(?P<verb>{'|'.join(TURN_FORMS)}){side('before')}(?:\s+by)?\s+{DEGREES}(?:\s+around)?{side('after')}", re.I
)
_MADE = re.compile(
    rf"\b(?P<verb>{'|'.join(_MAKES)})\s+an?\s+(?:(?P<before>left|right)\s+)?"
    rf"(?:(?P<kind>{'|'.join(_KINDS)})|{DEGREES}\s+(?:(?P<between>left|right)\s+)?turn)\b{side('after')}",
    re.I,
)
_PLAIN = re.compile(
    rf"\b(?:(?:{'|'.join(inflections('turn', 'veer', 'swerve', 'curve', 'pivot', 'rotate', 'swivel', 'go'))})"
    rf"\s+(?:(?:to|towards?)\s+(?:{THE}\s+)?)?|(?:{'|'.join(_MAKES)})\s+an?\s+)(?P<side>left|right)\b{NO_LIMB}"
    r"(?!\s+(?:ahead|to|up|down|back|through|on|into|away|by|over)\b)",  # which "right" may belong to
    re.I,
)
_ON_AND_ON = re.compile(r"\b(?:keep\w*|kept|continu\w*|again|over|times|constantly|forever|always)\b", re.I)
_GOES_BACK = re.compile(rf"\b(?P<goes>{'|'.join(sorted(TRAVELLING))})\s+back\b(?!\s+and\s+forth)", re.I)
_USUAL = 90  # degrees of a plain turn; takes of them end at 91
_MOST = 720  # degrees: nobody turns further in a clip


def plain_turn(sentence: str, known: KnownPrompts) -> Turn | None:
    """How far a sentence turns that names nothing but the side, in a motion that ends nowhere; None of others.

    A stream that is told to turn does so, but ends at twice the angle of takes as often as not. One that was told of
    angles is left alone.

    Args:
        sentence: as the model is told it.
        known: what the model was trained on.
    """
    found = list(_PLAIN.finditer(sentence))
    if len(found) != 1 or _ON_AND_ON.search(sentence) or not known.words:
        return None
    if told_of(known, _BYDEGREES, _by_degrees) or told_of(known, _AROUND, _around):
        return None
    return Turn(sign(found[0]["side"]) * math.radians(_USUAL))


def _around(found: re.Match[str], text: str, _: KnownPrompts) -> Plain:
    return _turned(found, text, TURN_FORMS, 180, found["after"])


def _heads(found: re.Match[str], text: str, _: KnownPrompts) -> Plain | None:
    *_, before = "", *words_of(CLAUSE.split(text[: found.start()])[-1])
    if found["verb"].lower() == "head" and before not in BEFORE_VERBS:
        return None  # what a body has on its neck
    return _turned(found, text, _LEAVES, _USUAL, found["after"])


def _by_degrees(found: re.Match[str], text: str, _: KnownPrompts) -> Plain | None:
    degrees = count_of(found["degrees"])
    return _turned(found, text, TURN_FORMS, degrees, found["before"], found["after"]) if 1 <= degrees <= _MOST else None


def _made(found: re.Match[str], text: str, _: KnownPrompts) -> Plain | None:
    degrees = _KINDS[found["kind"].lower()] if found["kind"] else count_of(found["degrees"])
    sides = found["before"], found["between"], found["after"]
    return _turned(found, text, _MAKES, degrees, *sides) if 1 <= degrees <= _MOST else None


def _turned(found: re.Match[str], text: str, verbs: dict[str, str], degrees: int, *sides: str | None) -> Plain:
    """The sentence with a plain turn, and by how much it turns."""
    to = sign(*sides)
    verb = inflect("turn", verbs[found["verb"].lower()])
    verb = verb.capitalize() if found["verb"][0].isupper() else verb
    after = text[found.end() :]
    if degrees >= 135:  # whoever turned around and walks back walks forward
        after = _GOES_BACK.sub(lambda m: m["goes"], after)
    turn = f"{verb} to the {side_of(to)}"
    return text[: found.start()] + turn + after, Turn(to * math.radians(degrees))


def count_of(degrees: str) -> int:
    """The number that ``DEGREES`` found."""
    return int(degrees) if degrees.isdigit() else _WORDS[" ".join(degrees.lower().split())]


TURNS: dict[re.Pattern[str], Said] = {
    _BYDEGREES: _by_degrees,
    _MADE: _made,
    _AROUND: _around,
    _HEADS: _heads,
}
