"""What the benchmarks of recurrent models share: networks from run folders or a model folder, sampled in batches.

B items, N segments, n frames of a segment, D features, L text tokens, C text width. The rows of a batch are grouped by
segment, as ``rdm.sampler`` has them: every item's row of the oldest segment first.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

import torch
from torch import Tensor, nn

from moveset.data.captions import mirror_text
from moveset.diffusion.guidance import cfg
from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import linear
from moveset.errors import InputError
from moveset.models.symmetric import Symmetric
from moveset.motion.clip import Motion
from moveset.motion.contacts import PLANTED
from moveset.motion.features import FeatureCodec, Normalizer, get_codec
from moveset.motion.foot_lock import FootLock
from moveset.motion.hold_root import hold_root
from moveset.motion.incremental import IncrementalDecoder
from moveset.motion.native import NativeCodec
from moveset.pipelines.stream_bundle import FLOW, StreamBundle
from moveset.rdm.sampler import Denoiser, stream
from moveset.rdm.staircase import Shape, Staircase, levels
from moveset.rdm.transport import Transport
from moveset.text.encoder import TextEmbedding, get_text_encoder, stack
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


class TextBank:
    """Sentences encoded once."""

    def __init__(self, encoder: str) -> None:
        self._encoder, self._known = get_text_encoder(encoder), {}

    def __call__(self, sentences: Sequence[str]) -> TextEmbedding:
        """Embeddings (B, L, C), padded to the longest of these."""
        new = sorted({s for s in sentences if s not in self._known}, key=len)
        for k in range(0, len(new), 64):
            coded = self._encoder.encode(new[k : k + 64])
            for row, sentence in enumerate(new[k : k + 64]):
                count = int(coded.mask[row].sum())
                one = coded[row : row + 1]
                self._known[sentence] = TextEmbedding(one.tokens[:, :count], one.mask[:, :count], one.pooled)
        return stack([self._known[s] for s in sentences])


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
        self.cache = runs / "cache"

    @property
    def guidance(self) -> dict[str, float]:
        """A model's own scales by network; none of runs."""
        return dict(self._bundle.config.guidance) if self._bundle else {}

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
            points = self._bundle.config.points if self._bundle else 10
            return PhaseGrid(points, method.steps).edges[::-1]
        return levels(method.steps)

    @cached_property
    def _task(self) -> dict:
        return frozen.load(self._runs / self._folders["rdm"], "denoiser_ema").task

    def _load(self, name: str) -> nn.Module:
        if name == FLOW:
            return frozen.load(self._runs / self._folders["rdm"], "flow_ema", part="coupling_flow").module
        kind = "student_ema" if name.startswith("pcm-") else "denoiser_ema"
        found = frozen.load(self._runs / self._folders[name], kind)
        print(name, "from", found.path, flush=True)
        return found.module

    @cached_property
    def text(self) -> TextBank:
        """The encoder of all of them."""
        return TextBank(self._bundle.config.text_encoder if self._bundle else self._task["text_encoder"])

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


class Bound:
    """A denoiser with every item's prompt of every segment bound to it, for ``rdm.sampler``; counts row evaluations.

    Args:
        prompts: by segment, the sentence of each item.
        clean_left: every segment is told its finished predecessor: text and predecessor are read once.
        half: evaluate the network in bfloat16.
    """

    def __init__(
        self,
        module: nn.Module,
        text: TextBank,
        prompts: Callable[[int], Sequence[str]],
        guidance: float,
        clean_left: bool,
        half: bool,
    ) -> None:
        self._module, self._text, self._prompts, self._w = module, text, prompts, guidance
        self._guided = bool(getattr(module.config, "guided", False))
        self._twice = bool(guidance) and not self._guided
        self._even = isinstance(module, Symmetric)
        self._once = clean_left and hasattr(module, "read")
        self._half, self.evaluations = half, 0
        self._read: tuple[tuple[int, ...], TextEmbedding] | None = None
        self._context: tuple[int, object] | None = None

    def pooled(self, segment: int) -> Tensor:
        """(B, C) sentence embeddings of a segment's prompts."""
        return self._text(self._prompts(segment)).pooled

    def __call__(
        self, x: Tensor, t: Tensor, prev: Tensor, prev_t: Tensor, index: Tensor, segments: Sequence[int]
    ) -> Tensor:
        """Clean segments (B, n, D)."""
        text = self._words(tuple(dict.fromkeys(segments)))
        self.evaluations += len(text)
        if self._twice:
            x, prev = (z.repeat(2, 1, 1) for z in (x, prev))
            t, prev_t, index = (z.repeat(2) for z in (t, prev_t, index))
        w = torch.full((len(x),), self._w) if self._guided else None
        with torch.autocast("cpu", torch.bfloat16, enabled=self._half):
            if self._once:
                if self._context is None or self._context[0] != segments[0]:
                    read = self._module.read(text.tokens, text.mask, prev, prev_t, index)
                    self._context = (segments[0], read)
                made = self._module.denoise(x, t, self._context[1], w)
            else:
                made = self._module(x, t, prev, prev_t, index, text.tokens, text.mask, w)
        return cfg(*made.float().chunk(2), self._w) if self._twice else made.float()

    def _words(self, order: tuple[int, ...]) -> TextEmbedding:
        """Of the rows of these segments; below them the empty text for guidance, or what mirror images are told."""
        if self._read is None or self._read[0] != order:
            said = [sentence for segment in order for sentence in self._prompts(segment)]
            below = [""] * len(said) if self._twice else [mirror_text(line) for line in said] if self._even else []
            self._read = (order, self._text(said + below))
        return self._read[1]


def segments_of(
    networks: Networks,
    method: Method,
    prompts: Callable[[int], Sequence[str]],
    seeds: Sequence[int],
    segments: int | None,
    half: bool = False,
) -> Iterator[Tensor]:
    """Segments (B, n, D), normalised, one after the other.

    Args:
        prompts: by segment, the sentence of each item.
        seeds: one for every item.
        segments: N, or None for a stream without end.
        half: evaluate the network in bfloat16.
    """
    module, plan = networks.module(method.network), method.staircase(segments)
    clean_left = plan.lag == plan.steps and method.past_lag is None
    bound = Bound(module, networks.text, prompts, method.guidance, clean_left, half)
    call: Denoiser = bound
    return stream(
        call, networks.transport(method.network), SCHEDULE, networks.levels(method), plan, seeds,
        (networks.frames, networks.codec.dim), bound.pooled, eta=method.eta, init_noise=method.init_noise,
        entry=method.entry, past_lag=method.past_lag, colour=getattr(module, "colour", None),
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
            said = [wanted[k][0] for k in part]
            made = list(islice(segments_of(networks, method, lambda _, said=said: said, part, count, half), count))
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
    decoder, feet = IncrementalDecoder(codec, blend_seconds), FootLock(codec.skeleton, codec.fps)
    pieces = []
    for piece in networks.normalizer.denormalize(features).split(networks.frames):
        planted = piece[:, codec.groups["contacts"]] > PLANTED
        pieces.append(feet(decoder(hold_root(piece, planted, codec)), planted))
    turned, root = (torch.cat([getattr(p, name) for p in pieces]) for name in ("rotations", "root"))
    return Motion(turned, root, codec.fps, codec.skeleton)
