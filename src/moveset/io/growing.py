"""Files that grow by whole frames under a name of their own, ``walk.bvh.part``, and become ``walk.bvh`` in the end.

Whatever ends the writing, the first ``frames`` frames are whole and in the first ``size`` bytes: what a full disk, an
interrupt or an error cut in two lies behind them. Bytes go to the system at once, so a killed process loses at most the
piece that it was writing.
"""

import os
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import accumulate
from pathlib import Path
from typing import BinaryIO

from moveset.errors import FormatError, InputError
from moveset.io.limits import BINARY, NO_FOLDER, system_errors
from moveset.io.process import claim
from moveset.motion.clip import Motion

_BUSY = "{} is being written; stop that first"


class GrowingFile(ABC):
    """``path`` with ``.part`` behind its name, created with a head, locked as long as it is open, ``path`` at the end.

    Raises:
        InputError: there is such a file already, or the folder is missing or cannot be written to.
        OSError: there is no space for the head.
    """

    def __init__(self, path: Path, head: bytes) -> None:
        self.path, self.part = path, part_of(path)
        self.frames, self.size = 0, len(head)
        with system_errors(f"write {path}", NO_FOLDER, InputError):
            try:
                self.handle = os.open(self.part, os.O_RDWR | os.O_CREAT | os.O_EXCL | BINARY, 0o666)
            except FileExistsError as error:
                raise InputError(
                    f"{self.part} exists: a take of this name is being written or was cut off; rescue it with "
                    "`moveset convert` of that .part, delete it, or give another name"
                ) from error
        try:
            claim(self.handle, _BUSY.format(self.part))
            self.write(0, head)
        except BaseException:
            self.remove()
            raise

    @property
    @abstractmethod
    def room(self) -> int:
        """Frames that fit the longest file that is read back."""

    @abstractmethod
    def append(self, motion: Motion) -> None:
        """Raises OSError on a full disk, having kept the frames that fitted."""

    def finish(self) -> None:
        """Become ``path``, or nothing if there are no frames."""
        if not self.frames:
            self.remove()
            return
        self._seal()
        self.close()
        os.replace(self.part, self.path)

    def _seal(self) -> None:
        """Bring the part to the last byte of the file that it becomes."""
        self.cut()

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


def recover_text(path: Path, mend: Callable[[BinaryIO], int]) -> int:
    """Make ``path.part``, mended, ``path``; arguments and errors as for ``mended``."""
    frames = mended(path, mend)
    os.replace(part_of(path), path)
    return frames


def mended(path: Path, mend: Callable[[BinaryIO], int]) -> int:
    """Mend ``path.part``, which nobody writes any more; the number of its frames.

    Args:
        mend: makes the best of the whole frames in an open file and counts them; 0 leaves it as it is.

    Raises:
        InputError: it is still being written.
        FormatError: it holds no whole frame, or is no take.
        OSError: it cannot be read or written.
    """
    part = part_of(path)
    with part.open("r+b") as file:
        claim(file.fileno(), _BUSY.format(part))
        if not (frames := mend(file)):
            raise FormatError(f"{part} holds no whole frame of a take; delete it")
        file.flush()
        os.fsync(file.fileno())
    return frames


def part_of(path: Path) -> Path:
    return path.with_name(path.name + ".part")
