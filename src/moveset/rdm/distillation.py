"""Few-step RDM: phased consistency of one segment, in the coordinates in which every segment is an ordinary diffusion.

In y = f^(-p)(x) the segments of RDM are noised and denoised like anything else, so a student can learn to jump to the
lower edge s of each phase as MotionPCM's does: F(z, t, s) = a_s y0 + s_s eps. The networks predict the clean segment
x0, not noise, and

    F(z, t, s) = c y0 + (s_s / s_t) z,        c = a_s - a_t s_s / s_t,

so that hitting a target F* is hitting the clean segment that F* implies, up to the factor c. The loss is taken there,
in x: no gradient has to pass the flow.

Callables have condition and guidance bound inside (``models.condition.guided``): ``teacher(x, t)``, ``student(x, t)``
and ``ema`` give the clean segment x0 of x_t.

Shapes: B rows, n frames, D features; ``point`` is the index i of the solver point t_i (``diffusion.phases``).
Source: MotionPCM (arXiv 2501.19083), Eq. 8-12; RDM (arXiv 2406.07169), Eq. 9-10.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from moveset.diffusion.phases import PhaseGrid, down_to_edge
from moveset.diffusion.schedule import Schedule
from moveset.diffusion.steps import denoise_step, over

Clean = Callable[[Tensor, Tensor], Tensor]
Carry = Callable[[Tensor], Tensor]


def share_of_clean(schedule: Schedule, t_B: Tensor, s_B: Tensor) -> Tensor:
    """c (B,): how much of F(z, t, s) is the clean segment; 0 where s = t, 1 where s is clean."""
    alpha_t, sigma_t, alpha_s, sigma_s = (
        f(at, torch.float64) for at in (t_B, s_B) for f in (schedule.alpha, schedule.sigma)
    )
    return (alpha_s - alpha_t * sigma_s / sigma_t).float()


def implied_clean(schedule: Schedule, z_BnD: Tensor, landed_BnD: Tensor, t_B: Tensor, s_B: Tensor) -> Tensor:
    """The y0 with which a jump from z at t lands at ``landed`` at s: the inverse of F in y0."""
    ratio_B = (schedule.sigma(s_B, torch.float64) / schedule.sigma(t_B, torch.float64)).float()
    share_B = share_of_clean(schedule, t_B, s_B)
    return (landed_BnD - over(ratio_B, z_BnD) * z_BnD) / over(share_B, z_BnD)


@torch.no_grad()
def clean_target(
    schedule: Schedule,
    grid: PhaseGrid,
    teacher: Clean,
    ema: Clean,
    push: Carry,
    pull: Carry,
    z_BnD: Tensor,
    point_B: Tensor,
) -> tuple[Tensor, Tensor]:
    """What the student should say at z_{t_i}: the clean segment x0, and the weight c (B,) of its error.

    The teacher's guided step from t_i to t_{i-1}, then the averaged student's jump to the phase's lower edge; at the
    lowest point of a phase t_{i-1} is the edge itself, and the target is the teacher's own step.

    Args:
        push, pull: between y and x.
        z_BnD: noisy segments at t_i, in y.
    """
    t_B, next_B, edge_B = grid.time(point_B), grid.previous(point_B), grid.lower(point_B)
    stepped = denoise_step(schedule, z_BnD, pull(teacher(push(z_BnD), t_B)), t_B, next_B)
    at_edge_B = next_B == edge_B
    # A jump of no length has no noise to divide by where it starts clean; its rows are replaced below.
    jumped = denoise_step(schedule, stepped, pull(ema(push(stepped), next_B)), next_B.clamp(min=1), edge_B)
    landed = torch.where(over(at_edge_B, z_BnD), stepped, jumped)
    return push(implied_clean(schedule, z_BnD, landed, t_B, edge_B)), share_of_clean(schedule, t_B, edge_B)


@torch.no_grad()
def trajectory_target(
    schedule: Schedule,
    grid: PhaseGrid,
    teacher: Clean,
    push: Carry,
    pull: Carry,
    z_BnD: Tensor,
    point_B: Tensor,
) -> Tensor:
    """The clean segment that all of the teacher's guided steps from t_i to the phase's lower edge come to.

    What ``clean_target`` says far above an edge is what the averaged student says a step below: what is wrong there
    goes on upwards. This asks the teacher itself, for as many evaluations as there are points in between.
    """

    def step(z: Tensor, i: Tensor) -> Tensor:
        t_B = grid.time(i)
        return denoise_step(schedule, z, pull(teacher(push(z), t_B)), t_B, grid.previous(i))

    landed = down_to_edge(grid, step, z_BnD, point_B)
    return push(implied_clean(schedule, z_BnD, landed, grid.time(point_B), grid.lower(point_B)))
