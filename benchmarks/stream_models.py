"""What the benchmarks of recurrent models share: networks from run folders or a model folder, sampled in batches.

B items, N segments, n frames of a segment, D features.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import linear
from moveset.errors import InputError
from moveset.evaluation.generators import Remembered, Wanted
from moveset.evaluation.streams import Bound, timeline
from moveset.motion.clip import Motion
from moveset.motion.features import FeatureCodec, Normalizer, get_codec
from moveset.motion.native import NativeCodec
from moveset.motion.stream_decoder import StreamDecoder
from moveset.pipelines.course import Course
from moveset.pipelines.stream_bundle import FLOW, StreamBundle, StreamConfig
from moveset.rdm.sampler import stream
from moveset.rdm.staircase import Shape, Staircase, levels
from moveset.rdm.transport import Transport
from moveset.text.encoder import get_text_encoder
from moveset.text.familiarity import KnownPrompts
from moveset.training import frozen
from moveset.training.clips import FeatureStore
from moveset.training.pack_stream import RUNS

SCHEDULE = linear()
BLEND_SECONDS = 0.3


@dataclass(frozen=True, kw_only=True)
class Method:
    """How sequences are sampled; ``start`` None is K, ``lag`` 0 is K, ``past_lag`` None tells a finished past clean."""

    network: str = "rdm"
    steps: int = 10
    start: int | None = None
    shape: Shape = "parallelogram"
    lag: int = 0
    past_lag: int | None = None
    eta: float = 0.0
    guidance: float = 0.0
    init_noise: str = "independent"
    entry: str = "copy"

    def staircase(self, segments: int | None) -> Staircase:
        """The plan for so many segments."""
        start = self.steps if self.start is None else self.start
        return Staircase(self.steps, segments, start, self.shape, self.lag or self.steps)

    @property
    def name(self) -> str:
        """A line that says it all."""
        plan = self.staircase(None)
        words = [self.network]
        if not self.network.startswith("pcm-"):
            words += [f"K={plan.steps}", f"R={plan.start}", f"lag={plan.lag}"]
        words += [f"past_lag={self.past_lag}"] if self.past_lag else []
        words += [plan.shape] if plan.shape != "parallelogram" else []
        words += [f"eta={self.eta:g}"] if self.eta else []
        words += [self.init_noise] if self.init_noise != "independent" else []
        words += [self.entry] if self.entry != "copy" else []
        return " ".join([*words, f"w={self.guidance:g}"])


class Networks:
    """Denoisers and the flow by name, from the latest checkpoints of run folders or from a packed model folder.

    Args:
        runs: the folder of all runs; used if there is no model folder.
        model: a stream's model folder.
        folders: run folders of other names than ``training.pack_stream.RUNS``.
    """

    def __init__(self, runs: Path, model: Path | None = None, folders: dict[str, str] | None = None) -> None:
        self._runs, self._folders = runs, RUNS | (folders or {})
        self._bundle = StreamBundle.find(model) if model else None
        self._kept: dict[str, nn.Module] = {}
        self._students: dict[str, frozen.Frozen] = {}
        self.cache = runs / "cache"

    @property
    def guidance(self) -> dict[str, float]:
        """A model's own scales by network; none of runs."""
        return dict(self._bundle.config.guidance) if self._bundle else {}

    @property
    def travelling(self) -> float:
        """How much a model holds the root of whoever goes (``StreamConfig``); all of it for runs."""
        return self._bundle.config.travelling if self._bundle else StreamConfig.travelling

    def has(self, name: str) -> bool:
        """Whether there is such a network."""
        if self._bundle:
            return name in self._bundle.config.models
        if name not in self._folders:
            raise InputError(f"no network {name!r} is known; there are {', '.join(self._folders)}, or give --folder")
        return any((self._runs / self._folders[name]).glob("step_*/manifest.json"))

    def module(self, name: str) -> nn.Module:
        """A denoiser by name, or "flow"."""
        if name not in self._kept:
            self._kept[name] = self._bundle.module(name) if self._bundle else self._load(name)
        return self._kept[name]

    def transport(self, network: str) -> Transport:
        """The flow that a network was trained with; the baseline had none."""
        if network == "md":
            return Transport(None)
        if self._bundle:
            flow = self.module(FLOW) if FLOW in self._bundle.config.models else None
            return Transport(flow, max(self._bundle.config.depth_cap, 1))
        flow = self.module(FLOW) if self._task["flow"] is not None else None
        return Transport(flow, self._task["depth_cap"])

    def levels(self, method: Method) -> tuple[int, ...]:
        """K + 1 falling noise levels: a student's are the edges of its phases."""
        if method.network.startswith("pcm-"):
            points = self._bundle.config.points if self._bundle else self._student(method.network).task["points"]
            return PhaseGrid(points, method.steps).edges[::-1]
        return levels(method.steps)

    @cached_property
    def _task(self) -> dict:
        return frozen.load(self._runs / self._folders["rdm"], "denoiser_ema").task

    def _load(self, name: str) -> nn.Module:
        if name == FLOW:
            return frozen.load(self._runs / self._folders["rdm"], "flow_ema", part="coupling_flow").module
        if name.startswith("pcm-"):
            found = self._student(name)
        else:
            found = frozen.load(self._runs / self._folders[name], "denoiser_ema")
        print(name, "from", found.path, flush=True)
        return found.module

    def _student(self, name: str) -> frozen.Frozen:
        if name not in self._students:
            self._students[name] = frozen.load(self._runs / self._folders[name], "student_ema")
        return self._students[name]

    @cached_property
    def text(self) -> Remembered:
        """The encoder of all of them."""
        name = self._bundle.config.text_encoder if self._bundle else self._task["text_encoder"]
        return Remembered(get_text_encoder(name))

    @property
    def captions(self) -> KnownPrompts | None:
        """What a packed model was trained on."""
        return self._bundle.captions if self._bundle else None

    @cached_property
    def codec(self) -> FeatureCodec:
        """What the features mean."""
        return get_codec(self._bundle.config.codec if self._bundle else self._task["codec"])

    @cached_property
    def frames(self) -> int:
        """n."""
        return self._bundle.config.segment if self._bundle else self._task["grid"]["frames"]

    @cached_property
    def store(self) -> FeatureStore:
        """Features of the corpus, normalised as the networks expect them."""
        return FeatureStore(self.cache / f"features-{self.codec.name}")

    @cached_property
    def normalizer(self) -> Normalizer:
        """Of the features."""
        if self._bundle:
            stored = self._bundle.normalizer
            return Normalizer(stored["feature_mean"], stored["feature_std"])
        return self.store.normalizer


def segments_of(
    networks: Networks,
    method: Method,
    said: Sequence[Wanted],
    segments: int | None,
    half: bool = False,
) -> Iterator[Tensor]:
    """Segments (B, n, D), normalised, one after the other.

    Args:
        said: each item's sentences with their frames, and its seed; what is held has more frames than a network can be
            told of. Sentences are said whole.
        segments: N, or None for a stream without end.
        half: evaluate the network in bfloat16.
    """
    module, plan = networks.module(method.network), method.staircase(segments)
    n, fps, normalizer = networks.frames, networks.codec.fps, networks.normalizer
    assert isinstance(networks.codec, NativeCodec)
    bound = Bound(
        module, networks.text, [timeline(one, fps, n / fps, stages=False) for one in said],
        guided=bool(getattr(module.config, "guided", False)), guidance=method.guidance,
        once=plan.lag == plan.steps and method.past_lag is None,
        course=Course(networks.codec.groups["root_yaw"], normalizer.mean, normalizer.std, plan.steps),
        device=torch.device("cpu"),
    )  # fmt: skip

    def denoiser(*given: Any) -> Tensor:
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            return bound(*given).float()

    return stream(
        denoiser, networks.transport(method.network), SCHEDULE, networks.levels(method), plan,
        [one.seed for one in said], (n, networks.codec.dim), bound.pooled, eta=method.eta,
        init_noise=method.init_noise, entry=method.entry, past_lag=method.past_lag,
        colour=getattr(module, "colour", None),
    )  # fmt: skip


def sample_all(
    networks: Networks, method: Method, wanted: Sequence[tuple[str, int]], half: bool = False, rows: int = 96
) -> list[Tensor]:
    """Normalised features (F, D) for every (sentence, frames), in their order; item k has seed k.

    Items of the same number of segments are one batch, of at most about ``rows`` rows a wave.
    """
    n = networks.frames
    by_count: dict[int, list[int]] = {}
    for k, (_, frames) in enumerate(wanted):
        by_count.setdefault(math.ceil(frames / n), []).append(k)
    out: list[Tensor] = [torch.empty(0)] * len(wanted)
    for count, items in sorted(by_count.items()):
        widest = max(len(cells) for cells in method.staircase(count).wavefront())
        size = max(1, rows // widest)
        for k in range(0, len(items), size):
            part = items[k : k + size]
            said = [Wanted((wanted[k],), seed=k) for k in part]
            made = list(islice(segments_of(networks, method, said, count, half), count))
            sequences = torch.cat(made, dim=1)
            for row, item in enumerate(part):
                out[item] = sequences[row, : wanted[item][1]].clone()
    return out


def raw_motion(networks: Networks, features: Tensor) -> Motion:
    """The motion of normalised features (F, D), as it is, float64: a rollout gets far from where it began."""
    return networks.codec.decode(networks.normalizer.denormalize(features.double()))


def finished_motion(networks: Networks, features: Tensor, blend_seconds: float = BLEND_SECONDS) -> Motion:
    """The motion as a stream gives it out, float64: seams smoothed, feet locked, piece by piece."""
    codec = networks.codec
    assert isinstance(codec, NativeCodec)
    decoder = StreamDecoder(codec, blend_seconds, travelling=networks.travelling)
    return decoder.whole(networks.normalizer.denormalize(features), networks.frames)
