"""How ``efficiency.py`` counts: calls and waves of a run, and operations by part.

network   evaluations of one segment, chunk or clip of one sample; guidance by two evaluations counts both
waves     evaluations one after the other: those of a wave are one batch
context   readings of text and previous segment by a network that keeps them apart from denoising
text      readings of the token states by the network's text layers (the frozen text encoder is not measured)
flow      applications of the flow or its inverse to one segment; flow text: its readings of the sentence
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import pairwise

from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel

from moveset.bench.flops import counter
from moveset.models.flow import CouplingFlow


@dataclass
class Tally:
    """What one run did. With a ``meter`` operations are counted too, which takes time: never time such a run.

    Before a clock is read, ``settle`` waits for a device that works behind the program's back.
    """

    batch: int
    meter: "Meter | None" = None
    settle: Callable[[], object] = bool
    seconds: float = 0.0
    flow_seconds: float = 0.0
    marks: list[tuple[int, float]] = field(default_factory=list)

    def wave(self, rows: int) -> None:
        """A network is about to be called on this many rows."""
        self.marks.append((rows // self.batch, self.now()))

    def now(self) -> float:
        """Seconds of a clock, when all that was asked for is done."""
        self.settle()
        return time.perf_counter()

    def part(self, name: str, rows: int):
        """Books operations to a part."""
        return nullcontext() if self.meter is None else self.meter.part(name, rows)

    @property
    def calls(self) -> int:
        """Calls of one sample."""
        return sum(width for width, _ in self.marks)

    def spans(self) -> Iterator[tuple[int, float]]:
        """(calls of a sample in a wave, seconds until the next wave), without the last, which also ends the run."""
        return ((width, end - start) for (width, start), (_, end) in pairwise(self.marks))


class Meter:
    """Operations by part, two for a multiplication and addition; a part within a part counts in the inner one only."""

    def __init__(self) -> None:
        self.rows: Counter[str] = Counter()
        self.operations: Counter[str] = Counter()
        self._counter = counter()
        self._open: list[list] = []

    @contextmanager
    def running(self, network: nn.Module, flow: CouplingFlow) -> Iterator[None]:
        """Counts all that happens within."""
        texts = [getattr(network, name) for name in ("text_in", "pool", "text_summary") if hasattr(network, name)]
        watched = [("text", [*texts, *getattr(network, "text_blocks", ())])]
        watched += [("flow", [*flow.blocks]), ("flow text", [flow.text])]
        with ExitStack() as stack:
            for name, modules in watched:
                for k, module in enumerate(modules):
                    for handle in self._watch(name, module, count=k == 0):
                        stack.callback(handle.remove)
            stack.enter_context(sdpa_kernel(SDPBackend.MATH))  # the fused attention of processors is not counted
            stack.enter_context(self._counter)
            yield
        self.operations["network"] = self._counter.get_total_flops() - self.operations.total()

    @contextmanager
    def part(self, name: str, rows: int) -> Iterator[None]:
        """Books what happens within to a part."""
        self._enter(name, rows)
        yield
        self._leave()

    def units(self, calls: int) -> dict[str, int]:
        """Operations of each part for one row of it.

        Raises:
            RuntimeError: rows of a part that differ in cost.
        """
        rows = {**self.rows, "network": calls}
        if odd := [name for name, spent in self.operations.items() if spent % rows[name]]:
            raise RuntimeError(f"not every row costs the same in {', '.join(odd)}")
        return {name: spent // rows[name] for name, spent in self.operations.items()}

    def _watch(self, name: str, module: nn.Module, count: bool) -> tuple:
        def before(_: nn.Module, inputs: tuple[Tensor, ...]) -> None:
            self._enter(name, len(inputs[0]) if count else 0)

        def after(*_: object) -> None:
            self._leave()

        return module.register_forward_pre_hook(before), module.register_forward_hook(after)

    def _enter(self, name: str, rows: int) -> None:
        self.rows[name] += rows
        self._open.append([name, self._counter.get_total_flops(), 0])

    def _leave(self) -> None:
        name, start, inner = self._open.pop()
        spent = self._counter.get_total_flops() - start
        self.operations[name] += spent - inner
        if self._open:
            self._open[-1][2] += spent
