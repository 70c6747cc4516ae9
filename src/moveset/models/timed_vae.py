"""A motion VAE whose latent tokens own a place in time: 16 tokens of 32 numbers, learned in minutes instead of days.

In the published VAE (``token_vae``) attention must first discover which latent token answers for which moment. Here the
routing is fixed: latent token n covers the n-th sixteenth of the clip, whatever its length; convolutions do the rest.

With one token and 48 slots the latent is MLD's single global one (arXiv 2212.04048) in an otherwise equal network.

Shapes: B batch, F frames, D features, P patches of 4 frames, S slots over relative time, N latent tokens, C width.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.models.layers import zeroed
from moveset.models.registry import ModelConfig, register, require_sizes

PATCH = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class TimedVAEConfig(ModelConfig):
    """Sizes of a ``TimedVAE``; ``slots`` is how many places in time, evenly spread, a token is made of."""

    features: int = 269
    tokens: int = 16
    slots: int = 3
    token_dim: int = 32
    width: int = 256
    frame_width: int = 128
    encoder_blocks: int = 3
    decoder_blocks: int = 4
    token_blocks: int = 2
    frame_blocks: int = 2

    def __post_init__(self) -> None:
        blocks = ("encoder_blocks", "decoder_blocks", "token_blocks", "frame_blocks")
        require_sizes(self, **dict.fromkeys(blocks, (0, 64)))


class TimedVAE(nn.Module):
    """Encode clips of any length to N tokens, decode tokens to any length; padding never shows in the output."""

    def __init__(self, config: TimedVAEConfig) -> None:
        super().__init__()
        self.config = config
        c = config
        self.patch_in = nn.Linear(PATCH * c.features, c.width)
        self.length_in = nn.Linear(2 * _RELATIVE_WAVES + 2, c.width)
        self.encoder = nn.ModuleList(ConvBlock(c.width, 3, 1) for _ in range(c.encoder_blocks))
        self.merge = nn.Linear(c.slots * c.width, c.width)
        self.encoder_mixer = nn.ModuleList(TokenMixer(c.width, c.tokens) for _ in range(c.token_blocks))
        self.norm_latent = nn.LayerNorm(c.width)
        self.to_latent = nn.Linear(c.width, 2 * c.token_dim)

        self.from_latent = nn.Linear(c.token_dim, c.width)
        self.decoder_mixer = nn.ModuleList(TokenMixer(c.width, c.tokens) for _ in range(c.token_blocks))
        self.split = nn.Linear(c.width, c.slots * c.width)
        self.length_out = nn.Linear(2 * _RELATIVE_WAVES + 2, c.width)
        self.decoder = nn.ModuleList(ConvBlock(c.width, 3, 1) for _ in range(c.decoder_blocks))
        self.patch_out = nn.Linear(c.width, PATCH * c.frame_width)
        self.frame = nn.ModuleList(ConvBlock(c.frame_width, 5, 3) for _ in range(c.frame_blocks))
        self.frame_out = nn.Linear(c.frame_width, c.features)

    def encode(self, x_BFD: Tensor, lengths_B: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance (B, N, d) of clips of ``lengths_B`` frames; what lies beyond them is ignored."""
        batch, frames, _ = x_BFD.shape
        padded = -frames % PATCH
        # A length that is no multiple of 4 ends in a patch whose missing frames repeat the last one.
        index = torch.arange(frames + padded, device=x_BFD.device).minimum(lengths_B[:, None] - 1)
        x_BFD = x_BFD.gather(1, index[..., None].expand(-1, -1, x_BFD.shape[-1]))
        x = self.patch_in(x_BFD.reshape(batch, -1, PATCH * x_BFD.shape[-1]))
        patches = _patches(lengths_B)
        mask = _mask(patches, x.shape[1])
        x = (x + self.length_in(place(lengths_B, x.shape[1]))).transpose(1, 2) * mask
        for block in self.encoder:
            x = block(x, mask)
        slots = resample(x.transpose(1, 2), patches, torch.full_like(patches, self.config.slots * self.config.tokens))
        tokens = self.merge(slots.reshape(batch, self.config.tokens, -1))
        for mixer in self.encoder_mixer:
            tokens = mixer(tokens)
        # Full precision, and a bounded spread: exp(log-variance) of one bad batch would otherwise end a training.
        with torch.autocast(x.device.type, enabled=False):
            mean, spread = self.to_latent(self.norm_latent(tokens.float())).chunk(2, dim=-1)
        return mean, _MOST_LOG_VARIANCE - fn.softplus(_MOST_LOG_VARIANCE - spread)

    def decode(self, z_BND: Tensor, lengths_B: Tensor, frames: int) -> Tensor:
        """Features (B, frames, D) of latents (B, N, d); rows beyond a clip's length are zero.

        Args:
            lengths_B: frames of each clip, at most ``frames``.
            frames: rows of the output.
        """
        batch = len(z_BND)
        tokens = self.from_latent(z_BND)
        for mixer in self.decoder_mixer:
            tokens = mixer(tokens)
        slots = self.split(tokens).reshape(batch, -1, self.config.width)
        patches = _patches(lengths_B)
        count = -(-frames // PATCH)
        mask = _mask(patches, count)
        x = resample(slots, torch.full_like(patches, slots.shape[1]), patches, count)
        x = (x + self.length_out(place(lengths_B, count))).transpose(1, 2) * mask
        for block in self.decoder:
            x = block(x, mask)
        x = self.patch_out(x.transpose(1, 2)).reshape(batch, count * PATCH, -1)[:, :frames].transpose(1, 2)
        valid = (torch.arange(frames, device=x.device) < lengths_B[:, None])[:, None]
        x = x * valid
        for block in self.frame:
            x = block(x, valid)
        # In bfloat16 the last product would quantise joint angles to a fraction of a degree: visible as jitter.
        with torch.autocast(x.device.type, enabled=False):
            return self.frame_out(x.float().transpose(1, 2)) * valid.transpose(1, 2)


class ConvBlock(nn.Module):
    """Residual pair of convolutions over time on (B, C, T); masked positions stay zero."""

    EPS = 1e-6

    def __init__(self, width: int, kernel: int, out_kernel: int) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.ones(width, 1))
        self.mix = nn.Conv1d(width, width, kernel, padding=kernel // 2)
        self.out = zeroed(nn.Conv1d(width, width, out_kernel, padding=out_kernel // 2))

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        """x (B, C, T), mask (B, 1, T)."""
        scale = torch.rsqrt((x * x).mean(dim=1, keepdim=True) + self.EPS)
        hidden = fn.gelu(self.mix(x * scale * self.gain), approximate="tanh") * mask
        return x + self.out(hidden) * mask


class TokenMixer(nn.Module):
    """MLP-mixer block on (B, N, C): the tokens are always all there and in order, so no attention is needed."""

    def __init__(self, width: int, tokens: int) -> None:
        super().__init__()
        self.norm_time = nn.LayerNorm(width)
        self.time = nn.Sequential(nn.Linear(tokens, 2 * tokens), nn.GELU("tanh"), nn.Linear(2 * tokens, tokens))
        self.norm_channels = nn.LayerNorm(width)
        self.channels = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU("tanh"), nn.Linear(2 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        """x (B, N, C)."""
        x = x + self.time(self.norm_time(x).transpose(1, 2)).transpose(1, 2)
        return x + self.channels(self.norm_channels(x))


_RELATIVE_WAVES = 8
_MOST_LOG_VARIANCE = 1.0


def _patches(lengths_B: Tensor) -> Tensor:
    return (lengths_B + PATCH - 1) // PATCH


def _mask(counts_B: Tensor, size: int) -> Tensor:
    return (torch.arange(size, device=counts_B.device) < counts_B[:, None])[:, None].float()


def place(lengths_B: Tensor, count: int) -> Tensor:
    """Where each patch stands: sinusoids of its relative time, and the clip's length; (B, P, 2W + 2)."""
    patch = torch.arange(count, device=lengths_B.device)
    relative = (patch + 0.5) / _patches(lengths_B)[:, None]
    waves = relative[..., None] * torch.pi * 2.0 ** torch.arange(_RELATIVE_WAVES, device=lengths_B.device).div(1.5)
    length = (lengths_B / 100.0)[:, None].expand_as(relative)
    return torch.cat((waves.sin(), waves.cos(), length[..., None], length.reciprocal()[..., None]), dim=-1)


def resample(x: Tensor, from_B: Tensor, to_B: Tensor, size: int | None = None) -> Tensor:
    """Linear interpolation of (B, T, C) over relative time, from ``from_B`` valid steps to ``to_B`` steps."""
    size = int(to_B.max()) if size is None else size
    at = torch.arange(size, device=x.device) + 0.5
    where = at / to_B[:, None] * from_B[:, None] - 0.5
    where = where.clamp(min=0.0).minimum((from_B - 1)[:, None].to(where.dtype))
    low = where.floor().long()
    high = (low + 1).minimum((from_B - 1)[:, None])
    part = (where - low)[..., None].to(x.dtype)
    take = (-1, -1, x.shape[-1])
    return x.gather(1, low[..., None].expand(take)) * (1 - part) + x.gather(1, high[..., None].expand(take)) * part


register("timed_vae", TimedVAEConfig, TimedVAE)
