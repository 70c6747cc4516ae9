"""Files that grow by whole frames under a name of their own, ``walk.bvh.part``, and become ``walk.bvh`` in the end.

Whatever ends the writing, the first ``frames`` frames are whole and in the first ``size`` bytes: what a full disk, an
interrupt or an error cut in two lies behind them. Bytes go to the system at once, so a killed process loses at most the
piece that it was writing.
"""

import os
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import accumulate
from pathlib import Path
from typing import BinaryIO

from moveset.errors import FormatError, InputError

_BINARY = getattr(os, "O_BINARY", 0)  # Windows would write line ends of its own


class GrowingFile:
    """``path`` with ``.part`` behind its name, created with a head, and locked as long as it is open.

    Raises:
        InputError: there is such a file already, or the folder is missing or cannot be written to.
        OSError: there is no space for the head.
    """

    def __init__(self, path: Path, head: bytes) -> None:
        self.part = part_of(path)
        self.frames, self.size = 0, len(head)
        try:
            self.handle = os.open(self.part, os.O_RDWR | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
        except FileExistsError as error:
            raise InputError(
                f"{self.part} exists: a take of this name is being written or was cut off; rescue it with "
                "`moveset convert` of that .part, delete it, or give another name"
            ) from error
        except OSError as error:
            raise InputError(
                f"cannot write {path}: {error.strerror or error}; choose a folder that exists and can be written to"
            ) from error
        try:
            claim(self.handle, self.part)
            self.write(0, head)
        except BaseException:
            self.remove()
            raise

    def grow(self, rows: Sequence[bytes]) -> None:
        """Append frames; those that could be written whole count, also when this raises.

        Raises:
            OSError: the disk is full.
        """
        ends, done = list(accumulate(map(len, rows))), 0
        data = memoryview(b"".join(rows))
        try:
            os.lseek(self.handle, self.size, os.SEEK_SET)
            while done < len(data):
                done += os.write(self.handle, data[done:])
        finally:
            whole = bisect_right(ends, done)
            self.frames, self.size = self.frames + whole, self.size + (ends[whole - 1] if whole else 0)

    def write(self, at: int, data: bytes) -> None:
        """Overwrite some bytes.

        Raises:
            OSError: the disk is full.
        """
        os.lseek(self.handle, at, os.SEEK_SET)
        view = memoryview(data)
        while view:
            view = view[os.write(self.handle, view) :]

    def cut(self, tail: int = 0) -> None:
        """Drop what is neither a whole frame nor one of ``tail`` bytes behind them; have the disk confirm the rest."""
        os.ftruncate(self.handle, self.size + tail)
        os.fsync(self.handle)

    def close(self) -> None:
        if self.handle >= 0:
            handle, self.handle = self.handle, -1
            os.close(handle)

    def remove(self) -> None:
        self.close()
        self.part.unlink(missing_ok=True)


class GrowingText:
    """A take in a text format: ``path.part`` is a valid file itself between two calls, and becomes ``path`` at the end.

    Raises:
        InputError: a path that cannot be written to.
        OSError: there is no space for the head.
    """

    def __init__(self, path: Path, head: bytes) -> None:
        self.path = path
        self._file = GrowingFile(path, head)

    @property
    def part(self) -> Path:
        return self._file.part

    @property
    def frames(self) -> int:
        return self._file.frames

    def finish(self) -> None:
        """Become ``path``, or nothing if there are no frames."""
        if not self.frames:
            self._file.remove()
            return
        self._seal()
        self._file.close()
        os.replace(self.part, self.path)

    def close(self) -> None:
        self._file.close()

    def _seal(self) -> None:
        """Bring the part to the last byte of the file that it becomes."""
        self._file.cut()


def recover_text(path: Path, mend: Callable[[BinaryIO], int]) -> int:
    """Make ``path.part``, which nobody writes any more, ``path``; the number of its frames.

    Args:
        mend: cuts an open file after its last whole frame, makes it valid and counts its frames; 0 leaves it as it is.

    Raises:
        InputError: it is still being written.
        FormatError: it holds no whole frame, or is no take.
        OSError: it cannot be read or written.
    """
    part = part_of(path)
    with part.open("r+b") as file:
        claim(file.fileno(), part)
        if not (frames := mend(file)):
            raise FormatError(f"{part} holds no whole frame of a take; delete it")
        file.flush()
        os.fsync(file.fileno())
    os.replace(part, path)
    return frames


def part_of(path: Path) -> Path:
    return path.with_name(path.name + ".part")


def claim(handle: int, part: Path) -> None:
    """Lock an open file; the system lets go of it when its holder ends, however that happens.

    Raises:
        InputError: another process writes it.
    """
    try:
        import fcntl
    except ImportError:  # Windows has no flock; there nobody is kept from a file that is being written
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(f"{part} is being written; stop that first") from error
