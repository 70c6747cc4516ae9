"""Recurrent models as generators: many sequences at once, each with its own prompts.

B sequences, N segments, n frames of a segment, D features, L text tokens. The rows of a batch are grouped by segment,
as ``rdm.sampler`` has them: every sequence's row of the oldest segment first.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import asdict
from itertools import islice
from typing import Any, cast

import torch
from torch import Tensor, nn

from moveset.data.captions import mirror_text
from moveset.diffusion.guidance import cfg
from moveset.evaluation.generators import Tick, Wanted, frames_at, joints_at
from moveset.models.flow import CouplingFlow
from moveset.models.segment_transformer import told_of
from moveset.models.symmetric import Symmetric
from moveset.motion.clip import Motion
from moveset.pipelines.course import Course
from moveset.pipelines.device import pick_device
from moveset.pipelines.generator import REMEMBERED
from moveset.pipelines.stream_bundle import FLOW, StreamBundle
from moveset.pipelines.stream_settings import StreamSettings, share_evenly
from moveset.rdm.sampler import Settings, Stream
from moveset.rdm.staircase import Shape, Staircase
from moveset.rdm.transport import Transport
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEmbedding, get_text_encoder
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
        self._codec = bundle.config.feature_codec()
        self._device, self._batch = pick_device(device), batch
        self._text = CachedEncoder(get_text_encoder(bundle.config.text_encoder, device=self._device), REMEMBERED)
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
        return self._bundle.sha256(self._settings.network, *([FLOW] if self._uses_flow else []))

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
                sequences = self._sample([wanted[k] for k in part], plan, fps)
                for k, features in zip(part, sequences, strict=True):
                    made[k] = joints_at(self._motion(features), fps, wanted[k].frames)
                tick(len(part))
        return made

    @property
    def _uses_flow(self) -> bool:
        return self._bundle.config.flows(self._settings.network)

    def _plan(self, segments: int) -> Staircase:
        settings = self._settings
        return Staircase(settings.steps, segments, settings.start, self._shape, settings.lag)

    @torch.inference_mode()
    def _sample(self, wanted: Sequence[Wanted], plan: Staircase, fps: float) -> Tensor:
        """Features (B, N n, D), not normalised."""
        config, settings, statistics = self._bundle.config, self._settings, self._bundle.normalizer
        network = self._bundle.module(settings.network, self._device)
        flow = self._bundle.module(FLOW, self._device) if self._uses_flow else None
        said = [timeline(one, fps, config.segment / config.fps, settings.stages) for one in wanted]
        denoiser = Bound(
            network,
            self._text,
            said,
            guided=bool(config.models[settings.network].config.get("guided")),
            guidance=settings.guidance,
            once=settings.clean_left,
            course=Course(
                self._codec.groups["root_yaw"], statistics["feature_mean"], statistics["feature_std"], plan.steps
            ),
            device=self._device,
        )

        def enter(segment: int) -> Tensor | None:
            return None if flow is None else denoiser.pooled(segment)

        segments = Stream(
            denoiser,
            Transport(cast(CouplingFlow | None, flow), max(config.depth_cap, 1)),
            Settings(solver=settings.solver(config, network), staircase=plan),
            [one.seed for one in wanted],
            (config.segment, self._codec.dim),
            enter,
            device=self._device,
        )
        assert plan.segments is not None
        made = torch.cat(list(islice(segments, plan.segments)), dim=1).cpu()
        return made * statistics["feature_std"] + statistics["feature_mean"]

    def _motion(self, features: Tensor) -> Motion:
        """The motion of features (F, D) as a stream gives it out, piece by piece: seams smoothed, feet locked."""
        decoder = self._settings.decoder(self._bundle.config, self._codec)
        return decoder.whole(features, self._bundle.config.segment)


class _Line:
    """Which prompt a segment has, and where in its time the segment lies.

    Args:
        starts: the first segment of each prompt.
        total: segments of all of them together, the last not always whole.
    """

    def __init__(self, prompts: Sequence[str], starts: Sequence[int], total: float) -> None:
        self._prompts, self._bounds = tuple(prompts), (*starts, total)

    def __call__(self, segment: int) -> str:
        return self._prompts[self._part(segment)]

    def place(self, segment: int) -> tuple[float, float]:
        """Segments behind this one and from its beginning on, of what its prompt has."""
        begin, end = self._bounds[(part := self._part(segment)) : part + 2]
        return segment - begin, end - segment

    def _part(self, segment: int) -> int:
        return bisect_right(self._bounds[:-1], segment) - 1


def timeline(wanted: Wanted, fps: float, seconds: float, stages: bool = True) -> _Line:
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
    return _Line(prompts, starts[:-1], frames / fps / seconds)


class Bound:
    """A denoiser with every sequence's prompt of every segment bound to it, for ``rdm.sampler``.

    Args:
        network: the denoiser.
        text: its encoder.
        said: of each sequence, the prompt by segment.
        guided: whether it takes the guidance scale as an input; the others are evaluated with and without text.
        guidance: scale w.
        once: every segment is told its finished predecessor, so text and predecessor are read once for all steps.
        course: how far the sequences have turned, which is kept here.
        device: where to compute.
    """

    def __init__(
        self, network: nn.Module, text: CachedEncoder, said: Sequence[_Line], *, guided: bool, guidance: float,
        once: bool, course: Course, device: torch.device,
    ) -> None:  # fmt: skip
        self._network, self._text, self._said, self._guided, self._w = network, text, said, guided, guidance
        self._twice = bool(guidance) and not guided
        self._even = isinstance(network, Symmetric)
        self._once, self._device, self._course = once and hasattr(network, "read"), device, course
        self._words: tuple[tuple[int, ...], TextEmbedding] | None = None
        self._context: tuple[int, object] | None = None

    def __call__(
        self, x_BnD: Tensor, t_B: Tensor, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor, segments: Sequence[int]
    ) -> Tensor:
        """Clean segments (B, n, D)."""
        text = self._read(tuple(dict.fromkeys(segments)))
        if self._twice:
            x_BnD, prev_BnD = (z.repeat(2, 1, 1) for z in (x_BnD, prev_BnD))
            t_B, prev_t_B, index_B = (z.repeat(2) for z in (t_B, prev_t_B, index_B))
        w_B = torch.full((len(x_BnD),), self._w, device=self._device) if self._guided else None
        if self._once:
            network: Any = self._network
            if self._context is None or self._context[0] != segments[0]:
                told = self._told(segments, x_BnD.shape[1])
                read = network.read(text.tokens, text.mask, prev_BnD, prev_t_B, index_B, **told)
                self._context = (segments[0], read)
            made = network.denoise(x_BnD, t_B, self._context[1], w_B)
        else:
            told = self._told(segments, x_BnD.shape[1])
            made = self._network(x_BnD, t_B, prev_BnD, prev_t_B, index_B, text.tokens, text.mask, w_B, **told)
        made = cfg(*made.chunk(2), self._w) if self._twice else made
        for segment, rows in zip(dict.fromkeys(segments), made.split(len(self._said)), strict=True):
            self._course.made(segment, rows, self._behind(segment))
        return made

    def pooled(self, segment: int) -> Tensor:
        """(B, C) sentence embeddings of a segment's prompts."""
        return self._text.encode([line(segment) for line in self._said]).pooled.to(self._device)

    def _told(self, segments: Sequence[int], frames: int) -> dict[str, Tensor]:
        """Where in the time of their prompts these rows lie, and how far they have turned since, as the network reads
        it."""
        each, times = dict.fromkeys(segments), 2 if self._twice else 1
        place_B2 = torch.tensor([line.place(segment) for segment in each for line in self._said]) * frames
        turned_B = torch.cat([self._course.turned(segment, self._behind(segment)) for segment in each])
        return told_of(self._network, place_B2.repeat(times, 1).to(self._device), turned_B.repeat(times))

    def _behind(self, segment: int) -> Tensor:
        """Segments (B,) of the same prompts that lie before this one."""
        return torch.tensor([int(line.place(segment)[0]) for line in self._said], device=self._device)

    def _read(self, segments: tuple[int, ...]) -> TextEmbedding:
        """Of the rows of these segments; below them the empty text for guidance, or what mirror images are told."""
        if self._words is None or self._words[0] != segments:
            said = [line(segment) for segment in segments for line in self._said]
            below = [""] * len(said) if self._twice else [mirror_text(line) for line in said] if self._even else []
            text = self._text.encode(said + below)
            self._words = (segments, text.to(self._device))
        return self._words[1]
