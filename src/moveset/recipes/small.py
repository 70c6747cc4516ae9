"""What ships: the same methods at sizes that two processor cores train in hours and run in milliseconds."""

from collections.abc import Callable

from moveset.training.engine import EngineConfig
from moveset.training.tasks import Recipe
from moveset.training.vae import VAETrainingConfig


def vae() -> Recipe:
    """4.0 M parameters; 16 latent tokens of 32 numbers."""
    return Recipe(
        task=VAETrainingConfig(batch=32),
        engine=EngineConfig(
            steps=6000, save_every=500, validate_every=500, grad_clip=20.0, precision="bf16-mixed", threads=1
        ),
    )


TRAINING: dict[str, Callable[[], Recipe]] = {"vae": vae}
