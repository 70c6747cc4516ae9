"""What ``efficiency.py`` compares: RDM and its baselines at a size, as samplers that count what they do.

Weights are random: what a call costs does not depend on them. Every method runs the library's own sampler; counts come
from the calls that this makes (``efficiency_tally``), and must equal the closed forms of ``expected``.

Shapes: B samples, N segments, K steps, n frames of a segment, D features, L text tokens, C text width.
"""

from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache, cached_property

import torch
from torch import Tensor, nn

from efficiency_tally import Meter, Tally
from moveset.diffusion.guidance import cfg
from moveset.diffusion.schedule import cosine, linear
from moveset.models.condition import Condition, PastSegment
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.flow import CouplingFlow, FlowConfig
from moveset.models.segment_denoiser import SegmentDenoiser, SegmentDenoiserConfig, TextStates
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.rdm.sampler import Denoiser, Settings, Stream
from moveset.rdm.sequential import Solver, rollout_chunks
from moveset.rdm.staircase import Staircase, levels
from moveset.rdm.transport import Transport
from moveset.text.encoder import TextEmbedding

HORIZON = 196
_SCHEDULE = linear()


@dataclass(frozen=True)
class Row:
    """A line of the tables."""

    model: str
    variant: str = ""

    @property
    def frames(self) -> int:
        """Frames of a call: a segment, a chunk, or the whole clip."""
        if self.model == "DiP":
            return 40
        return HORIZON // int(self.model.split("-")[1]) if "-" in self.model else HORIZON

    @property
    def label(self) -> str:
        """As printed."""
        return f"{self.model}, {self.variant}" if self.variant else self.model


TRIANGLE, PARALLELOGRAM, FULL = "triangle R = N", "parallelogram R = ⌈K/3⌉", "full R = K"
UNGUIDED = "without guidance"
ROWS = (
    *(Row(f"RDM-{n}", plan) for n in (4, 7, 14) for plan in (TRIANGLE, PARALLELOGRAM, FULL)),
    *(Row("MD-4"), Row("MD-7"), Row("DiP"), Row("DiP", UNGUIDED), Row("MotionDiffuse")),
)


@dataclass(frozen=True, kw_only=True)
class Size:
    """Networks of one size; ``text`` and ``dip_text`` are (tokens, width) of their text encoders' states."""

    about: str
    segment: Callable[[int], SegmentTransformerConfig | SegmentDenoiserConfig]
    volume: SegmentDenoiserConfig
    dip: DipDecoderConfig
    flow: FlowConfig
    text: tuple[int, int]
    dip_text: tuple[int, int]


_TINY = {"features": 6, "text_dim": 8, "width": 16, "layers": 1, "heads": 2, "feed_forward": 16}
SIZES = {
    "small": Size(
        about="the networks of the small recipes at 269 features: segments by width 256 in 4 blocks with a flow of 2 "
        "couplings of 64, DiP at the same width and depth, MotionDiffuse at width 384; 16 text tokens of 384",
        segment=lambda n: SegmentTransformerConfig(frames=n, smoothing=0.3, heading_change=True),
        volume=SegmentDenoiserConfig(
            features=269,
            text_dim=384,
            width=384,
            layers=4,
            heads=6,
            feed_forward=768,
            conditioning=512,
            text_width=192,
            text_layers=1,
            text_feed_forward=768,
        ),
        dip=DipDecoderConfig(features=269, text_dim=384, width=256, layers=4),
        flow=FlowConfig(blocks=2, hidden=64, text_context=32, index_context=8),
        text=(16, 384),
        dip_text=(16, 384),
    ),
    "paper": Size(
        about="the published networks (width 512, 8 layers; 6 couplings of 256) at KIT-ML's 251 features; 77 tokens of "
        "CLIP, for DiP 20 of DistilBERT",
        segment=lambda n: SegmentDenoiserConfig(features=251, frames=n, prev="xattn", max_index=1, read_padding=True),
        volume=SegmentDenoiserConfig(features=251, read_padding=True),
        dip=DipDecoderConfig(features=251),
        flow=FlowConfig(features=251, text_dim=512, bound="hardtanh"),
        text=(77, 512),
        dip_text=(20, 768),
    ),
    "tiny": Size(
        about="for tests of the benchmark: the numbers say nothing",
        segment=lambda n: SegmentTransformerConfig(
            features=6, frames=n, text_dim=8, width=16, heads=2, hidden=16, blocks=1
        ),
        volume=SegmentDenoiserConfig(
            **_TINY, conditioning=16, text_width=8, text_layers=1, text_heads=2, text_feed_forward=8
        ),
        dip=DipDecoderConfig(**_TINY),
        flow=FlowConfig(features=6, blocks=2, hidden=4, text_dim=8, text_context=4, index_context=2),
        text=(3, 8),
        dip_text=(3, 8),
    ),
}


def pieces(row: Row, frames: int = HORIZON) -> int:
    """N: segments or chunks of a sequence."""
    return -(-frames // row.frames)


def staircase(row: Row, steps: int, segments: int) -> Staircase:
    """The plan of an RDM row."""
    if row.variant == TRIANGLE:
        return Staircase(steps, segments, start=min(segments, steps), shape="triangle")
    return Staircase(steps, segments, start=steps if row.variant == FULL else -(-steps // 3))


def expected(size: Size, row: Row, steps: int, frames: int = HORIZON) -> Counter[str]:
    """What one sample takes, in closed form but for the flow, whose applications follow from the plan of cells."""
    n, recurrent = pieces(row, frames), row.model.startswith("RDM")
    calls, waves, alone, back = n * steps, n * steps, 0, []
    if recurrent:
        start = {TRIANGLE: min(n, steps), PARALLELOGRAM: -(-steps // 3), FULL: steps}[row.variant]
        entering = min(n - 1, start) if row.variant == TRIANGLE else n - 1
        calls = steps + entering * start - (entering * (entering - 1) // 2 if row.variant == TRIANGLE else 0)
        waves, alone = steps + entering, n - 1 - entering
        # Segments are pulled back from x to y after a call, but not in a wave that only finishes what it evaluates.
        plan = staircase(row, steps, n).wavefront()
        back = [j for cells in plan if any(k + 1 < steps for _, k in cells) for j, _ in cells]
    elif row.model == "MotionDiffuse":
        n, calls, waves = 1, steps, steps
    elif row.model == "DiP" and row.variant != UNGUIDED:
        calls *= 2
    apart = isinstance(size.segment(row.frames), SegmentTransformerConfig) and row.model[:2] in ("RD", "MD")
    # The left neighbour changes with every call of RDM, and with every segment of MD.
    context = (calls if recurrent else n) if apart else 0
    return Counter(
        {
            "network": calls,
            "waves": waves,
            "context": context,
            "text": calls if row.model == "DiP" else context or 1,
            "flow": calls - steps + sum(j > 0 for j in back) + alone if recurrent else 0,
            "flow text": calls + len(back) + alone if recurrent else 0,
        }
    )


class Methods:
    """All rows at one size; networks are made when first used."""

    def __init__(self, size: Size, device: str = "cpu") -> None:
        self.size, self.device = size, device
        self._network = cache(lambda config: _awake(config).to(device))
        self._settle = torch.cuda.synchronize if device == "cuda" else bool

    def network(self, row: Row) -> nn.Module:
        """The denoiser of a row; MD-N has that of RDM-N."""
        if row.model == "DiP":
            return self._network(self.size.dip)
        return self._network(self.size.volume if row.model == "MotionDiffuse" else self.size.segment(row.frames))

    @cached_property
    def flow(self) -> CouplingFlow:
        """The flow of the RDM rows."""
        return self._network(self.size.flow)

    @torch.no_grad()
    def run(
        self, row: Row, steps: int, *, frames: int = HORIZON, batch: int = 1, meter: Meter | None = None, eta: float = 0
    ) -> Tally:
        """Samples ``batch`` sequences of one prompt and says what it took.

        Raises:
            RuntimeError: other calls or waves than expected.
        """
        network, tally = self.network(row), Tally(batch, meter, self._settle)
        make = self._recurrent if row.model.startswith("RDM") else getattr(self, f"_{row.model.split('-')[0].lower()}")
        with nullcontext() if meter is None else meter.running(network, self.flow):
            start = tally.now()
            made = make(row, network, steps, frames, tally, eta)
            tally.seconds = tally.now() - start
        if made.shape[:2] != (batch, frames) or not bool(made.isfinite().all()):
            raise RuntimeError(f"{row.label} made {tuple(made.shape)} instead of {batch} times {frames} finite frames")
        counted = {"network": tally.calls, "waves": len(tally.marks)} | (dict(meter.rows) if meter else {})
        should = expected(self.size, row, steps, frames)
        if wrong := {name: (n, should[name]) for name, n in counted.items() if n != should[name]}:
            raise RuntimeError(f"{row.label}, K = {steps}, {frames} frames: counted, expected: {wrong}")
        return tally

    def _recurrent(
        self, row: Row, network: nn.Module, steps: int, frames: int, tally: Tally, eta: float, flow: bool = True
    ) -> Tensor:
        segments, batch = pieces(row, frames), tally.batch
        plan = staircase(row, steps, segments) if flow else Staircase(steps, segments, start=0)
        pooled_BC = _noise(batch, self.flow.config.text_dim).to(self.device) if flow else None
        made = Stream(
            _bound(network, *self._text(batch), tally, once=False),
            Transport(_TimedFlow(self.flow, tally) if flow else None),
            Settings(solver=_solver(steps, eta), staircase=plan), range(batch), (row.frames, network.config.features),
            lambda segment: pooled_BC, device=self.device,
        )  # fmt: skip
        return torch.cat(list(made), dim=1)[:, :frames]

    def _motiondiffuse(self, row: Row, network: nn.Module, steps: int, frames: int, tally: Tally, eta: float) -> Tensor:
        # One segment and no flow: the same sampler.
        return self._recurrent(row, network, steps, frames, tally, eta, flow=False)

    def _md(self, row: Row, network: nn.Module, steps: int, frames: int, tally: Tally, eta: float) -> Tensor:
        shape = (row.frames, network.config.features)
        denoiser = _bound(network, *self._text(tally.batch), tally, once=True)
        plan = Staircase(steps, pieces(row, frames), steps, lag=steps)
        settings = Settings(solver=_solver(steps, eta), staircase=plan)
        seeds = range(tally.batch)
        made = Stream(denoiser, Transport(None), settings, seeds, shape, lambda segment: None, device=self.device)
        return torch.cat(list(made), dim=1)[:, :frames]

    def _dip(self, row: Row, network: nn.Module, steps: int, frames: int, tally: Tally, eta: float) -> Tensor:
        copies = 1 if row.variant == UNGUIDED else 2
        (length, width), rows = self.size.dip_text, copies * tally.batch
        # The second half is the empty prompt.
        mask = (torch.arange(rows, device=self.device) < tally.batch)[:, None].expand(rows, length)
        tokens = _noise(rows, length, width).to(self.device)

        def denoiser(x_BnD: Tensor, t_B: Tensor, prefix_BPD: Tensor, number: int) -> Tensor:
            tally.wave(rows)
            x, prefix = x_BnD.repeat(copies, 1, 1), prefix_BPD.repeat(copies, 1, 1)
            made = network(x, t_B.repeat(copies), Condition(_embedding(tokens, mask), past=PastSegment.clean(prefix)))
            return made if copies == 1 else cfg(*made.chunk(2), 6.5)

        prefix = torch.zeros(tally.batch, 20, network.config.features, device=self.device)
        return rollout_chunks(denoiser, cosine(steps), prefix, frames, range(tally.batch))

    def _text(self, batch: int) -> tuple[Tensor, Tensor]:
        length, width = self.size.text
        return _noise(batch, length, width).to(self.device), torch.ones(
            batch, length, dtype=torch.bool, device=self.device
        )


class _TimedFlow:
    """A flow, and how long it takes."""

    def __init__(self, flow: CouplingFlow, tally: Tally) -> None:
        self.dtype = flow.dtype
        self.context = self._timed(flow.context, tally)
        self.inverse = self._timed(flow.inverse, tally)
        self._forward = self._timed(flow, tally)

    def __call__(self, x_BnD: Tensor, context_Bc: Tensor) -> Tensor:
        return self._forward(x_BnD, context_Bc)

    @staticmethod
    def _timed(of: Callable[..., Tensor], tally: Tally) -> Callable[..., Tensor]:
        def timed(*inputs: Tensor) -> Tensor:
            start = tally.now()
            made = of(*inputs)
            tally.flow_seconds += tally.now() - start
            return made

        return timed


def _solver(steps: int, eta: float) -> Solver:
    return Solver(schedule=_SCHEDULE, levels=levels(steps), eta=eta)


def _noise(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0))


def _awake(config: SegmentTransformerConfig | SegmentDenoiserConfig | DipDecoderConfig | FlowConfig) -> nn.Module:
    """A network of random weights, those that start at zero included."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        module = config.build().eval().requires_grad_(False)
        for parameter in module.parameters():
            if not bool(parameter.any()):
                parameter.normal_(std=0.02)
    return module


def _bound(network: nn.Module, tokens_BLC: Tensor, mask_BL: Tensor, tally: Tally, *, once: bool) -> Denoiser:
    """A segment denoiser with its prompt; ``once``: the left neighbour is the same for all steps of a segment."""

    def condition(copies: int, prev: Tensor, prev_t: Tensor, index: Tensor) -> Condition:
        text = _embedding(tokens_BLC.repeat(copies, 1, 1), mask_BL.repeat(copies, 1))
        return Condition(text, past=PastSegment(prev, prev_t, index))

    if isinstance(network, SegmentDenoiser):
        text = network.prepare(Condition(_embedding(tokens_BLC, mask_BL)))

        @cache
        def repeated(copies: int) -> TextStates:
            mask = None if text.mask is None else text.mask.repeat(copies, 1)
            return replace(
                text, states=text.states.repeat(copies, 1, 1), mask=mask, summary=text.summary.repeat(copies, 1)
            )

        def apart(x: Tensor, t: Tensor, prev: Tensor, prev_t: Tensor, index: Tensor, rows: object) -> Tensor:
            tally.wave(len(x))
            copies = len(x) // tally.batch
            return network(x, t, replace(repeated(copies), condition=condition(copies, prev, prev_t, index)))

        return apart
    held: dict[int, object] = {}

    def denoiser(x: Tensor, t: Tensor, prev: Tensor, prev_t: Tensor, index: Tensor, rows: object) -> Tensor:
        tally.wave(len(x))
        context = held.get(rows[0]) if once else None
        if context is None:
            with tally.part("context", len(x)):
                context = network.prepare(condition(len(x) // tally.batch, prev, prev_t, index))
            held.clear()
            held[rows[0]] = context
        return network(x, t, context)

    return denoiser


def _embedding(tokens_BLC: Tensor, mask_BL: Tensor) -> TextEmbedding:
    return TextEmbedding(tokens_BLC, mask_BL, tokens_BLC.mean(1))
