"""Files of any body: axes of joints, up axis, facing, unit of length and names are found, or said."""

from dataclasses import replace

import pytest
import torch

from moveset.errors import InputError
from moveset.io import Body, load, save
from moveset.io.bvh import write_bvh
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import recognised, roles
from tests.io.foreign import in_units
from tests.motion.other_axes import with_other_axes
from tests.motion.test_reference import foreign, with_rest_first


def turned(motion, turn):
    """The whole file turned, its rest pose as well."""
    body = replace(motion.skeleton, offsets=rotations.rotate(turn, motion.skeleton.offsets))
    local = rotations.mul(rotations.mul(turn, motion.rotations), rotations.inv(turn))
    return Motion(local, rotations.rotate(turn, motion.root), motion.fps, body)


def as_others_write(motion, path):
    """A GLB file that is not known to be ours."""
    save(motion, path)
    path.write_bytes(path.read_bytes().replace(b'"moveset"', b'"somebody'[:8] + b'"'))
    return path


@pytest.fixture(scope="module")
def walk():
    return foreign("mixamo")


def test_bones_along_any_axis_give_what_an_upright_rest_pose_gives(walk, tmp_path):
    shown = with_rest_first(walk)
    upright, other = tmp_path / "upright.bvh", tmp_path / "other.bvh"
    write_bvh(shown, upright)
    write_bvh(with_other_axes(shown, 4), other)
    there = [retarget(load(path), "mixamo").joints for path in (upright, other)]
    assert (there[0] - there[1]).abs().max() < 1e-3


@pytest.mark.parametrize("suffix", [".glb", ".html"])
def test_bodies_are_drawn_on_a_rest_pose_that_stands(suffix, walk, tmp_path):
    shown = with_rest_first(walk)
    found = load(save(with_other_axes(shown, 4), tmp_path / f"a{suffix}"))
    assert (found.joints - shown.joints).abs().max() < 1e-3
    assert torch.allclose(found.skeleton.rest_positions, walk.skeleton.rest_positions, atol=1e-3)


@pytest.mark.parametrize("suffix", [".bvh", ".glb"])
@pytest.mark.parametrize(("axis", "degrees"), [("x", 90.0), ("y", 180.0), ("z", 90.0)])
def test_other_up_axes_and_facings_are_read_upright(suffix, axis, degrees, walk, tmp_path):
    path = tmp_path / f"a{suffix}"
    given = turned(walk, rotations.about(axis, degrees))
    if suffix == ".bvh":
        write_bvh(given, path)
    else:
        as_others_write(given, path)
    found = load(path)
    assert torch.allclose(found.skeleton.rest_positions, walk.skeleton.rest_positions, atol=1e-4)
    assert (found.canonical().joints - walk.canonical().joints).abs().max() < 1e-3


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, 0.0254, 0.3048, 0.1, 0.0254 / 0.45, 0.0034])
@pytest.mark.parametrize("size", [0.85, 1.0])
def test_units_are_guessed_from_the_size_of_the_body(unit, size, walk, tmp_path):
    """As they are where people are that large; units that nobody has make an adult."""
    body = replace(walk, root=size * walk.root, skeleton=replace(walk.skeleton, offsets=size * walk.skeleton.offsets))
    path = in_units(write_bvh(body, tmp_path / "a.bvh"), unit)
    expected = 1.0 / size if unit == 0.0034 else 1.0
    found = load(path).skeleton.rest_positions[:, 1]
    assert float(found.max() - found.min()) == pytest.approx(
        expected * float(body.skeleton.rest_positions[:, 1].max() - body.skeleton.rest_positions[:, 1].min()), rel=0.01
    )
    told = load(path, body=Body(unit=2 * unit)).skeleton.rest_positions
    assert torch.allclose(told, 2 * body.skeleton.rest_positions, atol=1e-3)


@pytest.mark.parametrize("change", ["{}.001", "mixamorig_{}", "mixamorig{}", "{}_12"])
def test_joints_of_other_names_are_recognised(change, walk, tmp_path):
    names = tuple(change.format(name.split(":")[1]) for name in walk.skeleton.joints)
    given = replace(walk, skeleton=replace(walk.skeleton, joints=names))
    found = load(as_others_write(given, tmp_path / "a.glb"))
    assert roles(found.skeleton) == roles(walk.skeleton)


def test_joints_are_recognised_by_the_shape_of_the_body_alone(walk, tmp_path):
    names = tuple(f"joint_{j}" for j in range(len(walk.skeleton)))
    path = write_bvh(replace(walk, skeleton=replace(walk.skeleton, joints=names)), tmp_path / "a.bvh")
    found = load(path)
    by_name = roles(walk.skeleton)
    order = [found.skeleton.joints.index(f"joint_{j}") for j in range(len(names))]
    assert roles(found.skeleton) == {role: order[j] for role, j in by_name.items()}
    assert recognised(found.skeleton).family == "unknown names"


def test_what_is_said_of_joints_and_axes_counts(walk, tmp_path):
    path = write_bvh(walk, tmp_path / "a.bvh")
    names = [name.replace("mixamorig:", "") for name in walk.skeleton.joints]
    assert names
    found = load(path, body=Body(joints={"left_wrist": "mixamorig:LeftForeArm", "neck": "", "left_elbow": ""}))
    known = roles(found.skeleton)
    assert found.skeleton.joints[known["left_wrist"]] == "mixamorig:LeftForeArm"
    assert not {"neck", "left_elbow"} & set(known)
    with pytest.raises(InputError, match="no part 'left_tail'"):
        load(path, body=Body(joints={"left_tail": "mixamorig:LeftForeArm"}))
    with pytest.raises(InputError, match="has no joint 'Thigh'"):
        load(path, body=Body(joints={"left_hip": "Thigh"}))
    with pytest.raises(InputError, match="has no joint for left_hip"):
        load(path, body=Body(joints={"left_hip": ""}))
    assert torch.allclose(load(path, body=Body(up="z")).root[:, 1], walk.root[:, 2], atol=1e-4)
    save(walk, tmp_path / "a.npz")
    with pytest.raises(InputError, match=r"of \.npz files are known"):
        load(tmp_path / "a.npz", body=Body(up="z"))
