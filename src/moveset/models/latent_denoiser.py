"""The denoiser that ships: the published network's U-shaped transformer, made cheap for a processor.

Same task as ``token_denoiser`` (noise prediction on the 16 latent tokens, MotionPCM §3 and Eq. 11), three changes:
the text's token states enter as extra keys and values instead of extra sequence elements (they are computed once per
prompt, and a step costs half); time, guidance, the pooled text and the clip's length modulate the blocks (one shared
adaLN, arXiv 2310.00426) instead of being tokens; blocks are pre-norm.

Shapes: B batch, N latent tokens, d latent width, L text tokens, C text width, W model width, H heads.
"""

from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.diffusion.schedule import Schedule, scaled_linear
from moveset.models.condition import Condition, Denoiser
from moveset.models.layers import time_embedding, zeroed
from moveset.models.registry import ModelConfig, register, require_range, require_sizes

WAVES = 256  # size of the embeddings of time, length and guidance scale, numbers of the order of 0..1000


@dataclass(frozen=True, kw_only=True, slots=True)
class LatentDenoiserConfig(ModelConfig):
    """Sizes of a ``LatentDenoiser``.

    Args:
        guided: adds the guidance-scale embedding of the students.
        carried: the input reaches the output by itself, eps = sigma_t z_t + alpha_t F, and the layers need only say
            what that lacks (F is v-prediction, arXiv 2202.00512). For wide latents of few tokens: their noise, copied
            through normalised layers as wide as itself, arrives with more error than a clean latent has variance.
    """

    tokens: int = 16
    token_dim: int = 32
    text_dim: int = 384
    width: int = 256
    heads: int = 4
    hidden: int = 1024
    blocks: int = 5
    dropout: float = 0.0
    guided: bool = False
    carried: bool = False

    def __post_init__(self) -> None:
        require_sizes(self)
        require_range("width modulo heads", self.width % self.heads, 0, 0)


@dataclass(frozen=True, eq=False)
class TextKeys:
    """A condition as the blocks read it: (keys, values) (B, H, L, W/H) of the text for every block, additive mask,
    summary (B, W); frames (B,) and guidance scale (B,) as they are."""

    pairs: tuple[tuple[Tensor, Tensor], ...]
    bias: Tensor
    pooled: Tensor
    length: Tensor | None
    scale: Tensor | None


class LatentDenoiser(Denoiser):
    """Predicts the noise (B, N, d) in latents at timesteps 0..999.

    It reads text, clip length (without one, 120 frames are assumed) and, as a student, the guidance scale; ``taps``
    collect every block's output (B, N, W).
    """

    of_students = MappingProxyType({"dropout": 0.0})

    def __init__(self, config: LatentDenoiserConfig) -> None:
        super().__init__()
        self.config = c = config
        self.latent_in = nn.Linear(c.token_dim, c.width)
        self.position = nn.Parameter(torch.randn(c.tokens, c.width) * 0.02)
        self.text_in = nn.Sequential(nn.Linear(c.text_dim, c.width), nn.GELU("tanh"), nn.Linear(c.width, c.width))
        self.text_norm = nn.LayerNorm(c.width)
        self.text_position = nn.Parameter(torch.randn(64, c.width) * 0.02)
        self.pool = nn.Linear(c.width, c.width)
        self.time = nn.Sequential(nn.Linear(WAVES, c.width), nn.SiLU(), nn.Linear(c.width, c.width))
        self.length = nn.Linear(WAVES, c.width)
        if c.guided:
            # Zero at the start: a fresh student is its teacher, whatever the guidance scale.
            self.guidance = zeroed(nn.Linear(WAVES, c.width, bias=False))
        self.modulate = nn.Linear(c.width, 6 * c.width)
        nn.init.normal_(self.modulate.weight, std=0.02)
        nn.init.zeros_(self.modulate.bias)
        self.blocks = nn.ModuleList(Block(c.width, c.heads, c.hidden, c.dropout) for _ in range(c.blocks))
        half = c.blocks // 2
        self.skips = nn.ModuleList(nn.Linear(2 * c.width, c.width) for _ in range(half))
        for skip in self.skips:
            # Start as if there were no skip: the current state passes, the remembered one is not yet used.
            nn.init.zeros_(skip.bias)
            with torch.no_grad():
                skip.weight.copy_(torch.cat((torch.eye(c.width), torch.zeros(c.width, c.width)), dim=1))
        self.norm_out = nn.LayerNorm(c.width, elementwise_affine=False)
        self.modulate_out = zeroed(nn.Linear(c.width, 2 * c.width))
        self.out = zeroed(nn.Linear(c.width, c.token_dim))
        self.schedule = scaled_linear() if c.carried else None

    def prepare(self, condition: Condition) -> TextKeys:
        said = condition.text.first(len(self.text_position))
        tokens_BLC, mask_BL = said.tokens, said.mask
        length = tokens_BLC.shape[1]
        text = self.text_norm(self.text_in(tokens_BLC) + self.text_position[:length])
        keep = mask_BL[..., None].to(text.dtype)
        pooled = self.pool((text * keep).sum(1) / keep.sum(1).clamp_min(1.0))
        bias = torch.zeros(mask_BL.shape, dtype=text.dtype, device=text.device).masked_fill(~mask_BL, -1e4)
        pairs = tuple(block.read(text) for block in self.blocks)
        return TextKeys(pairs, bias, pooled, condition.length, condition.scale)

    def denoise(self, z_BND: Tensor, t_B: Tensor, text: TextKeys, taps: list[Tensor] | None) -> Tensor:
        frames_B = torch.full_like(t_B, 120) if text.length is None else text.length
        condition = (
            self.time(time_embedding(t_B, WAVES)) + self.length(time_embedding(frames_B * 4.0, WAVES)) + text.pooled
        )
        if text.scale is not None:
            condition = condition + self.guidance(time_embedding(text.scale * 100.0, WAVES))
        condition = fn.silu(condition)
        modulation = self.modulate(condition)[:, None]
        x = self.latent_in(z_BND) + self.position
        half = len(self.blocks) // 2
        remembered: list[Tensor] = []
        # A mask costs the attention its fast path, so none is built when no prompt in the batch is padded.
        bias = None
        if bool((text.bias < 0).any()):
            latent_bias = text.bias.new_zeros(len(text.bias), z_BND.shape[1])
            bias = torch.cat((latent_bias, text.bias), dim=1)[:, None, None, :]
        for k, (block, pair) in enumerate(zip(self.blocks, text.pairs, strict=True)):
            if k >= len(self.blocks) - half:
                x = self.skips[k - (len(self.blocks) - half)](torch.cat((x, remembered.pop()), dim=-1))
            x = block(x, modulation, pair, bias)
            if k < half:
                remembered.append(x)
            if taps is not None:
                taps.append(x)
        scale, shift = self.modulate_out(condition)[:, None].chunk(2, dim=-1)
        # On the way to z_0 this is divided by alpha_t (times 14.6 at t = 999), which would magnify bfloat16's steps.
        with torch.autocast(x.device.type, enabled=False):
            said = self.out(self.norm_out(x.float()) * (1 + scale.float()) + shift.float())
            return said if self.schedule is None else carry(said, z_BND.float(), t_B, self.schedule)


class Block(nn.Module):
    """Self-attention over the latents with the text as extra keys and values, then a feed-forward; modulated."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.heads = heads
        self.dropout = dropout
        self.norm_attention = nn.LayerNorm(width, elementwise_affine=False)
        self.norm_feed = nn.LayerNorm(width, elementwise_affine=False)
        # The block's own offset to the shared modulation; both gates start at a small constant.
        self.offset = nn.Parameter(torch.zeros(6, width))
        with torch.no_grad():
            self.offset[[2, 5]] = 0.3
        self.qkv = nn.Linear(width, 3 * width)
        self.text_kv = nn.Linear(width, 2 * width)
        self.attended = nn.Linear(width, width)
        self.feed = nn.Linear(width, hidden)
        self.fed = nn.Linear(hidden, width)

    def read(self, text_BLW: Tensor) -> tuple[Tensor, Tensor]:
        """Keys and values (B, H, L, W/H) of the text."""
        keys, values = self.text_kv(text_BLW).chunk(2, dim=-1)
        return self._split(keys), self._split(values)

    def forward(self, x: Tensor, modulation: Tensor, text: tuple[Tensor, Tensor], bias: Tensor | None) -> Tensor:
        """x (B, N, W), modulation (B, 1, 6W)."""
        scale_a, shift_a, gate_a, scale_f, shift_f, gate_f = (modulation + self.offset.flatten()).chunk(6, dim=-1)
        hidden = self.norm_attention(x) * (1 + scale_a) + shift_a
        query, keys, values = (self._split(part) for part in self.qkv(hidden).chunk(3, dim=-1))
        keys, values = torch.cat((keys, text[0]), dim=2), torch.cat((values, text[1]), dim=2)
        mixed = _attend(query, keys, values, bias)
        mixed = self.attended(mixed.transpose(1, 2).flatten(2))
        x = x + gate_a * fn.dropout(mixed, self.dropout, self.training)
        hidden = self.norm_feed(x) * (1 + scale_f) + shift_f
        fed = self.fed(fn.gelu(self.feed(hidden), approximate="tanh"))
        return x + gate_f * fn.dropout(fed, self.dropout, self.training)

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)


def _attend(query: Tensor, keys: Tensor, values: Tensor, bias: Tensor | None) -> Tensor:
    """Scaled dot-product attention; spelled out in training, where the fused backward pass is five times slower."""
    if not torch.is_grad_enabled():
        return fn.scaled_dot_product_attention(query, keys, values, attn_mask=bias)
    weight = (query * query.shape[-1] ** -0.5) @ keys.transpose(-1, -2)
    if bias is not None:
        weight = weight + bias
    return weight.float().softmax(dim=-1).to(values.dtype) @ values


def carry(said_BND: Tensor, z_BND: Tensor, t_B: Tensor, schedule: Schedule) -> Tensor:
    """The noise (B, N, d) in z_t where a network says v_t = alpha_t eps - sigma_t z_0 (arXiv 2202.00512)."""
    return schedule.sigma(t_B)[:, None, None] * z_BND + schedule.alpha(t_B)[:, None, None] * said_BND


register("latent_denoiser", LatentDenoiserConfig, LatentDenoiser)
