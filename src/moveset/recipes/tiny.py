"""Seconds on any machine: every part of the real thing, too small to be any good. For tests and trying things out."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from moveset.data.segments import SEGMENT_FRAMES, CuttingConfig
from moveset.data.text_augmentation import TextAugmentation
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.evaluator import EvaluatorConfig, MovementConfig
from moveset.models.flow import FlowConfig
from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.length import LengthPredictorConfig
from moveset.models.light_t2m import LightT2MConfig
from moveset.models.segment_denoiser import SegmentDenoiserConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.models.sides import SidePredictorConfig
from moveset.models.timed_vae import TimedVAEConfig
from moveset.rdm.grid import GridConfig
from moveset.training.dip import DiPConfig
from moveset.training.distillation import DistillationConfig
from moveset.training.engine import EngineConfig
from moveset.training.evaluator import EvaluatorTrainingConfig, MovementTrainingConfig
from moveset.training.export import BaselineExport, ClipExport, EvaluatorExport, Export, StreamExport
from moveset.training.length import LengthConfig
from moveset.training.rdm import RDMConfig
from moveset.training.rdm_distillation import RDMStudentConfig
from moveset.training.sides import SidesConfig
from moveset.training.tasks import Recipe
from moveset.training.teacher import TeacherConfig
from moveset.training.vae import VAETrainingConfig

_ENGINE = EngineConfig(steps=4, save_every=2, validate_every=4, log_every=1, precision="32-true", tensorboard=False)
_ROUGH = TextAugmentation(token_dropout=0.1, embedding_noise=0.1)
_VAE = TimedVAEConfig(width=32, frame_width=16, encoder_blocks=1, decoder_blocks=1, token_blocks=1, frame_blocks=1)


def vae() -> Recipe:
    """About 0.1 M parameters."""
    return Recipe(task=VAETrainingConfig(model=_VAE, batch=4, warmup=1), engine=_ENGINE)


def decoder() -> Recipe:
    """More of the same decoder."""
    return Recipe(task=VAETrainingConfig(model=_VAE, batch=4, warmup=1, latent_noise=0.3), engine=_ENGINE)


def teacher() -> Recipe:
    """Three blocks of width 32."""
    model = LatentDenoiserConfig(width=32, heads=2, hidden=32, blocks=3)
    return Recipe(task=TeacherConfig(model=model, batch=4, warmup=1, augmentation=_ROUGH), engine=_ENGINE)


def mld_vae() -> Recipe:
    """One latent token."""
    return Recipe(task=replace(vae().task, model=replace(_VAE, tokens=1, slots=6, token_dim=24)), engine=_ENGINE)


def mld() -> Recipe:
    """Its noise."""
    chosen = teacher()
    model = replace(chosen.task.model, tokens=1, token_dim=24, carried=True)
    return replace(chosen, task=replace(chosen.task, model=model))


def student(phases: int = 1) -> Recipe:
    """LCM, or MotionPCM with its discriminator."""
    task = DistillationConfig(phases=phases, guidance=(1.0, 5.0), batch=4, warmup=1, augmentation=_ROUGH)
    return Recipe(task=task, engine=_ENGINE)


_RECURRENT = SegmentTransformerConfig(width=32, heads=2, hidden=32, blocks=2)
_PUBLISHED = SegmentDenoiserConfig(
    width=32, layers=1, heads=2, feed_forward=32, conditioning=32, text_width=16, text_layers=1, text_heads=2,
    text_feed_forward=32,
)  # fmt: skip


def rdm(segments: int = 7) -> Recipe:
    """The kind of network that ships, two blocks of width 32, and a flow of two."""
    if segments == 1:
        return _volume(RDMConfig(model=_PUBLISHED))
    task = RDMConfig(
        model=_RECURRENT,
        flow=FlowConfig(blocks=2, hidden=8, text_context=4, index_context=4),
        grid=GridConfig(frames=SEGMENT_FRAMES[segments]),
        batch=4,
        warmup=1,
        velocity=2.0,
        sides=0.7,
        augmentation=_ROUGH,
    )
    return Recipe(task=task, engine=_ENGINE)


def md(segments: int = 7) -> Recipe:
    """The same without flow, told the finished segment."""
    chosen = rdm(segments)
    grid = replace(chosen.task.grid, condition="clean")
    return replace(chosen, task=replace(chosen.task, flow=None, grid=grid))


def light_rdm() -> Recipe:
    """One stage of width 32."""
    model = LightT2MConfig(width=32, stages=1, groups=4, states=4, expand=1, rank=4, pool="mean")
    return _volume(RDMConfig(model=model))


def motiondiffuse() -> Recipe:
    """One layer of the published network that says the noise."""
    return _volume(RDMConfig(model=_PUBLISHED, predict="eps", weight="x0"))


def dip() -> Recipe:
    """Two layers of width 32: 8 frames from the 4 before."""
    model = DipDecoderConfig(prefix=4, frames=8, width=32, layers=2, heads=2, feed_forward=32)
    return Recipe(task=DiPConfig(model=model, batch=4, warmup=1, augmentation=_ROUGH), engine=_ENGINE)


def rdm_student() -> Recipe:
    """One evaluation a segment."""
    task = RDMStudentConfig(
        batch=4,
        warmup=1,
        tremor=1.0,
        trajectory_rows=2,
        heading=1.0,
        past_perturbation=0.1,
        sides=0.7,
        augmentation=_ROUGH,
    )
    return Recipe(task=task, engine=_ENGINE)


def movement() -> Recipe:
    """A width of 16."""
    return Recipe(task=MovementTrainingConfig(model=MovementConfig(width=16, latent=16), batch=4), engine=_ENGINE)


def evaluator() -> Recipe:
    """Widths of 16."""
    model = EvaluatorConfig(
        movement_width=16,
        movement_latent=16,
        word_width=384,
        speech_classes=0,
        text_hidden=16,
        motion_hidden=16,
        joint=8,
    )
    return Recipe(task=EvaluatorTrainingConfig(model=model, batch=4), engine=_ENGINE)


def length() -> Recipe:
    """A width of 16."""
    model = LengthPredictorConfig(width=16)
    return Recipe(task=LengthConfig(model=model, batch=8), engine=_ENGINE)


def sides() -> Recipe:
    """A width of 8."""
    return Recipe(task=SidesConfig(model=SidePredictorConfig(width=8), batch=8), engine=_ENGINE)


def _volume(task: RDMConfig) -> Recipe:
    cutting = CuttingConfig(aligned=True, whole_caption=1.0)
    grid = GridConfig(frames=SEGMENT_FRAMES[1])
    return Recipe(
        task=replace(task, flow=None, grid=grid, cutting=cutting, batch=2, warmup=1, augmentation=_ROUGH),
        engine=_ENGINE,
    )


TRAINING: dict[str, Callable[[], Recipe]] = {
    "movement": movement,
    "evaluator": evaluator,
    "length": length,
    "sides": sides,
    "vae": vae,
    "decoder": decoder,
    "teacher": teacher,
    "mld-vae": mld_vae,
    "mld": mld,
    "lcm-1": student,
    **{f"pcm-{phases}": partial(student, phases) for phases in (1, 2, 4)},
    **{f"rdm-{n}": partial(rdm, n) for n in SEGMENT_FRAMES},
    **{f"md-{n}": partial(md, n) for n in (4, 7)},
    "rdm-student": rdm_student,
    "light-rdm-1": light_rdm,
    "motiondiffuse": motiondiffuse,
    "dip": dip,
}

EXPORTS: tuple[Export, ...] = (
    ClipExport(
        name="motionpcm-tiny",
        runs={run: run for run in ("vae", "decoder", "teacher", "length", "sides", "lcm-1", "pcm-1", "pcm-2", "pcm-4")},
        guidance=dict.fromkeys(("teacher", "lcm-1", "pcm-1", "pcm-2", "pcm-4"), 2.0),
        compact=("teacher",),
    ),
    ClipExport(
        name="mld-tiny", runs={"vae": "mld-vae", "teacher": "mld", "length": "length"}, guidance={"teacher": 2.0}
    ),
    StreamExport(
        name="rdm-tiny",
        runs={"rdm": "rdm-7", "pcm-1": "rdm-student", "sides": "sides"},
        guidance={"rdm": 1.5, "pcm-1": 1.5},
        sampling={"network": "pcm-1", "sampler_steps": 4, "start": 4, "symmetric": ("pcm-1",)},
    ),
    StreamExport(
        name="md-7-tiny", runs={"rdm": "rdm-7", "md": "md-7", "sides": "sides"}, guidance={"rdm": 1.5, "md": 1.5},
        sampling={"sampler_steps": 4, "start": 4},
    ),
    *(
        BaselineExport(name=f"{run}-tiny", runs={"denoiser": run}, steps=4)
        for run in ("rdm-1", "light-rdm-1", "motiondiffuse", "dip")
    ),
    EvaluatorExport(name="t2m-tiny", runs={"evaluator": "evaluator"}),
)  # fmt: skip
