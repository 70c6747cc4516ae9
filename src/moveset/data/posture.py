"""Upright and on the floor: what the markers of one performer have in common, taken from all takes of them.

Where markers sit tilts pelvis, head and feet by a constant that differs from performer to performer, and the floor of a
capture is not always at height 0. Both are seen in frames in which somebody stands; a take on a stool, on a ladder or
upside down has none of its own, but other takes of its performer have. F frames.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from moveset.data.hml22_calibration import FPS, HIPS, turn
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import stands_on
from moveset.motion.kinematics import fk, global_to_local
from moveset.motion.skeleton import HML22

_PELVIS, _CHEST, _NECK, _HEAD = (HML22.index(name) for name in ("pelvis", "spine3", "neck", "head"))
_FEET = list(HML22.feet)
_ANKLES = _FEET[::2]
_OTHERS = [joint for joint in range(len(HML22)) if joint not in _FEET]
_KNEES = [HML22.index("left_knee"), HML22.index("right_knee")]
# Somebody who stands looks down a little: degrees.
_USUAL = {"pelvis": 0.0, "head": 6.0, "ankle": 0.0}
_LEAST = 40  # frames of standing that say how a performer's markers sit
_FLOOR_SPREAD = 0.06  # metres by which a take's floor may be above that of its performer's others
_SELDOM = 0.1  # share of the frames
_LOWER = 0.3  # share of a performer's takes that are on the floor at some time
_SKIN = 0.04  # metres of the body under a joint that lies on the floor


def on_still_feet(turned: Tensor, joints: Tensor) -> Tensor:
    """(F,) bool: legs, straight or bent, carry an upright chest; both feet still and equally high.

    Args:
        turned: (F, 22, 4) world rotations.
        joints: (F, 22, 3) world positions.
    """
    if len(joints) < 2:
        return torch.zeros(len(joints), dtype=torch.bool)
    speed = joints[:, _FEET].diff(dim=0).norm(dim=-1).amax(dim=1) * FPS
    still = torch.cat((speed, speed[-1:])) < 0.25
    upright = rotations.rotate(turned[:, _CHEST], joints.new_tensor((0.0, 1.0, 0.0)))[:, 1] > math.cos(
        math.radians(15.0)
    )
    level = (joints[:, 7, 1] - joints[:, 8, 1]).abs() < 0.05
    return still & upright & level & stands_on(joints, HML22)


def standing(turned: Tensor, joints: Tensor) -> Tensor:
    """(F,) bool: ``on_still_feet``, with straight legs."""
    shin = joints[:, _ANKLES] - joints[:, _KNEES]
    thigh = joints[:, _KNEES] - joints[:, [1, 2]]
    straight = (torch.cosine_similarity(shin, thigh, dim=-1) > math.cos(math.radians(20.0))).all(dim=1)
    below = (thigh[..., 1] < -0.9 * thigh.norm(dim=-1)).all(dim=1)
    return on_still_feet(turned, joints) & straight & below


def lean(turned: Tensor) -> Tensor:
    """(F, 3) forward pitch of pelvis, head and (the mean of both) feet in degrees."""
    ahead = rotations.rotate(turned, turned.new_tensor((0.0, 0.0, 1.0)))[..., 1].clamp(-1.0, 1.0).asin()
    feet = ahead[:, _ANKLES].mean(dim=1)
    return torch.rad2deg(-torch.stack((ahead[:, _PELVIS], ahead[:, _HEAD], feet), dim=1))


def leanings(takes: Sequence[tuple[Tensor, Tensor]]) -> dict[str, float] | None:
    """Degrees of forward pitch that are to be taken from a performer's pelvis, head and feet; None if nobody stands.

    Args:
        takes: local rotations (F, 22, 4) and root (F, 3) of each.
    """
    found = []
    for local, root in takes:
        turned, joints = fk(local, root, HML22)
        found.append(lean(turned)[standing(turned, joints)])
    pitch = torch.cat(found)
    if len(pitch) < _LEAST:
        return None
    return {name: float(pitch[:, k].median()) - usual for k, (name, usual) in enumerate(_USUAL.items())}


def upright(local: Tensor, root: Tensor, degrees: dict[str, float]) -> tuple[Tensor, Tensor]:
    """The take with so much forward pitch taken from pelvis, head and feet; hips stay where they are."""
    turned, _ = fk(local, root, HML22)
    turned = turned.clone()
    moved = rotations.rotate(turned[:, 0], HIPS.to(turned))
    for joints, name in (([_PELVIS], "pelvis"), ([_HEAD], "head"), (_FEET, "ankle")):
        turned[:, joints] = rotations.mul(turned[:, joints], turn("x", -degrees[name]).to(turned))
    # The neck is halfway between chest and head.
    turned[:, _NECK] = rotations.mul(turned[:, _NECK], turn("x", -0.5 * degrees["head"]).to(turned))
    moved = moved - rotations.rotate(turned[:, 0], HIPS.to(turned))
    return rotations.unroll(global_to_local(turned, HML22)), root + moved


def floor_of(local: Tensor, root: Tensor) -> float:
    """Height of the floor that a take seems to have: the 1st percentile over time of the lowest of ankles and toes.

    No other joint is under it: who lies with the feet up lies on the floor. Where feet hardly ever get as low, and
    somebody stands above it, what lies below is no floor but an error of the capture (in flips, and falls).
    """
    turned, joints = fk(local, root, HML22)
    heights = joints[..., 1]
    feet, body = heights[:, _FEET].amin(dim=1), heights[:, _OTHERS].amin(dim=1) - _SKIN
    floor = min(float(torch.quantile(feet, 0.01)), float(torch.quantile(body, 0.01)))
    if float((feet < floor + _FLOOR_SPREAD).float().mean()) < _SELDOM:
        stands = feet[on_still_feet(turned, joints)]
        if len(stands) >= FPS / 2:
            floor = max(floor, float(torch.quantile(stands, 0.1)))
    return floor


def on_floor(local: Tensor, root: Tensor, floor: float) -> Motion:
    """The motion above the origin, facing +Z, with a floor of the capture at height 0."""
    down = root.new_tensor((0.0, floor, 0.0))
    return Motion(rotations.normalize(local).float(), (root - down).float(), FPS, HML22).canonical()


def floors(takes: Sequence[float]) -> list[float]:
    """The floor of each take of a performer: its own, or that of the lower takes if those are far below.

    Whoever sits on a stool or climbs all the time never touches the floor, but nobody is under it.

    Args:
        takes: ``floor_of`` each take, of one at least.
    """
    usual = float(torch.quantile(torch.tensor(takes), _LOWER))
    return [usual if floor > usual + _FLOOR_SPREAD else floor for floor in takes]
