"""Batches of consecutive steps, made ahead in other processes so that a fast device need not wait for them."""

import atexit
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any

import torch
from torch.utils.data import DataLoader

from moveset.errors import MovesetError


def in_order(make: Callable[[int], Any], numbers: Sequence[int], workers: int) -> Iterator[Any]:
    """``make(number)`` of each number, made ahead by ``workers`` processes; with 0 it is made when it is asked for.

    They are forked, so that what is read exists once; where there is no fork, there are none.

    Raises:
        MovesetError: what ``make`` raises of it.
    """
    if not workers or "fork" not in torch.multiprocessing.get_all_start_methods():
        return map(make, numbers)
    return _made_ahead(make, numbers, workers)


def _made_ahead(make: Callable[[int], Any], numbers: Sequence[int], workers: int) -> Iterator[Any]:
    def made_or_error(number: int) -> Any:
        try:
            return make(number)
        except MovesetError as error:  # which the loader would raise again as the traceback that led to it
            return error

    # Workers end when the other end of a pipe is closed, however that happens: of a program that was killed they would
    # wait for ever to hand over what they made, and hold its lock, which forks share.
    watched, held = os.pipe()

    def begin(worker: int) -> None:
        # Whoever stops a training by its process group would kill workers whose next batch it waits for.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        os.close(held)
        threading.Thread(target=_end_with, args=(watched,), daemon=True).start()

    let_go = ExitStack()
    for end in (watched, held):
        let_go.callback(os.close, end)
    atexit.register(let_go.close)  # a program that ends by an error may still hold them, and would wait for them
    try:
        for made in DataLoader(
            numbers,
            batch_size=None,
            collate_fn=made_or_error,
            num_workers=workers,
            multiprocessing_context="fork",
            worker_init_fn=begin,
            # Otherwise the loader would draw from torch's own generator, and dropout would be another.
            generator=torch.Generator().manual_seed(0),
        ):
            if isinstance(made, MovesetError):
                raise made
            yield made
    finally:
        atexit.unregister(let_go.close)
        let_go.close()


def _end_with(pipe: int) -> None:
    os.read(pipe, 1)
    os._exit(0)


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
