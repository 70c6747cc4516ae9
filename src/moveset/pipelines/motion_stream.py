"""``MotionStream``: motion without end, a segment at a time, told by a prompt that may change at any moment.

A prompt belongs to a segment from the moment that segment enters the sampler; a new one takes effect with the next to
enter. Memory is constant: what is held are the segments in work, one finished one, and a few encoded prompts.

Shapes: n frames of a segment, D features; in the sampler always one item.
"""

import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import torch

from moveset.diffusion.steps import Variance
from moveset.errors import FormatError, InputError
from moveset.motion.clip import Motion
from moveset.pipelines.device import pick_device
from moveset.pipelines.initial_motion import InitialMotion
from moveset.pipelines.model_config import DEFAULT_STREAM, FLOW, StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.overlapping import Overlapping
from moveset.pipelines.stream_batch import OneByOne, Segment, StreamBatch, StreamModel
from moveset.pipelines.stream_settings import (
    BLEND_SECONDS,
    StreamRequest,
    StreamSettings,
    check_stream,
)
from moveset.pipelines.stream_state import Snapshot
from moveset.pipelines.timeline import Timeline
from moveset.rdm.state import StreamState
from moveset.text.encoder import TextEncoder, get_text_encoder

_WARM_UP = 3  # segments made and thrown away before the first
_TENSORS = ("motion", "planted")  # of a segment


class MotionStream(Iterator[Segment]):
    """An endless motion; an iterator of its segments.

    >>> from moveset import MotionStream
    >>> stream = MotionStream.from_pretrained(prompt="a person walks forward", seed=7)  # doctest: +SKIP
    >>> first = next(stream).motion  # doctest: +SKIP
    >>> stream.prompt("a person waves with the left hand")  # doctest: +SKIP
    28

    Args:
        request: what happens, from which seed, by which settings: ``check_stream``.
        seed_motion: a clip that the stream goes on from, of at least one segment; it is retargeted and resampled.
        encoder: the model's text encoder, if it is there already.

    Raises:
        InputError: no such device, or a seed motion that cannot be used.
        FormatError: a damaged model.
    """

    def __init__(
        self,
        bundle: ModelFolder[StreamConfig],
        request: StreamRequest,
        *,
        seed_motion: Motion | None = None,
        device: torch.device | str = "auto",
        encoder: TextEncoder | None = None,
    ) -> None:
        self.bundle, self.codec, self.device = bundle, bundle.config.feature_codec(), pick_device(str(device))
        self.encoder = encoder or get_text_encoder(bundle.config.text_encoder, device=self.device)
        if seed_motion is not None and not isinstance(seed_motion, Motion):
            raise InputError(f"a stream goes on from a Motion, not from {seed_motion!r}; read a file by moveset.load")
        self._open(request.settings, request.timeline, request.seed)
        if seed_motion is not None:
            given = InitialMotion.of(seed_motion, self.codec, bundle.config.segment)
            self._stream.decoder.go_on_from(given.features, given.heading, given.x, given.z)
            left_1nD = ((given.features.to(self.device) - self._model.mean) / self._model.std)[None]
            solver, plan = self._model.solver, request.settings.staircase()
            self._go_on({"prompts": {}}, given.state(left_1nD, solver, plan, request.seed), 1)

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
        variance: Variance | None = None,
        eps_scale: float | None = None,
        time_shift: float | None = None,
        guidance: float | None = None,
        buffer: int = 0,
        foot_lock: bool = True,
        blend_seconds: float = BLEND_SECONDS,
        stages: bool = True,
        device: torch.device | str = "auto",
    ) -> "MotionStream":
        """A stream of a shipped model by name, or of a model folder.

        Args:
            seed_motion: a clip that the stream goes on from.
            others: ``stream_settings.check_stream``.

        Raises:
            InputError: no such model, or anything out of range.
            FormatError: a damaged model folder.
        """
        bundle = ModelFolder.open(name_or_path, StreamConfig)
        request = check_stream(
            bundle.config, prompt, seconds, loop=loop, seed=seed, network=network, steps=steps, start=start, lag=lag,
            past_lag=past_lag, eta=eta, variance=variance, eps_scale=eps_scale, time_shift=time_shift,
            guidance=guidance, buffer=buffer, foot_lock=foot_lock, blend_seconds=blend_seconds, stages=stages,
        )  # fmt: skip
        return cls(bundle, request, seed_motion=seed_motion, device=device)

    def __reduce__(self) -> tuple[Any, ...]:
        # A pickle, or a copy, goes on where this one stands; the model's folder is read again.
        request = StreamRequest(self.timeline, self.seed, self._settings, (), ())
        return _reopened, (self.bundle, request, self.device, self.encoder, self.state())

    def __next__(self) -> Segment:
        if self._pool is None:
            return self._waiting.popleft() if self._waiting else self._make()
        # One segment more than the buffer holds: the one that is about to be taken.
        while len(self._ahead) + len(self._waiting) <= self.settings.buffer:
            self._ahead.append(self._pool.submit(self._make))
        if self._waiting:
            return self._waiting.popleft()
        wait([self._ahead[0]])  # whoever is interrupted here finds the segment still at its place
        return self._ahead.popleft().result()

    def prompt(self, text: str) -> int:
        """Go on with another prompt, until the next call; what was left of a timeline is dropped.

        Of a sentence with several stages ("walks, then waves") the last is held; ``timeline`` says when each begins.

        Returns:
            The first frame that it has an effect on: that of the next segment to enter the sampler.

        Raises:
            InputError: an empty or absurd prompt.
        """
        with self._lock:
            return self._model.prompt(self._stream, text, self._maker.entered - self._stream.given)

    @property
    def settings(self) -> StreamSettings:
        """How segments are made."""
        return self._settings

    @property
    def timeline(self) -> Timeline:
        """Which segment has which prompt."""
        return self._stream.line

    @property
    def seed(self) -> int:
        """What the noise was drawn from."""
        return self._stream.seed

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know about the prompts of the timeline, or about the last one given."""
        return self._model.warnings(self._stream)

    def state(self) -> Snapshot:
        """Everything that the next segments depend on, also those that were made ahead of the reader."""
        waiting = [*self._waiting, *(ahead.result() for ahead in self._ahead)]
        with self._lock:
            stream, (own, progress) = self._stream, self._maker.state()
            numbers = {
                "model": self.bundle.config.name,
                "weights": self._weights(self._settings),
                "settings": dict(vars(self._settings)),
                "seed": stream.seed,
                "timeline": dict(vars(stream.line)),
                "given": stream.given,
                **own,
                "sampler": progress.numbers(),
                **stream.decoder.state(),
                "waiting": [{k: v for k, v in vars(made).items() if k not in _TENSORS} for made in waiting],
            }
            tensors = {f"sampler.{name}": x for name, x in progress.tensors().items()}
            for k, made in enumerate(waiting):
                tensors |= {f"waiting.{k}.rotations": made.motion.rotations, f"waiting.{k}.root": made.motion.root}
                tensors[f"waiting.{k}.planted"] = made.planted
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
            line = Timeline(**{**line, "prompts": tuple(line["prompts"]), "starts": tuple(line["starts"])})
            self._open(settings, line, numbers["seed"])
            found = {k.removeprefix("sampler."): x for k, x in snapshot.tensors.items() if k.startswith("sampler.")}
            found = {k: x.to(self.device) for k, x in found.items()}
            self._go_on(numbers, StreamState.restore(numbers["sampler"], found), int(numbers["given"]))
            self._stream.decoder.restore(numbers)
            for k, made in enumerate(numbers["waiting"]):
                turned, root = (snapshot.tensors[f"waiting.{k}.{part}"] for part in ("rotations", "root"))
                motion = Motion(turned, root, self.codec.fps, self.codec.skeleton)
                planted = snapshot.tensors[f"waiting.{k}.planted"]
                self._waiting.append(Segment(motion=motion, planted=planted, **made))
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

    def _open(self, settings: StreamSettings, line: Timeline, seed: int) -> None:
        """Everything anew, by these settings."""
        if (pool := getattr(self, "_pool", None)) is not None:
            # What it still has to make would be taken from the stream that begins here.
            pool.shutdown(cancel_futures=True)
        self._settings = settings
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(1) if settings.buffer else None
        self._ahead: deque[Future[Segment]] = deque()
        self._waiting: deque[Segment] = deque()
        self._warm_up(settings)
        kind = StreamBatch if settings.sequential else StreamModel
        model = self._model = kind(self.bundle, settings, device=self.device, encoder=self.encoder)
        stream = self._stream = model.open(line, seed)
        self._maker = OneByOne(model, stream) if isinstance(model, StreamBatch) else Overlapping(model, [stream])

    def _warm_up(self, settings: StreamSettings) -> None:
        """A few segments of one step that nobody sees: first calls of a network take many times as long as others."""
        settings = replace(settings, steps=1, start=1, lag=1, past_lag=None)
        batch = StreamBatch(self.bundle, settings, device=self.device, encoder=self.encoder)
        stream = batch.open(self.bundle.config.idle, 0)
        for _ in range(_WARM_UP):
            batch.step([stream])

    def _go_on(self, numbers: Mapping[str, Any], state: StreamState, given: int) -> None:
        """From this state of a sampler on, of which the first ``given`` segments are none of the stream's own."""
        self._stream.given, self._stream.number = given, state.finished
        self._maker.go_on(numbers, state)

    def _make(self) -> Segment:
        with self._lock:
            [made] = self._maker.step()
            return made

    def _weights(self, settings: StreamSettings) -> dict[str, Any]:
        """The sha256 of the networks that make segments, and what else of the model they depend on."""
        config = self.bundle.config
        names = (settings.network, FLOW) if config.flows(settings.network) else (settings.network,)
        found: dict[str, Any] = {name: self.bundle.files[f"{name}.safetensors"][0] for name in names}
        return found | {"symmetric": settings.network in config.symmetric}


def _reopened(
    bundle: ModelFolder[StreamConfig],
    request: StreamRequest,
    device: torch.device,
    encoder: TextEncoder,
    state: Snapshot,
) -> MotionStream:
    return MotionStream(bundle, request, device=device, encoder=encoder).restore(state)
