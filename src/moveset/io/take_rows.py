"""A take on its way to npz or GLB, whose arrays are not laid out frame by frame: rows in a file, arranged at the end.

The file ``walk.glb.part`` begins with a line of JSON (skeleton, frame rate, metadata) and goes on with a row of float32
for each frame: the root's position, then the rotations of the J joints (3 + 4 J numbers). Beside it ``.walk.glb.space``
grows with zeros to the size of the final file, so that a disk that fills up does so while frames are appended and the
frames that were taken can still be arranged.
"""

import json
import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
import torch

from moveset.errors import FormatError, InputError
from moveset.io.arrays import still_arrays
from moveset.io.gltf import glb_head, key_times
from moveset.io.growing import GrowingFile, mended, part_of
from moveset.io.limits import BINARY, MAX_BYTES, MAX_FRAMES, MAX_JOINTS
from moveset.io.packets import frame_rows
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.rigs import as_skeleton
from moveset.motion.skeleton import Skeleton

_FORMAT = "moveset take 1"
_BLOCK = 2048  # frames in memory at a time
_SPARE = 2**16  # bytes for zip directories, and numbers that are longer for longer takes
_MAX_HEAD = 2**24
_DISK_BLOCK = 2**16


@dataclass(frozen=True, eq=False)
class _Head:
    """What is the same for all frames of a take; ``start`` is where its rows begin."""

    skeleton: Skeleton
    fps: float
    metadata: dict[str, Any]
    start: int

    @property
    def row(self) -> int:
        return 4 * (3 + 4 * len(self.skeleton))


class RowsTake(GrowingFile):
    """Grows ``path.part``; ``finish`` arranges its rows as npz or GLB.

    Raises:
        InputError: a path that cannot be written to.
        OSError: no space.
    """

    def __init__(self, path: Path, skeleton: Skeleton, fps: float, metadata: dict[str, Any]) -> None:
        text = _head_text(skeleton, fps, metadata)
        self._head = _Head(skeleton, fps, metadata, len(text))
        self._overhead = _overhead(path, self._head)
        self._space, self._reserved = -1, 0
        super().__init__(path, text)
        try:
            self._space = os.open(_space_of(path), os.O_RDWR | os.O_CREAT | os.O_TRUNC | BINARY, 0o666)
            self._reserve(0)
        except BaseException:
            self.remove()
            raise

    @property
    def room(self) -> int:
        longest = (MAX_BYTES - self._overhead) // _final_row(self._head) if _is_glb(self.path) else MAX_FRAMES
        return longest - self.frames

    def append(self, motion: Motion) -> None:
        try:
            self._reserve(self.frames + len(motion))
        finally:
            fitting = (self._reserved - self._overhead) // _final_row(self._head) - self.frames
            self.grow([row.tobytes() for row in frame_rows(motion)[: max(fitting, 0)]])

    def finish(self) -> None:
        if not self.frames:
            self.remove()
            return
        self.cut()
        self._leave_space()
        _arrange(self.path, self._head, self.frames)
        self.close()
        os.unlink(self.part)

    def close(self) -> None:
        super().close()
        self._leave_space()

    def remove(self) -> None:
        super().remove()
        _space_of(self.path).unlink(missing_ok=True)

    def _leave_space(self) -> None:
        if self._space >= 0:
            handle, self._space = self._space, -1
            os.close(handle)

    def _reserve(self, frames: int) -> None:
        """Zeros up to the size of a final file of so many frames: unlike a hole, they take their place on the disk."""
        wanted = self._overhead + frames * _final_row(self._head)
        os.lseek(self._space, self._reserved, os.SEEK_SET)
        while self._reserved < wanted:
            self._reserved += os.write(self._space, bytes(min(wanted - self._reserved, _DISK_BLOCK)))


def recover_rows(path: Path) -> int:
    """Arrange the whole rows of ``path.part`` as ``path``; errors as for ``mended``."""

    def arrange(file: BinaryIO) -> int:
        head = _read_head(file, part_of(path))
        frames = (os.fstat(file.fileno()).st_size - head.start) // head.row
        if frames:
            _arrange(path, head, frames)
        return frames

    frames = mended(path, arrange)
    part_of(path).unlink()
    return frames


def _arrange(path: Path, head: _Head, frames: int) -> None:
    """Write ``path`` from the rows of its part, in the space that is set aside for it."""
    space = _space_of(path)
    handle = os.open(space, os.O_RDWR | os.O_CREAT | BINARY, 0o666)
    with os.fdopen(handle, "r+b") as file:
        (_arrange_glb if _is_glb(path) else _arrange_npz)(file, part_of(path), head, frames)
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
    os.replace(space, path)


def _arrange_npz(file: IO[bytes], part: Path, head: _Head, frames: int) -> None:
    joints = len(head.skeleton)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, columns, shape in (
            ("rotations", slice(3, None), (frames, joints, 4)),
            ("root", slice(3), (frames, 3)),
        ):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                header = {"descr": "<f4", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(member, header)
                for _, rows in _blocks(part, head, frames):
                    member.write(rows[:, columns].tobytes())
        for name, values in still_arrays(head.skeleton, head.fps, head.metadata).items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)


def _arrange_glb(file: IO[bytes], part: Path, head: _Head, frames: int) -> None:
    joints = len(head.skeleton)
    file.write(glb_head(head.skeleton, head.fps, frames, head.metadata))
    times = file.tell()
    turns, roots = times + 4 * frames, times + (4 + 16 * joints) * frames
    before = None
    for first, rows in _blocks(part, head, frames):
        quats = torch.from_numpy(rows[:, 3:].reshape(-1, joints, 4))
        quats = rotations.unroll(quats if before is None else torch.cat((before, quats)))
        quats, before = quats[-len(rows) :], quats[-1:]
        file.seek(times + 4 * first)
        file.write(key_times(first, len(rows), head.fps).tobytes())
        for j in range(joints):
            file.seek(turns + 16 * (j * frames + first))
            file.write(quats[:, j].numpy().tobytes())
        file.seek(roots + 12 * first)
        file.write(rows[:, :3].tobytes())


def _blocks(part: Path, head: _Head, frames: int) -> Iterator[tuple[int, np.ndarray]]:
    """Number of the first frame and rows (n, 3 + 4 J), all frames in turn."""
    with part.open("rb") as file:
        file.seek(head.start)
        for first in range(0, frames, _BLOCK):
            count = min(_BLOCK, frames - first)
            values = np.frombuffer(bytearray(file.read(count * head.row)), dtype="<f4")
            yield first, values.reshape(count, -1)


def _space_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.space")


def _is_glb(path: Path) -> bool:
    return path.suffix.lower() == ".glb"


def _final_row(head: _Head) -> int:
    """Bytes of a frame in the final file, at most: time, rotations and root."""
    return 16 + 16 * len(head.skeleton)


def _overhead(path: Path, head: _Head) -> int:
    if _is_glb(path):
        return _SPARE + len(glb_head(head.skeleton, head.fps, 1, head.metadata))
    arrays = still_arrays(head.skeleton, head.fps, head.metadata)
    return _SPARE + sum(values.nbytes for values in arrays.values())


def _head_text(skeleton: Skeleton, fps: float, metadata: Mapping[str, Any]) -> bytes:
    tree = {
        "format": _FORMAT,
        "fps": fps,
        "skeleton": skeleton.name,
        "joints": list(skeleton.joints),
        "parents": list(skeleton.parents),
        "offsets": skeleton.offsets.tolist(),
        "metadata": dict(metadata),
    }
    return json.dumps(tree).encode() + b"\n"


def _read_head(file: IO[bytes], part: Path) -> _Head:
    line = file.readline(_MAX_HEAD)
    try:
        tree = json.loads(line)
        if tree["format"] != _FORMAT or not line.endswith(b"\n"):
            raise ValueError(f"not {_FORMAT}")
        names, parents, fps = tuple(tree["joints"]), tuple(tree["parents"]), float(tree["fps"])
        offsets = torch.tensor(tree["offsets"], dtype=torch.float32)
        if not 1 <= len(names) <= MAX_JOINTS or not 0 < fps < math.inf:
            raise ValueError("absurd sizes")
        skeleton = as_skeleton(str(tree["skeleton"]), names, parents, offsets)
        return _Head(skeleton, fps, dict(tree["metadata"]), len(line))
    except (ValueError, KeyError, TypeError, RecursionError, InputError) as error:
        raise FormatError(f"{part} is no take of moveset or its beginning is damaged; delete it") from error
