"""The published sizes and hyper-parameters, as far as the models go: HumanML3D or KIT-ML, sentence-T5 or CLIP, a GPU.

All models read HumanML3D's features, or KIT-ML's of its folder. Where RDM's paper leaves a choice they take the one
that holds up: every segment is noised around itself, one application of the flow, a segment number that only tells the
first from later ones, and any level of the segment before. The printed Algorithm 2 of RDM-N is

    --set grid.anchor=first --set grid.share_noise=true --set grid.condition=previous
    --set depth_cap=N-1 --set model.max_index=N-1 --set flow.max_index=N-1

with the number N - 1 written out; a text drop, for guidance, is ``--set condition_dropout=0.1``.

Source: MotionPCM (arXiv 2501.19083) on the VAE and denoiser of MotionLCM-V2 (arXiv 2404.19759); RDM (arXiv 2406.07169),
Sections 5 and 10; MotionDiffuse (arXiv 2208.15001), Light-T2M (arXiv 2412.11193), CLoSD (arXiv 2410.03441).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from moveset.data.segments import SEGMENT_FRAMES, CuttingConfig
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.flow import FlowConfig
from moveset.models.light_t2m import LightT2MConfig
from moveset.models.segment_denoiser import SegmentDenoiserConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.models.token_vae import TokenVAEConfig
from moveset.rdm.grid import GridConfig
from moveset.training.dip import DiPConfig
from moveset.training.distillation import DistillationConfig
from moveset.training.engine import EngineConfig
from moveset.training.evaluator import EvaluatorTrainingConfig, MovementTrainingConfig
from moveset.training.export import BaselineExport, ClipExport, EvaluatorExport, Export, StreamExport
from moveset.training.length import LengthConfig
from moveset.training.rdm import RDMConfig
from moveset.training.tasks import Recipe, variants
from moveset.training.teacher import TeacherConfig
from moveset.training.vae import VAETrainingConfig


def movement() -> Recipe:
    """T2M's movement autoencoder; 270 epochs of HumanML3D's windows are about 1.3 M steps at batch 128 as published."""
    return Recipe(task=MovementTrainingConfig(), engine=_engine(300_000))


def evaluator() -> Recipe:
    """T2M's matching networks; ``--set words=glove:FOLDER`` says where HumanML3D's table of words lies."""
    return Recipe(task=EvaluatorTrainingConfig(words="glove:glove", ema=0.0), engine=_engine(200_000))


def _engine(steps: int) -> EngineConfig:
    return EngineConfig(steps=steps, save_every=5000, validate_every=10000, grad_clip=1.0, precision="auto")


def train_vae() -> Recipe:
    """MotionLCM-V2's autoencoder: 6000 epochs of about 192 batches of 128."""
    return Recipe(
        task=VAETrainingConfig(
            model=TokenVAEConfig(),  # 18.06 M parameters
            codec="published",
            loss="published",
            kl=1e-4,
            batch=128,
            lr=2e-4,
            warmup=1000,
            beta2=0.999,
            ema=0.0,
        ),
        engine=_engine(1_150_000),
    )


def train_teacher() -> Recipe:
    """MotionLCM-V2's teacher: 3000 epochs, batch 64."""
    model = TokenDenoiserConfig()  # 8,237,856 parameters, as a student with its guidance embedding 8,434,464
    task = TeacherConfig(
        model=model, batch=64, lr=1e-4, warmup=1000, beta2=0.999, ema=0.0, normalised_latents=False,
        text_encoder="sentence-t5:sentence-transformers/sentence-t5-large",
    )  # fmt: skip
    return Recipe(task=task, engine=_engine(1_150_000))


def train_mld_vae() -> Recipe:
    """MLD's latent, one token of 256 numbers, in the autoencoder and the training of MotionLCM-V2."""
    chosen = train_vae()
    return replace(chosen, task=replace(chosen.task, model=TokenVAEConfig(tokens=1, token_dim=256)))


def train_mld() -> Recipe:
    """Its noise."""
    chosen = train_teacher()
    return replace(chosen, task=replace(chosen.task, model=TokenDenoiserConfig(token_dim=256)))


def train_lcm() -> Recipe:
    """MotionLCM-V2: 1000 epochs, batch 128, w in [5, 15], c = 0.5, k = 100."""
    return Recipe(task=DistillationConfig(text_encoder=train_teacher().task.text_encoder), engine=_engine(192_000))


def train_pcm(phases: int = 1) -> Recipe:
    """MotionPCM, Section 5.1: 384 K iterations; here every one updates both student and discriminator."""
    task = DistillationConfig(phases=phases, text_encoder=train_teacher().task.text_encoder)
    return Recipe(task=task, engine=_engine(384_000))


CLIP = "clip:openai/clip-vit-base-patch32"


def train_rdm(segments: int = 7) -> Recipe:
    """RDM-N: 50 epochs of HumanML3D's 24 thousand clips, each 50 times; RDM-1 has no flow and nothing before it.

    Gradients are not clipped: MoMo's model of the loss is made of them.
    """
    frames = SEGMENT_FRAMES[segments]
    recurrent = segments > 1
    model = SegmentDenoiserConfig(frames=frames, prev="xattn" if recurrent else "none", max_index=1 if recurrent else 0)
    task = RDMConfig(
        model=model,
        flow=FlowConfig(features=263, text_dim=512, bound="hardtanh") if recurrent else None,
        grid=GridConfig(frames=frames),
        depth_cap=1,
        codec="published",
        cutting=CuttingConfig(aligned=True, whole_caption=1.0),
        batch=512,
        optimizer="momo",
        lr=2e-4,
        flow_lr=1e-4,
        constant_lr=True,
        condition_dropout=0.0,
        ema=0.9999,
        weight="x0",
        root=1.0,
        velocity=0.0,
        isometry=0.0,
        frozen_flow=0.0,
        text_encoder=CLIP,
    )
    return Recipe(task=task, engine=replace(_engine(115_000), grad_clip=0.0))


def train_md(segments: int = 7) -> Recipe:
    """MD-N: the network of RDM-N told the finished segment before; ``--set md_condition=none`` tells it nothing."""
    chosen = train_rdm(segments)
    grid = replace(chosen.task.grid, condition="clean")
    return replace(chosen, task=replace(chosen.task, flow=None, grid=grid))


def train_light_rdm() -> Recipe:
    """Light-RDM-1: Light-T2M's network, 4.5 M parameters, in the training of RDM-1; its text drop allows guidance."""
    chosen = train_rdm(1)
    return replace(chosen, task=replace(chosen.task, model=LightT2MConfig(frames=196), condition_dropout=0.2))


def train_motiondiffuse() -> Recipe:
    """MotionDiffuse: 87 M parameters, predicts the noise; 50 epochs, each clip 25 times, batch 128, no average."""
    chosen = train_rdm(1)
    task = replace(chosen.task, predict="eps", optimizer="adamw", beta2=0.999, batch=128, ema=0.0)
    return replace(chosen, task=task, engine=replace(chosen.engine, steps=230_000, grad_clip=0.5))


def train_dip() -> Recipe:
    """DiP: 600 thousand batches of 64. Its own text encoder is DistilBERT; here, as elsewhere, CLIP."""
    task = DiPConfig(
        model=DipDecoderConfig(text_dim=512),
        codec="published",
        cutting=CuttingConfig(whole_caption=1.0),
        constant_lr=True,
        text_encoder=CLIP,
    )
    return Recipe(task=task, engine=_engine(600_000))


def train_length() -> Recipe:
    """How long a sentence lasts, by sentence-T5."""
    return Recipe(task=LengthConfig(text_encoder=train_teacher().task.text_encoder), engine=_engine(5_000))


TRAINING: dict[str, Callable[[], Recipe]] = {
    "movement": movement,
    "evaluator": evaluator,
    "length": train_length,
    "vae": train_vae,
    "teacher": train_teacher,
    "mld-vae": train_mld_vae,
    "mld": train_mld,
    "lcm-1": train_lcm,
    **{f"pcm-{phases}": partial(train_pcm, phases) for phases in (1, 2, 4)},
    **{f"rdm-{n}": partial(train_rdm, n) for n in SEGMENT_FRAMES},
    **{f"md-{n}": partial(train_md, n) for n in (4, 7)},
    "light-rdm-1": train_light_rdm,
    "motiondiffuse": train_motiondiffuse,
    "dip": train_dip,
}
TRAINING |= variants(TRAINING)

EXPORTS: tuple[Export, ...] = (
    ClipExport(
        name="motionpcm-paper",
        runs={name: name for name in ("vae", "teacher", "length", "lcm-1", "pcm-1", "pcm-2", "pcm-4")},
        # w = s - 1 for the scales s that MotionLCM-V2 prints, for the same number of steps; MotionPCM prints none.
        guidance={"teacher": 6.5, "lcm-1": 7.0, "pcm-1": 7.0, "pcm-2": 11.5, "pcm-4": 12.5},
        last=True,
    ),
    *(
        ClipExport(
            name=f"motionpcm-{name}-paper",
            runs={"vae": "vae", "teacher": "teacher", "length": "length", "pcm-1": f"pcm-1-{name}"},
            guidance={"teacher": 6.5, "pcm-1": 7.0},
            last=True,
        )
        for name in ("k20", "no-ema", "no-discriminator")
    ),
    ClipExport(
        name="mld-paper", runs={"vae": "mld-vae", "teacher": "mld", "length": "length"}, guidance={"teacher": 6.5},
        last=True,
    ),
    *(
        StreamExport(
            name=f"{name}-paper", runs=runs,
            sampling={"sampler_steps": 1000, "start": n, "eta": 1.0, "variance": "beta"},
        )
        for name, n, runs in (
            ("rdm", 7, {"rdm": "rdm-7"}),
            *((f"rdm-{n}", n, {"rdm": f"rdm-{n}"}) for n in (4, 14)),
            *((f"md-{n}", n, {"rdm": f"rdm-{n}", "md": f"md-{n}"}) for n in (4, 7)),
            ("md-7-alone", 7, {"rdm": "rdm-7", "md": "md-7-alone"}),
        )
    ),
    *(
        BaselineExport(name=f"{run}-paper", runs={"denoiser": run}, steps=1000, eta=1.0, variance=variance)
        for run, variance in
        (("rdm-1", "beta"), ("light-rdm-1", "beta"), ("motiondiffuse", "posterior"), ("dip", "posterior"))
    ),
    EvaluatorExport(name="t2m-paper", runs={"evaluator": "evaluator"}),
)  # fmt: skip
