"""Batches of consecutive steps, made ahead in other processes so that a fast device need not wait for them."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from torch.utils.data import DataLoader


def in_order(make: Callable[[int], Any], numbers: Sequence[int], workers: int) -> Iterator[Any]:
    """``make(number)`` of each number, made ahead by ``workers`` processes; with 0 it is made when it is asked for.

    They are forked, so that what is read exists once; where there is no fork, it has to be small.
    """
    if not workers:
        return map(make, numbers)
    context = "fork" if "fork" in torch.multiprocessing.get_all_start_methods() else None
    return iter(
        DataLoader(
            numbers,
            batch_size=None,
            collate_fn=make,
            num_workers=workers,
            multiprocessing_context=context,
            # Otherwise the loader would draw from torch's own generator, and dropout would be another.
            generator=torch.Generator().manual_seed(0),
        )
    )


class Ahead:
    """Pure functions of the step, evaluated ahead of time (see ``in_order``)."""

    def __init__(self, workers: int, last: int) -> None:
        self.workers, self.last = workers, last
        self._next = -1
        self._batches: Iterator[Any] = iter(())

    def get(self, step: int, make: Callable[[int], Any]) -> Any:
        """``make(step)``. What the steps after it give is begun, as if ``make`` were the same for them."""
        if not self.workers:
            return make(step)
        if step != self._next:
            self._batches = in_order(make, range(step, max(step, self.last) + 1), self.workers)
        self._next = step + 1
        return next(self._batches)
