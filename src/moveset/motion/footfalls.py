"""Walks of so many steps, and standing for longer than it was made. F frames, D features."""

from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.motion.cleanup import lock_feet
from moveset.motion.clip import Motion
from moveset.motion.contacts import PLANTED
from moveset.motion.features import FeatureCodec
from moveset.motion.way import GOES, steps

_STEP = 0.2  # metres; a foot that comes down nearer to where it was has only shifted
_HELD, _LOW = 0.3, 0.1  # metres a second and metres: below both a foot stands
_STANDS = 2.0  # seconds that are left after the last step
_ENDS = 0.5  # seconds after a body has stopped in which its last foot comes down
_STEP_SECONDS, _ELSE_SECONDS, _LEAST_SECONDS = 1.1, 3.0, 7.0  # half of a motion of two stages is its first


@dataclass(frozen=True)
class Steps:
    """Whoever walks and then stands takes so many steps, the last ones of those that were made.

    Args:
        count: at least 1.
        then: something else is done afterwards, and stays; else standing is cut to ``_STANDS``.
    """

    count: int
    then: bool = False
    cuts = True

    @property
    def says(self) -> str:
        """What is done, for users."""
        return f"what comes before the last {self.count} is cut off"

    @property
    def seconds(self) -> float:
        """How long a motion should be made in which there are so many steps."""
        return max(_STEP_SECONDS * self.count + _ELSE_SECONDS, _LEAST_SECONDS)

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F' <= F, D) of a whole motion, from the step before these on."""
        stop = _stop(features, codec)
        planted = features[:, codec.groups["contacts"]] > PLANTED
        late = stop + round(_ENDS * codec.fps)
        # Feet take other steps once they are held where they stand.
        falls = [at for at in footfalls(lock_feet(codec.decode(features), contacts=planted)) if at <= late]
        begin = max((at for at in falls[: -self.count] if at < falls[-self.count]), default=0)
        return features[begin : None if self.then else late + round(_STANDS * codec.fps)]

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, which goes on."""
        return features


def footfalls(motion: Motion) -> list[int]:
    """Frames in which feet come down, in order, of a motion whose feet hold still while they stand.

    They come down at another place than they stood at, or out of the air in which they were in the first frame.
    """
    falls = []
    for toe, stands in zip(motion.skeleton.feet[1::2], _stances(motion), strict=True):
        before = None
        for begin, end in stands:
            here = motion.joints[begin:end, toe].double()[:, [0, 2]].mean(dim=0)
            if begin > 1 if before is None else float((here - before).norm()) >= _STEP:
                falls.append(begin)
            before = here
    return sorted(falls)


def stand_on(features: Tensor, codec: FeatureCodec, frames: int) -> Tensor:
    """Features (frames, D): of F of at least 2 frames, the end of which, where a body stands, lasts so much longer.

    More frames than are wanted are cut off.
    """
    more = frames - len(features)
    if more <= 0:
        return features[:frames]
    still = min(_stop(features, codec) + 1, len(features) - 2)
    tail = features[still:]
    at = torch.linspace(0.0, len(tail) - 1.0, len(tail) + more, dtype=torch.float64)
    low = at.floor().long().clamp_max(len(tail) - 2)
    longer = torch.lerp(tail[low], tail[low + 1], (at - low)[:, None].to(tail.dtype))
    for rate in ("root_yaw", "root_velocity", "velocities"):
        longer[:, codec.groups[rate]] *= len(tail) / len(longer)
    return torch.cat((features[:still], longer))


def _stop(features: Tensor, codec: FeatureCodec) -> int:
    """The last frame in which a body is on its way."""
    goes = (steps(features, codec) * codec.fps > GOES).nonzero()
    return int(goes[-1]) if len(goes) else 0


def _stances(motion: Motion) -> list[list[tuple[int, int]]]:
    """The first frame and the one after the last of every stance of the left foot and of the right one."""
    joints = motion.joints.double()[:, list(motion.skeleton.feet[1::2])]
    pace = joints[..., [0, 2]].diff(dim=0).norm(dim=-1) * motion.fps
    stands = (pace < _HELD) & (joints[1:, :, 1] < _LOW)
    return [[(begin, end + 1) for begin, end in _runs(foot)] for foot in stands.unbind(1)]


def _runs(marks: Tensor) -> list[tuple[int, int]]:
    """Where runs of True (F,) begin and end."""
    edges = torch.diff(marks.int(), prepend=marks.new_zeros(1).int(), append=marks.new_zeros(1).int())
    begins, ends = (edges == 1).nonzero().flatten().tolist(), (edges == -1).nonzero().flatten().tolist()
    return list(zip(begins, ends, strict=True))
