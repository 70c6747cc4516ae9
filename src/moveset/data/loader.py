"""Batches of consecutive steps, made ahead in other processes so that a fast device need not wait for them."""

from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch.utils.data import DataLoader, Dataset


class _Steps(Dataset[Any]):
    def __init__(self, make: Callable[[int], Any]) -> None:
        self.make = make

    def __getitem__(self, step: int) -> Any:
        return self.make(step)


class Ahead:
    """Pure functions of the step, evaluated ahead of time.

    Args:
        workers: processes; with 0 a batch is made when it is asked for. They are forked, so that what batches are made
            of exists once; where there is no fork, it has to be small.
        last: the last step.
    """

    def __init__(self, workers: int, last: int) -> None:
        self.workers, self.last = workers, last
        self._next = -1
        self._batches: Iterator[Any] = iter(())

    def get(self, step: int, make: Callable[[int], Any]) -> Any:
        """``make(step)``. What the steps after it give is begun, as if ``make`` were the same for them."""
        if not self.workers:
            return make(step)
        if step != self._next:
            context = "fork" if "fork" in torch.multiprocessing.get_all_start_methods() else None
            loader: DataLoader[Any] = DataLoader(
                _Steps(make),
                batch_size=None,
                sampler=range(step, max(step, self.last) + 1),
                num_workers=self.workers,
                multiprocessing_context=context,
                # Otherwise the loader would draw from torch's own generator, and dropout would be another.
                generator=torch.Generator().manual_seed(0),
            )
            self._batches = iter(loader)
        self._next = step + 1
        return next(self._batches)
