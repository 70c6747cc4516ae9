"""The segment denoiser that ships: predicts a clean segment from a noisy one, the segment before it, and text.

Same task as ``segment_denoiser`` (RDM, Section 4), made cheap for a processor with the blocks of ``latent_denoiser``:
text tokens and the frames of the previous segment enter as extra keys and values, computed once where neither changes;
time, levels and text modulate the blocks.

The network says the clean segment itself. A skip from the noisy input (the preconditioning of Karras et al. 2022, arXiv
2206.00364) would spare it the copying at low noise, but what it then fails to take off the input stays in the output as
jitter. For the same reason it is trained on noise with the spectrum of motion (``diffusion.coloured``), which belongs
to the network: ``colour``.

What it says is added to a linear forecast from the last two frames of the segment before (fitted to the data before
training, and learned on from there), as far as that segment is clean: going on should not have to be found out.

Shapes: B rows, n frames, D features, L text tokens, C text width, W model width.
"""

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.diffusion.coloured import colour, dct_matrix
from moveset.diffusion.schedule import linear
from moveset.errors import InputError
from moveset.models.condition import Condition, Denoiser
from moveset.models.latent_denoiser import WAVES, Block
from moveset.models.layers import time_embedding, zeroed
from moveset.models.registry import ModelConfig, register, require_range, require_sizes

_SCHEDULE = linear()


@dataclass(frozen=True, kw_only=True, slots=True)
class SegmentTransformerConfig(ModelConfig):
    """Sizes of a ``SegmentTransformer``; ``guided`` adds the guidance-scale embedding of the few-step students.

    ``max_index`` is where the segment index saturates: 1 tells a first segment from a later one, and nothing more.
    ``smoothing`` c damps frequency k of what the network says by s_k / sqrt(s_k² + c²), s being the spectrum of the
    data: frames are made by one token each, and what little they disagree in is worth nothing to a squared error and
    all to the eye. ``tremor`` is c where it is larger, for the frequencies above a third of the highest, in which
    nobody moves on purpose: with one c for all that is strong enough against trembling, feet swing too low. 0 leaves
    all as it is. ``alone`` takes every segment for a first one, whatever is told of the one before it.
    ``heading_change`` reads how far the way has turned since the sentence began, wherever that is told.
    """

    features: int = 269
    frames: int = 28
    text_dim: int = 384
    width: int = 256
    heads: int = 4
    hidden: int = 1024
    blocks: int = 4
    max_index: int = 1
    smoothing: float = 0.0
    tremor: float = 0.0
    guided: bool = False
    alone: bool = False
    heading_change: bool = False

    def __post_init__(self) -> None:
        require_sizes(self, frames=(2, 4096), smoothing=(0.0, 100.0), tremor=(0.0, 100.0))
        require_range("width modulo heads", self.width % self.heads, 0, 0)


@dataclass(frozen=True, eq=False)
class Context:
    """What a segment depends on besides itself.

    Keys and values for every block, additive mask, modulation (B, W), the last frame before (B, 1, W), and the segment
    that is to be expected from the last two frames (B, n, D); guidance scale (B,) and valid frames (B, n) as they are.
    """

    pairs: tuple[tuple[Tensor, Tensor], ...]
    bias: Tensor | None
    modulation: Tensor
    last: Tensor
    expected: Tensor
    scale: Tensor | None
    valid: Tensor | None


class SegmentTransformer(Denoiser):
    """Predicts the clean segment (B, n, D) of a noisy one at level 0 … 1000, from text and what it goes on from.

    Segment numbers beyond ``max_index`` are all alike. Only networks with ``heading_change`` read the change of
    heading, and none of more than a turn. ``taps`` collect every block's output (B, n, W).
    """

    def __init__(self, config: SegmentTransformerConfig) -> None:
        super().__init__()
        self.config = c = config
        # The spectrum of the noise that the network knows; flat: white noise.
        self.register_buffer("spectrum", torch.ones(c.frames, c.features))
        # Weights of the last frame before, and of its difference to the one before that, in every frame to come.
        self.forecast = nn.Parameter(torch.zeros(2, c.frames, c.features))
        self.frame_in = nn.Linear(c.features, c.width)
        self.position = nn.Parameter(torch.randn(c.frames, c.width) * 0.02)
        self.previous_in = nn.Linear(c.features, c.width)
        self.previous_position = nn.Parameter(torch.randn(c.frames, c.width) * 0.02)
        self.previous_level = nn.Linear(WAVES, c.width)
        self.previous_norm = nn.LayerNorm(c.width)
        self.no_previous = nn.Parameter(torch.randn(c.frames, c.width) * 0.02)
        # The frame that the segment goes on from, beside every frame of it: continuity should not need attention.
        self.last_in = nn.Linear(c.features, c.width)
        self.text_in = nn.Sequential(nn.Linear(c.text_dim, c.width), nn.GELU("tanh"), nn.Linear(c.width, c.width))
        self.text_norm = nn.LayerNorm(c.width)
        self.text_position = nn.Parameter(torch.randn(64, c.width) * 0.02)
        self.pool = nn.Linear(c.width, c.width)
        self.time = nn.Sequential(nn.Linear(WAVES, c.width), nn.SiLU(), nn.Linear(c.width, c.width))
        self.index = nn.Embedding(c.max_index + 1, c.width)
        nn.init.normal_(self.index.weight, std=0.02)
        if c.heading_change:
            # Zero at the start, so that a network may learn it after the rest.
            self.course = zeroed(nn.Linear(WAVES, c.width, bias=False))
        if c.guided:
            # Zero at the start: a fresh student is its teacher, whatever the guidance scale.
            self.guidance = zeroed(nn.Linear(WAVES, c.width, bias=False))
        self.modulate = nn.Linear(c.width, 6 * c.width)
        nn.init.normal_(self.modulate.weight, std=0.02)
        nn.init.zeros_(self.modulate.bias)
        self.blocks = nn.ModuleList(Block(c.width, c.heads, c.hidden, 0.0) for _ in range(c.blocks))
        self.norm_out = nn.LayerNorm(c.width, elementwise_affine=False)
        self.modulate_out = zeroed(nn.Linear(c.width, 2 * c.width))
        self.out = zeroed(nn.Linear(c.width, c.features))

    def colour(self, noise_BnD: Tensor) -> Tensor:
        """Standard normal noise (B, n, D) as this network was trained on it."""
        return colour(noise_BnD, cast(Tensor, self.spectrum))

    def prepare(self, condition: Condition) -> Context:
        """Text and previous segment, for any number of calls in which neither they nor their level change."""
        past = condition.past
        if past is None:
            raise InputError("a segment transformer needs a past; give one of zeros and index 0 to a first segment")
        said = condition.text.first(len(self.text_position))
        tokens_BLC, mask_BL = said.tokens, said.mask
        prev_BnD, prev_t_B, index_B = past.frames, past.level, past.index
        if self.config.alone:
            prev_t_B, index_B = torch.zeros_like(prev_t_B), torch.zeros_like(index_B)
        length = tokens_BLC.shape[1]
        text = self.text_norm(self.text_in(tokens_BLC) + self.text_position[:length])
        keep = mask_BL[..., None].to(text.dtype)
        pooled = self.pool((text * keep).sum(1) / keep.sum(1).clamp_min(1.0))
        later = (index_B > 0)[:, None, None]
        level = self.previous_level(time_embedding(prev_t_B, WAVES))
        told = self.previous_norm(self.previous_in(prev_BnD) + self.previous_position + level[:, None])
        previous = torch.where(later, told, self.no_previous.to(told.dtype))
        last = torch.where(later, self.last_in(prev_BnD[:, -1:]), torch.zeros((), device=told.device, dtype=told.dtype))
        context = torch.cat((text.to(told.dtype), previous), dim=1)
        bias = None
        # A mask costs the attention its fast path, so none is built when no prompt in the batch is padded.
        if not bool(mask_BL.all()):
            bias = torch.zeros(context.shape[:2], dtype=torch.float32, device=context.device)
            bias[:, :length].masked_fill_(~mask_BL, -1e4)
        modulation = pooled + self.index(index_B.clamp(max=self.config.max_index)) + level
        if self.config.heading_change and past.heading_change is not None:
            modulation = modulation + self.course(course_waves(past.heading_change))
        pairs = tuple(cast(Block, block).read(context) for block in self.blocks)
        expected = self._expected(prev_BnD, prev_t_B, index_B)
        return Context(pairs, bias, modulation, last, expected, condition.scale, condition.valid)

    def _expected(self, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor) -> Tensor:
        """The linear forecast (B, n, D), fading with the noise in what it is made from; zero for first segments."""
        last_BD, step_BD = prev_BnD[:, -1].float(), (prev_BnD[:, -1] - prev_BnD[:, -2]).float()
        clean_B = _SCHEDULE.alpha(prev_t_B).square() * (index_B > 0)
        forecast = self.forecast[0] * last_BD[:, None] + self.forecast[1] * step_BD[:, None]
        return forecast * clean_B[:, None, None]

    def denoise(self, x_BnD: Tensor, t_B: Tensor, context: Context, taps: list[Tensor] | None) -> Tensor:
        condition = context.modulation + self.time(time_embedding(t_B, WAVES))
        if context.scale is not None:
            condition = condition + self.guidance(time_embedding(context.scale * 100.0, WAVES))
        condition = fn.silu(condition)
        modulation = self.modulate(condition)[:, None]
        x = self.frame_in(x_BnD) + self.position + context.last
        bias = self._bias(context, x)
        for block, pair in zip(self.blocks, context.pairs, strict=True):
            x = block(x, modulation, pair, bias)
            if taps is not None:
                taps.append(x)
        scale, shift = self.modulate_out(condition)[:, None].chunk(2, dim=-1)
        # In bfloat16 the last product would quantise joint angles to a fraction of a degree: visible as jitter.
        with torch.autocast(x.device.type, enabled=False):
            missed = self.out(self.norm_out(x.float()) * (1 + scale.float()) + shift.float())
            return context.expected + self._smoothed(missed)

    def _smoothed(self, x_BnD: Tensor) -> Tensor:
        frames, smoothing, tremor = self.config.frames, self.config.smoothing, self.config.tremor
        if not (smoothing or tremor):
            return x_BnD
        spectrum = cast(Tensor, self.spectrum)
        # From one to the other within a few frequencies: an edge would ring.
        fast_k = torch.sigmoid(torch.arange(frames, device=x_BnD.device) - frames / 3)
        limit_k1 = (smoothing + (max(tremor, smoothing) - smoothing) * fast_k)[:, None]
        keep = spectrum / (spectrum.square() + limit_k1.square()).sqrt()
        dct = dct_matrix(frames, x_BnD.device)
        return dct.T @ (keep * (dct @ x_BnD))

    @staticmethod
    def _bias(context: Context, x: Tensor) -> Tensor | None:
        """Additive mask (B, 1, 1, n + L + n) over own frames and context, or None where everything may be seen."""
        mask_Bn = context.valid
        if context.bias is None and (mask_Bn is None or bool(mask_Bn.all())):
            return None
        own = x.new_zeros(x.shape[:2])
        if mask_Bn is not None:
            own = own.masked_fill(~mask_Bn, -1e4)
        keys = context.pairs[0][0].shape[2]
        told = x.new_zeros(len(x), keys) if context.bias is None else context.bias.to(x.dtype)
        return torch.cat((own, told), dim=1)[:, None, None, :]


def course_waves(turned_B: Tensor) -> Tensor:
    """Sinusoids (B, 256) of how far a way has turned, in tens of degrees: nobody needs to know it more finely. Zero
    where it is not known, or more than a turn."""
    known_B = turned_B.abs() <= 2 * torch.pi  # NaN is not
    return time_embedding(turned_B.masked_fill(~known_B, 0.0).rad2deg() / 10.0, WAVES) * known_B[:, None]


register("segment_transformer", SegmentTransformerConfig, SegmentTransformer)
