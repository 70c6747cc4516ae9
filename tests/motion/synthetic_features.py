"""Features of synthetic motions."""

from torch import Tensor

from moveset.motion.native import NativeCodec
from tests.synthetic import synthetic_motion

NATIVE = NativeCodec()


def features(kind: str = "walk", frames: int = 120) -> Tensor:
    """Native features (F, D) of a motion of that kind."""
    return NATIVE.encode(synthetic_motion(kind, frames))
