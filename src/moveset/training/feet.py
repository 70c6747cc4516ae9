"""How well the feet of what is predicted move: by what a viewer sees, not by features.

A squared error of features lets root and legs err apart, and feet that stand slide by the difference.
Shapes: B rows, n frames, D features.
"""

import torch
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


def sliding(
    made_BFD: Tensor, lengths_B: Tensor, codec: FeatureCodec, normalizer: Normalizer, contact: float = 0.5
) -> Tensor:
    """Mean squared planar speed, in (m/s)², of ankles and toes that the features themselves call planted.

    The contact loss of EDGE (Tseng et al. 2023, arXiv 2211.10658, Eq. 10), but that contacts have no gradient: they are
    what is said of a step, and shall not change so that it may slide. Zero where nothing is planted.

    Args:
        made_BFD: normalised features.
        lengths_B: frames of each clip; the rest is ignored.
        contact: from which value on a contact channel means planted.
    """
    made = normalizer.denormalize(made_BFD.float())
    moved = codec.joints(made)[..., list(codec.skeleton.feet), :].diff(dim=1)[..., [0, 2]] * codec.fps
    planted = made.detach()[:, :-1, codec.groups["contacts"]] > contact
    valid = torch.arange(1, made.shape[1], device=made.device) < lengths_B[:, None]
    counts = (planted & valid[..., None]).to(made.dtype)
    return (moved.square().sum(dim=-1) * counts).sum() / counts.sum().clamp_min(1)
