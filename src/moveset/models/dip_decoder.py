"""DiP: a transformer decoder that continues a motion. Given clean frames, it denoises those that follow.

Clean and noisy frames are one sequence, which attends to itself and to a memory of the noise level and the text.

Shapes: B batch, n noisy frames, m clean frames before them, D features, L text tokens, C text channels, W width.
Source: CLoSD (Tevet et al. 2024, arXiv 2410.03441), which predicts 40 clean frames from 20 on a cosine schedule of ten
steps; the parts are MDM's (arXiv 2209.14916).
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.errors import InputError
from moveset.models.condition import Condition, Denoiser
from moveset.models.layers import Attention, sinusoids
from moveset.models.registry import ModelConfig, register, require_range, require_sizes


@dataclass(frozen=True, kw_only=True, slots=True)
class DipDecoderConfig(ModelConfig):
    """Sizes of a ``DipDecoder``; the defaults are the published ones on HumanML3D.

    Args:
        features: D.
        prefix: m, the clean frames it is given.
        frames: n, the frames it denoises.
        text_dim: C of the token states: 768 for DistilBERT, 384 for MiniLM.
    """

    features: int = 263
    prefix: int = 20
    frames: int = 40
    text_dim: int = 768
    width: int = 512
    layers: int = 8
    heads: int = 4
    feed_forward: int = 1024
    dropout: float = 0.1

    def __post_init__(self) -> None:
        limits = {"prefix": (0, 4096), "frames": (1, 4096), "width": (2, 4096), "heads": (1, self.width)}
        require_sizes(self, layers=(1, 64), **limits)
        require_range("width modulo 2", self.width % 2, 0, 0)
        require_range("width modulo heads", self.width % self.heads, 0, 0)


class DipDecoder(Denoiser):
    """Predicts the clean frames (B, n, D) after a clean prefix from their noisy version, its level and the text.

    The prefix is the condition's past; a row without any real token is the empty prompt, for guidance. Frames that are
    not valid do not matter, and their output means nothing.
    """

    def __init__(self, config: DipDecoderConfig) -> None:
        super().__init__()
        self.config = c = config
        self.frames_in = nn.Linear(c.features, c.width)
        self.text_in = nn.Linear(c.text_dim, c.width)
        self.time = nn.Sequential(nn.Linear(c.width, c.width), nn.SiLU(), nn.Linear(c.width, c.width))
        self.dropout = nn.Dropout(c.dropout)
        self.layers = nn.ModuleList(Layer(c) for _ in range(c.layers))
        self.out = nn.Linear(c.width, c.features)

    def denoise(self, x_BnD: Tensor, t_B: Tensor, condition: Condition, taps: list[Tensor] | None) -> Tensor:
        """See ``Denoiser.forward``.

        Raises:
            InputError: another number of frames than the network is made for, or no prefix.
        """
        if condition.past is None:
            raise InputError("DiP goes on from a prefix; give it as the condition's past")
        prefix_BmD, mask_Bn = condition.past.frames, condition.valid
        tokens_BLC, mask_BL = condition.text.tokens, condition.text.mask
        c = self.config
        for what, found, made in (("prefix", prefix_BmD.shape[1], c.prefix), ("prediction", x_BnD.shape[1], c.frames)):
            if found != made:
                raise InputError(f"a {what} of {found} frames does not fit this model; give it {made}")
        mask = None
        if mask_Bn is not None:
            x_BnD = x_BnD.masked_fill(~mask_Bn[..., None], 0.0)
            mask = torch.cat((mask_Bn.new_ones(len(mask_Bn), c.prefix), mask_Bn), dim=1)
        x = self.frames_in(torch.cat((prefix_BmD, x_BnD), dim=1))
        x = self.dropout(x + sinusoids(torch.arange(x.shape[1], device=x.device), c.width).to(x.dtype))

        time = self.time(sinusoids(t_B, c.width).to(x.dtype))[:, None]
        # Padding may hold anything, NaN included, and 0 * NaN would be NaN in the attention.
        text = self.text_in(tokens_BLC.masked_fill(~mask_BL[..., None], 0.0))
        memory = torch.cat((time, text), dim=1)
        memory_mask = torch.cat((mask_BL.new_ones(len(mask_BL), 1), mask_BL), dim=1)
        for layer in self.layers:
            x = layer(x, mask, memory, memory_mask)
        return self.out(x[:, c.prefix :])


class Layer(nn.Module):
    """``torch.nn.TransformerDecoderLayer`` with GELU, post-norm: frames, memory, feed-forward."""

    def __init__(self, config: DipDecoderConfig) -> None:
        super().__init__()
        c = config
        self.itself, self.itself_norm = Attention(c.width, c.heads, c.dropout), nn.LayerNorm(c.width)
        self.memory, self.memory_norm = Attention(c.width, c.heads, c.dropout), nn.LayerNorm(c.width)
        self.inward, self.outward = nn.Linear(c.width, c.feed_forward), nn.Linear(c.feed_forward, c.width)
        self.norm = nn.LayerNorm(c.width)
        self.dropout = nn.Dropout(c.dropout)

    def forward(self, x_BlW: Tensor, mask_Bl: Tensor | None, memory_BMW: Tensor, mask_BM: Tensor) -> Tensor:
        x = self.itself_norm(x_BlW + self.dropout(self.itself(x_BlW, None, mask_Bl)))
        x = self.memory_norm(x + self.dropout(self.memory(x, memory_BMW, mask_BM)))
        fed = self.outward(self.dropout(fn.gelu(self.inward(x))))
        return self.norm(x + self.dropout(fed))


register("dip_decoder", DipDecoderConfig, DipDecoder)
