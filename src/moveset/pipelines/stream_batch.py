"""``StreamBatch``: streams of one model side by side, each going on from its finished segment in one batched call.

A stream may join, leave, be copied and go back at any segment. Noise is keyed by seed, segment and step, and rows never
see each other, so a stream is the same in any company, to float tolerance; ``MotionStream`` is a batch of one.

Shapes: B streams, n frames of a segment, D features, C text width.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.models.condition import Denoiser
from moveset.models.flow import CouplingFlow
from moveset.motion.clip import Motion
from moveset.motion.stream_decoder import StreamDecoder
from moveset.pipelines.conditioning import Conditioning, SegmentCondition
from moveset.pipelines.device import one_thread, pick_device
from moveset.pipelines.heading_tracker import HeadingTracker
from moveset.pipelines.model_config import FLOW, StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.stream_settings import StreamSettings
from moveset.pipelines.timeline import Timeline, held
from moveset.pipelines.warnings import too_long, unfamiliar
from moveset.rdm.sequential import Past, sample_segment
from moveset.rdm.state import StreamState
from moveset.rdm.transport import Transport
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEncoder, get_text_encoder


@dataclass(frozen=True, eq=False)
class Segment:
    """A piece of the motion.

    Args:
        number: from 0.
        first_frame: number of its first frame in the stream.
        frames: n.
        motion: world rotations and path, going on from the segment before; float64, so that long walks stay smooth.
        planted: (n, 4) bool left ankle, left toe, right ankle, right toe: which feet stand by the model's own account.
        latency_ms: what making it took, its whole batch, with the encoding of new prompts since the segment before.
        network_evaluations: since the segment before; guidance by two evaluations counts both, as
            does a network that is evaluated with its mirror image.
    """

    number: int
    first_frame: int
    frames: int
    prompt: str
    motion: Motion
    planted: Tensor
    latency_ms: float
    network_evaluations: int


@dataclass(eq=False)
class Stream:
    """One stream between two segments. Made by ``StreamModel.open``; fits every batch of the same model.

    Attributes:
        seed: what its noise is drawn from.
        guidance: scale w.
        line: its prompts, by segments of its own.
        decoder: makes motion of its segments.
        condition: of the segment that was made last, or of the first one.
        number: of the next segment, as the sampler counts.
        given: how many of these are no segments of its own: a motion that it goes on from.
        left: (1, n, D) the last finished segment, normalised.
        left_pooled: (1, C) the sentence embedding of what it was told; None for a given motion.
        turned: radians by which its way has turned since its sentence began.
        reading_ms: what encoding took since the last segment.
    """

    seed: int
    guidance: float
    line: Timeline
    decoder: StreamDecoder
    condition: SegmentCondition
    number: int = 0
    given: int = 0
    left: Tensor | None = None
    left_pooled: Tensor | None = None
    turned: float = 0.0
    reading_ms: float = 0.0

    def copy(self) -> "Stream":
        return replace(self, decoder=self.decoder.copy())

    def back_at(self, earlier: "Stream") -> "Stream":
        """A copy of ``earlier`` that is told from there on what this stream is told."""
        line = self.line.beginning(earlier.number - earlier.given)
        return replace(
            earlier.copy(), line=line, guidance=self.guidance, condition=self.condition, reading_ms=self.reading_ms
        )


class StreamModel:
    """One network of a model, ready to make segments.

    Args:
        settings: how segments are made; ``guidance`` is the default of its streams.
        encoder: the model's text encoder, if it is there already.
        remembered: sentences that are kept encoded.

    Raises:
        FormatError: a damaged model.
    """

    #: Whether several segments of a stream may be in work at once.
    overlaps = True

    @one_thread()
    def __init__(
        self,
        bundle: ModelFolder[StreamConfig],
        settings: StreamSettings,
        *,
        device: torch.device | str = "auto",
        encoder: TextEncoder | None = None,
        remembered: int = 64,
    ) -> None:
        if not (self.overlaps or settings.sequential):
            raise InputError(
                f"network {settings.network!r} works on several segments of a stream at once (lag {settings.lag} of "
                f"{settings.steps} steps); streams are grouped where a segment follows a finished one: set start and "
                "lag to the steps"
            )
        config = bundle.config
        self.bundle, self.settings = bundle, settings
        self.codec, self.device = config.feature_codec(), pick_device(str(device))
        self.encoder = encoder or get_text_encoder(config.text_encoder, device=self.device)
        self.texts = CachedEncoder(self.encoder, remembered)
        self.mean, self.std = (bundle.normalizer[name].to(self.device) for name in ("feature_mean", "feature_std"))
        network = cast(Denoiser, bundle.module(settings.network, self.device))
        self.conditioning = Conditioning(bundle, network, self.texts, self.device)
        flow = cast(CouplingFlow, bundle.module(FLOW, self.device)) if config.flows(settings.network) else None
        self.transport = Transport(flow, max(config.depth_cap, 1))
        self.solver = settings.solver(config, network)
        self.shape = (config.segment, self.codec.dim)

    @one_thread()
    def open(self, prompt: str | Timeline, seed: int, guidance: float | None = None) -> Stream:
        """A stream at its beginning.

        Raises:
            InputError: an empty or absurd prompt.
        """
        line = held(prompt, self.settings.stages) if isinstance(prompt, str) else prompt
        guidance = self.settings.guidance if guidance is None else guidance
        start = time.perf_counter()
        condition = self.conditioning.of(line, 0, guidance)
        spent = (time.perf_counter() - start) * 1e3
        decoder = StreamDecoder(self.codec, self.settings.blend_seconds, foot_lock=self.settings.foot_lock)
        return Stream(seed, guidance, line, decoder, condition, reading_ms=spent)

    @one_thread()
    def prompt(self, stream: Stream, text: str, number: int | None = None) -> int:
        """Go on with another prompt, from the next segment on or from a later one of the stream's own.

        Returns:
            The first frame that it has an effect on.

        Raises:
            InputError: an empty or absurd prompt; the stream is as it was.
        """
        line = held(text, self.settings.stages)
        start = time.perf_counter()
        self.texts.encode(line.prompts)
        number = stream.number - stream.given if number is None else number
        stream.line = line.beginning(number)
        stream.reading_ms += (time.perf_counter() - start) * 1e3
        return number * self.bundle.config.segment

    @one_thread()
    def warnings(self, stream: Stream) -> tuple[str, ...]:
        """What the user should know about a stream's prompts."""
        prompts = tuple(dict.fromkeys(stream.line.prompts))
        pooled = self.texts.encode(prompts).pooled
        return (*too_long(self.encoder, prompts), *unfamiliar(self.bundle, prompts, pooled))

    def course(self, window: int) -> HeadingTracker:
        """Keeps how far streams turn of which so many segments are in work."""
        return HeadingTracker(self.codec.groups["root_yaw"], self.mean, self.std, window)

    def finished(
        self, streams: Sequence[Stream], clean_BnD: Tensor, conditions: Sequence[SegmentCondition], steps: int,
        start: float,
    ) -> list[Segment]:  # fmt: skip
        """Segments of what the sampler made, each the next of its stream.

        Args:
            streams: B, of which ``number`` is still that of the segment.
            clean_BnD: normalised.
            conditions: what they were told.
            steps: sampler steps that were taken for each.
            start: when this began, by ``time.perf_counter``.
        """
        with torch.inference_mode():
            features = clean_BnD * self.std + self.mean
        # Outside, so that what users get are ordinary tensors.
        features = features.cpu().clone()
        decoded = [(stream.decoder(x), self.codec.planted(x)) for stream, x in zip(streams, features, strict=True)]
        spent, n, out = (time.perf_counter() - start) * 1e3, self.shape[0], []
        for stream, told, (motion, planted) in zip(streams, conditions, decoded, strict=True):
            number, latency = stream.number - stream.given, round(spent + stream.reading_ms, 3)
            stream.number, stream.reading_ms = stream.number + 1, 0.0
            calls = steps * self.conditioning.evaluations(told.guidance)
            out.append(Segment(number, number * n, n, told.prompt, motion, planted, latency, calls))
        return out


class StreamBatch(StreamModel):
    """Makes segments of streams that each wait for their finished segment.

    Raises:
        InputError: settings by which several segments of a stream are in work at once.
    """

    overlaps = False

    @cached_property
    def _course(self) -> HeadingTracker:
        return self.course(window=1)

    @one_thread()
    def step(self, streams: Sequence[Stream]) -> list[Segment]:
        for stream in streams:
            start = time.perf_counter()
            number = stream.number - stream.given
            stream.condition = self.conditioning.of(stream.line, number, stream.guidance, stream.condition)
            stream.turned = stream.turned if stream.condition.behind else 0.0
            stream.reading_ms += (time.perf_counter() - start) * 1e3
        start = time.perf_counter()
        conditions = [stream.condition for stream in streams]
        with torch.inference_mode():
            clean_BnD = self._sample(streams, conditions)
            turns_B = self._course.turn(clean_BnD)
        for stream, told, clean, turn in zip(streams, conditions, clean_BnD.split(1), turns_B.tolist(), strict=True):
            stream.left, stream.left_pooled = clean.clone(), told.text.pooled
            stream.turned += turn
        return self.finished(streams, clean_BnD, conditions, self.settings.steps, start)

    def _sample(self, streams: Sequence[Stream], conditions: Sequence[SegmentCondition]) -> Tensor:
        """Clean segments (B, n, D), normalised."""
        seeds, numbers = [stream.seed for stream in streams], [stream.number for stream in streams]
        turned_B = torch.tensor([stream.turned for stream in streams], device=self.device)
        index_B = torch.tensor(numbers, device=self.device)
        denoise = self.conditioning.bind(conditions, index_B, turned_B, same_past=self.settings.clean_left)
        zeros = torch.zeros(1, *self.shape, device=self.device)
        left_BnD = torch.cat([zeros if stream.left is None else stream.left for stream in streams])
        pooled = [one.text.pooled for one in conditions]
        before = [own if s.left_pooled is None else s.left_pooled for s, own in zip(streams, pooled, strict=True)]
        # A stream's beginning has no past, and a motion that was given stays clean.
        noisy_B = torch.tensor([stream.left_pooled is not None for stream in streams], device=self.device)
        past = Past(left_BnD, seeds, [max(number - 1, 0) for number in numbers], torch.cat(before), noisy_B)
        return sample_segment(denoise, self.solver, seeds, numbers, past, self.transport, torch.cat(pooled))


class OneByOne:
    """A batch of one stream, and what it remembers."""

    def __init__(self, batch: StreamBatch, stream: Stream) -> None:
        self._batch, self._stream = batch, stream

    @property
    def entered(self) -> int:
        """Segments that were made, as the sampler counts."""
        return self._stream.number

    def step(self) -> list[Segment]:
        return self._batch.step([self._stream])

    def state(self) -> tuple[dict[str, Any], StreamState]:
        """Numbers for JSON, and what the staircase's sampler would remember."""
        stream, settings = self._stream, self._batch.settings
        waves = settings.staircase().begin(stream.number)
        pooled = None if settings.past_lag is None else stream.left_pooled
        numbers = {"prompts": {}, "behind": {}, "course": {"before": stream.turned, "turns": {}}}
        return numbers, StreamState(waves, stream.number, left=stream.left, left_pooled=pooled)

    def go_on(self, numbers: Mapping[str, Any], state: StreamState) -> None:
        """The stream goes on where another was when it gave this state, or from a given motion."""
        stream, course = self._stream, self._batch.course(window=1)
        if "course" in numbers:  # a given motion has none
            course.restored(numbers["course"])
        behind = stream.line.behind(stream.number - stream.given)
        stream.turned = float(course.total(stream.number, torch.tensor([behind])))
        stream.left, stream.left_pooled = state.left, state.left_pooled
