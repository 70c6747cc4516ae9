"""The model folder of a stream: denoisers of segments, and the flow that carries one segment to the next.

Networks, all but one of the denoisers optional:
``rdm``          the full recurrent denoiser, sampled in a staircase
``pcm-1|2|4``    its students: one segment in that many evaluations, given the finished one before it
``md``           the baseline: the same denoiser, trained with a clean previous segment
``flow``         the invertible transport between segments; without it the transport is the identity
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from moveset.errors import FormatError
from moveset.models import flow, segment_transformer  # noqa: F401  (they register their kinds)
from moveset.models.symmetric import Symmetric
from moveset.motion.native import NativeCodec
from moveset.pipelines.model_folder import STREAM, FolderConfig, ModelFolder, save_folder
from moveset.pipelines.role import Role, named

DEFAULT_STREAM = "rdm-small"
SCHEDULES = ("linear", "cosine")
FLOW = "flow"
STATISTICS = ("feature_mean", "feature_std")
_LEAN = 1e-3  # of a standard deviation


@dataclass(frozen=True, kw_only=True)
class StreamConfig(FolderConfig):
    """What a stream's folder holds, besides what every ``FolderConfig`` says.

    Args:
        network: the denoiser that a stream uses when none is named.
        segment: n, frames of a segment.
        depth_cap: most applications of the flow; segment i has min(i, cap).
        schedule: "linear" or "cosine", a name in ``diffusion.schedule``.
        timesteps: T; time 0 is clean.
        points: solver points of the students' distillation grid.
        sampler_steps: K, steps of the networks that are no students.
        start: R, how many of these steps remain when the next segment enters the staircase.
        lag: by how many steps a segment stays behind the one before it.
        eta: noise that is put back at each step, 0 (none) to 1.
        past_lag: where segments of ``rdm`` are made one after the other, by how many steps the finished one before is
            told to be ahead: it is noised again to that level (``rdm.sampler``). None tells it clean.
        idle: the prompt of a stream before it is given one.
        travelling: share by which the root of whoever goes is held over feet that slide (``motion.hold_root``).
        symmetric: guided networks that are evaluated with their mirror image (``models.symmetric``), so that streams
            keep to neither side.
    """

    task: ClassVar[str] = STREAM
    newer: ClassVar[frozenset[str]] = frozenset({"past_lag", "travelling"})

    network: str
    segment: int = 28
    depth_cap: int = 1
    schedule: str = "linear"
    timesteps: int = 1000
    points: int = 10
    sampler_steps: int = 20
    start: int = 7
    lag: int = 1
    eta: float = 0.0
    past_lag: int | None = None
    idle: str = "a person stands still"
    travelling: float = 1.0
    symmetric: tuple[str, ...] = ()

    @classmethod
    def of(cls, raw: Mapping[str, Any]) -> Self:
        return cls(**{**raw, "symmetric": tuple(raw["symmetric"])})

    def flows(self, network: str) -> bool:
        """Whether a network's segments pass through the flow; the baseline was trained without."""
        return FLOW in self.models and named(network).role is not Role.AUTOREGRESSIVE

    @property
    def denoisers(self) -> tuple[str, ...]:
        """Names of the networks that a stream can be made with."""
        return tuple(name for name in self.models if name != FLOW)

    def check(self) -> None:
        """Raises ValueError, TypeError or KeyError for numbers that no such model can have."""
        super().check()
        if self.network not in self.denoisers:
            raise ValueError(f"the default network {self.network!r} is none of {', '.join(self.denoisers)}")
        if not all(1 <= steps <= self.points for steps in self.steps("pcm")):
            raise ValueError(f"a student of more steps than the {self.points} points of its grid")
        if self.schedule not in SCHEDULES:
            raise ValueError(f"the schedule {self.schedule!r} is none of {', '.join(SCHEDULES)}")
        limits = {
            "segment": (1, 1000),
            "depth_cap": (0, 1000),
            "timesteps": (1, 100_000),
            "points": (1, self.timesteps),
            "sampler_steps": (1, self.timesteps),
            "start": (0, self.sampler_steps),
            "lag": (1, self.sampler_steps),
        }
        if self.past_lag is not None:
            limits["past_lag"] = (1, self.sampler_steps)
        self.check_sampling(self.eta, limits)
        if not 0 <= self.travelling <= 1:
            raise ValueError(f"travelling {self.travelling} is not in 0 to 1")
        for name in self.symmetric:
            if name not in self.models or not self.models[name].config.get("guided"):
                raise ValueError(f"{name!r} is no guided network, which alone can be symmetric")
        for name, spec in self.models.items():
            if spec.config.get("guided") and name not in self.guidance:
                raise ValueError(f"the network {name!r} takes a guidance scale, but has no default")


class StreamBundle(ModelFolder[StreamConfig]):
    """An opened stream folder; networks are read when they are first asked for.

    Args:
        path: the folder.

    Raises:
        FormatError: no model folder, or a damaged one.
        InputError: a model of another kind.
    """

    config_class = StreamConfig
    statistics = STATISTICS

    def module(self, name: str, device: torch.device | str = "cpu") -> nn.Module:
        """As every model folder's; symmetric networks come with their mirror image.

        Raises:
            FormatError: as there; statistics that lean to one side.
        """
        network = super().module(name, device)
        if name in self.config.symmetric and not isinstance(network, Symmetric):
            network = self._modules[name, str(device)] = self._even(network).to(device)
        return network

    def _even(self, network: nn.Module) -> Symmetric:
        codec = self.config.feature_codec()
        if not isinstance(codec, NativeCodec):
            raise FormatError(f"{self.path}: features of {codec.name!r} are not symmetric; export it without")
        order, signs = codec.mirror()
        mean, std = (self.normalizer[statistic] for statistic in STATISTICS)
        lean = ((mean[order] * signs - mean) / std, std[order] / std - 1)
        if max(float(part.abs().max()) for part in lean) > _LEAN:
            raise FormatError(f"{self.path}: its statistics lean to one side, so nothing is symmetric; pack it without")
        return Symmetric(network, order, signs).eval()


def save_stream_bundle(
    path: Path,
    config: StreamConfig,
    modules: Mapping[str, nn.Module],
    normalizer: Mapping[str, Tensor],
    captions: Sequence[str],
    pooled: Tensor,
    bases: Mapping[str, str] | None = None,
    words: Collection[str] = (),
) -> Path:
    """Write a stream's folder; it appears whole or not at all, and replaces an older one of that name.

    Args:
        path: the folder to make.
        config: all but ``models``, which are taken from the networks' own ``.config``.
        modules: networks by name: "rdm", "pcm-1", "pcm-2", "pcm-4", "md", "flow"; stored in half precision.
        normalizer: feature_mean, feature_std (D,); stored in float32.
        captions: P sentences the model was trained on.
        pooled: (P, C) their pooled text embeddings.
        bases: by name of a student, the network it was started from ("rdm"): it is stored as differences.
        words: of all captions of the training.

    Raises:
        ValueError: missing statistics, weights that half precision cannot hold, or captions that do not fit theirs.
        FormatError: a configuration that could not be read again.
    """
    if missing := set(STATISTICS) - set(normalizer):
        raise ValueError(f"the normalizer lacks {sorted(missing)[0]!r}")
    return save_folder(path, config, modules, normalizer, captions, pooled, bases, words)
