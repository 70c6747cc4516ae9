"""The way of a motion in its features: how long it is, how far it turns, and the same bent.

Features of every codec are seen from their own heading, so adding to their yaw step bends the way and leaves everything
else as it was made: steps, pace, and which feet stand.

Angles are radians, to the left above zero. F frames, D features.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from moveset.motion.features import FeatureCodec

GOES = 0.3  # metres a second, below which a body stands and sways
FASTEST = math.radians(120.0)  # a second, on a circle: a run leans into it, a walk trips
# What 1 is in a codec's features: radians to the left (T2M's half-angles turn the world, KIT-ML's in a mirror); metres.
YAW = {"native": 1.0, "hml": -2.0, "kit": 2.0}
_METRES = {"native": 1.0, "hml": 1.0, "kit": 0.001}
_TIGHTEST = 0.4  # metres, radius of a way; who stands and sways does not spin


def way_of(features: Tensor, codec: FeatureCodec) -> float:
    """Metres along the way of features (F, D), to the frame after the last one."""
    return float(steps(features, codec).sum())


def turned_by(features: Tensor, codec: FeatureCodec) -> float:
    """From the first frame to the last of features (F, D) of a whole motion; the last step leads out of it."""
    return YAW[codec.name] * float(features[:-1, codec.groups["root_yaw"]].double().sum())


def pace_of(features: Tensor, codec: FeatureCodec) -> float:
    """Metres a second of a body that is on its way; 0 if it never is."""
    pace = steps(features, codec) * codec.fps
    goes = pace > GOES
    return float((pace * goes).sum() / goes.sum().clamp_min(1))


def steps(features: Tensor, codec: FeatureCodec) -> Tensor:
    """Metres (F,) to the next frame."""
    return features[:, codec.groups["root_velocity"]].double().norm(dim=1) * _METRES[codec.name]


def arc(features: Tensor, codec: FeatureCodec, curvature: float) -> Tensor:
    """Bent by ``curvature`` radians a metre, but within ``_TIGHTEST`` and ``FASTEST``."""
    return bent_by(features, codec, curvature * steps(features, codec))


def led(features: Tensor, codec: FeatureCodec, gone: float, heading: Callable[[Tensor], Tensor]) -> Tensor:
    """Bent to a heading (F,) at every way (F,), but within the same, of a piece before which ``gone`` metres lie."""
    way = gone + steps(features, codec).cumsum(0)
    headings = heading(torch.cat((way.new_tensor([gone]), way)))
    return bent_by(features, codec, headings.diff())


def bent_by(features: Tensor, codec: FeatureCodec, bend: Tensor) -> Tensor:
    """Bent by radians (F,) a frame, as far as feet can follow."""
    most = (steps(features, codec) / _TIGHTEST).clamp_max(FASTEST / codec.fps)
    bend = bend.clamp(-most, most)
    bent = features.clone()
    bent[:, codec.groups["root_yaw"]] += (bend / YAW[codec.name])[:, None].to(bent.dtype)
    return bent


def side_of(side: float) -> str:
    """What a side is called: "left" above zero."""
    return "left" if side > 0 else "right"
