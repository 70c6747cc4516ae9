"""What readings of sentences share: clauses, sides, who is on his way, and what a model was told of."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

from moveset.motion.steering import Steering
from moveset.pipelines.synonyms import BEFORE_VERBS, CLOCKWISE, TRAVELLING, in_known_words
from moveset.text.english import inflect
from moveset.text.familiarity import KnownPrompts
from moveset.text.subject import SUBJECT
from moveset.text.vocabulary import words_of

#: A sentence without what the model was never told of, and how its motion is bent for that; None if it need not be.
Plain = tuple[str, Steering | None]
#: What is made of a sentence in which a pattern was found; None where it means another thing.
Said = Callable[[re.Match[str], str, KnownPrompts], Plain | None]

THE = r"(?:the|his|her|their|its|my|your|our)"
#: A pattern of "in place" and the like.
ON_THE_SPOT = r"(?:in\s+(?:one\s+)?place|on\s+the\s+spot)"
#: How often something is done, in words.
TIMES = {"once": 1, "one time": 1, "twice": 2, "two times": 2, "three times": 3, "four times": 4}
CLAUSE = re.compile(r"[,.;:!?]|\b(?:then|while|before|after)\b", re.I)
NO_LIMB = r"(?!\s+(?:hand|arm|leg|foot|knee|elbow|shoulder|hip|side)s?\b)"
_AND = r"(?:and|but|then|finally|eventually|afterwards|later|after\s+that|before)"
_BEFORE = re.compile(
    rf"(?P<done>.*?)(?P<link>\s*[,;.]?\s*(?:\b{_AND}\b[\s,]*)*)(?P<who>(?:{SUBJECT.pattern}\s+)?(?:\w+ly\s+)?"
    r"(?:(?:is|are|was|were|am|just)\s+)*)",
    re.I | re.S,
)
_AFTER = re.compile(rf"(?P<link>\s*[,;.!]?\s*(?:\b{_AND}\b[\s,]*)*)(?P<rest>.*)", re.I | re.S)
_IN_ORDER = re.compile(r"\b(?:then|before|finally|afterwards|later|after\s+that)\b", re.I)
_CLOCK = "|".join(CLOCKWISE)
_OBJECTS = frozenset(words_of("a an the his her their its my your our it him them"))
_LIMBS = frozenset(words_of(
    "hand hands arm arms leg legs foot feet knee knees elbow elbows head hips hip wrist wrists shoulder shoulders"
))  # fmt: skip


@dataclass(frozen=True)
class Clause:
    """What is done in a sentence before and after words that were found in it.

    Args:
        done: what is done before them; "" if they come first.
        first: that, the word that joins it, and who does what comes now.
        form: of the verb that was found (``english.FORMS``).
        capital: it begins the sentence, and looks it.
        rest: what is done after them; "" if they come last.
        following: that, and the word that joins it; or the full stop.
    """

    done: str
    first: str
    form: str
    capital: bool
    rest: str
    following: str

    @classmethod
    def around(cls, found: re.Match[str], text: str, form: str) -> "Clause | None":
        """The clause of what was found in a text; None if it belongs to words beside it, or is a noun."""
        before, after = _BEFORE.fullmatch(text[: found.start()]), _AFTER.match(text[found.end() :])
        *_, word = "", *words_of(text[: found.start()])
        if before is None or after is None or (form == "base" and word not in BEFORE_VERBS):
            return None
        done, link, rest = before["done"], before["link"], after["rest"]
        if (done and not link.strip()) or (rest and not _joined(after["link"], rest)):
            return None
        first = done + (link if not done else _in_order(link)) + before["who"]
        following = _in_order(after["link"]) + rest if rest else after["link"]
        return cls(done, first, form, found[0][0].isupper(), rest, following)

    def does(self, verb: str) -> str:
        """Another verb in place of the one that was found."""
        word = inflect(verb, self.form)
        return word.capitalize() if self.capital else word


def _joined(link: str, rest: str) -> bool:
    """Whether a word or a stop stands between two things to do, and the second is no manner ("stands, waving")."""
    return bool(link.strip()) and (bool(link.strip(" ,;.!")) or not rest.split()[0].endswith("ing"))


def _in_order(link: str) -> str:
    """What joins two things to do, in words that say which comes first."""
    return link if _IN_ORDER.search(link) else ", then "


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
