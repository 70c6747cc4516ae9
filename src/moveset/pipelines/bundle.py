"""The model folder of text-to-motion: an autoencoder of clips, a denoiser of its latents, and the denoiser's students.

Networks: ``vae``, ``length``, ``teacher``, ``lcm-1``, ``pcm-1`` … in a folder as described in ``model_folder``;
``normalizer.safetensors`` has feature_mean, feature_std (D,), latent_mean, latent_std (N, d) or (d,).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from torch import Tensor, nn

from moveset.pipelines.model_folder import (
    TEXT_TO_MOTION,
    FolderConfig,
    ModelFolder,
    ModelSpec,
    find_folder,
    save_folder,
)
from moveset.pipelines.model_folder import shipped as shipped

__all__ = ["DEFAULT_MODEL", "SOLVERS", "Bundle", "BundleConfig", "ModelSpec", "find_folder", "save_bundle", "shipped"]

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


def save_bundle(
    path: Path,
    config: BundleConfig,
    modules: Mapping[str, nn.Module],
    normalizer: Mapping[str, Tensor],
    captions: Sequence[str],
    pooled: Tensor,
    bases: Mapping[str, str] | None = None,
) -> Path:
    """Write a text-to-motion folder; it appears whole or not at all, and replaces an older one of that name.

    Args:
        path: the folder to make.
        config: all but ``models``, which are taken from the networks' own ``.config``.
        modules: networks by name: "vae", "length", "teacher", "pcm-1", …; stored in half precision.
        normalizer: feature_mean, feature_std, latent_mean, latent_std; stored in float32.
        captions: P sentences the model was trained on.
        pooled: (P, C) their pooled text embeddings.
        bases: by name of a student, the network it was started from ("teacher"): it is stored as differences.

    Raises:
        ValueError: weights that half precision cannot hold, or captions that do not fit their embeddings.
        FormatError: a configuration that could not be read again.
    """
    return save_folder(path, config, modules, normalizer, captions, pooled, bases)
