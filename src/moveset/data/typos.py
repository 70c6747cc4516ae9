"""Obvious typos of typed sentences, by the words of all of them: a rare word one slip from a common one.

What is typed a few times and is one letter more, less or other than a word that is typed often, within the word, is a
slip; endings are left alone, for "lifter" and "lifted" are both words.
"""

import re
from collections import Counter
from collections.abc import Iterable

_RARE, _COMMON, _LONG = 2, 20, 6
#: Rare words that are no slips, whatever common word is near.
_RIGHT = """
    strike passes flipping licking teaching cocking mother cooking handing leaving saying sawing sewing mopping
    cutting giggles wriggles petting flopping rising formal sleeping tumbles fourth slapping emotion stoops rushes
    crotches abject bopping causes locking looping potion steeping stomping stomps waking moping
"""
_ENDINGS = ("s", "es", "d", "ed", "r", "er", "ers", "ing", "ly", "y", "n", "en", "e", "al")


def word_list(sentences: Iterable[str]) -> Counter[str]:
    """How often each word is typed."""
    return Counter(word for sentence in sentences for word in re.findall(r"[a-z]+", sentence.lower()))


def mend(sentence: str, words: Counter[str]) -> str:
    """The sentence with its obvious typos mended.

    >>> words = Counter({"person": 900, "walking": 400, "lifted": 90, "waling": 1, "oerson": 1, "lifter": 1})
    >>> mend("the oerson is waling, a lifter", words)
    'the person is walking, a lifter'
    """
    # Whole words: what follows a capital is no word.
    return re.sub(r"\b[a-z]+\b", lambda found: _mended(found[0], words), sentence)


def _mended(word: str, words: Counter[str]) -> str:
    if len(word) < _LONG or words[word] > _RARE or word in _RIGHT.split():
        return word
    best = [other for other in _slips(word) if words[other] >= _COMMON and not _same_stem(word, other)]
    return max(best, key=lambda other: words[other]) if best else word


def _slips(word: str) -> set[str]:
    """Words that differ by a letter more, less or other, or by two neighbours exchanged."""
    letters = "abcdefghijklmnopqrstuvwxyz"
    cuts = [(word[:k], word[k:]) for k in range(len(word) + 1)]
    return (
        {a + b[1:] for a, b in cuts if b}
        | {a + b[1] + b[0] + b[2:] for a, b in cuts if len(b) > 1}
        | {a + c + b[1:] for a, b in cuts if b for c in letters}
        | {a + c + b for a, b in cuts for c in letters}
    ) - {word}


def _same_stem(one: str, other: str) -> bool:
    """Whether two words may be forms of one."""
    common = next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
    return common >= 3 and (one[common:] in ("", *_ENDINGS)) and (other[common:] in ("", *_ENDINGS))
