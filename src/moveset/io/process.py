"""Several processes at work: one at a time in a folder, helpers that end with the one that started them, signals."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from moveset.errors import InputError

#: Whether there are locks: Windows has no flock, and nobody is kept out there.
LOCKS = find_spec("fcntl") is not None


@contextmanager
def locked(folder: Path, busy: str | None = None) -> Iterator[None]:
    """Holds ``folder/.lock``, which the system releases even when its holder is killed; makes the folder if need be.

    Args:
        busy: what to say if another process holds it; None waits for that one.

    Raises:
        InputError: another process holds it.
        OSError: the folder cannot be made or written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "w") as file:
        claim(file.fileno(), busy)
        yield


def claim(handle: int, busy: str | None = None) -> None:
    """Locks an open file; the system lets go of it when its holder ends, however that happens.

    Args:
        busy: what to say if another process holds it; None waits for that one.

    Raises:
        InputError: another process holds it.
    """
    if not LOCKS:
        return
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if busy is None else fcntl.LOCK_NB))
    except BlockingIOError as error:
        raise InputError(str(busy)) from error


def end_with_parent() -> None:
    """Let this process, which another one started by ``multiprocessing``, end as soon as that one is gone.

    Whoever is killed cannot stop its helpers any more.
    """
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def noted_signals() -> Iterator[list[int]]:
    """Collects SIGINT and SIGTERM instead of dying, so that what was made is kept; a second one of a kind interrupts.

    Of unlike ones the second does not: Ctrl-C reaches all processes of a terminal, and their parent may end them, too.
    """
    received: list[int] = []

    def note(number: int, frame: object) -> None:
        if number in received:
            raise KeyboardInterrupt
        received.append(number)

    with handled_signals(note):
        yield received


@contextmanager
def handled_signals(handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Has SIGINT and SIGTERM call a function. Only the main thread may: elsewhere they do what they always did."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
