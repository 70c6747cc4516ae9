"""What a sampler of segments remembers between two of them, to keep and to go on from.

Shapes: B items, n frames of a segment, D features, C text width.
"""

from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor

_HELD = ("left", "left_pooled", "waiting")  # tensors that may not be there


@dataclass(eq=False)
class StreamState:
    """All that a sampler remembers: with the same settings and seeds, what continues it to the last bit.

    Attributes:
        wave: waves done.
        finished: segments finished; the next one is the oldest in work.
        steps: step that each segment in work has reached, oldest first.
        y: (B, n, D) state of each in y-space.
        pooled: (B, C) sentence embedding of each.
        left: (B, n, D) the last finished segment, clean, in x-space.
        left_pooled: (B, C) its sentence embedding, where it may be noised again; None for a motion that was given.
        waiting: (B, n, D) in y-space, what the next segment will begin with.
    """

    wave: int = 0
    finished: int = 0
    steps: list[int] = field(default_factory=list)
    y: list[Tensor] = field(default_factory=list)
    pooled: list[Tensor] = field(default_factory=list)
    left: Tensor | None = None
    left_pooled: Tensor | None = None
    waiting: Tensor | None = None

    @property
    def entered(self) -> int:
        """Segments that have entered; also the number of the next one."""
        return self.finished + len(self.steps)

    @property
    def active(self) -> range:
        """Numbers of the segments in work."""
        return range(self.finished, self.entered)

    def copy(self) -> "StreamState":
        """An independent copy; tensors are shared, since none is ever written to."""
        return replace(self, steps=[*self.steps], y=[*self.y], pooled=[*self.pooled])

    def numbers(self) -> dict[str, Any]:
        """Everything but the tensors, for JSON."""
        return {"wave": self.wave, "finished": self.finished, "steps": [*self.steps]}

    def tensors(self) -> dict[str, Tensor]:
        """The tensors by name, each with memory of its own, for safetensors."""
        named = {f"y.{k}": y for k, y in enumerate(self.y)} | {f"pooled.{k}": p for k, p in enumerate(self.pooled)}
        named |= {name: held for name in _HELD if (held := getattr(self, name)) is not None}
        return {name: held.clone() for name, held in named.items()}

    @classmethod
    def restore(cls, numbers: dict[str, Any], tensors: dict[str, Tensor]) -> "StreamState":
        """The state of which these are the ``numbers`` and ``tensors``."""
        y, pooled = ([tensors[f"{name}.{k}"] for k in range(len(numbers["steps"]))] for name in ("y", "pooled"))
        return cls(
            numbers["wave"], numbers["finished"], [*numbers["steps"]], y, pooled,
            *(tensors.get(name) for name in _HELD),
        )  # fmt: skip
