"""Limits for files that came from somewhere else, and writes that leave nothing half-written."""

import os
import secrets
import tokenize
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from moveset.errors import FormatError, InputError, MovesetError

MAX_BYTES = 256 * 2**20
MAX_LINE = 64 * 2**10
MAX_JOINTS = 512
MAX_DEPTH = 128
MAX_FRAMES = 100_000
# Frames times joints: what may be unfolded from a file whose joints need not have a channel each.
MAX_POSES = 4_000_000
MAX_NUMBER = 1e7
MAX_JOINT_NAME = 256  # characters: namespaces of references in references are long
BINARY = getattr(os, "O_BINARY", 0)  # Windows would write line ends of its own
NO_FOLDER, NO_SPACE = "choose a folder that exists and can be written to", "free some space or choose another disk"
#: What numpy raises for the header of an array, which it parses as Python.
HEADER_ERRORS = (ValueError, TypeError, EOFError, SyntaxError, RecursionError, MemoryError, tokenize.TokenError)


@contextmanager
def system_errors(doing: str, remedy: str, kind: type[MovesetError] = MovesetError) -> Iterator[None]:
    """What the system refuses, in one sentence: "cannot write walk.bvh: No space left on device; free some space".

    Raises:
        kind: for any OSError.
    """
    try:
        yield
    except OSError as error:
        raise kind(f"cannot {doing}: {error.strerror or error}; {remedy}") from error


def plain_text(text: object, most: int) -> str:
    """The first ``most`` characters of what a file's JSON calls something.

    Half a surrogate pair, which JSON may spell, is no letter that a file could be written with: it becomes "?".
    """
    return str(text)[:most].encode("utf-8", "replace").decode()


def read_limited(path: str | Path, max_bytes: int = MAX_BYTES) -> bytes:
    """The bytes of a regular file of at most ``max_bytes``.

    Raises:
        InputError: the file is missing, unreadable, or not a regular file (a pipe could block for ever).
        FormatError: the file is larger than ``max_bytes``.
    """
    path = Path(path)
    with system_errors(f"read {path}", "check the path and its permissions", InputError):
        if path.exists() and not path.is_file():
            raise InputError(f"{path} is not a regular file; give the path of a file")
        with path.open("rb") as file:
            # What is asked for is set aside at once, so ask for no more than there is.
            size = os.fstat(file.fileno()).st_size
            data = file.read(size + 1) if size <= max_bytes else b""
    if max(size, len(data)) > max_bytes:
        raise FormatError(f"{path} is larger than the limit of {max_bytes / 2**20:g} MB; split or reduce it")
    return data


def written_to(path: str | Path) -> Path:
    """Where a file is written for ``path``: there, or, for a link, where that leads.

    Raises:
        InputError: there is something that a file cannot take the place of: a folder, a pipe, a device.
    """
    path = Path(path)
    # A rename would replace the link itself.
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if target.is_dir():
        raise InputError(f"cannot write {path}: it is a folder; give the path of a file")
    if target.exists() and not target.is_file():
        raise InputError(f"cannot write {path}: it is no regular file but a pipe or a device; give the path of a file")
    return target


def make_folder(folder: Path, remedy: str = "choose another place") -> Path:
    """A folder, which is made with those that it is in where they are missing.

    Raises:
        InputError: it cannot be made.
    """
    with system_errors(f"make the folder {folder}", remedy, InputError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_text(path: str | Path, text: str) -> None:
    """A UTF-8 file, by ``atomic_write``."""
    with atomic_write(path) as file:
        file.write(text.encode())


@contextmanager
def atomic_write(path: str | Path) -> Iterator[IO[bytes]]:
    """A binary file that appears at ``path`` whole or not at all.

    The bytes go to a hidden temporary file beside ``path``, or beside what that links to, which is fsynced and renamed
    when the block ends well and removed when it does not.

    Raises:
        InputError: the folder is missing or cannot be written to, or ``path`` is a folder, a pipe or a device.
        MovesetError: writing fails half-way, for example on a full disk.
    """
    path = written_to(path)
    name = path.with_name(f".{path.name[:32]}.{secrets.token_hex(8)}.part")
    with system_errors(f"write {path}", NO_FOLDER, InputError):
        # Not mkstemp, whose files are private: giving them the usual permissions takes the umask, which a process can
        # only read by changing it, for all its threads.
        handle = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL | BINARY, 0o666)
    try:
        with system_errors(f"write {path}", NO_SPACE):
            with os.fdopen(handle, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, path)
    except BaseException:
        name.unlink(missing_ok=True)
        raise
