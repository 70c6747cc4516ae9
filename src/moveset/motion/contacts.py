"""When a foot is planted: low and slow. Height alone is not contact, since swinging toes stay low in real takes."""

import torch
from torch import Tensor

from moveset.motion.skeleton import Skeleton
from moveset.motion.smoothing import gaussian_smooth, smoothstep, spans

TOE_HEIGHT = 0.05
ANKLE_HEIGHT = 0.12
SPEED = 0.5
_CARRYING = 0.5
_SURELY = 0.65
#: Above this a network's contact feature is a planted foot: far below one half, since what blurs feet blurs contacts
#: too, and a doubtful foot is better held than let slide (docs/decisions/motion.md).
PLANTED = 0.15


def foot_contacts(joints: Tensor, fps: float, skeleton: Skeleton) -> Tensor:
    """Planted feet, (F, 4) bool: left ankle, left toe, right ankle, right toe.

    A joint is planted where it is below its height limit (toe 5 cm, ankle 12 cm above the floor y = 0) and moves slower
    than 0.5 m/s to the next frame; the last frame repeats the one before.

    Args:
        joints: (F, J, 3) world positions in metres, F >= 2.
    """
    feet = joints[:, list(skeleton.feet)]
    speed = (feet[1:] - feet[:-1]).norm(dim=-1) * fps
    speed = torch.cat((speed, speed[-1:]))
    limits = feet.new_tensor((ANKLE_HEIGHT, TOE_HEIGHT, ANKLE_HEIGHT, TOE_HEIGHT))
    return (feet[..., 1] < limits) & (speed < SPEED)


def stances(joints: Tensor, fps: float, skeleton: Skeleton, contacts: Tensor | None = None) -> Tensor:
    """Planted feet as ``foot_contacts`` finds them, without flicker: (F, 4) bool.

    Contacts are judged on positions smoothed over a twentieth of a second, gaps up to a tenth of a second are closed,
    and what is shorter than a seventh of a second is dropped. Given ``contacts`` (F, 4) are only closed and dropped.
    """
    if contacts is None:
        flat = gaussian_smooth(joints.flatten(1), 0.05 * fps)
        contacts = foot_contacts(flat.reshape(joints.shape), fps, skeleton)
    closed = _without_short_runs(~contacts.bool(), round(0.1 * fps), ends=False)
    return _without_short_runs(~closed, round(0.14 * fps) - 1, ends=True)


def stands_on(joints: Tensor, skeleton: Skeleton, least: float = _CARRYING) -> Tensor:
    """(F,) bool: whether the hips of (F, J, 3) are so high above the lower foot that legs carry the body.

    Args:
        least: as ``leg_share``. A deep lunge has half, who kneels or sits on the floor has not.
    """
    return leg_share(joints, skeleton) > least


def leg_share(joints: Tensor, skeleton: Skeleton) -> Tensor:
    """How high (F,) the hips of (F, J, 3) are above the lower foot, as a share of the length of thigh and shin."""
    ankles, knees = zip(*(_ankle_and_knee(skeleton, foot) for foot in skeleton.feet[::2]), strict=True)
    hips = [skeleton.parents[knee] for knee in knees]
    leg = skeleton.offsets[[*knees, *ankles]].norm(dim=-1).sum() / 2
    return (joints[:, hips, 1].mean(dim=1) - joints[:, ankles, 1].amin(dim=1)) / leg.to(joints)


def off_legs(joints: Tensor, skeleton: Skeleton) -> Tensor:
    """How far (F,), 0 to 1, somebody is off the legs, as who sits, kneels, lies or is upside down; of (F, J, 3)."""
    return smoothstep(((_SURELY - leg_share(joints, skeleton)) / (_SURELY - _CARRYING)).clamp(0.0, 1.0))


def _ankle_and_knee(skeleton: Skeleton, foot: int) -> list[int]:
    """Where the two longest bones above a foot end, shin and thigh; the foot may be a heel (``kit21``)."""
    chain = [foot]
    while skeleton.parents[chain[-1]] > 0:
        chain.append(skeleton.parents[chain[-1]])
    longest = sorted(chain, key=lambda joint: -float(skeleton.offsets[joint].norm()))[:2]
    return sorted(longest, key=chain.index)


def _without_short_runs(marks: Tensor, longest: int, ends: bool) -> Tensor:
    """Clear runs of at most ``longest`` set frames in each column of (F, C); those at the clip's ends only if told."""
    out = marks.clone()
    for column in out.T:
        for start, end in spans(column):
            if end - start <= longest and (ends or (start > 0 and end < len(column))):
                column[start:end] = False
    return out
