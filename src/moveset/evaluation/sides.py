"""Whether a motion does with the left what its sentence says of the left.

A sentence names a side where it says "left" or "right" of a hand, an arm, a leg or a foot, or of a turn, and never the
other side of that. The limb named then has to move more than the other one, seen from the pelvis; a turn has to go
there. What the sentence says of sides otherwise ("to the right of a table") is not judged.

Shapes: F frames, J joints.
"""

import re
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from moveset.motion.sides import LEAST_TURN, SIDED, more_left, turned
from moveset.motion.skeleton import Skeleton

Side = Literal["left", "right"]
_LIMBS = {"arm": r"(?:hands?|arms?|fists?|elbows?)", "leg": r"(?:legs?|foot|feet|knees?)"}
_NAMED = {limb: re.compile(rf"\b(left|right)\s+(?:\w+\s+)?{words}\b", re.IGNORECASE) for limb, words in _LIMBS.items()}
_TURN = re.compile(
    r"\b(?:turn(?:s|ed|ing)?|veer(?:s|ed|ing)?)\s+(?:\w+\s+)?(?:(?:to|toward)\s+)?(?:(?:the|his|her|their)\s+)?"
    r"(left|right)\b(?!\s+(?:\w+\s+)?(?:hand|arm|leg|foot|knee|elbow))",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Named:
    what: Literal["arm", "leg", "turn"]
    side: Side


def named_side(sentence: str) -> Named | None:
    """The one side that a sentence names; None where it names none, or more than one.

    >>> named_side("A person waves with the right hand.")
    Named(what='arm', side='right')
    >>> named_side("a man kicks with his left foot, then his right foot")
    """
    found = {
        Named(what, side.lower())  # type: ignore[arg-type]
        for what, pattern in (*_NAMED.items(), ("turn", _TURN))
        for side in pattern.findall(sentence)
    }
    return found.pop() if len(found) == 1 else None


def on_named_side(named: Named, joints: Tensor, skeleton: Skeleton) -> bool:
    """Whether a motion (F, J, 3), in metres, does what is named on that side."""
    sign = 1 if named.side == "left" else -1
    if named.what == "turn":
        return sign * turned(joints, skeleton) > LEAST_TURN
    limbs = more_left(joints[None], torch.tensor([len(joints)]), skeleton)[0]
    return bool(sign * limbs[SIDED.index(named.what)] > 0)
