"""Motion that is written while it is being made, for as long as it goes on, in constant memory.

    with open_take("walk.bvh", HML22, 20.0) as take:
        for motion in stream:
            take.append(motion)

The take grows in ``walk.bvh.part`` and becomes ``walk.bvh`` when the block ends, however it ends: after an error, an
interrupt, a closed pipe or on a full disk the file holds every frame that was written whole. A process that is killed,
or a machine that fails, leaves the part: ``recover_take("walk.bvh")`` makes the file of it, up to the last whole frame.
A BVH or HTML part needs no more than that; an npz or a GLB is arranged from its part in the space that is kept for it.
"""

from pathlib import Path
from typing import Self

from moveset.errors import InputError, MovesetError
from moveset.io import Metadata, save_beside
from moveset.io.growing import GrowingFile, part_of, recover_text
from moveset.io.limits import MAX_FRAMES, MAX_JOINTS, MAX_POSES, NO_SPACE, system_errors, written_to
from moveset.io.take_bvh import BvhTake, mend_bvh
from moveset.io.take_html import HtmlTake, mend_html
from moveset.io.take_rows import RowsTake, recover_rows
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import Skeleton

SUFFIXES = (".bvh", ".glb", ".npz", ".html")


def open_take(path: str | Path, skeleton: Skeleton, fps: float, *, metadata: Metadata | None = None) -> "Take":
    """Begin a take.

    Args:
        path: where to; .bvh, .glb, .npz or .html. A file of this name stays until the take ends and is then replaced.
        metadata: as in ``moveset.io.save``.

    Raises:
        InputError: another extension, a skeleton or rate that cannot be read back, a path that cannot be written to, or
            one of whose takes there is a part already.
        MovesetError: no space to begin with.
    """
    path = written_to(_checked(path))
    if not 0 < fps <= 1000 or len(skeleton) > MAX_JOINTS:
        raise InputError(f"{len(skeleton)} joints at {fps:g} fps are not within {MAX_JOINTS} and (0, 1000]")
    notes = dict(metadata or {})
    with system_errors(f"write {path}", NO_SPACE):
        if path.suffix.lower() == ".bvh":
            store: GrowingFile = BvhTake(path, skeleton, fps)
        elif path.suffix.lower() == ".html":
            store = HtmlTake(path, skeleton, fps, notes)
        else:
            store = RowsTake(path, skeleton, fps, notes)
    return Take(store, skeleton, fps, notes)


class Take:
    """A take in progress, made by ``open_take``; leaving its ``with`` block ends it."""

    def __init__(self, store: GrowingFile, skeleton: Skeleton, fps: float, notes: Metadata) -> None:
        self.path = store.path
        self._store = store
        self._skeleton, self._fps, self._notes = skeleton, fps, notes
        self._stopped = self._closed = False

    @property
    def frames(self) -> int:
        return self._store.frames

    @property
    def room(self) -> int:
        """Frames that can be appended at least before the file is longer than what ``moveset.io.load`` reads."""
        poses = MAX_POSES // len(self._skeleton)
        return min(self._store.room, min(MAX_FRAMES, poses) - self.frames)

    def append(self, motion: Motion) -> None:
        """Write the next frames; when this returns they survive the process.

        Raises:
            InputError: another body (``Skeleton.order_in``) or frame rate, more frames than there is ``room`` for, or a
                take that has ended; nothing is written.
            MovesetError: the disk is full: the frames that fitted are kept, and the take can only be closed.
        """
        if self._stopped or self._closed:
            raise InputError(f"the take {self.path} has ended after {self.frames} frames; begin another")
        if motion.fps != self._fps:
            raise InputError(
                f"a piece at {motion.fps:g} fps does not go on a take at {self._fps:g} fps; resample it first "
                "(motion.resampled)"
            )
        if self._skeleton.order_in(motion.skeleton) is None:
            raise InputError(
                f"a piece on {motion.skeleton.name!r} does not go on a take on {self._skeleton.name!r}, which has "
                "other joints or bones; retarget it first (moveset.motion.retarget.retarget)"
            )
        # The same body may list its joints in another order.
        motion = retarget(motion, self._skeleton)
        if len(motion) > self.room:
            raise InputError(
                f"{len(motion)} more frames after {self.frames} may make {self.path} too long to be read back; close "
                "it and go on in another file"
            )
        try:
            self._store.append(motion)
        except BaseException as error:
            # A part of the piece is missing: what came next would not fit.
            self._stopped = True
            if isinstance(error, OSError):
                raise MovesetError(
                    f"cannot write {self.path}: {error.strerror or error}; the take ends after {self.frames} frames, "
                    "free some space or choose another disk"
                ) from error
            raise

    def close(self) -> Path | None:
        """End the take; where its file is, or None if it has no frames and so no file. Closing again changes nothing.

        Raises:
            MovesetError: the file cannot be finished; its part stays and can be recovered.
        """
        if not self._closed:
            self._closed = True
            remedy = f"free some space and recover its {self.frames} frames from {self._store.part}"
            try:
                with system_errors(f"finish {self.path}", remedy):
                    self._store.finish()
            finally:
                self._store.close()
            if self.frames:
                save_beside(self._notes, self.path)
        return self.path if self.frames else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def recover_take(path: str | Path) -> int:
    """Finish a take whose process was killed, from its part; the number of frames that are in its file now.

    A BVH has no metadata then, for its part has none.

    Args:
        path: of the take or of its part: ``walk.bvh`` or ``walk.bvh.part``.

    Raises:
        InputError: there is no part, it is still being written, or it cannot be read.
        FormatError: a part without a whole frame, or that is none.
        MovesetError: no space for the result.
    """
    path = Path(path)
    path = _checked(path.with_suffix("") if path.suffix == ".part" else path)
    if not (part := part_of(path)).is_file():
        raise InputError(f"there is no {part}, so nothing to recover; give the path that the take was opened with")
    mend = {".bvh": mend_bvh, ".html": mend_html}.get(path.suffix.lower())
    with system_errors(f"recover {path}", "check its permissions and the space on its disk"):
        frames = recover_text(path, mend) if mend else recover_rows(path)
    save_beside({}, path)
    return frames


def _checked(path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES or path.name.lower().endswith(".amass.npz"):
        raise InputError(f"a take cannot be written as {path.name!r}; choose one of {' '.join(SUFFIXES)}")
    return path
