"""From a capture's world rotations to ``hml22``: R_hml = R_source · A with one constant A per joint.

The constants were measured on the takes themselves: knees and elbows come out as pure hinges and a standing foot as
flat. Rotations decide over positions: hip, collar and spine bones of the sources point elsewhere than those of hml22,
and only the rotations mean the same on both. F frames, J = 22 joints; float64.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.kinematics import global_to_local
from moveset.motion.skeleton import HML22

FPS = 20.0
#: (3,) middle of the hips in the pelvis.
HIPS = HML22.offsets[1:3].double().mean(dim=0)
_LEG = float(HML22.offsets[[4, 7]].double().norm(dim=-1).sum())


def turn(axis: str, degrees: float) -> Tensor:
    """A constant rotation (4,) float64 about "x", "y" or "z"."""
    return rotations.about(axis, torch.tensor(degrees, dtype=torch.float64))


def assemble(turned: Mapping[str, Tensor], hip_centre: Tensor, leg: float) -> tuple[Tensor, Tensor]:
    """Local rotations (F, J, 4) and root path (F, 3) on ``hml22``.

    Args:
        turned: joint name to world rotation (F, 4), already multiplied by its constant. Without "spine1", which is
            halfway between pelvis and spine2; "neck" may be missing, and is halfway between spine3 and head.
        hip_centre: (F, 3) midpoint of the source's hip joints, metres.
        leg: the source's length of thigh and shin, metres; the root path is scaled by the ratio of leg lengths.

    Returns:
        Rotations whose signs are continuous in time, and the root placed so that the hip centres coincide: the
        sources' own root joints sit 6 to 11 cm from where hml22 has its pelvis.
    """
    spine1 = rotations.slerp(turned["pelvis"], turned["spine2"], 0.5)
    neck = rotations.slerp(turned["spine3"], turned["head"], 0.5)
    turned = {"neck": neck, **turned, "spine1": spine1}
    local = global_to_local(torch.stack([turned[joint] for joint in HML22.joints], dim=1), HML22)
    root = hip_centre * (_LEG / leg) - rotations.rotate(turned["pelvis"], HIPS)
    return rotations.unroll(local), root
