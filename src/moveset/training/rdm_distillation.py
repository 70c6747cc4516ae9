"""Distilling a recurrent diffusion model into one, two or four evaluations a segment: the two papers joined.

Segments are denoised one after the other, each told its finished predecessor, or in a staircase. Teacher, guidance,
averaged target and discriminator are as in ``training.distillation``; the mathematics is in ``rdm.distillation``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import torch
from torch import Tensor

from moveset.data.segments import CuttingConfig, SegmentBatch
from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.steps import add_noise, over, predict_eps, renoise
from moveset.errors import InputError
from moveset.models.condition import Denoiser
from moveset.models.discriminator import DiscriminatorHeads
from moveset.models.segment_transformer import SegmentTransformer, SegmentTransformerConfig
from moveset.motion.features import Normalizer
from moveset.pcm.consistency import Draws, draw
from moveset.pcm.losses import hinge_generator, huber
from moveset.pipelines.heading_tracker import HeadingTracker
from moveset.rdm.distillation import clean_target, trajectory_target
from moveset.rdm.grid import GridConfig
from moveset.rdm.staircase import levels
from moveset.rdm.transport import Transport
from moveset.text.encoder import TextEmbedding
from moveset.text.sides import forget, with_sides
from moveset.training.adversarial import AdversarialTask, discriminator_step
from moveset.training.bound_segments import BoundSegments, NoisyPast
from moveset.training.condition_dropout import drop_heading_change, perturb_heading, perturb_past
from moveset.training.distillation import StudentConfig, require_rows
from moveset.training.ema import Ema
from moveset.training.engine import Loop
from moveset.training.rdm import SCHEDULE, RDMConfig, feature_weights, require_heading_told
from moveset.training.rollout import Rollout
from moveset.training.segment_data import SegmentData
from moveset.training.segment_losses import heading_error, placed, side_shortfall
from moveset.training.tasks import Sources
from moveset.training.trained import load_trained, require_same_encoder

NEARER = 0.75
"""Share of the level at which the teacher of streams is asked that a noisy past is told at."""


@dataclass(frozen=True, kw_only=True)
class RDMStudentConfig(StudentConfig):
    """What a few-step student of segments is and how it learns.

    Args:
        root: weight of the four root features, as in the teacher's training.
        tremor: of the student's network, see ``SegmentTransformerConfig``; one evaluation trembles more than ten.
        heading, past_perturbation: as in the teacher's training (``RDMConfig``); the teacher is told the bent past too.
        context_noise_rollout: tell the teacher of ``rollout_share`` the segment before at a level somewhat below the
            one it is asked at, as most of its training did; the student is told a finished one, as in use. From a noisy
            past the teacher goes on more lively than from the tired one that a stream may have come to; told takes'
            pasts as they are, it can be followed.
        overlapping: tell teacher, student and discriminator the segment before at the lower edge of the phase in which
            they are asked, where a staircase of lag 1 has it then (``--set lag=1``). In the last phase it is finished.
        rollout_share: share of a batch's rows that are told what the student made itself (``training.rollout``). They
            are asked at the top of each phase in turn, and judged without their past: not whether a segment goes on as
            takes do, but whether it shows what is said as takes do.
        heading_change, heading_noise: as in the teacher's training, for a teacher that was told how far its way has
            turned; streams of ``rollout_share`` are told it where the takes are that they begin with, or whose
            sentences they are given.
        sides, side_weight: as in the teacher's training; streams of ``rollout_share`` are told the sides of the takes
            whose sentences they are given.
        codec, frames: filled in from the teacher's.
    """

    guidance: tuple[float, float] = (0.0, 3.0)
    batch: int = 64
    lr: float = 3e-4
    warmup: int = 100
    discriminator_lr: float = 1e-3
    root: float = 5.0
    tremor: float = 0.0
    heading: float = 0.0
    past_perturbation: float = 0.0
    context_noise_rollout: bool = False
    overlapping: bool = False
    rollout_share: float = 0.0
    heading_change: float = 0.0
    heading_noise: float = 0.0
    sides: float = 0.0
    side_weight: float = 0.0
    cutting: CuttingConfig = field(default_factory=CuttingConfig)
    codec: str = ""
    frames: int = 0
    model: SegmentTransformerConfig | None = None


class RDMStudentTask(AdversarialTask):
    """Consistency inside each of M phases, a discriminator on the frozen teacher's features."""

    name = "rdm-student"

    def __init__(self, config: RDMStudentConfig, sources: Sources, loop: Loop) -> None:
        require_rows(config, "trajectory_rows")
        require_heading_told(config)
        if config.context_noise_rollout and not config.rollout_share:
            raise InputError(
                "context_noise_rollout is of the student's own streams, and there are none; set rollout_share too"
            )
        if config.overlapping and config.phases == 1:
            raise InputError(
                "overlapping is for several phases: in one the segment before is finished; set phases=2 or 4"
            )
        if config.overlapping and config.context_noise_rollout:
            raise InputError("overlapping tells noisy pasts of its own; leave context_noise_rollout out")
        teacher = load_trained(sources.teacher, "denoiser_ema", loop.device)
        require_same_encoder(config, teacher)
        loop.learned_from |= {"teacher": teacher.digest, "flow": ""}
        self.teacher = teacher.module
        if not isinstance(self.teacher, SegmentTransformer):
            raise InputError(
                f"{teacher.path} holds a {teacher.kind}; only a segment_transformer teaches streams: give another "
                "--teacher"
            )
        flow = None
        if teacher.task["flow"] is not None:
            found = load_trained(sources.teacher, "flow_ema", loop.device, part="coupling_flow")
            loop.learned_from["flow"] = found.digest
            # Without dropout both modes compute the same, but cuDNN differentiates LSTMs in training's alone.
            flow = found.module.train()
        self.transport = Transport(flow, teacher.task["depth_cap"])
        if config.heading_change and not self.teacher.config.heading_change:
            raise InputError("heading_change is for a teacher that was trained with heading_change; leave it out")
        shared = RDMConfig(
            grid=GridConfig(frames=teacher.task["grid"]["frames"]),
            codec=teacher.task["codec"],
            cutting=config.cutting,
            augmentation=config.augmentation,
            text_encoder=config.text_encoder,
        )
        self.data = SegmentData(sources, shared, loop)
        self.student = self.teacher.student().requires_grad_(True)
        self.student.config = replace(self.student.config, tremor=config.tremor)
        self.config = replace(config, model=self.student.config, codec=shared.codec, frames=shared.grid.frames)
        self.ema = Ema(self.student, config.ema)
        self.grid = PhaseGrid(config.points, config.phases)
        self.own = Rollout(config.rollout_share, config.batch, self.grid)
        self.alone = torch.zeros(config.batch, dtype=torch.bool).index_fill(0, self.own.rows, True).to(loop.device)
        self.draws = loop.generator("draws", device=loop.device)
        self.optimizer = torch.optim.AdamW(self.student.parameters(), config.lr, betas=(0.9, 0.999), weight_decay=0.0)
        if config.adversarial:
            self.make_heads(self.student.config.width, self.student.config.blocks, loop)
        self.normalizer = Normalizer(*(x.to(loop.device) for x in vars(self.data.normalizer).values()))
        yaw = self.data.codec.groups["root_yaw"]
        self.course = HeadingTracker(yaw, self.normalizer.mean, self.normalizer.std, window=1)
        self.scale = feature_weights(self.data.codec, config.root).sqrt().to(loop.device)
        self._reference: Tensor | None = None

    def take_given(self) -> None:
        """The spectrum of the teacher's noise."""
        for network in (self.student, self.ema.module):
            network.spectrum.copy_(self.teacher.spectrum)

    def state(self) -> dict[str, Any]:
        return self.own.state()

    def load_state(self, state: Mapping[str, Any]) -> None:
        self.own.load_state(state, self.scale.device)

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        config = self.config
        batch = self.data.training_batch(config.batch, step)
        if config.heading_noise:
            about = (config.heading_noise, self.data.codec, self.normalizer, self.draws)
            clean, turned_B = perturb_heading(batch.clean, batch.turned, batch.begun, *about)
            batch = replace(batch, clean=clean, turned=turned_B)
        turned_B = drop_heading_change(batch.turned, config.heading_change, self.draws)
        sides_B3 = forget(batch.sides, 1 - config.sides, self.draws)
        batch = replace(batch, turned=turned_B, sides=sides_B3)
        if config.past_perturbation:
            size, codec = config.past_perturbation, self.data.codec
            past = perturb_past(batch.previous, batch.index, size, codec, self.normalizer, self.draws)
            batch = replace(batch, previous=past)
        shares = (config.inference_points, config.discriminator_max_noise)
        draws = draw(self.grid, batch.clean, config.guidance, self.draws, *shares, self.own.place)
        white_BnD, draws = draws.noise_BND, self._coloured(draws)
        if config.rollout_share:
            batch, w_B = self.own.tell(batch, draws.w_B, self.draws)
            draws = replace(draws, w_B=w_B)
        past_noise = self._past_noise(self.own.began_with(white_BnD), self.draws)
        # The student reads a roughened sentence and should say what is said to the sentence as it is.
        rough, text = self._read(batch, self.draws), self._read(batch)
        bound = self._bound(batch, text, past_noise)
        t_B, edge_B = self.grid.time(draws.point_B), self.grid.lower(draws.point_B)
        z = self.own.enter(add_noise(SCHEDULE, bound.pull(batch.clean), draws.noise_BND, t_B))
        target, share_B = clean_target(
            SCHEDULE, self.grid, bound.guided(draws.w_B), bound.by(self.ema.module, draws.w_B), bound.push, bound.pull,
            z, draws.point_B,
        )  # fmt: skip
        made = bound.by(self.student, draws.w_B, rough)(bound.push(z), t_B)
        loss = _distance(made, target, over(share_B, made) * self.scale, batch.valid, config.huber)
        report = {"consistency": loss.detach()}
        if config.heading:
            turn_B = heading_error(made, target, batch.valid, self.data.codec, self.normalizer)
            loss = loss + config.heading * (turn_B * share_B).mean()
            report["heading"] = turn_B.mean().detach()
        if config.side_weight:
            joints, real = (placed(x, self.data.codec, self.normalizer) for x in (made, batch.clean))
            evenly_B = torch.ones_like(batch.turned)
            short = side_shortfall(joints, real, batch.valid, batch.sides, evenly_B, self.data.codec.skeleton)
            loss = loss + config.side_weight * short
            report["sides"] = short.detach()
        if config.trajectory_rows:
            trajectory = self._trajectory(batch, draws, z, past_noise)
            loss = loss + trajectory
            report["trajectory"] = trajectory.detach()
        if self.heads is not None:
            fooled, seen = self._judge(self.heads, bound, batch, draws, z, made, t_B, edge_B, loop)
            loss = loss + config.adversarial * fooled
            report |= seen
        if config.rollout_share:
            past = made.detach()  # of the streams
            self.own.go_on(past, bound.land(z, past, t_B, edge_B), self.course.turn(past).to(z))
        report["gradient_norm"] = loop.minimise(loss, "student")
        self.ema.update(self.student)
        return report | {"loss": loss.detach()}

    def _read(self, batch: SegmentBatch, augmented_by: torch.Generator | None = None) -> TextEmbedding:
        """The captions with the sides that are said beside them."""
        return with_sides(self.data.read(batch.captions, augmented_by), batch.sides)

    def _trajectory(self, batch: SegmentBatch, draws: Draws, z: Tensor, past_noise: Tensor | None) -> Tensor:
        """Distance to the teacher's whole way down a phase, for the first rows of a batch; streams from theirs."""
        batch = batch.rows(self.config.trajectory_rows)
        count = len(batch.index)
        running_B = self.alone[:count]
        text, w_B = self._read(batch), draws.w_B[:count]
        bound = self._bound(batch, text, None if past_noise is None else past_noise[:count])
        phase_B = torch.randint(self.config.phases, (count,), generator=self.draws, device=w_B.device)
        point_B = torch.where(running_B, draws.point_B[:count], self.grid.highest_of(phase_B))
        noisy = add_noise(SCHEDULE, bound.pull(batch.clean), draws.noise_BND[:count], self.grid.time(point_B))
        z = torch.where(over(running_B, noisy), z[:count], noisy)
        target = trajectory_target(SCHEDULE, self.grid, bound.guided(w_B), bound.push, bound.pull, z, point_B)
        rough = self._read(batch, self.draws)
        made = bound.by(self.student, w_B, rough)(bound.push(z), self.grid.time(point_B))
        loss = _distance(made, target, self.scale, batch.valid, self.config.huber)
        if self.config.heading:
            turn_B = heading_error(made, target, batch.valid, self.data.codec, self.normalizer)
            loss = loss + self.config.heading * turn_B.mean()
        return loss

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        """Mean squared distance to the teacher's 25 guided steps from the same noise, on captions of val."""
        batch = self.data.val.batch(64, 0, 0).to(loop.device)
        text, w = self.data.read(batch.captions), torch.full((64,), sum(self.config.guidance) / 2).to(loop.device)
        noise = torch.randn(batch.clean.shape, generator=torch.Generator().manual_seed(0)).to(loop.device)
        fresh = torch.Generator().manual_seed(1)
        bound = self._bound(batch, text, self._past_noise(noise, fresh) if self.config.overlapping else None)
        noise = self.teacher.colour(noise)
        if self._reference is None:
            self._reference = bound.sample(bound.guided(w), noise, levels(25))
        edges = self.grid.edges[::-1]
        valid = batch.valid[..., None]
        report = {}
        for name, network in (("student", self.student), ("ema", self.ema.module)):
            made = bound.sample(bound.by(cast(Denoiser, network), w), noise, edges)
            report[f"{name}_gap"] = float(
                ((made - self._reference).square() * valid).sum() / valid.sum() / made.shape[-1]
            )
        return report | {"teacher_std": float(self._reference.std()), "student_std": float(made.std())}

    def _past_noise(self, white_BnD: Tensor, generator: torch.Generator) -> Tensor | None:
        """Noise of noisy pasts, if there are such.

        Where the teacher alone is told it, a segment's own noise decides it: the teacher's way down is a function of
        that. The features' noises change places, so that to the teacher the two look independent, as in its training.
        """
        if self.config.overlapping:
            past_noise = torch.randn(white_BnD.shape, generator=generator, device=generator.device).to(white_BnD)
        elif self.config.context_noise_rollout:
            past_noise = white_BnD.roll(white_BnD.shape[-1] // 2, dims=-1)
        else:
            return None
        noise: Tensor = self.teacher.colour(past_noise)
        return noise

    def _bound(self, batch: SegmentBatch, text: TextEmbedding, past_noise: Tensor | None = None) -> BoundSegments:
        past = None
        if past_noise is not None:
            streams_B = self.alone[: len(batch.index)]  # a trajectory's rows are the first of a batch
            overlaps, pooled = self.config.overlapping, self.data.pooled(batch.previous_captions)
            level = self.grid.below if overlaps else lambda t_B: (NEARER * t_B).long() * streams_B
            past = NoisyPast(past_noise, pooled, level, to_all=overlaps)
        return BoundSegments(batch, text, self.data.read([""]), self.transport, self.teacher, past)

    def _coloured(self, draws: Draws) -> Draws:
        noises = ("noise_BND", "fake_noise_BND", "real_noise_BND")
        return replace(draws, **{name: self.teacher.colour(getattr(draws, name)) for name in noises})

    def _judge(
        self, heads: DiscriminatorHeads, bound: BoundSegments, batch: SegmentBatch, draws: Draws, z: Tensor,
        made: Tensor, t_B: Tensor, edge_B: Tensor, loop: Loop,
    ) -> tuple[Tensor, dict[str, Tensor]]:  # fmt: skip
        """How little the discriminator is fooled, after its own step; fake and real are noised to the judged time.

        Frames after a clip's end are not judged: there a take's are zeros, which nobody asks a student for.
        """
        clean = bound.pull(made)
        eps = predict_eps(SCHEDULE, z, clean, t_B)
        if self.config.rollout_share:
            # Their pasts alone would tell streams from takes, and nothing would be learned of what they settle into.
            bound = bound.alone(self.alone)
            clean = bound.pull(made)
        landed = add_noise(SCHEDULE, clean, eps, edge_B)
        fake = bound.push(renoise(SCHEDULE, landed, edge_B, draws.judged_B, draws.fake_noise_BND))
        seen = bound.features(fake, draws.judged_B)
        with torch.no_grad():
            real = bound.push(add_noise(SCHEDULE, bound.pull(batch.clean), draws.real_noise_BND, draws.judged_B))
            real_seen = bound.features(real, draws.judged_B)
            mismatched_seen = bound.mismatched().features(real, draws.judged_B) if self.config.mismatched_text else None
        seen, real_seen = _valid(seen, batch), _valid(real_seen, batch)
        mismatched_seen = None if mismatched_seen is None else _valid(mismatched_seen, batch)
        report = discriminator_step(heads, real_seen, seen, mismatched_seen, self.config.mismatched_text, loop)
        return hinge_generator(heads(seen)), report


def _valid(taps: list[Tensor], batch: SegmentBatch) -> list[Tensor]:
    """Feature maps (B, n, C) at valid frames alone: (frames, 1, C)."""
    return [tap_BnC[batch.valid][:, None] for tap_BnC in taps]


def _distance(made: Tensor, target: Tensor, weight: Tensor, valid_Bn: Tensor, c: float) -> Tensor:
    """Pseudo-Huber distance over valid frames."""
    each = huber((made - target) * weight, c).mean(dim=-1)
    return (each * valid_Bn).sum() / valid_Bn.sum().clamp_min(1)
