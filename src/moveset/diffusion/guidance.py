"""Classifier-free guidance (Ho & Salimans 2022, arXiv 2207.12598) and its scale as a network input.

Everywhere in moveset the scale w follows the papers on consistency distillation: w = 0 is no guidance, and w = s - 1
for the scale s that Stable Diffusion and MLD print.
"""

import math

import torch
from torch import Tensor

from moveset.diffusion.steps import over


def cfg(eps_cond: Tensor, eps_uncond: Tensor, w: Tensor | float) -> Tensor:
    """(1 + w) eps_cond - w eps_uncond (MotionPCM, Eq. 11).

    Args:
        eps_cond: (B, …) noise predicted with the text.
        eps_uncond: (B, …) noise predicted with the empty text.
        w: guidance scale, one number or (B,).
    """
    w = over(w, eps_cond) if isinstance(w, Tensor) else w
    return eps_cond + w * (eps_cond - eps_uncond)


def guidance_embedding(w: Tensor, dim: int = 256) -> Tensor:
    """Sinusoids of 1000 w, (B,) -> (B, dim): [sin, cos], frequencies 10000^(-i / (dim/2 - 1)).

    As in LCM (Luo et al. 2023, arXiv 2310.04378) and MotionLCM.

    >>> guidance_embedding(torch.zeros(1), 4)
    tensor([[0., 0., 1., 1.]])
    """
    half = dim // 2
    frequencies = torch.exp(torch.arange(half, device=w.device) * (-math.log(10000.0) / (half - 1)))
    angles = 1000.0 * w.float()[:, None] * frequencies
    return torch.cat((torch.sin(angles), torch.cos(angles)), dim=-1)
