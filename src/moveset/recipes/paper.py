"""The published sizes and hyper-parameters, as far as the models go: HumanML3D or KIT-ML, sentence-T5, a GPU.

Source: MotionPCM (arXiv 2501.19083) on the VAE and denoiser of MotionLCM-V2 (arXiv 2404.19759).
"""

from collections.abc import Callable

from moveset.models.discriminator import DiscriminatorConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.models.token_vae import TokenVAEConfig
from moveset.training.distill import DistillationConfig
from moveset.training.engine import EngineConfig
from moveset.training.tasks import Recipe
from moveset.training.teacher import TeacherConfig
from moveset.training.vae import VAETrainingConfig


def vae(features: int = 263) -> TokenVAEConfig:
    """18.06 M parameters at HumanML3D's 263 features; KIT-ML has 251."""
    return TokenVAEConfig(features=features)


def teacher(text_dim: int = 768) -> TokenDenoiserConfig:
    """8,237,856 parameters with sentence-T5's 768 numbers a sentence."""
    return TokenDenoiserConfig(text_dim=text_dim)


def student(text_dim: int = 768) -> TokenDenoiserConfig:
    """8,434,464 parameters: the teacher and a guidance embedding."""
    return TokenDenoiserConfig(text_dim=text_dim, guidance=True)


def discriminator() -> DiscriminatorConfig:
    """Heads on all nine blocks of the teacher: 1.2 M trained parameters."""
    return DiscriminatorConfig(width=256, taps=9)


def _engine(steps: int) -> EngineConfig:
    return EngineConfig(steps=steps, save_every=5000, validate_every=10000, grad_clip=1.0, precision="auto")


def train_vae() -> Recipe:
    """MotionLCM-V2's autoencoder: 6000 epochs of about 192 batches of 128."""
    return Recipe(
        task=VAETrainingConfig(
            model=vae(), codec="hml", loss="published", kl=1e-4, batch=128, lr=2e-4, warmup=1000, ema=0.999
        ),
        engine=_engine(1_150_000),
    )


def train_teacher() -> Recipe:
    """MotionLCM-V2's teacher: 3000 epochs, batch 64."""
    model = teacher(text_dim=768)
    task = TeacherConfig(
        model=model, batch=64, lr=1e-4, warmup=1000, text_encoder="t5:sentence-transformers/sentence-t5-large"
    )
    return Recipe(task=task, engine=_engine(1_150_000))


def train_lcm() -> Recipe:
    """MotionLCM-V2: 1000 epochs, batch 128, w in [5, 15], c = 0.5, k = 100."""
    return Recipe(task=DistillationConfig(text_encoder=train_teacher().task.text_encoder), engine=_engine(192_000))


def train_pcm() -> Recipe:
    """MotionPCM, Section 5.1: 384 K iterations; here every one updates both student and discriminator."""
    return Recipe(task=DistillationConfig(text_encoder=train_teacher().task.text_encoder), engine=_engine(384_000))


TRAINING: dict[str, Callable[[], Recipe]] = {
    "vae": train_vae,
    "teacher": train_teacher,
    "lcm": train_lcm,
    "pcm": train_pcm,
}
