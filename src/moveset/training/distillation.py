"""Distilling the teacher: MotionPCM's students for 1, 2 and 4 phases, and the latent consistency model as the baseline.

Both learn from the same teacher, data, solver grid and guidance range; PCM adds phases and the discriminator.
"""

from dataclasses import dataclass, field, replace
from typing import cast

import torch
from torch import Tensor, nn

from moveset.data.latents import LatentBatch
from moveset.data.text_augmentation import TextAugmentation
from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import add_noise, ddim_timesteps
from moveset.errors import InputError
from moveset.models.condition import Condition, Denoiser, Prediction, guided
from moveset.models.discriminator import DiscriminatorHeads
from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.registry import ModelConfig, require_range
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.motion.sides import more_left, shortfall
from moveset.pcm.consistency import (
    Draws,
    adversarial_pair,
    draw,
    lcm_prediction,
    lcm_target,
    phase_entry,
    phased_prediction,
    phased_target,
    trajectory_target,
)
from moveset.pcm.losses import hinge_generator, pseudo_huber
from moveset.pcm.sampler import lcm_timesteps, sample_ddim, sample_lcm, sample_phased
from moveset.text.encoder import TextEmbedding
from moveset.text.sides import forget, with_sides
from moveset.training.adversarial import AdversarialTask, discriminator_step, of_another
from moveset.training.ema import Ema
from moveset.training.engine import Loop
from moveset.training.single_network import NetworkConfig
from moveset.training.tasks import Sources
from moveset.training.teacher import LatentData, normalised_latents
from moveset.training.trained import load_trained, require_same_encoder


@dataclass(frozen=True, kw_only=True)
class StudentConfig(NetworkConfig):
    """How a student of clips or of segments learns; the learning rate is a cosine over the run.

    Args:
        points: solver points N of the grid (k = 1000 / N).
        phases: M, evaluations of a sample; 1 for LCM.
        guidance: range of the guidance scale w that the student is trained for.
        huber: c of the pseudo-Huber distance.
        adversarial: weight of the discriminator's verdict; 0 leaves the discriminator out.
        inference_points: share of a batch that is moved to the points which sampling evaluates; 0 as published.
        mismatched_text: share of real samples with the text of an item that shows something else in what the
            discriminator is to call fake, so that it judges what is said too; 0 as published.
        discriminator_max_noise: the lower part of a phase in which the discriminator looks; 1 as published.
        trajectory_rows: rows of a batch that are asked, besides, for what all of the teacher's steps lead to from where
            sampling enters a phase (``pcm.consistency.phase_entry`` and ``trajectory_target``, and
            ``rdm.distillation.trajectory_target``); 0 as published.
        ema: decay of the target network.
        model: the student's architecture; filled in from the teacher's.
    """

    points: int = 10
    phases: int = 1
    guidance: tuple[float, float] = (5.0, 15.0)
    huber: float = 0.5
    adversarial: float = 0.1
    inference_points: float = 0.0
    mismatched_text: float = 0.0
    discriminator_max_noise: float = 1.0
    trajectory_rows: int = 0
    ema: float = 0.95
    batch: int = 128
    lr: float = 2e-4
    warmup: int = 1000
    discriminator_lr: float = 1e-4
    text_encoder: str = "minilm"
    augmentation: TextAugmentation = field(default_factory=TextAugmentation)
    model: ModelConfig | None = None


def require_rows(config: StudentConfig, *names: str) -> None:
    """Raises InputError for more rows than a batch has. No check of the configuration: settings come one by one."""
    for name in names:
        require_range(f"rows that are {name}", getattr(config, name), 0, config.batch)


@dataclass(frozen=True, kw_only=True)
class DistillationConfig(StudentConfig):
    """What a student of clips is and how it learns.

    Args:
        sides: share of samples that are told which sides the motion favours, as their teacher's were.
        side_rows: rows of a batch that are asked, besides, to move that arm or leg more which they are told: decoded
            from where sampling begins, and judged as motion; 0 leaves it out.
        side_weight: of that.
    """

    sides: float = 0.0
    side_rows: int = 0
    side_weight: float = 0.15
    model: LatentDenoiserConfig | TokenDenoiserConfig | None = None


class _DistillationTask(AdversarialTask):
    """What LCM and PCM share: frozen teacher, student with its averaged target, one update from their distance."""

    def __init__(self, config: DistillationConfig, sources: Sources, loop: Loop) -> None:
        require_rows(config, "trajectory_rows", "side_rows")
        teacher = load_trained(sources.teacher, "teacher_ema", loop.device)
        require_same_encoder(config, teacher)
        loop.learned_from["teacher"] = teacher.digest
        normalised = normalised_latents(teacher)
        self.data = LatentData(sources, config.text_encoder, config.augmentation, loop, normalised, teacher)
        self.teacher = teacher.module
        self.student = self.teacher.student().requires_grad_(True)
        self.config = replace(config, model=self.student.config)
        self.ema = Ema(self.student, config.ema)
        self.schedule = scaled_linear()
        self.grid = PhaseGrid(config.points, config.phases)
        self.draws = loop.generator("draws")
        self.optimizer = torch.optim.AdamW(self.student.parameters(), config.lr, betas=(0.9, 0.999), weight_decay=0.0)
        self._reference: Tensor | None = None

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        config = self.config
        batch = self.data.batch(config.batch, step)
        text = self.data.told(batch, batch.captions, config.sides, self.draws)
        shares = (config.inference_points, config.discriminator_max_noise)
        draws = draw(self.grid, batch.z0, config.guidance, self.draws, *shares)
        z = add_noise(self.schedule, batch.z0, draws.noise_BND, self.grid.time(draws.point_B))
        teacher, ema, student = (
            self._guided(network, text, batch.frames, draws.w_B)
            for network in (self.teacher, self.ema.module, self.student)
        )
        target = self.target(teacher, ema, z, draws.point_B)
        made = self.predict(student, z, draws.point_B)
        loss = pseudo_huber(made, target, config.huber)
        report = {"consistency": loss.detach()}
        loss = loss + self._trajectory(batch, draws, report)
        if config.side_rows:
            loss = loss + config.side_weight * self._on_sides(batch, draws, report)
        if self.heads is not None and config.adversarial:
            fooled = hinge_generator(self.heads(self._judged(self.heads, batch, text, draws, made, report, loop)))
            report["generator"] = fooled.detach()
            loss = loss + config.adversarial * fooled
        report["gradient_norm"] = loop.minimise(loss, "student")
        self.ema.update(self.student)
        return report | {"loss": loss.detach()}

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        """Mean squared distance in the latent to the teacher's 50 guided steps from the same noise, captions of val."""
        batch = self.data.val.batch(32, 0, 0).to(loop.device)
        text, w = self.data.read(batch.captions), sum(self.config.guidance) / 2
        noise = torch.randn(batch.z0.shape, generator=torch.Generator().manual_seed(0)).to(batch.z0)
        if self._reference is None:
            self._reference = sample_ddim(
                self._guided(self.teacher, text, batch.frames, w), self.schedule, ddim_timesteps(50), noise
            )
        report = {}
        for name, network in (("student", self.student), ("ema", self.ema.module)):
            made = self.sample(self._guided(network, text, batch.frames, w), noise)
            report[f"{name}_gap"] = float((made - self._reference).square().mean())
        return report | {"teacher_std": float(self._reference.std()), "student_std": float(made.std())}

    def sample(self, model: Prediction, noise: Tensor) -> Tensor:
        """Latents by this student."""
        raise NotImplementedError

    def predict(self, student: Prediction, z: Tensor, point_B: Tensor) -> Tensor:
        """Where this student lands from a solver point."""
        raise NotImplementedError

    def target(self, teacher: Prediction, ema: Prediction, z: Tensor, point_B: Tensor) -> Tensor:
        """Where it should land."""
        raise NotImplementedError

    def _trajectory(self, batch: LatentBatch, draws: Draws, report: dict[str, Tensor]) -> Tensor | float:
        """Distance to where the teacher's whole way through a phase leads, for the first rows of a batch; reported."""
        if not (count := self.config.trajectory_rows):
            return 0.0
        rows, w_B = batch.rows(count), draws.w_B[:count]
        text, frames = self.data.told(rows, rows.captions, self.config.sides, self.draws), rows.frames
        phase_B = torch.randint(self.grid.phases, (count,), generator=self.draws).to(w_B.device)
        point_B = self.grid.highest_of(phase_B)
        noise = torch.randn(rows.z0.shape, generator=self.draws).to(batch.z0)
        teacher, ema, student = (
            self._guided(network, text, frames, w_B) for network in (self.teacher, self.ema.module, self.student)
        )
        z = phase_entry(self.schedule, self.grid, ema, noise, phase_B)
        target = trajectory_target(self.schedule, self.grid, teacher, z, point_B)
        made = self.predict(student, z, point_B)
        loss = pseudo_huber(made, target, self.config.huber)
        report["trajectory"] = loss.detach()
        return loss

    def _on_sides(self, batch: LatentBatch, draws: Draws, report: dict[str, Tensor]) -> Tensor:
        """By how much arms and legs that are told to move more fail to, in what is made of noise; reported.

        Of a distance in the latent an arm is a hundredth: what is asked for is looked at where it shows, in the motion,
        as the control of MotionLCM is (arXiv 2404.19759).
        """
        favours = batch.sides[:, :2].any(dim=1).nonzero()[: self.config.side_rows, 0]
        if not len(favours):
            report["sides"] = batch.z0.new_zeros(())
            return report["sides"]
        captions, frames = [batch.captions[k] for k in favours.tolist()], batch.frames[favours]
        sides_B3 = forget(batch.sides[favours], 0.0, self.draws)
        text = with_sides(self.data.read(captions, self.draws), sides_B3)
        noise = torch.randn(batch.z0[favours].shape, generator=self.draws).to(batch.z0)
        point_B = self.grid.highest_of(torch.full_like(frames, self.grid.phases - 1))
        student = self._guided(self.student, text, frames, draws.w_B[favours])
        made_BND = lcm_prediction(self.schedule, student, noise, self.grid.time(point_B))
        made_BFJ3 = self.data.joints(made_BND, frames)
        told_B2 = sides_B3[:, :2].nan_to_num()
        short_B2 = shortfall(more_left(made_BFJ3, frames, self.data.codec.skeleton), told_B2) * told_B2.abs()
        loss = short_B2.sum() / told_B2.abs().sum().clamp(min=1.0)
        report["sides"] = loss.detach()
        return loss

    def _judged(
        self, heads: DiscriminatorHeads, batch: LatentBatch, text: TextEmbedding, draws: Draws, made: Tensor,
        report: dict[str, Tensor], loop: Loop,
    ) -> list[Tensor]:  # fmt: skip
        """One step of the discriminator, reported; returns the features of what the student made, for its own step."""
        fake, real = adversarial_pair(self.schedule, self.grid, draws, made, batch.z0)
        condition, s_B = Condition(text, length=batch.frames), draws.judged_B
        seen = self._features(fake, s_B, condition)
        with torch.no_grad():
            real_seen = self._features(real, s_B, condition)
            others_seen = None
            if self.config.mismatched_text:
                others = replace(condition, text=text[torch.tensor(of_another(batch.contents), device=real.device)])
                others_seen = self._features(real, s_B, others)
        report |= discriminator_step(heads, real_seen, seen, others_seen, self.config.mismatched_text, loop)
        return seen

    def _features(self, z_BND: Tensor, s_B: Tensor, condition: Condition) -> list[Tensor]:
        """K feature maps (B, N, C) of the frozen teacher, of latents noised to s (B,): for both steps, one pass."""
        taps: list[Tensor] = []
        self.teacher(z_BND, s_B, condition, taps)
        return taps

    def _guided(self, network: nn.Module, text: TextEmbedding, frames: Tensor, w: Tensor | float) -> Prediction:
        """The teacher, or a student, with captions, lengths and guidance bound."""
        return guided(cast(Denoiser, network), Condition(text, length=frames), w, self.data.read([""]))


class LCMTask(_DistillationTask):
    """The latent consistency model of MotionLCM: every point of the trajectory maps to its origin.

    Raises:
        InputError: more than one phase.
    """

    name = "lcm"
    unused = ("adversarial", "mismatched_text", "discriminator_max_noise", "discriminator_lr")

    def __init__(self, config: DistillationConfig, sources: Sources, loop: Loop) -> None:
        if config.phases != 1:
            raise InputError(f"phases={config.phases} is for pcm; an lcm student has one phase, so leave it out")
        super().__init__(config, sources, loop)

    def target(self, teacher: Prediction, ema: Prediction, z: Tensor, point_B: Tensor) -> Tensor:
        return lcm_target(self.schedule, self.grid, teacher, ema, z, point_B)

    def predict(self, student: Prediction, z: Tensor, point_B: Tensor) -> Tensor:
        return lcm_prediction(self.schedule, student, z, self.grid.time(point_B))

    def sample(self, model: Prediction, noise: Tensor) -> Tensor:
        return sample_lcm(model, self.schedule, lcm_timesteps(1, self.config.points), [noise])


class PCMTask(_DistillationTask):
    """MotionPCM (Section 4): consistency inside each of M phases, a discriminator on the frozen teacher's features."""

    name = "pcm"

    def __init__(self, config: DistillationConfig, sources: Sources, loop: Loop) -> None:
        super().__init__(config, sources, loop)
        batch = self.data.val.batch(1, 0, 0).to(loop.device)
        condition = Condition(self.data.read(batch.captions), length=batch.frames)
        with torch.no_grad():
            taps = self._features(batch.z0, torch.zeros_like(batch.frames), condition)
        self.make_heads(taps[0].shape[-1], len(taps), loop)

    def target(self, teacher: Prediction, ema: Prediction, z: Tensor, point_B: Tensor) -> Tensor:
        return phased_target(self.schedule, self.grid, teacher, ema, z, point_B)

    def sample(self, model: Prediction, noise: Tensor) -> Tensor:
        return sample_phased(model, self.schedule, self.grid, noise)

    def predict(self, student: Prediction, z: Tensor, point_B: Tensor) -> Tensor:
        return phased_prediction(self.schedule, self.grid, student, z, point_B)
