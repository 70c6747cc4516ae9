"""Arrays in .npy and .npz files that came from somewhere else: headers are judged first, and no pickle is ever read."""

import math
import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from typing import IO, NoReturn

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import HEADER_ERRORS, MAX_NUMBER, read_limited

MAX_NPZ_BYTES = 512 * 2**20
_MEMBERS = 64
#: What is said of a file that would have to be unpickled.
PICKLED = (
    "it is a pickle, such as MDM's results.npy, which could run anything and is never read; where you trust it, save "
    "the array alone: numpy.save('motion.npy', numpy.load(file, allow_pickle=True).item()['motion']), of shape "
    "(samples, 22, 3, frames) or (frames, 22, 3)"
)


def read_array(path: str | Path) -> Tensor:
    """The real numbers in an npy file of any shape, as float32; NaN and infinities are whoever's who asks.

    Raises:
        InputError: the file is missing or unreadable.
        FormatError: no npy file of real numbers, damaged, or over 512 MB.
    """
    data = read_limited(path, MAX_NPZ_BYTES)
    values = parse_array(BytesIO(data), len(data), str(path), "fiu", finite=False)
    return torch.from_numpy(np.array(values, dtype=np.float32, order="C"))


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


class Npz:
    """A zip of arrays of which only the named ones are read, each after its header has been checked."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        try:
            self.zip = zipfile.ZipFile(BytesIO(read_limited(path, MAX_NPZ_BYTES)))
            members = self.zip.infolist()
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            raise FormatError(
                f"{path}: it is not an npz file or is truncated ({_one_line(error)}); save it again"
            ) from error
        if len(members) > _MEMBERS:
            self.fail(f"{len(members)} arrays exceed the limit of {_MEMBERS}; it is no motion")
        self.names = {m.filename.removesuffix(".npy"): m for m in members if m.filename.endswith(".npy")}

    def fail(self, message: str) -> NoReturn:
        raise FormatError(f"{self.path}: {message}")

    def array(self, name: str, kinds: str, shape: tuple[int | None, ...] | None) -> np.ndarray:
        """An array of one of the dtype kinds and of a shape, in which None stands for any size."""
        if name not in self.names:
            self.fail(f"it lacks {name!r}; save it again")
        member = self.names[name]
        if member.flag_bits & 1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            self.fail(f"{name!r} is encrypted or packed in an unusual way; save it with numpy.savez")
        try:
            with self.zip.open(member) as file:
                values = parse_array(file, member.file_size, f"{self.path}, {name!r}", kinds)
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, NotImplementedError) as error:
            raise FormatError(f"{self.path}: {name!r} is damaged ({_one_line(error)}); save it again") from error
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
        raise FormatError(f"{where}: no npy header ({_one_line(error)}); save it again with numpy") from error
    if dtype.hasobject:
        raise FormatError(f"{where}: its type is {dtype}, not numbers of the kind needed: {PICKLED}")
    if dtype.kind not in kinds:
        raise FormatError(f"{where}: its type is {dtype}, not numbers of the kind needed; save it as plain numbers")
    needed, rest = math.prod(shape) * dtype.itemsize, size - file.tell()
    if min(shape, default=0) < 0 or needed > min(rest, MAX_NPZ_BYTES):
        raise FormatError(f"{where}: shape {shape} needs more bytes than the file has, or the limit; it is damaged")
    if needed != rest:
        raise FormatError(f"{where}: shape {shape} needs {needed} bytes and the file has {rest}; it is damaged")
    return shape, fortran, dtype


def parse_array(file: IO[bytes], size: int, where: str, kinds: str, *, finite: bool = True) -> np.ndarray:
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
    if dtype.kind == "U":
        codes = values.astype(dtype.newbyteorder("=")).reshape(-1).view(np.uint32)
        if codes.size and (codes.max() > 0x10FFFF or ((codes >= 0xD800) & (codes < 0xE000)).any()):
            raise FormatError(f"{where}: its text has letters that do not exist; it is damaged")
    # The limit itself would be infinite in float16.
    if finite and dtype.kind == "f" and not (np.abs(values) <= np.float64(MAX_NUMBER)).all():
        raise FormatError(f"{where}: it holds numbers that are not finite (NaN, infinite) or absurd; save it again")
    return values


def _one_line(error: Exception) -> str:
    return " ".join(str(error)[:80].split())
