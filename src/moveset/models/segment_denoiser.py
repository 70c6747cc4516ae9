"""The published segment denoiser: MotionDiffuse's linear-attention transformer that also sees the segment before.

With ``prev="none"`` and ``max_index=0`` it is MotionDiffuse's own network, whose one segment is the whole clip
("volume", 196 frames). RDM's recurrence adds two inputs: the number of the segment, and the previous segment at its
own noise level. Whether the output is read as the clean segment (RDM) or as the noise (MotionDiffuse) is up to whoever
trains it.

Shapes: B batch, n frames of the segment, m frames of the previous one, D features, L text tokens, C text channels,
M memory, P previous-segment width, W width, E conditioning width, H heads, d width of a head.
Source: MotionDiffuse (arXiv 2208.15001), efficient attention (arXiv 1812.01243), RDM (arXiv 2406.07169). How RDM reads
the previous segment is not published; one more cross-attention a layer is what its operation counts point to.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.diffusion.guidance import guidance_embedding
from moveset.errors import InputError
from moveset.models.condition import Condition, Denoiser
from moveset.models.layers import Block, TimeEmbedding, zeroed
from moveset.models.registry import ModelConfig, register, require_range, require_sizes

PREVIOUS = ("none", "xattn")
ATTENTION = ("linear", "softmax")


@dataclass(frozen=True, kw_only=True, slots=True)
class SegmentDenoiserConfig(ModelConfig):
    """Sizes of a ``SegmentDenoiser``; the defaults are MotionDiffuse on HumanML3D (KIT-ML: ``features=251``).

    Args:
        features: D.
        frames: the longest segment, which is also the longest previous one.
        text_dim: C of the token states: 512 for CLIP ViT-B/32, 384 for MiniLM.
        conditioning: E, the width in which time, segment number and summary of the text are added up.
        attention: "linear" (published) or "softmax".
        read_padding: read the text's padding as well, as published (CLIP's 77 positions); the mask then only says
            where the text ends. False: padding does not matter.
        prev: how the previous segment is read. "none": not at all. "xattn": by one more cross-attention a layer, to an
            encoding ``prev_width`` wide (1.24 times the operations at 28 frames).
        boundary: with "xattn", the last so many frames of the previous segment are given once more as tokens of their
            own, for a smooth join.
        max_index: larger segment numbers count as this one; 0: the number is not an input.
        guided: adds the guidance-scale embedding of the students.
    """

    features: int = 263
    frames: int = 196
    text_dim: int = 512
    width: int = 512
    layers: int = 8
    heads: int = 8
    feed_forward: int = 1024
    conditioning: int = 2048
    dropout: float = 0.0
    attention: str = "linear"
    text_width: int = 256
    text_layers: int = 4
    text_heads: int = 4
    text_feed_forward: int = 2048
    read_padding: bool = False
    prev: str = "none"
    prev_width: int = 256
    boundary: int = 0
    max_index: int = 0
    guided: bool = False
    guidance_waves: int = 256

    def __post_init__(self) -> None:
        limits = {"heads": (1, self.width), "text_heads": (1, self.text_width), "boundary": (0, self.frames)}
        require_sizes(self, layers=(1, 64), **limits)
        require_range("width modulo heads", self.width % self.heads, 0, 0)
        require_range("width modulo 2", self.width % 2, 0, 0)
        require_range("text_width modulo text_heads", self.text_width % self.text_heads, 0, 0)
        for name, known in (("prev", PREVIOUS), ("attention", ATTENTION)):
            if getattr(self, name) not in known:
                raise InputError(f"{name} = {getattr(self, name)!r} is not known; choose one of {', '.join(known)}")
        if self.prev != "none" and self.max_index == 0:
            raise InputError(f"prev = {self.prev!r} needs max_index >= 1: segment 0 has no previous segment")
        if self.boundary and self.prev != "xattn":
            raise InputError(f"boundary = {self.boundary} needs prev = 'xattn', but prev is {self.prev!r}")


@dataclass(frozen=True, eq=False)
class TextStates:
    """A prompt after the text layers: states (B, L, C'), mask (B, L) or None to read all, summary (B, E); and the
    condition that it is of."""

    states: Tensor
    mask: Tensor | None
    summary: Tensor
    condition: Condition


class SegmentDenoiser(Denoiser):
    """Predicts a segment (B, n, D) from a noisy one at level 0 … 1000, the text, its number and the segment before it.

    The segment before is read in full, by networks with a ``prev`` and not in rows of index 0. The text's summary is
    taken at the last real token: for CLIP that is the end-of-text token, whose state is CLIP's own summary. Frames that
    are not valid do not matter, and their output means nothing. ``taps`` collect every layer's output (B, n, W).
    """

    def __init__(self, config: SegmentDenoiserConfig) -> None:
        super().__init__()
        self.config = c = config
        self.text_in = nn.Linear(c.text_dim, c.text_width)
        self.text_blocks = nn.ModuleList(
            Block(c.text_width, c.text_heads, c.text_feed_forward, c.dropout, cross=False) for _ in range(c.text_layers)
        )
        self.text_norm = nn.LayerNorm(c.text_width)
        self.text_summary = nn.Linear(c.text_width, c.conditioning)

        self.frames_in = nn.Linear(c.features, c.width)
        self.position = nn.Parameter(torch.randn(c.frames, c.width))
        self.time = TimeEmbedding(c.conditioning, c.width, c.guidance_waves if c.guided else None)
        self.index = TimeEmbedding(c.conditioning, c.width, None) if c.max_index else None
        self.previous = Previous(c) if c.prev != "none" else None
        self.layers = nn.ModuleList(Layer(c) for _ in range(c.layers))
        self.out = zeroed(nn.Linear(c.width, c.features))

    def prepare(self, condition: Condition) -> TextStates:
        """The text layers: they depend on neither time nor noise, so a prompt needs them once.

        A row without any real token reads one zero token.
        """
        tokens_BLC, mask_BL = condition.text.tokens, condition.text.mask
        length = mask_BL.shape[1]
        last_B = (mask_BL * torch.arange(length, device=mask_BL.device)).amax(dim=1)
        mask = None
        if not self.config.read_padding:
            tokens_BLC = tokens_BLC.masked_fill(~mask_BL[..., None], 0.0)
            empty = ~mask_BL.any(dim=1, keepdim=True)
            mask = mask_BL | (empty & (torch.arange(length, device=mask_BL.device) == 0))
        x = self.text_in(tokens_BLC)
        for block in self.text_blocks:
            x = block(x, mask, None)
        x = self.text_norm(x)
        summary = self.text_summary(x[torch.arange(len(x), device=x.device), last_B])
        return TextStates(x, mask, summary, condition)

    def denoise(self, x_BnD: Tensor, t_B: Tensor, text: TextStates, taps: list[Tensor] | None) -> Tensor:
        """See ``Denoiser.forward``.

        Raises:
            InputError: a segment longer than ``frames``, a previous one that is longer or missing, or a guidance scale
                where none belongs (or the reverse).
        """
        past, w_B, mask_Bn = text.condition.past, text.condition.scale, text.condition.valid
        if past is None and (self.index is not None or self.previous is not None):
            raise InputError("this segment denoiser reads a past; give one of zeros and index 0 to a first segment")
        c, n = self.config, x_BnD.shape[1]
        require_length("segment", n, c.frames)
        w_BG = None if w_B is None else guidance_embedding(w_B, c.guidance_waves)
        condition = self.time(t_B, w_BG) + text.summary
        if self.index is not None and past is not None:
            condition = condition + self.index(past.index.clamp(max=c.max_index), None)
        condition = fn.silu(condition)

        if mask_Bn is not None:
            x_BnD = x_BnD.masked_fill(~mask_Bn[..., None], 0.0)
        x = self.frames_in(x_BnD) + self.position[:n]
        before = None
        if self.previous is not None and past is not None:
            before = self.previous(past.frames, past.level, past.index == 0)
        for layer in self.layers:
            x = layer(x, mask_Bn, text, before, condition)
            if taps is not None:
                taps.append(x)
        return self.out(x)


class Previous(nn.Module):
    """The previous segment as tokens (B, m, P): its frames, their positions and noise level; or a learned null."""

    def __init__(self, config: SegmentDenoiserConfig) -> None:
        super().__init__()
        self.boundary, width = config.boundary, config.prev_width
        self.frames_in = nn.Linear(config.features, width)
        self.position = nn.Parameter(torch.randn(config.frames, width))
        self.level = TimeEmbedding(width, config.width, None)
        self.null = nn.Parameter(torch.randn(width))
        if config.boundary:
            self.boundary_in = nn.Linear(config.features, width)
            self.boundary_position = nn.Parameter(torch.randn(config.boundary, width))

    def forward(self, prev_BmD: Tensor, prev_t_B: Tensor, first_B: Tensor) -> Tensor:
        """Tokens; rows of a first segment are the null, whatever stands in prev.

        Raises:
            InputError: more frames than positions.
        """
        require_length("previous segment", prev_BmD.shape[1], len(self.position))
        first = first_B[:, None, None]
        prev = prev_BmD.masked_fill(first, 0.0)
        tokens = self.frames_in(prev) + self.position[: prev.shape[1]]
        if self.boundary:
            # A previous segment shorter than the boundary gives what it has, the newest at the last place.
            last = self.boundary_in(prev[:, -self.boundary :])
            tokens = torch.cat((tokens, last + self.boundary_position[-last.shape[1] :]), dim=1)
        return torch.where(first, self.null, tokens + self.level(prev_t_B, None)[:, None])


class Layer(nn.Module):
    """Frames attend to each other, to the text and to the previous segment, then feed forward; each step stylized."""

    def __init__(self, config: SegmentDenoiserConfig) -> None:
        super().__init__()
        c = config
        self.itself, self.itself_out = Attention(c, None), Stylization(c)
        self.text, self.text_out = Attention(c, c.text_width), Stylization(c)
        self.before = Attention(c, c.prev_width) if c.prev != "none" else None
        self.before_out = Stylization(c) if c.prev != "none" else None
        self.inward, self.outward = nn.Linear(c.width, c.feed_forward), zeroed(nn.Linear(c.feed_forward, c.width))
        self.feed_out = Stylization(c)
        self.dropout = nn.Dropout(c.dropout)

    def forward(
        self, x_BnW: Tensor, mask_Bn: Tensor | None, text: TextStates, before_BmP: Tensor | None, condition_BE: Tensor
    ) -> Tensor:
        x = x_BnW + self.itself_out(self.itself(x_BnW, None, mask_Bn), condition_BE)
        x = x + self.text_out(self.text(x, text.states, text.mask), condition_BE)
        if self.before is not None and self.before_out is not None:
            x = x + self.before_out(self.before(x, before_BmP, None), condition_BE)
        fed = self.outward(self.dropout(fn.gelu(self.inward(x))))
        return x + self.feed_out(fed, condition_BE)


class Attention(nn.Module):
    """Pre-norm attention to the frames themselves or to a memory; the projection after it is the stylization's."""

    def __init__(self, config: SegmentDenoiserConfig, memory: int | None) -> None:
        super().__init__()
        self.heads, self.mix = config.heads, linear_attention if config.attention == "linear" else softmax_attention
        self.norm = nn.LayerNorm(config.width)
        self.memory_norm = None if memory is None else nn.LayerNorm(memory)
        self.query = nn.Linear(config.width, config.width)
        self.keys = nn.Linear(memory or config.width, config.width)
        self.values = nn.Linear(memory or config.width, config.width)

    def forward(self, x_BnW: Tensor, memory_BMC: Tensor | None, mask_BM: Tensor | None) -> Tensor:
        x = self.norm(x_BnW)
        memory = x if memory_BMC is None or self.memory_norm is None else self.memory_norm(memory_BMC)
        q, k, v = (
            part.unflatten(-1, (self.heads, -1)) for part in (self.query(x), self.keys(memory), self.values(memory))
        )
        return self.mix(q, k, v, mask_BM).flatten(2)


class Stylization(nn.Module):
    """Scale and shift by the conditioning, SiLU, and a projection that starts at zero: a fresh layer does nothing."""

    def __init__(self, config: SegmentDenoiserConfig) -> None:
        super().__init__()
        self.modulate = nn.Linear(config.conditioning, 2 * config.width)
        self.norm = nn.LayerNorm(config.width)
        self.dropout = nn.Dropout(config.dropout)
        self.out = zeroed(nn.Linear(config.width, config.width))

    def forward(self, x_BnW: Tensor, condition_BE: Tensor) -> Tensor:
        scale, shift = self.modulate(condition_BE)[:, None].chunk(2, dim=-1)
        return self.out(self.dropout(fn.silu(self.norm(x_BnW) * (1 + scale) + shift)))


def linear_attention(q_BnHd: Tensor, k_BMHd: Tensor, v_BMHd: Tensor, mask_BM: Tensor | None) -> Tensor:
    """softmax_d(q) (softmax_M(k)^T v): linear in n and M, since keys meet values first. (B, n, H, d)

    The mask is True at entries to be read; a row that has none gives zero.
    """
    if mask_BM is not None:
        away = ~mask_BM[:, :, None, None]
        # Not minus infinity: a row without entries would become NaN.
        k_BMHd, v_BMHd = k_BMHd.masked_fill(away, torch.finfo(k_BMHd.dtype).min), v_BMHd.masked_fill(away, 0.0)
    context_BHde = torch.einsum("bmhd,bmhe->bhde", k_BMHd.softmax(dim=1), v_BMHd)
    return torch.einsum("bnhd,bhde->bnhe", q_BnHd.softmax(dim=-1), context_BHde)


def softmax_attention(q_BnHd: Tensor, k_BMHd: Tensor, v_BMHd: Tensor, mask_BM: Tensor | None) -> Tensor:
    """Ordinary attention, softmax(q k^T / sqrt(d)) v, in the layout of ``linear_attention``."""
    q, k, v = (part.transpose(1, 2) for part in (q_BnHd, k_BMHd, v_BMHd))
    mask = None if mask_BM is None else mask_BM[:, None, None, :]
    return fn.scaled_dot_product_attention(q, k, v, attn_mask=mask).transpose(1, 2)


def require_length(what: str, frames: int, limit: int) -> None:
    """Raises InputError for more frames than positions."""
    if frames > limit:
        raise InputError(f"a {what} of {frames} frames exceeds the model's {limit} positions; shorten it")


register("segment_denoiser", SegmentDenoiserConfig, SegmentDenoiser)
