"""Which side a motion favours: the arm and the leg that move more, seen from the pelvis, and where it turns.

Shapes: F frames, J joints.
"""

import torch
from torch import Tensor

from moveset.motion.skeleton import Skeleton

SIDED = ("arm", "leg", "turn")
_ENDS = {"arm": "wrist", "leg": "ankle"}
MORE = {"arm": 0.15, "leg": 0.1}  # of the ways of both, by which one is longer than the other
LEAST_TURN = 0.35  # radians that are a turn
_CLEARLY = 2 * MORE["arm"]


def favoured(joints: Tensor, skeleton: Skeleton) -> Tensor:
    """(3,) float32 of arms, legs and turn of joints (F, J, 3): 1 where the left is favoured, -1 right, 0 neither."""
    limbs = more_left(joints[None], torch.tensor([len(joints)]), skeleton)[0]
    found = torch.cat((limbs, limbs.new_tensor([turned(joints, skeleton)])))
    least = found.new_tensor([*MORE.values(), LEAST_TURN])
    return (found.sign() * (found.abs() > least)).float()


def more_left(joints_BFJ3: Tensor, frames_B: Tensor, skeleton: Skeleton) -> Tensor:
    """(B, 2) by how much the left arm and the left leg travel more than the right ones, in shares of the ways of both.

    Args:
        frames_B: of each; what lies beyond them is left out.
    """
    steps_BFJ = (joints_BFJ3 - joints_BFJ3[:, :, :1]).diff(dim=1).norm(dim=-1)
    within = torch.arange(1, joints_BFJ3.shape[1], device=frames_B.device) < frames_B[:, None]
    way_BJ = (steps_BFJ * within[..., None]).sum(dim=1)
    found = []
    for end in _ENDS.values():
        left, right = (way_BJ[:, skeleton.index(f"{side}_{end}")] for side in ("left", "right"))
        found.append((left - right) / (left + right).clamp(min=1e-3))
    return torch.stack(found, dim=1)


def shortfall(more_left_B2: Tensor, told_B2: Tensor, shown_B2: Tensor | None = None) -> Tensor:
    """(B, 2) by how much the arm and the leg that are told to (1 left, -1 right) do not clearly travel more.

    Args:
        shown_B2: what an example shows, of which no more is asked for.
    """
    asked_B2 = torch.full_like(told_B2, _CLEARLY)
    if shown_B2 is not None:
        asked_B2 = (told_B2 * shown_B2).clamp(max=_CLEARLY)
    return (asked_B2 - told_B2 * more_left_B2).relu()


def turned(joints: Tensor, skeleton: Skeleton) -> float:
    """Radians by which the hips turn from the first frame to the last, to the left."""
    hips = joints[:, skeleton.index("left_hip")] - joints[:, skeleton.index("right_hip")]
    # Of the way from the right hip to the left one; seen from above with Y up, it grows to the left.
    heading = torch.atan2(-hips[:, 2], hips[:, 0])
    return float((heading.diff() + torch.pi).remainder(2 * torch.pi).sub(torch.pi).sum())
