"""When a foot is planted: low and slow. Height alone is not contact, since swinging toes stay low in real takes."""

import torch
from torch import Tensor

from moveset.motion.skeleton import Skeleton

TOE_HEIGHT = 0.05
ANKLE_HEIGHT = 0.12
SPEED = 0.5


def foot_contacts(joints: Tensor, fps: float, skeleton: Skeleton) -> Tensor:
    """Planted feet, (F, 4) bool: left ankle, left toe, right ankle, right toe.

    A joint is planted where it is below its height limit (toe 5 cm, ankle 12 cm above the floor y = 0) and moves slower
    than 0.5 m/s to the next frame; the last frame repeats the one before.

    Args:
        joints: (F, J, 3) world positions in metres, F >= 2.
        fps: frames per second.
    """
    feet = joints[:, list(skeleton.feet)]
    speed = (feet[1:] - feet[:-1]).norm(dim=-1) * fps
    speed = torch.cat((speed, speed[-1:]))
    limits = feet.new_tensor((ANKLE_HEIGHT, TOE_HEIGHT, ANKLE_HEIGHT, TOE_HEIGHT))
    return (feet[..., 1] < limits) & (speed < SPEED)
