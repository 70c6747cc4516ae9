"""What readings of sentences share: sides, who is on his way, and whether a model was told such a thing."""

import re
from collections.abc import Callable, Mapping
from functools import lru_cache

from moveset.motion.steering import Steering
from moveset.pipelines.synonyms import CLOCKWISE, TRAVELLING, in_known_words
from moveset.text.familiarity import KnownPrompts
from moveset.text.subject import SUBJECT
from moveset.text.vocabulary import words_of

#: A sentence without what the model was never told of, and how its motion is bent for that; None if it need not be.
Plain = tuple[str, Steering | None]
#: What is made of a sentence in which a pattern was found; None where it means another thing.
Said = Callable[[re.Match[str], str, KnownPrompts], Plain | None]

THE = r"(?:the|his|her|their|its|my|your|our)"
CLAUSE = re.compile(r"[,.;:!?]|\b(?:then|while|before|after)\b", re.I)
NO_LIMB = r"(?!\s+(?:hand|arm|leg|foot|knee|elbow|shoulder|hip|side)s?\b)"
_AND = r"(?:and|but|then|finally|eventually|afterwards|later|after\s+that|before)"
#: What was done before, the word that joins it, and who does what comes now.
BEFORE = re.compile(
    rf"(?P<done>.*?)(?P<link>\s*[,;.]?\s*(?:\b{_AND}\b[\s,]*)*)(?P<who>(?:{SUBJECT.pattern}\s+)?(?:\w+ly\s+)?"
    r"(?:(?:is|are|was|were|am|just)\s+)*)",
    re.I | re.S,
)
#: Nobody, or who a sentence is about, and nothing that is done.
ALONE = re.compile(rf"\s*(?:{SUBJECT.pattern}\s+)?(?:\w+ly\s+)?(?:(?:is|are|was|were|am|just)\s+)*", re.I)
#: What follows, without the word that joins it.
AFTER = re.compile(rf"(?P<link>\s*[,;.!]?\s*(?:\b{_AND}\b[\s,]*)*)(?P<rest>.*)", re.I | re.S)
#: Words that say which of two things comes first.
IN_ORDER = re.compile(r"\b(?:then|before|finally|afterwards|later|after\s+that)\b", re.I)
_CLOCK = "|".join(CLOCKWISE)
_OBJECTS = frozenset(words_of("a an the his her their its my your our it him them"))
_LIMBS = frozenset(words_of(
    "hand hands arm arms leg legs foot feet knee knees elbow elbows head hips hip wrist wrists shoulder shoulders"
))  # fmt: skip


def side(name: str) -> str:
    """A pattern of "to the left", "clockwise" and the like, which may be missing; the group of that name."""
    to = rf"(?:(?:to|towards?)\s+(?:{THE}\s+)?|turning\s+)?"
    return rf"(?:\s+(?P<{name}>{to}(?:left|right)(?:wards?)?|{_CLOCK})\b{NO_LIMB})?"


def sign(*said: str | None) -> int:
    """-1 where one of these names the right, else 1."""
    words = [word for side in said if side for word in words_of(side)]
    return -1 if any(CLOCKWISE.get(word, word) in ("right", "rightward", "rightwards") for word in words) else 1


def since_going(text: str, known: KnownPrompts) -> list[str] | None:
    """The words after the one that says that somebody is on his way, in the last clause of this; None if none does.

    Whoever moves a hand, or runs a finger, goes nowhere by that.
    """
    clause = words_of(in_known_words(CLAUSE.split(text)[-1], known).text)
    verbs = [k for k, word in enumerate(clause) if word in TRAVELLING]
    if not verbs or _LIMBS.intersection(clause):
        return None
    since = clause[verbs[-1] + 1 :]
    return None if _OBJECTS.intersection(since[:1]) else since


def names_object(words: list[str]) -> bool:
    """Whether something is named that may be done something to."""
    return bool(_OBJECTS.intersection(words))


def first_said(
    sentence: str, known: KnownPrompts, patterns: Mapping[re.Pattern[str], Said]
) -> tuple[str, str, Steering | None] | None:
    """What a sentence says of a kind that the model was never told of: the plain sentence, the words that are not told,
    and how the motion is bent; None if it says no such thing.
    """
    for pattern, said in patterns.items():
        for found in pattern.finditer(sentence):
            if (plain := said(found, sentence, known)) and not told_of(known, pattern, said):
                return plain[0], found[0].strip(), plain[1]
    return None


@lru_cache(maxsize=64)
def told_of(known: KnownPrompts, pattern: re.Pattern[str], said: Said) -> bool:
    """Whether a caption of the training says something of the kind."""
    return any(said(found, sentence, known) for sentence in known.sentences for found in pattern.finditer(sentence))
