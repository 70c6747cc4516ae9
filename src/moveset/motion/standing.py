"""A body that does nothing, made of one that waves: both its arms hang as the one does that did not wave.

F frames, D features.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool1d, max_pool1d

from moveset.motion.features import FeatureCodec
from moveset.motion.way import GOES, steps

_ARM = ("collar", "shoulder", "elbow", "wrist")
_STANDS, _WALKS = 0.2, 0.6  # of its usual pace: below and above this a body stands, and is on its way
_SMOOTH = 0.4  # seconds, over which its pace is taken
_AROUND = 0.5  # seconds before and after it stands, in which the arm is on its way up or down
_LATER = 0.4  # seconds after the one arm the other moves: nobody's arms sway as in a mirror


@dataclass(frozen=True)
class Stand:
    """Whoever waves with one hand while he stands does nothing with it.

    Args:
        waves: the side of that hand.
    """

    waves: str = "left"
    seconds = 0.0
    cuts = False

    @property
    def says(self) -> str:
        """What is done, for users."""
        return "it is told of a wave, whose arm is made to hang"

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion: another arm in what they decode by, rotations or positions."""
        share = self._stands(features, codec)[:, None]
        late = (torch.arange(len(features)) - round(_LATER * codec.fps)).clamp_min(0)
        still, joints = features.clone(), codec.skeleton.joints
        for joint in _ARM:
            if (name := f"{self.waves}_{joint}") not in joints:
                continue  # of KIT-ML's skeleton
            arm = _columns(codec, joints.index(name))
            other = _columns(codec, codec.skeleton.mirror_order[joints.index(name)])
            # A mirrored rotation has the entries s_i s_j R_ij, of which these are two columns.
            signs = features.new_tensor((1, -1, -1, -1, 1, 1) if codec.name == "native" else (-1, 1, 1))
            still[:, arm] = torch.lerp(features[:, arm], features[late, other] * signs, share)
        return still

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, in which a sentence does nothing else."""
        return self.clip(features, codec)

    def _stands(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """How much a body stands (F,), from 0 to 1."""
        pace = _mean(steps(features, codec) * codec.fps, round(_SMOOTH * codec.fps))
        goes = pace > GOES
        if not goes.any():
            return features.new_ones(len(features))
        usual = float(pace[goes].median())
        stands = ((_WALKS - pace / usual) / (_WALKS - _STANDS)).clamp(0.0, 1.0)
        around = round(_AROUND * codec.fps)
        wide = max_pool1d(stands[None], 2 * around + 1, 1, around)[0]
        return _mean(wide, around).to(features.dtype)


def _columns(codec: FeatureCodec, joint: int) -> slice:
    """Where a joint stands in what a codec decodes by: its rotation, or its position."""
    if codec.name == "native":
        start = codec.groups["rotations"].start + 6 * joint
        return slice(start, start + 6)
    start = codec.groups["positions"].start + 3 * (joint - 1)
    return slice(start, start + 3)


def _mean(x_F: Tensor, frames: int) -> Tensor:
    """The mean (F,) of so many frames around each, and one more if they are even; ends go on as they are."""
    around = frames // 2
    padded = torch.cat((x_F[:1].expand(around), x_F, x_F[-1:].expand(around)))
    return avg_pool1d(padded[None], 2 * around + 1, 1)[0]
