"""Words of a prompt that a model was never trained on, whatever their inflection, or can do nothing with."""

import re
from collections.abc import Iterable
from functools import lru_cache

_WORD = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*")
_SUFFIXES = ("s", "es", "ed", "d", "ing", "ly", "er", "ers")
_LEAST = 3  # letters of a stem


_FIGURES = re.compile(r"(?<!\w)\d+(?:[.,]\d+)*")
# Captions have these words, and whoever is captured is alone and does something all the same.
_SEVERAL = re.compile(
    r"\b(?:people|persons|men|women|children|kids|boys|girls|guys|ladies|gentlemen|couple(?!\s+(?:of|more)\b)|crowd|each\s+other"
    r"|one\s+another)\b(?!['’])",
    re.IGNORECASE,
)
_NOT = re.compile(r"\b(?:(?:can)?not|never|nobody|no\s+one)\b|n['’]t\b", re.IGNORECASE)


def words_of(sentence: str) -> list[str]:
    """Words in lower case, without a possessive ending.

    >>> words_of("A person's left-hand wave, 2 times!")
    ['a', 'person', 'left-hand', 'wave', 'times']
    """
    found = (word.replace("’", "'").lower() for word in _WORD.findall(sentence))
    return [word.removesuffix("'s") for word in found]


# Words that only hold a sentence together, or say no more than that somebody does it: no motion hangs on them. On "not"
# all of it does.
_GRAMMAR = frozenset(words_of(
    """
    a about above across after again against ahead all along also although always am among an and another any anybody
    anyone are around as aside at away back be because been before behind being below beneath beside between beyond
    both but by came can come comes coming continually could did do does doing done down during each either else even
    ever every few finally first for from further get gets getting go goes going gone got had has have having he her
    here hers herself him himself his how i if in inside instead into is it its itself just last later left less let
    like likes little made make makes making many me meanwhile more most much must my myself near nearly next no
    now of off often on once one oneself onto onward onwards or other others our out outside over own past per please
    quite rather really right said same several shall she should so some somehow somewhat somewhere starts start
    started starting such than that the their them themselves then there these they this those though through
    throughout till to together too toward towards two under until unto up upon us very via was way we well went were
    what when where whether which while whilst who whole whom whose why will with within without would yet you your
    actor actors actress adult boy boys character characters child children dude figure figures friend gentleman girl
    girls guy guys human humans individual individuals kid kids lady ladies man men people performer performers person
    persons somebody someone subject subjects woman women
    """
))  # fmt: skip


def figures_of(sentence: str) -> list[str]:
    """Numbers of a sentence that are written in figures, with the word that one is a part of left out.

    >>> figures_of("waves 3 times for 2.5 seconds, 10x")
    ['3', '2.5', '10']
    """
    return _FIGURES.findall(sentence)


def unread(sentence: str, vocabulary: Iterable[str]) -> tuple[str, ...]:
    """Words of a sentence of which no form is in the vocabulary, each once; words of grammar and persons are left out.

    A hyphenated word is known if it is, or if all its parts are.

    Args:
        vocabulary: words, in any form; none at all is an unknown vocabulary, of which nothing is said.

    >>> unread("a person rides a bicycle quickly", ["riding", "quick", "walk"])
    ('bicycle',)
    """
    known = _stems(frozenset(vocabulary))
    if not known:
        return ()

    def is_known(word: str) -> bool:
        return word in _GRAMMAR or bool(_stems_of(word) & known)

    missing = (
        word
        for word in words_of(sentence)
        if not is_known(word) and not ("-" in word and all(is_known(part) for part in word.split("-")))
    )
    return tuple(dict.fromkeys(missing))


@lru_cache(maxsize=8)
def _stems(vocabulary: frozenset[str]) -> frozenset[str]:
    return frozenset(stem for word in vocabulary for stem in _stems_of(word.lower()))


@lru_cache(maxsize=4096)
def _stems_of(word: str) -> frozenset[str]:
    """What a word may be a form of, itself among them: "stopping" of "stop", "waving" of "wave"."""
    stems = {word}
    for suffix in _SUFFIXES:
        stem = word.removesuffix(suffix)
        if stem == word or len(stem) < _LEAST:
            continue
        stems |= {stem, stem + "e"}
        if stem[-1] == stem[-2]:
            stems.add(stem[:-1])
        if stem.endswith("i"):
            stems.add(stem[:-1] + "y")
    return frozenset(stems)


def several(sentence: str) -> str:
    """The words that tell of more than one person; "" where none do.

    >>> several("Two people dance"), several("a man takes a couple of steps")
    ('people', '')
    """
    found = _SEVERAL.search(sentence)
    return found.group() if found else ""


def denied(sentence: str) -> str:
    """The word that says of something that it is not done; "" where none does.

    >>> denied("a person does not walk"), denied("a person ties a knot")
    ('not', '')
    """
    found = _NOT.search(sentence)
    return found.group() if found else ""
