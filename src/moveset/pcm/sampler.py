"""Samplers: one short loop each, the network as a callable ``model(z_BND, t_B) -> eps`` with condition and guidance
bound inside (``models.condition.guided``).

Noise comes from the caller. All end in an estimate of the noise-free z_0, not in z at the schedule's lowest noise
level, which keeps a share of 0.029 of the predicted noise.

Shapes: ``B`` batch, ``N`` latent tokens, ``D`` numbers in each.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import Schedule
from moveset.diffusion.steps import add_noise, ddim_step, predict_z0
from moveset.errors import InputError
from moveset.pcm.consistency import Epsilon, lcm_prediction


def sample_ddim(model: Epsilon, schedule: Schedule, times: Sequence[int], noise_BND: Tensor) -> Tensor:
    """Deterministic sampling of a diffusion model (DDIM, arXiv 2010.02502).

    Args:
        times: falling evaluation times, usually ``ddim_timesteps(50)``.
    """
    z_BND = noise_BND
    for k, t in enumerate(times):
        t_B = _everywhere(t, z_BND)
        eps_BND = model(z_BND, t_B)
        if k + 1 < len(times):
            z_BND = ddim_step(schedule, z_BND, eps_BND, t_B, _everywhere(times[k + 1], z_BND))
        else:
            z_BND = predict_z0(schedule, z_BND, eps_BND, t_B)
    return z_BND


def sample_phased(model: Epsilon, schedule: Schedule, grid: PhaseGrid, noise_BND: Tensor) -> Tensor:
    """M deterministic jumps over exactly the edges of training (MotionPCM, Section 4.4): M network evaluations.

    Args:
        model: a student of ``grid.phases`` phases.
        grid: the grid that the student was trained on.
    """
    return sample_ddim(model, schedule, [t for t, _ in grid.jumps], noise_BND)


def sample_lcm(model: Epsilon, schedule: Schedule, times: Sequence[int], noise: Sequence[Tensor]) -> Tensor:
    """Stochastic multistep consistency sampling (LCM, arXiv 2310.04378, Algorithm 3): estimate z_0, add noise, repeat.

    Args:
        model: a consistency student.
        times: falling evaluation times, usually ``lcm_timesteps(n)``.
        noise: for every time a (B, N, D) tensor: the start, then what is added before each further evaluation.

    Raises:
        InputError: not one noise for every time.
    """
    if not times or len(noise) != len(times):
        raise InputError(f"{len(times)} times and {len(noise)} noises do not match; give one noise for every time")
    z_BND = noise[0]
    for k, t in enumerate(times):
        if k:
            z_BND = add_noise(schedule, z_BND, noise[k], _everywhere(t, z_BND))
        z_BND = lcm_prediction(schedule, model, z_BND, _everywhere(t, z_BND))
    return z_BND


def lcm_timesteps(count: int, points: int = 10, steps: int = 1000) -> tuple[int, ...]:
    """Evaluation times of LCM sampling, spread over the solver points of training.

    Raises:
        InputError: ``count`` not in 1 … ``points``.

    >>> lcm_timesteps(4)
    (999, 799, 499, 299)
    """
    if not 1 <= count <= points:
        raise InputError(f"{count} steps is not in 1 to {points}, the solver points of training; use 1, 2 or 4")
    skip = steps // points
    return tuple(steps - 1 - skip * (k * points // count) for k in range(count))


def item_noise(seeds: Sequence[int], shape: Sequence[int]) -> Tensor:
    """(B, *shape) standard normal noise, each item from its own seed: it does not depend on the rest of the batch.

    Drawn on the CPU, so that a seed means the same on any device. A longer first dimension only appends: noise for
    four steps begins with that for one.
    """
    return torch.stack([torch.randn(*shape, generator=torch.Generator().manual_seed(seed)) for seed in seeds])


def _everywhere(t: int, z: Tensor) -> Tensor:
    return torch.full((len(z),), t, device=z.device)
