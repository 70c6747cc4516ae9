"""What kinds of model folders there are, and what ``config.json`` says of each."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Self

from moveset.diffusion.schedule import cosine, linear
from moveset.diffusion.steps import Variance, require_variance
from moveset.errors import FormatError, InputError
from moveset.io.manifest import json_object
from moveset.motion.features import FeatureCodec, get_codec
from moveset.pipelines.role import Role, named

FORMAT = 1
TEXT_TO_MOTION, STREAM, BASELINE = "text-to-motion", "stream", "baseline"
DEFAULT_MODEL, DEFAULT_STREAM = "motionpcm-small", "rdm-small"
SOLVERS = ("pcm", "lcm", "teacher")
SCHEDULES = {"linear": linear, "cosine": cosine}
PREDICTIONS = ("x0", "eps")
EPS_SCALES = (0.5, 2.0)
FLOW, SIDES, DENOISER, IDLE = "flow", "sides", "denoiser", "idle"


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """One network: what ``models.registry.build_model`` takes, and what its file is to be read with.

    Args:
        base: the network whose weights the file tells the differences from; None if it holds the weights themselves.
        base_sha256: of that network's file.
    """

    kind: str
    config: Mapping[str, Any]
    base: str | None = None
    base_sha256: str | None = None


@dataclass(frozen=True, kw_only=True)
class FolderConfig:
    """What every kind of model folder says of itself.

    Args:
        codec: feature codec of its motions, a name for ``motion.features.get_codec``.
        text_encoder: a name for ``text.encoder.get_text_encoder``.
        guidance: default guidance scale w by name of the network, for those that take one.
        far_prompt: a prompt whose best cosine to the training captions is lower gets a warning.
        examples: sentences to begin with, as an interface suggests them; none where nobody chose any.
        provenance: on what, how and when it was trained; for people.
        models: the networks by name; filled in when the folder is saved.
    """

    task: ClassVar[str]
    #: Names of tensors in ``normalizer.safetensors``.
    statistics: ClassVar[tuple[str, ...]]
    #: Guided networks that come with their mirror image.
    symmetric: ClassVar[tuple[str, ...]] = ()

    name: str
    codec: str = "native"
    fps: float = 20.0
    text_encoder: str = "minilm"
    guidance: Mapping[str, float] = field(default_factory=dict)
    far_prompt: float = 0.5
    examples: tuple[str, ...] = ()
    provenance: Mapping[str, str | int | float] = field(default_factory=dict)
    models: Mapping[str, ModelSpec] = field(default_factory=dict)

    def steps(self, solver: str) -> tuple[int, ...]:
        """Step counts for which there is a student of this solver ("pcm" or "lcm"), ascending."""
        found = map(named, self.models)
        return tuple(sorted(of.steps for of in found if of.solver == solver and of.steps is not None))

    @property
    def needed(self) -> tuple[str, ...]:
        """Names of the statistics that a folder of this configuration has to have."""
        return self.statistics

    def feature_codec(self) -> FeatureCodec:
        return get_codec(self.codec)

    def check(self) -> None:
        """Raises ValueError, TypeError or KeyError for numbers that no such model can have."""
        if not self.name or re.search(r"[/\\:\x00-\x1f]|^\.", self.name):
            raise ValueError(f"the name {self.name!r} cannot be part of a file's name")
        if not 0 < self.fps <= 1000:
            raise ValueError("frame rate out of range")
        if not all(isinstance(text, str) for text in self.examples):
            raise ValueError("examples that are no sentences")
        for name, spec in self.models.items():
            if spec.base is not None and self.models[spec.base].base is not None:
                raise ValueError(f"the base {spec.base!r} of {name!r} is itself stored as differences")

    def check_sampling(self, eta: float, variance: str, limits: Mapping[str, tuple[int, int]]) -> None:
        """Raises ValueError for fields that are no whole number within limits, and for eta, its variance or guidance
        out of range."""
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if type(value) is not int or not low <= value <= high:
                raise ValueError(f"{name} {value!r} is no whole number in {low} to {high}")
        if not 0 <= eta <= 1:
            raise ValueError(f"eta {eta} is not in 0 to 1")
        try:
            require_variance(variance)
        except InputError as error:
            raise ValueError(error) from error
        if not all(name in self.models and 0 <= w < math.inf for name, w in self.guidance.items()):
            raise ValueError("guidance of a network that is not there, or below 0")

    @classmethod
    def parse(cls, data: bytes, where: Path) -> Self:
        """From the bytes of a ``config.json``.

        Raises:
            FormatError: not this format, or a model of another kind.
        """
        raw = json_object(data, where)
        version = raw.pop("format", None)
        if version != FORMAT:
            raise FormatError(f"{where} has format {version!r}; this version reads format {FORMAT}")
        if (task := raw.pop("task", TEXT_TO_MOTION)) != cls.task:
            raise FormatError(f"{where} has the task {task!r}, not {cls.task!r}; give a folder of that kind")
        known = {f.name for f in fields(cls)}
        if wrong := set(raw) ^ known:
            raise FormatError(f"{where} does not fit this version: {sorted(wrong)[0]!r} is missing or unknown")
        try:
            raw["models"] = {name: ModelSpec(**spec) for name, spec in raw["models"].items()}
            config = cls(**{key: tuple(value) if isinstance(value, list) else value for key, value in raw.items()})
            config.check()
            return config
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise FormatError(f"{where} does not describe a model: {error}") from error


@dataclass(frozen=True, kw_only=True)
class ClipConfig(FolderConfig):
    """What a text-to-motion folder holds, besides what every ``FolderConfig`` says.

    Networks: ``vae``, ``length``, ``sides``, ``teacher``, ``lcm-1``, ``pcm-1`` …

    Args:
        latent: (N, d), tokens of the latent and numbers in each.
        points: solver points of the distillation grid (N in MotionPCM, section 3).
    """

    task: ClassVar[str] = TEXT_TO_MOTION
    statistics: ClassVar[tuple[str, ...]] = ("feature_mean", "feature_std", "latent_mean", "latent_std")

    min_frames: int = 20
    max_frames: int = 196
    latent: tuple[int, int] = (16, 32)
    points: int = 10

    def check(self) -> None:
        super().check()
        if [type(size) for size in self.latent] != [int, int]:
            raise ValueError(f"a latent of {self.latent}, which are no two whole numbers")
        for denoiser in ("teacher", *(f"{solver}-{n}" for solver in ("pcm", "lcm") for n in self.steps(solver))):
            if denoiser in self.models and not self.guidance[denoiser] >= 0:
                raise ValueError(f"guidance of {denoiser!r} is below 0")
        if not 1 <= self.min_frames <= self.max_frames <= 10_000:
            raise ValueError("frame numbers out of range")
        for name, spec in self.models.items():
            for size, key in zip(self.latent, ("tokens", "token_dim"), strict=True):
                if spec.config.get(key, size) != size:
                    raise ValueError(f"{name!r} has {key} {spec.config[key]}, the latent {size}")


@dataclass(frozen=True, kw_only=True)
class StreamConfig(FolderConfig):
    """What a stream's folder holds, besides what every ``FolderConfig`` says.

    Networks, all but one of the denoisers optional:
    ``rdm``          the full recurrent denoiser, sampled in a staircase
    ``pcm-1|2|4``    its students: one segment in that many evaluations, given the finished one before it
    ``md``           the baseline: the same denoiser, trained with a clean previous segment
    ``flow``         the invertible transport between segments; without it the transport is the identity
    ``sides``        says which sides a sentence names, for denoisers that are told of them (``text.sides``)

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
        variance: of that noise, as in ``diffusion.steps.denoise_step``.
        eps_scale: likewise, at K steps; where more or fewer are asked for, the power with the same product.
        time_shift: as in ``rdm.sequential.Solver``.
        past_lag: where segments of ``rdm`` are made one after the other, by how many steps the finished one before is
            told to be ahead: it is noised again to that level (``rdm.sampler``). None tells it clean.
        idle: the prompt of a stream before it is given one.
        symmetric: guided networks that are evaluated with their mirror image (``models.symmetric``), so that streams
            keep to neither side.
    """

    task: ClassVar[str] = STREAM
    statistics: ClassVar[tuple[str, ...]] = ("feature_mean", "feature_std")

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
    variance: Variance = "posterior"
    eps_scale: float = 1.0
    time_shift: float = 0.0
    past_lag: int | None = None
    idle: str = "a person stands still"
    symmetric: tuple[str, ...] = ()

    def flows(self, network: str) -> bool:
        """Whether a network's segments pass through the flow; the baseline was trained without."""
        return FLOW in self.models and named(network).role is not Role.AUTOREGRESSIVE

    @property
    def denoisers(self) -> tuple[str, ...]:
        return tuple(name for name in self.models if name not in (FLOW, SIDES))

    def check(self) -> None:
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
        self.check_sampling(self.eta, self.variance, limits)
        if not EPS_SCALES[0] <= self.eps_scale <= EPS_SCALES[1]:
            raise ValueError(f"eps_scale {self.eps_scale} is not in {EPS_SCALES[0]} to {EPS_SCALES[1]}")
        if not 0 <= self.time_shift <= 1:
            raise ValueError(f"time_shift {self.time_shift} is not in 0 to 1")
        for name in self.symmetric:
            if name not in self.models or not self.models[name].config.get("guided"):
                raise ValueError(f"{name!r} is no guided network, which alone can be symmetric")
        for name, spec in self.models.items():
            if spec.config.get("guided") and name not in self.guidance:
                raise ValueError(f"the network {name!r} takes a guidance scale, but has no default")


@dataclass(frozen=True, kw_only=True)
class BaselineConfig(FolderConfig):
    """What the folder of a baseline holds, besides what every ``FolderConfig`` says.

    Recurrent models are compared with it, and nothing but the evaluation runs it. One network, ``denoiser``: of whole
    clips (RDM-1, Light-RDM-1, MotionDiffuse), or of chunks that go on from the frames before them (DiP), whose
    statistics have ``idle`` (D,) too, the normalised pose that a motion starts from.

    Args:
        frames: of the longest clip, or of a chunk.
        prefix: frames before a chunk that the network is told; 0 for whole clips.
        schedule: "linear" or "cosine".
        timesteps: T; time 0 is clean.
        predict: "x0" or "eps".
        sampler_steps: K.
        eta: noise that is put back at each step, 0 (DDIM) to 1 (DDPM).
        variance: of that noise, as in ``diffusion.steps.denoise_step``.
    """

    task: ClassVar[str] = BASELINE
    statistics: ClassVar[tuple[str, ...]] = ("feature_mean", "feature_std")

    frames: int
    prefix: int = 0
    schedule: str = "linear"
    timesteps: int = 1000
    predict: str = "x0"
    sampler_steps: int = 50
    eta: float = 0.0
    variance: Variance = "posterior"

    @property
    def needed(self) -> tuple[str, ...]:
        """The statistics, and for chunks the pose that a motion starts from."""
        return (*self.statistics, IDLE) if self.prefix else self.statistics

    def check(self) -> None:
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
        self.check_sampling(self.eta, self.variance, limits)


#: The kinds of folders, by what their models are for.
CONFIGS: dict[str, type[FolderConfig]] = {kind.task: kind for kind in (ClipConfig, StreamConfig, BaselineConfig)}
