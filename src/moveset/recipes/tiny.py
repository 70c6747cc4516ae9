"""Seconds on any machine: every part of the real thing, too small to be any good. For tests and trying things out."""

from collections.abc import Callable

from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.timed_vae import TimedVAEConfig
from moveset.training.distill import DistillationConfig
from moveset.training.engine import EngineConfig
from moveset.training.reading import Disturbance
from moveset.training.tasks import Recipe
from moveset.training.teacher import TeacherConfig
from moveset.training.vae import VAETrainingConfig

_ENGINE = EngineConfig(steps=4, save_every=2, validate_every=4, log_every=1, precision="32-true", tensorboard=False)
_ROUGH = Disturbance(paraphrased=0.5, word_drop=0.1, blur=0.1)
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
    return Recipe(task=TeacherConfig(model=model, batch=4, warmup=1, disturbance=_ROUGH), engine=_ENGINE)


def student() -> Recipe:
    """LCM, or MotionPCM with its discriminator."""
    return Recipe(task=DistillationConfig(guidance=(1.0, 5.0), batch=4, warmup=1, disturbance=_ROUGH), engine=_ENGINE)


TRAINING: dict[str, Callable[[], Recipe]] = {
    "vae": vae,
    "decoder": decoder,
    "teacher": teacher,
    "lcm": student,
    "pcm": student,
}
