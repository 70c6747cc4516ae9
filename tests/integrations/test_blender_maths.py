"""What the Blender add-on computes, without Blender: against moveset's own and a model of Blender's bones."""

import importlib
import itertools

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS, get_rig, roles
from moveset.motion.skeleton import HML22
from tests.motions import gait, wander


@pytest.fixture(scope="module")
def load(addon):
    return lambda name: importlib.import_module(f"moveset_blender.{name}")


def take_of(load, motion):
    skeleton = motion.skeleton
    own = load("take").Skeleton(skeleton.name, skeleton.joints, skeleton.parents, skeleton.offsets.double().numpy())
    return load("take").Take(own, motion.fps, motion.root.double().numpy(), motion.rotations.double().numpy())


def rig_of(load, skeleton, seed, *, yaw=0.0, size=1.0):
    """A rig of a skeleton standing on the floor whose bones have random axes of their own, turned and scaled."""
    turn = Rotation.from_euler("z", yaw).as_quat()
    heads = load("armature").to_blender(skeleton.rest_positions.double().numpy())
    heads[:, 2] -= heads[:, 2].min()
    own = Rotation.random(len(skeleton), rng=np.random.default_rng(seed)).as_quat()
    quat = load("quaternions")
    return load("armature").Rig(
        "Character",
        skeleton.joints,
        skeleton.parents,
        size * quat.rotate(turn, heads),
        quat.mul(turn, own),
    )


def blender(rig, pose):
    """Heads (F, J, 3) and turns from rest of a rig in a pose, by Blender's rule in 4x4 matrices:

    pose = parent's pose · parent's rest⁻¹ · rest · channel.
    """
    frames = len(pose.path)
    rest = np.zeros((len(rig.bones), 4, 4))
    rest[:, :3, :3] = Rotation.from_quat(rig.turns).as_matrix()
    rest[:, :3, 3], rest[:, 3, 3] = rig.heads, 1.0
    posed = np.zeros((frames, len(rig.bones), 4, 4))
    for j, parent in enumerate(rig.parents):
        basis = np.tile(np.eye(4), (frames, 1, 1))
        if j in pose.turned:
            basis[:, :3, :3] = Rotation.from_quat(pose.turned[j]).as_matrix()
        if j == pose.mover:
            basis[:, :3, 3] = pose.location
        above = posed[:, parent] @ np.linalg.inv(rest[parent]) if parent >= 0 else np.eye(4)
        posed[:, j] = above @ rest[j] @ basis
    turned = posed[..., :3, :3] @ np.swapaxes(rest[:, :3, :3], 1, 2)
    return posed[..., :3, 3], turned


@pytest.fixture(scope="module")
def motion():
    return wander(40, seed=5, bend=0.6, turn=1.5)


def test_quaternions_are_those_of_moveset(load):
    quat = load("quaternions")
    a, b = (
        rotations.normalize(torch.randn(50, 4, generator=torch.Generator().manual_seed(k)).double()) for k in (1, 2)
    )
    v = torch.randn(50, 3, generator=torch.Generator().manual_seed(3)).double()
    t = torch.linspace(0, 1, 50).double()
    assert np.allclose(quat.mul(a.numpy(), b.numpy()), rotations.mul(a, b), atol=1e-14)
    assert np.allclose(quat.rotate(a.numpy(), v.numpy()), rotations.rotate(a, v), atol=1e-14)
    assert np.allclose(quat.slerp(a.numpy(), b.numpy(), t.numpy()), rotations.slerp(a, b, t), atol=1e-9)
    assert np.allclose(quat.unroll(a.numpy()), rotations.unroll(a), atol=0)
    for u, w in itertools.pairwise(v):
        arc = quat.between(u.numpy(), w.numpy())
        assert np.allclose(arc, rotations.between(u, w), atol=1e-12)
        opposite = quat.rotate(quat.between(u.numpy(), -u.numpy()), u.numpy())
        assert np.allclose(opposite, -u.numpy(), atol=1e-9)
    turned = quat.from_matrix(Rotation.from_quat(a.numpy()).as_matrix())
    assert np.allclose(np.abs((turned * a.numpy()).sum(-1)), 1.0, atol=1e-14)
    half = quat.from_matrix(np.array([np.diag(d) for d in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])]))
    assert np.allclose(np.abs(half), np.eye(4)[:3], atol=1e-14)


def test_the_skeleton_is_hml22(load):
    own = load("hml22").HML22
    assert (own.joints, own.parents) == (HML22.joints, HML22.parents)
    assert np.abs(own.offsets - HML22.offsets.numpy()).max() < 1e-7


@pytest.mark.parametrize("name", ["smpl", "mixamo", "vrm", "ue5"])
def test_names_mean_the_same_as_in_moveset(load, name):
    rig = get_rig(name)
    assert load("roles").find_roles(rig.joints, rig.parents) == roles(rig)
    assert load("roles").find_roles([joint.upper() for joint in rig.joints], rig.parents) == roles(rig)
    with pytest.raises(load("take").MotionError, match="Fox has no bone recognisable as pelvis, left_hip"):
        load("roles").find_roles(["root", "paw"], [-1, 0], "Fox")


def test_a_take_is_the_motion(load, motion):
    take = take_of(load, motion)
    turned, placed = take.world()
    assert np.abs(placed - motion.joints.numpy()).max() < 1e-5
    assert np.abs(np.abs((turned * motion.global_rotations.numpy()).sum(-1)) - 1).max() < 1e-5
    for fps in (30.0, 24.0, 11.5):
        ours, theirs = take.resampled(fps), motion.resampled(fps)
        assert len(ours.root) == len(theirs)
        assert np.abs(ours.world()[1] - theirs.joints.numpy()).max() < 1e-5


def test_blenders_axes(load):
    armature = load("armature")
    left, up, forward = np.eye(3)
    assert np.array_equal(armature.to_blender(np.stack((left, up, forward))), [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    q = Rotation.random(20, rng=np.random.default_rng(0)).as_quat()
    v = np.random.default_rng(1).normal(size=(20, 3))
    quat = load("quaternions")
    there = quat.rotate(armature.turn_to_blender(q), armature.to_blender(v))
    assert np.allclose(there, armature.to_blender(quat.rotate(q, v)), atol=1e-14)
    assert np.array_equal(armature.from_blender(armature.to_blender(v)), v)
    assert np.array_equal(armature.turn_from_blender(armature.turn_to_blender(q)), q)


def shuffled(load, rig):
    """The same rig, its bones listed in the order of their names as far as parents allow."""
    depth = [0] * len(rig.bones)
    for j, parent in enumerate(rig.parents[1:], start=1):
        depth[j] = depth[parent] + 1
    order = sorted(range(len(rig.bones)), key=lambda j: (depth[j], rig.bones[j]))
    parents = tuple(order.index(rig.parents[j]) if j else -1 for j in order)
    names = tuple(rig.bones[j] for j in order)
    return load("armature").Rig(rig.name, names, parents, rig.heads[order], rig.turns[order]), order


@pytest.mark.parametrize("name", ["hml22", "mixamo", "ue5"])
def test_a_posed_armature_has_the_joints_of_the_motion_whatever_its_rolls(load, motion, name):
    motion = retarget(motion, name)
    rig, order = shuffled(load, rig_of(load, motion.skeleton, seed=3))
    pose = load("armature").pose_same(take_of(load, motion), rig)
    heads, _ = blender(rig, pose)
    assert np.abs(heads - load("armature").to_blender(motion.joints.double().numpy())[:, order]).max() < 1e-5
    assert all(((turns[1:] * turns[:-1]).sum(-1) > 0).all() for turns in pose.turned.values())


@pytest.mark.parametrize("name", list(RIGS))
def test_bones_can_be_built(load, name):
    skeleton = get_rig(name)
    bones = load("armature").bones_of(take_of(load, Motion(rotations.identity(1, len(skeleton)), torch.zeros(1, 3),
                                                           20.0, skeleton)).skeleton)  # fmt: skip
    along = bones.tails - bones.heads
    length = np.linalg.norm(along, axis=1)
    assert bones.heads[:, 2].min() == 0.0
    assert length.min() > 1e-3
    # A roll is only defined by a direction that is not the bone's own.
    across = np.abs((along * bones.rolls).sum(-1)) / length
    assert across.max() < 0.9
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0 and skeleton.parents.count(parent) == 1 and skeleton.offsets[j].norm() > 1e-3:
            assert np.allclose(bones.tails[parent], bones.heads[j])


@pytest.mark.parametrize("name", ["smpl", "mixamo", "vrm", "ue5"])
@pytest.mark.parametrize("yaw", [0.0, 2.1])
def test_retargeting_to_a_preset_is_that_of_moveset(load, motion, name, yaw):
    rig = rig_of(load, get_rig(name), seed=8, yaw=yaw)
    heads, _ = blender(rig, load("retarget").retarget(take_of(load, motion), rig))
    there = load("armature").to_blender(retarget(motion, name).joints.double().numpy())
    # It plays the way the armature looks at rest.
    there = load("quaternions").rotate(Rotation.from_euler("z", yaw).as_quat(), there)
    assert np.abs(heads - there).max() < 1e-5


def test_a_giant_walks_on_the_floor_with_longer_steps(load):
    motion = gait(40)
    rig = rig_of(load, get_rig("mixamo"), seed=1, size=3.0)
    heads, _ = blender(rig, load("retarget").retarget(take_of(load, motion), rig))
    assert (
        np.abs(heads - 3.0 * load("armature").to_blender(retarget(motion, "mixamo").joints.double().numpy())).max()
        < 1e-4
    )
    toes = heads[:, [rig.bones.index(f"mixamorig:{side}ToeBase") for side in ("Left", "Right")], 2]
    assert np.abs(toes.min(axis=1)).max() < 1e-4


def test_shoes_keep_a_character_above_its_soles(load):
    """Toe joints three centimetres above where the character stands stay so when it stands."""
    motion = gait(20, speed=0.0)
    plain, shod = rig_of(load, get_rig("vrm"), seed=1), rig_of(load, get_rig("vrm"), seed=1)
    shod.heads[:, 2] += 0.03
    take = take_of(load, motion)
    heads = [blender(rig, load("retarget").retarget(take, rig))[0] for rig in (plain, shod)]
    assert np.allclose(heads[1] - heads[0], (0.0, 0.0, 0.03), atol=1e-9)


def test_limbs_of_an_a_pose_point_as_those_of_the_take(load, motion):
    rig = rig_of(load, get_rig("ue5"), seed=4)
    heads, _ = blender(rig, load("retarget").retarget(take_of(load, motion), rig))
    placed = load("armature").to_blender(motion.joints.double().numpy())
    for ours, theirs in ((("upperarm_l", "lowerarm_l"), (16, 18)), (("calf_r", "foot_r"), (5, 8))):
        a = heads[:, rig.bones.index(ours[1])] - heads[:, rig.bones.index(ours[0])]
        b = placed[:, theirs[1]] - placed[:, theirs[0]]
        assert np.allclose(a / np.linalg.norm(a, axis=-1, keepdims=True), b / np.linalg.norm(b, axis=-1, keepdims=True),
                           atol=1e-6)  # fmt: skip


def test_what_cannot_be_retargeted_is_said(load, motion):
    error, take = load("take").MotionError, take_of(load, motion)
    rig = rig_of(load, get_rig("mixamo"), seed=1)
    lying = load("armature").Rig("Lying", rig.bones, rig.parents, rig.heads[:, [0, 2, 1]], rig.turns)
    with pytest.raises(error, match="Lying does not stand upright"):
        load("retarget").retarget(take, lying)
    strange = load("armature").Rig("Spider", tuple(f"leg{k}" for k in range(28)), rig.parents, rig.heads, rig.turns)
    with pytest.raises(error, match="Spider has no bone recognisable as pelvis"):
        load("retarget").retarget(take, strange)
