"""A text-to-motion model as a generator: clips in batches of like length."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from moveset.errors import InputError
from moveset.motion.clip import Motion
from moveset.pipelines.model_config import SIDES, SOLVERS, ClipConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.request import Method, Request, check_method
from moveset.pipelines.text_to_motion import TextToMotion
from moveset.text.cache import CachedEncoder

CHUNK = 512  # motions made before progress is told


class ClipGenerator:
    """A text-to-motion model folder by one of its networks.

    Args:
        foot_lock: motion as users get it, with planted feet held; off: as the decoder gives it.
    """

    segment = 0

    def __init__(
        self,
        bundle: ModelFolder[ClipConfig],
        method: Method,
        *,
        device: str = "auto",
        batch: int = 64,
        foot_lock: bool = True,
    ) -> None:
        self._t2m = TextToMotion(bundle, device)
        self._t2m.encoder = CachedEncoder(self._t2m.encoder, limit=8192)
        self._method, self._batch, self._foot_lock = method, batch, foot_lock
        self.model, self.network, self.steps = bundle.config.name, method.network, method.steps
        self.skeleton, self.fps = bundle.config.feature_codec().skeleton.name, bundle.config.fps
        own = bundle.config.guidance[method.network]
        extras = [f"{method.steps}-steps"] if method.network != f"{method.solver}-{method.steps}" else []
        extras += [f"w{method.guidance:g}"] if method.guidance != own else []
        self.slug = "-".join([self.model, method.network, *extras, *(() if foot_lock else ("raw",))])

    def describe(self) -> dict[str, Any]:
        method = self._method
        return {
            "solver": method.solver, "guidance": method.guidance, "foot_lock": self._foot_lock, "batch": self._batch,
            "device": self._t2m.device.type,
        }  # fmt: skip

    def weights(self) -> dict[str, str]:
        return self._t2m.bundle.sha256("vae", self._method.network, SIDES)

    def generate(
        self, requests: Sequence[Request], progress: Callable[[int], object] = lambda count: None
    ) -> list[Motion]:
        made: dict[int, Motion] = {}
        # Clips of like length together: a batch is padded to its longest.
        order = sorted(range(len(requests)), key=lambda k: requests[k].total)
        for start in range(0, len(order), CHUNK):
            rows = order[start : start + CHUNK]
            within = [self._within(requests[k]) for k in rows]
            done = self._t2m.generate(within, self._method, foot_lock=self._foot_lock, batch=self._batch)
            made |= {k: generation.motion for k, generation in zip(rows, done, strict=True)}
            progress(len(rows))
        return [made[k] for k in range(len(requests))]

    def _within(self, request: Request) -> Request:
        """The same within the limits of the model."""
        low, high = self._t2m.bundle.config.min_frames, self._t2m.bundle.config.max_frames
        return replace(request, frames=tuple(n if n is None else min(max(n, low), high) for n in request.frames))


def clip_method(config: ClipConfig, network: str | None, steps: int | None, guidance: float | None) -> Method:
    """How clips are sampled; an LCM student takes any number of steps, a PCM student its own.

    Raises:
        InputError: no such network or steps, or guidance out of range.
    """
    solver, _, count = (network or "pcm").partition("-")
    names = ", ".join(["vae", *(name for name in config.models if name not in ("vae", "length", "sides"))])
    if solver not in SOLVERS or (count and not count.isdecimal()):
        raise InputError(f"unknown network {network!r}; model {config.name!r} has {names}")
    if solver == "lcm" and (steps is not None or count):
        known = config.steps("lcm")
        own = int(count) if count else known[0] if known else 0
        method = check_method(config, "lcm", own, guidance)
        steps = own if steps is None else steps
        if not 1 <= steps <= config.points:
            raise InputError(f"{steps} steps are not in 1 to {config.points}, the solver points of training")
        return replace(method, steps=steps)
    if count and not (solver == "pcm" and steps in (None, int(count))):
        raise InputError(f"network {network!r} does not go with {steps or 'its'} steps; {config.name!r} has {names}")
    return check_method(config, solver, int(count) if count else steps, guidance)
