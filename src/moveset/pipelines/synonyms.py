"""Everyday words that a model was never trained on, read as words that it was: whoever saunters strolls.

Words of the held-out phrases are kept from every training caption, so that what unknown words do can be measured
(``data.held_out_phrases``), and some of them are said every day; a few others never were in any phrase ("clockwise").
Only what means the same *motion* is here: nobody who crawls should walk. A word is read otherwise only by a model that
does not know it and knows the other.
"""

import re
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

from moveset.motion.steering import Steering, Together
from moveset.pipelines.model_folder import ModelFolder
from moveset.text.english import FORMS, article, inflect, inflect_marked, inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread, words_of

#: What verbs are read as; brackets mark what is inflected as they are.
_VERBS = {
    "[stroll]": "amble saunter mosey",
    "[walk]": "march advance",
    "[walk] toward": "approach",
    "[walk] into": "enter",
    "[go]": "proceed travel",
    "[walk] slowly": "creep sneak",
    "[trudge]": "plod traipse",
    "[toddle]": "waddle totter",
    "[walk] fast": "hurry hasten",
    "[walk] around": "wander roam rove",
    "[sidle]": "drift",
    "[back] away": "retreat",
    "[walk] backwards": "backpedal",
    "[turn]": "veer",
    "[jog]": "trot",
    "[scamper]": "scurry scuttle",
    "[run] away": "flee",
    "[sprint]": "bolt charge zoom hurtle",
    "[leap]": "spring",
    "[wag]": "flap",
    "[escort]": "usher",
    "[yell]": "scream shriek bellow",
    "[dance]": "groove boogie jive",
    "[twirl] on tiptoe": "pirouette",
    "[punch]": "jab",
    "[strut]": "sashay",
    "[fence]": "duel",
    "[shower]": "bathe",
    "[wash]": "rinse",
    "[soap]": "lather",
    "[chuckle]": "giggle",
    "[laugh]": "guffaw",
    "[drink]": "gulp swig guzzle",
}
_NOUNS = {
    "sword": "katana",
    "enemy": "opponent",
    "grandmother": "grandma",
    "grandfather": "grandpa",
    "old man": "geezer",
    "old person": "pensioner",
    "baby": "infant",
    "giant": "ogre behemoth",
    "gangster": "hoodlum",
    "exercise": "workout",
    "angle": "slant",
    "turn": "detour",
}
_PLURALS = {"old man": "old men", "old person": "old people"}
_OTHERS = {
    "left": "leftward leftwards",
    "right": "rightward rightwards",
    # "Round" itself is mostly a preposition.
    "walks around": "rounds",
    "walking around": "rounding",
    "walked around": "rounded",
    "salsa": "latin",
    "steps": "footwork",
    "hello": "hi",
    "goodbye": "adios",
    "quick": "speedy",
    "quickly": "speedily hurriedly hastily",
    "slow": "sluggish unhurried",
    "slowly": "unhurriedly sluggishly lazily",
    "wildly": "frantically",
    "energetically": "enthusiastically",
    "lively": "peppy",
    "happy": "joyous elated ecstatic jolly jovial",
    "joyfully": "joyously gleefully",
    "sad": "upset",
    "sadly": "glumly",
    "angry": "enraged outraged irritated annoyed",
    "angrily": "grumpily irritably",
    "proud": "haughty smug boastful",
    "proudly": "haughtily",
    "shy": "bashful",
    "shyly": "bashfully",
    "timid": "fearful",
    "timidly": "fearfully",
    "exhausted": "drained lethargic",
    "sleepily": "drowsily lethargically",
    "muscular": "burly brawny",
    "masculine": "macho",
    "girlish": "girly",
    "polite": "respectful",
    "politely": "respectfully",
}
#: Other spellings and forms of these.
_VARIANTS = {
    "travelling": "traveling", "travelled": "traveled", "backpedalling": "backpedaling",
    "backpedalled": "backpedaled", "duelling": "dueling", "duelled": "dueled", "boogying": "boogieing",
    "sprung": "sprang",
}  # fmt: skip

#: In every form, what people do who are on their way somewhere.
TRAVELLING = frozenset(
    inflections(
        "walk", "run", "jog", "go", "move", "stroll", "stride", "pace", "hike", "tramp", "trudge", "toddle", "strut",
        "sprint", "dash", "scamper", "tiptoe", "step",
    )
)  # fmt: skip
# "Stops" alone is known to who stands, but who was told "stops walking" walked on.
_STOP, _COME = inflections("stop", "cease", "quit", "finish"), inflections("come")
_STOPPING = re.compile(
    rf"\b(?:(?P<stop>{'|'.join(_STOP)})\s+(?:{'|'.join(sorted(word for word in TRAVELLING if word.endswith('ing')))})"
    rf"|(?P<come>{'|'.join(_COME)})\s+to\s+an?\s+(?:\w+\s+)?(?:stop|halt|standstill))\b"
    r"(?!\s+(?:the|his|her|their|its|my|your|an?|it|him|them|around|backwards?)\b)",
    re.I,
)
#: The side to which a path bends, seen from above; what turns so is said right before or after it.
CLOCKWISE = {
    "clockwise": "right",
    **dict.fromkeys(("counterclockwise", "counter-clockwise", "anticlockwise", "anti-clockwise"), "left"),
}
_WHO_TURNS = {"degrees", *inflections("turn", "rotate", "pivot")}
_WHO_TRAVELS = {"around", *TRAVELLING}
_ROUND = r"\s+(?:circle|turn|path|loop|arc|curve|direction)s?\b"
_ON_ITS_WAY = r"\s+(?:ahead|forwards?|onwards?|off|away|across|along|toward|towards|past|out|into|through)\b"
_OBJECT = r"\s+(?:his|her|him|them|the|an?|it|its|me|us|away|out|off)\b"
# What has to follow a word, in any form or in this one, if it is to mean that motion, and what may not.
_ONLY_BEFORE = {
    **dict.fromkeys(("bolt", "charge", "zoom", "hurtle"), _ON_ITS_WAY),
    "spring": r"\s+(?:ahead|forwards?|up|upwards?|high|into|off|over|to (?:his|her|their) feet)\b",
    "advance": rf"{_ON_ITS_WAY}|\s+(?:slowly|steadily|quickly|with|a (?:little|bit|few))\b|\s*(?:$|[.,;!])",
    "gulp": r"\s+(?:down|an?|the|some|water|it)\b",
    **dict.fromkeys(("rounds", "rounding", "rounded"), r"\s+(?:an?|the)\s+(?:[\w-]+\s+)?(?:corner|bend|curve)\b"),
    **dict.fromkeys(
        ("approach", "enter"), r"\s+(?:the|an?|his|her|their|its|my|our|your|me|us|you|him|them|some\w+)\b"
    ),
    "latin": r"\s+(?:danc\w+|rhythms?|beats?|music|style|steps?|moves?)\b",
}
_NOT_BEFORE = {
    **dict.fromkeys(("enraged", "outraged", "irritated", "annoyed", "drained", "upset"), _OBJECT),
    "creep": r"\s+up\b|.*\b(?:knees|fours|belly)\b",
    "sneak": r"\s+an? (?:\w+ )?(?:look|peek|glance)\b",
    "hurry": r"\s+up\b",
    "hurried": r"\s+(?:steps?|pace|walk|way|manner|strides?|looks?)\b",
    "bathe": r"\s+in (?:sweat|light|sun\w*)\b",
    "flap": r"\s+(?:his|her|their|its|the) (?:mouth|lips|gums)\b",
}
# After these a word is no verb ("the march"), but "a marching man" walks and "a jab" is a punch.
_BEFORE_NOUNS = frozenset(
    words_of("a an the his her their its my your our this no with without in of by from on some every each another")
)
_NOUNS_TOO = frozenset({"stroll", "walk", "turn", "jog", "yell", "dance", "punch", "chuckle", "laugh"})
#: A verb as it stands in a dictionary may be a noun behind an adjective ("in early spring"), but not after these.
BEFORE_VERBS = frozenset(
    words_of("to and then or they we you i people men women who that can could will would must may might should not")
) | {""}
_ARTICLE = re.compile(r"\b([Aa])n?(\s+)$")
_WORD = re.compile(r"[^\W\d_]+(?:-[^\W\d_]+)*")


@dataclass(frozen=True, slots=True)
class Bend:
    """What a sentence says of a way that the model is not told of, and how the way is bent then."""

    said: str
    steering: Steering


@dataclass(frozen=True, slots=True)
class Reading:
    """A sentence as a model is told it, and every word that was read otherwise with what it was read as.

    Args:
        text: what the model is told.
        replaced: words, and what they were read as.
        bent: what the model is not told of (``reading``).
    """

    text: str
    replaced: tuple[tuple[str, str], ...] = ()
    bent: tuple[Bend, ...] = ()

    @property
    def steering(self) -> Together:
        """All that is done to the motion."""
        return Together(tuple(bend.steering for bend in self.bent))

    @property
    def seconds(self) -> float | None:
        """How long a motion is made, if nobody says; None for as long as the text takes."""
        return self.steering.seconds or None

    @property
    def cut(self) -> bool:
        """Whether it is made as long as that at least, and cut then."""
        return self.steering.cuts


def in_known_words(sentence: str, known: KnownPrompts) -> Reading:
    """The sentence with everyday words that the model does not know said in ones that it does.

    A model of whose words there is no list is told every sentence as it is.
    """
    replaced: dict[tuple[str, str], None] = {}
    if known.words and _knows(known.words, "stands still") and not _says_stopping(known):
        sentence = _STOPPING.sub(lambda found: _stands(found, replaced), sentence)
    new = set(unread(sentence, known.words))
    if not new:
        return Reading(sentence, tuple(replaced))
    out, start, end, before = [], 0, 0, ""
    for found in _WORD.finditer(sentence):
        word = found[0].lower()
        if sentence[end : found.start()].strip():
            before = ""  # another clause
        end = found.end()
        if word in new and (by := _means(word, before, sentence[end:])) and _knows(known.words, by):
            by = _without_echo(by, sentence[end:])
            said = by.capitalize() if found[0][0].isupper() else by
            out += [_with_article(sentence[start : found.start()], by), said]
            start = end
            replaced[word, by] = None
        if not word.endswith("ly"):
            before = word
    return Reading("".join((*out, sentence[start:])), tuple(replaced))


def _stands(found: re.Match[str], replaced: dict[tuple[str, str], None]) -> str:
    """What somebody does who stops what he does; noted in ``replaced``."""
    form = _STOP[found["stop"].lower()] if found["stop"] else _COME[found["come"].lower()]
    by = inflect_marked("[stand] still", form)
    replaced[found[0].lower(), by] = None
    return by.capitalize() if found[0][0].isupper() else by


@lru_cache(maxsize=16)
def _says_stopping(known: KnownPrompts) -> bool:
    return any(map(_STOPPING.search, known.sentences))


def _means(word: str, before: str, text: str) -> str:
    """What a word is read as between these; "" where it may mean something else."""
    if word in CLOCKWISE:
        return _sided(CLOCKWISE[word], before, text)
    by, verb, form = _table().get(word, ("", "", ""))
    for key in (word, verb):
        if (key in _ONLY_BEFORE and not _follows(_ONLY_BEFORE[key], text)) or (
            key in _NOT_BEFORE and _follows(_NOT_BEFORE[key], text)
        ):
            return ""
    if not verb:
        return by
    if before in _BEFORE_NOUNS:
        return by if (form == "ing" and " " not in by) or by in _NOUNS_TOO else ""
    return by if form != "base" or before in BEFORE_VERBS or by in _NOUNS_TOO else ""


def _sided(side: str, before: str, text: str) -> str:
    """What "clockwise" is read as; whoever walks so does not walk "to the right", which may be sideways."""
    if _follows(_ROUND, text):
        return side
    if _follows(r"\s+to\b", text):
        return ""
    return f"to the {side}" if before in _WHO_TURNS else f"turning {side}" if before in _WHO_TRAVELS else ""


def _follows(pattern: str, text: str) -> bool:
    return bool(re.match(pattern, text, re.I))


def _without_echo(phrase: str, text: str) -> str:
    """A phrase without its last word if the text after it begins with that: "wanders around"."""
    first, _, last = phrase.rpartition(" ")
    following = _WORD.match(text.lstrip())
    return first if first and following and following[0].lower() == last else phrase


def _with_article(text: str, word: str) -> str:
    """Text that may end with "a" or "an", as it is before that word."""
    return _ARTICLE.sub(lambda m: article(m[1], word) + m[2], text)


def as_written(model: ModelFolder[Any]) -> None:
    """Have an opened model told every sentence as it is: its networks are judged, not what else is known of words."""
    model.captions = replace(model.captions, words=frozenset())


@cache
def _table() -> dict[str, tuple[str, str, str]]:
    """By a word in one of its forms: what it is read as, in the same form, and of verbs the verb and the form."""
    table = {word: (by, "", "") for by, words in _OTHERS.items() for word in words.split()}
    for by, nouns in _NOUNS.items():
        for noun in nouns.split():
            several = _PLURALS.get(by) or inflect(by, "present")
            table |= {noun: (by, "", ""), inflect(noun, "present"): (several, "", "")}
    for phrase, verbs in _VERBS.items():
        for verb in verbs.split():
            for form in FORMS:
                table[inflect(verb, form)] = (inflect_marked(phrase, form), verb, form)
    return table | {variant: table[word] for variant, word in _VARIANTS.items()}


@lru_cache(maxsize=1024)
def _knows(words: frozenset[str], phrase: str) -> bool:
    return not unread(phrase, words)
