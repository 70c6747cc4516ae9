"""The published latent denoiser: noise in 16 latent tokens, predicted by a skip transformer that also reads the text.

Shapes: B batch, N latent tokens, D latent channels, L text tokens, C text channels, W width.
Source: MLD (arXiv 2212.04048), MotionLCM-V2 (arXiv 2404.19759); MotionPCM's student adds the guidance scale.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from moveset.diffusion.guidance import guidance_embedding
from moveset.models.condition import Condition, Denoiser
from moveset.models.layers import Positions, TimeEmbedding
from moveset.models.registry import ModelConfig, register, require_sizes
from moveset.models.skip_transformer import SkipTransformer, require_stack


@dataclass(frozen=True, kw_only=True, slots=True)
class TokenDenoiserConfig(ModelConfig):
    """Sizes of a ``TokenDenoiser``; the defaults are the published teacher, ``guided=True`` the student."""

    token_dim: int = 32
    text_dim: int = 768
    width: int = 256
    layers: int = 9
    heads: int = 4
    feed_forward: int = 1024
    dropout: float = 0.1
    positions: int = 500
    time_waves: int = 768
    guided: bool = False
    guidance_waves: int = 256

    def __post_init__(self) -> None:
        require_sizes(self, time_waves=(2, 4096))
        require_stack(self)


class TokenDenoiser(Denoiser):
    """Predicts the noise (B, N, D) in z_t: [latent tokens; time; text tokens] through one skip transformer.

    The published models use one pooled text token, L = 1. Of text padding it does not matter what stands there, and the
    clip's length is not read. ``taps`` collect the latent tokens' part (B, N, W) of every block's output.
    """

    def __init__(self, config: TokenDenoiserConfig) -> None:
        super().__init__()
        self.config = config
        self.latent_in = nn.Linear(config.token_dim, config.width)
        self.time = TimeEmbedding(config.width, config.time_waves, config.guidance_waves if config.guided else None)
        self.text_in = nn.Linear(config.text_dim, config.width)
        self.positions = Positions(config.positions, config.width)
        self.stack = SkipTransformer(config, cross=False)
        self.latent_out = nn.Linear(config.width, config.token_dim)

    def denoise(self, z_BND: Tensor, t_B: Tensor, condition: Condition, taps: list[Tensor] | None) -> Tensor:
        """See ``Denoiser.forward``.

        Raises:
            InputError: more tokens than positions, or a guidance scale where none belongs (or the reverse).
        """
        tokens_BLC, mask_BL, w_B = condition.text.tokens, condition.text.mask, condition.scale
        count = z_BND.shape[1]
        waves_w = None if w_B is None else guidance_embedding(w_B, self.config.guidance_waves)
        time = self.time(t_B, waves_w)[:, None]
        # Padding may hold anything, NaN included, and 0 * NaN would be NaN in the attention.
        text = self.text_in(tokens_BLC.masked_fill(~mask_BL[..., None], 0.0))
        x = self.positions(torch.cat((self.latent_in(z_BND), time, text), dim=1))
        mask = torch.cat((mask_BL.new_ones(len(mask_BL), count + 1), mask_BL), dim=1)
        blocks: list[Tensor] | None = None if taps is None else []
        eps = self.latent_out(self.stack(x, mask, None, blocks)[:, :count])
        if taps is not None and blocks is not None:
            taps.extend(block[:, :count] for block in blocks)
        return eps


register("token_denoiser", TokenDenoiserConfig, TokenDenoiser)
