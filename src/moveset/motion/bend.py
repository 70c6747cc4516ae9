"""Bends the way of a motion: the same steps, on a path that turns otherwise.

Native features are seen from their own heading, so what is added to their yaw step bends the way and leaves everything
else as it was: steps, pace, and which feet stand. Feet that turn with it may slide; ``cleanup.lock_feet`` holds them.

Angles are radians, to the left above zero. F frames, D features.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from moveset.motion.native import NativeCodec

# The most that feet can follow:
_TIGHTEST = 0.4  # metres, radius of a way; who stands and sways does not spin
_FASTEST = math.radians(120.0)  # a second; a run leans into it, a walk trips


def steps(features_FD: Tensor, codec: NativeCodec) -> Tensor:
    """Metres (F,), float64, that the root travels over the ground to the next frame."""
    return features_FD[:, codec.groups["root_velocity"]].double().norm(dim=1)


def led(features_FD: Tensor, codec: NativeCodec, heading: Callable[[Tensor], Tensor]) -> Tensor:
    """Bent along a path, as far as feet can follow: (F, D).

    Args:
        heading: radians by which the path has turned after so many metres, (F + 1,) to (F + 1,).
    """
    steps_F = steps(features_FD, codec)
    gone = steps_F.cumsum(0)
    most_F = (steps_F / _TIGHTEST).clamp_max(_FASTEST / codec.fps)
    added_F = heading(torch.cat((gone.new_zeros(1), gone))).diff().clamp(-most_F, most_F)
    bent_FD = features_FD.clone()
    bent_FD[:, codec.groups["root_yaw"]] += added_F[:, None].to(bent_FD.dtype)
    return bent_FD
