"""``MotionStream``: motion without end, a segment at a time, told by a prompt that may change at any moment.

A prompt belongs to a segment from the moment that segment enters the sampler; a new one takes effect with the next to
enter. Memory is constant: what is held are the segments in work, one finished one, and a few encoded prompts.

Shapes: n frames of a segment, D features; in the sampler always one item.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, cast

import torch
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.models.flow import CouplingFlow
from moveset.models.segment_transformer import UNKNOWN
from moveset.motion.clip import Motion
from moveset.pipelines.course import Course
from moveset.pipelines.device import one_thread, pick_device
from moveset.pipelines.seed_motion import SeedMotion
from moveset.pipelines.segment import Segment
from moveset.pipelines.segment_denoise import SegmentDenoise
from moveset.pipelines.stream_bundle import DEFAULT_STREAM, FLOW, StreamBundle
from moveset.pipelines.stream_settings import (
    BLEND_SECONDS,
    StreamRequest,
    StreamSettings,
    Timeline,
    check_stream,
    held,
)
from moveset.pipelines.stream_state import Snapshot
from moveset.pipelines.warnings import too_long, unfamiliar
from moveset.rdm.sampler import Settings, Stream
from moveset.rdm.state import StreamState
from moveset.rdm.transport import Transport
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEncoder, get_text_encoder

_WARM_UP = 3  # segments made and thrown away before the first


class MotionStream(Iterator[Segment]):
    """An endless motion; an iterator of its segments.

    >>> from moveset import MotionStream
    >>> stream = MotionStream.from_pretrained(prompt="a person walks forward", seed=7)  # doctest: +SKIP
    >>> first = next(stream).motion  # doctest: +SKIP
    >>> stream.prompt("a person waves with the left hand")  # doctest: +SKIP
    28

    Args:
        bundle: the model.
        request: what happens, from which seed, by which settings: ``check_stream``.
        seed_motion: a clip that the stream goes on from, of at least one segment; it is retargeted and resampled.
        device: where to compute.
        encoder: the model's text encoder, if it is there already.

    Raises:
        InputError: no such device, or a seed motion that cannot be used.
        FormatError: a damaged model.
    """

    def __init__(
        self,
        bundle: StreamBundle,
        request: StreamRequest,
        *,
        seed_motion: Motion | None = None,
        device: torch.device | str = "auto",
        encoder: TextEncoder | None = None,
    ) -> None:
        self.bundle, self.codec, self.device = bundle, bundle.config.feature_codec(), pick_device(str(device))
        self.encoder = encoder or get_text_encoder(bundle.config.text_encoder, device=self.device)
        self._texts = CachedEncoder(self.encoder)
        normalizer = bundle.normalizer
        self._mean, self._std = (normalizer[name].to(self.device) for name in ("feature_mean", "feature_std"))
        self._seed, self._timeline = request.seed, request.timeline
        if seed_motion is not None and not isinstance(seed_motion, Motion):
            raise InputError(f"a stream goes on from a Motion, not from {seed_motion!r}; read a file by moveset.load")
        seed = None if seed_motion is None else SeedMotion.of(seed_motion, self.codec, bundle.config.segment)
        self._begin(request.settings, seed)

    @classmethod
    def from_pretrained(
        cls,
        name_or_path: str | Path = DEFAULT_STREAM,
        prompt: str | Sequence[str] | None = None,
        *,
        seconds: float | Sequence[float] | None = None,
        loop: bool = False,
        seed: int = 0,
        seed_motion: Motion | None = None,
        network: str | None = None,
        steps: int | None = None,
        start: int | None = None,
        lag: int | None = None,
        past_lag: int | None = None,
        eta: float | None = None,
        guidance: float | None = None,
        buffer: int = 0,
        foot_lock: bool = True,
        blend_seconds: float = BLEND_SECONDS,
        stages: bool = True,
        device: torch.device | str = "auto",
    ) -> "MotionStream":
        """A stream of a shipped model by name, or of a model folder.

        Args:
            name_or_path: the model.
            seed_motion: a clip that the stream goes on from.
            device: where to compute.
            others: ``stream_settings.check_stream``.

        Raises:
            InputError: no such model, or anything out of range.
            FormatError: a damaged model folder.
        """
        bundle = StreamBundle.find(name_or_path)
        request = check_stream(
            bundle.config, prompt, seconds, loop=loop, seed=seed, network=network, steps=steps, start=start, lag=lag,
            past_lag=past_lag, eta=eta, guidance=guidance, buffer=buffer, foot_lock=foot_lock,
            blend_seconds=blend_seconds, stages=stages,
        )  # fmt: skip
        return cls(bundle, request, seed_motion=seed_motion, device=device)

    def __reduce__(self) -> tuple[Any, ...]:
        # A pickle, or a copy, goes on where this one stands; the model's folder is read again.
        request = StreamRequest(self._timeline, self._seed, self._settings, (), ())
        return _reopened, (self.bundle, request, self.device, self.encoder, self.state())

    def __next__(self) -> Segment:
        if self._pool is None:
            return self._waiting.popleft() if self._waiting else self._make()
        # One segment more than the buffer holds: the one that is about to be taken.
        while len(self._ahead) + len(self._waiting) <= self.settings.buffer:
            self._ahead.append(self._pool.submit(self._make))
        return self._waiting.popleft() if self._waiting else self._ahead.popleft().result()

    @one_thread()
    def prompt(self, text: str) -> int:
        """Go on with another prompt, until the next call; what was left of a timeline is dropped.

        Of a sentence with several stages ("walks, then waves") the last is held; ``timeline`` says when each begins.

        Returns:
            The first frame that it has an effect on: that of the next segment to enter the sampler.

        Raises:
            InputError: an empty or absurd prompt.
        """
        timeline = held(text, self._settings.stages)
        start = time.perf_counter()
        for stage in timeline.prompts:
            self._texts.encode([stage])
        with self._lock:
            begins = self._sampler.progress.entered - self._given
            self._timeline = timeline.beginning(begins)
            self._reading += time.perf_counter() - start
            return begins * self.bundle.config.segment

    @property
    def settings(self) -> StreamSettings:
        """How segments are made."""
        return self._settings

    @property
    def timeline(self) -> Timeline:
        """Which segment has which prompt."""
        return self._timeline

    @property
    def seed(self) -> int:
        """What the noise was drawn from."""
        return self._seed

    @property
    @one_thread()
    def warnings(self) -> tuple[str, ...]:
        """What the user should know about the prompts of the timeline, or about the last one given."""
        prompts = tuple(dict.fromkeys(self._timeline.prompts))
        pooled = self._texts.encode(prompts).pooled
        return (*too_long(self.encoder, prompts), *unfamiliar(self.bundle, prompts, pooled))

    def state(self) -> Snapshot:
        """Everything that the next segments depend on, also those that were made ahead of the reader."""
        waiting = [*self._waiting, *(ahead.result() for ahead in self._ahead)]
        with self._lock:
            progress = self._sampler.progress
            numbers = {
                "model": self.bundle.config.name,
                "weights": self._weights(self._settings),
                "settings": dict(vars(self._settings)),
                "seed": self._seed,
                "timeline": dict(vars(self._timeline)),
                "given": self._given,
                "prompts": {str(j): self._prompts[j] for j in progress.active},
                "places": {str(j): self._places[j] for j in progress.active},
                "course": self._denoise.course.state(),
                "sampler": progress.numbers(),
                **self._decoder.state(),
                "waiting": [{k: v for k, v in vars(made).items() if k != "motion"} for made in waiting],
            }
            tensors = {f"sampler.{name}": x for name, x in progress.tensors().items()}
            for k, made in enumerate(waiting):
                tensors |= {f"waiting.{k}.rotations": made.motion.rotations, f"waiting.{k}.root": made.motion.root}
            return Snapshot(numbers, tensors)

    def restore(self, snapshot: Snapshot) -> Self:
        """Go on where the stream whose ``state()`` this is stood, by its settings (but with this one's buffer).

        A state may be restored any number of times.

        Raises:
            InputError: the state of another model.
            FormatError: a state that does not describe a stream; this one is of no use then.
        """
        # Parts of a stream go on with the very lists that they are given.
        snapshot = deepcopy(snapshot)
        numbers, name = snapshot.numbers, self.bundle.config.name
        if numbers.get("model") != name:
            raise InputError(
                f"this is the state of a stream of {numbers.get('model')!r}; open that model, not {name!r}"
            )
        try:
            settings = replace(StreamSettings(**numbers["settings"]), buffer=self._settings.buffer)
            if numbers["weights"] != self._weights(settings):
                raise InputError(f"this state was made with other weights of {name!r}; open the model it was made with")
            line = numbers["timeline"]
            self._begin(settings, None)
            self._seed = numbers["seed"]
            self._timeline = Timeline(**{**line, "prompts": tuple(line["prompts"]), "starts": tuple(line["starts"])})
            found = {k.removeprefix("sampler."): x for k, x in snapshot.tensors.items() if k.startswith("sampler.")}
            found = {k: x.to(self.device) for k, x in found.items()}
            self._go_on(StreamState.restore(numbers["sampler"], found), int(numbers["given"]))
            self._prompts |= {int(segment): prompt for segment, prompt in numbers["prompts"].items()}
            places = numbers.get("places", {})  # states from before streams were told have none, or no third number
            for segment, prompt in self._prompts.items():
                place = (*places.get(str(segment), (UNKNOWN, UNKNOWN)), 0)[:3]
                self._places[segment] = place
                self._denoise.enter(segment, prompt, place)
            if "course" in numbers:
                self._denoise.course.restored(numbers["course"])
            self._decoder.restore(numbers)
            for k, made in enumerate(numbers["waiting"]):
                turned, root = (snapshot.tensors[f"waiting.{k}.{part}"] for part in ("rotations", "root"))
                motion = Motion(turned, root, self.codec.fps, self.codec.skeleton)
                self._waiting.append(Segment(motion=motion, **made))
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise FormatError(f"this state does not describe a stream: {error}") from error
        return self

    def save_state(self, path: str | Path) -> Path:
        """Write ``state()`` to a file.

        Raises:
            InputError: a path that cannot be written to.
        """
        return self.state().save(path)

    def load_state(self, path: str | Path) -> Self:
        """``restore`` from a file.

        Raises:
            InputError: a file that cannot be read, or the state of another model.
            FormatError: a damaged file.
        """
        return self.restore(Snapshot.load(path))

    @one_thread()
    def _begin(self, settings: StreamSettings, seed: SeedMotion | None) -> None:
        """Everything anew, by these settings."""
        config = self.bundle.config
        if (pool := getattr(self, "_pool", None)) is not None:
            # What it still has to make would be taken from the stream that begins here.
            pool.shutdown(cancel_futures=True)
        self._settings = settings
        self._reading = 0.0
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(1) if settings.buffer else None
        self._ahead: deque[Future[Segment]] = deque()
        self._waiting: deque[Segment] = deque()
        self._network = self.bundle.module(settings.network, self.device)
        # Networks that were trained on other than white noise say so.
        self._colour: Callable[[Tensor], Tensor] | None = getattr(self._network, "colour", None)
        flow = self.bundle.module(FLOW, self.device) if self._uses_flow(settings) else None
        self._transport = Transport(cast(CouplingFlow | None, flow), max(config.depth_cap, 1))
        self._warm_up()
        self._fresh()
        if seed is not None:
            self._decoder.go_on_from(seed.features, seed.heading, seed.x, seed.z)
            left = (seed.features.to(self.device) - self._mean) / self._std
            self._go_on(seed.state(left[None], settings, self._seed, config, self._colour), 1)

    def _fresh(self) -> None:
        self._decoder = self._settings.decoder(self.bundle.config, self.codec)
        self._go_on(None, 0)

    def _go_on(self, state: StreamState | None, given: int) -> None:
        """A sampler from this state on, of which the first ``given`` segments are none of the stream's own."""
        config, settings = self.bundle.config, self._settings
        self._given, self._told = given, 0
        self._prompts: dict[int, str] = {}
        self._places: dict[int, tuple[int, int, int]] = {}
        self._denoise = SegmentDenoise(
            self._network,
            guided=bool(config.models[settings.network].config.get("guided")),
            guidance=settings.guidance,
            texts=self._texts,
            clean_left=settings.clean_left,
            seeded=given > 0,
            course=Course(self.codec.groups["root_yaw"], self._mean, self._std, settings.steps),
            device=self.device,
        )
        plan = Settings(solver=settings.solver(config, self._network), staircase=settings.staircase())
        self._sampler = Stream(
            self._denoise, self._transport, plan, (self._seed,), (config.segment, self.codec.dim), self._enter, state,
            self.device,
        )  # fmt: skip

    def _warm_up(self) -> None:
        """A few segments of one step that nobody sees: first calls of a network take many times as long as others."""
        settings, timeline = self._settings, self._timeline
        self._settings = replace(settings, steps=1, start=1, lag=1, past_lag=None)
        self._timeline = held(self.bundle.config.idle)
        self._fresh()
        for _ in range(_WARM_UP):
            self._make()
        self._settings, self._timeline = settings, timeline

    @one_thread()
    def _make(self) -> Segment:
        """The next segment."""
        with self._lock:
            start = time.perf_counter()
            with torch.inference_mode():
                features = next(self._sampler)[0] * self._std + self._mean
            # Outside, so that what users get are ordinary tensors.
            features = features.cpu().clone()
            finished = self._sampler.progress.finished - 1
            motion = self._decoder(features)
            self._denoise.leave(finished)
            self._places.pop(finished)
            number, frames = finished - self._given, len(features)
            evaluations, self._told = self._denoise.evaluations - self._told, self._denoise.evaluations
            spent, self._reading = time.perf_counter() - start + self._reading, 0.0
            return Segment(
                number, number * frames, frames, self._prompts.pop(finished), motion, round(spent * 1e3, 3), evaluations
            )

    def _enter(self, segment: int) -> Tensor | None:
        """Called by the sampler when a segment enters: its prompt, which stays."""
        line, number = self._timeline, segment - self._given
        prompt = self._prompts[segment] = line.at(number)
        place = self._places[segment] = (*line.place(number), line.behind(number))
        pooled = self._denoise.enter(segment, prompt, place)
        return None if self._transport.flow is None else pooled

    def _weights(self, settings: StreamSettings) -> dict[str, Any]:
        """The sha256 of the networks that make segments, and what else of the model they depend on."""
        names = (settings.network, FLOW) if self._uses_flow(settings) else (settings.network,)
        found: dict[str, Any] = {name: self.bundle.files[f"{name}.safetensors"][0] for name in names}
        travelling = self.bundle.config.travelling
        found |= {} if travelling == 1.0 else {"travelling": travelling}  # states of models from before have none
        return found | {"symmetric": settings.network in self.bundle.config.symmetric}

    def _uses_flow(self, settings: StreamSettings) -> bool:
        return self.bundle.config.flows(settings.network)


def _reopened(
    bundle: StreamBundle, request: StreamRequest, device: torch.device, encoder: TextEncoder, state: Snapshot
) -> MotionStream:
    """The stream of a pickle."""
    return MotionStream(bundle, request, device=device, encoder=encoder).restore(state)
