"""The model folder of what the recurrent model is compared with, and which nothing but the evaluation runs.

One network, ``denoiser``: of whole clips (RDM-1, Light-RDM-1, MotionDiffuse), or of chunks that go on from the frames
before them (DiP). ``normalizer.safetensors`` has feature_mean and feature_std (D,), and for chunks ``idle`` (D,), the
normalised pose that a motion starts from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from torch import Tensor, nn

from moveset.diffusion.schedule import Schedule, cosine, linear
from moveset.models import dip_decoder, light_t2m, segment_denoiser, segment_transformer  # noqa: F401  (their kinds)
from moveset.pipelines.model_folder import BASELINE, FolderConfig, ModelFolder, save_folder

DENOISER, IDLE = "denoiser", "idle"
STATISTICS = ("feature_mean", "feature_std")
SCHEDULES = {"linear": linear, "cosine": cosine}
PREDICTIONS = ("x0", "eps")


@dataclass(frozen=True, kw_only=True)
class BaselineConfig(FolderConfig):
    """What a baseline's folder holds, besides what every ``FolderConfig`` says.

    Args:
        frames: of the longest clip, or of a chunk.
        prefix: frames before a chunk that the network is told; 0 for whole clips.
        schedule: "linear" or "cosine".
        timesteps: T; time 0 is clean.
        predict: "x0" or "eps".
        sampler_steps: K.
        eta: noise that is put back at each step, 0 (DDIM) to 1 (DDPM).
    """

    task: ClassVar[str] = BASELINE

    frames: int
    prefix: int = 0
    schedule: str = "linear"
    timesteps: int = 1000
    predict: str = "x0"
    sampler_steps: int = 50
    eta: float = 0.0

    def check(self) -> None:
        """Raises ValueError, TypeError or KeyError for numbers that no such model can have."""
        super().check()
        if tuple(self.models) != (DENOISER,):
            raise ValueError(f"a baseline has one network, {DENOISER!r}, not {', '.join(self.models)}")
        if self.schedule not in SCHEDULES or self.predict not in PREDICTIONS:
            raise ValueError(f"unknown schedule {self.schedule!r} or prediction {self.predict!r}")
        if self.predict == "eps" and self.prefix:
            raise ValueError("chunks are predicted clean")
        limits = {
            "frames": (2, 10_000),
            "prefix": (0, 10_000),
            "timesteps": (1, 100_000),
            "sampler_steps": (1, self.timesteps),
        }
        self.check_sampling(self.eta, limits)

    def noise_schedule(self) -> Schedule:
        """The schedule by its name and length."""
        return SCHEDULES[self.schedule](self.timesteps)


class BaselineBundle(ModelFolder[BaselineConfig]):
    """An opened baseline.

    Args:
        path: the folder.

    Raises:
        FormatError: no model folder, or a damaged one.
        InputError: a model of another kind.
    """

    config_class = BaselineConfig
    statistics = STATISTICS


def save_baseline(
    path: Path,
    config: BaselineConfig,
    denoiser: nn.Module,
    normalizer: Mapping[str, Tensor],
    captions: Sequence[str],
    pooled: Tensor,
) -> Path:
    """Write a baseline's folder; it appears whole or not at all, and replaces an older one of that name.

    Args:
        path: the folder to make.
        config: all but ``models``.
        denoiser: the network; stored in half precision.
        normalizer: feature_mean and feature_std (D,), and ``idle`` for chunks; stored in float32.
        captions: P sentences the model was trained on.
        pooled: (P, C) their pooled text embeddings.

    Raises:
        ValueError: missing statistics, weights that half precision cannot hold, or captions that do not fit theirs.
        FormatError: a configuration that could not be read again.
    """
    needed = {*STATISTICS, *((IDLE,) if config.prefix else ())}
    if missing := needed - set(normalizer):
        raise ValueError(f"the normalizer lacks {sorted(missing)[0]!r}")
    return save_folder(path, config, {DENOISER: denoiser}, normalizer, captions, pooled)
