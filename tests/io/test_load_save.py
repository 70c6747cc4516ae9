"""``load`` and ``save``: choice by extension, metadata, whole files or none."""

import json
import os
from dataclasses import replace

import pytest
import torch

from moveset.errors import FormatError, InputError, MovesetError
from moveset.io import READABLE, WRITABLE, load, read_metadata, save
from moveset.motion import rotations
from moveset.motion.cleanup import lock_feet
from moveset.motion.clip import Motion
from moveset.motion.join import join
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import Skeleton
from tests.motions import gait, wander

NOTES = {"prompt": "a person walks", "seed": 7, "guidance": 3.5, "model": "tiny"}


@pytest.fixture(scope="module")
def motion():
    return wander(12, seed=3, turn=1.0)


def test_extensions_are_read_in_any_case(motion, tmp_path):
    assert motion.save(str(tmp_path / "A.GLB")) == tmp_path / "A.GLB"
    assert (load(tmp_path / "A.GLB").joints - motion.joints).abs().max() < 1e-4


@pytest.mark.parametrize("suffix", WRITABLE)
def test_every_format_is_written_whole_and_twice_alike(motion, suffix, tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        save(motion[:4], tmp_path / folder / f"a{suffix}", metadata=NOTES)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
        assert path.stat().st_size > 40
    beside = {"a.bvh": ["a.bvh.json"], "a.npy": ["a.npy.json"]}.get(f"a{suffix}", [])
    assert sorted(p.name for p in (tmp_path / "one").iterdir()) == [f"a{suffix}", *beside]


@pytest.mark.parametrize(
    "name", ["a.bvh", "a.glb", "a.gltf", "a.vrma", "a.npz", "a.amass.npz", "a.npy", "a.html", "a.png"]
)
def test_metadata_is_kept_with_the_file_or_beside_it(motion, name, tmp_path):
    save(motion, tmp_path / name, metadata=NOTES)
    assert read_metadata(tmp_path / name).items() >= NOTES.items()
    save(motion, tmp_path / f"b{name}")
    assert not read_metadata(tmp_path / f"b{name}").keys() & NOTES.keys()
    assert not (tmp_path / f"b{name}.json").exists(), "nothing to remember, no file beside"


def test_a_file_beside_that_is_damaged_is_refused(motion, tmp_path):
    save(motion, tmp_path / "a.bvh", metadata=NOTES)
    assert json.loads((tmp_path / "a.bvh.json").read_text()) == NOTES
    (tmp_path / "a.bvh.json").write_text("{")
    with pytest.raises(FormatError, match=r"a\.bvh\.json"):
        read_metadata(tmp_path / "a.bvh")


def test_a_name_that_leaves_no_room_for_a_file_beside_is_read(motion, tmp_path):
    save(motion, tmp_path / "a.npy")
    path = (tmp_path / "a.npy").rename(tmp_path / ("a" * 248 + ".npy"))
    assert len(load(path)) == len(motion)
    assert read_metadata(path) == {}


@pytest.mark.parametrize("name", ["a.bvh", "a.glb", "a.npz", "a.npy"])
def test_half_a_letter_is_remembered(motion, name, tmp_path):
    half = {"prompt": "a man \ud83d waves, \u00e9"}
    assert read_metadata(save(motion, tmp_path / name, metadata=half)).items() >= half.items()


@pytest.mark.parametrize("name", ["a.fbx", "a", "a.bvh.txt", ".bvh", "npz"])
def test_unknown_extensions_are_said_with_the_known_ones(motion, name, tmp_path):
    with pytest.raises(InputError, match=r"\.bvh \.glb \.npz \.npy \.html \.mp4 \.gif \.png; use one"):
        save(motion, tmp_path / name)
    with pytest.raises(InputError, match=r"\.bvh \.glb \.npz \.npy \.html;"):
        load(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_formats_of_other_programs_are_reached_through_blender(motion, tmp_path):
    for suffix in (".fbx", ".usda", ".dae"):
        with pytest.raises(InputError, match=r"open it in Blender and export"):
            load(tmp_path / f"a{suffix}")
        with pytest.raises(InputError, match=r"import that into Blender"):
            save(motion, tmp_path / f"a{suffix}")


def test_pictures_cannot_be_loaded(motion, tmp_path):
    save(motion[:2], tmp_path / "a.png")
    with pytest.raises(InputError, match=r"cannot read .*a\.png"):
        load(tmp_path / "a.png")


@pytest.mark.parametrize("suffix", READABLE)
def test_wrong_contents_are_format_errors(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    for contents in (b"", b"\0" * 100, b"HIERARCHY", b"glTF\2\0\0\0", b"PK\3\4", b"\x93NUMPY\1\0"):
        path.write_bytes(contents)
        with pytest.raises(FormatError) as caught:
            load(path)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 400 + len(str(path))
    with pytest.raises(InputError, match="cannot read"):
        load(tmp_path / f"none{suffix}")


@pytest.mark.parametrize("suffix", WRITABLE)
def test_nothing_half_written_is_left(motion, suffix, tmp_path, monkeypatch):
    """The disk fails when the last bytes are flushed: an old file stays as it was, no temporary one remains."""
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MovesetError, match="No space left") as caught:
        save(motion[:3], path)
    assert not isinstance(caught.value, InputError)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == b"old"


@pytest.mark.parametrize("suffix", WRITABLE)
def test_unwritable_places_are_said(motion, suffix, tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        save(motion[:2], tmp_path / "missing" / f"a{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(InputError, match="folder"):
        save(motion[:2], tmp_path / f"folder{suffix}")
    assert not (tmp_path / "missing").exists()


@pytest.mark.parametrize(
    "name", ["a.bvh", "a.glb", "a.gltf", "a.vrma", "a.npz", "a.amass.npz", "a.npy", "a.html", "a.png"]
)
def test_a_motion_that_is_being_optimised_is_written_as_it_stands(name, tmp_path):
    motion = gait(5)
    save(motion, tmp_path / name)
    expected = (tmp_path / name).read_bytes()
    save(Motion(motion.rotations.clone().requires_grad_(), motion.root.clone().requires_grad_()), tmp_path / name)
    assert (tmp_path / name).read_bytes() == expected


def test_a_picture_is_drawn_at_the_slowest_rate(tmp_path):
    assert save(Motion(gait(3).rotations, torch.zeros(3, 3), 0.01), tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.filterwarnings("ignore:.*frames a second are unusual")
@pytest.mark.parametrize("fps", [0.01, 29.97, 1000.0])
@pytest.mark.parametrize("name", ["a.bvh", "a.glb", "a.npz", "a.amass.npz", "a.html"])
def test_rates_are_read_back(name, fps, tmp_path):
    found = load(save(Motion(gait(5).rotations, torch.zeros(5, 3), fps), tmp_path / name))
    # BVH has the time of a frame, with nine decimals; motions of unlike rates could not be joined.
    assert (len(found), found.fps) == (5, fps)


@pytest.mark.parametrize("suffix", sorted(READABLE))
def test_what_could_not_be_read_back_is_not_written(suffix, tmp_path, monkeypatch):
    one = Skeleton("one", ("base",), (-1,), torch.zeros(1, 3))
    with pytest.raises(InputError, match="100001 frames of 1 joints exceed what is read back"):
        save(Motion(rotations.identity(100_001, 1), torch.zeros(100_001, 3), 20.0, one), tmp_path / f"a{suffix}")
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr("moveset.io.limits.MAX_POSES", 100)
    if suffix in (".npz", ".glb", ".gltf"):
        with pytest.raises(InputError, match="100 poses"):
            save(gait(5), tmp_path / f"a{suffix}")


@pytest.mark.parametrize("size", [1.0, 1.1])
@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".npz", ".html"])
@pytest.mark.parametrize("rig", RIGS)
def test_files_of_one_body_can_be_joined_with_each_other_and_with_what_was_written(motion, rig, suffix, size, tmp_path):
    """BVH lists joints depth first and calls the skeleton by the file's name."""
    body = replace(RIGS[rig], name="body", offsets=size * RIGS[rig].offsets)
    written = retarget(motion, body)
    walk, run = (load(save(written, tmp_path / f"{name}{suffix}")) for name in ("walk", "run"))
    joined = join([written, walk, run])
    assert joined.skeleton is body
    assert (joined.joints - join([written] * 3).joints).abs().max() < 1e-3
    there = retarget(walk, body)
    assert (there.joints - written.joints).abs().max() < 1e-4
    assert (len(walk.skeleton.pairs), len(walk.skeleton.feet)) == (len(body.pairs), 4)


def test_a_file_called_as_a_built_in_skeleton_is_not_taken_for_it(motion, tmp_path):
    body = replace(RIGS["mixamo"], offsets=1.1 * RIGS["mixamo"].offsets)
    found = load(save(retarget(motion, body), tmp_path / "hml22.bvh"))
    assert found.skeleton.name not in RIGS
    with pytest.raises(InputError, match="retarget"):
        lock_feet(found)


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".npz", ".html"])
@pytest.mark.parametrize("size", [0.0, 0.001, 0.1, 30.0])
def test_own_files_keep_the_size_of_what_is_no_human(size, suffix, tmp_path):
    tree = Skeleton("crane", ("the base", "arm", "a hook"), (-1, 0, 1), size * torch.eye(3))
    for skeleton in (tree, Skeleton("one", ("base",), (-1,), torch.zeros(1, 3))):
        made = Motion(gait(5).rotations[:, : len(skeleton)], gait(5).root, 20.0, skeleton)
        found = load(save(made, tmp_path / f"a{suffix}"))
        assert (found.joints - made.joints).abs().max() < 1e-4
        assert len(join([made, found])) == 10
