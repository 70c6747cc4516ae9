"""NumPy files: native npz, AMASS npz, and npy of joint positions as HumanML3D has them. No pickle, headers first.

F frames, J joints. A native npz holds ``rotations`` (F, J, 4) xyzw and ``root`` (F, 3) m, both float32, ``fps``,
``skeleton`` (its name), ``joints`` (J,) names, ``parents`` (J,) with -1 for the root, ``offsets`` (J, 3) m of the rest
pose, and ``metadata``, a JSON object. Arrays that are no motion (statistics, features, word vectors) are read as they
are by ``read_array`` and ``read_arrays``.
"""

import json
import math
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
import roma
import torch
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import (
    HEADER_ERRORS,
    MAX_FRAMES,
    MAX_JOINTS,
    MAX_NUMBER,
    MAX_POSES,
    atomic_write,
    read_limited,
)
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.positions import solve_rotations
from moveset.motion.retarget import retarget
from moveset.motion.rigs import as_skeleton
from moveset.motion.skeleton import HML22, Skeleton

MAX_NPZ_BYTES = 512 * 2**20
_MEMBERS = 64
# Where SMPL's pelvis lies in its template, metres, rounded from the mean shape: AMASS translates the template, so the
# pelvis of a frame is at trans + this, whatever the pose.
_SMPL_PELVIS = (0.0, -0.22, 0.03)
# Z up, as AMASS has it, to Y up.
_Z_TO_Y = rotations.about("x", -90.0)


def write_npz(motion: Motion, path: str | Path, *, metadata: Mapping[str, object] | None = None) -> None:
    """Write the native npz.

    Raises:
        InputError: the path cannot be written to.
    """
    with atomic_write(path) as file:
        np.savez(
            file,
            rotations=motion.rotations.numpy().astype(np.float32),
            root=motion.root.numpy().astype(np.float32),
            **still_arrays(motion.skeleton, motion.fps, metadata or {}),
        )


def still_arrays(skeleton: Skeleton, fps: float, metadata: Mapping[str, object]) -> dict[str, Any]:
    """What a native npz holds besides rotations and root."""
    return {
        "fps": np.array(fps, dtype=np.float64),
        "skeleton": np.array(skeleton.name),
        "joints": np.array(skeleton.joints),
        "parents": np.array(skeleton.parents, dtype=np.int32),
        "offsets": skeleton.offsets.numpy().astype(np.float32),
        "metadata": np.array(json.dumps(dict(metadata))),
    }


def write_amass(motion: Motion, path: str | Path) -> None:
    """Write an npz as AMASS has them, for SMPL-H tools: Z up, ``poses`` (F, 156), ``trans``, zero ``betas`` and hands.

    SMPL's own joint positions are licensed, so a body of these poses is not exactly this one: hml22's rest pose stands
    in for SMPL's, which differs from it by some degrees in the spine, collars and feet.

    Raises:
        InputError: the path cannot be written to, or the skeleton cannot be retargeted to SMPL's joints.
    """
    motion = motion if motion.skeleton.joints[:22] == HML22.joints else retarget(motion, "hml22")
    up = rotations.inv(_Z_TO_Y).to(motion.rotations)  # pieces of a stream are float64
    local = motion.rotations[:, :22].clone()
    local[:, 0] = rotations.mul(up, local[:, 0])
    poses = np.zeros((len(motion), 156), dtype=np.float64)
    poses[:, :66] = roma.unitquat_to_rotvec(local).reshape(len(motion), 66).numpy()
    with atomic_write(path) as file:
        np.savez(
            file,
            poses=poses,
            trans=(rotations.rotate(up, motion.root).double() - torch.tensor(_SMPL_PELVIS)).numpy(),
            betas=np.zeros(16),
            gender=np.array("neutral"),
            mocap_framerate=np.float64(motion.fps),
        )


def write_npy(motion: Motion, path: str | Path) -> None:
    """Write joint positions (F, J, 3) float32, metres; with hml22 they are HumanML3D's ``new_joints``.

    Raises:
        InputError: the path cannot be written to.
    """
    with atomic_write(path) as file:
        np.save(file, motion.joints.numpy().astype(np.float32))


def read_npz(path: str | Path) -> Motion:
    """Read a native or an AMASS npz.

    Of AMASS files, body poses and translation are read, at the file's frame rate; the body is hml22's whatever the
    shape parameters, so feet of tall or small people end above or below the floor.

    Raises:
        InputError: the file cannot be read.
        FormatError: damaged, arrays missing, of the wrong type or shape, not finite, or over the limits.
    """
    with _Npz(path) as npz:
        if "rotations" in npz.names:
            return _native(npz)
        if "poses" in npz.names:
            return _amass(npz)
        npz.fail("it has neither 'rotations' (moveset) nor 'poses' (AMASS); give one of these kinds of npz")


def read_npy(path: str | Path, *, fps: float = 20.0) -> Motion:
    """Read joint positions (F, 22, 3) in metres, Y up, and find rotations for them (``motion.positions``).

    Raises:
        InputError: the file cannot be read.
        FormatError: damaged, of another shape or type, not finite, or over the limits.
    """
    data = read_limited(path)
    joints = _array(BytesIO(data), len(data), str(path), "fiu")
    if joints.ndim != 3 or joints.shape[1:] != (22, 3) or not 1 <= len(joints) <= MAX_FRAMES:
        raise FormatError(
            f"{path}: its shape {joints.shape} is not (frames, 22, 3) with 1 to {MAX_FRAMES} frames; give joint "
            "positions in HumanML3D's order"
        )
    return solve_rotations(torch.from_numpy(joints.astype(np.float32)), fps)


def read_array(path: str | Path) -> Tensor:
    """The real numbers in an npy file of any shape, as float32; NaN and infinities are whoever's who asks.

    Raises:
        InputError: the file is missing or unreadable.
        FormatError: no npy file of real numbers, damaged, or over 512 MB.
    """
    data = read_limited(path, MAX_NPZ_BYTES)
    return _float32(_array(BytesIO(data), len(data), str(path), "fiu", finite=False))


def read_arrays(path: str | Path, names: Iterable[str]) -> dict[str, Tensor]:
    """The named arrays of an npz that exist in it, as ``read_array``; others (objects, strings) are never touched.

    Raises:
        InputError, FormatError: as ``read_array``, for the file or a named array.
    """
    with _Npz(path) as npz:
        return {name: _float32(npz.array(name, "fiu", None, finite=False)) for name in names if name in npz.names}


def array_shape(path: str | Path) -> tuple[int, ...]:
    """The shape of the array in an npy file, from its header alone.

    Raises:
        InputError, FormatError: as ``read_array``.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"there is no file {path}; check the path")
    with path.open("rb") as file:
        return _header(file, path.stat().st_size, str(path), "fiu")[0]


def npz_metadata(path: str | Path) -> dict[str, Any]:
    """The metadata of a native npz; empty for others.

    Raises:
        InputError, FormatError: as ``read_npz``.
    """
    with _Npz(path) as npz:
        if "metadata" not in npz.names:
            return {}
        try:
            found = json.loads(str(npz.array("metadata", "U", ())))
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{path}: its metadata is not JSON; it is damaged") from error
        return found if isinstance(found, dict) else {}


def _native(npz: "_Npz") -> Motion:
    turns = npz.array("rotations", "f", (None, None, 4))
    frames, joints = turns.shape[:2]
    if not 1 <= frames <= MAX_FRAMES or not 1 <= joints <= MAX_JOINTS or frames * joints > MAX_POSES:
        npz.fail(f"{frames} frames of {joints} joints are not within {MAX_FRAMES} and {MAX_JOINTS}; split the file")
    root = npz.array("root", "f", (frames, 3))
    fps = float(npz.array("fps", "fiu", ()))
    names = tuple(str(name) for name in npz.array("joints", "U", (joints,)))
    parents = tuple(int(p) for p in npz.array("parents", "iu", (joints,)))
    offsets = npz.array("offsets", "f", (joints, 3))
    norms = np.linalg.norm(turns, axis=-1)
    if np.abs(norms - 1.0).max() > 1e-2 or not 0 < fps <= 1000:
        npz.fail(f"its rotations are not unit quaternions or its frame rate {fps:g} is not in (0, 1000]; it is damaged")
    try:
        skeleton = as_skeleton(
            str(npz.array("skeleton", "U", ()))[:64], names, parents, torch.from_numpy(offsets.astype(np.float32))
        )
    except InputError as error:
        raise FormatError(f"{npz.path}: {error}") from error
    return Motion(torch.from_numpy(turns.astype(np.float32)), torch.from_numpy(root.astype(np.float32)), fps, skeleton)


def _amass(npz: "_Npz") -> Motion:
    poses = npz.array("poses", "f", (None, None))
    frames, width = poses.shape
    if not 1 <= frames <= MAX_FRAMES or width < 66 or width % 3:
        npz.fail(
            f"poses of shape {poses.shape} are not 1 to {MAX_FRAMES} frames of at least 66 angles; give SMPL poses"
        )
    trans = npz.array("trans", "f", (frames, 3))
    rate = next((name for name in ("mocap_framerate", "mocap_frame_rate", "fps") if name in npz.names), "")
    if not rate:
        npz.fail("it has no 'mocap_framerate'; add the frame rate")
    fps = float(npz.array(rate, "fiu", ()))
    if not 0 < fps <= 1000:
        npz.fail(f"its frame rate {fps:g} is not in (0, 1000]; it is damaged")
    local = roma.rotvec_to_unitquat(torch.from_numpy(poses[:, :66].astype(np.float64)).reshape(frames, 22, 3))
    local[:, 0] = rotations.mul(_Z_TO_Y.double(), local[:, 0])
    pelvis = torch.from_numpy(trans.astype(np.float64)) + torch.tensor(_SMPL_PELVIS)
    root = rotations.rotate(_Z_TO_Y.double(), pelvis)
    return Motion(rotations.unroll(rotations.normalize(local)).float(), root.float(), fps, HML22)


class _Npz:
    """A zip of arrays of which only the named ones are read, each after its header has been checked."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        try:
            self.zip = zipfile.ZipFile(BytesIO(read_limited(path, MAX_NPZ_BYTES)))
            members = self.zip.infolist()
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            raise FormatError(f"{path}: it is not an npz file or is truncated ({error}); save it again") from error
        if len(members) > _MEMBERS:
            self.fail(f"{len(members)} arrays exceed the limit of {_MEMBERS}; it is no motion")
        self.names = {m.filename.removesuffix(".npy"): m for m in members if m.filename.endswith(".npy")}

    def __enter__(self) -> "_Npz":
        return self

    def __exit__(self, *_: object) -> None:
        self.zip.close()

    def fail(self, message: str) -> NoReturn:
        raise FormatError(f"{self.path}: {message}")

    def array(self, name: str, kinds: str, shape: tuple[int | None, ...] | None, *, finite: bool = True) -> np.ndarray:
        """An array of one of the dtype kinds and of a shape, in which None stands for any size."""
        if name not in self.names:
            self.fail(f"it lacks {name!r}; save it again")
        member = self.names[name]
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            self.fail(f"{name!r} is encrypted or packed in an unusual way; save it with numpy.savez")
        try:
            with self.zip.open(member) as file:
                values = _array(file, member.file_size, f"{self.path}, {name!r}", kinds, finite=finite)
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, NotImplementedError) as error:
            raise FormatError(f"{self.path}: {name!r} is damaged ({error}); save it again") from error
        if shape is not None and (
            len(values.shape) != len(shape) or any(w not in (None, h) for h, w in zip(values.shape, shape, strict=True))
        ):
            wanted = ", ".join("any" if size is None else str(size) for size in shape)
            self.fail(f"{name!r} has shape {values.shape} and not ({wanted}); it is damaged")
        return values


def _header(file: IO[bytes], size: int, where: str, kinds: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether in Fortran order, and type of an npy array; the rest of ``size`` bytes are its numbers."""
    try:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"npy version {version}")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(file, max_header_size=10_000)
    except HEADER_ERRORS as error:
        raise FormatError(f"{where}: no npy header ({str(error)[:80]}); save it again with numpy") from error
    if dtype.kind not in kinds or dtype.hasobject:
        raise FormatError(f"{where}: its type is {dtype}, not numbers of the kind needed; save it as plain numbers")
    needed, rest = math.prod(shape) * dtype.itemsize, size - file.tell()
    if min(shape, default=0) < 0 or needed > min(rest, MAX_NPZ_BYTES):
        raise FormatError(f"{where}: shape {shape} needs more bytes than the file has, or the limit; it is damaged")
    if needed != rest:
        raise FormatError(f"{where}: shape {shape} needs {needed} bytes and the file has {rest}; it is damaged")
    return shape, fortran, dtype


def _array(file: IO[bytes], size: int, where: str, kinds: str, *, finite: bool = True) -> np.ndarray:
    """An npy array from a stream of ``size`` bytes whose header is judged before anything is allocated.

    Raises:
        FormatError: another type than ``kinds`` (numpy's letters), sizes that disagree, or, if they must be
            ``finite``, numbers that are not or absurd.
    """
    shape, fortran, dtype = _header(file, size, where, kinds)
    raw = file.read(math.prod(shape) * dtype.itemsize)
    if len(raw) != math.prod(shape) * dtype.itemsize:
        raise FormatError(f"{where}: {len(raw)} bytes for shape {shape} of {dtype}; it is truncated")
    values = np.frombuffer(raw, dtype=dtype).reshape(shape, order="F" if fortran else "C")
    # The limit itself would be infinite in float16.
    if finite and dtype.kind == "f" and not (np.abs(values) <= np.float64(MAX_NUMBER)).all():
        raise FormatError(f"{where}: it holds NaN, infinite or absurd numbers; save it again")
    return values


def _float32(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float32, order="C"))
