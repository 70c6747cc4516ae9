"""The solver grid of distillation and its division into phases.

The teacher's trajectory is crossed in N solver steps between the times t_i = (i + 1) T/N - 1, i = 0 … N-1; the step
down from t_0 ends at time 0. It is divided into M phases with edges s_0 = 0 < s_1 < … < s_M = T - 1 that lie on the
grid, and the student maps every point of phase m to its lower edge s_m (MotionPCM, Section 4.2; PCM, Wang et al. 2024,
arXiv 2405.18407). One phase makes a plain consistency model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import torch
from torch import Tensor

from moveset.diffusion.steps import over
from moveset.errors import InputError


@dataclass(frozen=True)
class PhaseGrid:
    """N solver points in M phases. Indices ``i`` are int64 tensors of any shape; results have their shape and device.

    Args:
        points: N, a divisor of ``steps`` below it; MotionPCM's skip k = 100 is N = 10.
        phases: M in 1 … N, the number of network evaluations when sampling.
        steps: T, length of the noise schedule.

    Raises:
        InputError: N that does not divide T or equals it, or M outside 1 … N.

    >>> PhaseGrid(points=10, phases=4).edges
    (0, 199, 499, 699, 999)
    """

    points: int = 10
    phases: int = 1
    steps: int = 1000

    def __post_init__(self) -> None:
        if not (1 <= self.points <= self.steps // 2 and self.steps % self.points == 0):
            raise InputError(
                f"{self.points} solver points do not divide {self.steps} steps into equal skips; use 10, 20 or 50"
            )
        if not 1 <= self.phases <= self.points:
            raise InputError(f"{self.phases} phases is not in 1 to {self.points}, the solver points; use 1, 2 or 4")

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """(M,) index of the lowest solver point of each phase: floor(m N / M)."""
        return tuple(m * self.points // self.phases for m in range(self.phases))

    @cached_property
    def edges(self) -> tuple[int, ...]:
        """(M + 1,) edge times s_0 = 0 … s_M = T - 1."""
        skip = self.steps // self.points
        return (0, *(start * skip - 1 for start in self.starts[1:]), self.steps - 1)

    @property
    def jumps(self) -> tuple[tuple[int, int], ...]:
        """(from, to) times of sampling, from s_M down to s_0: exactly the training edges.

        >>> PhaseGrid(points=10, phases=2).jumps
        ((999, 499), (499, 0))
        """
        falling = self.edges[::-1]
        return tuple(pairwise(falling))

    def time(self, i: Tensor) -> Tensor:
        """t_i, where the student starts."""
        return (i + 1) * (self.steps // self.points) - 1

    def previous(self, i: Tensor) -> Tensor:
        """t_{i-1}, where the teacher's solver step from t_i ends; 0 for i = 0."""
        return (i * (self.steps // self.points) - 1).clamp(min=0)

    def phase(self, i: Tensor) -> Tensor:
        """m, the phase of solver point i."""
        # The inverse of floor(m N / M): the largest m with floor(m N / M) <= i.
        return ((i + 1) * self.phases - 1).div(self.points, rounding_mode="floor")

    def highest(self, i: Tensor) -> Tensor:
        """Highest solver point of the phase of point i: where sampling enters it."""
        return self.highest_of(self.phase(i))

    def highest_of(self, m: Tensor) -> Tensor:
        return ((m + 1) * self.points).div(self.phases, rounding_mode="floor") - 1

    def lower(self, i: Tensor) -> Tensor:
        """s_m, the lower edge of the phase of point i, where the student lands."""
        return self._edge(self.phase(i))

    def upper(self, i: Tensor) -> Tensor:
        """s_{m+1}, the upper edge of the phase of point i."""
        return self._edge(self.phase(i) + 1)

    def below(self, t: Tensor) -> Tensor:
        """The highest edge below times t, which need not be solver points; 0 where there is none.

        >>> PhaseGrid(points=10, phases=2).below(torch.tensor([0, 1, 499, 500, 1000])).tolist()
        [0, 0, 0, 499, 499]
        """
        below = torch.zeros_like(t)
        for edge in self.edges[1:-1]:
            below = below.masked_fill(t > edge, edge)
        return below

    def _edge(self, m: Tensor) -> Tensor:
        # Arithmetic instead of a table: nothing to copy to the device in every training step.
        start = (m * self.points).div(self.phases, rounding_mode="floor")
        return (start * (self.steps // self.points) - 1).clamp(min=0)


def down_to_edge(grid: PhaseGrid, step: Callable[[Tensor, Tensor], Tensor], z: Tensor, point_B: Tensor) -> Tensor:
    """``z`` (B, …) after all solver steps from t_i to the lower edge of its phase.

    Args:
        step: from z_t (B, …) at points (B,) to z at the times before them; called for all rows until the last arrives.
        point_B: the points they are at.
    """
    t_B, edge_B = grid.time(point_B), grid.lower(point_B)
    while bool((going_B := t_B > edge_B).any()):
        z = torch.where(over(going_B, z), step(z, point_B), z)
        t_B = torch.where(going_B, grid.previous(point_B), t_B)
        point_B = torch.where(t_B > edge_B, point_B - 1, point_B)
    return z
