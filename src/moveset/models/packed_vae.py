"""The decoder of ``timed_vae`` for inference on a processor: the same numbers in a third of the operations.

Time comes before channels throughout, so that nothing is transposed; activations and residual sums are part of the
products; masks exist only where clips of a batch differ in length; what depends on the length alone is kept.

Shapes: as in ``timed_vae``; B batch, F frames, D features, P patches, S slots, N latent tokens, C width.
"""

from functools import lru_cache

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.models.packed import PackedTimeConv
from moveset.models.timed_vae import PATCH, ConvBlock, TimedVAE, TokenMixer, place, resample
from moveset.text.packed_linear import PackedLinear


class PackedVAE(nn.Module):
    """What ``TimedVAE`` does, for inference."""

    def __init__(self, vae: TimedVAE) -> None:
        super().__init__()
        self.config = vae.config
        self.from_latent = PackedLinear.of(vae.from_latent)
        self.mixers = nn.ModuleList(PackedMixer(block) for block in vae.decoder_mixer)
        self.split = PackedLinear.of(vae.split)
        self.length_out = PackedLinear.of(vae.length_out)
        self.decoder = nn.ModuleList(PackedConvBlock(block) for block in vae.decoder)
        self.patch_out = PackedLinear.of(vae.patch_out)
        self.frame = nn.ModuleList(PackedConvBlock(block) for block in vae.frame)
        self.frame_out = PackedLinear.of(vae.frame_out)
        self.plain = vae  # encodes

    def encode(self, x_BFD: Tensor, lengths_B: Tensor) -> tuple[Tensor, Tensor]:
        """See ``TimedVAE.encode``."""
        return self.plain.encode(x_BFD, lengths_B)

    def decode(self, z_BND: Tensor, lengths_B: Tensor, frames: int) -> Tensor:
        """See ``TimedVAE.decode``."""
        batch, patches = len(z_BND), -(-frames // PATCH)
        tokens = self.from_latent(z_BND)
        for mixer in self.mixers:
            tokens = mixer(tokens)
        slots = self.split(tokens).view(batch, -1, self.config.width)
        mask_BP1 = mask_BF1 = None
        if bool((lengths_B == frames).all()):
            stretch, where = _whole(frames, slots.shape[1])
            x = self.length_out.plus(where.expand(batch, -1, -1), stretch @ slots)
        else:
            counts = (lengths_B + PATCH - 1) // PATCH
            mask_BP1 = (torch.arange(patches) < counts[:, None])[..., None].float()
            mask_BF1 = (torch.arange(frames) < lengths_B[:, None])[..., None].float()
            x = resample(slots, torch.full_like(counts, slots.shape[1]), counts, patches)
            x = self.length_out.plus(place(lengths_B, patches), x) * mask_BP1
        for block in self.decoder:
            x = block(x, mask_BP1)
        x = self.patch_out(x).view(batch, patches * PATCH, -1)[:, :frames].contiguous()
        x = x if mask_BF1 is None else x * mask_BF1
        for block in self.frame:
            x = block(x, mask_BF1)
        x = self.frame_out(x)
        return x if mask_BF1 is None else x * mask_BF1


class PackedConvBlock(nn.Module):
    """``ConvBlock`` on (B, T, C)."""

    def __init__(self, block: ConvBlock) -> None:
        super().__init__()
        # Dividing by the root of a mean is dividing by a length, times the root of the number of channels.
        width = len(block.gain)
        self.floor = torch.tensor((width * block.EPS) ** 0.5)
        self.mix = PackedTimeConv(block.mix, block.gain.detach() * width**0.5, "tanh_gelu")
        self.out = PackedTimeConv(block.out)

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """x (B, T, C), mask (B, T, 1) where there is padding."""
        size = torch.hypot(torch.linalg.vector_norm(x, dim=-1, keepdim=True), self.floor)
        if mask is None:
            return self.out.plus(self.mix(x / size), x)
        return x + self.out(self.mix(x / size) * mask) * mask


class PackedMixer(nn.Module):
    """``TokenMixer``: tokens are mixed from the left, so that nothing is transposed."""

    def __init__(self, block: TokenMixer) -> None:
        super().__init__()
        self.norm_time, self.norm_channels = block.norm_time, block.norm_channels
        into, back = block.time[0], block.time[2]
        self.into, self.into_bias = into.weight.detach(), into.bias.detach()[:, None]
        self.back, self.back_bias = back.weight.detach(), back.bias.detach()[:, None]
        self.up, self.down = PackedLinear.of(block.channels[0], "tanh_gelu"), PackedLinear.of(block.channels[2])

    def forward(self, x: Tensor) -> Tensor:
        """x (B, N, C)."""
        hidden = fn.gelu(torch.matmul(self.into, self.norm_time(x)) + self.into_bias, approximate="tanh")
        x = x + self.back_bias + torch.matmul(self.back, hidden)
        return self.down.plus(self.up(self.norm_channels(x)), x)


@lru_cache(maxsize=1024)
def _whole(frames: int, slots: int) -> tuple[Tensor, Tensor]:
    """(P, S) that stretches slots over a clip of that length, and (1, P, ...) where its patches stand."""
    with torch.inference_mode(False), torch.no_grad():
        count = torch.tensor([-(-frames // PATCH)])
        stretch = resample(torch.eye(slots)[None], torch.tensor([slots]), count, int(count))[0]
        return stretch, place(torch.tensor([frames]), int(count))
