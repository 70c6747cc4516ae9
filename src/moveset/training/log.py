"""What a training says: ``metrics.jsonl`` always, TensorBoard where installed, a bar where a person looks."""

import json
import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor

from moveset.errors import MovesetError
from moveset.io.limits import write_text


def truncate_metrics(file: Path, step: int) -> None:
    """Drops lines after ``step`` and a last line torn by a kill, so that resuming appends to a consistent file."""
    if not file.exists():
        return
    kept = []
    for line in file.read_text(errors="replace").splitlines():
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if isinstance(entry, dict) and entry.get("step", step + 1) <= step:
            kept.append(line + "\n")
    write_text(file, "".join(kept))


class TrainingLog:
    """Collects metrics without waiting for the device, and writes their means.

    Args:
        folder: where ``metrics.jsonl`` and ``tensorboard/`` are.
        start, total: steps done before, and in all.
        tensorboard: also write TensorBoard events, if the package is installed.
    """

    def __init__(self, folder: Path, name: str, start: int, total: int, tensorboard: bool) -> None:
        from tqdm import tqdm

        folder.mkdir(parents=True, exist_ok=True)
        truncate_metrics(folder / "metrics.jsonl", start)
        # Unbuffered: what a full disk did not take must not come again when the file is closed.
        self._file = open(folder / "metrics.jsonl", "ab", buffering=0)  # noqa: SIM115 (closed in __exit__)
        self._board = _summary_writer(folder / "tensorboard", start) if tensorboard else None
        self._bar = tqdm(
            total=total, initial=start, desc=name, unit="step", file=sys.stderr, disable=not sys.stderr.isatty()
        )
        self._window: dict[str, list[float | Tensor]] = {}
        self._steps, self._since = 0, time.monotonic()

    def add(self, metrics: Mapping[str, float | Tensor]) -> None:
        """Takes the metrics of one step; tensors must be scalars and are not waited for."""
        for key, value in metrics.items():
            self._window.setdefault(key, []).append(value.detach() if isinstance(value, Tensor) else value)
        self._steps += 1
        self._bar.update(1)

    def flush(self, step: int, **constants: float) -> dict[str, float]:
        """Writes and returns the means since the last flush, plus constants such as learning rates.

        Raises:
            MovesetError: one of them is NaN or infinite: the training has failed.
        """
        if not self._steps:
            return {}
        means = {key: _mean(values) for key, values in self._window.items()}
        for key, value in means.items():
            if not math.isfinite(value):
                raise MovesetError(
                    f"{key} became {value} by step {step}; resume from an older checkpoint with a lower learning rate "
                    "or a tighter gradient clip"
                )
        elapsed = time.monotonic() - self._since
        self.write("train", step, {**means, **constants, "steps_per_second": self._steps / max(elapsed, 1e-9)})
        self._bar.set_postfix({key: f"{value:.4g}" for key, value in list(means.items())[:4]}, refresh=False)
        self.restart_clock()
        self._window = {}
        return means

    def restart_clock(self) -> None:
        """Leaves validation and saving out of ``steps_per_second``."""
        self._steps, self._since = 0, time.monotonic()

    def write(self, split: str, step: int, metrics: dict[str, float]) -> None:
        """Appends one line ``{"step", "split", "time", …}``.

        Raises:
            MovesetError: the disk is full or not writable.
        """
        line: dict[str, Any] = {"step": step, "split": split, "time": round(time.time(), 3)}
        # JSON has no NaN; a validation may well have one (the correlation of constants, say).
        line |= {key: float(f"{value:.8g}") if math.isfinite(value) else None for key, value in metrics.items()}
        try:
            self._file.write((json.dumps(line, allow_nan=False) + "\n").encode())
        except OSError as error:
            raise MovesetError(
                f"{self._file.name} could not be written ({error.strerror or error}); make room, then resume"
            ) from error
        if self._board is not None:
            for key, value in metrics.items():
                self._board.add_scalar(f"{split}/{key}", value, step)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
        self._file.close()
        if self._board is not None:
            self._board.close()


def _mean(values: list[float | Tensor]) -> float:
    tensors = [value.float() for value in values if isinstance(value, Tensor)]
    total = sum(value for value in values if not isinstance(value, Tensor))
    if tensors:
        total += float(torch.stack(tensors).sum(dtype=torch.float64))
    return total / len(values)


def _summary_writer(folder: Path, start: int) -> Any | None:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder), purge_step=start + 1)
