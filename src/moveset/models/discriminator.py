"""The discriminator of adversarial consistency: small heads that read a frozen denoiser's features.

It judges noised latents z_s at time s, given the text: high logits mean real. Gradients flow through the frozen
denoiser into z_s, which is how a student learns from the verdict.

Shapes: B batch, N latent tokens, C width of the denoiser, K tapped blocks.
Source: PCM (Wang et al. 2024, arXiv 2405.18407) and MotionPCM, Eq. 13, on the tokens of a latent sequence.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from moveset.errors import InputError
from moveset.models.registry import ModelConfig, register, require_sizes


@dataclass(frozen=True, kw_only=True, slots=True)
class DiscriminatorConfig(ModelConfig):
    """Sizes of the trained part: one head per tapped block of the backbone."""

    width: int = 256
    taps: int = 9
    groups: int = 32

    def __post_init__(self) -> None:
        require_sizes(self, taps=(1, 256), groups=(1, self.width))
        if self.width % self.groups:
            raise InputError(f"discriminator width {self.width} is not a multiple of its {self.groups} groups")


class _Head(nn.Module):
    """Logit of every token by itself: Linear, GroupNorm, LeakyReLU; the same again as a residual; Linear to 1.

    The 1x1 convolutions of PCM's heads, for a sequence: GroupNorm sees one token at a time, so that no statistics
    leak from token to token.
    """

    def __init__(self, width: int, groups: int) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(width, width), nn.Linear(width, width)
        self.first_norm, self.second_norm = nn.GroupNorm(groups, width), nn.GroupNorm(groups, width)
        self.logit = nn.Linear(width, 1)

    def forward(self, x_BNC: Tensor) -> Tensor:
        h = x_BNC.flatten(0, 1)
        h = F.leaky_relu(self.first_norm(self.first(h)), 0.01)
        h = h + F.leaky_relu(self.second_norm(self.second(h)), 0.01)
        return self.logit(h).view(x_BNC.shape[:2])


class DiscriminatorHeads(nn.Module):
    """What is trained: K heads for the K feature maps that the frozen denoiser's ``taps`` collect."""

    def __init__(self, config: DiscriminatorConfig) -> None:
        super().__init__()
        self.config = config
        self.heads = nn.ModuleList(_Head(config.width, config.groups) for _ in range(config.taps))

    def forward(self, taps: list[Tensor]) -> Tensor:
        """Logits (B, N, K) of K feature maps (B, N, C); a hinge loss averages over all of them."""
        if len(taps) != len(self.heads):
            raise InputError(f"the backbone gave {len(taps)} feature maps for {len(self.heads)} discriminator heads")
        return torch.stack([head(tap) for head, tap in zip(self.heads, taps, strict=True)], dim=-1)


register("latent_discriminator", DiscriminatorConfig, DiscriminatorHeads)
