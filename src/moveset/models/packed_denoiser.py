"""``latent_denoiser`` for inference on a processor: the same numbers in half of the operations.

The modulation of all blocks, and the text's keys and values in all of them, are one product each; a modulated norm is
one operation for one clip; activations and sums are part of the products; queries, keys and values are never copied.

Shapes: as in ``latent_denoiser``; B batch, N latent tokens, d latent width, L text tokens, W width, H heads.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.models.condition import Condition, Denoiser
from moveset.models.latent_denoiser import WAVES, Block, LatentDenoiser, carry
from moveset.models.layers import frequencies
from moveset.text.packed_linear import PackedLinear


@dataclass(frozen=True, eq=False)
class PackedText:
    """A condition as the blocks read it: keys and values (B, L, 2, H, W/H) of the text for every block, mask, summary
    (B, W); frames (B,) and guidance scale (B,) as they are."""

    pairs: tuple[Tensor, ...]
    bias: Tensor | None
    pooled: Tensor
    length: Tensor | None
    scale: Tensor | None


class PackedDenoiser(Denoiser):
    """What ``LatentDenoiser`` does, for inference."""

    def __init__(self, denoiser: LatentDenoiser) -> None:
        super().__init__()
        self.config = c = denoiser.config
        self.text_in = PackedLinear.of(denoiser.text_in[0], "tanh_gelu")
        self.text_out = PackedLinear.of(denoiser.text_in[2])
        self.text_norm, self.text_position = denoiser.text_norm, denoiser.text_position.detach()
        # A single row is read fastest as it is.
        self.pool, self.time, self.length = denoiser.pool, denoiser.time, denoiser.length
        self.guidance = denoiser.guidance if c.guided else None
        self.text_kv = _stacked([block.text_kv for block in denoiser.blocks])
        self.latent_in, self.position = PackedLinear.of(denoiser.latent_in), denoiser.position.detach()[None]
        self.frequencies = frequencies(WAVES // 2, denoiser.position.device)
        self.modulate = _stacked([denoiser.modulate, denoiser.modulate_out])
        # A scale is one plus what the network says; so is that of the last norm, whose block has no offset.
        one = torch.zeros(8, c.width)
        one[[0, 3, 6]] = 1.0
        self.offsets = torch.stack([block.offset.detach() for block in denoiser.blocks]) + one[:6]
        self.offsets_out = one[6:]
        self.blocks = nn.ModuleList(PackedBlock(block) for block in denoiser.blocks)
        self.skips = nn.ModuleList(PackedLinear.of(skip) for skip in denoiser.skips)
        self.out = PackedLinear.of(denoiser.out)
        self.schedule = denoiser.schedule

    def prepare(self, condition: Condition) -> PackedText:
        said = condition.text.first(len(self.text_position))
        tokens_BLC, mask_BL = said.tokens, said.mask
        batch, length, _ = tokens_BLC.shape
        text = self.text_norm(self.text_out(self.text_in(tokens_BLC)) + self.text_position[:length])
        bias = None
        if bool(mask_BL.all()):
            summary = text.mean(1)
        else:
            keep = mask_BL[..., None].to(text.dtype)
            summary = (text * keep).sum(1) / keep.sum(1).clamp_min(1.0)
            seen = torch.cat((mask_BL.new_ones(batch, self.config.tokens), mask_BL), dim=1)
            bias = torch.zeros(seen.shape, dtype=text.dtype).masked_fill(~seen, -1e4)[:, None, None]
        heads = self.config.heads
        pairs = self.text_kv(text).view(batch, length, len(self.blocks), 2, heads, -1).unbind(2)
        return PackedText(pairs, bias, self.pool(summary), condition.length, condition.scale)

    def denoise(self, z_BND: Tensor, t_B: Tensor, text: PackedText, taps: list[Tensor] | None) -> Tensor:
        parts = self._modulation(t_B, text)
        x = self.latent_in(z_BND) + self.position
        half = len(self.blocks) // 2
        remembered: list[Tensor] = []
        for k, (block, pair) in enumerate(zip(self.blocks, text.pairs, strict=True)):
            if k >= len(self.blocks) - half:
                x = self.skips[k - (len(self.blocks) - half)](torch.cat((x, remembered.pop()), dim=-1))
            x = block(x, parts[6 * k : 6 * k + 6], pair, text.bias)
            if k < half:
                remembered.append(x)
            if taps is not None:
                taps.append(x)
        said = self.out(_modulated(x, *parts[-2:]))
        return said if self.schedule is None else carry(said, z_BND, t_B, self.schedule)

    def _modulation(self, t_B: Tensor, text: PackedText) -> tuple[Tensor, ...]:
        """Scale, shift and gate of every norm: six a block and two at the end; (W,) for one clip, else (B, 1, W)."""
        w_B, frames_B = text.scale, torch.full_like(t_B, 120) if text.length is None else text.length
        numbers = (t_B, frames_B * 4.0, torch.zeros_like(t_B) if w_B is None else w_B * 100.0)
        angle = torch.stack(numbers)[..., None] * self.frequencies
        t, frames, w = torch.cat((angle.cos(), angle.sin()), dim=-1)
        condition = self.time(t) + self.length(frames) + text.pooled
        if self.guidance is not None and w_B is not None:
            condition = condition + self.guidance(w)
        batch, width = len(t_B), self.config.width
        shared = self.modulate(fn.silu(condition)).view(batch, 8, width)
        parts = (shared[:, None, :6] + self.offsets).flatten(1, 2), shared[:, 6:] + self.offsets_out
        rows = torch.cat(parts, dim=1)
        return rows[0].unbind(0) if batch == 1 else rows[:, :, None].unbind(1)


class PackedBlock(nn.Module):
    """``Block``; its share of the modulation and the text's keys and values come ready."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        self.heads = block.heads
        self.qkv, self.attended = PackedLinear.of(block.qkv), PackedLinear.of(block.attended)
        self.feed, self.fed = PackedLinear.of(block.feed, "tanh_gelu"), PackedLinear.of(block.fed)

    def forward(self, x: Tensor, parts: tuple[Tensor, ...], text: Tensor, bias: Tensor | None) -> Tensor:
        """x (B, N, W); parts: scale, shift, gate, twice; text (B, L, 2, H, W/H)."""
        scale_a, shift_a, gate_a, scale_f, shift_f, gate_f = parts
        qkv = self.qkv(_modulated(x, scale_a, shift_a)).unflatten(-1, (3, self.heads, -1))
        keys, values = torch.cat((qkv[:, :, 1:], text), dim=1).permute(2, 0, 3, 1, 4)
        mixed = fn.scaled_dot_product_attention(qkv[:, :, 0].transpose(1, 2), keys, values, attn_mask=bias)
        x = torch.addcmul(x, gate_a, self.attended(mixed.transpose(1, 2).flatten(2)))
        return torch.addcmul(x, gate_f, self.fed(self.feed(_modulated(x, scale_f, shift_f))))


def _modulated(x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
    """Scaled and shifted after a norm; for one clip by the norm itself."""
    if scale.ndim == 1:
        return fn.layer_norm(x, x.shape[-1:], scale, shift)
    return torch.addcmul(shift, fn.layer_norm(x, x.shape[-1:]), scale)


def _stacked(layers: list[nn.Linear]) -> PackedLinear:
    """Layers of one input as one, their outputs one after the other."""
    return PackedLinear(torch.cat([layer.weight for layer in layers]), torch.cat([layer.bias for layer in layers]))
