"""Which device to compute on, with how many threads, and how long things take there."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import torch

from moveset.errors import InputError


def pick_device(name: str = "auto") -> torch.device:
    """A device by name; "auto" takes a CUDA device if there is one, under torchrun the one of this process.

    Raises:
        InputError: an unknown device, or one that this machine does not have.
    """
    if name == "auto":
        if not torch.cuda.is_available():
            return torch.device("cpu")
        return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"unknown device {name!r}; use auto, cpu, cuda or mps") from None
    count = {"cpu": 1, "cuda": torch.cuda.device_count(), "mps": int(torch.backends.mps.is_available())}
    if (device.index or 0) >= count.get(device.type, 0):
        raise InputError(f"device {name!r} is not available on this machine; use --device cpu")
    return device


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Compute with so many threads of this process, then with as many as before."""
    before = torch.get_num_threads()
    if before == count:
        yield
        return
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute with one thread of this process, unless ``OMP_NUM_THREADS`` says otherwise, then with as many as before.

    Networks as small as ours have hundreds of short operations. Two threads save a fifth of a clip's time on a quiet
    machine, but spin while they wait for each other: once another process is busy on one of the cores, they take a
    hundred times as long. Sums come out the same whatever the program around sets, too.
    """
    with nullcontext() if "OMP_NUM_THREADS" in os.environ else threads(1):
        yield


class Stopwatch:
    """Wall-clock time of stages in milliseconds; waits for a GPU's queue at each lap."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self.laps: dict[str, float] = {}
        self._last = self._now()

    def lap(self, stage: str) -> None:
        """Note the time since the last lap (or the start) as that of ``stage``."""
        now = self._now()
        self.laps[stage] = round((now - self._last) * 1e3, 3)
        self._last = now

    def _now(self) -> float:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        return time.perf_counter()
