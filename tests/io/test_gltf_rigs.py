"""Which joints of a GLB file are its skeleton: none that moves is lost, whatever else travels."""

import pytest
import torch

from moveset.io.gltf import write_glb
from moveset.io.gltf_reader import read_glb
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import Skeleton
from tests.io.foreign import pack, shaken, unpack
from tests.motions import wander


@pytest.fixture(scope="module")
def motion():
    return wander(25, seed=1, turn=0.8)


@pytest.fixture
def altered(tmp_path):
    """A motion as read from its GLB file after a function has changed tree and binary chunk."""

    def read(motion, change):
        path = tmp_path / "a.glb"
        write_glb(motion, path)
        path.write_bytes(pack(*change(*unpack(path.read_bytes()))))
        return read_glb(path)

    return read


def move_the_root_of(node):
    """The channel that moves the root moves another node."""

    def change(tree, binary):
        tree["animations"][0]["channels"][-1]["target"]["node"] = node
        return tree, binary

    return change


def test_a_still_root_joint_is_folded_into_the_hips_that_travel(altered):
    tree = Skeleton("rig", ("root", "hips", "leg"), (-1, 0, 1), torch.tensor([[0, 0, 0], [0, 1.0, 0], [0, -0.5, 0]]))
    path = torch.linspace(0, 2, 10)[:, None] * torch.tensor([0.0, 0.1, 1.0])
    found = altered(Motion(rotations.identity(10, 3), path, 20.0, tree), move_the_root_of(1))
    assert found.skeleton.joints == ("hips", "leg")
    # The root joint itself stands half a metre up, so that the lowest joint is on the floor.
    lift = torch.tensor([0.0, -float(tree.rest_positions[:, 1].min()), 0.0])
    assert torch.allclose(found.root, path + lift, atol=1e-6)


def test_the_way_down_to_a_known_pelvis_may_lead_over_still_joints(motion, altered):
    """Two still joints above the pelvis and a prop beside it."""
    wanted = retarget(motion, "ue5")
    rig, still = wanted.skeleton, rotations.identity(25, 1)
    parents = (-1, 0, 1, *(p + 2 for p in rig.parents[1:]), 0)
    offsets = torch.cat((torch.zeros(2, 3), rig.offsets, torch.ones(1, 3)))
    manny = Skeleton("manny", ("top", "root", *rig.joints, "weapon"), parents, offsets)
    turned = torch.cat((still, still, wanted.rotations, still), dim=1)
    found = altered(Motion(turned, motion.root, 20.0, manny), move_the_root_of(2))
    assert found.skeleton.joints == rig.joints
    away = found.joints - wanted.joints
    assert (away - away[:1, :1]).abs().max() < 1e-4


@pytest.mark.parametrize(("rig", "spine"), [("hml22", "spine1"), ("mixamo", "mixamorig:Spine"), ("ue5", "spine_01")])
@pytest.mark.parametrize("by", [0.0004, 0.001, 0.02])
def test_a_spine_that_travels_a_little_keeps_the_legs(motion, altered, rig, spine, by):
    made = retarget(motion, rig)
    found = altered(made, lambda tree, binary: shaken(tree, binary, spine, by))
    assert found.skeleton.joints == made.skeleton.joints
    # The spine rests where it is in the mean.
    assert (found.joints - made.joints).norm(dim=-1).max() < 1.2 * by + 1e-4


def test_an_unknown_creature_keeps_its_legs_too(altered):
    offsets = torch.tensor([[0, 0, 0], [0, 0.3, 0], [0, 0.3, 0], [0, 0.2, 0], [0.2, -0.8, 0], [-0.2, -0.8, 0]])
    bird = Skeleton("bird", ("body", "trunk", "neck", "beak", "leg_a", "leg_b"), (-1, 0, 1, 2, 0, 0), offsets)
    made = Motion(rotations.identity(10, 6), torch.zeros(10, 3), 20.0, bird)
    found = altered(made, lambda tree, binary: shaken(tree, binary, "trunk", 0.01))
    assert found.skeleton.joints == bird.joints


@pytest.mark.parametrize("unit", [1.0, 0.01])
@pytest.mark.parametrize("size", [0.01, 50.0])
@pytest.mark.parametrize(("part", "joints"), [(1e-5, ("top", "hips", "leg")), (1e-3, ("hips", "leg"))])
def test_what_counts_as_travel_is_measured_by_the_body(altered, size, unit, part, joints):
    chain = Skeleton("rig", ("top", "hips", "leg"), (-1, 0, 1), size / unit * torch.eye(3))

    def change(tree, binary):
        tree["nodes"].append({"name": "Armature", "scale": [unit] * 3, "children": [0]})
        tree["scenes"][0]["nodes"][0] = len(tree["nodes"]) - 1
        return shaken(tree, binary, "hips", part * size / unit)

    found = altered(Motion(rotations.identity(10, 3), torch.zeros(10, 3), 20.0, chain), change)
    assert found.skeleton.joints == joints
