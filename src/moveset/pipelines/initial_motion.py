"""A given clip as the first segment of a stream: its last frames as features, and where in the world they are.

Shapes: n frames of a segment, D features.
"""

from dataclasses import dataclass, replace

from torch import Tensor

from moveset.diffusion.steps import add_noise
from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.features import FeatureCodec
from moveset.motion.native import NativeCodec
from moveset.motion.retarget import retarget
from moveset.rdm.noise import START
from moveset.rdm.sequential import Solver
from moveset.rdm.staircase import Staircase
from moveset.rdm.state import StreamState


@dataclass(frozen=True, eq=False)
class InitialMotion:
    """The last segment of a clip.

    Args:
        features: (n, D), not normalised.
        heading: of its first frame, radians.
        x, z: of its first frame, metres.
    """

    features: Tensor
    heading: float
    x: float
    z: float

    @classmethod
    def of(cls, motion: Motion, codec: FeatureCodec, frames: int) -> "InitialMotion":
        """The last ``frames`` frames of a motion, on the codec's skeleton at its frame rate.

        Raises:
            InputError: a skeleton that cannot be retargeted, a shorter motion, or features that re-pose what they
                encode, so that a stream would not go on from it.
        """
        if not isinstance(codec, NativeCodec):
            raise InputError(f"a model of {codec.name!r} features cannot go on from a motion; take one of native ones")
        motion = retarget(motion, codec.skeleton)
        given, motion = motion, motion.resampled(codec.fps)
        if len(motion) < frames:
            raise InputError(
                f"a seed motion of {len(given)} frames at {given.fps:g} fps lasts {given.seconds:.2f} s; give at least "
                f"{frames / codec.fps:g} s ({frames} frames at {codec.fps:g} fps)"
            )
        last = motion[-frames:]
        last = replace(last, rotations=last.rotations.float(), root=last.root.float(), skeleton=codec.skeleton)
        heading = rotations.heading_angle(rotations.heading(last.rotations[0, 0]))
        return cls(codec.encode(last), float(heading), float(last.root[0, 0]), float(last.root[0, 2]))

    def state(self, left_1nD: Tensor, solver: Solver, plan: Staircase, seed: int) -> StreamState:
        """A sampler that has finished segment 0, this clip, and is about to take in segment 1.

        Args:
            left_1nD: the features, normalised, on the device.
        """
        waiting = None
        if at := plan.entry(1) if plan.has(1) else 0:
            # What segment 1 begins with is a noisy neighbour, which was never sampled here: the clip with noise on it.
            noise = solver.noise([seed], [0], START, left_1nD.shape[1:]).to(left_1nD)
            level = left_1nD.new_full((1,), solver.levels[at]).long()
            waiting = add_noise(solver.schedule, left_1nD, noise, level)
        return StreamState(wave=plan.begin(1), finished=1, left=left_1nD, waiting=waiting)
