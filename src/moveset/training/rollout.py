"""Streams that run beside a student's training, so that it is told what it is told in use: its own past.

A student of segments learns with predecessors from takes. In use it goes on from what it made itself, and what no take
has (a slower step, a lower hip) becomes the next segment's past. Some rows of a batch are therefore running streams:
each is told what the student made there a step ago, and what it makes now is what it is told next. A segment of several
phases takes as many training steps, each from where the one before landed, so that lower phases meet the student's own
guesses too; streams take turns, so that every batch has all phases. Streams give way now and then: something else is
said, either to the stream or where another one begins.
Source: scheduled sampling (Bengio et al. 2015, arXiv 1506.03099) and self forcing (Huang et al. 2025, arXiv
2506.08009), here across training steps, so that a stream's length costs nothing.

Shapes: B rows, S of them streams, n frames of a segment, D features.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from moveset.data.segments import SegmentBatch
from moveset.diffusion.phases import PhaseGrid
from moveset.errors import InputError

SEGMENTS = 32
"""Segments for which a stream goes on with one sentence, on average."""
STAYING = 0.5
"""Share of new sentences that are said to a running stream; with the others another one begins."""


@dataclass(frozen=True, eq=False)
class _Streams:
    """What streams are told (S, …): past, segment number, turn since the sentence began, sides beside it,
    guidance scale, sentence; and an example of the sentence.

    ``phase`` is the one that is next, ``landed`` the noisy segment there, of no meaning where one begins, and ``noise``
    the one that the segment began with.
    """

    previous: Tensor
    index: Tensor
    turned: Tensor
    sides: Tensor
    w: Tensor
    clean: Tensor
    phase: Tensor
    landed: Tensor
    noise: Tensor
    captions: list[str]


class Rollout:
    """The streams of a training.

    Args:
        share: of a batch's rows, spread evenly over it.

    Raises:
        InputError: a share that comes to no row.
    """

    def __init__(self, share: float, batch: int, grid: PhaseGrid) -> None:
        self.grid = grid
        self.count = round(share * batch)
        if share and not self.count:
            raise InputError(
                f"rollout_share = {share} of a batch of {batch} is not one row; give a larger share or batch"
            )
        self.rows = torch.arange(self.count) * batch // max(self.count, 1)
        self._streams: _Streams | None = None
        self._moving = False

    def tell(self, batch: SegmentBatch, w_B: Tensor, generator: torch.Generator) -> tuple[SegmentBatch, Tensor]:
        """A batch of takes with streams instead of some rows, and guidance scales (B,): a stream keeps its own.

        ``clean`` of a stream is what a take shows for its sentence, not what follows on its past.

        Args:
            generator: decides which streams give way.
        """
        to = batch.index.device
        ends, stays = torch.rand((2, self.count), generator=generator, device=generator.device).to(to)
        offered = self._offered(batch, w_B)
        if self._streams is None:
            self._streams = offered
        old = self._streams
        ends_S = (ends < 1 / SEGMENTS) & (old.phase == self.grid.phases - 1)
        begins_S = ends_S & (stays >= STAYING)
        new_captions = zip(ends_S.tolist(), offered.captions, old.captions, strict=True)
        # What is said to a running stream begins then.
        anew_S = offered.turned * 0.0  # unknown stays so
        turned_S = _mixed(ends_S, _mixed(begins_S, offered.turned, anew_S), old.turned)
        now = self._streams = replace(
            old,
            previous=_mixed(begins_S, offered.previous, old.previous),
            index=_mixed(begins_S, offered.index, old.index),
            turned=turned_S,
            sides=_mixed(ends_S, offered.sides, old.sides),
            w=_mixed(begins_S, offered.w, old.w),
            clean=_mixed(ends_S, offered.clean, old.clean),
            captions=[new if end else kept for end, new, kept in new_captions],
        )
        rows, captions, before = self.rows.to(to), list(batch.captions), list(batch.previous_captions)
        for row, caption in zip(self.rows.tolist(), now.captions, strict=True):
            captions[row] = before[row] = caption
        told = replace(
            batch,
            clean=batch.clean.index_copy(0, rows, now.clean),
            valid=batch.valid.index_fill(0, rows, True),
            previous=batch.previous.index_copy(0, rows, now.previous),
            index=batch.index.index_copy(0, rows, now.index),
            turned=batch.turned.index_copy(0, rows, now.turned),
            sides=batch.sides.index_copy(0, rows, now.sides),
            captions=captions,
            previous_captions=before,
        )
        return told, w_B.index_copy(0, rows, now.w)

    def place(self, point_B: Tensor) -> Tensor:
        """Solver points (B,): a stream's is the highest of the phase that it is in; before ``tell``."""
        rows = self.rows.to(point_B.device)
        phase_S = self._turns() if self._streams is None else self._streams.phase
        return point_B.index_copy(0, rows, self.grid.highest_of(phase_S.to(rows.device)))

    def enter(self, z_BnD: Tensor) -> Tensor:
        """Noisy segments (B, n, D) at these points: in the middle of a segment a stream is where it landed.

        Before anything was made it is where a take's segment is.
        """
        if self._streams is None:
            return z_BnD
        rows = self.rows.to(z_BnD.device)
        return z_BnD.index_copy(0, rows, _mixed(self._in_the_middle(), self._streams.landed, z_BnD[rows]))

    def began_with(self, noise_BnD: Tensor) -> Tensor:
        """Noise (B, n, D) that segments began with: a batch's own, but what a stream in the middle of one had then.

        After ``tell``, once a step.
        """
        if self._streams is None:
            return noise_BnD
        rows = self.rows.to(noise_BnD.device)
        noise_S = _mixed(self._in_the_middle(), self._streams.noise, noise_BnD[rows])
        self._streams = replace(self._streams, noise=noise_S)
        return noise_BnD.index_copy(0, rows, noise_S)

    def go_on(self, made_BnD: Tensor, landed_BnD: Tensor, turn_B: Tensor) -> None:
        """What the student made of the batch that ``tell`` gave becomes the streams' past, at the end of a segment.

        Args:
            made_BnD: clean segments.
            landed_BnD: noisy ones at the lower edges of their phases, where unfinished segments go on.
            turn_B: radians by which the clean ones turn.
        """
        assert self._streams is not None
        old, rows = self._streams, self.rows.to(made_BnD.device)
        made, landed = (x.detach()[rows].to(old.previous.dtype) for x in (made_BnD, landed_BnD))
        done_S, self._moving = old.phase == 0, True
        self._streams = replace(
            old,
            previous=_mixed(done_S, made, old.previous),
            index=old.index + done_S.long(),
            turned=old.turned + turn_B[rows] * done_S,
            phase=torch.where(done_S, self.grid.phases - 1, old.phase - 1),
            landed=landed,
        )

    def state(self) -> dict[str, Any]:
        """For a checkpoint; empty before the first step."""
        return {} if self._streams is None else vars(self._streams) | {"captions": json.dumps(self._streams.captions)}

    def load_state(self, state: Mapping[str, Any], device: torch.device) -> None:
        """Takes back what ``state`` gave; of other streams (fewer, of other phases) nothing, they begin anew."""
        names = {field.name for field in fields(_Streams)}
        if state.keys() == names and len(state["index"]) == self.count and int(state["phase"].max()) < self.grid.phases:
            tensors = {name: value.to(device) for name, value in state.items() if isinstance(value, Tensor)}
            self._streams, self._moving = _Streams(**tensors, captions=json.loads(state["captions"])), True

    def _offered(self, batch: SegmentBatch, w_B: Tensor) -> _Streams:
        """Takes' rows to begin with, for every stream one: those without frames missing, while there are any."""
        whole = batch.valid.all(dim=1).nonzero()[:, 0]
        if not len(whole):
            whole = torch.arange(len(batch.index), device=whole.device)
        rows = whole[torch.arange(self.count, device=whole.device) % len(whole)]
        captions = [batch.captions[row] for row in rows.tolist()]
        clean, phase = batch.clean[rows], self._turns().to(batch.index.device)
        named = (batch.previous, batch.index, batch.turned, batch.sides, w_B)
        return _Streams(*(part[rows] for part in named), clean, phase, clean, clean, captions)

    def _in_the_middle(self) -> Tensor:
        """Which streams (S,) have made a part of a segment."""
        assert self._streams is not None
        begun_S: Tensor = self._streams.phase < self.grid.phases - 1
        return begun_S & self._moving

    def _turns(self) -> Tensor:
        """Phases (S,) in which streams begin: the highest, the one below, and so on."""
        return (self.grid.phases - 1 - torch.arange(self.count)) % self.grid.phases


def _mixed(these_S: Tensor, new: Tensor, old: Tensor) -> Tensor:
    return torch.where(these_S.view(-1, *[1] * (new.ndim - 1)), new, old)
