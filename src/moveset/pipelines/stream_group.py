"""``StreamGroup``: several streams of one model by the same settings, advanced by one batched call of the network.

A lane is what one stream remembers between two segments; it may join, leave, be copied and go back at any segment.
Noise is keyed by seed, segment and step, and rows never see each other, so a lane gives what ``MotionStream`` gives
alone with the same seed and prompts, to float tolerance.

Shapes: B lanes, n frames of a segment, D features.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import torch
from torch import Tensor

from moveset.data.captions import mirror_text
from moveset.diffusion.guidance import cfg
from moveset.errors import InputError
from moveset.models.flow import CouplingFlow
from moveset.models.segment_transformer import told_of
from moveset.models.symmetric import Symmetric
from moveset.motion.clip import Motion
from moveset.motion.stream_decoder import StreamDecoder
from moveset.pipelines.course import Course
from moveset.pipelines.device import one_thread, pick_device
from moveset.pipelines.segment import Segment
from moveset.pipelines.segment_denoise import Reader
from moveset.pipelines.stream_bundle import FLOW, StreamBundle
from moveset.pipelines.stream_settings import StreamSettings, Timeline, held
from moveset.pipelines.warnings import too_long, unfamiliar
from moveset.rdm.sequential import Past, sample_segment
from moveset.rdm.transport import Transport
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEmbedding, TextEncoder, get_text_encoder, stack


@dataclass(frozen=True, eq=False)
class Piece:
    """A segment, and which feet it has planted by the model's own account.

    Args:
        segment: as ``MotionStream`` gives it; its latency is that of the whole batch.
        planted: (n, 4) bool left ankle, left toe, right ankle, right toe.
    """

    segment: Segment
    planted: Tensor


@dataclass(eq=False)
class Lane:
    """One stream between two segments. Made by ``StreamGroup.open``; fits every group of the same model.

    Attributes:
        seed: what its noise is drawn from.
        guidance: scale w.
        line: what it is told when, counted from segment ``since`` on.
        prompt: what the next segment is told.
        text: the same, encoded.
        mirrored: what it says of the mirror image, encoded, where the network is symmetric.
        number: of the next segment.
        left: (1, n, D) the last finished segment, normalised.
        left_pooled: (1, C) the sentence embedding of what it was told.
        turned: radians by which its way has turned since its sentence began.
        reading_ms: what encoding took since the last segment.
    """

    seed: int
    guidance: float
    line: Timeline
    prompt: str
    text: TextEmbedding
    decoder: StreamDecoder
    since: int = 0
    number: int = 0
    left: Tensor | None = None
    left_pooled: Tensor | None = None
    turned: float = 0.0
    mirrored: TextEmbedding | None = None
    reading_ms: float = 0.0

    @property
    def behind(self) -> int:
        """Segments before the next one that are told the same sentence."""
        return self.line.behind(self.number - self.since)

    def copy(self) -> "Lane":
        """An independent copy, to go back to."""
        return replace(self, decoder=self.decoder.copy())

    def back_at(self, earlier: "Lane") -> "Lane":
        """A copy of ``earlier`` that is told from there on what this lane is told."""
        place = earlier.copy()
        place.line, place.since, place.guidance = self.line, earlier.number, self.guidance
        place.prompt, place.text, place.mirrored = self.prompt, self.text, self.mirrored
        place.reading_ms = self.reading_ms
        return place


class StreamGroup:
    """Makes segments of lanes.

    Args:
        bundle: the model.
        settings: how segments are made; ``guidance`` is the default of its lanes.
        device: where to compute.
        encoder: the model's text encoder, if it is there already.

    Raises:
        InputError: settings by which several segments of a stream are in work at once.
        FormatError: a damaged model.
    """

    @one_thread()
    def __init__(
        self,
        bundle: StreamBundle,
        settings: StreamSettings,
        *,
        device: torch.device | str = "auto",
        encoder: TextEncoder | None = None,
    ) -> None:
        config = bundle.config
        if not (settings.one_by_one and settings.start == settings.steps):
            raise InputError(
                f"network {settings.network!r} works on several segments of a stream at once (lag {settings.lag} of "
                f"{settings.steps} steps); streams are grouped where a segment follows a finished one: set start and "
                "lag to the steps, or use a student"
            )
        self.bundle, self.settings = bundle, settings
        self.codec, self.device = config.feature_codec(), pick_device(str(device))
        self.encoder = encoder or get_text_encoder(config.text_encoder, device=self.device)
        self._texts = CachedEncoder(self.encoder)
        self._mean, self._std = (bundle.normalizer[name].to(self.device) for name in ("feature_mean", "feature_std"))
        self._network = bundle.module(settings.network, self.device)
        self._even = isinstance(self._network, Symmetric)
        self._guided = bool(config.models[settings.network].config.get("guided"))
        flow = cast(CouplingFlow, bundle.module(FLOW, self.device)) if config.flows(settings.network) else None
        self._transport = Transport(flow, max(config.depth_cap, 1))
        self._solver = settings.solver(config, self._network)
        self._shape = (config.segment, self.codec.dim)
        self._course = Course(self.codec.groups["root_yaw"], self._mean, self._std, window=1)

    @one_thread()
    def open(self, prompt: str, seed: int, guidance: float | None = None) -> Lane:
        """A stream at its beginning.

        Raises:
            InputError: an empty or absurd prompt.
        """
        line = held(prompt, self.settings.stages)
        start = time.perf_counter()
        text = self._texts.encode([line.prompts[0]]).to(self.device)
        return Lane(
            seed,
            self.settings.guidance if guidance is None else guidance,
            line,
            line.prompts[0],
            text,
            self.settings.decoder(self.bundle.config, self.codec),
            reading_ms=(time.perf_counter() - start) * 1e3,
        )

    @one_thread()
    def prompt(self, lane: Lane, text: str) -> int:
        """Go on with another prompt.

        Returns:
            The first frame that it has an effect on: that of the next segment.

        Raises:
            InputError: an empty or absurd prompt; the lane is as it was.
        """
        lane.line, lane.since = held(text, self.settings.stages), lane.number
        self._read(lane)
        return lane.number * self.bundle.config.segment

    @one_thread()
    def warnings(self, lane: Lane) -> tuple[str, ...]:
        """What the user should know about a lane's prompt."""
        prompts = tuple(dict.fromkeys(lane.line.prompts))
        pooled = self._texts.encode(prompts).pooled
        return (*too_long(self.encoder, prompts), *unfamiliar(self.bundle, prompts, pooled))

    @one_thread()
    def advance(self, lanes: Sequence[Lane]) -> list[Piece]:
        """The next segment of every lane."""
        for lane in lanes:
            self._read(lane)
        start = time.perf_counter()
        with torch.inference_mode():
            clean = self._sample(lanes)
            features = clean * self._std + self._mean
        # Outside, so that what users get are ordinary tensors.
        features = features.cpu().clone()
        decoded = [(lane.decoder(x), lane.decoder.planted(x)) for lane, x in zip(lanes, features, strict=True)]
        spent = (time.perf_counter() - start) * 1e3
        return [self._piece(*row, spent) for row in zip(lanes, clean, decoded, strict=True)]

    def _read(self, lane: Lane) -> None:
        """What the lane's next segment is told."""
        prompt = lane.line.at(lane.number - lane.since)
        if prompt != lane.prompt or (self._even and lane.mirrored is None):
            start = time.perf_counter()
            lane.text, lane.prompt = self._texts.encode([prompt]).to(self.device), prompt
            lane.mirrored = self._texts.encode([mirror_text(prompt)]).to(self.device) if self._even else None
            lane.reading_ms += (time.perf_counter() - start) * 1e3

    def _piece(self, lane: Lane, clean: Tensor, decoded: tuple[Motion, Tensor], spent: float) -> Piece:
        motion, planted = decoded
        number, frames = lane.number, len(motion)
        twice = self._even or (lane.guidance and not self._guided)
        evaluations = self.settings.steps * (2 if twice else 1)
        latency = round(spent + lane.reading_ms, 3)
        lane.left, lane.left_pooled = clean[None].clone(), lane.text.pooled
        lane.turned = float(self._course.turn(clean[None])) + (lane.turned if lane.behind else 0.0)
        lane.number, lane.reading_ms = number + 1, 0.0
        return Piece(Segment(number, number * frames, frames, lane.prompt, motion, latency, evaluations), planted)

    def _sample(self, lanes: Sequence[Lane]) -> Tensor:
        """Clean segments (B, n, D), normalised."""
        numbers, seeds = [lane.number for lane in lanes], [lane.seed for lane in lanes]
        text = lanes[0].text if len(lanes) == 1 else stack([lane.text for lane in lanes])
        denoise = self._denoiser(lanes, text, torch.tensor(numbers, device=self.device))
        # Lanes at their beginning have no past, which stays clean.
        begun_B = torch.tensor([lane.left is not None for lane in lanes], device=self.device)
        zeros = torch.zeros(1, *self._shape, device=self.device)
        left_BnD = torch.cat([zeros if lane.left is None else lane.left for lane in lanes])
        pooled_BC = torch.cat([lane.text.pooled if lane.left_pooled is None else lane.left_pooled for lane in lanes])
        past = Past(left_BnD, seeds, [max(number - 1, 0) for number in numbers], pooled_BC, begun_B)
        return sample_segment(denoise, self._solver, seeds, numbers, past, self._transport, text.pooled)

    def _denoiser(
        self, lanes: Sequence[Lane], text: TextEmbedding, index_B: Tensor
    ) -> Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]:
        """The network with everything bound but the noisy segments, those before them, and the levels of both."""
        w_B = torch.tensor([lane.guidance for lane in lanes], device=self.device)
        twice = not self._guided and bool(w_B.any())
        scale_B = w_B if self._guided else None
        if self._even:
            text = stack([text, *(lane.mirrored for lane in lanes if lane.mirrored is not None)])
        if twice:
            text = stack([text, *[self._texts.encode([""]).to(self.device)] * len(lanes)])
            index_B = index_B.repeat(2)
        network, times = self._network, 2 if twice else 1
        places = [lane.line.place(lane.number - lane.since) for lane in lanes] * times
        turned_B = torch.tensor([lane.turned if lane.behind else 0.0 for lane in lanes] * times, device=self.device)
        told = told_of(network, torch.tensor(places, device=self.device) * float(self._shape[0]), turned_B)
        context: object = None  # text and past, read once if they stay the same

        def denoise(x_BnD: Tensor, t_B: Tensor, left_BnD: Tensor, left_t_B: Tensor) -> Tensor:
            nonlocal context
            if twice:
                x_BnD, left_BnD = x_BnD.repeat(2, 1, 1), left_BnD.repeat(2, 1, 1)
                t_B, left_t_B = t_B.repeat(2), left_t_B.repeat(2)
            if isinstance(network, Reader):
                if context is None or not self.settings.clean_left:
                    context = network.read(text.tokens, text.mask, left_BnD, left_t_B, index_B, **told)
                made = network.denoise(x_BnD, t_B, context, scale_B)
            else:
                made = network(x_BnD, t_B, left_BnD, left_t_B, index_B, text.tokens, text.mask, scale_B, **told)
            return cfg(*made.chunk(2), w_B) if twice else made

        return denoise
