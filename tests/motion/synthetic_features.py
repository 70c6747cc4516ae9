"""Features of synthetic motions, whatever the codec."""

from torch import Tensor

from moveset.motion.features import FeatureCodec
from moveset.motion.native import NativeCodec
from moveset.motion.retarget import retarget
from tests.synthetic import synthetic_motion

NATIVE = NativeCodec()


def features(kind: str = "walk", frames: int = 120, codec: FeatureCodec = NATIVE) -> Tensor:
    """Features (F, D) of a motion of that kind, at the rate and on the skeleton of the codec."""
    motion = synthetic_motion(kind, frames, fps=codec.fps)
    return codec.encode(retarget(motion, codec.skeleton) if codec.name == "kit" else motion)
