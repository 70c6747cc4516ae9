"""The two-dimensional grid of RDM: segments of a sequence along one axis, noise levels along the other.

A sequence of F frames is cut from its first frame into N = ceil(F / n) segments of n frames. Cell (i, t) is segment i
at noise level t; its left neighbour (i - 1, t') with t' < t is what the denoiser is told of the past. Training draws
cells; ``corrupt`` says what the network sees in one.

Two readings of how a cell is made, with f the flow from one segment to the next and f^(p) its power:

- ``anchor="segment"``: y = f^(-p)(x_0^i) is noised and carried back, x_t^i = f^(p)(a_t y + s_t eps). In y every
  segment is an ordinary diffusion, whatever the flow is.
- ``anchor="first"``: the published Algorithm 2, x_t^i = f^(i)(a_t x_0^0 + s_t eps) with the target x_0^i. As t falls
  the input tells nothing of x_0^i beyond x_0^0, so the network learns the conditional mean; kept to show exactly that.

A sampler that lets segment i enter at level r as a copy of its neighbour (``rdm.staircase``) is at level t < r in a
state that still has a share of the copy. With q = (alpha_r / sigma_r) / (alpha_t / sigma_t), and a denoiser that is
right, DDPM's steps leave q^2 of the neighbour in the segment and a correlation q of the noise; DDIM's leave q of the
neighbour and all of the noise. ``entangled`` cells are such states.

Shapes: B rows, n frames of a segment, D features, C text width.
Source: RDM (arXiv 2406.07169), Sections 3 and 4, Algorithm 2, Eq. 9-10 and 27-30.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

from moveset.diffusion.schedule import Schedule
from moveset.diffusion.steps import add_noise, over
from moveset.errors import InputError
from moveset.rdm.transport import Transport

Anchor = Literal["segment", "first"]
ConditionLevel = Literal["below", "previous", "clean"]


@dataclass(frozen=True, kw_only=True)
class GridConfig:
    """How cells are drawn.

    Args:
        frames: n, frames of a segment.
        anchor: see the module.
        share_noise: one noise for a cell and its left neighbour, as Algorithm 2 has it. With ``anchor="segment"`` the
            two inputs would give the clean data away and sampling diverges.
        condition: level t' of the left neighbour: uniform "below" t, "previous" (t - 1, as published), or "clean"
            (t' = 0: the autoregressive baselines MD-N).
        entangled: share of cells that entered as a copy of their neighbour (``anchor="segment"``), at a level r which
            is uniform in its logarithm, so that late starts are as frequent as early ones; t is uniform in 1 … r, of
            first segments, too, which have no neighbour. Their noise is what DDPM leaves of the neighbour's, or with
            ``share_noise`` all of it, as DDIM.
        clean_share: share of cells whose neighbour is clean whatever ``condition`` says. A stream in which each segment
            waits for the one before meets nothing else, and "below" hardly ever draws t' = 0.

    Raises:
        InputError: an unknown reading, or fewer than 2 frames.
    """

    frames: int = 28
    anchor: Anchor = "segment"
    share_noise: bool = False
    condition: ConditionLevel = "below"
    clean_share: float = 0.0
    entangled: float = 0.0

    def __post_init__(self) -> None:
        if self.frames < 2:
            raise InputError(f"a segment of {self.frames} frames is too short; give at least 2")
        for name in ("clean_share", "entangled"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"{name} {getattr(self, name)} is not in 0 to 1")
        for name, kind in (("anchor", Anchor), ("condition", ConditionLevel)):
            if getattr(self, name) not in get_args(kind):
                raise InputError(f"{name} {getattr(self, name)!r} is not one of {', '.join(get_args(kind))}")


@dataclass(frozen=True, eq=False)
class Draws:
    """Everything random in one batch of cells: levels t and t' (B,), noises (B, n, D) of cell and neighbour, and how
    much of its neighbour is left in a segment that entered as a copy of it (B,), None if none did."""

    t_B: Tensor
    prev_t_B: Tensor
    noise_BnD: Tensor
    prev_noise_BnD: Tensor
    copied_B: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Cell:
    """What the denoiser sees: x_t^i at t, the left neighbour at t'. What it should say is the clean segment."""

    x_BnD: Tensor
    t_B: Tensor
    prev_BnD: Tensor
    prev_t_B: Tensor


def draw(config: GridConfig, schedule: Schedule, shape: tuple[int, int, int], generator: torch.Generator) -> Draws:
    """Levels and noises of B cells, ``shape`` = (B, n, D): t uniform in 1 … T, t' as the configuration says.

    Drawn on the generator's device.
    """
    at = generator.device
    t_B = torch.randint(1, len(schedule), shape[:1], generator=generator, device=at)
    share_B = torch.rand(shape[:1], generator=generator, device=at, dtype=torch.float64)
    noise, other = torch.randn((2, *shape), generator=generator, device=at)
    entry_B, copied_B = t_B, None
    if config.entangled:
        entered_B, how_late_B, share_of_r_B = torch.rand((3, shape[0]), generator=generator, device=at)
        entry_B = (len(schedule) ** how_late_B).long().clamp(max=len(schedule) - 1)
        t_B = torch.where(entered_B < config.entangled, (share_of_r_B * entry_B).long() + 1, t_B)
    prev_t_B = {"below": (share_B * t_B).long(), "previous": t_B - 1, "clean": torch.zeros_like(t_B)}[config.condition]
    if config.clean_share:
        clean_B = torch.rand(shape[:1], generator=generator, device=at) < config.clean_share
        prev_t_B = prev_t_B.masked_fill(clean_B, 0)
    if config.entangled:
        left_B = left_of_copy(schedule, entry_B, t_B) * (entered_B < config.entangled)
        copied_B = left_B if config.share_noise else left_B.square()
        if not config.share_noise:
            common = torch.randn(shape, generator=generator, device=at)
            prev_left_B = left_of_copy(schedule, entry_B, prev_t_B) * (entered_B < config.entangled)
            noise, other = (
                over(part, fresh) * common + over((1 - part.square()).sqrt(), fresh) * fresh
                for part, fresh in ((left_B, noise), (prev_left_B, other))
            )
    return Draws(t_B, prev_t_B, noise, noise if config.share_noise else other, copied_B)


def left_of_copy(schedule: Schedule, entry_B: Tensor, t_B: Tensor) -> Tensor:
    """q (B,) at levels t of states that were copied at levels r >= t: see the module; 0 at t = 0."""
    ratio_B = schedule.half_log_snr(entry_B, torch.float64) - schedule.half_log_snr(t_B, torch.float64)
    return ratio_B.exp().float()


def corrupt(
    config: GridConfig,
    schedule: Schedule,
    transport: Transport,
    clean_BnD: Tensor,
    prev_BnD: Tensor,
    first_BnD: Tensor | None,
    index_B: Tensor,
    pooled_BC: Tensor,
    prev_pooled_BC: Tensor,
    draws: Draws,
) -> Cell:
    """The inputs of B cells. Gradients reach the flow: use ``torch.no_grad`` unless it learns by them.

    Args:
        clean_BnD: the clean segment i of each row; prev_BnD the one before it (anything finite where i = 0).
        first_BnD: the clean first segment of each row's sequence, for ``anchor="first"`` only.
        index_B: i.
        pooled_BC: pooled text of each row, the flow's context; prev_pooled_BC that of the segment before.

    Raises:
        InputError: ``anchor="first"`` without first segments.
    """
    before_B = (index_B - 1).clamp(min=0)
    if config.anchor == "first":
        if first_BnD is None:
            raise InputError('anchor="first" needs the first segment of every sequence')
        y, y_prev = first_BnD, first_BnD
    else:
        y = transport.pull(clean_BnD, index_B, pooled_BC)
        y_prev = transport.pull(prev_BnD, before_B, prev_pooled_BC)
        if draws.copied_B is not None:
            y = torch.lerp(y, y_prev, over(draws.copied_B * (index_B > 0), y))
    noisy = add_noise(schedule, y, draws.noise_BnD.to(y), draws.t_B)
    noisy_prev = add_noise(schedule, y_prev, draws.prev_noise_BnD.to(y), draws.prev_t_B)
    x = transport.push(noisy, index_B, pooled_BC)
    prev = transport.push(noisy_prev, before_B, prev_pooled_BC)
    return Cell(x, draws.t_B, prev, draws.prev_t_B)
