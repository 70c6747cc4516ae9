"""Segments one after the other: each goes from noise to clean, told the finished one before it.

- MD-N: the denoiser of RDM on its own, N segments of K steps each. No flow, no staircase.
- RDM whose segments wait for each other, and few-step students of it: the same through the flow.
- DiP: chunks of 40 frames, each conditioned on the 20 frames before it, by 10 DDPM steps.

Rows are segments of any streams: each has its own seed, number and past, and never sees the others. Noise is keyed, so
neither the batch nor the place where a stream was stopped and taken up again changes a sample.

Shapes: B rows, n frames of a segment or chunk, P frames of a prefix, F frames, D features, C text width.
Source: RDM (arXiv 2406.07169), Section 5, for MD-N; CLoSD (arXiv 2410.03441), Section 4.1, for DiP.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from moveset.diffusion.schedule import Schedule
from moveset.diffusion.steps import Variance, add_noise, denoise_step, require_variance
from moveset.errors import InputError
from moveset.rdm.noise import PAST, START, segment_noise
from moveset.rdm.transport import Transport

# x_BnD, t_B, past_BnD, past_t_B -> clean x_BnD. Text, segment numbers and guidance are bound inside.
Denoise = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
# x_BnD, t_B, prefix_BPD and the number of the chunk -> clean x_BnD. Text and guidance are bound inside.
ChunkDenoiser = Callable[[Tensor, Tensor, Tensor, int], Tensor]

_IDENTITY = Transport(None)


@dataclass(frozen=True, kw_only=True)
class Solver:
    """How noise becomes a clean segment.

    Args:
        schedule: the noise schedule; its time 0 is clean.
        levels: K + 1 falling levels of it, the last 0: ``staircase.levels(K)``, or the phase edges of a student.
        eta: share of fresh noise in every step: 0 is DDIM, 1 is DDPM.
        variance, eps_scale: as in ``diffusion.steps.denoise_step``.
        time_shift: share by which the network is told more noise than there is (time shift, Li et al. 2024, arXiv
            2305.15583): on its own way down a segment is not what noised data are.
        past_lag: how many steps a segment is told the finished one before it to be ahead: to the level of that step it
            is noised again, in y-space. None tells it clean.
        colour: what turns standard normal noise (B, n, D) into the noise that the network was trained on, if anything.

    Raises:
        InputError: levels that do not fit the schedule, or an option out of range.
    """

    schedule: Schedule
    levels: tuple[int, ...]
    eta: float = 0.0
    variance: Variance = "posterior"
    eps_scale: float = 1.0
    time_shift: float = 0.0
    past_lag: int | None = None
    colour: Callable[[Tensor], Tensor] | None = None

    def __post_init__(self) -> None:
        falling = all(t > s for t, s in pairwise(self.levels))
        if not (falling and self.levels[-1] == 0 and self.levels[0] < len(self.schedule)):
            raise InputError(f"levels must fall from at most {len(self.schedule) - 1} to 0; got {self.levels}")
        if not 0.0 <= self.eta <= 1.0:
            raise InputError(f"eta {self.eta} is not in 0 (DDIM) to 1 (DDPM)")
        require_variance(self.variance)
        if self.past_lag is not None and not 1 <= self.past_lag <= self.steps:
            raise InputError(
                f"past_lag {self.past_lag} is not in 1 to {self.steps} steps; leave it out for a clean past"
            )

    @property
    def steps(self) -> int:
        """K."""
        return len(self.levels) - 1

    def told(self, t_B: Tensor) -> Tensor:
        """The levels that a network is told of segments at levels t."""
        return t_B if self.time_shift == 0.0 else ((1 + self.time_shift) * t_B).long().clamp(max=len(self.schedule) - 1)

    def step(self, z: Tensor, z0: Tensor, t_B: Tensor, s_B: Tensor, noise: Tensor | None) -> Tensor:
        """From levels t down to s, given the clean z_0; noise as for ``denoise_step``."""
        return denoise_step(self.schedule, z, z0, t_B, s_B, self.eta, noise, self.variance, self.eps_scale)

    def noise(self, seeds: Sequence[int], numbers: Sequence[int], step: int, shape: Sequence[int]) -> Tensor:
        """Noise (B, n, D), on the CPU, of segments with these seeds and numbers (``rdm.noise``)."""
        keys = zip(seeds, numbers, strict=True)
        noise_BnD = torch.stack([segment_noise(seed, number, step, shape) for seed, number in keys])
        return noise_BnD if self.colour is None else self.colour(noise_BnD)


class Past:
    """Finished segments that others follow on.

    Args:
        x_BnD: clean; zeros where a stream begins.
        seeds: of their streams.
        numbers: of the segments in their streams.
        pooled_BC: sentence embedding of each, for the flow.
        noisy_B: bool, which may be told noisily: not those that were given, and not what is no segment at all.
    """

    def __init__(
        self, x_BnD: Tensor, seeds: Sequence[int], numbers: Sequence[int], pooled_BC: Tensor, noisy_B: Tensor
    ) -> None:
        self.x_BnD, self._noisy_B, self._pooled_BC = x_BnD, noisy_B, pooled_BC
        self._seeds, self._numbers = seeds, numbers
        self._index_B = torch.tensor(numbers, device=x_BnD.device)
        self._carried: tuple[Tensor, Tensor] | None = None

    def at(self, solver: Solver, transport: Transport, step: int) -> tuple[Tensor, Tensor]:
        """As if they had reached that step only: segments (B, n, D) in x, and their levels (B,)."""
        t_B = solver.levels[step] * self._noisy_B
        if not t_B.any():
            return self.x_BnD, t_B
        if self._carried is None:
            noise_BnD = solver.noise(self._seeds, self._numbers, PAST, self.x_BnD.shape[1:]).to(self.x_BnD.device)
            self._carried = transport.pull(self.x_BnD, self._index_B, self._pooled_BC), noise_BnD
        noisy_BnD = add_noise(solver.schedule, *self._carried, t_B)
        pushed_BnD = transport.push(noisy_BnD, self._index_B, self._pooled_BC)
        return torch.where(t_B[:, None, None] > 0, pushed_BnD, self.x_BnD), t_B


@torch.no_grad()
def sample_segment(
    denoise: Denoise,
    solver: Solver,
    seeds: Sequence[int],
    numbers: Sequence[int],
    past: Past | Tensor,
    transport: Transport = _IDENTITY,
    pooled_BC: Tensor | None = None,
) -> Tensor:
    """Clean segments (B, n, D), in x.

    Args:
        denoise: the network with everything else bound.
        solver: schedule, levels, and how the past is told.
        seeds: of each row's stream.
        numbers: of each segment in its stream; with the seed it chooses the noise.
        past: the segments before them; or zeros (B, n, D) where there are none, or the denoiser knows better.
        transport: the flow, or the identity.
        pooled_BC: sentence embeddings, for the flow.
    """
    x_BnD = past if isinstance(past, Tensor) else past.x_BnD
    device, shape = x_BnD.device, x_BnD.shape[1:]
    index_B = torch.tensor(list(numbers), device=device)
    pooled_BC = x_BnD.new_zeros(len(x_BnD), 0) if pooled_BC is None else pooled_BC
    clean_B = torch.zeros_like(index_B)
    y_BnD = solver.noise(seeds, numbers, START, shape).to(device)
    for k, (t, s) in enumerate(pairwise(solver.levels)):
        t_B, s_B = torch.full_like(index_B, t), torch.full_like(index_B, s)
        past_told = (x_BnD, clean_B)
        if solver.past_lag is not None and isinstance(past, Past):
            past_told = past.at(solver, transport, min(k + solver.past_lag, solver.steps))
        x0_BnD = denoise(transport.push(y_BnD, index_B, pooled_BC), solver.told(t_B), *past_told).to(y_BnD.dtype)
        if s:  # a finished segment is wanted in x only
            y0_BnD = transport.pull(x0_BnD, index_B, pooled_BC)
            noise_BnD = solver.noise(seeds, numbers, k, shape).to(device) if solver.eta else None
            y_BnD = solver.step(y_BnD, y0_BnD, t_B, s_B, noise_BnD)
    return x0_BnD


def rollout_chunks(
    denoiser: ChunkDenoiser,
    schedule: Schedule,
    prefix_BPD: Tensor,
    frames: int,
    seeds: Sequence[int],
    *,
    chunk: int = 40,
) -> Tensor:
    """Sequences (B, F, D) in chunks, without the prefix (DiP).

    All steps of the schedule are taken as DDPM takes them; the last chunk is cut.

    Args:
        schedule: ``cosine(10)`` for DiP.
        prefix_BPD: normalised frames that come before: those of a motion, or one pose of standing still.
        frames: F.
        seeds: one for every item.
        chunk: n.

    Raises:
        InputError: no frames, or not one prefix for every seed.
    """
    if frames < 1 or len(prefix_BPD) != len(seeds):
        raise InputError(
            f"{frames} frames of {len(prefix_BPD)} prefixes for {len(seeds)} seeds; give one prefix per seed"
        )
    solver = Solver(schedule=schedule, levels=tuple(reversed(range(len(schedule)))), eta=1.0)
    nothing = prefix_BPD.new_zeros(len(seeds), chunk, prefix_BPD.shape[2])
    made: list[Tensor] = []
    for number in range(-(-frames // chunk)):
        before = prefix_BPD

        def denoise(x: Tensor, t_B: Tensor, *_: Tensor) -> Tensor:
            return denoiser(x, t_B, before, number)  # noqa: B023 (called before the next turn)

        made.append(sample_segment(denoise, solver, seeds, [number] * len(seeds), nothing))
        # A chunk may be shorter than the prefix, and the prefix nothing.
        prefix_BPD = torch.cat((prefix_BPD, made[-1]), dim=1)[:, chunk:]
    return torch.cat(made, dim=1)[:, :frames]
