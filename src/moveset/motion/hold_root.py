"""A body that stands on both feet stays where it is: the root's drift, as its planted feet show it, is taken out.

A step of the root and the legs' posture are separate features, and what a network makes of them differs by a few
centimetres a second. While one foot swings nobody sees it; who stands glides. Locking the feet alone would stretch the
legs until they let go.
Shapes: F frames of a segment, D features.
"""

import torch
from torch import Tensor

from moveset.motion.native import NativeCodec


def hold_root(features_FD: Tensor, planted_F4: Tensor, codec: NativeCodec) -> Tensor:
    """Features, not normalised, whose root does not travel while both feet stand; nothing else is changed.

    From one frame to the next, where both feet are planted in both, the root's planar step loses what the planted
    joints travel on average. The change sets in and ends within a frame, and the last frame's step, which leads to the
    next segment, loses as much as the one before it.

    Args:
        planted_F4: bool, as in the codec's contacts: left ankle, left toe, right ankle, right toe.
    """
    stays_S4 = planted_F4[1:] & planted_F4[:-1]
    both_S = stays_S4[:, :2].any(dim=1) & stays_S4[:, 2:].any(dim=1)
    if not bool(both_S.any()):
        return features_FD
    joints = codec.joints(features_FD)[:, list(codec.skeleton.feet)]
    moved_S42 = joints.diff(dim=0)[..., [0, 2]]
    share_S41 = stays_S4.to(moved_S42.dtype)[..., None]
    drift_S2 = (moved_S42 * share_S41).sum(dim=1) / share_S41.sum(dim=1).clamp_min(1)
    # A window of three steps: a drift that stops at once would be a jolt.
    weight = torch.nn.functional.pad(both_S.to(drift_S2.dtype)[None, None], (1, 1), mode="replicate")
    weight_S1 = torch.nn.functional.avg_pool1d(weight, 3, 1)[0, 0, :, None] * both_S[:, None]
    drift_S2 = drift_S2 * weight_S1
    # Steps are in the heading of the frame that they lead from.
    heading_F = codec.root_path(features_FD)[0]
    sin_S, cos_S = heading_F[:-1].sin(), heading_F[:-1].cos()
    x_S, z_S = drift_S2.unbind(dim=1)
    local_S2 = torch.stack((x_S * cos_S - z_S * sin_S, x_S * sin_S + z_S * cos_S), dim=1)
    held = features_FD.clone()
    steps = codec.groups["root_velocity"]
    held[:-1, steps] -= local_S2
    held[-1, steps] -= local_S2[-1]
    return held
