"""How well predicted segments move as real ones do: by what a viewer sees, not by features.

A squared error of features lets root and legs err apart, and feet that stand slide by the difference. Nor does it see a
turn of five degrees a second, a tenth of the deviation that the yaw step has in all motion; who watches a straight walk
does.
Shapes: B rows, n frames, D features, J joints.
"""

import torch
from torch import Tensor

from moveset.motion.features import FeatureCodec, Normalizer
from moveset.motion.sides import MORE, more_left, shortfall
from moveset.motion.skeleton import Skeleton
from moveset.pcm.losses import huber

KNEE = 0.1  # radians above which an error counts in proportion only: how far a turn goes can seldom be known


def placed(features_BnD: Tensor, codec: FeatureCodec, normalizer: Normalizer) -> Tensor:
    """Joints (B, n, J, 3) in metres, in float32 under autocast too; every row by its own root path, starting alike."""
    with torch.autocast(features_BnD.device.type, enabled=False):
        return codec.joints(normalizer.denormalize(features_BnD.float()))


def foot_error(made_BnJ3: Tensor, real_BnJ3: Tensor, valid_Bn: Tensor, fps: float, skeleton: Skeleton) -> Tensor:
    """Mean squared error (B,) of the world velocities of ankles and toes, in (m/s)², over valid steps."""
    feet = list(skeleton.feet)
    made, real = (x[..., feet, :].diff(dim=1) * fps for x in (made_BnJ3, real_BnJ3))
    error_Bn = (made - real).square().sum(dim=-1).mean(dim=-1)
    return valid_mean(error_Bn, valid_Bn[:, 1:] & valid_Bn[:, :-1])


def below_floor(made_y: Tensor, real_y: Tensor) -> Tensor:
    """How deep joints (..., J) are under the floor y = 0 where those of the take are not: mean (...), metres.

    In a mean over all motion somebody who lies in the floor hardly counts, and who watches sees nothing else.
    """
    return (real_y.clamp(max=0.0) - made_y).relu().mean(dim=-1)


def valid_mean(x_Bn: Tensor, valid_Bn: Tensor) -> Tensor:
    """Mean (B,) over the frames that are valid."""
    return (x_Bn * valid_Bn).sum(dim=1) / valid_Bn.sum(dim=1).clamp_min(1)


def heading_error(
    made_BnD: Tensor, real_BnD: Tensor, valid_Bn: Tensor, codec: FeatureCodec, normalizer: Normalizer
) -> Tensor:
    """Mean pseudo-Huber distance (B,) of the headings that each frame leads to; both sequences start facing alike.

    In radians, as the codec's yaw step has them (``hml``: of half the angle).
    """
    yaw = codec.groups["root_yaw"]
    steps_Bn = ((made_BnD - real_BnD)[..., yaw].float() * normalizer.std[yaw].to(made_BnD.device))[..., 0]
    return valid_mean(huber((steps_Bn * valid_Bn).cumsum(dim=1), KNEE), valid_Bn)


def side_shortfall(
    made_BnJ3: Tensor, real_BnJ3: Tensor, valid_Bn: Tensor, told_B3: Tensor, weight_B: Tensor, skeleton: Skeleton
) -> Tensor:
    """By how much arms and legs that are told to move more than the others fail to: a weighted mean, in shares of the
    ways of both.

    Of an error of features one arm or the other is a hundredth, so what is asked for is looked at in the motion.

    Args:
        told_B3: sides as ``text.sides`` has them; a limb is asked for where the real segment favours it, and no more
            than there.
        weight_B: of each row.
    """
    frames_B = valid_Bn.sum(dim=1)
    made_B2, real_B2 = (more_left(x, frames_B, skeleton) for x in (made_BnJ3, real_BnJ3))
    told_B2 = told_B3[:, :2].nan_to_num().to(made_B2)
    asked_B2 = weight_B[:, None] * (told_B2 * real_B2 > MORE["arm"])
    return (shortfall(made_B2, told_B2, real_B2) * asked_B2).sum() / asked_B2.sum().clamp_min(1.0)
