"""Takes: the same as files written at once, in constant memory, and never lost."""

import errno
import json
import os
import re
import tracemalloc
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from moveset.errors import FormatError, InputError, MovesetError
from moveset.io import load, read_metadata, save, take_bvh, take_rows
from moveset.io.take_writer import Take, open_take, recover_take
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import HML22
from tests.motions import wander

SUFFIXES = [".bvh", ".glb", ".npz", ".html"]
every_format = pytest.mark.parametrize("suffix", SUFFIXES)
LENGTHS = (28, 1, 60, 28, 7)


@pytest.fixture(scope="module")
def motion() -> Motion:
    return wander(sum(LENGTHS), seed=3, bend=1.2, turn=2.0)


def pieces(motion: Motion, lengths=LENGTHS) -> list[Motion]:
    return [motion[a:b] for a, b in pairwise(np.cumsum([0, *lengths]))]


def fill(take: Take, stream) -> None:
    for piece in stream:
        take.append(piece)


def write(motion: Motion, path, **options) -> None:
    with open_take(path, motion.skeleton, motion.fps, **options) as take:
        fill(take, pieces(motion))


def unpadded(data: bytes) -> bytes:
    return re.sub(rb"(Frames: \d+) *\n", rb"\1\n", data)


def same(found: Motion, wanted: Motion) -> bool:
    return len(found) == len(wanted) and (found.joints - wanted.joints).norm(dim=-1).max() < 1e-4


@pytest.mark.parametrize("rig", ["hml22", "mixamo"])
@every_format
def test_a_take_is_the_file_that_is_written_at_once(motion, suffix, rig, tmp_path):
    motion, notes = retarget(motion, rig), {"prompt": "a person dances", "seed": 3}
    save(motion, tmp_path / f"whole{suffix}", metadata=notes)
    write(motion, tmp_path / f"take{suffix}", metadata=notes)
    whole, take = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("whole", "take"))
    assert unpadded(take) == whole
    assert (suffix == ".bvh") == (take != whole)
    assert read_metadata(tmp_path / f"take{suffix}") == read_metadata(tmp_path / f"whole{suffix}")
    assert not list(tmp_path.glob("*.part")) + list(tmp_path.glob("*.space"))
    assert same(load(tmp_path / f"take{suffix}"), motion)


@every_format
def test_pieces_in_double_precision_are_written_in_the_files_own(motion, suffix, tmp_path):
    double = Motion(motion.rotations.double(), motion.root.double(), motion.fps, motion.skeleton)
    write(double, tmp_path / f"double{suffix}")
    save(double, tmp_path / f"whole{suffix}")
    write(motion, tmp_path / f"single{suffix}")
    data = [unpadded((tmp_path / f"{name}{suffix}").read_bytes()) for name in ("double", "whole", "single")]
    assert data[0] == data[1] == data[2]


@every_format
def test_the_old_file_stays_until_the_take_ends(motion, suffix, tmp_path):
    path = tmp_path / f"take{suffix}"
    path.write_bytes(b"old")
    with open_take(path, HML22, 20.0) as take:
        take.append(motion)
        assert path.read_bytes() == b"old"
    assert same(load(path), motion)
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask


@every_format
def test_a_take_of_nothing_leaves_nothing(suffix, tmp_path):
    with open_take(tmp_path / f"take{suffix}", HML22, 20.0) as take:
        assert take.frames == 0
    assert take.close() is None
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), BrokenPipeError(errno.EPIPE, "Broken pipe")])
@every_format
def test_what_was_made_before_an_error_is_a_file(motion, suffix, error, tmp_path):
    path = tmp_path / f"take{suffix}"

    def stream():
        yield from pieces(motion)[:3]
        raise error

    take = open_take(path, HML22, 20.0)
    with pytest.raises(type(error)), take:
        fill(take, stream())
    assert same(load(path), motion[:89])
    assert take.close() == path
    assert os.listdir(tmp_path) == [path.name]


@every_format
def test_an_interrupt_in_the_middle_of_a_write_keeps_whole_frames(motion, suffix, tmp_path, monkeypatch):
    path, real = tmp_path / f"take{suffix}", os.write
    take = open_take(path, HML22, 20.0)
    take.append(motion[:28])

    def interrupted(handle, data):
        if len(data) > 1000 and handle == take._store.handle:
            real(handle, data[: len(data) // 2])
            monkeypatch.setattr(os, "write", real)
            raise KeyboardInterrupt
        return real(handle, data)

    monkeypatch.setattr(os, "write", interrupted)
    with pytest.raises(KeyboardInterrupt), take:
        take.append(motion[28:56])
    assert same(load(path), motion[:28])
    with pytest.raises(InputError, match="has ended after 28 frames"):
        take.append(motion[28:56])


class Disk:
    """A disk with so many bytes left for files to grow: writes are cut short, then fail."""

    def __init__(self, monkeypatch, room: int) -> None:
        self.room, self.real = room, os.write
        monkeypatch.setattr(os, "write", self.write)

    def write(self, handle: int, data) -> int:
        grows = max(os.lseek(handle, 0, os.SEEK_CUR) + len(data) - os.fstat(handle).st_size, 0)
        allowed = len(data) - max(grows - self.room, 0)
        if allowed <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.room -= min(grows, self.room)
        return self.real(handle, data[:allowed])


@pytest.mark.parametrize("after", [20, 10_000, 31_000, 40_001])
@every_format
def test_a_full_disk_ends_the_take_after_its_last_whole_frame(motion, suffix, after, tmp_path, monkeypatch):
    path, parts, sizes = tmp_path / f"take{suffix}", pieces(motion, (28,) * 4), {}
    take = open_take(path, HML22, 20.0)
    take.append(parts[0])
    finish = take._store.finish

    def finish_noting_sizes():
        sizes.update({file.name: file.stat().st_size for file in tmp_path.iterdir()})
        finish()

    monkeypatch.setattr(take._store, "finish", finish_noting_sizes)
    Disk(monkeypatch, after)
    with pytest.raises(MovesetError, match=r"No space left on device; the take ends after \d+ frames") as caught, take:
        fill(take, parts[1:])
    assert not isinstance(caught.value, InputError)
    assert f"after {take.frames} frames" in str(caught.value)
    assert 28 <= take.frames < 112
    assert same(load(path), motion[: take.frames])
    assert os.listdir(tmp_path) == [path.name]
    if suffix == ".bvh":
        # No row more would have fitted.
        rows = (tmp_path / path.name).read_bytes().splitlines(keepends=True)[-take.frames :]
        longest = max(map(len, rows)) + 40
        assert after - longest < sum(map(len, rows[28:])) <= after
    elif suffix != ".html":
        # The file is arranged in the space that was kept for it.
        assert path.stat().st_size <= sizes[f".{path.name}.space"]


@every_format
def test_a_disk_that_is_full_from_the_start_is_reported(suffix, tmp_path, monkeypatch):
    Disk(monkeypatch, 100)
    with pytest.raises(MovesetError, match="No space left"):
        open_take(tmp_path / f"take{suffix}", HML22, 20.0)
    assert os.listdir(tmp_path) == []


@every_format
def test_a_take_that_cannot_be_finished_can_be_recovered(motion, suffix, tmp_path, monkeypatch):
    path, real = tmp_path / f"take{suffix}", os.replace

    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    take = open_take(path, HML22, 20.0)
    take.append(motion[:28])
    with pytest.raises(MovesetError, match=r"free some space and recover its 28 frames from .*\.part"):
        take.close()
    monkeypatch.setattr(os, "replace", real)
    assert recover_take(path) == 28
    assert same(load(path), motion[:28])
    assert os.listdir(tmp_path) == [path.name]


def abandoned(motion, path) -> Take:
    """A take as a killed process leaves it."""
    take = open_take(path, HML22, 20.0, metadata={"prompt": "a person walks"})
    fill(take, pieces(motion)[:2])
    take._store.close()
    return take


@pytest.mark.parametrize("tail", [0, 1, 100])
@every_format
def test_a_part_is_recovered_up_to_its_last_whole_frame(motion, suffix, tail, tmp_path):
    path = tmp_path / f"take{suffix}"
    part = abandoned(motion, path)._store.part
    with part.open("ab") as file:
        file.write(b"1" * tail)
    with pytest.raises(InputError, match="moveset convert"):
        open_take(path, HML22, 20.0)
    assert recover_take(part) == 29
    assert same(load(path), motion[:29])
    assert os.listdir(tmp_path) == [path.name]
    if suffix != ".bvh":
        assert read_metadata(path)["prompt"] == "a person walks"
    with pytest.raises(InputError, match="nothing to recover"):
        recover_take(path)


@pytest.mark.parametrize("rescued", [False, True])
@every_format
def test_notes_of_the_file_before_are_not_those_of_the_take(motion, suffix, rescued, tmp_path):
    path = tmp_path / f"take{suffix}"
    save(motion, path, metadata={"prompt": "a person sleeps", "seed": 1})
    if rescued:
        abandoned(motion, path)
        recover_take(path)
    else:
        write(motion, path)
    found = read_metadata(path)
    assert found.get("prompt") == ("a person walks" if rescued and suffix != ".bvh" else None)
    assert "seed" not in found


def test_notes_stay_with_the_file_that_a_take_of_nothing_leaves(motion, tmp_path):
    notes = {"prompt": "a person sleeps"}
    save(motion, tmp_path / "take.bvh", metadata=notes)
    open_take(tmp_path / "take.bvh", HML22, 20.0).close()
    assert read_metadata(tmp_path / "take.bvh") == notes


def test_a_bvh_part_is_a_bvh_file_between_two_pieces(motion, tmp_path):
    with open_take(tmp_path / "take.bvh", HML22, 20.0) as take:
        for end in (28, 29, 89):
            take.append(motion[take.frames : end])
            (tmp_path / "now.bvh").write_bytes((tmp_path / "take.bvh.part").read_bytes())
            assert same(load(tmp_path / "now.bvh"), motion[:end])


@every_format
def test_a_take_in_progress_is_nobody_elses(motion, suffix, tmp_path):
    pytest.importorskip("fcntl")
    path = tmp_path / f"take{suffix}"
    with open_take(path, HML22, 20.0) as take:
        take.append(motion[:28])
        with pytest.raises(InputError, match="is being written"):
            recover_take(path)
        with pytest.raises(InputError, match="exists"):
            open_take(path, HML22, 20.0)
    assert same(load(path), motion[:28])


@pytest.mark.parametrize(
    "data", [b"", b"HIERARCHY\n", b"[1]\n", b'{"format": "moveset take 1"}\n', b"[" * 100_000], ids=range(5)
)
@every_format
def test_parts_that_are_none_are_refused(suffix, data, tmp_path):
    (tmp_path / f"take{suffix}.part").write_bytes(data)
    with pytest.raises(FormatError, match="delete it"):
        recover_take(tmp_path / f"take{suffix}")
    assert (tmp_path / f"take{suffix}.part").exists()


def test_damaged_heads_of_rows_are_refused(motion, tmp_path):
    part = abandoned(motion, tmp_path / "take.npz")._store.part
    head, rows = part.read_bytes().split(b"\n", 1)
    for key, value in (("fps", -1), ("fps", "x"), ("parents", [0] * 22), ("offsets", [[1.0]]), ("joints", [])):
        part.write_bytes(json.dumps({**json.loads(head), key: value}).encode() + b"\n" + rows)
        with pytest.raises(FormatError, match="no take of moveset or its beginning is damaged"):
            recover_take(part)


@every_format
def test_memory_does_not_grow_with_the_take(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr(take_rows, "_BLOCK", 256)
    piece = wander(100, 1)

    def peak(count: int) -> int:
        tracemalloc.start()
        with open_take(tmp_path / f"take{suffix}", HML22, 20.0) as take:
            fill(take, [piece] * count)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    peak(1)  # what is imported at first use does not count
    few, many = peak(4), peak(30)
    assert (tmp_path / f"take{suffix}").stat().st_size > 2**20
    assert many < few + 2**17


def test_takes_end_where_files_would_be_too_long_to_be_read_back(motion, tmp_path, monkeypatch):
    monkeypatch.setattr(take_bvh, "MAX_BYTES", 100_000)
    monkeypatch.setattr(take_rows, "MAX_FRAMES", 60)
    for suffix in (".bvh", ".npz"):
        with open_take(tmp_path / f"take{suffix}", HML22, 20.0) as take:
            while take.room >= 7:
                take.append(motion[take.frames : take.frames + 7])
            with pytest.raises(InputError, match=f"7 more frames after {take.frames} may make .* too long"):
                take.append(motion[:7])
        assert 28 < take.frames < 120
        assert same(load(tmp_path / f"take{suffix}"), motion[: take.frames])
    assert (tmp_path / "take.bvh").stat().st_size <= 100_000


def test_requests_that_make_no_sense_are_named(motion, tmp_path):
    for name in ("take.mp4", "take.amass.npz", "take"):
        with pytest.raises(InputError, match="cannot be written as"):
            open_take(tmp_path / name, HML22, 20.0)
    for name in ("missing/take.bvh", "missing/take.glb"):
        with pytest.raises(InputError, match="cannot write"):
            open_take(tmp_path / name, HML22, 20.0)
    (tmp_path / "folder.bvh").mkdir()
    with pytest.raises(InputError, match="it is a folder"):
        open_take(tmp_path / "folder.bvh", HML22, 20.0)
    with pytest.raises(InputError, match="at -1 fps"):
        open_take(tmp_path / "take.bvh", HML22, -1.0)
    with open_take(tmp_path / "take.bvh", HML22, 20.0) as take:
        take.append(motion)
        with pytest.raises(InputError, match="at 30 fps does not go on"):
            take.append(Motion(motion.rotations, motion.root, 30.0))
        with pytest.raises(InputError, match="'kit21'"):
            take.append(retarget(motion, "kit21"))
        take.append(motion)
    assert len(load(tmp_path / "take.bvh")) == 2 * len(motion)


def test_a_take_is_written_through_a_link_and_over_no_pipe(motion, tmp_path):
    (tmp_path / "link.bvh").symlink_to("real.bvh")
    with open_take(tmp_path / "link.bvh", HML22, 20.0, metadata={"prompt": "walks"}) as take:
        take.append(motion)
    assert (tmp_path / "link.bvh").is_symlink()
    assert len(load(tmp_path / "real.bvh")) == len(motion)
    os.mkfifo(tmp_path / "pipe.glb")
    with pytest.raises(InputError, match="no regular file"):
        open_take(tmp_path / "pipe.glb", HML22, 20.0)


def test_a_take_on_any_skeleton_at_any_rate(tmp_path):
    from moveset.motion.skeleton import Skeleton

    tree = Skeleton("crane", ("base", "arm", "hook"), (-1, 0, 1), torch.tensor([[0, 0, 0], [0, 2.0, 0], [1.0, 0, 0]]))
    one = Motion(rotations.identity(1, 3), torch.zeros(1, 3), 29.97, tree)
    for suffix in SUFFIXES:
        take = open_take(tmp_path / f"take{suffix}", tree, 29.97)
        take.append(one)
        take.append(one)
        assert take.close() == take.path == tmp_path / f"take{suffix}"
        found = load(take.path)
        assert (len(found), found.skeleton.joints) == (2, tree.joints)
        assert found.fps == pytest.approx(29.97)


@every_format
def test_pieces_are_of_the_takes_own_body_whatever_it_is_called(motion, suffix, tmp_path):
    body = replace(RIGS["smpl"], name="body", offsets=1.1 * RIGS["smpl"].offsets)
    made = retarget(motion, body)
    read = load(save(made, tmp_path / "read.bvh"))  # in another order of joints
    assert read.skeleton.joints != body.joints
    with open_take(tmp_path / f"take{suffix}", body, 20.0) as take:
        take.append(made[:28])
        take.append(read[28:])
        with pytest.raises(InputError, match=r"other joints or bones; retarget"):
            take.append(retarget(motion, replace(body, offsets=1.2 * RIGS["smpl"].offsets)))
    found = retarget(load(tmp_path / f"take{suffix}"), body)
    assert same(found, made)
