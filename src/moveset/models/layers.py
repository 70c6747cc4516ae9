"""Transformer parts at the published sizes: embeddings of time and guidance, post-norm blocks, learned positions.

Shapes: B batch, L sequence, M memory, C width, H heads. Masks are boolean, True where there is a token.
Source: Vaswani et al. 2017 (arXiv 1706.03762) as used by MLD (Chen et al. 2023, arXiv 2212.04048) and MotionLCM
(Dai et al. 2024, arXiv 2404.19759).
"""

import math
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from moveset.errors import InputError

Layer = TypeVar("Layer", nn.Linear, nn.Conv1d)


def time_embedding(t_B: Tensor, dim: int = 768) -> Tensor:
    """Sinusoids (B, dim) of timesteps (B,): [cos, sin] at frequencies 10000^(-i / (dim / 2)).

    >>> time_embedding(torch.tensor([0]), 4).tolist()
    [[1.0, 1.0, 0.0, 0.0]]
    """
    angles = t_B.float()[:, None] * frequencies(dim // 2, t_B.device)
    return torch.cat((angles.cos(), angles.sin()), dim=-1)


def frequencies(count: int, device: torch.device) -> Tensor:
    """(count,) of ``time_embedding``."""
    return torch.exp(torch.arange(count, device=device) * (-math.log(10000.0) / count))


def sinusoids(places: Tensor, width: int) -> Tensor:
    """(…,) numbers -> (…, width): [sin, cos, sin, cos, …] at frequencies 10000^(-2i / width); width is even.

    >>> sinusoids(torch.tensor([0, 1]), 2)
    tensor([[0.0000, 1.0000],
            [0.8415, 0.5403]])
    """
    cos_sin = time_embedding(places.flatten(), width).unflatten(-1, (2, -1))
    return torch.stack((cos_sin[:, 1], cos_sin[:, 0]), dim=-1).reshape(*places.shape, width)


def zeroed(layer: Layer) -> Layer:
    """A layer that says nothing before it has learned to."""
    nn.init.zeros_(layer.weight)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer


class TimeEmbedding(nn.Module):
    """Timestep, and in a distilled model the guidance scale, as one token (B, C).

    Args:
        width: C.
        waves: size of the sinusoidal embedding of time.
        guidance: size of the embedding of the guidance scale, or None for a model without. It enters through a
            linear map that starts at zero, so that a student starts as its teacher whatever the scale.
    """

    def __init__(self, width: int, waves: int, guidance: int | None) -> None:
        super().__init__()
        self.waves = waves
        self.guidance = None if guidance is None else zeroed(nn.Linear(guidance, waves, bias=False))
        self.inward, self.outward = nn.Linear(waves, width), nn.Linear(width, width)

    def forward(self, t_B: Tensor, w_BG: Tensor | None) -> Tensor:
        """Embed t (B,) and the embedded guidance scale (B, G).

        Raises:
            InputError: a guidance scale for a model without, or none for a model with.
        """
        waves = time_embedding(t_B, self.waves).to(self.inward.weight.dtype)
        if self.guidance is not None and w_BG is not None:
            waves = waves + self.guidance(w_BG.to(self.inward.weight.dtype))
        elif self.guidance is not None or w_BG is not None:
            kind = "needs" if w_BG is None else "does not take"
            raise InputError(f"this denoiser {kind} a guidance scale: a teacher takes none, a distilled student one")
        return self.outward(F.silu(self.inward(waves)))


class Attention(nn.Module):
    """Multi-head attention; parameters are laid out as in ``torch.nn.MultiheadAttention``."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.inward, self.outward = nn.Linear(width, 3 * width), nn.Linear(width, width)
        nn.init.zeros_(self.inward.bias)
        nn.init.zeros_(self.outward.bias)

    def forward(self, x_BLC: Tensor, memory_BMC: Tensor | None, mask_BM: Tensor | None) -> Tensor:
        """Attend from x to the memory (to x itself when None) where the mask, if any, is True."""
        if memory_BMC is None:
            q, k, v = self.inward(x_BLC).chunk(3, dim=-1)
        else:
            parts, width = (self.inward.weight, self.inward.bias), x_BLC.shape[-1]
            (wq, wkv), (bq, bkv) = (p.split((width, 2 * width)) for p in parts)
            q = F.linear(x_BLC, wq, bq)
            k, v = F.linear(memory_BMC, wkv, bkv).chunk(2, dim=-1)
        q, k, v = (p.unflatten(-1, (self.heads, -1)).transpose(1, 2) for p in (q, k, v))
        mask = None if mask_BM is None else mask_BM[:, None, None, :]
        dropout = self.dropout if self.training else 0.0
        h = F.scaled_dot_product_attention(q, k, v, attn_mask=mask, dropout_p=dropout)
        return self.outward(h.transpose(1, 2).flatten(2))


class Block(nn.Module):
    """Post-norm transformer block: self-attention, optionally cross-attention to a memory, feed-forward with GELU."""

    def __init__(self, width: int, heads: int, feed_forward: int, dropout: float, cross: bool) -> None:
        super().__init__()
        self.attention, self.attention_norm = Attention(width, heads, dropout), nn.LayerNorm(width)
        self.cross = Attention(width, heads, dropout) if cross else None
        self.cross_norm = nn.LayerNorm(width) if cross else None
        self.inward, self.outward = nn.Linear(width, feed_forward), nn.Linear(feed_forward, width)
        self.norm = nn.LayerNorm(width)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x_BLC: Tensor, mask_BL: Tensor | None, memory_BMC: Tensor | None) -> Tensor:
        x = self.attention_norm(x_BLC + self.dropout(self.attention(x_BLC, None, mask_BL)))
        if self.cross is not None and self.cross_norm is not None:
            x = self.cross_norm(x + self.dropout(self.cross(x, memory_BMC, None)))
        h = self.outward(self.dropout(F.gelu(self.inward(x))))
        return self.norm(x + self.dropout(h))


class Positions(nn.Module):
    """A learned table of positions, added once to a sequence."""

    def __init__(self, length: int, width: int) -> None:
        super().__init__()
        self.table = nn.Parameter(torch.rand(length, width))

    def forward(self, x_BLC: Tensor) -> Tensor:
        """x plus the first L positions.

        Raises:
            InputError: a sequence longer than the table.
        """
        if x_BLC.shape[1] > len(self.table):
            raise InputError(
                f"a sequence of {x_BLC.shape[1]} tokens exceeds the model's {len(self.table)} positions; shorten it"
            )
        return x_BLC + self.table[: x_BLC.shape[1]]
