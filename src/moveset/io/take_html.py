"""A take as a page that plays it: a line of base64 for each frame, between a head and a tail.

The tail is written again behind every piece, so that between two calls the part, by a name that ends in .html, is a
whole page itself.
"""

from pathlib import Path
from typing import BinaryIO

from moveset.io import Metadata
from moveset.io.growing import GrowingFile
from moveset.io.html import FRAMES_BEGIN, FRAMES_END, frame_lines, open_page
from moveset.io.limits import MAX_BYTES, read_limited
from moveset.io.packets import HEADER
from moveset.motion.clip import Motion
from moveset.motion.skeleton import Skeleton


class HtmlTake(GrowingFile):
    """Grows ``path.part``, a page that plays what has been made so far.

    Raises:
        InputError: a path that cannot be written to.
        OSError: no space.
    """

    def __init__(self, path: Path, skeleton: Skeleton, fps: float, notes: Metadata) -> None:
        super().__init__(path, open_page(skeleton, fps, notes))
        # Four characters of base64 for three bytes, and what stands around them.
        self._row = 4 * -(-(HEADER.size + 4 * (3 + 4 * len(skeleton))) // 3) + 4

    @property
    def room(self) -> int:
        return (MAX_BYTES - self.size - len(FRAMES_END)) // self._row

    def append(self, motion: Motion) -> None:
        try:
            self.grow(frame_lines(motion, self.frames))
        finally:
            self._close_page()

    def _close_page(self) -> None:
        if not self.frames:
            return
        try:
            self.write(self.size, FRAMES_END)
        except OSError:
            # No space even for these few bytes: the last frame's are longer.
            self.frames, self.size = self.frames - 1, self.size - self._row
            self.write(self.size, FRAMES_END)
            raise

    def _seal(self) -> None:
        self.cut(len(FRAMES_END))


def mend_html(file: BinaryIO) -> int:
    """Close the page of a part after its last whole frame; the number of frames, as ``recover_text`` wants it."""
    data = read_limited(file.name)
    begun = data.find(FRAMES_BEGIN) + len(FRAMES_BEGIN)
    frames, end = 0, begun
    while begun >= len(FRAMES_BEGIN) and data.startswith(b',"', end) and (stop := data.find(b'"\n', end)) > 0:
        frames, end = frames + 1, stop + 2
    if frames:
        file.seek(end)
        file.write(FRAMES_END)
        file.truncate()
    return frames
