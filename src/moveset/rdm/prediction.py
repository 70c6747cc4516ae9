"""Networks that predict the noise, for samplers that ask for the clean segment.

Shapes: B rows, n frames of a segment, D features.
"""

from collections.abc import Callable
from typing import Any

from torch import Tensor

from moveset.diffusion.schedule import Schedule
from moveset.diffusion.steps import predict_z0

# x_BnD, t_B and whatever else -> (B, n, D): a network of a segment, or a sampler's ``Denoiser``.
Predictor = Callable[..., Tensor]


def clean_from_noise(schedule: Schedule, denoiser: Predictor) -> Predictor:
    """The same denoiser saying the clean segment that its noise implies: (x_t - sigma_t eps) / alpha_t.

    For networks without a flow: the noise is that of x. Computed in float32: alpha is 0.006 at the noisiest level.

    Args:
        schedule: of the network's training.
        denoiser: called with x_BnD, t_B and anything else, which is passed on; t_B is above 0 or any level.
    """

    def clean(x_BnD: Tensor, t_B: Tensor, *told: Any, **named: Any) -> Tensor:
        return predict_z0(schedule, x_BnD.float(), denoiser(x_BnD, t_B, *told, **named).float(), t_B)

    return clean
