"""Arrays from strangers: checked before they are allocated."""

import tracemalloc
import zipfile
from io import BytesIO

import numpy as np
import pytest
import torch

from moveset.errors import FormatError, InputError
from moveset.io.numpy_file import array_shape, read_array, read_arrays

BROKEN_HEADERS = (b"{'descr': (", b"{[]: 1}", b"{" + b"-" * 40)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16, np.uint8, ">f4"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_numbers_of_any_kind_are_read(tmp_path, dtype, order):
    values = np.asarray(np.arange(60).reshape(5, 4, 3), dtype=dtype, order=order)
    np.save(tmp_path / "a.npy", values)
    assert array_shape(tmp_path / "a.npy") == (5, 4, 3)
    assert torch.equal(read_array(tmp_path / "a.npy"), torch.arange(60.0).reshape(5, 4, 3))


def test_a_small_file_that_claims_a_huge_array_allocates_nothing(tmp_path):
    header = BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**32,)})
    (tmp_path / "bomb.npy").write_bytes(header.getvalue())
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w") as archive:
        archive.writestr("poses.npy", header.getvalue())
    tracemalloc.start()
    with pytest.raises(FormatError, match="limit"):
        read_array(tmp_path / "bomb.npy")
    with pytest.raises(FormatError, match="limit"):
        read_arrays(tmp_path / "bomb.npz", ["poses"])
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_damage_is_noticed(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((10, 3)))
    data = (tmp_path / "a.npy").read_bytes()
    for damaged in (
        data[:-1],
        data + b"x",
        data[:40],
        data[:3],
        b"",
        b"PK\x03\x04",
        data.replace(b"(10, 3)", b"(-1, 3)"),
        data.replace(b"'descr'", b"'descr\n"),
        *(data[:10] + head.ljust(data.index(b"\n") - 10) + data[data.index(b"\n") :] for head in BROKEN_HEADERS),
    ):
        (tmp_path / "b.npy").write_bytes(damaged)
        with pytest.raises(FormatError):
            read_array(tmp_path / "b.npy")
    np.savez(tmp_path / "a.npz", poses=np.zeros((10, 3)))
    data = (tmp_path / "a.npz").read_bytes()
    for damaged in (data[: len(data) // 2], b"not a zip", data[:60] + b"\xff" * 40 + data[100:]):
        (tmp_path / "b.npz").write_bytes(damaged)
        with pytest.raises(FormatError):
            read_arrays(tmp_path / "b.npz", ["poses"])


def test_objects_are_never_unpickled(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(FormatError, match="kind needed"):
        read_array(tmp_path / "a.npy")
    np.savez(tmp_path / "a.npz", gender=np.array([object()]), trans=np.ones((2, 3)))
    assert read_arrays(tmp_path / "a.npz", ["trans", "poses"]).keys() == {"trans"}
    with pytest.raises(FormatError, match="kind needed"):
        read_arrays(tmp_path / "a.npz", ["gender"])


def test_missing_files(tmp_path):
    for read in (read_array, array_shape, lambda p: read_arrays(p, ["poses"])):
        with pytest.raises(InputError, match=r"(?i)no( such)? file"):
            read(tmp_path / "nothing.npy")
