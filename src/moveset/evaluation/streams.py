"""Recurrent models as generators: many sequences at once, each with its own prompts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from typing import Any

import torch
from torch import Tensor

from moveset.evaluation.generators import Tick, Wanted, frames_at, joints_at
from moveset.motion.clip import Motion
from moveset.motion.stream_decoder import concatenate
from moveset.pipelines.device import pick_device
from moveset.pipelines.generator import REMEMBERED
from moveset.pipelines.overlapping import Overlapping
from moveset.pipelines.stream_batch import Segment, StreamBatch, StreamModel
from moveset.pipelines.stream_bundle import FLOW, StreamBundle
from moveset.pipelines.stream_settings import StreamSettings
from moveset.pipelines.timeline import Timeline, share_evenly
from moveset.rdm.staircase import Shape, Staircase
from moveset.text.stages import split_stages


class Streams:
    """A stream's model folder by one of its networks, sampled in batches.

    Args:
        bundle: the folder.
        settings: network, steps, staircase, guidance and finish, from ``pipelines.stream_settings.check_stream``.
        shape: of the staircase; streams of users have "parallelogram".
        extras: what distinguishes these settings from the folder's own, for the name of files.
        device: where to compute.
        batch: rows evaluated at once, about.
    """

    random = True

    def __init__(
        self,
        bundle: StreamBundle,
        settings: StreamSettings,
        *,
        shape: Shape = "parallelogram",
        extras: Sequence[str] = (),
        device: str = "auto",
        batch: int = 96,
    ) -> None:
        self._bundle, self._settings, self._shape = bundle, settings, shape
        self._device, self._batch = pick_device(device), batch
        self.model, self.network, self.steps = bundle.config.name, settings.network, settings.steps
        self.segment = bundle.config.segment / bundle.config.fps
        self.slug = "-".join([self.model, settings.network, *extras])

    def describe(self) -> dict[str, Any]:
        settings = {k: v for k, v in asdict(self._settings).items() if k not in ("network", "steps", "buffer")}
        # Said where there is something to say, so that results from before it could be chosen are of the same settings.
        if settings["past_lag"] is None:
            del settings["past_lag"]
        if self._bundle.config.travelling != 1.0:
            settings["travelling"] = self._bundle.config.travelling
        settings["symmetric"] = self.network in self._bundle.config.symmetric
        return {**settings, "shape": self._shape, "batch": self._batch, "device": self._device.type}

    def weights(self) -> dict[str, str]:
        flow = (FLOW,) if self._bundle.config.flows(self._settings.network) else ()
        return self._bundle.sha256(self._settings.network, *flow)

    def generate(self, wanted: Sequence[Wanted], fps: float, tick: Tick = lambda count: None) -> list[Tensor]:
        made: list[Tensor] = [torch.empty(0)] * len(wanted)
        n, rate = self._bundle.config.segment, self._bundle.config.fps
        by_count: dict[int, list[int]] = {}
        for k, one in enumerate(wanted):
            by_count.setdefault(math.ceil(frames_at(one.frames, fps, rate) / n), []).append(k)
        for count, rows in sorted(by_count.items()):
            plan = self._plan(count)
            size = max(1, self._batch // max(len(cells) for cells in plan.wavefront()))
            for start in range(0, len(rows), size):
                part = rows[start : start + size]
                for k, motion in zip(part, self._sample([wanted[k] for k in part], plan, fps), strict=True):
                    made[k] = joints_at(motion, fps, wanted[k].frames)
                tick(len(part))
        return made

    @cached_property
    def _model(self) -> StreamModel:
        one_by_one = self._settings.sequential and self._shape == "parallelogram"
        kind = StreamBatch if one_by_one else StreamModel
        return kind(self._bundle, self._settings, device=self._device, remembered=REMEMBERED)

    def _plan(self, segments: int) -> Staircase:
        settings = self._settings
        return Staircase(settings.steps, segments, settings.start, self._shape, settings.lag)

    def _sample(self, wanted: Sequence[Wanted], plan: Staircase, fps: float) -> list[Motion]:
        """Every sequence as a stream gives it out: seams smoothed, feet locked."""
        assert plan.segments is not None
        config, model, settings = self._bundle.config, self._model, self._settings
        seconds = config.segment / config.fps
        streams = [model.open(timeline(one, fps, seconds, settings.stages), one.seed) for one in wanted]
        step: Callable[[], list[Segment]] = (
            partial(model.step, streams) if isinstance(model, StreamBatch) else Overlapping(model, streams, plan).step
        )
        pieces = zip(*[step() for _ in range(plan.segments)], strict=True)
        return [concatenate([segment.motion for segment in sequence]) for sequence in pieces]


def timeline(wanted: Wanted, fps: float, seconds: float, stages: bool = True) -> Timeline:
    """The prompts by segment of ``seconds``; each begins with the segment nearest to its place and has one at least.

    Args:
        stages: take the stages of a prompt apart (``text.stages``), which share its frames evenly.
    """
    prompts, starts, frames = [], [0], 0
    for prompt, count in wanted.parts:
        said = split_stages(prompt) if stages else (prompt,)
        prompts += said
        for end in share_evenly(frames, frames + count, len(said))[1:]:
            starts.append(max(starts[-1] + 1, round(end / fps / seconds)))
        frames += count
    return Timeline(tuple(prompts), tuple(starts[:-1]), frames / fps / seconds, timed=True)
