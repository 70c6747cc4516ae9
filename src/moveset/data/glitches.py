"""Where optical motion capture went wrong, on ``hml22``: single joints that flip are mended, the rest is cut out.

Conversions of marker data turn a joint by half a turn for some frames; the joints around it go on. What is left of
jumps and impossible postures is cut out. The thresholds suit the CMU takes. They are not for Bandai-Namco's: real
punches there turn a joint by 93 degrees in a frame, and nothing in that set needed rejecting.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22
from moveset.motion.smoothing import smoothstep, spans

MAX_JOINT_SPEED = 16.0
MAX_ROOT_SPEED = 6.5
MAX_STEP = math.radians(75.0)
MAX_TWO_STEPS = math.radians(105.0)
# Mean over the joints of the size of the third difference, m/s³: landings and kicks reach 900, hops of the solver 7000.
MAX_JERK = 1200.0
MARGIN = 3
MIN_FRAMES = 24
# A joint may be off for so many seconds, and turn by so much meanwhile, to be mended.
MENDABLE = 1.0
_MEANWHILE = math.radians(100.0)
_MOST = math.radians(110.0)

_WRISTS = [HML22.index("left_wrist"), HML22.index("right_wrist")]
_ANKLES = [HML22.index("left_ankle"), HML22.index("right_ankle")]
_NECK, _HEAD = HML22.index("neck"), HML22.index("head")
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
    jump |= _jumps(turned, MAX_STEP, MAX_TWO_STEPS).any(dim=1)
    if frames > 3:
        jerk = (joints.diff(n=3, dim=0) * fps**3).norm(dim=-1).mean(dim=1)
        jump[1:-1] |= jerk > MAX_JERK
    for k in jump.nonzero()[:, 0].tolist():
        bad[max(0, k - MARGIN) : k + 2 + MARGIN] = True
    return bad


def mended(local: Tensor, fps: float) -> Tensor:
    """Local rotations (F, J, 4) with flips of single joints interpolated.

    A joint, other than wrists and toes, is off between two jumps of it that are at most a second apart, and then is
    turned on from before to after that; where these differ by more than 100 degrees nothing is done, for then the joint
    has moved. Feet and heads are also off where no one can hold them so. When that lasts, or is at an end of the
    capture, there is nothing to go by: they are held straight.
    """
    local = local.clone()
    gap, slow = round(MENDABLE * fps), max(1.0, 20.0 / fps)
    jumps = _jumps(steps(local), MAX_STEP * slow, MAX_TWO_STEPS * slow)
    impossible = {j: rotations.angle(local[:, j]) > _MOST for j in _ANKLES}
    turned = turned_head(fk(local, torch.zeros_like(local[:, 0, :3]), HML22)[0])
    impossible |= {_NECK: turned, _HEAD: turned}
    for j in _STEADY:
        bad = torch.zeros(len(local), dtype=torch.bool)
        found = jumps[:, j].nonzero()[:, 0].tolist()
        for k, step in enumerate(found):
            bad[step : step + 2] = True
            if k and step - found[k - 1] <= gap:
                bad[found[k - 1] : step + 1] = True
        for start, stop in spans(bad | impossible[j] if j in impossible else bad):
            _mend(local[:, j], start, stop, gap, j in impossible and bool(impossible[j][start:stop].any()))
    return rotations.unroll(local)


def _mend(joint: Tensor, start: int, stop: int, gap: int, straight: bool) -> None:
    """Frames [start, stop) of one joint (F, 4), in place; ``straight`` if it may be held so."""
    inside = start > 0 and stop < len(joint)
    if inside and stop - start <= 2 * gap:
        before, after = joint[start - 1], joint[stop]
        if float(rotations.angle(rotations.mul(rotations.inv(before), after))) <= _MEANWHILE:
            t = torch.arange(1, stop - start + 1).to(joint) / (stop - start + 1)
            ends = (before.expand(len(t), 4), after.expand(len(t), 4))
            joint[start:stop] = rotations.slerp(*ends, smoothstep(t))
            return
    if not straight:
        return
    held = rotations.identity(stop - start).to(joint)
    ease = min(max(gap // 4, 1), stop - start)
    for k in range(ease):
        t = torch.tensor((k + 1) / (ease + 1)).to(joint)
        if start > 0:
            held[k] = rotations.slerp(joint[start - 1], held[k], t)
        if stop < len(joint):
            held[-1 - k] = rotations.slerp(joint[stop], held[-1 - k], t)
    joint[start:stop] = held


def _jumps(turned: Tensor, limit: float, limit_of_two: float) -> Tensor:
    """(F-1, J) bool: steps (F-1, J) over the limit, or over the other one together with a neighbour."""
    jump = turned > limit
    two = turned[:-1] + turned[1:] > limit_of_two
    jump[:-1] |= two
    jump[1:] |= two
    return jump


def faced_elbows(local: Tensor) -> Tensor:
    """Local rotations with every arm whose bent elbow mostly bends backwards turned by half a turn about itself.

    The forearm's rotation in the world, and so every position, stays what it is.
    """
    local = local.clone()
    half = local.new_tensor((1.0, 0.0, 0.0, 0.0))
    for side, j in _ELBOWS.items():
        if _backward(local[:, j], 1.0 if side == "left" else -1.0) > 0.5:
            shoulder = HML22.parents[j]
            local[:, shoulder] = rotations.mul(local[:, shoulder], half)
            local[:, j] = rotations.mul(rotations.inv(half), local[:, j])
    return rotations.unroll(local)


def whole_body_jumps(root: Tensor, fps: float) -> list[tuple[int, int]]:
    """Pieces (first and one-past-last frame) of a capture between single steps of its root (F, 3) that nobody makes."""
    step = root.diff(dim=0).norm(dim=-1) * fps
    edges = [0, *((step > MAX_ROOT_SPEED).nonzero()[:, 0] + 1).tolist(), len(root)]
    return [(a, b) for a, b in pairwise(edges) if b > a]


def _backward(elbow: Tensor, out: float) -> float:
    """Share of frames whose bent elbow (F, 4), over 25 degrees, bends backwards; ``out`` is 1 left and -1 right.

    With level arms and thumbs forward an elbow flexes by turning the forearm towards +Z; the azimuth of the forearm
    about the upper arm says which way it went, 110 degrees off that being no elbow's doing.
    """
    arm = rotations.rotate(elbow, elbow.new_tensor((out, 0.0, 0.0)))
    bent = (arm[:, 0] * out).clamp(-1.0, 1.0).acos() > math.radians(25.0)
    azimuth = torch.atan2(arm[:, 1], arm[:, 2]).abs()
    return float((azimuth[bent] > math.radians(110.0)).double().mean()) if bent.any() else 0.0


def turned_head(turned: Tensor) -> Tensor:
    """(F,) bool: the head faces more than 110 degrees away from the chest; ``turned`` (F, J, 4) world rotations."""
    chest, head = turned[:, HML22.index("spine3")], turned[:, HML22.index("head")]
    twist = rotations.heading(rotations.mul(rotations.inv(chest), head))
    return rotations.angle(twist) > _MOST


def impossible_foot(local: Tensor) -> Tensor:
    """(F,) bool: a foot more than 110 degrees off its rest on the shin; real takes reach 90.

    A flip before the first frame leaves no jump to find, only a foot that no one can hold so.
    """
    return rotations.angle(local[:, _ANKLES]).amax(dim=1) > _MOST


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
