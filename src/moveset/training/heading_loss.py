"""How well predicted segments keep their course: the turn that their steps add up to, not each step alone.

A turn of five degrees a second is a tenth of the deviation that the yaw step has in all motion: a squared error of
features does not see it, and who watches a straight walk does.
Shapes: B rows, n frames, D features.
"""

import torch
from torch import Tensor

from moveset.motion.features import FeatureCodec, Normalizer
from moveset.pcm.losses import huber

KNEE = 0.1  # radians above which an error counts in proportion only: how far a turn goes can seldom be known


def heading_error(
    made_BnD: Tensor, real_BnD: Tensor, valid_Bn: Tensor, codec: FeatureCodec, normalizer: Normalizer
) -> Tensor:
    """Mean pseudo-Huber distance (B,) of the headings that each frame leads to; both sequences start facing alike.

    In radians, as the codec's yaw step has them (``hml``: of half the angle).
    """
    yaw = codec.groups["root_yaw"]
    steps_Bn = ((made_BnD - real_BnD)[..., yaw].float() * normalizer.std[yaw].to(made_BnD.device))[..., 0]
    error_Bn = huber((steps_Bn * valid_Bn).cumsum(dim=1), KNEE) * valid_Bn
    return error_Bn.sum(dim=1) / valid_Bn.sum(dim=1).clamp_min(1)


def perturb_past(
    previous_BnD: Tensor,
    index_B: Tensor,
    rate: float,
    codec: FeatureCodec,
    normalizer: Normalizer,
    generator: torch.Generator,
) -> Tensor:
    """Normalised segments with a steady turn of normally distributed speed added, but where ``index_B`` says none is.

    A network that is told its own past, slightly bent, learns to walk on straight instead of round.

    Args:
        rate: deviation of the turn in radians a second.
        generator: drawn from on its own device.
    """
    yaw = codec.groups["root_yaw"]
    turn_B = torch.randn(len(previous_BnD), generator=generator, device=generator.device) * rate / codec.fps
    turn_B = turn_B.to(previous_BnD.device) * (index_B > 0)
    bent = previous_BnD.clone()
    bent[..., yaw] += turn_B[:, None, None] / normalizer.std[yaw].to(previous_BnD.device)
    return bent
