"""A transformer with long skip connections, shared by the published VAE and denoiser.

Shapes: B batch, L sequence, M memory, C width.
Source: U-ViT (Bao et al. 2022, arXiv 2209.12152), as used by MLD (arXiv 2212.04048) and MotionLCM (arXiv 2404.19759).
"""

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor, nn

from moveset.errors import InputError
from moveset.models.layers import Block
from moveset.models.registry import require_sizes


@dataclass(frozen=True, kw_only=True, slots=True)
class SkipTransformerConfig:
    """Sizes of a ``SkipTransformer``; ``layers`` is odd: as many before the middle one as after it."""

    width: int = 256
    layers: int = 9
    heads: int = 4
    feed_forward: int = 1024
    dropout: float = 0.1

    @classmethod
    def of(cls, config: Any) -> "SkipTransformerConfig":
        """The part of a larger configuration."""
        return cls(**{field.name: getattr(config, field.name) for field in fields(cls)})

    def __post_init__(self) -> None:
        require_sizes(self, heads=(1, self.width))
        if self.layers % 2 == 0:
            raise InputError(
                f"layers = {self.layers} is even; a skip transformer has a middle layer, so give an odd number"
            )
        if self.width % self.heads:
            raise InputError(f"width {self.width} is not a multiple of its {self.heads} heads")


class SkipTransformer(nn.Module):
    """Blocks in which the output of the n-th first one rejoins before the n-th last one; a final LayerNorm.

    Args:
        cross: whether every block also attends to a memory (the "decoder" stack).
    """

    def __init__(self, config: SkipTransformerConfig, *, cross: bool) -> None:
        super().__init__()
        c, half = config, config.layers // 2
        self.blocks = nn.ModuleList(
            Block(c.width, c.heads, c.feed_forward, c.dropout, cross) for _ in range(config.layers)
        )
        self.joins = nn.ModuleList(nn.Linear(2 * c.width, c.width) for _ in range(half))
        self.norm = nn.LayerNorm(c.width)
        for parameter in self.parameters():
            if parameter.dim() > 1:
                nn.init.xavier_uniform_(parameter)

    def forward(
        self,
        x_BLC: Tensor,
        mask_BL: Tensor | None = None,
        memory_BMC: Tensor | None = None,
        taps: list[Tensor] | None = None,
    ) -> Tensor:
        """Run the stack.

        Args:
            mask_BL: True where there is a token; None means everywhere.
            memory_BMC: what a stack with ``cross`` attends to.
            taps: collects the output of every block, (B, L, C) each, first block first.
        """
        half = len(self.joins)
        kept: list[Tensor] = []
        x = x_BLC
        for k, block in enumerate(self.blocks):
            if k > half:
                x = self.joins[k - half - 1](torch.cat((x, kept.pop()), dim=-1))
            x = block(x, mask_BL, memory_BMC)
            if k < half:
                kept.append(x)
            if taps is not None:
                taps.append(x)
        return self.norm(x)
