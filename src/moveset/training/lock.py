"""One training per folder: a lock that the system releases even when its holder is killed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from moveset.errors import InputError


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Holds ``folder/.lock``.

    Raises:
        InputError: another process trains in this folder.
    """
    try:
        import fcntl
    except ImportError:  # Windows has no flock; starting twice in one folder goes undetected there
        folder.mkdir(parents=True, exist_ok=True)
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"another training is running in {folder}; stop it or give another folder") from error
        yield
