"""npz, AMASS npz and npy: round trips, conventions, and files that are wrong."""

import contextlib
import io
import tracemalloc
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from moveset.errors import FormatError, InputError
from moveset.io.amass import write_amass
from moveset.io.arrays import npz_metadata, read_npz, write_npz
from moveset.io.joint_arrays import read_npy, write_npy
from moveset.io.numpy_file import array_shape, read_array
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import HML22
from tests.motions import gait, wander


@pytest.fixture(scope="module")
def motion():
    return wander(30, seed=2, turn=0.5)


@pytest.mark.parametrize("rig", RIGS)
def test_native_npz_comes_back_exactly(motion, rig, tmp_path):
    written = retarget(motion, rig)
    write_npz(written, tmp_path / "a.npz", metadata={"prompt": 'wéird "quotes"', "seed": 3})
    found = read_npz(tmp_path / "a.npz")
    assert torch.equal(found.rotations, written.rotations)
    assert torch.equal(found.root, written.root)
    assert (found.fps, found.skeleton) == (written.fps, written.skeleton)
    assert npz_metadata(tmp_path / "a.npz") == {"prompt": 'wéird "quotes"', "seed": 3}
    with np.load(tmp_path / "a.npz", allow_pickle=False) as plain:
        assert plain["rotations"].dtype == np.float32
        assert plain["joints"].tolist() == list(written.skeleton.joints)


def test_amass_round_trip(motion, tmp_path):
    write_amass(motion, tmp_path / "a.npz")
    found = read_npz(tmp_path / "a.npz")
    assert (found.joints - motion.joints).abs().max() < 1e-5
    assert rotations.angle(rotations.mul(rotations.inv(found.rotations), motion.rotations)).max() < 2e-3
    assert found.skeleton is HML22


def test_amass_of_another_body_with_the_same_names_stands_on_the_same_floor(tmp_path):
    motion = gait(8)
    small = replace(HML22, name="child", offsets=0.7 * HML22.offsets)
    write_amass(Motion(motion.rotations, 0.7 * motion.root, motion.fps, small), tmp_path / "a.npz")
    found = read_npz(tmp_path / "a.npz")
    # It is scaled as by retargeting: it was hml22's pose with the other body's pelvis, in the floor up to the knees.
    assert float(found.joints[..., 1].min()) == pytest.approx(float(motion.joints[..., 1].min()), abs=0.01)


@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, 270.0])
def test_who_crawls_towards_any_side_is_not_stood_up(tmp_path, degrees):
    motion = gait(8)
    # On all fours along the floor: the trunk level, the pelvis a thigh above it.
    down = rotations.mul(rotations.about("y", degrees), rotations.about("x", 90.0))
    turned = motion.rotations.clone()
    turned[:, 0] = down
    turned[:, [HML22.index("left_hip"), HML22.index("right_hip")]] = rotations.about("x", -90.0)
    turned[:, [HML22.index("left_knee"), HML22.index("right_knee")]] = rotations.about("x", 90.0)
    level = Motion(turned, torch.zeros_like(motion.root), motion.fps)
    crawling = Motion(turned, level.root - torch.tensor([0.0, float(level.joints[..., 1].min()), 0.0]), motion.fps)
    write_amass(crawling, tmp_path / "a.npz")
    assert (read_npz(tmp_path / "a.npz").joints - crawling.joints).abs().max() < 1e-5


def test_who_stands_along_y_is_read_as_that(tmp_path):
    motion = gait(8)
    for height in (0.0, -0.9):  # a tracker's floor is anywhere
        moved = motion.root + torch.tensor([0.0, height, 0.0])
        poses = rotations.to_rotvec(motion.rotations).reshape(8, 66).numpy()
        np.savez(tmp_path / "a.npz", poses=poses, trans=moved.numpy() - np.array((0.0, -0.22, 0.03)), fps=20)
        found = read_npz(tmp_path / "a.npz")
        assert (found.joints - replace(motion, root=moved).joints).abs().max() < 1e-5


def test_amass_conventions(tmp_path):
    """A standing body in AMASS: Z up, facing -Y at zero heading, pelvis about 0.9 m up; SMPL-H has 52 joints."""
    write_amass(gait(8), tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as plain:
        assert plain["poses"].shape == (8, 156)
        assert plain["trans"].shape == (8, 3)
        assert not plain["poses"][:, 66:].any()
        assert float(plain["mocap_framerate"]) == 20.0
        assert str(plain["gender"]) == "neutral"
        np.testing.assert_allclose(plain["poses"][:, :3], [[np.pi / 2, 0, 0]] * 8, atol=1e-5)
        assert (plain["trans"][:, 2] > 0.7).all()
        assert (plain["trans"][:, 2] < 1.0).all()
        # +Z in our world is -Y there.
        assert plain["trans"][-1, 1] < plain["trans"][0, 1] - 0.2


@pytest.mark.parametrize("width", [66, 72, 156, 165])
def test_amass_of_any_body_model_and_rate_is_read(width, tmp_path):
    poses = np.zeros((5, width), dtype=np.float32)
    poses[:, 0] = np.pi / 2
    extras = {"gender": np.array("male"), "betas": np.ones(16), "labels": np.array([object()], dtype=object)}
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.zeros((5, 3)), mocap_frame_rate=120, **extras)
    found = read_npz(tmp_path / "a.npz")
    assert (len(found), found.fps) == (5, 120.0)
    up = rotations.rotate(found.global_rotations[0, 0], torch.tensor([0.0, 1.0, 0.0]))
    assert torch.allclose(up, torch.tensor([0.0, 1.0, 0.0]), atol=1e-6)


def test_npy_holds_positions_and_gives_them_back(motion, tmp_path):
    write_npy(motion, tmp_path / "a.npy")
    raw = np.load(tmp_path / "a.npy", allow_pickle=False)
    assert (raw.shape, raw.dtype) == ((30, 22, 3), np.float32)
    np.testing.assert_array_equal(raw, motion.joints.numpy())
    found = read_npy(tmp_path / "a.npy")
    assert (found.joints - motion.joints).abs().max() < 1e-4


def npy(array, **options):
    out = io.BytesIO()
    np.save(out, array, **options)
    return out.getvalue()


def bomb(shape, dtype="<f4"):
    """An npy of 128 bytes whose header promises any size."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + np.uint16(118).tobytes() + header.ljust(117) + b"\n"


BAD_NPY = {
    "promises 32 GiB": bomb((2**31, 22, 3)),
    "promises 10^30 bytes": bomb((10**15, 10**15)),
    "negative": bomb((-5, 22, 3)),
    "objects": npy(np.array([object()]), allow_pickle=True),
    "text": npy(np.array(["a"])),
    "complex": npy(np.zeros((3, 22, 3), dtype=complex)),
    "structured": npy(np.zeros(3, dtype=[("a", "f4")])),
    "21 joints": npy(np.zeros((3, 21, 3))),
    "no frames": npy(np.zeros((0, 22, 3))),
    "flat": npy(np.zeros(66)),
    "NaN": npy(np.full((3, 22, 3), np.nan)),
    "infinite": npy(np.full((3, 22, 3), -np.inf)),
    "absurd": npy(np.full((3, 22, 3), 1e30)),
    "truncated": npy(np.zeros((30, 22, 3)))[:-100],
    "empty": b"",
    "not npy": b"hello, this is no array",
    "pickle": b"\x80\x04\x95\x0b\x00\x00\x00\x00\x00\x00\x00\x8c\x07os.exit\x94.",
    "endless header": b"\x93NUMPY\x01\x00" + np.uint16(118).tobytes() + b"{'shape': (3, 22, 3".ljust(117) + b"\n",
    "long header": b"\x93NUMPY\x02\x00" + np.uint32(20_000).tobytes() + b"{".ljust(20_000) + bytes(9),
    "bytes after its end": npy(np.zeros((3, 22, 3))) + b"x",
    "header of operators": b"\x93NUMPY\x01\x00" + np.uint16(118).tobytes() + (b"{" + b"-" * 40).ljust(117) + b"\n",
    "header of no keys": b"\x93NUMPY\x01\x00" + np.uint16(118).tobytes() + b"{[]: 1}".ljust(117) + b"\n",
    "header is code": b"\x93NUMPY\x01\x00" + np.uint16(118).tobytes() + b"__import__('os').getcwd()".ljust(117) + b"\n",
}


@pytest.mark.parametrize("bad", BAD_NPY)
def test_bad_npy_is_refused_without_allocating(bad, tmp_path):
    (tmp_path / "a.npy").write_bytes(BAD_NPY[bad])
    tracemalloc.start()
    with pytest.raises(FormatError, match=r"a\.npy") as caught:
        read_npy(tmp_path / "a.npy")
    assert "\n" not in str(caught.value)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


@pytest.fixture(scope="module")
def arrays(motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("npz") / "a.npz"
    write_npz(motion, path)
    with np.load(path, allow_pickle=False) as plain:
        return dict(plain)


BAD_FIELDS = {
    "rotations": (np.zeros((3, 22, 4), dtype=np.float32), np.zeros((30, 22, 3)), np.full((30, 22, 4), np.nan)),
    "root": (np.zeros((29, 3)), np.zeros((30, 2)), np.zeros((30, 3), dtype=np.int32)),
    "fps": (np.float64(0), np.float64(-20), np.float64(np.nan), np.array("20"), np.zeros(2)),
    "joints": (
        np.full(22, 0x110000, np.uint32).view("<U1"),
        np.full(22, 0xD800, np.uint32).view("<U1"),
        np.array(["a"] * 21),
        np.arange(22),
        np.array([None] * 22, dtype=object),
    ),
    "parents": (np.zeros(22, dtype=int), np.arange(22) + 1, np.full(22, -1), np.zeros(3, dtype=int)),
    "offsets": (np.full((22, 3), np.inf), np.full((22, 3), -np.inf, dtype=np.float16), np.zeros((21, 3))),
    "skeleton": (np.float64(3),),
}


@pytest.mark.parametrize("name", BAD_FIELDS)
def test_bad_fields_are_refused(arrays, name, tmp_path):
    for value in BAD_FIELDS[name]:
        np.savez(tmp_path / "a.npz", **{**arrays, name: value})
        with pytest.raises(FormatError, match=r"a\.npz"):
            read_npz(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", **{k: v for k, v in arrays.items() if k != name})
    with pytest.raises(FormatError, match=name if name != "rotations" else "neither"):
        read_npz(tmp_path / "a.npz")


def test_bad_amass_is_refused(tmp_path):
    good = {"poses": np.zeros((5, 156)), "trans": np.zeros((5, 3)), "mocap_framerate": np.float64(120)}
    for name, value in (
        ("poses", np.zeros((5, 60))),
        ("poses", np.zeros((5, 67))),
        ("poses", np.zeros((0, 156))),
        ("poses", np.full((5, 156), np.nan)),
        ("trans", np.zeros((4, 3))),
        ("mocap_framerate", np.float64(0)),
        ("mocap_framerate", np.array([object()], dtype=object)),
    ):
        np.savez(tmp_path / "a.npz", **{**good, name: value})
        with pytest.raises(FormatError):
            read_npz(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", poses=good["poses"], trans=good["trans"])
    with pytest.raises(FormatError, match="mocap_framerate"):
        read_npz(tmp_path / "a.npz")


def test_zip_tricks_are_refused(arrays, tmp_path):
    path = tmp_path / "a.npz"
    # A member that unpacks to far more than its header says.
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("rotations.npy", bomb((10**8, 22, 4)) + bytes(10**7))
    with pytest.raises(FormatError, match="more bytes"):
        read_npz(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as bundle:
        bundle.writestr("rotations.npy", npy(arrays["rotations"]))
    with pytest.raises(FormatError, match="unusual"):
        read_npz(path)
    for bit in (5, 6):  # patched data, strong encryption
        with zipfile.ZipFile(path, "w") as bundle:
            bundle.writestr("rotations.npy", npy(arrays["rotations"]))
        data = bytearray(path.read_bytes())
        data[data.index(b"PK\x01\x02") + 8] |= 1 << bit
        path.write_bytes(data)
        with pytest.raises(FormatError, match="rotations"):
            read_npz(path)
    with zipfile.ZipFile(path, "w") as bundle:
        for k in range(100):
            bundle.writestr(f"{k}.npy", b"")
    with pytest.raises(FormatError, match="100 arrays"):
        read_npz(path)


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=6), st.floats(0, 1))
def test_damaged_npz_never_crashes(small_npz, flips, keep):
    data, folder = small_npz
    spoilt = bytearray(data[: max(1, int(len(data) * (1 - keep * keep * keep)))])
    for at, value in flips:
        spoilt[at % len(spoilt)] = value
    (folder / "b.npz").write_bytes(bytes(spoilt))
    with contextlib.suppress(InputError):
        read_npz(folder / "b.npz")


@pytest.fixture(scope="module")
def small_npz(tmp_path_factory):
    folder = tmp_path_factory.mktemp("npz")
    write_npz(Motion(rotations.identity(2, 22), torch.zeros(2, 3)), folder / "a.npz")
    return (folder / "a.npz").read_bytes(), folder


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16, np.uint8, ">f4"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_numbers_of_any_kind_are_read(tmp_path, dtype, order):
    values = np.asarray(np.arange(60).reshape(5, 4, 3), dtype=dtype, order=order)
    np.save(tmp_path / "a.npy", values)
    assert array_shape(tmp_path / "a.npy") == (5, 4, 3)
    assert torch.equal(read_array(tmp_path / "a.npy"), torch.arange(60.0).reshape(5, 4, 3))


def test_missing_files(tmp_path):
    for read in (read_array, array_shape):
        with pytest.raises(InputError, match=r"(?i)no( such)? file"):
            read(tmp_path / "nothing.npy")
