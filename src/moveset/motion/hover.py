"""Nobody hovers: a body that has been off the floor for longer than a jump takes is set down.

Networks that have seen few jumps make people who rise and stay up there. A body's clearance is how far its lowest joint
is above the floor; of a clip's clearance no jump explains the morphological opening, the highest curve below it that is
nowhere narrower than the longest jump. A stream, which does not know what comes, takes the least clearance of the time
that a jump takes, eased: the body rises as it was to, and then sinks.
Shapes: F frames, J joints.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import exp

import torch
from torch import Tensor
from torch.nn.functional import max_pool1d, pad

from moveset.motion.clip import Motion
from moveset.motion.smoothing import gaussian_smooth

LONGEST = 0.6  # seconds in the air: a jump of 0.44 m
_STANDING = 0.05  # metres over the floor, below which the lowest joint of a body on the floor is
_SMOOTH = 0.05  # seconds
_EASE = 0.1  # seconds, of a stream


def clearance(joints: Tensor) -> Tensor:
    """How far (F,) the lowest joint of (F, J, 3) is above where it is on a body that touches the floor, metres."""
    return (joints[..., 1].amin(dim=-1) - _STANDING).clamp_min(0.0)


def hovering(clearance_F: Tensor, fps: float) -> Tensor:
    """How much (F,) of a clip's clearance lasts longer than ``LONGEST``, metres; a jump may go on beyond its ends."""
    width = min(_frames(fps), len(clearance_F))
    eroded = -max_pool1d(-clearance_F[None], width, stride=1)
    opened = max_pool1d(pad(eroded, (width - 1, width - 1)), width, stride=1)[0]
    return gaussian_smooth(opened[:, None], _SMOOTH * fps)[:, 0]


def set_down(motion: Motion, strength: float = 1.0) -> Motion:
    """The clip without its hovering: the root sinks, nothing else changes."""
    height = hovering(clearance(motion.joints), motion.fps)
    if not bool(height.any()):
        return motion
    return lowered(motion, strength * height)


def lowered(motion: Motion, height_F: Tensor) -> Motion:
    """The motion with its root lower by ``height_F`` metres."""
    down = torch.zeros_like(motion.root)
    down[:, 1] = height_F.to(down)
    return replace(motion, root=motion.root - down)


class Hovering:
    """``hovering`` of motion that never ends, piece by piece.

    Args:
        fps: frames per second.
        recent: clearances of the frames before the first piece.
        height: how much the frame before it was set down.
    """

    def __init__(self, fps: float, recent: Sequence[float] = (), height: float = 0.0) -> None:
        self._frames, self._kept = _frames(fps), exp(-1.0 / (_EASE * fps))
        self._recent, self._height = list(recent), height

    def __call__(self, joints: Tensor) -> Tensor:
        """How much (F,) of the next frames (F, J, 3) is to be taken off, metres, float64."""
        heights = []
        for now in clearance(joints).tolist():
            self._recent = [*self._recent[1 - self._frames :], now]
            least = min(self._recent) if len(self._recent) == self._frames else 0.0
            self._height = least + self._kept * (self._height - least)
            # It dies away; what is left of it after a while is nothing.
            self._height = self._height if self._height > 1e-6 else 0.0
            heights.append(self._height)
        return torch.tensor(heights, dtype=torch.float64)

    def state(self) -> dict[str, list[float] | float]:
        """The arguments of one that goes on here."""
        return {"recent": self._recent, "height": self._height}


def _frames(fps: float) -> int:
    return round(LONGEST * fps) + 1
