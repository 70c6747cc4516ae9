"""Nobody hovers: a body that has been off the floor for longer than a jump takes is set down.

Networks that have seen few jumps make people who rise and stay up there. A body's clearance is how far its lowest joint
is above the floor; of a clip's clearance no jump explains the morphological opening, the highest curve below it that is
nowhere narrower than the longest jump. Somebody on stairs or a stool is up for as long, but got there without flying:
of a body that is carried something rests, if only for a moment. A stream, which does not know what comes, has a floor
that rises: the body goes up as it was to, and then sinks.
Shapes: F frames, J joints.
"""

from dataclasses import replace
from math import exp

import torch
from torch import Tensor
from torch.nn.functional import max_pool1d, pad

from moveset.motion.clip import Motion
from moveset.motion.contacts import SPEED, off_legs, stands_on
from moveset.motion.smoothing import gaussian_smooth, spans

SOLE = 0.02  # metres over the floor, below which the lowest joint of a standing foot is
LONGEST = 0.6  # seconds in the air: a jump of 0.44 m
_HIGHEST = 0.2  # metres: who is higher for longer than that is on something
_SEAT = 0.4  # the same of who sits or lies
_FLIGHT = 0.25  # seconds, longer than the flights of somebody who runs; a jump of 8 cm
_STANDING = 0.05  # metres over the floor, below which the lowest joint of a body on the floor is
_SMOOTH = 0.05  # seconds
_EASE = 0.1  # seconds in which a stream's floor comes up or goes down
_SETTLE = 0.6  # the same where feet are planted above it


def clearance(joints: Tensor) -> Tensor:
    """How far (F,) the lowest joint of (F, J, 3) is above where it is on a body that touches the floor, metres."""
    return (joints[..., 1].amin(dim=-1) - _STANDING).clamp_min(0.0)


def flying(joints: Tensor, fps: float) -> Tensor:
    """(F,) bool: for ``_FLIGHT`` seconds no joint of (F, J, 3) rests, as one does of who stands, climbs or hangs."""
    flies = (joints.diff(dim=0, prepend=joints[:1]).norm(dim=-1) * fps >= SPEED).all(dim=1)
    for start, stop in spans(flies):
        if stop - start < round(_FLIGHT * fps):
            flies[start:stop] = False
    return flies


def lasting(clearance_F: Tensor, fps: float) -> Tensor:
    """How much (F,) of a clip's clearance lasts longer than ``LONGEST``, metres; a jump may go on beyond its ends."""
    width = min(_frames(fps), len(clearance_F))
    eroded = -max_pool1d(-clearance_F[None], width, stride=1)
    return max_pool1d(pad(eroded, (width - 1, width - 1)), width, stride=1)[0]


def set_down(motion: Motion) -> Motion:
    """The clip without its hovering: the root sinks, nothing else changes.

    Somebody whose legs do not carry the body, but who sits, lies or kneels, does not hover; nor does one who got up
    without flying, or higher than people jump (``_HIGHEST``): that one is on something. So is who is up from the
    beginning, for nobody saw how.
    """
    joints = motion.joints
    flies = flying(joints, motion.fps)
    height = lasting(clearance(joints) * stands_on(joints, motion.skeleton), motion.fps)
    for start, stop in spans(height > 0):
        up = slice(start, stop)
        if start == 0 or not flies[up].any() or float(height[up].max()) > _HIGHEST:
            height[up] = 0.0
    return _eased(motion, height)


def seated(motion: Motion) -> Motion:
    """The clip with whoever sits, lies or kneels set down until something rests on the floor: the root sinks.

    In takes people sit on stools that their feet hang from, and networks learn it; in what they make there are no
    stools. Who stands, jumps, or is higher than a seat (``_SEAT``) stays where they are.
    """
    joints = motion.joints
    height = lasting(clearance(joints) * off_legs(joints, motion.skeleton), motion.fps)
    for start, stop in spans(height > 0):
        if float(height[start:stop].max()) > _SEAT:
            height[start:stop] = 0.0
    return _eased(motion, height)


def _eased(motion: Motion, height_F: Tensor) -> Motion:
    """``lowered``, as smoothly as somebody sinks."""
    if not bool(height_F.any()):
        return motion
    return lowered(motion, gaussian_smooth(height_F[:, None], _SMOOTH * motion.fps)[:, 0])


def lowered(motion: Motion, height_F: Tensor) -> Motion:
    """The motion with its root lower by ``height_F`` metres."""
    down = torch.zeros_like(motion.root)
    down[:, 1] = height_F.to(down)
    return replace(motion, root=motion.root - down)


class Hovering:
    """``set_down`` and ``seated`` for motion that never ends, piece by piece, with planted feet to go by.

    The floor comes up to a body that has been in the air for longer than a jump takes, and slowly to one whose planted
    feet are far above it; the rest is for the legs (``foot_lock``). It goes down again with the body.

    Args:
        fps: frames per second.
        height: how much the frame before the first piece was set down, metres.
        aloft: for how many frames the body had been in the air.
    """

    def __init__(self, fps: float, height: float = 0.0, aloft: int = 0) -> None:
        self._frames = _frames(fps)
        self._ease, self._settle = (1.0 - exp(-1.0 / (seconds * fps)) for seconds in (_EASE, _SETTLE))
        self._height, self._aloft = height, aloft

    def __call__(self, lowest: Tensor, feet: Tensor, planted: Tensor) -> Tensor:
        """How much (F,) of the next frames is to be taken off, metres, float64.

        Args:
            lowest: (F,) height of the body's lowest joint.
            feet: (F, 2) that of the lowest joint of each foot.
            planted: (F, 2) bool, which of them stand.
        """
        heights = []
        for low, at, stands in zip(*(x.tolist() for x in (lowest, feet, planted)), strict=True):
            standing = [height for height, stand in zip(at, stands, strict=True) if stand]
            down = standing or low - self._height < _STANDING
            self._aloft = 0 if down else self._aloft + 1
            if standing:
                self._height += self._settle * max(min(standing) - _STANDING - self._height, 0.0)
            elif self._aloft >= self._frames:
                self._height += self._ease * max(low - SOLE - self._height, 0.0)
            self._height -= self._ease * max(self._height - max(low - SOLE, 0.0), 0.0)
            # It dies away; what is left of it after a while is nothing.
            self._height = self._height if self._height > 1e-6 else 0.0
            heights.append(self._height)
        return torch.tensor(heights, dtype=torch.float64)

    def state(self) -> dict[str, float | int]:
        """The arguments of one that goes on here."""
        return {"height": self._height, "aloft": self._aloft}


def _frames(fps: float) -> int:
    return round(LONGEST * fps) + 1
