"""Analytic inverse kinematics of two bones: hip, knee and ankle, or shoulder, elbow and wrist."""

import torch
from torch import Tensor

from moveset.motion import rotations

# The longest reach as a share of the straight limb: at the very end of its reach a knee moves infinitely fast.
REACH = 0.9995
_CLEARLY_BENT = 0.1  # sine of the knee's angle


def two_bone(
    upper: Tensor, lower: Tensor, start: Tensor, middle: Tensor, end: Tensor, target: Tensor, hinge: Tensor
) -> tuple[Tensor, Tensor]:
    """World rotations of both bones that bring the limb's end to a target, turning as little as possible.

    The knee bends or stretches in the plane that it is bent in already, to the same side; then the whole limb swings by
    the shortest arc. A target out of reach is approached as far as the limb goes (a limb that is straighter than
    ``REACH`` already may stay so), one nearer than the folded limb as near as it folds.

    Args:
        upper: (..., 4) world rotation of the bone from start to middle.
        lower: (..., 4) world rotation of the bone from middle to end.
        start: (..., 3) world position of the hip.
        middle: (..., 3) of the knee.
        end: (..., 3) of the ankle.
        target: (..., 3) where the ankle should be.
        hinge: (..., 3) world axis that the knee bends about (straight to bent, right-handed), which decides the plane
            of a straight limb.

    Returns:
        The new world rotations of both bones, (..., 4) each.
    """
    thigh, shin = middle - start, end - middle
    a, b = thigh.norm(dim=-1), shin.norm(dim=-1)
    reach = (end - start).norm(dim=-1)
    longest = torch.maximum(REACH * (a + b), torch.minimum(reach, a + b))
    wanted = torch.minimum((target - start).norm(dim=-1), longest)
    wanted = torch.maximum(wanted, (a - b).abs() + 1e-6 * (a + b))

    axis, side = _bend(thigh, shin, hinge)
    cosine = ((wanted**2 - a**2 - b**2) / (2 * a * b).clamp_min(1e-12)).clamp(-1.0, 1.0)
    sine = side * (1.0 - cosine**2).sqrt()
    along = torch.nn.functional.normalize(thigh, dim=-1)
    folded = b[..., None] * (cosine[..., None] * along + sine[..., None] * torch.linalg.cross(axis, along))
    fold = rotations.between(shin, folded)

    swing = rotations.between(thigh + folded, target - start)
    turned = rotations.mul(swing, rotations.mul(fold, lower))
    return rotations.normalize(rotations.mul(swing, upper)), rotations.normalize(turned)


def _bend(thigh: Tensor, shin: Tensor, hinge: Tensor) -> tuple[Tensor, Tensor]:
    """The unit axis that the knee bends about, across the thigh and on the side of the hinge, and the bend's sense.

    The axis is that of the plane the limb lies in, and passes over to the hinge's own as the limb gets straight.
    """
    across = torch.linalg.cross(thigh, shin)
    size = thigh.norm(dim=-1, keepdim=True) * shin.norm(dim=-1, keepdim=True)
    flat = hinge - thigh * (hinge * thigh).sum(-1, keepdim=True) / (thigh * thigh).sum(-1, keepdim=True).clamp_min(
        1e-12
    )
    backward = (across * flat).sum(-1, keepdim=True) < 0
    sure = (across.norm(dim=-1, keepdim=True) / (_CLEARLY_BENT * size).clamp_min(1e-12)).clamp(max=1.0)
    bent = torch.nn.functional.normalize(torch.where(backward, -across, across), dim=-1)
    axis = sure * bent + (1.0 - sure) * torch.nn.functional.normalize(flat, dim=-1)
    # Noise bends a straight knee a little backward, which is no reason to bend it further that way.
    side = torch.where(backward & (sure >= 1.0), -1.0, 1.0).to(thigh)
    return torch.nn.functional.normalize(axis, dim=-1), side[..., 0]
