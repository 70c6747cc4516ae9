"""Streams that keep step, several segments of each in work at once: RDM's staircase.

Shapes: B streams, n frames of a segment, D features; in the network's calls B counts rows.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from moveset.pipelines.conditioning import SegmentCondition
from moveset.pipelines.device import one_thread
from moveset.pipelines.stream_batch import Segment, Stream, StreamModel
from moveset.pipelines.timeline import held
from moveset.rdm import sampler
from moveset.rdm.sequential import Denoise
from moveset.rdm.staircase import Staircase
from moveset.rdm.state import StreamState


class Overlapping:
    """Makes segments of streams by one sampler.

    Args:
        streams: B, all at the same segment.
        plan: the staircase; by default the settings' own, without end.
        init_noise: as in ``rdm.sampler.Settings``; a given motion has none to share.
    """

    def __init__(
        self,
        model: StreamModel,
        streams: Sequence[Stream],
        plan: Staircase | None = None,
        init_noise: sampler.InitNoise = "independent",
    ) -> None:
        self._model, self._streams, self._init_noise = model, streams, init_noise
        self._plan = plan or model.settings.staircase()
        self._begin(None)

    def _begin(self, state: StreamState | None) -> None:
        model = self._model
        self._conditions: dict[int, list[SegmentCondition]] = {}  # of the segments in work
        self._course = model.course(self._plan.steps)
        self._bound: tuple[int, Denoise] | None = None
        self._calls = 0
        self._sampler = sampler.Stream(
            self._denoise, model.transport,
            sampler.Settings(solver=model.solver, staircase=self._plan, init_noise=self._init_noise),
            [stream.seed for stream in self._streams], model.shape, self._enter, state, model.device,
        )  # fmt: skip

    @property
    def entered(self) -> int:
        """Segments that have entered the sampler, as it counts."""
        return self._sampler.progress.entered

    def state(self) -> tuple[dict[str, Any], StreamState]:
        """Of a single stream: numbers for JSON, and the sampler's own state."""
        told = {j: one for j, [one] in self._conditions.items()}
        numbers = {
            "prompts": {str(j): one.prompt for j, one in told.items()},
            "behind": {str(j): one.behind for j, one in told.items()},
            "course": self._course.state(),
        }
        return numbers, self._sampler.progress

    def go_on(self, numbers: Mapping[str, Any], state: StreamState) -> None:
        """A single stream goes on where another was when it gave this state, or from a given motion."""
        self._begin(state)
        if "course" in numbers:  # a given motion has none
            self._course.restored(numbers["course"])
        [stream] = self._streams
        for segment, prompt in numbers["prompts"].items():
            condition = self._model.conditioning.of(held(prompt, stages=False), 0, stream.guidance)
            self._conditions[int(segment)] = [replace(condition, behind=numbers["behind"][segment])]

    @one_thread()
    def step(self) -> list[Segment]:
        start = time.perf_counter()
        with torch.inference_mode():
            clean_BnD = next(self._sampler)
        conditions = self._conditions.pop(self._sampler.progress.finished - 1)
        calls, self._calls = self._calls, 0
        return self._model.finished(self._streams, clean_BnD, conditions, calls, start)

    def _enter(self, segment: int) -> Tensor | None:
        of, before = self._model.conditioning.of, self._conditions.get(segment - 1, [None] * len(self._streams))
        self._conditions[segment] = conditions = [
            of(stream.line, segment - stream.given, stream.guidance, last)
            for stream, last in zip(self._streams, before, strict=True)
        ]
        if self._model.transport.flow is None:
            return None
        return torch.cat([one.text.pooled for one in conditions])

    def _denoise(
        self, x_BnD: Tensor, t_B: Tensor, past_BnD: Tensor, past_t_B: Tensor, index_B: Tensor, rows: Sequence[int]
    ) -> Tensor:
        segments, given = list(dict.fromkeys(rows)), self._streams[0].given
        if given and 1 in segments:
            # The sampler's plan has the given motion still in work, at the level of its place in the staircase.
            past_t_B = past_t_B * (index_B != 1)
        if self._bound is None or self._bound[0] != segments[0] or not self._model.settings.clean_left:
            conditions = [one for segment in segments for one in self._conditions[segment]]
            turned_B = torch.cat([self._course.turned(segment, self._behind(segment)) for segment in segments])
            bind, same_past = self._model.conditioning.bind, self._model.settings.clean_left
            self._bound = segments[0], bind(conditions, index_B, turned_B, same_past=same_past)
        made_BnD = self._bound[1](x_BnD, t_B, past_BnD, past_t_B)
        for segment, made in zip(segments, made_BnD.split(len(self._streams)), strict=True):
            self._course.made(segment, made, self._behind(segment))
        self._calls += len(segments)
        return made_BnD

    def _behind(self, segment: int) -> Tensor:
        return torch.tensor([one.behind for one in self._conditions[segment]], device=self._model.device)
