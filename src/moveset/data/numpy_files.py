"""Arrays in .npy and .npz files that came from somewhere else: the header is checked before anything is allocated."""

import zipfile
import zlib
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import HEADER_ERRORS

MAX_BYTES = 512 * 2**20


def read_npy(path: str | Path) -> Tensor:
    """The numbers in a .npy file, as float32.

    Raises:
        InputError: the file is missing or unreadable.
        FormatError: it is no .npy file of real numbers, is truncated, or claims more than 512 MB.
    """
    path = Path(path)
    _must_be_file(path)
    try:
        with path.open("rb") as file:
            return _array(file, path.stat().st_size, str(path))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; check its permissions") from error


def npy_shape(path: str | Path) -> tuple[int, ...]:
    """The shape of the array in a .npy file, from its header alone.

    Raises:
        InputError: the file is missing or unreadable.
        FormatError: it is no .npy file of real numbers, is truncated, or claims more than 512 MB.
    """
    path = Path(path)
    _must_be_file(path)
    with path.open("rb") as file:
        return _header(file, path.stat().st_size, str(path))[0]


def read_npz(path: str | Path, names: Iterable[str]) -> dict[str, Tensor]:
    """The named arrays of a .npz file that exist in it, as float32; others (objects, strings) are never touched.

    Raises:
        InputError: the file is missing or unreadable.
        FormatError: it is no .npz file, or a named array is not of real numbers, is truncated or larger than 512 MB.
    """
    path = Path(path)
    _must_be_file(path)
    found = {}
    try:
        with zipfile.ZipFile(path) as archive:
            members = {info.filename: info for info in archive.infolist()}
            for name in names:
                info = members.get(f"{name}.npy")
                if info is None:
                    continue
                where = f"{path}, array {name!r}"
                if info.file_size > MAX_BYTES:
                    raise FormatError(f"{where} claims {info.file_size} bytes, more than the limit of {MAX_BYTES}")
                with archive.open(info) as member:
                    data = member.read(MAX_BYTES + 1)
                found[name] = _array(BytesIO(data), len(data), where)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise FormatError(f"{path} is not a readable .npz file ({error}); copy or download it again") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; check its permissions") from error
    return found


def _must_be_file(path: Path) -> None:
    if not path.is_file():
        raise InputError(f"there is no file {path}; check the path")


def _header(file: BinaryIO, size: int, where: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether in Fortran order, and type; the numbers that follow are as many bytes as these say."""
    try:
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        elif version == (2, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(file)
        else:
            raise ValueError(f"version {version}")
    except HEADER_ERRORS as error:
        raise FormatError(f"{where} is not a .npy array ({error}); copy or download it again") from None
    if dtype.kind not in "fiu" or dtype.hasobject or any(n < 0 for n in shape):
        raise FormatError(f"{where} holds {dtype} of shape {shape}; only arrays of real numbers are read")
    count = 1
    for n in shape:
        count *= n
    expected = count * dtype.itemsize
    if expected > MAX_BYTES:
        raise FormatError(f"{where} claims {expected} bytes, more than the limit of {MAX_BYTES}")
    if file.tell() + expected != size:
        raise FormatError(
            f"{where} has {size - file.tell()} bytes of numbers where its header says {expected}; it is damaged"
        )
    return shape, fortran, dtype


def _array(file: BinaryIO, size: int, where: str) -> Tensor:
    shape, fortran, dtype = _header(file, size, where)
    values = np.frombuffer(file.read(), dtype=dtype).reshape(shape, order="F" if fortran else "C")
    return torch.from_numpy(np.array(values, dtype=np.float32, order="C"))
