"""Light-T2M's denoiser: 4.48 M parameters, convolutions for what is near, a state space over patches for what is far.

It denoises a whole clip (one segment: with it as the denoiser, RDM is Light-RDM-1); a previous segment is not an input.

Shapes: B batch, n frames, D features, L text tokens, C text channels, W width, P patches of eight frames.
Source: Light-T2M (Zeng et al., AAAI 2025). One difference: padded frames take no part, neither in the
statistics of the normalisation nor in the state space, so that a clip does not depend on the batch it is in. For a
batch without padding that is the published network.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.errors import InputError
from moveset.models.condition import Condition, Denoiser
from moveset.models.layers import sinusoids, time_embedding
from moveset.models.registry import ModelConfig, register, require_range, require_sizes
from moveset.models.selective_scan import Mamba

POOLS = ("last", "mean")


@dataclass(frozen=True, kw_only=True, slots=True)
class LightT2MConfig(ModelConfig):
    """Sizes of a ``LightT2M``; the defaults are the published ones on HumanML3D (KIT-ML: ``features=251``).

    Args:
        features: D.
        frames: the longest clip.
        text_dim: C.
        pool: how the text becomes the one vector that is read. "last": the last real token (CLIP's end-of-text token,
            or a single pooled one). "mean": the mean of the real tokens (MiniLM).
        stages: each is local, mixed, local.
        patch: frames a patch.
        groups: of the group normalisation.
        states, convolution, expand, rank: of the state space, see ``Mamba``.
        dropout: of the input's sum with its positions.
    """

    features: int = 263
    frames: int = 199
    text_dim: int = 512
    pool: str = "last"
    width: int = 256
    stages: int = 4
    patch: int = 8
    groups: int = 16
    states: int = 16
    convolution: int = 4
    expand: int = 2
    rank: int = 16
    dropout: float = 0.1

    def __post_init__(self) -> None:
        few = dict.fromkeys(("stages", "patch", "states", "convolution", "expand"), (1, 64))
        require_sizes(self, frames=(1, 4096), width=(2, 4096), **few)
        require_range("width modulo 2", self.width % 2, 0, 0)
        require_range("width modulo groups", self.width % self.groups, 0, 0)
        if self.pool not in POOLS:
            raise InputError(f"pool = {self.pool!r} is not known; choose one of {', '.join(POOLS)}")


class LightT2M(Denoiser):
    """Predicts a clip (B, n, D) from a noisy one, its noise level and one text vector.

    A row without any real token is the empty prompt; valid frames are a clip's first ones. There is no distilled
    student of this network. ``taps`` collect every stage's output (B, n, W).
    """

    def __init__(self, config: LightT2MConfig) -> None:
        super().__init__()
        self.config = c = config
        self.frames_in = nn.Linear(c.features, c.width)
        self.text_in = nn.Linear(c.text_dim, c.width)
        self.time = nn.Linear(c.width, c.width)
        self.dropout = nn.Dropout(c.dropout)
        self.stages = nn.ModuleList(Stage(c) for _ in range(c.stages))
        self.out = nn.Linear(c.width, c.features)

    def denoise(self, x_BnD: Tensor, t_B: Tensor, condition: Condition, taps: list[Tensor] | None) -> Tensor:
        """See ``Denoiser.forward``.

        Raises:
            InputError: a later segment than the first, a clip longer than ``frames``, or a guidance scale.
        """
        text, past, mask_Bn = condition.text, condition.past, condition.valid
        c, n = self.config, x_BnD.shape[1]
        if past is not None and bool((past.index > 0).any()):
            raise InputError(
                f"light_t2m denoises whole clips, but segment {int(past.index.max())} was asked for; "
                "use segment_denoiser"
            )
        if condition.scale is not None:
            raise InputError("light_t2m does not take a guidance scale: it is a teacher, only distilled students do")
        if n > c.frames:
            raise InputError(f"a clip of {n} frames exceeds the model's {c.frames}; shorten it")
        mask = torch.ones(x_BnD.shape[:2], dtype=torch.bool, device=x_BnD.device) if mask_Bn is None else mask_Bn
        text_B1W = self.text_in(self.pooled(text.tokens, text.mask))[:, None]
        frames = self.frames_in(x_BnD.masked_fill(~mask[..., None], 0.0))
        time = self.time(time_embedding(t_B, c.width).to(frames.dtype))[:, None]
        x = torch.cat((time, frames), dim=1)
        places = sinusoids(torch.arange(n + 1, device=x.device), c.width)
        x = self.dropout(x + places.to(x.dtype))
        mask = torch.cat((mask.new_ones(len(mask), 1), mask), dim=1)
        for stage in self.stages:
            x = stage(x, mask, text_B1W)
            if taps is not None:
                taps.append(x[:, 1:])
        return self.out(x[:, 1:])

    def pooled(self, tokens_BLC: Tensor, mask_BL: Tensor) -> Tensor:
        """The text as one vector (B, C); zero where the prompt is empty."""
        tokens = tokens_BLC.masked_fill(~mask_BL[..., None], 0.0)
        if self.config.pool == "mean":
            return tokens.sum(dim=1) / mask_BL.sum(dim=1, keepdim=True).clamp_min(1)
        last_B = (mask_BL * torch.arange(mask_BL.shape[1], device=mask_BL.device)).amax(dim=1)
        return tokens[torch.arange(len(tokens), device=tokens.device), last_B]


class Stage(nn.Module):
    """Local, mixed, local."""

    def __init__(self, config: LightT2MConfig) -> None:
        super().__init__()
        self.before, self.mixed, self.after = Local(config), Mixed(config), Local(config)

    def forward(self, x_BlW: Tensor, mask_Bl: Tensor, text_B1W: Tensor) -> Tensor:
        """x is the time token and the frames, l = 1 + n."""
        return self.after(self.mixed(self.before(x_BlW, mask_Bl), mask_Bl, text_B1W), mask_Bl)


class Local(nn.Module):
    """A convolution over three neighbours; the time token is the first frame's neighbour."""

    def __init__(self, config: LightT2MConfig) -> None:
        super().__init__()
        self.point = nn.Linear(config.width, config.width)
        self.near = nn.Conv1d(config.width, config.width, 3, padding=1, groups=config.width)
        self.group_norm = MaskedGroupNorm(config.groups, config.width)
        self.norm = nn.LayerNorm(config.width)

    def forward(self, x_BlW: Tensor, mask_Bl: Tensor) -> Tensor:
        away = ~mask_Bl[..., None]
        x = x_BlW.masked_fill(away, 0.0)
        # Zeroed once more after the bias: beyond the clip's end there is nothing, as beyond the sequence's.
        near = self.near(self.point(x).masked_fill(away, 0.0).mT)
        return self.norm(x + fn.relu(self.group_norm(near, mask_Bl)).mT)


class Mixed(nn.Module):
    """Patches of frames take in the text, then see the whole clip, and tell their frames."""

    def __init__(self, config: LightT2MConfig) -> None:
        super().__init__()
        c = config
        self.patch = c.patch
        self.point = nn.Linear(c.width, c.width)
        self.down = nn.Conv1d(c.width, c.width, c.patch, stride=c.patch, groups=c.width)
        self.gate, self.fuse = nn.Linear(2 * c.width, c.width), nn.Linear(2 * c.width, c.width)
        self.mamba = Mamba(c.width, c.states, c.convolution, c.expand, c.rank)
        self.mamba_norm = nn.LayerNorm(c.width)
        self.tell = nn.Linear(2 * c.width, c.width)
        self.norm = nn.LayerNorm(c.width)

    def forward(self, x_BlW: Tensor, mask_Bl: Tensor, text_B1W: Tensor) -> Tensor:
        time, frames = x_BlW.masked_fill(~mask_Bl[..., None], 0.0).split((1, x_BlW.shape[1] - 1), dim=1)
        count = frames.shape[1]
        missing = -count % self.patch
        filled = fn.pad(frames, (0, 0, 0, missing))
        mask_BP = fn.pad(mask_Bl[:, 1:], (0, missing)).unflatten(1, (-1, self.patch)).any(dim=-1)
        patches = self.down(fn.relu(self.point(filled)).mT).mT

        text = text_B1W.expand_as(patches)
        text = text * self.gate(torch.cat((patches, text), dim=-1)).sigmoid()
        patches = self.fuse(torch.cat((patches, text), dim=-1))
        # Having read the clip backwards, the second, forward reading of every patch knows what comes after it.
        both = torch.cat((patches.flip(1), patches), dim=1)
        mixed = self.mamba_norm(both + self.mamba(both, torch.cat((mask_BP.flip(1), mask_BP), dim=1)))
        told = mixed[:, patches.shape[1] :].repeat_interleave(self.patch, dim=1)[:, :count]
        return self.norm(torch.cat((time, self.tell(torch.cat((frames, told), dim=-1))), dim=1))


class MaskedGroupNorm(nn.Module):
    """``torch.nn.GroupNorm`` whose statistics know the masked-in elements only."""

    def __init__(self, groups: int, width: int) -> None:
        super().__init__()
        self.groups = groups
        self.weight, self.bias = nn.Parameter(torch.ones(width)), nn.Parameter(torch.zeros(width))

    def forward(self, x_BWl: Tensor, mask_Bl: Tensor) -> Tensor:
        x = x_BWl.unflatten(1, (self.groups, -1))
        weight = mask_Bl[:, None, None].to(x.dtype)
        count = weight.sum(dim=(2, 3), keepdim=True) * x.shape[2]
        centred = x - (x * weight).sum(dim=(2, 3), keepdim=True) / count
        variance = (centred.square() * weight).sum(dim=(2, 3), keepdim=True) / count
        normal = (centred * torch.rsqrt(variance + 1e-5)).flatten(1, 2)
        return normal * self.weight[:, None] + self.bias[:, None]


register("light_t2m", LightT2MConfig, LightT2M)
