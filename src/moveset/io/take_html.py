"""A take as a page that plays it: a line of base64 for each frame, between a head and a tail.

The tail is written again behind every piece, so that the part is a whole page itself between two calls.
"""

from pathlib import Path
from typing import BinaryIO

from moveset.io import Metadata
from moveset.io.growing import GrowingText, recover_text
from moveset.io.html import FRAMES_BEGIN, close_page, frame_lines, open_page
from moveset.io.limits import MAX_BYTES, read_limited
from moveset.io.packets import HEADER
from moveset.motion.clip import Motion
from moveset.motion.skeleton import Skeleton


class HtmlTake(GrowingText):
    """Grows ``path.part``, a page that plays what has been made so far.

    Raises:
        InputError: a path that cannot be written to.
        OSError: no space.
    """

    def __init__(self, path: Path, skeleton: Skeleton, fps: float, notes: Metadata) -> None:
        super().__init__(path, open_page(skeleton, fps, notes))
        self._tail = close_page()
        # Four characters of base64 for three bytes, and what stands around them.
        self._row = 4 * -(-(HEADER.size + 4 * (3 + 4 * len(skeleton))) // 3) + 4

    @property
    def room(self) -> int:
        return (MAX_BYTES - self.size - len(self._tail)) // self._row

    def append(self, motion: Motion) -> None:
        try:
            self.grow(frame_lines(motion, self.frames))
        finally:
            self._close_page()

    def _close_page(self) -> None:
        if not self.frames:
            return
        try:
            self.write(self.size, self._tail)
        except OSError:
            # No space even for these few bytes: the last frame's are longer.
            self.frames, self.size = self.frames - 1, self.size - self._row
            self.write(self.size, self._tail)
            raise

    def _seal(self) -> None:
        self.cut(len(self._tail))


def recover_html(path: Path) -> int:
    """Close the page in ``path.part`` after its last whole frame and make it ``path``, as ``recover_text`` does."""
    return recover_text(path, _mend)


def _mend(file: BinaryIO) -> int:
    data = read_limited(file.name)
    begun = data.find(FRAMES_BEGIN) + len(FRAMES_BEGIN)
    frames, end = 0, begun
    while begun >= len(FRAMES_BEGIN) and data.startswith(b',"', end) and (stop := data.find(b'"\n', end)) > 0:
        frames, end = frames + 1, stop + 2
    if frames:
        file.seek(end)
        file.write(close_page())
        file.truncate()
    return frames
