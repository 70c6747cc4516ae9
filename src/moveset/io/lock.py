"""One process at a time in a folder: a lock that the system releases even when its holder is killed."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from moveset.errors import InputError

#: Whether there are locks: Windows has no flock, and nobody is kept out there.
LOCKS = find_spec("fcntl") is not None


@contextmanager
def locked(folder: Path, busy: str | None = None) -> Iterator[None]:
    """Holds ``folder/.lock``; the folder is made if it is not there.

    Args:
        busy: what to say if another process holds it; None waits for that one.

    Raises:
        InputError: another process holds it.
        OSError: the folder cannot be made or written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not LOCKS:
        yield
        return
    import fcntl

    with open(folder / ".lock", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if busy is None else fcntl.LOCK_NB))
        except BlockingIOError as error:
            raise InputError(str(busy)) from error
        yield
