"""Which way is a body? Left, up and forward from the places of its joints, and how far a pose is from standing.

F frames, J joints; float64.
"""

import itertools
from collections.abc import Mapping

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.skeleton import Skeleton

Roles = Mapping[str, int]

_TINY = 1e-9
_ANKLE = 0.078  # of a leg: height of ankles above toe joints, on hml22
_SNAP = 0.8  # cosine: rest poses that are nearly along the axes are meant to be


def unit(v: Tensor) -> Tensor:
    """Directions (..., 3); zero where there is none."""
    return torch.nn.functional.normalize(v, dim=-1, eps=_TINY)


def centre(placed: Tensor, roles: Roles, part: str) -> Tensor:
    """Halfway between the left and the right one of a part (..., 3)."""
    return placed[..., [roles[f"left_{part}"], roles[f"right_{part}"]], :].mean(dim=-2)


def leg_length(skeleton: Skeleton, roles: Roles) -> float:
    """Hip to knee to ankle, metres, mean of both sides."""
    rest = skeleton.rest_positions
    length = 0.0
    for side in ("left", "right"):
        hip, knee, ankle = (rest[roles[f"{side}_{part}"]] for part in ("hip", "knee", "ankle"))
        length += 0.5 * float((knee - hip).norm() + (ankle - knee).norm())
    return length


def ankle_height(skeleton: Skeleton, roles: Roles) -> float:
    """Height of the ankles above the toe joints at rest, Y up, metres; as people have it where there are no toes."""
    rest = skeleton.rest_positions
    sides = [side for side in ("left", "right") if f"{side}_foot" in roles]
    drops = [float(rest[roles[f"{side}_ankle"], 1] - rest[roles[f"{side}_foot"], 1]) for side in sides]
    return max(0.0, sum(drops) / len(drops)) if drops else _ANKLE * leg_length(skeleton, roles)


def across(placed: Tensor, roles: Roles, part: str) -> Tensor:
    """Direction from the right to the left one of a part (..., 3); zero where one is missing."""
    if f"left_{part}" not in roles or f"right_{part}" not in roles:
        return torch.zeros_like(placed[..., 0, :])
    return unit(placed[..., roles[f"left_{part}"], :] - placed[..., roles[f"right_{part}"], :])


def shoulder_line(placed: Tensor, roles: Roles) -> Tensor:
    """Direction from right to left shoulder, or collar (..., 3)."""
    line = across(placed, roles, "shoulder")
    return torch.where(line.norm(dim=-1, keepdim=True) > 0.5, line, across(placed, roles, "collar"))


def top(placed: Tensor, roles: Roles) -> Tensor:
    """Where the trunk ends: neck, else between the shoulders, else head, else the highest known joint of the spine."""
    for role in ("neck", "shoulder", "head", "spine3", "spine2", "spine1"):
        if role in roles:
            return placed[..., roles[role], :]
        if f"left_{role}" in roles and f"right_{role}" in roles:
            return centre(placed, roles, role)
    return placed[..., roles["pelvis"], :]


def body_frame(placed: Tensor, roles: Roles) -> Tensor:
    """(..., 3, 3): columns left, up and forward of bodies whose joints are at ``placed`` (..., J, 3).

    Up is the mean of trunk and legs, left that of hips and shoulders, made perpendicular.
    """
    hips, ankles = centre(placed, roles, "hip"), centre(placed, roles, "ankle")
    up = unit(unit(top(placed, roles) - hips) + unit(hips - ankles))
    return frame(across(placed, roles, "hip") + shoulder_line(placed, roles), up)


def frame(left: Tensor, up: Tensor) -> Tensor:
    """(..., 3, 3): columns left, up, forward; up as it is, left made perpendicular to it."""
    up = unit(up)
    left = unit(left - (left * up).sum(-1, keepdim=True) * up)
    return torch.stack((left, up, torch.linalg.cross(left, up)), dim=-1)


def snapped(axes: Tensor) -> Tensor:
    """The axes (3, 3) along those of the world that they nearly are; as they are where they are not."""
    size, nearest = axes.abs().max(dim=0)
    if len(set(nearest.tolist())) < 3 or float(size.min()) < _SNAP:
        return axes
    return torch.stack([nearest_axis(column) for column in axes.T], dim=-1)


def nearest_axis(v: Tensor) -> Tensor:
    """(3,) the axis of the world nearest to a direction."""
    axis = int(v.abs().argmax())
    out = torch.zeros(3, dtype=torch.float64)
    out[axis] = v[axis].sign()
    return out


def to_upright(axes: Tensor) -> Tensor:
    """(4,) the rotation that takes left, up, forward (3, 3) to +X, +Y, +Z."""
    return rotations.from_matrix(axes.T)


def _degrees(v: Tensor, axis: Tensor) -> Tensor:
    """Angle (...) between directions; zero where one has no length."""
    angle = torch.rad2deg(torch.atan2(torch.linalg.cross(v, axis.expand_as(v)).norm(dim=-1), (v * axis).sum(-1)))
    return torch.where(v.norm(dim=-1) > 0.5, angle, 0.0)


def posture(placed: Tensor, roles: Roles, axes: Tensor) -> dict[str, Tensor]:
    """How far, in degrees (...), a body's parts point from where they point in somebody who stands with level arms.

    Args:
        placed: (..., J, 3).
        axes: (..., 3, 3) left, up, forward.
    """
    placed = placed @ axes
    x, y, z = torch.eye(3, dtype=placed.dtype)
    hips = centre(placed, roles, "hip")
    out = {
        "trunk": _degrees(unit(top(placed, roles) - hips), y),
        "hips": _degrees(across(placed, roles, "hip"), x),
        "shoulders": _degrees(shoulder_line(placed, roles), x),
    }
    chain = [role for role in ("spine1", "spine2", "spine3", "neck", "head") if role in roles]
    for start, end in itertools.pairwise(chain):
        bone = unit(placed[..., roles[end], :] - placed[..., roles[start], :])
        out["head" if end == "head" else f"{start} to {end}"] = _degrees(bone, y)
    for side, out_ward in (("left", x), ("right", -x)):
        bones = {
            start: unit(placed[..., roles[f"{side}_{end}"], :] - placed[..., roles[f"{side}_{start}"], :])
            for start, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
            if f"{side}_{start}" in roles and f"{side}_{end}" in roles
        }
        for part, bone in bones.items():
            out[f"{side}_{part}"] = _degrees(bone, -y if part in ("hip", "knee") else out_ward)
        for joint, upper, lower in (("knee", "hip", "knee"), ("elbow", "shoulder", "elbow")):
            if upper in bones and lower in bones:
                out[f"{side} {joint} bend"] = _degrees(bones[upper], bones[lower])
        if f"{side}_foot" in roles:
            toes = unit(placed[..., roles[f"{side}_foot"], :] - placed[..., roles[f"{side}_ankle"], :])
            out[f"{side} toes"] = _degrees(toes, z)
    return out


# How far each part may be from standing: for a rest pose to be one (any pose of the arms that arms can have), and for
# a frame to be an unmistakable T-pose, as actors stand in it, or A-pose, which is less unmistakable.
_STANDING = {"trunk": 35.0, "hips": 30.0, "shoulders": 35.0, "head": 75.0, "toes": 82.0, "to": 65.0, "knee bend": 50.0,
             "elbow bend": 80.0, "hip": 45.0, "knee": 50.0, "shoulder": 115.0, "elbow": 135.0}  # fmt: skip
_T_POSE = {"trunk": 15.0, "hips": 12.0, "shoulders": 12.0, "head": 50.0, "toes": 60.0, "to": 35.0, "knee bend": 30.0,
           "elbow bend": 25.0, "hip": 18.0, "knee": 20.0, "shoulder": 25.0, "elbow": 25.0}  # fmt: skip
_A_POSE = _T_POSE | {"knee bend": 10.0, "elbow bend": 12.0, "shoulder": 62.0, "elbow": 62.0}


def _excess(found: Mapping[str, Tensor], limits: Mapping[str, float]) -> Tensor:
    """(...): the worst part's angle as a share of what it may be."""
    parts = []
    for part, angle in found.items():
        limit = limits.get(part) or next(limit for end, limit in limits.items() if _ends(part, end))
        parts.append(angle / limit)
    return torch.stack(parts).amax(dim=0)


def _ends(part: str, end: str) -> bool:
    return " to " in part if end == "to" else part.endswith((f"_{end}", f" {end}"))


def unlike_standing(placed: Tensor, roles: Roles, axes: Tensor) -> Tensor:
    """(...): at most 1 where a rest pose (..., J, 3) is that of a standing body, arms in any pose."""
    return _excess(posture(placed, roles, axes), _STANDING)


def unlike_t_pose(placed: Tensor, roles: Roles, axes: Tensor) -> Tensor:
    """(...): at most 1 where a pose is unmistakably a T- or A-pose, and the less the better.

    Legs and arms are nearly straight, arms level, or lowered alike and beside the body.
    """
    found = posture(placed, roles, axes)
    if not {"left_shoulder", "right_shoulder"} <= set(found):
        return torch.full_like(found["trunk"], torch.inf)
    lowered = torch.maximum(_excess(found, _A_POSE), (found["left_shoulder"] - found["right_shoulder"]).abs() / 12.0)
    for side in ("left", "right"):
        arm = unit(placed[..., roles[f"{side}_elbow"], :] - placed[..., roles[f"{side}_shoulder"], :])
        lowered = torch.maximum(lowered, (arm * axes[..., 2]).sum(-1).abs() / 0.35)
    return torch.minimum(_excess(found, _T_POSE), lowered)
