"""Bends the way of a motion: the same steps, on a path that turns otherwise.

Features of every codec are seen from their own heading, so what is added to their yaw step bends the way and leaves
everything else as it was: steps, pace, and which feet stand. Feet that turn with it may slide; ``cleanup.lock_feet``
holds them.

Angles are radians, to the left above zero. F frames, D features.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from moveset.motion.features import FeatureCodec

# What 1 is in a codec's features: radians to the left (T2M's half-angles turn the world, KIT-ML's in a mirror); metres.
_YAW = {"native": 1.0, "hml": -2.0, "kit": 2.0}
_METRES = {"native": 1.0, "hml": 1.0, "kit": 0.001}
# The most that feet can follow:
_TIGHTEST = 0.4  # metres, radius of a way; who stands and sways does not spin
_FASTEST = math.radians(120.0)  # a second; a run leans into it, a walk trips
_SHARPEST = 2.0  # times as fast as it was made a turn is made
_TURNING = math.radians(30.0)  # in all; whoever turns by less does not turn


def steps(features_FD: Tensor, codec: FeatureCodec) -> Tensor:
    """Metres (F,), float64, that the root travels over the ground to the next frame."""
    return features_FD[:, codec.groups["root_velocity"]].double().norm(dim=1) * _METRES[codec.name]


def turned_by(features_FD: Tensor, codec: FeatureCodec) -> float:
    """From the first frame to the last; the last step leads out of the motion."""
    return _YAW[codec.name] * float(features_FD[:-1, codec.groups["root_yaw"]].double().sum())


def arc(features_FD: Tensor, codec: FeatureCodec, curvature: float) -> Tensor:
    """Bent by ``curvature`` radians a metre, as far as feet can follow: (F, D)."""
    return _bent(features_FD, codec, curvature * steps(features_FD, codec))


def led(features_FD: Tensor, codec: FeatureCodec, heading: Callable[[Tensor], Tensor]) -> Tensor:
    """Bent along a path, as far as feet can follow: (F, D).

    Args:
        heading: radians by which the path has turned after so many metres, (F + 1,) to (F + 1,).
    """
    gone = steps(features_FD, codec).cumsum(0)
    return _bent(features_FD, codec, heading(torch.cat((gone.new_zeros(1), gone))).diff())


def turn(features_FD: Tensor, codec: FeatureCodec, angle: float) -> Tensor:
    """Bent so that the last frame faces ``angle`` from where the first does, as far as feet can follow: (F, D).

    A turn to that side is made so much sharper, or wider, where it is; what that does not bring is spread along the
    way. Whoever stands turns no further.
    """
    turned = turned_by(features_FD, codec)
    share = angle / turned if turned * angle > 0 and abs(turned) >= _TURNING else 1.0
    scaled_FD = features_FD.clone()
    scaled_FD[:, codec.groups["root_yaw"]] *= min(share, _SHARPEST)
    way = float(steps(scaled_FD[:-1], codec).sum())
    return arc(scaled_FD, codec, (angle - turned_by(scaled_FD, codec)) / way) if way > 0 else scaled_FD


def _bent(features_FD: Tensor, codec: FeatureCodec, added_F: Tensor) -> Tensor:
    most_F = (steps(features_FD, codec) / _TIGHTEST).clamp_max(_FASTEST / codec.fps)
    added_F = added_F.clamp(-most_F, most_F)
    bent_FD = features_FD.clone()
    bent_FD[:, codec.groups["root_yaw"]] += (added_F / _YAW[codec.name])[:, None].to(bent_FD.dtype)
    return bent_FD
