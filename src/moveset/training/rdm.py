"""Training a recurrent diffusion model: the denoiser of a segment, and the flow from one segment to the next.

One task for RDM and for what it is compared with: ``flow=None`` with ``grid.condition="clean"`` is the autoregressive
MD-N, one segment as long as the longest clip is a volume model (RDM-1, MotionDiffuse, Light-RDM-1).
Source: RDM (arXiv 2406.07169), Section 4.4 and Algorithm 2; MotionDiffuse (arXiv 2208.15001).
"""

from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

import torch
from torch import Tensor, nn

from moveset.data.segments import CuttingConfig, SegmentBatch
from moveset.data.text_augmentation import TextAugmentation
from moveset.diffusion.schedule import linear
from moveset.errors import InputError
from moveset.models.condition import Condition, PastSegment
from moveset.models.flow import CouplingFlow, FlowConfig
from moveset.models.light_t2m import LightT2MConfig
from moveset.models.registry import describe
from moveset.models.segment_denoiser import SegmentDenoiserConfig
from moveset.models.segment_transformer import SegmentTransformer, SegmentTransformerConfig
from moveset.motion.features import FeatureCodec, Normalizer
from moveset.rdm.grid import GridConfig, corrupt, draw
from moveset.rdm.losses import flow_loss, jacobian_weight, masked_mse, velocity_loss
from moveset.rdm.transport import Transport
from moveset.text.encoder import TextEmbedding
from moveset.text.sides import with_sides
from moveset.training.condition_dropout import drop_captions, drop_heading_change, perturb_heading, perturb_past
from moveset.training.ema import Ema, ema_warmup
from moveset.training.engine import Loop, Task
from moveset.training.momo import MomoAdam
from moveset.training.optim import cosine_lr
from moveset.training.reading import told_sides
from moveset.training.segment_data import SegmentData, forecast, spectrum
from moveset.training.segment_losses import foot_error, heading_error, placed, side_shortfall
from moveset.training.single_network import NetworkConfig
from moveset.training.tasks import Sources

SCHEDULE = linear()

Optimizer = Literal["adamw", "momo"]
Weight = Literal["x0", "v"]
Prediction = Literal["x0", "eps"]
Noise = Literal["white", "coloured"]
Told = Literal["clean_prev", "none"]


@dataclass(frozen=True, kw_only=True)
class RDMConfig(NetworkConfig):
    """What ``RDMTask`` trains and how.

    Args:
        model: the denoiser of a segment. Its ``features``, ``frames`` and ``text_dim``, and those of the flow, follow
            from codec, grid and text encoder.
        flow: None leaves the flow out.
        depth_cap: P, the most applications of the flow; N - 1 is the paper.
        codec: its features, a name for ``data.dataset.choose_codec``.
        optimizer: "momo" (the paper) or "adamw".
        beta2: of AdamW.
        constant_lr: no cosine decay.
        condition_dropout: share of captions replaced by "", for guidance.
        weight: of a cell's error: "x0" (1, the paper) or "v" (1/sigma², at most 5): more for low
            noise.
        jacobian: power of the flow's |det df/dx|^-1 in a cell's weight: 0 as in RDM's Algorithm 2, 1 as in its Eq. 13
            and 31 (``rdm.losses.jacobian_weight``).
        joint: let the denoiser's error reach the flow, too, through what is carried and through ``jacobian`` (Eq. 13),
            beside the flow's own loss.
        root: weight of the four root features, by which a character travels.
        noise: "white" (the paper), or "coloured" with the temporal spectrum of the training segments
            (``diffusion.coloured``).
        forecast: start the segment transformer's forecast from a fit to the data instead of from zero.
        feet: weight of the error of the feet's velocities in the world, for clean predictions.
        heading: weight of the error of the turn that a segment's steps add up to, likewise (``segment_losses``).
        past_perturbation: deviation, in radians a second, of a steady turn that is added to the segment before, as it
            is told.
        velocity: weight of the error of frame-to-frame differences.
        flow_noise: deviation of the noise added to the flow's input.
        isometry: weight that keeps the flow's scales near one.
        frozen_flow: share of the steps at the end in which the flow no longer changes.
        predict: the clean segment (RDM), or the noise (MotionDiffuse), for models without a flow.
        md_condition: what an autoregressive baseline (``grid.condition="clean"``, no flow) is told of the past: the
            segment before, or nothing; then every segment counts as a first one.
        heading_change: share of segments that are told how far the heading has turned since their sentence began (the
            segment transformer).
        sides: share of samples that are told, beside their sentence, the sides favoured by what it is said to
            (``text.sides``).
        side_weight: at the beginning, of that by which limbs that are told to move more fail to, in clean predictions
            (``segment_losses``). It fades as learning rates do: gaits get slow by it, and who listens goes on doing so.
        heading_noise: deviation, in radians, of how far their way has turned more or less than it should have, of which
            they take half back (``training.condition_dropout.perturb_heading``).
    """

    model: SegmentTransformerConfig | SegmentDenoiserConfig | LightT2MConfig = field(
        default_factory=SegmentTransformerConfig
    )
    flow: FlowConfig | None = field(default_factory=FlowConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    depth_cap: int = 1
    codec: str = "auto"
    cutting: CuttingConfig = field(default_factory=CuttingConfig)
    batch: int = 64
    optimizer: Optimizer = "adamw"
    lr: float = 7e-4
    flow_lr: float = 5e-4
    warmup: int = 200
    beta2: float = 0.99
    constant_lr: bool = False
    condition_dropout: float = 0.1
    ema: float = 0.999
    weight: Weight = "v"
    jacobian: float = 0.0
    joint: bool = False
    root: float = 5.0
    noise: Noise = "white"
    forecast: bool = False
    feet: float = 0.0
    heading: float = 0.0
    past_perturbation: float = 0.0
    velocity: float = 0.0
    flow_noise: float = 0.02
    isometry: float = 1e-2
    frozen_flow: float = 0.25
    text_encoder: str = "minilm"
    augmentation: TextAugmentation = field(default_factory=TextAugmentation)
    predict: Prediction = "x0"
    md_condition: Told = "clean_prev"
    heading_change: float = 0.0
    heading_noise: float = 0.0
    sides: float = 0.0
    side_weight: float = 0.0


class RDMTask(Task):
    """Both networks, each with its own loss and optimiser; the denoiser's error reaches the flow only if ``joint``."""

    name = "rdm"

    def __init__(self, config: RDMConfig, sources: Sources, loop: Loop) -> None:
        _check(config)
        self.data = SegmentData(sources, config, loop)
        self.config = config = _sized(config, self.data)
        self.denoiser = config.model.build().to(loop.device)
        self._spectrum = spectrum(self.data.train) if config.noise == "coloured" else None
        if config.forecast:
            with torch.no_grad():
                self.denoiser.forecast.copy_(forecast(self.data.train))
        self.ema = Ema(self.denoiser, config.ema)
        self.take_given()
        self.flow: CouplingFlow | None = None if config.flow is None else config.flow.build().to(loop.device)
        self.flow_ema = None if self.flow is None else Ema(self.flow, config.ema)
        self.transport = Transport(self.flow, config.depth_cap)
        self.draws = loop.generator("draws", device=loop.device)
        self.normalizer = Normalizer(*(x.to(loop.device) for x in vars(self.data.normalizer).values()))
        self.feature_weight = feature_weights(self.data.codec, config.root).to(loop.device)
        self._optimizers = {"denoiser": _optimizer(config, self.denoiser, config.lr)}
        if self.flow is not None:
            self._optimizers["flow"] = _optimizer(config, self.flow, config.flow_lr)

    def modules(self) -> dict[str, nn.Module]:
        return {"denoiser": self.denoiser} | ({} if self.flow is None else {"flow": self.flow})

    def averages(self) -> dict[str, nn.Module]:
        return {"denoiser_ema": self.ema.module} | ({} if self.flow_ema is None else {"flow_ema": self.flow_ema.module})

    def optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return self._optimizers

    def take_given(self) -> None:
        """The spectrum of these segments, or a flat one: noise is what ``noise`` says, whatever it goes on from."""
        for network in (self.denoiser, self.ema.module):
            if isinstance(network, SegmentTransformer):
                cast(Tensor, network.spectrum).copy_(1.0 if self._spectrum is None else self._spectrum)

    def learning_rates(self, step: int, steps: int) -> dict[str, float]:
        config = self.config
        rates = {"denoiser": config.lr} | ({} if self.flow is None else {"flow": config.flow_lr})
        if config.constant_lr:
            return rates
        return {name: cosine_lr(step, lr, config.warmup, steps) for name, lr in rates.items()}

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        config = self.config
        batch = self.data.training_batch(config.batch, step)
        report: dict[str, Tensor] = {}
        learns = self.flow is not None and step <= loop.config.steps * (1 - config.frozen_flow)
        if learns:
            report |= self._train_flow(batch, loop)
        said = drop_captions(batch.captions, config.condition_dropout, self.draws)
        text, asked = self.data.read(said, self.draws), None
        if config.sides:
            sides_B3 = told_sides(said, batch.sides, config.sides, self.draws)
            text = with_sides(text, sides_B3)
            if config.side_weight:
                asked = sides_B3, cosine_lr(step, config.side_weight, 0, loop.config.steps)
        both = config.joint and learns
        loss, parts = self._loss(self.denoiser, self.transport, batch, text, self.draws, both, asked)
        moved = ("denoiser", "flow") if both else ("denoiser",)
        report |= parts | {"loss": loss.detach(), "gradient_norm": loop.minimise(loss, *moved)}
        self.ema.update(self.denoiser, ema_warmup(step, config.ema))
        if self.flow is not None and self.flow_ema is not None:
            self.flow_ema.update(self.flow, ema_warmup(step, config.ema))
        return report

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        """The averaged denoiser's error on 512 segments of val at levels drawn once, and the deviation of its input."""
        generator = torch.Generator().manual_seed(0)
        flow = None if self.flow_ema is None else self.flow_ema.module
        transport = Transport(cast(CouplingFlow | None, flow), self.config.depth_cap)
        rows: dict[str, list[Tensor]] = {}
        for k in range(4):
            batch = self.data.val.batch(128, 0, k).to(loop.device)
            text = self.data.read(batch.captions)
            _, parts = self._loss(self.ema.module, transport, batch, text, generator)
            for name, value in parts.items():
                rows.setdefault(name, []).append(value)
        return {name: float(torch.stack(values).mean()) for name, values in rows.items()}

    def _train_flow(self, batch: SegmentBatch, loop: Loop) -> dict[str, Tensor]:
        rows = (batch.index > 0).nonzero()[:, 0]
        nothing = not len(rows)
        if self.flow is None or (nothing and loop.world_size == 1):
            return {}
        if nothing:  # other processes may have something, and wait for this one's gradient
            rows = torch.zeros(1, dtype=torch.long, device=batch.index.device)
        pooled = self.data.pooled([batch.captions[k] for k in rows.tolist()])
        context = self.flow.context(pooled, batch.index[rows])
        noise = torch.randn(len(rows), *batch.clean.shape[1:], generator=self.draws, device=loop.device)
        noise *= self.config.flow_noise
        loss, error = flow_loss(
            self.flow,
            batch.previous[rows],
            batch.clean[rows],
            batch.valid[rows],
            context,
            noise,
            self.config.isometry,
        )
        loop.minimise(loss * 0.0 if nothing else loss, "flow")
        return {} if nothing else {"flow": error}

    def _loss(
        self,
        denoiser: nn.Module,
        transport: Transport,
        batch: SegmentBatch,
        text: TextEmbedding,
        generator: torch.Generator,
        joint: bool = False,
        asked: tuple[Tensor, float] | None = None,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        config = self.config
        if config.md_condition == "none":
            batch = replace(batch, index=torch.zeros_like(batch.index))
        draws = draw(config.grid, SCHEDULE, tuple(batch.clean.shape), generator)  # type: ignore[arg-type]
        drawn = {name: value for name, value in vars(draws).items() if value is not None}
        draws = replace(draws, **{name: value.to(batch.clean.device) for name, value in drawn.items()})
        if isinstance(self.denoiser, SegmentTransformer):
            noises = (draws.noise_BnD, draws.prev_noise_BnD)
            noise, other = (self.denoiser.colour(part) for part in noises)
            draws = replace(draws, noise_BnD=noise, prev_noise_BnD=other)
        # The flow always hears the sentence itself: dropping it for guidance is the denoiser's affair.
        said, before = self.data.pooled(batch.captions), self.data.pooled(batch.previous_captions)
        first = batch.first if config.grid.anchor == "first" else None
        clean, previous, turned_B = batch.clean, batch.previous, batch.turned
        if config.heading_noise:
            clean, turned_B = perturb_heading(
                clean, turned_B, batch.begun, config.heading_noise, self.data.codec, self.normalizer, generator
            )
        if config.past_perturbation:
            size = config.past_perturbation
            previous = perturb_past(previous, batch.index, size, self.data.codec, self.normalizer, generator)
        with nullcontext() if joint else torch.no_grad():
            cell = corrupt(config.grid, SCHEDULE, transport, clean, previous, first, batch.index, said, before, draws)
            weight_B = _level_weight(config.weight, cell.t_B)
            if config.jacobian:
                of_flow_B = jacobian_weight(transport, clean, batch.valid, batch.index, said, config.jacobian)
                weight_B = weight_B * of_flow_B
        heading_B = drop_heading_change(turned_B, config.heading_change, generator) if config.heading_change else None
        past = PastSegment(cell.prev_BnD, cell.prev_t_B, batch.index, heading_B)
        made = denoiser(cell.x_BnD, cell.t_B, Condition(text, past=past, valid=batch.valid)).float()
        root_B = weight_B.sqrt()[:, None, None] * self.feature_weight.sqrt()
        target = draws.noise_BnD if config.predict == "eps" else clean
        loss = masked_mse(made * root_B, target * root_B, batch.valid)
        if config.velocity:
            last, later = batch.previous[:, -1], batch.index > 0
            loss = loss + config.velocity * velocity_loss(
                made * root_B, clean * root_B, last * root_B[:, 0], later, batch.valid
            )
        seen_B = SCHEDULE.alpha(cell.t_B).square()  # what noise still hides has no feet to judge, and no course
        if config.feet or asked is not None:
            codec = self.data.codec
            joints, real = (placed(x, codec, self.normalizer) for x in (made, clean))
        if config.feet:
            feet_B = foot_error(joints, real, batch.valid, codec.fps, codec.skeleton)
            loss = loss + config.feet * (feet_B * seen_B).mean()
        if asked is not None:
            short = side_shortfall(joints, real, batch.valid, asked[0], seen_B, codec.skeleton)
            loss = loss + asked[1] * short
        if config.heading:
            turn_B = heading_error(made, clean, batch.valid, self.data.codec, self.normalizer)
            if heading_B is not None:  # in any noise: who knows how far the way has turned knows what is left of it
                seen_B = torch.where(heading_B.isnan(), seen_B, 1.0)
            loss = loss + config.heading * (turn_B * seen_B).mean()
        seen = {"error": masked_mse(made.detach(), target, batch.valid), "noisy_std": cell.x_BnD.std()}
        if config.heading:
            seen["heading"] = turn_B.mean().detach()
        if asked is not None:
            seen["sides"] = short.detach()
        return loss, seen


def feature_weights(codec: FeatureCodec, root: float) -> Tensor:
    """Weights (D,) of mean 1 in which the root's features count ``root`` times as much as others."""
    weights = torch.ones(codec.dim)
    for name in ("root_yaw", "root_velocity", "root_height"):
        weights[codec.groups[name]] = root
    return weights * len(weights) / weights.sum()


def _level_weight(kind: str, t_B: Tensor) -> Tensor:
    if kind == "x0":
        return torch.ones(len(t_B), device=t_B.device)
    return (1 / SCHEDULE.sigma(t_B).square()).clamp(max=5.0)


def _optimizer(config: RDMConfig, module: nn.Module, lr: float) -> torch.optim.Optimizer:
    if config.optimizer == "momo":
        return MomoAdam(module.parameters(), lr)
    return torch.optim.AdamW(module.parameters(), lr, betas=(0.9, config.beta2), weight_decay=0.0)


def _sized(config: RDMConfig, data: SegmentData) -> RDMConfig:
    """With the sizes that follow from the codec, the segment and the text encoder filled in."""
    features, text = data.codec.dim, data.text
    model = replace(config.model, features=features, frames=config.grid.frames, text_dim=text.widths[0])
    if config.heading_change and isinstance(model, SegmentTransformerConfig):
        model = replace(model, heading_change=True)
    if config.md_condition == "none":
        # Whoever samples it tells it of the segment before: the network itself must not listen.
        if isinstance(model, SegmentTransformerConfig):
            model = replace(model, alone=True)
        elif isinstance(model, SegmentDenoiserConfig):
            model = replace(model, prev="none", max_index=0, boundary=0)
    flow = None if config.flow is None else replace(config.flow, features=features, text_dim=text.widths[1])
    return replace(config, codec=data.codec.name, model=model, flow=flow)


def require_heading_told(config: Any) -> None:
    """Raises InputError for ways that go astray of which nobody is told."""
    if config.heading_noise and not config.heading_change:
        raise InputError("heading_noise is for segments that are told their heading_change; set that too")


def _check(config: RDMConfig) -> None:
    """Raises InputError for settings that contradict each other (as a whole: they are made one after the other)."""
    if not isinstance(config.model, SegmentTransformerConfig):
        for name, plain in (("noise", "white"), ("forecast", False), ("heading_change", 0.0)):
            if (value := getattr(config, name)) != plain:
                kind = describe(config.model)[0]
                raise InputError(f"{name}={value} is for the segment transformer, not for a {kind}; leave it out")
    asked = config.sides and config.side_weight  # who is told no sides is asked for none
    judged = config.velocity or config.feet or config.heading or asked
    if config.predict == "eps" and (config.flow is not None or judged or config.weight != "x0"):
        raise InputError(
            'predict="eps" is for models without a flow, with velocity, feet, heading and side_weight 0 and weight '
            '"x0"; change these'
        )
    for name in ("jacobian", "joint"):
        if getattr(config, name) and config.flow is None:
            raise InputError(f"{name} {getattr(config, name):g} is of the flow, and there is none; leave it out")
    if config.grid.entangled and config.grid.anchor != "segment":
        raise InputError(f'grid.entangled {config.grid.entangled:g} is for grid.anchor="segment"; leave it out')
    require_heading_told(config)
    if config.md_condition == "none" and (config.flow is not None or config.grid.condition != "clean"):
        raise InputError('md_condition="none" is for models without a flow and with grid.condition="clean"')
