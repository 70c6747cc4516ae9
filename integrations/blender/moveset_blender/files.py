"""Takes in files: .mvst (packets of a stream or clip) and the npz that moveset writes. Nothing in them is run."""

import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from . import quaternions as quat
from .hml22 import HML22
from .packets import read_packets
from .take import MotionError, Skeleton, Take

MAX_BYTES = 512 * 2**20
# What zipfile and numpy raise of a damaged archive, of what is packed in it, of an array's head and of its numbers.
_DAMAGED = (
    zipfile.BadZipFile, zlib.error, tokenize.TokenError, SyntaxError, RuntimeError, ValueError, TypeError,
    ArithmeticError, LookupError, EOFError, MemoryError,
)  # fmt: skip


def read_take(path: str | Path) -> Take:
    """The take in a file, named after it.

    Raises:
        MotionError: another kind of file, too large, unreadable or damaged.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise MotionError(f"{path.name} is larger than {MAX_BYTES >> 20} MiB; cut it into shorter takes")
        if path.suffix.lower() == ".mvst":
            return read_packets(path.read_bytes(), HML22, path.stem)
        if path.suffix.lower() == ".npz":
            return _read_npz(path)
    except OSError as error:
        raise MotionError(f"{path.name} cannot be read: {error.strerror or error}") from error
    raise MotionError(f"{path.name} is neither .mvst nor .npz; import .bvh and .glb with Blender's own importers")


def _read_npz(path: Path) -> Take:
    wanted = ("rotations", "root", "fps", "skeleton", "joints", "parents", "offsets")
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
                raise MotionError(f"{path.name} unpacks to more than {MAX_BYTES >> 20} MiB; cut it into shorter takes")
        with np.load(path, allow_pickle=False) as npz:
            missing = [name for name in wanted if name not in npz.files]
            if missing:
                raise MotionError(f"{path.name} lacks {', '.join(missing)}: it is no npz of moveset; convert it first")
            found = {name: npz[name] for name in wanted}
        skeleton = Skeleton(
            str(found["skeleton"]),
            tuple(str(name) for name in found["joints"]),
            tuple(int(parent) for parent in found["parents"]),
            found["offsets"].astype(np.float64),
        )
        turns, root = found["rotations"].astype(np.float64), found["root"].astype(np.float64)
        take = Take(skeleton, float(found["fps"]), root, turns, path.stem)
    except MotionError:
        raise
    except _DAMAGED as error:
        raise MotionError(f"{path.name} is damaged or no npz of moveset; save it again ({error})") from error
    return Take(skeleton, take.fps, root, quat.normalize(turns), path.stem)
