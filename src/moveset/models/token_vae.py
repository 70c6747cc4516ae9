"""The published motion VAE: learned tokens read a clip by attention, zero queries write it back at any length.

Shapes: B batch, F frames, D features, N latent tokens, C latent channels.
Source: MLD (arXiv 2212.04048) with the per-token adapters of MotionLCM-V2 (arXiv 2404.19759): 16 tokens of 32.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from moveset.errors import InputError
from moveset.models.layers import Positions
from moveset.models.registry import ModelConfig, register, require_sizes
from moveset.models.skip_transformer import SkipTransformer, require_stack


@dataclass(frozen=True, kw_only=True, slots=True)
class TokenVAEConfig(ModelConfig):
    """Sizes of a ``TokenVAE``; the defaults are the published ones for HumanML3D's 263 features."""

    features: int = 263
    tokens: int = 16
    token_dim: int = 32
    width: int = 256
    layers: int = 9
    heads: int = 4
    feed_forward: int = 1024
    dropout: float = 0.1
    positions: int = 500

    def __post_init__(self) -> None:
        require_sizes(self, tokens=(1, 1024))
        if self.positions <= 2 * self.tokens:
            raise InputError(f"{self.positions} positions leave no frame beside 2 x {self.tokens} tokens; give more")
        require_stack(self)


class TokenVAE(nn.Module):
    """Clips of any length to N Gaussian tokens and back; padded frames never show in the output."""

    def __init__(self, config: TokenVAEConfig) -> None:
        super().__init__()
        self.config = config
        c = config
        self.frame_in = nn.Linear(c.features, c.width)
        self.tokens = nn.Parameter(torch.randn(2 * c.tokens, c.width))  # N for the means, N for the log-variances
        self.encoder_positions = Positions(c.positions, c.width)
        self.encoder = SkipTransformer(c, cross=False)
        self.to_latent = nn.Linear(c.width, c.token_dim)

        self.from_latent = nn.Linear(c.token_dim, c.width)
        self.decoder_positions = Positions(c.positions, c.width)
        self.decoder = SkipTransformer(c, cross=True)
        self.frame_out = nn.Linear(c.width, c.features)

    def encode(self, x_BFD: Tensor, lengths_B: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance, (B, N, C) each, of clips of ``lengths_B`` >= 1 frames.

        Raises:
            InputError: more frames than the model has positions.
        """
        valid = frame_mask(lengths_B, x_BFD.shape[1])
        # Padding may hold anything, NaN included, and 0 * NaN would be NaN in the attention.
        frames = self.frame_in(x_BFD.masked_fill(~valid[..., None], 0.0))
        x = self.encoder_positions(torch.cat((self.tokens.expand(len(frames), -1, -1), frames), dim=1))
        mask = torch.cat((valid.new_ones(len(valid), len(self.tokens)), valid), dim=1)
        mean, log_variance = self.to_latent(self.encoder(x, mask)[:, : len(self.tokens)]).chunk(2, dim=1)
        return mean, log_variance

    def decode(self, z_BNC: Tensor, lengths_B: Tensor, frames: int) -> Tensor:
        """Features (B, frames, D) of latents; zero beyond each clip's length.

        Args:
            lengths_B: frames wanted of each clip, 1 to ``frames``.
            frames: size of the output.

        Raises:
            InputError: more frames than the model has positions.
        """
        valid = frame_mask(lengths_B, frames)
        queries = self.decoder_positions(z_BNC.new_zeros(len(z_BNC), frames, self.config.width))
        x = self.frame_out(self.decoder(queries, valid, self.from_latent(z_BNC)))
        return x.masked_fill(~valid[..., None], 0.0)


def frame_mask(lengths_B: Tensor, frames: int) -> Tensor:
    """(B, frames) mask, True within each clip's length.

    >>> frame_mask(torch.tensor([1, 3]), 3).tolist()
    [[True, False, False], [True, True, True]]
    """
    return torch.arange(frames, device=lengths_B.device) < lengths_B[:, None]


register("token_vae", TokenVAEConfig, TokenVAE)
