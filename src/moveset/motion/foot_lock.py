"""Foot locking for motion that never ends: ``cleanup.lock_feet`` without a look ahead, piece by piece.

A foot is pinned where it lands, with whatever shift it still has from its last stance, so that nothing jumps; when it
leaves, its shift dies away. A foot that stays planted while the body drifts off is let go before its leg is stretched.
On its way to where it should be a foot rises, the higher the further, if the other one stands. A planted foot above the
floor comes down to it, a body that hovers sinks (``hover``), and one that is in the floor rises (``floor``).
F frames of a piece.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import exp, hypot
from typing import Any

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion.cleanup import ALONE, LANDING, move_feet, step_heights
from moveset.motion.clip import Motion
from moveset.motion.contacts import stances, stands_on
from moveset.motion.floor import above_floor
from moveset.motion.hover import SOLE, Hovering, lowered
from moveset.motion.skeleton import Skeleton
from moveset.motion.smoothing import decay

_BLEND = 0.3  # seconds in which a foot leaves its locked place
_SLACK = 0.17  # metres from its locked place at which a foot is let go
_HISTORY = 4  # frames of contacts that decide with the next ones whether a foot stands

_Point = tuple[float, float]


@dataclass
class _Foot:
    """One foot between two frames: horizontal numbers in metres."""

    pivot: int = -1  # 0 ankle, 1 toe, -1 free
    pin: _Point = (0.0, 0.0)
    shift: _Point = (0.0, 0.0)
    before: _Point = (0.0, 0.0)  # the shift one frame earlier
    fading: list[_Point] = field(default_factory=list)  # shifts of the next frames of a free foot
    rising: list[float] = field(default_factory=list)  # how high it is raised in these frames
    joints: tuple[_Point, _Point] = ((0.0, 0.0), (0.0, 0.0))  # ankle and toe, unshifted, in the last frame
    drop: float = 0.0  # how far it is drawn down to the floor
    lift: float = 0.0  # how far it is raised onto it


class FootLock:
    """Locks the feet of pieces of one motion, each of which goes on from the one before.

    Args:
        skeleton: with feet and known knees (hml22, kit21).
    """

    def __init__(self, skeleton: Skeleton, fps: float) -> None:
        self.skeleton, self.fps = skeleton, fps
        self._blend, self._kept = max(round(_BLEND * fps), 2), exp(-1.0 / (LANDING * fps))
        self._feet = [_Foot(), _Foot()]
        self._contacts: list[list[bool]] = []
        self._hovering = Hovering(fps)

    def __call__(self, piece: Motion, contacts: Tensor) -> Motion:
        """The next piece with its feet locked, float64.

        Args:
            contacts: (F, 4) bool planted left ankle, left toe, right ankle, right toe.

        Raises:
            InputError: contacts of another shape, or a skeleton without known knees.
        """
        if tuple(contacts.shape) != (len(piece), 4):
            raise InputError(f"contacts must be (F, 4) = ({len(piece)}, 4), got {tuple(contacts.shape)}")
        joints = piece.joints.double()
        carried = stands_on(joints, self.skeleton)
        known = self._contacts + (contacts.bool() & carried[:, None]).tolist()
        standing = stances(joints, self.fps, self.skeleton, torch.tensor(known))[len(self._contacts) :]
        self._contacts = known[-_HISTORY:]
        feet = joints[:, list(self.skeleton.feet)].unflatten(1, (2, 2))
        lowest = feet[..., 1].amin(dim=2)
        stands = standing.unflatten(1, (2, 2)).any(dim=2)
        height = self._hovering(joints[..., 1].amin(dim=1), lowest, stands)
        if bool(height.any()):
            piece, lowest = lowered(piece, height), lowest - height[:, None]
        shifts = []
        for place, low, planted in zip(feet[..., [0, 2]].tolist(), lowest.tolist(), standing.tolist(), strict=True):
            for side, foot in enumerate(self._feet):
                ankle, toe = planted[2 * side : 2 * side + 2]
                other = self._feet[1 - side]
                alone = bool(other.rising) or other.pivot < 0
                shift = self._step(foot, place[side], 1 if toe else 0 if ankle else -1, alone)
                above = max(low[side] - SOLE, 0.0) if foot.pivot >= 0 else 0.0
                foot.drop = above + self._kept * (foot.drop - above)
                foot.lift = max(foot.drop - low[side], self._kept * foot.lift)
                step = foot.rising.pop(0) if foot.rising else 0.0
                shifts.append((shift[0], foot.lift - foot.drop + step, shift[1]))
        return above_floor(move_feet(piece, torch.tensor(shifts, dtype=torch.float64).reshape(-1, 2, 3)))

    def state(self) -> dict[str, Any]:
        """Everything that the next piece depends on, as numbers and lists that survive JSON exactly."""
        feet = [asdict(foot) for foot in self._feet]
        return {"feet": feet, "contacts": self._contacts, "hovering": self._hovering.state()}

    @classmethod
    def from_state(cls, skeleton: Skeleton, fps: float, state: Mapping[str, Any]) -> "FootLock":
        """A lock that goes on where the one whose ``state()`` this is stood."""
        lock = cls(skeleton, fps)
        lock._feet = [_Foot(**foot) for foot in state["feet"]]
        lock._contacts = state["contacts"]
        lock._hovering = Hovering(fps, **state["hovering"])
        return lock

    def _step(self, foot: _Foot, joints: tuple[_Point, _Point], pivot: int, alone: bool) -> _Point:
        """The horizontal shift of the next frame; ``alone`` while the other foot is in the air."""
        if pivot >= 0 and foot.pivot >= 0:
            if pivot != foot.pivot:  # it rolls: the new pivot stays where it was in the last frame
                foot.pin = _plus(foot.joints[pivot], foot.shift)
            shift = _minus(foot.pin, joints[pivot])
            if shift[0] ** 2 + shift[1] ** 2 > (_SLACK * (ALONE if alone else 1)) ** 2:
                pivot, shift = -1, self._let_go(foot, 0.0 if alone else 1.0)
        elif foot.pivot >= 0:
            shift = self._let_go(foot, 0.0 if alone else min(hypot(*foot.shift) / _SLACK, 1.0))
        else:
            shift = foot.fading.pop(0) if foot.fading else (0.0, 0.0)
            # One that was let go for slack is not pinned again before it is back in place.
            if pivot >= 0 and shift[0] ** 2 + shift[1] ** 2 < (0.5 * _SLACK) ** 2:
                foot.pin, foot.fading = _plus(joints[pivot], shift), []
            else:
                pivot = -1
        foot.pivot, foot.before, foot.shift, foot.joints = pivot, foot.shift, shift, joints
        return shift

    def _let_go(self, foot: _Foot, step: float) -> _Point:
        """The first shift of a foot on its way to where it should be, with this share of a step's height."""
        foot.rising = (step * step_heights(self._blend - 1)).tolist() if step else []
        at = torch.arange(1, self._blend, dtype=torch.float64)
        offset = torch.tensor(foot.shift, dtype=torch.float64)
        speed = torch.tensor(_minus(foot.shift, foot.before), dtype=torch.float64)
        path = decay(offset, speed, float(self._blend), at).tolist()
        foot.fading = [(x, z) for x, z in path]
        return foot.fading.pop(0)


def _plus(a: _Point, b: _Point) -> _Point:
    return a[0] + b[0], a[1] + b[1]


def _minus(a: _Point, b: _Point) -> _Point:
    return a[0] - b[0], a[1] - b[1]
