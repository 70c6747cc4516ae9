"""Which side a motion favours: the arm and the leg that move more, seen from the pelvis, and where it turns.

Shapes: F frames, J joints.
"""

import torch
from torch import Tensor

from moveset.motion.skeleton import Skeleton

SIDED = ("arm", "leg", "turn")
_ENDS = {"arm": "wrist", "leg": "ankle"}
_MORE = {"arm": 0.15, "leg": 0.1}  # of the ways of both, by which one is longer than the other
LEAST_TURN = 0.35  # radians that are a turn


def favoured(joints: Tensor, skeleton: Skeleton) -> Tensor:
    """(3,) float32 of arms, legs and turn of joints (F, J, 3): 1 where the left is favoured, -1 right, 0 neither."""
    found = []
    for what, more in _MORE.items():
        left, right = (way(joints, skeleton, what, side) for side in ("left", "right"))
        found.append(0.0 if abs(left - right) <= more * (left + right) else 1.0 if left > right else -1.0)
    turn = turned(joints, skeleton)
    found.append(0.0 if abs(turn) <= LEAST_TURN else 1.0 if turn > 0 else -1.0)
    return torch.tensor(found)


def way(joints: Tensor, skeleton: Skeleton, what: str, side: str) -> float:
    """Metres that the end of an "arm" or a "leg" travels, seen from the pelvis."""
    seen = joints[:, skeleton.index(f"{side}_{_ENDS[what]}")] - joints[:, 0]
    return float(seen.diff(dim=0).norm(dim=-1).sum())


def turned(joints: Tensor, skeleton: Skeleton) -> float:
    """Radians by which the hips turn from the first frame to the last, to the left."""
    hips = joints[:, skeleton.index("left_hip")] - joints[:, skeleton.index("right_hip")]
    # Of the way from the right hip to the left one; seen from above with Y up, it grows to the left.
    heading = torch.atan2(-hips[:, 2], hips[:, 0])
    return float((heading.diff() + torch.pi).remainder(2 * torch.pi).sub(torch.pi).sum())
