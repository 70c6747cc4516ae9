"""What RDM is compared with: rollouts that finish one piece of motion before they begin the next.

- MD-N: the denoiser of RDM on its own, N segments of K steps each, conditioned on the finished segment before or on
  nothing. No flow, no staircase: N K evaluations, one after the other.
- DiP: chunks of 40 frames, each conditioned on the 20 frames before it, by 10 DDPM steps.

Noise is keyed as in RDM's samplers, a chunk being a segment.

Shapes: B items, n frames of a segment or chunk, P frames of a prefix, F frames, D features.
Source: RDM (arXiv 2406.07169), Section 5, for MD-N; CLoSD (arXiv 2410.03441), Section 4.1, for DiP.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count, islice, pairwise
from typing import Literal, get_args

import torch
from torch import Tensor

from moveset.diffusion.schedule import Schedule
from moveset.diffusion.steps import denoise_step
from moveset.errors import InputError
from moveset.rdm.noise import START, noise_of_items
from moveset.rdm.sampler import Denoiser

Condition = Literal["clean_prev", "none"]
# x_BnD, t_B, prefix_BPD and the number of the chunk -> clean x_BnD. Text and guidance are bound inside.
ChunkDenoiser = Callable[[Tensor, Tensor, Tensor, int], Tensor]


def rollout_segments(
    denoiser: Denoiser,
    schedule: Schedule,
    levels: tuple[int, ...],
    seeds: Sequence[int],
    shape: tuple[int, int],
    *,
    condition: Condition = "clean_prev",
    eta: float = 0.0,
    device: torch.device | str = "cpu",
) -> Iterator[Tensor]:
    """Segments (B, n, D) without end (MD-N).

    Args:
        denoiser: as for RDM's samplers; its rows are always those of one segment.
        schedule: the noise schedule, with a clean time 0.
        levels: K + 1 falling noise levels, the last 0.
        seeds: one for every item.
        shape: (n, D) of a segment.
        condition: "clean_prev", or "none": every segment is sampled like a first one.
        eta: 0 is DDIM, 1 is DDPM.

    Raises:
        InputError: an unknown condition.
    """
    if condition not in get_args(Condition):
        raise InputError(f"condition {condition!r} is not one of {', '.join(get_args(Condition))}")

    def segments() -> Iterator[Tensor]:
        prev_BnD, clean_B = torch.zeros(len(seeds), *shape, device=device), _rows(0, seeds, device)
        for number in count():
            index_B = _rows(number if condition == "clean_prev" else 0, seeds, device)
            rows, before = [number] * len(seeds), prev_BnD

            def clean(x: Tensor, t_B: Tensor) -> Tensor:
                return denoiser(x, t_B, before, clean_B, index_B, rows)  # noqa: B023 (called before the next turn)

            made_BnD = sample_piece(clean, schedule, levels, seeds, number, shape, eta=eta, device=device)
            if condition == "clean_prev":
                prev_BnD = made_BnD
            yield made_BnD

    return segments()


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
        denoiser: see the module.
        schedule: ``cosine(10)`` for DiP.
        prefix_BPD: normalised frames that come before: those of a motion, or ``idle_prefix``.
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
    endless = _chunks(denoiser, schedule, prefix_BPD, seeds, chunk)
    return torch.cat(list(islice(endless, -(-frames // chunk))), dim=1)[:, :frames]


def idle_prefix(pose_D: Tensor, items: int, frames: int = 20) -> Tensor:
    """A start without data (B, P, D): one pose, normalised and with the features of standing still, all the time."""
    return pose_D.expand(items, frames, -1)


def _chunks(
    denoiser: ChunkDenoiser, schedule: Schedule, prefix_BPD: Tensor, seeds: Sequence[int], chunk: int
) -> Iterator[Tensor]:
    levels = tuple(reversed(range(len(schedule))))
    kept, shape = prefix_BPD.shape[1], (chunk, prefix_BPD.shape[2])
    for number in count():
        before = prefix_BPD

        def clean(x: Tensor, t_B: Tensor) -> Tensor:
            return denoiser(x, t_B, before, number)  # noqa: B023 (called before the next turn)

        made_BnD = sample_piece(clean, schedule, levels, seeds, number, shape, eta=1.0, device=prefix_BPD.device)
        # A chunk may be shorter than the prefix.
        prefix_BPD = torch.cat((prefix_BPD, made_BnD), dim=1)[:, -kept:]
        yield made_BnD


@torch.no_grad()
def sample_piece(
    clean: Callable[[Tensor, Tensor], Tensor],
    schedule: Schedule,
    levels: tuple[int, ...],
    seeds: Sequence[int],
    number: int,
    shape: tuple[int, int],
    *,
    eta: float = 0.0,
    device: torch.device | str = "cpu",
) -> Tensor:
    """One piece (B, n, D) from noise to clean; a clip as a whole is a piece too (RDM-1, MotionDiffuse).

    Args:
        clean: x_BnD, t_B -> clean x_BnD.
        schedule: the noise schedule.
        levels: falling noise levels, the last 0.
        seeds: one for every item.
        number: of the piece in its sequence; with the seed it chooses the noise.
        shape: (n, D).
        eta: 0 is DDIM, 1 is DDPM.
    """
    z_BnD = noise_of_items(seeds, number, START, shape).to(device)
    for k, (t, s) in enumerate(pairwise(levels)):
        t_B, s_B = _rows(t, seeds, device), _rows(s, seeds, device)
        noise = noise_of_items(seeds, number, k, shape).to(device) if eta else None
        z_BnD = denoise_step(schedule, z_BnD, clean(z_BnD, t_B).to(z_BnD.dtype), t_B, s_B, eta, noise)
    return z_BnD


def _rows(value: int, seeds: Sequence[int], device: torch.device | str) -> Tensor:
    return torch.full((len(seeds),), value, device=device)
