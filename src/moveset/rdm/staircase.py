"""The staircase: which segment is denoised at which sampler step, and what can be done at the same time.

A sampler has K steps. Segment 0 takes all of them. When R remain, segment 1 enters as a copy of segment 0's noisy
state in y-space (the flow's image in x-space), then segment 2, and so on; each is denoised to the end, always ``lag``
steps behind its left neighbour, whose less noisy state it is conditioned on. R = 0 denoises segment 0 only and leaves
the rest to the flow ("disentangled"), R = K denoises every cell of the grid.

- ``shape="triangle"`` (as published): each segment enters one step later than the one before, takes R, R - 1, …, 1
  steps; those after the R-th are the flow's alone.
- ``shape="parallelogram"``: every later segment takes R steps, so the cost of a second of motion never changes.

A cell is (segment, step): step k leads from level tau_k to tau_(k+1). A wave is the set of cells that can be evaluated
at once: ``lag = 1`` needs K + N - 1 waves for N segments, ``lag = K`` is plain autoregression.
Source: RDM (arXiv 2406.07169), Section 4.3 and Algorithm 1; the parallelogram, the lag and the waves are additions.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

from moveset.errors import InputError

Shape = Literal["triangle", "parallelogram"]
Cell = tuple[int, int]


def levels(steps: int, noisiest: int = 1000) -> tuple[int, ...]:
    """The K + 1 noise levels between the steps of a sampler, falling evenly from ``noisiest`` to 0, which is clean.

    Raises:
        InputError: ``steps`` not in 1 … ``noisiest``.

    >>> levels(4)
    (1000, 750, 500, 250, 0)
    """
    if not 1 <= steps <= noisiest:
        raise InputError(f"{steps} sampler steps is not in 1 to {noisiest}; 50 is usual")
    return tuple(noisiest * (steps - k) // steps for k in range(steps + 1))


@dataclass(frozen=True)
class Staircase:
    """A plan of cells.

    Args:
        steps: K, sampler steps.
        segments: N, or None for a stream without end.
        start: R, sampler steps that remain when segment 1 enters, 0 … K.
        shape: see the module.
        lag: steps that a segment's left neighbour is ahead, 1 … K.

    Raises:
        InputError: a value out of range.
    """

    steps: int
    segments: int | None
    start: int
    shape: Shape = "parallelogram"
    lag: int = 1

    def __post_init__(self) -> None:
        if self.steps < 1 or (self.segments is not None and self.segments < 1):
            raise InputError(f"a staircase of {self.steps} steps and {self.segments} segments needs at least 1 of each")
        if not 0 <= self.start <= self.steps:
            raise InputError(f"start {self.start} is not in 0 (the first segment only) to {self.steps} (all of all)")
        if not 1 <= self.lag <= self.steps:
            raise InputError(f"lag {self.lag} is not in 1 to {self.steps} (wait for the finished segment before)")
        if self.shape not in get_args(Shape):
            raise InputError(f"shape {self.shape!r} is not one of {', '.join(get_args(Shape))}")

    def denoised(self, segment: int) -> int:
        """Steps that a segment is denoised for: K for the first, 0 for one that is the flow's alone."""
        if segment == 0:
            return self.steps
        return max(0, self.start - segment + 1) if self.shape == "triangle" else self.start

    def entry(self, segment: int) -> int:
        """The step at which a segment enters, K if it is never denoised."""
        return self.steps - self.denoised(segment)

    def has(self, segment: int) -> bool:
        """Whether there is such a segment, and it is denoised."""
        return (self.segments is None or segment < self.segments) and self.denoised(segment) > 0

    def end(self, segment: int) -> int:
        """Waves after which a segment is finished: what its viewer waits for."""
        # A segment ends min(lag, its steps) waves after its left neighbour: it was that much behind, or waited for it.
        if self.shape == "parallelogram":
            return self.steps + segment * min(self.lag, self.start)
        return self.steps + sum(min(self.lag, self.denoised(j)) for j in range(1, min(segment, self.start) + 1))

    def begin(self, segment: int) -> int:
        """The wave, from 0, in which a segment is first evaluated."""
        return self.end(segment) - self.denoised(segment)

    def wave(self, number: int, first: int = 0) -> tuple[Cell, ...]:
        """The cells of a wave, oldest segment first.

        Args:
            number: of the wave, from 0.
            first: a segment that all finished ones lie before; saves the search for it.
        """
        cells: list[Cell] = []
        segment = first
        while self.has(segment) and self.begin(segment) <= number:
            if number < self.end(segment):
                cells.append((segment, self.entry(segment) + number - self.begin(segment)))
            segment += 1
        return tuple(cells)

    def wavefront(self) -> Iterator[tuple[Cell, ...]]:
        """All waves; without end for an endless parallelogram."""
        number, cells = 0, self.wave(0)
        while cells:
            yield cells
            number, cells = number + 1, self.wave(number + 1, first=cells[0][0])
