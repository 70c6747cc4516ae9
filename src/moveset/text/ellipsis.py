"""What a sentence leaves out because it was just said: "raises his right hand, then his left".

Captions of motion say their verbs in full, so a network that reads "then his left" sees a side and nothing to do with
it.
"""

import re

from moveset.text.subject import SUBJECT

_LIMBS = {"hands": "hand", "arms": "arm", "legs": "leg", "feet": "foot", "fists": "fist", "knees": "knee"}
_PLURAL = {one: many for many, one in _LIMBS.items()}
_LIMB = "|".join((*_LIMBS, *_PLURAL))
_WHOSE = r"(?:his|her|their|your|its|my|the)"
_NAMED = re.compile(rf"\b(?:(?P<whose>{_WHOSE})\s+)?(?P<side>left|right|both)\s+(?P<limb>{_LIMB})\b", re.I)
_THEN = r"(?:\s*[,;.]\s*(?:and\s+)?|\s+and\s+|\s+)(?:then|after\s+that|afterwards|next|later|finally)\b,?\s+"
_TWO = rf"and\s+(?:{_WHOSE}\s+)?(?:left|right)"
# A limb and nothing to do with it: up to the end, a stop, or what else is done. "then left" alone may be a turn.
_LEFT_OUT = re.compile(
    rf"""(?P<then>{_THEN})(?:with\s+)?
        (?: (?P<whose>{_WHOSE})\s+(?P<side>left|right|other)(?:\s+(?P<limb>{_LIMB}|one))?
          | (?P<named>left|right)\s+(?P<which>{_LIMB}|one)
          | (?P<both>both)(?:\s+of\s+(?:them|{_WHOSE}\s+(?:{_LIMB}))|\s+(?:{_WHOSE}\s+)?(?P<all>{_LIMB}))? )
        (?= \s*[,;.!]? \s*$ | \s*[,;.]\s | {_THEN} | \s+(?!{_TWO})(?:and|while|as|again|too)\b )""",
    re.I | re.X,
)
_OTHER = {"left": "right", "right": "left"}


def in_full(sentence: str) -> str:
    """The sentence with what is done said of every limb, and its words a space apart.

    Args:
        sentence: what a person does.

    >>> in_full("a person raises his right hand, then his left")
    'a person raises his right hand, then raises his left hand'
    >>> in_full("someone waves with the left hand and then with the other one")
    'someone waves with the left hand and then waves with the right hand'
    >>> in_full("a man raises his right hand, then turns left")
    'a man raises his right hand, then turns left'
    """
    # A run of spaces would be searched from each of them to its end, and again.
    sentence = " ".join(sentence.split())
    start = 0  # of the clause before the limb
    while found := _LEFT_OUT.search(sentence, start):
        clause = _last_clause(sentence[: found.start()])
        said = list(_NAMED.finditer(clause))
        limb = _limb(found, said[-1]) if said else None
        if limb is None:
            start = found.end("then")
            continue
        again = f"{clause[: said[-1].start()]}{limb}{clause[said[-1].end() :]}"
        sentence = f"{sentence[: found.end('then')]}{again}{sentence[found.end() :]}"
        start = found.end("then") + len(again)
    return sentence


def _last_clause(before: str) -> str:
    """What is done last in ``before``, without who does it."""
    clause = re.split(_THEN, before, flags=re.I)[-1].strip(" \t\n,;.")
    subject = SUBJECT.match(clause)
    clause = clause[subject.end() :].strip() if subject else clause
    # Of two things at once, the one that is done with the limb is the last.
    head, _, last = clause.rpartition(" and ")
    clause = last if head and _NAMED.search(last) and not _NAMED.match(last) else clause
    return re.sub(r"\bfirst\s+", "", clause, flags=re.I)


def _limb(found: re.Match[str], said: re.Match[str]) -> str | None:
    """Whose, which side and what: of ``found`` where it says so, else as it was ``said``; None where nobody knows."""
    limb = said["limb"].lower()
    if found["both"]:
        limb = (found["all"] or limb).lower()
        return f"both {_PLURAL.get(limb, limb)}"
    side, whose = (found["side"] or found["named"]).lower(), found["whose"] or said["whose"]
    if side == "other":
        if said["side"].lower() == "both":
            return None
        side, whose = _OTHER[said["side"].lower()], said["whose"]
    other = (found["limb"] or found["which"] or "one").lower()
    limb = limb if other == "one" else other
    return f"{whose or 'the'} {side} {_LIMBS.get(limb, limb)}"
