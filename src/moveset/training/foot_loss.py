"""How well the feet of predicted segments move as the real ones do: by what a viewer sees, not by features.

A squared error of features lets root and legs err apart, and feet that stand slide by the difference.
Shapes: B rows, n frames, D features.
"""

from torch import Tensor

from moveset.motion.features import FeatureCodec, Normalizer


def foot_error(
    made_BnD: Tensor, real_BnD: Tensor, valid_Bn: Tensor, codec: FeatureCodec, normalizer: Normalizer
) -> Tensor:
    """Mean squared error (B,) of the world velocities of ankles and toes, in (m/s)², over valid steps.

    Both sequences are placed by their own root path, starting alike.
    """
    feet = list(codec.skeleton.feet)
    made, real = (
        codec.joints(normalizer.denormalize(x.float()))[..., feet, :].diff(dim=1) * codec.fps
        for x in (made_BnD, real_BnD)
    )
    error_Bn = (made - real).square().sum(dim=-1).mean(dim=-1)
    steps_Bn = (valid_Bn[:, 1:] & valid_Bn[:, :-1]).to(error_Bn.dtype)
    return (error_Bn * steps_Bn).sum(dim=1) / steps_Bn.sum(dim=1).clamp_min(1)
