"""What the two networks of RDM learn from.

Shapes: B rows, n frames of a segment, D features.
"""

import torch
from torch import Tensor

from moveset.models.flow import CouplingFlow
from moveset.rdm.transport import Transport


def masked_mse(prediction_BnD: Tensor, target_BnD: Tensor, valid_Bn: Tensor) -> Tensor:
    """Squared error over valid frames, mean over features (RDM, Eq. 31 without its Jacobian weight).

    The published weight |det df/dx|^-1 is no part of the bound: a KL divergence does not change under a bijection that
    both distributions share. ``jacobian_weight`` is there to compare.
    """
    square_Bn = (prediction_BnD - target_BnD).square().mean(dim=-1)
    return (square_Bn * valid_Bn).sum() / valid_Bn.sum().clamp_min(1)


def jacobian_weight(
    transport: Transport, clean_BnD: Tensor, valid_Bn: Tensor, index_B: Tensor, pooled_BC: Tensor, power: float
) -> Tensor:
    """|det df/dx_0|^-power (B,) of the valid frames of clean segments (RDM, Eq. 13 and 31, which print power 1).

    Thousands of numbers are carried, so with log-scales of .1 the power 1 is beyond float32. One by their number is the
    geometric mean.
    """
    y_BnD = transport.pull(clean_BnD, index_B, pooled_BC)
    return torch.exp(-power * (transport.log_det(y_BnD, index_B, pooled_BC) * valid_Bn).sum(dim=1))


def flow_loss(
    flow: CouplingFlow,
    previous_BnD: Tensor,
    next_BnD: Tensor,
    valid_Bn: Tensor,
    context_Bc: Tensor,
    noise_BnD: Tensor | None = None,
    isometry: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Teacher-forced reconstruction of the next clean segment from the one before (RDM, Section 4.4 and 16.1).

    Args:
        noise_BnD: added to the flow's input (Eq. 15's inflation, of the whole input, so that the map stays invertible).
        isometry: weight of mean (log s)², which keeps the flow's scales near one.

    Returns:
        The loss, and the reconstruction error alone.
    """
    start = previous_BnD if noise_BnD is None else previous_BnD + noise_BnD
    made_BnD, log_scales = flow.log_scales(start, context_Bc)
    error = masked_mse(made_BnD, next_BnD, valid_Bn)
    return error + isometry * log_scales.square().mean(), error.detach()


def velocity_loss(
    prediction_BnD: Tensor, target_BnD: Tensor, before_BD: Tensor, has_before_B: Tensor, valid_Bn: Tensor
) -> Tensor:
    """Squared error of the frame-to-frame differences, the step from the last frame of the past included.

    Not in the paper: a segment's mean squared error alone leaves steps between its frames and at its start, which show
    as jitter.

    Args:
        before_BD: clean last frame of the segment before.
        has_before_B: whether there is one.
    """
    made = torch.cat((before_BD[:, None], prediction_BnD), dim=1).diff(dim=1)
    real = torch.cat((before_BD[:, None], target_BnD), dim=1).diff(dim=1)
    joined = torch.cat((has_before_B[:, None], valid_Bn[:, :-1]), dim=1)
    weight_Bn = (valid_Bn & joined).to(made.dtype)
    return ((made - real).square().mean(dim=-1) * weight_Bn).sum() / weight_Bn.sum().clamp_min(1)
