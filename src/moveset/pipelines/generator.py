"""What makes motion, whatever its model: requests in, a motion each out. For tables and measurements, many at once."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

from moveset.motion.clip import Motion
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.request import Method, Request
from moveset.pipelines.text_to_motion import TextToMotion
from moveset.text.cache import CachedEncoder

CHUNK = 512  # motions made before progress is told
REMEMBERED = 8192  # sentences


class Generator(Protocol):
    """Makes motions of one model by one network.

    ``slug`` names it in files, ``model``, ``network`` and ``steps`` in tables; ``fps`` is the rate of its motions and
    of the frames that it is asked for; ``segment`` counts the frames between seams of a stream, 0 where there are none.
    """

    slug: str
    model: str
    network: str
    steps: int
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


class ClipGenerator:
    """A text-to-motion model folder by one of its networks.

    Args:
        bundle: the folder.
        method: network, steps and guidance.
        device: where to compute.
        batch: clips evaluated at once.
        foot_lock: motion as users get it, with planted feet held; off: as the decoder gives it.
    """

    segment = 0

    def __init__(
        self, bundle: Bundle, method: Method, *, device: str = "auto", batch: int = 64, foot_lock: bool = True
    ) -> None:
        self._t2m = TextToMotion(bundle, device)
        self._t2m.encoder = CachedEncoder(self._t2m.encoder, REMEMBERED)
        self._method, self._batch, self._foot_lock = method, batch, foot_lock
        self.model, self.network, self.steps = bundle.config.name, method.network, method.steps
        self.fps = bundle.config.fps
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
        return self._t2m.bundle.sha256("vae", self._method.network)

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
