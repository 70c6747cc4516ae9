"""What a student learns in one training iteration, as pure functions of tensors and callables.

MotionPCM (Section 4.2 and 4.3) and its plain case LCM (Luo et al. 2023, arXiv 2310.04378; MotionLCM). ``teacher``,
``student`` and ``ema``, the student's moving average, are callables ``(z_BND, t_B) -> eps`` with condition and guidance
bound inside (``models.condition.guided``). No gradient reaches teacher or ema: they are called without one.

Shapes: ``B`` batch, ``N`` latent tokens, ``D`` numbers in each. ``point`` is the index i of the solver point t_i.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.diffusion.phases import PhaseGrid, down_to_edge
from moveset.diffusion.schedule import Schedule
from moveset.diffusion.steps import add_noise, ddim_step, over, predict_z0, renoise

Epsilon = Callable[[Tensor, Tensor], Tensor]

_SIGMA_DATA = 0.5
_TIME_SCALE = 10.0


@dataclass(frozen=True, eq=False)
class Draws:
    """Everything random in one iteration.

    Args:
        point_B: solver point of each item.
        w_B: guidance scale of each item.
        noise_BND: noise from z_0 to t_i.
        judged_B: the time s in [s_m, s_{m+1}] at which the discriminator looks.
        fake_noise_BND: noise from the student's z_{s_m} to s, and ``real_noise_BND`` from z_0 to s.
    """

    point_B: Tensor
    w_B: Tensor
    noise_BND: Tensor
    judged_B: Tensor
    fake_noise_BND: Tensor
    real_noise_BND: Tensor


def draw(
    grid: PhaseGrid,
    z0_BND: Tensor,
    w_range: tuple[float, float],
    generator: torch.Generator,
    inference_points: float = 0.0,
    discriminator_max_noise: float = 1.0,
    place: Callable[[Tensor], Tensor] | None = None,
) -> Draws:
    """Uniform solver points, guidance scales and judged times, and three independent noises.

    Drawn on the generator's device and moved to that of ``z0_BND``: a CPU generator gives the same draws everywhere.

    Args:
        inference_points: this share of the items is moved up to the highest point of its phase. These are the points
            that sampling evaluates; the published method leaves them one in N / M items.
        discriminator_max_noise: the lower part of each phase in which judged times lie; 1 as published. Of what is
            noised far nothing can be told.
        place: may move the solver points (B,) once more.
    """
    batch, to, at = len(z0_BND), z0_BND.device, generator.device
    point_B = torch.randint(grid.points, (batch,), generator=generator, device=at)
    u_B, v_B = torch.rand((2, batch), generator=generator, device=at, dtype=torch.float64)
    noises = torch.randn((3, *z0_BND.shape), generator=generator, device=at, dtype=z0_BND.dtype).to(to)
    if inference_points:
        raised_B = torch.rand(batch, generator=generator, device=at) < inference_points
        point_B = torch.where(raised_B, grid.highest(point_B), point_B)
    if place is not None:
        point_B = place(point_B)
    low_B, high_B = grid.lower(point_B), grid.upper(point_B)
    judged_B = low_B + (u_B * discriminator_max_noise * (high_B - low_B + 1)).long()
    w_B = (w_range[0] + v_B * (w_range[1] - w_range[0])).to(z0_BND.dtype)
    return Draws(point_B.to(to), w_B.to(to), noises[0], judged_B.to(to), noises[1], noises[2])


@torch.no_grad()
def teacher_step(schedule: Schedule, grid: PhaseGrid, teacher: Epsilon, z_BND: Tensor, point_B: Tensor) -> Tensor:
    """One guided DDIM step from t_i to t_{i-1} (MotionPCM, Eq. 11 and the paragraph below it)."""
    t_B = grid.time(point_B)
    return ddim_step(schedule, z_BND, teacher(z_BND, t_B), t_B, grid.previous(point_B))


def phased_prediction(schedule: Schedule, grid: PhaseGrid, student: Epsilon, z_BND: Tensor, point_B: Tensor) -> Tensor:
    """The student's jump from t_i to the lower edge s_m of its phase (MotionPCM, Eq. 8 and 10)."""
    t_B = grid.time(point_B)
    return ddim_step(schedule, z_BND, student(z_BND, t_B), t_B, grid.lower(point_B))


@torch.no_grad()
def phased_target(
    schedule: Schedule, grid: PhaseGrid, teacher: Epsilon, ema: Epsilon, z_BND: Tensor, point_B: Tensor
) -> Tensor:
    """Where the student should land: the teacher's step to t_{i-1}, then the averaged student's jump to s_m (Eq. 12).

    At the lowest point of a phase t_{i-1} is s_m itself. The jump of no length is the identity to the last bit, so
    there the target is the teacher's own step, and everything else in the phase is anchored to it.
    """
    stepped_BND = teacher_step(schedule, grid, teacher, z_BND, point_B)
    t_B = grid.previous(point_B)
    return ddim_step(schedule, stepped_BND, ema(stepped_BND, t_B), t_B, grid.lower(point_B))


@torch.no_grad()
def trajectory_target(schedule: Schedule, grid: PhaseGrid, teacher: Epsilon, z_BND: Tensor, point_B: Tensor) -> Tensor:
    """Where all of the teacher's guided steps from t_i to the lower edge of its phase lead.

    ``phased_target`` asks the averaged student for all of them but the first, and what that one is wrong about goes on
    upwards from point to point. This asks the teacher alone, twice for every point in between.
    """
    return down_to_edge(grid, lambda z, i: teacher_step(schedule, grid, teacher, z, i), z_BND, point_B)


@torch.no_grad()
def phase_entry(schedule: Schedule, grid: PhaseGrid, student: Epsilon, noise_BND: Tensor, phase_B: Tensor) -> Tensor:
    """Where sampling enters phase m: where the student's own jumps lead from noise through all phases above it.

    Data noised to the same time, which consistency is learned from, has none of what those jumps are wrong about.
    """
    z_BND = noise_BND
    for m in range(grid.phases - 1, 0, -1):
        point_B = grid.highest_of(torch.full_like(phase_B, m))
        below_BND = phased_prediction(schedule, grid, student, z_BND, point_B)
        z_BND = torch.where(over(phase_B < m, z_BND), below_BND, z_BND)
    return z_BND


def adversarial_pair(
    schedule: Schedule, grid: PhaseGrid, draws: Draws, prediction_BND: Tensor, z0_BND: Tensor
) -> tuple[Tensor, Tensor]:
    """(fake, real) at the judged time s: the student's z_{s_m} noised further, and data noised directly (Section 4.3).

    Gradients flow through the fake; detach it for the discriminator's own step.
    """
    low_B = grid.lower(draws.point_B)
    fake = renoise(schedule, prediction_BND, low_B, draws.judged_B, draws.fake_noise_BND)
    return fake, add_noise(schedule, z0_BND, draws.real_noise_BND, draws.judged_B)


def lcm_scalings(t: Tensor, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    """(c_skip, c_out) of the boundary condition: (1, 0) at t = 0, and (0, 1) to six digits from t = 99 on."""
    scaled = _TIME_SCALE * t.to(dtype)
    total = scaled.square() + _SIGMA_DATA**2
    return _SIGMA_DATA**2 / total, scaled / total.sqrt()


def lcm_prediction(schedule: Schedule, student: Epsilon, z_BND: Tensor, t_B: Tensor) -> Tensor:
    """A latent consistency model's estimate of z_0 from z_t: c_skip z_t + c_out (z_t - sigma_t eps) / alpha_t."""
    c_skip, c_out = lcm_scalings(t_B, z_BND.dtype)
    z0_BND = predict_z0(schedule, z_BND, student(z_BND, t_B), t_B)
    return over(c_skip, z_BND) * z_BND + over(c_out, z_BND) * z0_BND


@torch.no_grad()
def lcm_target(
    schedule: Schedule, grid: PhaseGrid, teacher: Epsilon, ema: Epsilon, z_BND: Tensor, point_B: Tensor
) -> Tensor:
    """The averaged student's estimate of z_0 from the teacher's step to t_{i-1}. Only ``grid.points`` matters."""
    stepped_BND = teacher_step(schedule, grid, teacher, z_BND, point_B)
    return lcm_prediction(schedule, ema, stepped_BND, grid.previous(point_B))
