"""A take as BVH: rows are appended as they come, and the number of frames, in a field of fixed width, follows them."""

from pathlib import Path
from typing import BinaryIO

from moveset.io.bvh import BvhText
from moveset.io.growing import GrowingFile
from moveset.io.limits import MAX_BYTES, MAX_LINE
from moveset.motion.clip import Motion
from moveset.motion.skeleton import Skeleton

_COUNT = "{:<10}"  # blanks behind a number are no part of it for any reader
_WIDEST = 16  # bytes of a value and the blank or line end behind it, up to ten million
_HEAD_LINES = 10_000
_BLOCK = 2**20


class BvhTake(GrowingFile):
    """Grows ``path.part``, which is a valid BVH file itself between two calls.

    Raises:
        InputError: a skeleton that BVH cannot hold, or a path that cannot be written to.
        OSError: no space.
    """

    def __init__(self, path: Path, skeleton: Skeleton, fps: float) -> None:
        self._text = BvhText(skeleton, fps)
        head = self._text.head(_COUNT.format(0))
        self._count_at = head.rindex(b"\nFrames: ") + len("\nFrames: ")
        self._widest = _WIDEST * (3 + 3 * len(skeleton))
        super().__init__(path, head)

    @property
    def room(self) -> int:
        """Frames that fit the longest file that is read back, if each were as long as can be."""
        return (MAX_BYTES - self.size) // self._widest

    def append(self, motion: Motion) -> None:
        self.grow(self._text.rows(motion).splitlines(keepends=True))
        self.write(self._count_at, _COUNT.format(self.frames).encode())

    def _seal(self) -> None:
        self.write(self._count_at, _COUNT.format(self.frames).encode())
        self.cut()


def mend_bvh(file: BinaryIO) -> int:
    """Cut a part after its last whole frame; the number of frames, as ``recover_text`` wants it."""
    count_at = -1
    for _ in range(_HEAD_LINES):
        line = file.readline(MAX_LINE)
        if line.startswith(b"Frames: ") and len(line) == len(f"Frames: {_COUNT.format(0)}\n"):
            count_at = file.tell() - len(line) + len("Frames: ")
        if line.startswith(b"Frame Time: ") or not line:
            break
    end = start = file.tell()
    frames = 0
    while block := file.read(_BLOCK):
        if (last := block.rfind(b"\n")) >= 0:
            end = start + last + 1
        frames, start = frames + block.count(b"\n"), start + len(block)
    if count_at < 0 or not frames:
        return 0
    file.seek(count_at)
    file.write(_COUNT.format(frames).encode())
    file.truncate(end)
    return frames
