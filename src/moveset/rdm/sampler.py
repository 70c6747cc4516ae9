"""The sampler of RDM: a sequence of so many segments, or a stream without end, by one staircase.

The state of a segment is kept in y-space, where it is diffused like any other; it is pushed through the flow when the
network looks at it, and the network's clean segment is pulled back. All segments of a wave are one batch: the rows of
the batch are grouped by segment, oldest first, with one row for every item within. Noise is keyed by item, segment and
step, so neither the order of evaluation nor the batch changes a sample.

Shapes: B items, N segments, n frames of a segment, D features, C text width; in the networks' calls B counts rows.
Source: RDM (arXiv 2406.07169), Algorithm 1, with the prediction (not its noise) pulled back through the flow.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.rdm.noise import START
from moveset.rdm.sequential import Past, Solver
from moveset.rdm.staircase import Cell, Staircase
from moveset.rdm.state import StreamState
from moveset.rdm.transport import Transport

# x_BnD, t_B, prev_BnD, prev_t_B, index_B and the segment number of each row -> clean x_BnD. The text is bound inside.
Denoiser = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor, Sequence[int]], Tensor]
InitNoise = Literal["shared", "independent"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How cells become samples.

    Args:
        solver: schedule, levels, fresh noise, and how a finished past is told where segments wait for it (lag K).
        staircase: the plan, of as many steps.
        init_noise: whether a segment that enters at the first step begins with its left neighbour's noise or its own.
            Without fresh noise in the steps, shared noise keeps the segments correlated.
            One that enters later begins with a copy of its left neighbour's state in y-space.

    Raises:
        InputError: levels that do not fit the staircase, or an option out of range.
    """

    solver: Solver
    staircase: Staircase
    init_noise: InitNoise = "independent"

    def __post_init__(self) -> None:
        count = self.staircase.steps
        if self.solver.steps != count:
            given = len(self.solver.levels)
            raise InputError(f"{given} levels do not make {count} steps; give one more level than steps")
        if self.solver.past_lag is not None and self.staircase.lag != count:
            raise InputError(f"past_lag {self.solver.past_lag} is for a lag of all {count} steps; leave it out where "
                             "segments overlap")  # fmt: skip
        if self.init_noise not in get_args(InitNoise):
            raise InputError(f"init_noise {self.init_noise!r} is not one of {', '.join(get_args(InitNoise))}")


class Stream(Iterator[Tensor]):
    """Segments (B, n, D) one after the other, in constant memory: the state of those in work and one finished segment.

    Args:
        denoiser: see the module. Its rows say which segments they are, so that it can bind each one's text.
        transport: the flow, or the identity.
        settings: solver and plan; ``staircase.segments=None`` never ends.
        seeds: one for every item.
        shape: (n, D) of a segment.
        enter: called with the number of each segment just before its first evaluation; returns its text's sentence
            embeddings (B, C) for the flow, None where there is no flow.
        state: where an earlier stream of the same settings and seeds was left.
        device: where to compute; noise is always drawn on the CPU.

    Attributes:
        progress: the live state; a copy of it is what another stream goes on from.
    """

    def __init__(
        self,
        denoiser: Denoiser,
        transport: Transport,
        settings: Settings,
        seeds: Sequence[int],
        shape: tuple[int, int],
        enter: Callable[[int], Tensor | None],
        state: StreamState | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self._denoiser, self._transport, self._enter_text = denoiser, transport, enter
        self._settings, self._plan, self._solver = settings, settings.staircase, settings.solver
        self._seeds, self._shape, self._device = tuple(seeds), tuple(shape), device
        self.progress = StreamState() if state is None else state.copy()
        self._past: tuple[int, Past] | None = None  # a finished segment's number, and how it is told

    def __next__(self) -> Tensor:
        now = self.progress
        while self._plan.segments is None or now.finished < self._plan.segments:
            if not self._plan.denoised(now.finished):
                return self._flow_on()
            done = self.evaluate(self._plan.wave(now.wave, first=now.finished))
            now.wave += 1
            if done is not None:
                return done
        raise StopIteration

    @torch.no_grad()
    def evaluate(self, cells: Sequence[Cell]) -> Tensor | None:
        """Evaluates cells in one batch, all from the state before; the segment that was finished by it, if any.

        Every cell's left neighbour must be ``lag`` steps ahead, or finished.
        """
        now, last = self.progress, self._plan.steps
        segments, steps = [segment for segment, _ in cells], [step for _, step in cells]
        for segment in segments:
            if segment == now.entered:
                self._enter(segment)
        # What the network sees of a segment in work is pushed once, for itself and for its right neighbour.
        seen = [j for j in now.active if j in segments or j + 1 in segments]
        x = dict(zip(seen, self._by_segment(self._transport.push(*self._rows(seen))), strict=True))
        past_steps = [self._past_step(j, k) for j, k in cells]
        prev = [x[j - 1] if j - 1 in x else self._told(j, k) for j, k in zip(segments, past_steps, strict=True)]
        y_BnD, index_B, pooled_BC = self._rows(segments)
        t_B = self._levels(steps)
        x0_BnD = self._denoiser(
            torch.cat([x[j] for j in segments]),
            self._solver.told(t_B),
            torch.cat([torch.zeros_like(y_BnD[: len(self._seeds)]) if held is None else held for held in prev]),
            self._levels(past_steps),
            index_B,
            [j for j in segments for _ in self._seeds],
        ).to(y_BnD.dtype)
        if all(k + 1 == last for k in steps):
            # A finished segment is wanted in x only: this spares one carry a segment, half of a one-step student's.
            return self._advance(segments, *[self._by_segment(x0_BnD)] * 2)
        y0_BnD = self._transport.pull(x0_BnD, index_B, pooled_BC)
        s_B = self._levels([k + 1 for k in steps])
        noise_BnD = self._noise(segments, steps)
        stepped = self._solver.step(y_BnD, y0_BnD, t_B, s_B, noise_BnD)
        return self._advance(segments, *(self._by_segment(z) for z in (stepped, x0_BnD)))

    def _past_step(self, segment: int, step: int) -> int:
        """The step that a segment is told the one before it to have reached."""
        lag, past_lag = self._plan.lag, self._solver.past_lag
        if past_lag is not None and self.progress.left_pooled is not None:
            lag = past_lag
        return min(step + lag, self._plan.steps) if segment else self._plan.steps

    def _told(self, segment: int, step: int) -> Tensor | None:
        """The finished segment before this one as if it had reached that step only; None for the first of all."""
        now, items, before = self.progress, len(self._seeds), segment - 1
        if now.left is None or now.left_pooled is None:
            return now.left
        if self._past is None or self._past[0] != before:
            noisy_B = torch.ones(items, dtype=torch.bool, device=self._device)
            self._past = (before, Past(now.left, self._seeds, [before] * items, now.left_pooled, noisy_B))
        return self._past[1].at(self._solver, self._transport, step)[0]

    def _advance(self, segments: list[int], y: Sequence[Tensor], x0: Sequence[Tensor]) -> Tensor | None:
        now = self.progress
        last = now.entered - 1
        for j, stepped in zip(segments, y, strict=True):
            k = j - now.finished
            now.y[k], now.steps[k] = stepped, now.steps[k] + 1
            if j == last:
                self._leave_for_the_next()
        if now.steps[0] < self._plan.steps:
            return None
        # Only the oldest can be finished: each segment ends after its left neighbour.
        now.left = x0[segments.index(now.finished)].clone()
        now.left_pooled = None if self._solver.past_lag is None else now.pooled[0]
        now.finished += 1
        del now.steps[0], now.y[0], now.pooled[0]
        return now.left

    def _enter(self, segment: int) -> None:
        now, settings, at = self.progress, self._settings, self._plan.entry(segment)
        text = self._enter_text(segment)
        now.pooled.append(torch.zeros(len(self._seeds), 0, device=self._device) if text is None else text)
        if segment == 0 or (at == 0 and settings.init_noise == "independent"):
            y = self._drawn(segment, START)
        else:
            assert now.waiting is not None
            y = now.waiting
        now.steps.append(at)
        now.y.append(y)
        now.waiting = None
        self._leave_for_the_next()

    def _leave_for_the_next(self) -> None:
        """Keeps of the last segment what the next one to enter begins with, once it is there."""
        now, settings = self.progress, self._settings
        if not self._plan.has(now.entered):
            return
        at = self._plan.entry(now.entered)
        if now.steps[-1] == at and (at or settings.init_noise == "shared"):
            now.waiting = now.y[-1].clone()  # not a view that keeps a whole wave

    @torch.no_grad()
    def _flow_on(self) -> Tensor:
        """A segment of the flow alone: f of the finished one before it."""
        now, flow = self.progress, self._transport.flow
        text = self._enter_text(now.finished)
        assert now.left is not None
        if flow is not None:
            assert text is not None
            index_B = torch.full((len(self._seeds),), now.finished, device=self._device)
            now.left = flow(now.left, flow.context(text, index_B))
        now.finished += 1
        return now.left

    def _rows(self, segments: Sequence[int]) -> tuple[Tensor, Tensor, Tensor]:
        """State, segment number and sentence embedding of the rows of these segments."""
        now, items = self.progress, len(self._seeds)
        places = [j - now.finished for j in segments]
        index_B = torch.tensor(segments, device=self._device).repeat_interleave(items)
        return torch.cat([now.y[k] for k in places]), index_B, torch.cat([now.pooled[k] for k in places])

    def _by_segment(self, rows: Tensor) -> tuple[Tensor, ...]:
        return rows.split(len(self._seeds))

    def _levels(self, steps: Sequence[int]) -> Tensor:
        of_segments = torch.tensor([self._solver.levels[k] for k in steps], device=self._device)
        return of_segments.repeat_interleave(len(self._seeds))

    def _noise(self, segments: Sequence[int], steps: Sequence[int]) -> Tensor | None:
        if not self._solver.eta:
            return None
        # The step to a clean level has no noise.
        zeros = torch.zeros(len(self._seeds), *self._shape, device=self._device)
        drawn = [self._drawn(j, k) if k + 1 < self._plan.steps else zeros for j, k in zip(segments, steps, strict=True)]
        return torch.cat(drawn)

    def _drawn(self, segment: int, step: int) -> Tensor:
        return self._solver.noise(self._seeds, [segment] * len(self._seeds), step, self._shape).to(self._device)
