"""A body that does nothing, made of one that waves: both its arms hang as the one does that did not wave, and it does
not lean away from the one that did.

F frames, D features.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool1d, max_pool1d

from moveset.motion import rotations
from moveset.motion.features import FeatureCodec
from moveset.motion.kinematics import fk
from moveset.motion.way import GOES, steps

_ARM = ("collar", "shoulder", "elbow", "wrist")
_TORSO = ("spine1", "spine2", "spine3", "neck", "head")
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
        """Features (F, D) of a whole motion: another torso and arms in what they decode by, rotations or positions."""
        share = self._stands(features, codec)
        late = (torch.arange(len(features)) - round(_LATER * codec.fps)).clamp_min(0)
        if codec.name == "native":
            return self._hung(features, codec, share, late)
        still, joints = features.clone(), codec.skeleton.joints
        for name in (f"{self.waves}_{joint}" for joint in _ARM):
            if name in joints:  # KIT-ML's skeleton has no collars
                arm, other = (_place(codec, k) for k in (joints.index(name), _opposite(codec, name)))
                hangs = features[late, other] * features.new_tensor((-1, 1, 1))
                still[:, arm] = torch.lerp(features[:, arm], hangs, share[:, None].to(features.dtype))
        return still

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, in which a sentence does nothing else."""
        return self.clip(features, codec)

    def _hung(self, features: Tensor, codec: FeatureCodec, share: Tensor, late: Tensor) -> Tensor:
        """Features of rotations: the torso leans to no side, and both arms hang in the world as the other one did."""
        skeleton, columns = codec.skeleton, codec.groups["rotations"]
        local = rotations.from_6d(features[:, columns].double().unflatten(1, (-1, 6)))
        mirror, signs = list(skeleton.mirror_order), local.new_tensor((1.0, -1.0, -1.0, 1.0))
        torso = [skeleton.index(joint) for joint in _TORSO]
        arm = [skeleton.index(f"{self.waves}_{joint}") for joint in _ARM]
        mirrored, still = local[late][:, mirror] * signs, local.clone()
        still[:, torso] = rotations.slerp(local[:, torso], mirrored[:, torso], 0.5)
        still[:, arm] = mirrored[:, arm]
        nowhere, shoulders = local.new_zeros(len(local), 3), [arm[1], mirror[arm[1]]]
        turned, _ = fk(local, nowhere, skeleton)
        leans, _ = fk(still, nowhere, skeleton)
        hangs = torch.stack((turned[late][:, shoulders[1]] * signs, turned[:, shoulders[1]]), dim=1)
        collars = leans[:, [skeleton.parents[shoulder] for shoulder in shoulders]]
        still[:, shoulders] = rotations.mul(rotations.inv(collars), hangs)
        touched = [*torso, *arm, shoulders[1]]
        blended = rotations.to_6d(rotations.slerp(local[:, touched], still[:, touched], share[:, None]))
        six = (columns.start + 6 * torch.tensor(touched)[:, None] + torch.arange(6)).flatten()
        out = features.clone()
        out[:, six] = torch.where(share[:, None] > 0.0, blended.flatten(1).to(features.dtype), features[:, six])
        return out

    def _stands(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """How much a body stands (F,), from 0 to 1."""
        pace = _mean(steps(features, codec) * codec.fps, round(_SMOOTH * codec.fps))
        goes = pace > GOES
        if not goes.any():
            return torch.ones(len(features), dtype=torch.float64)
        usual = float(pace[goes].median())
        stands = ((_WALKS - pace / usual) / (_WALKS - _STANDS)).clamp(0.0, 1.0)
        around = round(_AROUND * codec.fps)
        wide = max_pool1d(stands[None], 2 * around + 1, 1, around)[0]
        return _mean(wide, around)


def _opposite(codec: FeatureCodec, name: str) -> int:
    """The joint on the other side."""
    return codec.skeleton.mirror_order[codec.skeleton.index(name)]


def _place(codec: FeatureCodec, joint: int) -> slice:
    """Where the position of a joint but the root stands."""
    start = codec.groups["positions"].start + 3 * (joint - 1)
    return slice(start, start + 3)


def _mean(x_F: Tensor, frames: int) -> Tensor:
    """The mean (F,) of so many frames around each, and one more if they are even; ends go on as they are."""
    around = frames // 2
    padded = torch.cat((x_F[:1].expand(around), x_F, x_F[-1:].expand(around)))
    return avg_pool1d(padded[None], 2 * around + 1, 1)[0]
