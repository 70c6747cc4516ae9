"""Circles, about-turns, degrees, no way at all: what sentences say of the way where a model was never told of that.

Captions of the shipped models turn left, turn right, and know no angle. So "walks in a circle" is told as "walks",
"turns around" as "turns to the left", "jogs in place" as "jogs", and the features are bent (``motion.steering``). What
does not say its side goes left. A model that has a caption of such words is told every sentence of the kind as it is.
"""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

from moveset.motion.steering import Circle, Stay, Steering, Turn
from moveset.pipelines.synonyms import BEFORE_VERBS, CLOCKWISE, TRAVELLING, Bend, Reading, in_known_words
from moveset.text.english import inflect, inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import words_of

_THE = r"(?:the|his|her|their|its|my|your|our)"
_CLOCK = "|".join(CLOCKWISE)
_LIMB = r"\s+(?:hand|arm|leg|foot|knee|elbow|shoulder|hip|side)s?\b"


def _side(name: str) -> str:
    """A pattern of "to the left", "clockwise" and the like, which may be missing."""
    to = rf"(?:(?:to|towards?)\s+(?:{_THE}\s+)?|turning\s+)?"
    return rf"(?:\s+(?P<{name}>{to}(?:left|right)(?:wards?)?|{_CLOCK})\b(?!{_LIMB}))?"


_TURNS = inflections("turn", "rotate", "pivot", "swivel")
_MAKES = inflections("make", "do", "take", "perform", "execute")
_LEAVES = inflections("head")
_SIZES = {"small": 0.8, "tight": 0.8, "little": 0.8, "big": 2.5, "large": 2.5, "wide": 2.5, "huge": 4.0}  # metres
_WORDS = {
    "forty-five": 45, "ninety": 90, "one hundred eighty": 180, "one hundred and eighty": 180,
    "a hundred and eighty": 180, "two hundred seventy": 270, "two hundred and seventy": 270,
    "three hundred sixty": 360, "three hundred and sixty": 360,
}  # fmt: skip
_KINDS = {
    "u-turn": 180, "u turn": 180, "about-face": 180, "about face": 180, "about-turn": 180, "about turn": 180,
    "half turn": 180, "half-turn": 180, "quarter turn": 90, "quarter-turn": 90, "full turn": 360,
}  # fmt: skip
_DEGREES = rf"(?P<degrees>\d{{1,3}}|{'|'.join(_WORDS)})(?:\s*°|[\s-]*degrees?\b)"
_ADJECTIVES = rf"an?|one|the|full|complete|whole|perfect|slow|left|right|{_CLOCK}|{'|'.join(_SIZES)}"

_CIRCLE = re.compile(
    rf"{_side('before')}\s+(?P<where>(?:(?:around|round|about)\s+)?(?:in|on|along)\s+)?(?P<adjectives>(?:(?:{_ADJECTIVES})\s+)*)"
    rf"circle(?P<several>s)?\b(?!\s+of\b){_side('after')}",
    re.I,
)
_IN_PLACE = re.compile(r"\s+(?:in\s+(?:one\s+)?place|on\s+the\s+spot)\b", re.I)
_HEADS = re.compile(rf"\b(?P<verb>{'|'.join(_LEAVES)})(?:\s+(?:off|out|over|away))?{_side('after')[:-1]}", re.I)
# What an angle or "around" belongs to; "turns around the corner" and "turns around his hand" are other things.
_AROUND = re.compile(
    rf"\b(?P<verb>{'|'.join(_TURNS)})(?:\s+(?:all\s+the\s+way|completely|fully|quickly|slowly|right))?\s+a?round\b"
    rf"(?!\s+(?:{_THE}|an?|in|and\s+a?round|this|that|\w+sel(?:f|ves)|again|twice|\w+\s+times)\b){_side('after')}",
    re.I,
)
_BY_DEGREES = re.compile(
    rf"\b(?P<verb>{'|'.join(_TURNS)}){_side('before')}(?:\s+by)?\s+{_DEGREES}(?:\s+around)?{_side('after')}", re.I
)
_MADE = re.compile(
    rf"\b(?P<verb>{'|'.join(_MAKES)})\s+an?\s+(?:(?P<before>left|right)\s+)?"
    rf"(?:(?P<kind>{'|'.join(_KINDS)})|{_DEGREES}\s+(?:(?P<between>left|right)\s+)?turn)\b{_side('after')}",
    re.I,
)
_PLAIN = re.compile(
    rf"\b(?:(?:{'|'.join(inflections('turn', 'veer', 'swerve', 'curve', 'pivot', 'rotate', 'swivel', 'go'))})"
    rf"\s+(?:(?:to|towards?)\s+(?:{_THE}\s+)?)?|(?:{'|'.join(_MAKES)})\s+an?\s+)(?P<side>left|right)\b(?!{_LIMB})"
    r"(?!\s+(?:ahead|to|up|down|back|through|on|into|away|by|over)\b)",  # which "right" may belong to
    re.I,
)
_ON_AND_ON = re.compile(r"\b(?:keep\w*|kept|continu\w*|again|over|times|constantly|forever|always)\b", re.I)
_GOES_BACK = re.compile(rf"\b(?P<goes>{'|'.join(sorted(TRAVELLING))})\s+back\b(?!\s+and\s+forth)", re.I)
_CLAUSE = re.compile(r"[,.;:!?]|\b(?:then|while|before|after)\b", re.I)
_OBJECTS = frozenset(words_of("a an the his her their its my your our it him them"))
_LIMBS = frozenset(words_of(
    "hand hands arm arms leg legs foot feet knee knees elbow elbows head hips hip wrist wrists shoulder shoulders"
))  # fmt: skip
_USUAL = 90  # degrees of a plain turn; takes of them end at 91
_MOST = 720  # degrees: nobody turns further in a clip
_Plain = tuple[str, Steering]  # a sentence without its turn, and the turn


def read(sentence: str, known: KnownPrompts) -> Reading:
    """A sentence as a model is told it: in words that it knows, and without turns of which it was never told.

    Args:
        sentence: what a person does.
        known: what the model was trained on; if nobody wrote its words down, every sentence is told as it is.
    """
    if known.words:
        for pattern, said in _PATTERNS.items():
            for found in pattern.finditer(sentence):
                if (plain := said(found, sentence, known)) and not _says(known, pattern):
                    text, steering = plain
                    return replace(in_known_words(text, known), bent=Bend(found[0].strip(), steering))
    return in_known_words(sentence, known)


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
    if _says(known, _BY_DEGREES) or _says(known, _AROUND):
        return None
    return Turn(_sign(found[0]["side"]) * math.radians(_USUAL))


def _since_going(text: str, known: KnownPrompts) -> list[str] | None:
    """The words after the one that says that somebody is on his way, in the last clause of this; None if none does.

    Whoever moves a hand, or runs a finger, goes nowhere by that.
    """
    clause = words_of(in_known_words(_CLAUSE.split(text)[-1], known).text)
    verbs = [k for k, word in enumerate(clause) if word in TRAVELLING]
    if not verbs or _LIMBS.intersection(clause):
        return None
    since = clause[verbs[-1] + 1 :]
    return None if _OBJECTS.intersection(since[:1]) else since


def _in_place(found: re.Match[str], text: str, known: KnownPrompts) -> _Plain | None:
    since = _since_going(text[: found.start()], known)
    if since is None or _OBJECTS.intersection(since):  # which may be what is put in its place
        return None
    return text[: found.start()] + text[found.end() :], Stay()


def _in_a_circle(found: re.Match[str], text: str, known: KnownPrompts) -> _Plain | None:
    since = _since_going(text[: found.start()], known)
    if since is None or (since and not found["where"]):
        return None
    adjectives = words_of(found["adjectives"])
    side = _sign(found["before"], found["after"], *adjectives)
    sizes = [_SIZES[word] for word in adjectives if word in _SIZES]
    circle = Circle(side, not found["several"], *sizes[:1])
    return text[: found.start()] + text[found.end() :], circle


def _around(found: re.Match[str], text: str, _: KnownPrompts) -> _Plain:
    return _turned(found, text, _TURNS, 180, found["after"])


def _heads(found: re.Match[str], text: str, _: KnownPrompts) -> _Plain | None:
    *_, before = "", *words_of(_CLAUSE.split(text[: found.start()])[-1])
    if found["verb"].lower() == "head" and before not in BEFORE_VERBS:
        return None  # what a body has on its neck
    return _turned(found, text, _LEAVES, _USUAL, found["after"])


def _by_degrees(found: re.Match[str], text: str, _: KnownPrompts) -> _Plain | None:
    degrees = _count(found["degrees"])
    return _turned(found, text, _TURNS, degrees, found["before"], found["after"]) if 1 <= degrees <= _MOST else None


def _made(found: re.Match[str], text: str, _: KnownPrompts) -> _Plain | None:
    degrees = _KINDS[found["kind"].lower()] if found["kind"] else _count(found["degrees"])
    sides = found["before"], found["between"], found["after"]
    return _turned(found, text, _MAKES, degrees, *sides) if 1 <= degrees <= _MOST else None


def _turned(found: re.Match[str], text: str, verbs: dict[str, str], degrees: int, *sides: str | None) -> _Plain:
    """The sentence with a plain turn, and by how much it turns."""
    sign = _sign(*sides)
    verb = inflect("turn", verbs[found["verb"].lower()])
    verb = verb.capitalize() if found["verb"][0].isupper() else verb
    after = text[found.end() :]
    if degrees >= 135:  # whoever turned around and walks back walks forward
        after = _GOES_BACK.sub(lambda m: m["goes"], after)
    turn = f"{verb} to the {'left' if sign > 0 else 'right'}"
    return text[: found.start()] + turn + after, Turn(sign * math.radians(degrees))


def _sign(*said: str | None) -> int:
    words = [word for side in said if side for word in words_of(side)]
    return -1 if any(CLOCKWISE.get(word, word) in ("right", "rightward", "rightwards") for word in words) else 1


def _count(degrees: str) -> int:
    return int(degrees) if degrees.isdigit() else _WORDS[" ".join(degrees.lower().split())]


_PATTERNS: dict[re.Pattern[str], Callable[[re.Match[str], str, KnownPrompts], _Plain | None]] = {
    _BY_DEGREES: _by_degrees,
    _MADE: _made,
    _AROUND: _around,
    _CIRCLE: _in_a_circle,
    _HEADS: _heads,
    _IN_PLACE: _in_place,
}


@lru_cache(maxsize=64)
def _says(known: KnownPrompts, pattern: re.Pattern[str]) -> bool:
    """Whether a caption of the training says something of the kind."""
    said = _PATTERNS[pattern]
    return any(said(found, sentence, known) for sentence in known.sentences for found in pattern.finditer(sentence))
