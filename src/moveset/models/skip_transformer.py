"""A transformer with long skip connections, shared by the published VAE and denoiser.

Shapes: B batch, L sequence, M memory, C width.
Source: U-ViT (Bao et al. 2022, arXiv 2209.12152), as used by MLD (arXiv 2212.04048) and MotionLCM (arXiv 2404.19759).
"""

from typing import Any

import torch
from torch import Tensor, nn

from moveset.errors import InputError
from moveset.models.layers import Block


def require_stack(config: Any) -> None:
    """For configurations of networks with a ``SkipTransformer``, whose sizes are within their limits.

    Raises:
        InputError: an even number of layers, or heads that do not divide the width.
    """
    if config.layers % 2 == 0:
        raise InputError(
            f"layers = {config.layers} is even; a skip transformer has a middle layer, so give an odd number"
        )
    if config.width % config.heads:
        raise InputError(f"width {config.width} is not a multiple of its {config.heads} heads")


class SkipTransformer(nn.Module):
    """Blocks in which the output of the n-th first one rejoins before the n-th last one; a final LayerNorm.

    Args:
        config: has its sizes, width, layers (as many before the middle one as after it), heads, feed_forward, dropout.
        cross: whether every block also attends to a memory (the "decoder" stack).
    """

    def __init__(self, config: Any, *, cross: bool) -> None:
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
