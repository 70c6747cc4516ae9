"""What ships: the same methods at sizes that two processor cores train in hours and run in milliseconds."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from moveset.data.segments import SEGMENT_FRAMES, CuttingConfig
from moveset.data.text_augmentation import TextAugmentation
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.evaluator import EvaluatorConfig, MovementConfig
from moveset.models.flow import FlowConfig
from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.light_t2m import LightT2MConfig
from moveset.models.segment_denoiser import SegmentDenoiserConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.models.timed_vae import TimedVAEConfig
from moveset.pipelines.role import is_student
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
from moveset.training.tasks import Recipe, variants
from moveset.training.teacher import TeacherConfig
from moveset.training.vae import VAETrainingConfig
from moveset.training.vae_loss import ReconstructionWeights


def vae() -> Recipe:
    """4.1 M parameters; 16 latent tokens of 64 numbers: what people do is more than walking."""
    # Gradients are of norm 8 to 12: a lower limit would be a constant step.
    return Recipe(task=VAETrainingConfig(model=_VAE, weights=_ON_FLOOR), engine=_engine(9000, grad_clip=20.0))


def decoder() -> Recipe:
    """The decoder again, on slightly wrong latents: it runs while the teacher learns the finished latents."""
    task = VAETrainingConfig(
        model=_VAE, weights=_ON_FLOOR, batch=32, lr=5e-4, latent_noise=0.3, balance=0.5
    )  # fmt: skip
    return Recipe(task=task, engine=_engine(1500, grad_clip=20.0))


def teacher() -> Recipe:
    """5.9 M parameters, text as token states."""
    model = LatentDenoiserConfig(token_dim=_VAE.token_dim)
    task = TeacherConfig(model=model, batch=128, lr=8e-4, weight="v", sides=SIDES, augmentation=AUGMENTATION)
    return Recipe(task=task, engine=_engine(10000))


def mld_vae() -> Recipe:
    """MLD's single latent: one token of 256 numbers for a whole clip, in an otherwise equal autoencoder."""
    chosen = vae()
    model = replace(_VAE, tokens=1, slots=48, token_dim=256)
    return replace(chosen, task=replace(chosen.task, model=model))


def mld() -> Recipe:
    """Its noise, which is carried past the layers (docs/decisions/clips.md)."""
    chosen = teacher()
    model = replace(chosen.task.model, tokens=1, token_dim=256, carried=True)
    return replace(chosen, task=replace(chosen.task, model=model))


def lcm() -> Recipe:
    """The one-step baseline: PCM of one phase without its discriminator; guidance around the teacher's best."""
    task = DistillationConfig(
        guidance=GUIDANCE, batch=64, lr=3e-4, warmup=100, sides=SIDES, augmentation=AUGMENTATION,
        # Beyond the papers, and the same for both methods (docs/decisions/clips.md).
        inference_points=0.5, trajectory_rows=8, side_rows=12,
    )  # fmt: skip
    return Recipe(task=task, engine=_engine(STUDENTS))


def pcm(phases: int = 1) -> Recipe:
    """MotionPCM of one, two or four evaluations; its discriminator reads, and looks where it can see."""
    task = replace(lcm().task, phases=phases, discriminator_lr=1e-3, mismatched_text=0.5, discriminator_max_noise=0.5)
    if phases > 1:  # what they make of noise is no motion yet: asked for limbs, it shrinks
        task = replace(task, side_rows=0)
    return Recipe(task=task, engine=_engine(STUDENTS))


def rdm(segments: int = 7) -> Recipe:
    """RDM-N; RDM-7, segments of 28 frames, 5.0 M parameters and a flow of 0.2 M, is what ships."""
    if segments == 1:
        return _volume(RDMConfig(velocity=2.0, augmentation=AUGMENTATION))
    return Recipe(
        task=RDMConfig(
            model=SegmentTransformerConfig(smoothing=0.3, heading_change=True),
            grid=GridConfig(frames=SEGMENT_FRAMES[segments], clean_share=0.3),
            flow=FlowConfig(blocks=2, hidden=64, text_context=32, index_context=8),
            frozen_flow=0.4,
            velocity=1.0,
            noise="coloured",
            forecast=True,
            feet=3.0,
            heading=HEADING,
            past_perturbation=BENT,
            **TOLD,
            sides=SIDES,
            side_weight=0.3,
            cutting=STREAMED,
            augmentation=AUGMENTATION,
        ),
        engine=_engine(_alike(64, SEGMENT_FRAMES[segments])),
    )


def md(segments: int = 7) -> Recipe:
    """MD-N: each segment from noise, told the finished one before; no flow, no noisy recurrence."""
    chosen = rdm(segments)
    grid = replace(chosen.task.grid, condition="clean", clean_share=0.0)
    return replace(chosen, task=replace(chosen.task, flow=None, grid=grid))


def light_rdm() -> Recipe:
    """Light-RDM-1: Light-T2M's denoiser, 4.5 M parameters, in the training of RDM-1."""
    chosen = rdm(1)
    return replace(chosen, task=replace(chosen.task, model=LightT2MConfig(frames=196, text_dim=384, pool="mean")))


def motiondiffuse() -> Recipe:
    """MotionDiffuse with 384 channels in four layers: the noise of whole clips."""
    model = SegmentDenoiserConfig(
        text_dim=384, width=384, layers=4, heads=6, feed_forward=768, conditioning=512, text_width=192, text_layers=1,
        text_feed_forward=768,
    )  # fmt: skip
    # Without condition dropout there is no guidance, as published.
    task = RDMConfig(
        model=model, predict="eps", weight="x0", root=1.0, lr=3e-4, condition_dropout=0.0, augmentation=AUGMENTATION
    )
    return _volume(task)


def dip() -> Recipe:
    """DiP at width 256 and four layers: 40 frames from the 20 before."""
    model = DipDecoderConfig(text_dim=384, width=256, layers=4)
    return Recipe(
        task=DiPConfig(model=model, lr=3e-4, ema=0.999, root=5.0, standing=0.2, augmentation=AUGMENTATION),
        engine=_engine(_alike(64, model.frames)),
    )


def rdm_student() -> Recipe:
    """RDM-7 in one evaluation a segment; ``--set phases=2`` and ``--set phases=4`` for more."""
    task = RDMStudentConfig(
        batch=32,
        warmup=50,
        tremor=1.0,
        trajectory_rows=8,
        # What keeps streams alive: rows that go on from what the student made, and a strong judge that looks at them.
        rollout_share=0.5,
        adversarial=0.4,
        context_noise_rollout=True,
        **TOLD,
        sides=SIDES,
        side_weight=0.15,
        heading=HEADING,
        past_perturbation=BENT,
        cutting=STREAMED,
        augmentation=AUGMENTATION,
    )
    return Recipe(task=task, engine=_engine(600))


def movement() -> Recipe:
    """Half the published width: 0.6 M parameters of the evaluator."""
    task = MovementTrainingConfig(model=MovementConfig(width=256, latent=256), lr=1e-3, warmup=100)
    return Recipe(task=task, engine=_judge(1500))


def evaluator() -> Recipe:
    """The judge of this corpus, 2.2 M parameters; noise and dropout keep it from learning its clips by heart."""
    model = EvaluatorConfig(
        movement_width=256,
        movement_latent=256,
        word_width=384,
        speech_classes=0,
        text_hidden=192,
        motion_hidden=256,
        joint=128,
        hidden_dropout=0.1,
    )
    task = EvaluatorTrainingConfig(model=model, batch=64, lr=1e-3, warmup=100, negatives="all", noise=0.05)
    return Recipe(task=task, engine=_judge(1500))


def length() -> Recipe:
    """How long a sentence lasts: 0.1 M parameters, a minute."""
    # Once through all captions: seen more often, lengths are learned of the very words.
    engine = EngineConfig(steps=800, save_every=400, validate_every=400, precision="32-true", threads=1)
    return Recipe(task=LengthConfig(), engine=engine)


def sides() -> Recipe:
    """Which side a sentence names: 0.03 M parameters, a minute."""
    engine = EngineConfig(steps=1500, save_every=500, validate_every=500, precision="32-true", threads=1)
    return Recipe(task=SidesConfig(), engine=engine)


def _judge(steps: int) -> EngineConfig:
    return EngineConfig(steps=steps, save_every=500, validate_every=250, grad_clip=0.5, precision="32-true", threads=1)


def _engine(steps: int, grad_clip: float = 1.0) -> EngineConfig:
    return EngineConfig(steps=steps, validate_every=500, grad_clip=grad_clip, threads=1)


# The published range [5, 15] is far too strong here: at 3.5 motion trembles a fifth more than takes do.
GUIDANCE = (1.0, 4.0)
STUDENTS = 450  # steps, the same for all: they are compared
# Of every clip it is known which sides it favours; in use hardly any sentence names one.
SIDES = 0.7
STREAMS = 25_200  # of RDM-7
# No words go missing: "left" and "right" are words too, and sentences of people are many.
AUGMENTATION = TextAugmentation(embedding_noise=0.05)
_VAE = TimedVAEConfig(token_dim=64)
_ON_FLOOR = ReconstructionWeights(floor=300.0)
# Streams walk straight and stand still (docs/streaming.md).
HEADING, BENT = 5.0, 0.1
# Half of the segments are told how far their way has turned (docs/decisions/streams.md).
TOLD = {"heading_change": 0.5, "heading_noise": 0.45}
STREAMED = CuttingConfig(take_share=0.3, changes=0.25, livelier=0.6)


def _volume(task: RDMConfig) -> Recipe:
    """One segment as long as the longest clip: whole clips, and no flow."""
    cutting = CuttingConfig(aligned=True, whole_caption=1.0)
    grid = GridConfig(frames=SEGMENT_FRAMES[1])
    task = replace(task, flow=None, grid=grid, cutting=cutting, batch=16)
    return Recipe(task=task, engine=_engine(_alike(task.batch, grid.frames)))


def _alike(batch: int, frames: int) -> int:
    """Steps in which as many frames of motion are shown as to RDM-7: what is compared has one budget."""
    return STREAMS * 64 * SEGMENT_FRAMES[7] // (batch * frames)


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
    "lcm-1": lcm,
    **{f"pcm-{phases}": partial(pcm, phases) for phases in (1, 2, 4)},
    **{f"rdm-{n}": partial(rdm, n) for n in SEGMENT_FRAMES},
    **{f"md-{n}": partial(md, n) for n in (4, 7)},
    "rdm-student": rdm_student,
    "light-rdm-1": light_rdm,
    "motiondiffuse": motiondiffuse,
    "dip": dip,
}
TRAINING |= variants(TRAINING)

# What the models do well, looked at.
_CLIPS = (
    "a person waves with the right hand",
    "a person walks forward and turns left",
    "a person does a cartwheel",
    "a person sits down",
    "a person kicks with the right leg",
    "a person crawls",
    "a person picks something up from the floor",
    "a person runs forward",
    "a person climbs a ladder",
    "a person dances",
    "a person jumps forward",
    "a boxer throws punches",
    "a person swings a golf club",
    "a person walks in a circle to the right",
    "a person swims",
    "a person squats down and gets up again",
    "a person marches",
    "a person walks backwards",
    "somebody plays the violin",
    "a person falls down",
    "a person sneaks along",
)
_STREAMS = (
    "a person walks forward",
    "a person sits down",
    "a person stands up",
    "a person waves with the left hand",
    "a person runs",
    "a person kicks with the right leg",
    "a person turns around to the left",
    "a person crawls",
    "a person jumps",
    "a person dances",
    "a person punches",
    "a person walks backwards",
    "a person squats",
    "a person marches",
    "a person walks in a circle to the right",
    "a person picks something up from the floor",
    "a person raises both arms",
    "a person stands still",
)

EXPORTS: tuple[Export, ...] = (
    ClipExport(
        name="motionpcm-small",
        runs={run: run for run in ("vae", "decoder", "teacher", "length", "sides", "lcm-1", "pcm-1", "pcm-2", "pcm-4")},
        guidance={"teacher": 2.5, "lcm-1": 2.5, "pcm-1": 3.5, "pcm-2": 3.0, "pcm-4": 3.0},
        compact=("teacher",),
        examples=_CLIPS,
    ),
    *(
        ClipExport(
            name=f"motionpcm-{name}-small",
            runs={run: run for run in ("vae", "decoder", "teacher", "length", "sides")} | {"pcm-1": f"pcm-1-{name}"},
            guidance={"teacher": 2.5, "pcm-1": 3.5},
            compact=("teacher",),
        )
        for name in ("k20", "no-ema", "no-discriminator")
    ),
    ClipExport(
        name="mld-small",
        runs={"vae": "mld-vae", "teacher": "mld", "length": "length", "sides": "sides"},
        guidance={"teacher": 2.5},
    ),
    StreamExport(
        name="rdm-small",
        runs={"rdm": "rdm-7", "pcm-1": "rdm-student", "sides": "sides"},
        guidance={"rdm": 2.0, "pcm-1": 2.0},
        tremor={"rdm": 1.0},
        sampling={
            "network": "rdm", "sampler_steps": 10, "start": 10, "lag": 10, "past_lag": 1, "eps_scale": 1.05,
            "time_shift": 0.1, "symmetric": ("pcm-1",),
        },
        compact=("rdm",),
        examples=_STREAMS,
    ),
    *(
        StreamExport(
            name=f"{name}-small", runs=runs | {"sides": "sides"}, guidance=dict.fromkeys(runs, guidance),
            tremor={network: 1.0 for network in runs if not is_student(network)},
            sampling={
                "sampler_steps": 10, "start": 10, "lag": 10, "eps_scale": 1.05, "time_shift": 0.1,
                "symmetric": tuple(network for network in runs if is_student(network)),
            },
        )
        for name, runs, guidance in (
            ("rdm-4", {"rdm": "rdm-4"}, 1.5),
            ("md-4", {"rdm": "rdm-4", "md": "md-4"}, 1.5),
            ("md-7", {"rdm": "rdm-7", "md": "md-7"}, 2.0),
            ("rdm-14", {"rdm": "rdm-14"}, 1.5),
            ("md-7-alone", {"rdm": "rdm-7", "md": "md-7-alone"}, 2.0),
            ("rdm-2-steps", {"rdm": "rdm-7", "pcm-2": "rdm-student-2"}, 2.0),
        )
    ),
    *(
        BaselineExport(name=f"{run}-small", runs={"denoiser": run}, guidance={"denoiser": 1.5}, steps=10)
        for run in ("rdm-1", "light-rdm-1")
    ),
    *(BaselineExport(name=f"{run}-small", runs={"denoiser": run}) for run in ("motiondiffuse", "dip")),
    EvaluatorExport(name="t2m-small", runs={"evaluator": "evaluator"}),
)  # fmt: skip

# What trainings took on a core that multiplies bfloat16, baselines by their share of rdm-7's time on another: by these
# and by how it goes, `moveset train all` says how much is left.
HOURS = {
    "movement": 0.12, "evaluator": 0.35, "length": 0.05, "sides": 0.05, "vae": 1.1, "decoder": 0.1, "teacher": 0.9,
    "lcm-1": 0.15, "pcm-1": 0.15, "pcm-2": 0.15, "pcm-4": 0.15,
    "pcm-1-k20": 0.25, "pcm-1-no-ema": 0.15, "pcm-1-no-discriminator": 0.15,
    "rdm-7": 2.5, "md-7": 1.75, "md-7-alone": 1.75, "rdm-4": 2.5, "rdm-14": 2.9, "md-4": 1.75, "rdm-student": 0.15,
    "rdm-student-2": 0.15, "rdm-1": 2.4, "light-rdm-1": 1.65, "motiondiffuse": 3.0, "dip": 2.8,
}  # fmt: skip
