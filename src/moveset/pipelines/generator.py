"""What makes motion, whatever its model: requests in, a motion each out. For tables and measurements, many at once."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, get_args

from moveset.diffusion.steps import Variance
from moveset.errors import InputError
from moveset.motion.clip import Motion
from moveset.pipelines.baseline import Baseline
from moveset.pipelines.clip_generator import ClipGenerator, clip_method
from moveset.pipelines.model_config import DENOISER, ClipConfig, StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.request import Request
from moveset.pipelines.role import Role, is_student, named
from moveset.pipelines.stream_generator import StreamGenerator
from moveset.pipelines.stream_settings import check_stream
from moveset.rdm.sampler import InitNoise
from moveset.rdm.staircase import Shape


class Generator(Protocol):
    """Makes motions of one model by one network.

    ``slug`` names it in files, ``model``, ``network`` and ``steps`` in tables; ``skeleton`` names the one it moves;
    ``fps`` is the rate of its motions and of the frames that it is asked for; ``segment`` counts the frames between
    seams of a stream, 0 where there are none.
    """

    slug: str
    model: str
    network: str
    steps: int
    skeleton: str
    fps: float
    segment: int

    def describe(self) -> dict[str, Any]:
        """Everything that its motions depend on besides weights, for JSON."""

    def weights(self) -> dict[str, str]:
        """sha256 of every file of weights that takes part."""

    def generate(
        self, requests: Sequence[Request], progress: Callable[[int], object] = lambda count: None
    ) -> list[Motion]:
        """A motion for each request: as long as asked for or a little longer, or shorter where the model has a limit.

        Args:
            progress: told after some motions how many more there are.
        """


@dataclass(frozen=True, kw_only=True)
class Sampler:
    """How to sample, where that is not the model's own choice (None).

    Args:
        start, lag, past_lag, eta, variance, eps_scale, time_shift, stages: of streams, as for
            ``stream_settings.check_stream``.
        shape: of a stream's staircase.
        init_noise: "shared" begins all segments of a stream with the first one's noise, carried by the flow, where they
            enter at the first step and overlap (RDM, Algorithm 1, line 2).
    """

    steps: int | None = None
    guidance: float | None = None
    start: int | None = None
    lag: int | None = None
    past_lag: int | None = None
    eta: float | None = None
    variance: Variance | None = None
    eps_scale: float | None = None
    time_shift: float | None = None
    shape: Shape | None = None
    init_noise: InitNoise | None = None
    stages: bool | None = None

    def given(self) -> dict[str, Any]:
        """What is not None, the steps left out."""
        return {name: value for name, value in asdict(self).items() if value is not None and name != "steps"}


def open_generator(
    name_or_path: str | Path,
    network: str | None = None,
    sampler: Sampler | None = None,
    *,
    foot_lock: bool = True,
    batch: int = 64,
    device: str = "auto",
) -> Generator:
    """What makes motion by one of a model's networks.

    Args:
        name_or_path: a shipped model, or a model folder.
        network: of the folder; None for its own choice. "pcm" and "lcm" mean the student of the sampler's steps.
        sampler: what differs from the folder's own choice.
        foot_lock: motion as users get it, with planted feet held; off: as the decoder gives it.
        batch: what the network evaluates at once, about.

    Raises:
        InputError: no such model, network, steps or setting.
        FormatError: a damaged folder.
    """
    sampler, folder = sampler or Sampler(), ModelFolder.open(name_or_path)
    config = folder.config
    if isinstance(config, StreamConfig):
        return _stream(folder, network, sampler, foot_lock, batch, device)
    if others := [name for name in sampler.given() if name != "guidance"]:
        raise InputError(f"{others[0]} is a setting of streams, and {config.name!r} is none")
    if isinstance(config, ClipConfig):
        method = clip_method(config, network, sampler.steps, sampler.guidance)
        return ClipGenerator(folder, method, device=device, batch=batch, foot_lock=foot_lock)
    if network not in (None, DENOISER):
        raise InputError(f"{config.name!r} has no network {network!r}; it has {DENOISER!r}")
    return Baseline(
        folder, steps=sampler.steps, guidance=sampler.guidance, foot_lock=foot_lock, device=device, batch=batch
    )


def _stream(
    bundle: ModelFolder[StreamConfig], network: str | None, sampler: Sampler, foot_lock: bool, batch: int, device: str
) -> StreamGenerator:
    given = sampler.given()
    shape, init_noise = given.pop("shape", "parallelogram"), given.pop("init_noise", "independent")
    for name, value, known in (("shape", shape, get_args(Shape)), ("init_noise", init_noise, get_args(InitNoise))):
        if value not in known:
            raise InputError(f"{name} {value!r} is not one of {', '.join(known)}")
    request = check_stream(bundle.config, network=network, steps=sampler.steps, foot_lock=foot_lock, **given)
    if shape != "parallelogram" and named(request.settings.network).role is not Role.DENOISER:
        raise InputError(
            f"network {request.settings.network!r} begins every segment from noise, so there is no {shape}; "
            "leave shape out or choose --network rdm"
        )
    plan = request.settings
    if init_noise != "independent" and not plan.lag < plan.start == plan.steps:
        raise InputError(
            f"init_noise {init_noise!r} is for start {plan.steps}, all of the steps, and a smaller lag; leave it out"
        )
    extras = [f"{sampler.steps}-steps"] if sampler.steps and not is_student(request.settings.network) else []
    extras += [f"{k}{v:g}" if isinstance(v, int | float) else f"{k}{v}" for k, v in given.items()]
    extras += [] if shape == "parallelogram" else [f"shape{shape}"]
    extras += [] if init_noise == "independent" else [f"init_noise-{init_noise}"]
    extras += [] if foot_lock else ["raw"]
    return StreamGenerator(
        bundle, request.settings, shape=shape, init_noise=init_noise, extras=extras, device=device, batch=batch
    )
