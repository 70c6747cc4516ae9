"""A body that stands stays where it is: the root's drift, as its planted feet show it, is taken out.

A step of the root and the legs' posture are separate features, and what a network makes of them differs: who stands on
both feet glides by centimetres a second. Locking the feet alone would stretch the legs until they let go. The foot that
carries a walk slides, too, for legs that are blurred to a mean swing too little for their way; a root that gave way to
that would walk slowly.
Shapes: F frames of a segment, S = F - 1 steps between them, D features.
"""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool1d, conv1d, pad

from moveset.motion.contacts import stands_on
from moveset.motion.features import FeatureCodec

_ALONE = 0.5  # share of a lone foot's sliding that the root gives up; the rest is for the foot lock
_DRIFTS, _TRAVELS = 0.1, 0.3  # m/s of planted feet: a standing body's are slower, those of one on its way are faster
_EASE = 5  # steps over which holding sets in and ends
_SMOOTH = (0.25, 0.5, 0.25)


def hold_root(features_FD: Tensor, planted_F4: Tensor, codec: FeatureCodec) -> Tensor:
    """Features, not normalised, whose root does not drift while both feet stand, and less where one does.

    From one frame to the next the root's planar step loses what the joints that are planted in both travel on average:
    all of it where both feet stand, half where one does, and nothing of a body whose planted feet are faster than a
    standing one's. It sets in and ends within a few frames, and the last frame's step, which leads to the next segment,
    loses as much as the one before it. Nothing else is changed, and nothing at all of who does not stand on the legs.

    Args:
        planted_F4: bool, as in the codec's contacts: left ankle, left toe, right ankle, right toe.
    """
    if not bool(planted_F4.any()):
        return features_FD
    body = codec.joints(features_FD)
    planted_F4 = planted_F4 & stands_on(body, codec.skeleton)[:, None]
    stays_S4 = planted_F4[1:] & planted_F4[:-1]
    left_S, right_S = stays_S4[:, :2].any(dim=1), stays_S4[:, 2:].any(dim=1)
    if not bool((left_S | right_S).any()):
        return features_FD
    joints = body[:, list(codec.skeleton.feet)]
    moved_S42 = joints.diff(dim=0)[..., [0, 2]]
    share_S41 = stays_S4.to(moved_S42.dtype)[..., None]
    drift_S2 = (moved_S42 * share_S41).sum(dim=1) / share_S41.sum(dim=1).clamp_min(1)
    # A drift that stops at once would be a jolt.
    held_S = (left_S & right_S) + _ALONE * (left_S ^ right_S).to(drift_S2.dtype)
    going_S = ((drift_S2.norm(dim=1) * codec.fps - _DRIFTS) / (_TRAVELS - _DRIFTS)).clamp(0.0, 1.0)
    held_S = held_S * (1.0 - going_S)
    eased_S = avg_pool1d(pad(held_S[None, None], (_EASE // 2, _EASE // 2), mode="replicate"), _EASE, 1)[0, 0]
    drift_2S = (drift_S2 * torch.minimum(eased_S, held_S)[:, None]).T
    drift_2S = conv1d(pad(drift_2S[:, None], (1, 1), mode="replicate"), drift_2S.new_tensor([[_SMOOTH]]))[:, 0]
    return codec.with_steps(features_FD, -drift_2S.T)
