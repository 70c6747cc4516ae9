"""The model folder of text-to-motion: an autoencoder of clips, a denoiser of its latents, and the denoiser's students.

Networks: ``vae``, ``length``, ``teacher``, ``lcm-1``, ``pcm-1`` … in a folder as described in ``model_folder``;
``normalizer.safetensors`` has feature_mean, feature_std (D,), latent_mean, latent_std (N, d) or (d,).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from moveset.pipelines.model_folder import (
    TEXT_TO_MOTION,
    FolderConfig,
    ModelFolder,
    ModelSpec,
    find_folder,
    save_folder,
)
from moveset.pipelines.model_folder import shipped as shipped

__all__ = ["DEFAULT_MODEL", "SOLVERS", "Bundle", "BundleConfig", "ModelSpec", "find_folder", "save_folder", "shipped"]

DEFAULT_MODEL = "motionpcm-small"
SOLVERS = ("pcm", "lcm", "teacher")


@dataclass(frozen=True, kw_only=True)
class BundleConfig(FolderConfig):
    """What a text-to-motion folder holds, besides what every ``FolderConfig`` says.

    Args:
        min_frames: shortest clip.
        max_frames: longest clip.
        latent: (N, d), tokens of the latent and numbers in each.
        points: solver points of the distillation grid (N in MotionPCM, section 3).
    """

    task: ClassVar[str] = TEXT_TO_MOTION

    min_frames: int = 20
    max_frames: int = 196
    latent: tuple[int, int] = (16, 32)
    points: int = 10

    @classmethod
    def of(cls, raw: Mapping[str, Any]) -> Self:
        """From the JSON object, whose ``models`` are specifications already."""
        tokens, width = (int(n) for n in raw["latent"])
        return cls(**{**raw, "latent": (tokens, width)})

    def check(self) -> None:
        """Raises ValueError, TypeError or KeyError for numbers that no such model can have."""
        super().check()
        for denoiser in ("teacher", *(f"{solver}-{n}" for solver in ("pcm", "lcm") for n in self.steps(solver))):
            if denoiser in self.models and not self.guidance[denoiser] >= 0:
                raise ValueError(f"guidance of {denoiser!r} is below 0")
        if not 1 <= self.min_frames <= self.max_frames <= 10_000:
            raise ValueError("frame numbers out of range")
        for name, spec in self.models.items():
            for size, field in zip(self.latent, ("tokens", "token_dim"), strict=True):
                if spec.config.get(field, size) != size:
                    raise ValueError(f"{name!r} has {field} {spec.config[field]}, the latent {size}")


class Bundle(ModelFolder[BundleConfig]):
    """An opened text-to-motion folder; networks are read when they are first asked for.

    Args:
        path: the folder.

    Raises:
        FormatError: no model folder, or a damaged one.
        InputError: a model of another kind.
    """

    config_class = BundleConfig
    statistics = ("feature_mean", "feature_std", "latent_mean", "latent_std")
