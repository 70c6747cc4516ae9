"""Conditions of made-up text, and segment networks called with all that they are given by name."""

from typing import Any

import torch
from torch import Tensor

from moveset.models.condition import Condition, Denoiser, PastSegment
from moveset.text.encoder import TextEmbedding


def condition_of(tokens: Tensor, mask: Tensor | None = None, **parts: Tensor | PastSegment) -> Condition:
    """Of token states (B, L, C), all of them real unless a mask (B, L) says which."""
    mask = torch.ones(tokens.shape[:2], dtype=torch.bool) if mask is None else mask
    return Condition(TextEmbedding(tokens, mask, tokens.mean(1)), **parts)


def awake(config: Any) -> Any:
    """A network whose zero-initialised layers speak."""
    torch.manual_seed(0)
    model = config.build().eval()
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return model


def call(
    network: Denoiser, x_BnD: Tensor, t_B: Tensor, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor,
    tokens_BLC: Tensor, mask_BL: Tensor, w_B: Tensor | None = None, mask_Bn: Tensor | None = None,
    taps: list[Tensor] | None = None, turned_B: Tensor | None = None,
    mirrored_BLC: Tensor | None = None, prepare: bool = False,
) -> Tensor:  # fmt: skip
    """What a segment network makes of a noisy segment; ``prepare``: its condition is prepared before."""
    past = PastSegment(prev_BnD, prev_t_B, index_B, turned_B)
    mirror = None if mirrored_BLC is None else condition_of(mirrored_BLC, mask_BL).text
    condition = condition_of(tokens_BLC, mask_BL, past=past, scale=w_B, valid=mask_Bn, mirror_text=mirror)
    return network(x_BnD, t_B, network.prepare(condition) if prepare else condition, taps)
