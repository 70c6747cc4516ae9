"""A stream's model as a generator: many sequences at once, each with its own prompts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from typing import Any

import torch

from moveset.motion.clip import Motion, concatenate
from moveset.pipelines.device import pick_device
from moveset.pipelines.model_config import FLOW, SIDES, StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.overlapping import Overlapping
from moveset.pipelines.request import Request
from moveset.pipelines.stream_batch import Segment, StreamBatch, StreamModel
from moveset.pipelines.stream_settings import StreamSettings
from moveset.pipelines.timeline import Timeline, share_evenly
from moveset.rdm.sampler import InitNoise
from moveset.rdm.staircase import Shape, Staircase
from moveset.text.stages import split_stages


class StreamGenerator:
    """A stream's model folder by one of its networks, sampled in batches.

    Args:
        settings: network, steps, staircase, guidance and finish, from ``pipelines.stream_settings.check_stream``.
        shape: of the staircase; streams of users have "parallelogram".
        init_noise: as in ``rdm.sampler.Settings``; theirs is "independent".
        extras: what distinguishes these settings from the folder's own, for the name of files.
        batch: rows evaluated at once, about.
    """

    def __init__(
        self,
        bundle: ModelFolder[StreamConfig],
        settings: StreamSettings,
        *,
        shape: Shape = "parallelogram",
        init_noise: InitNoise = "independent",
        extras: Sequence[str] = (),
        device: str = "auto",
        batch: int = 96,
    ) -> None:
        self._bundle, self._settings, self._shape, self._init_noise = bundle, settings, shape, init_noise
        self._device, self._batch = pick_device(device), batch
        self.model, self.network, self.steps = bundle.config.name, settings.network, settings.steps
        self.fps, self.segment = bundle.config.fps, bundle.config.segment
        self.skeleton = bundle.config.feature_codec().skeleton.name
        self.slug = "-".join([self.model, settings.network, *extras])

    def describe(self) -> dict[str, Any]:
        settings = {k: v for k, v in asdict(self._settings).items() if k not in ("network", "steps", "buffer")}
        # Said where there is something to say, so that results from before it could be chosen are of the same settings.
        for name, usual in (("past_lag", None), ("variance", "posterior"), ("eps_scale", 1.0), ("time_shift", 0.0)):
            if settings[name] == usual:
                del settings[name]
        settings["symmetric"] = self.network in self._bundle.config.symmetric
        if self._init_noise != "independent":
            settings["init_noise"] = self._init_noise
        return {**settings, "shape": self._shape, "batch": self._batch, "device": self._device.type}

    def weights(self) -> dict[str, str]:
        flow = (FLOW,) if self._bundle.config.flows(self._settings.network) else ()
        return self._bundle.sha256(self._settings.network, *flow, SIDES)

    @torch.inference_mode()
    def generate(
        self, requests: Sequence[Request], progress: Callable[[int], object] = lambda count: None
    ) -> list[Motion]:
        made: dict[int, Motion] = {}
        by_count: dict[int, list[int]] = {}
        for k, request in enumerate(requests):
            by_count.setdefault(math.ceil(request.total / self.segment), []).append(k)
        for count, rows in sorted(by_count.items()):
            plan = self._plan(count)
            size = max(1, self._batch // max(len(cells) for cells in plan.wavefront()))
            for start in range(0, len(rows), size):
                part = rows[start : start + size]
                made |= dict(zip(part, self._sample([requests[k] for k in part], plan), strict=True))
                progress(len(part))
        return [made[k] for k in range(len(requests))]

    @cached_property
    def _model(self) -> StreamModel:
        one_by_one = self._settings.sequential and self._shape == "parallelogram"
        kind = StreamBatch if one_by_one else StreamModel
        return kind(self._bundle, self._settings, device=self._device, remembered=8192)

    def _plan(self, segments: int) -> Staircase:
        settings = self._settings
        return Staircase(settings.steps, segments, settings.start, self._shape, settings.lag)

    def _sample(self, requests: Sequence[Request], plan: Staircase) -> list[Motion]:
        """Every sequence as a stream gives it out: seams smoothed, feet locked."""
        assert plan.segments is not None
        model, stages = self._model, self._settings.stages
        streams = [model.open(timeline(one, self.segment, self.fps, stages), one.seed) for one in requests]
        step: Callable[[], list[Segment]] = (
            partial(model.step, streams)
            if isinstance(model, StreamBatch)
            else Overlapping(model, streams, plan, self._init_noise).step
        )
        pieces = zip(*[step() for _ in range(plan.segments)], strict=True)
        return [concatenate([segment.motion for segment in sequence]) for sequence in pieces]


def timeline(request: Request, segment: int, fps: float, stages: bool = True) -> Timeline:
    """The prompts by segment; each begins with the segment nearest to its place and has one at least.

    Args:
        segment: frames of a segment, of which there are ``fps`` a second.
        stages: take the stages of a prompt apart (``text.stages``), which share its frames evenly.
    """
    prompts, starts, frames = [], [0], 0
    seconds = segment / fps
    for prompt, count in zip(request.prompts, request.frames, strict=True):
        said = split_stages(prompt) if stages else (prompt,)
        prompts += said
        end = frames + (count or 0)
        for stop in share_evenly(frames, end, len(said))[1:]:
            starts.append(max(starts[-1] + 1, round(stop / fps / seconds)))
        frames = end
    return Timeline(tuple(prompts), tuple(starts[:-1]), frames / fps / seconds)
