"""Where optical motion capture went wrong: flips, jumps and impossible postures, on ``hml22`` at 20 fps.

The thresholds suit the CMU takes. They are not for Bandai-Namco's: real punches there turn a joint by 93 degrees in a
frame, and nothing in that set needed rejecting.
"""

import math

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.skeleton import HML22

MAX_JOINT_SPEED = 16.0
MAX_ROOT_SPEED = 6.5
MAX_STEP = math.radians(75.0)
MAX_TWO_STEPS = math.radians(105.0)
# Mean over the joints of the size of the third difference, m/s³: landings and kicks reach 900, hops of the solver 7000.
MAX_JERK = 1200.0
MARGIN = 3
MIN_FRAMES = 40

_WRISTS = [HML22.index("left_wrist"), HML22.index("right_wrist")]
_ANKLES = [HML22.index("left_ankle"), HML22.index("right_ankle")]
_LEAVES = [*_WRISTS, HML22.index("left_foot"), HML22.index("right_foot")]
_STEADY = [j for j in range(len(HML22)) if j not in _LEAVES]
_ELBOWS = {"left": HML22.index("left_elbow"), "right": HML22.index("right_elbow")}


def steps(local: Tensor) -> Tensor:
    """(F-1, J) angle between consecutive frames of local rotations (F, J, 4), radians."""
    return rotations.angle(rotations.mul(rotations.inv(local[:-1]), local[1:]))


def glitch_mask(local: Tensor, root: Tensor, joints: Tensor, fps: float) -> Tensor:
    """(F,) bool: frames within three of one where a joint jumps.

    A joint faster than 16 m/s, a root faster than 6.5 m/s, a joint other than wrists and toes that turns more than 75
    degrees in a frame or 105 in two (a smoothed flip takes several), or a body whose mean jerk is over 1200 m/s³.
    """
    frames = len(root)
    bad = torch.zeros(frames, dtype=torch.bool)
    if frames < 2:
        return bad
    turned = steps(local)[:, _STEADY]
    jump = (joints.diff(dim=0).norm(dim=-1) * fps > MAX_JOINT_SPEED).any(dim=1)
    jump |= root.diff(dim=0).norm(dim=-1) * fps > MAX_ROOT_SPEED
    jump |= (turned > MAX_STEP).any(dim=1)
    jump[:-1] |= (turned[:-1] + turned[1:] > MAX_TWO_STEPS).any(dim=1)
    jump[1:] |= (turned[:-1] + turned[1:] > MAX_TWO_STEPS).any(dim=1)
    if frames > 3:
        jerk = (joints.diff(n=3, dim=0) * fps**3).norm(dim=-1).mean(dim=1)
        jump[1:-1] |= jerk > MAX_JERK
    for k in jump.nonzero()[:, 0].tolist():
        bad[max(0, k - MARGIN) : k + 2 + MARGIN] = True
    return bad


def longest_clean_run(bad: Tensor) -> tuple[int, int]:
    """First and one-past-last frame of the longest run that is not bad.

    >>> longest_clean_run(torch.tensor([False, True, False, False, True]))
    (2, 4)
    """
    best = (0, 0)
    start = 0
    for k, is_bad in enumerate([*bad.tolist(), True]):
        if is_bad:
            if k - start > best[1] - best[0]:
                best = (start, k)
            start = k + 1
    return best


def backward_elbow(local: Tensor) -> float:
    """The larger share of frames, of either arm, whose bent elbow (over 25 degrees) bends backwards.

    With level arms and thumbs forward an elbow flexes by turning the forearm towards +Z; the azimuth of the forearm
    about the upper arm says which way it went, 110 degrees off that being no elbow's doing.
    """
    worst = 0.0
    for side, j in _ELBOWS.items():
        out = 1.0 if side == "left" else -1.0
        arm = rotations.rotate(local[:, j], local.new_tensor((out, 0.0, 0.0)))
        bent = (arm[:, 0] * out).clamp(-1.0, 1.0).acos() > math.radians(25.0)
        azimuth = torch.atan2(arm[:, 1], arm[:, 2]).abs()
        if bent.any():
            worst = max(worst, float((bent & (azimuth > math.radians(110.0))).double().mean()))
    return worst


def turned_head(turned: Tensor) -> Tensor:
    """(F,) bool: the head faces more than 110 degrees away from the chest; ``turned`` (F, J, 4) world rotations."""
    chest, head = turned[:, HML22.index("spine3")], turned[:, HML22.index("head")]
    twist = rotations.heading(rotations.mul(rotations.inv(chest), head))
    return rotations.angle(twist) > math.radians(110.0)


def impossible_posture(local: Tensor) -> Tensor:
    """(F,) bool: a foot more than 110 degrees off its rest on the shin, or a forearm twisted by more than 130 degrees.

    A flip before the first frame leaves no jump to find, only a limb that no one can hold so; real takes reach 90 and
    121 degrees.
    """
    feet = rotations.angle(local[:, _ANKLES]).amax(dim=1)
    forearms = local[:, list(_ELBOWS.values())]
    twist = 2.0 * torch.atan2(forearms[..., 0].abs(), forearms[..., 3].abs()).amax(dim=1)
    return (feet > math.radians(110.0)) | (twist > math.radians(130.0))


def calm_wrists(local: Tensor) -> Tensor:
    """Local rotations with every wrist that ever flips held straight: a flipped hand bone says nothing about the hand.

    No joint position depends on a wrist's rotation.
    """
    local = local.clone()
    if len(local) > 1:
        for j in _WRISTS:
            if bool((steps(local)[:, j] > MAX_STEP).any()):
                local[:, j] = rotations.identity().to(local)
    return local
