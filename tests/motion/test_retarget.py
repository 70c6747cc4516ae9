"""Laws of retargeting: nothing moves on the same skeleton, limbs keep their directions, feet keep to the floor."""

from dataclasses import replace

import pytest
import torch

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.body_axes import leg_length
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS, as_skeleton, get_rig, pairs_by_name, roles
from moveset.motion.skeleton import HML22, Skeleton
from tests.motions import gait, wander

LIMBS = [
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
]
PRESETS = ("smpl", "mixamo", "vrm", "ue5")


def directions(motion):
    """(F, limbs, 3) unit world directions of arms and legs, by role."""
    found = roles(motion.skeleton)
    bones = [motion.joints[:, found[b]] - motion.joints[:, found[a]] for a, b in LIMBS if {a, b} <= set(found)]
    return torch.nn.functional.normalize(torch.stack(bones, dim=1), dim=-1)


def degrees(a, b):
    return torch.rad2deg(torch.atan2(torch.linalg.cross(a, b).norm(dim=-1), (a * b).sum(-1)))


def other_body(height=0.7, splay=0.0):
    """A Mixamo-named body of another size and other proportions, its arms and legs splayed at rest (degrees)."""
    rig = get_rig("mixamo")
    found = roles(rig)
    offsets = height * rig.offsets
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for role, factor, angle in (
            ("knee", 0.9, 0.3), ("ankle", 0.9, 0.3), ("elbow", 1.2, -1.0), ("wrist", 1.1, -1.0), ("hip", 1.4, 0.0)
        ):  # fmt: skip
            j = found[f"{side}_{role}"]
            offsets[j] = factor * rotations.rotate(rotations.about("z", sign * angle * splay), offsets[j])
    return replace(rig, name="other", offsets=offsets)


@pytest.fixture(scope="module")
def motion():
    return wander(40, seed=7, bend=0.4, turn=1.0)


@pytest.mark.parametrize("rig", [*RIGS])
def test_to_itself_is_the_identity(motion, rig):
    there = retarget(motion, rig)
    copy = replace(there.skeleton, name="copy")
    again = retarget(there, copy)
    assert again.skeleton is copy
    turn = rotations.mul(rotations.inv(again.rotations), there.rotations)
    assert rotations.angle(turn).max() < 1e-5
    assert torch.allclose(again.root, there.root, atol=1e-5)
    assert retarget(there, rig) is there


@pytest.mark.parametrize("rig", PRESETS)
def test_presets_lose_nothing(motion, rig):
    there = retarget(motion, rig)
    found = roles(there.skeleton)
    assert len(found) == 22
    assert (there.joints[:, [found[role] for role in HML22.joints]] - motion.joints).abs().max() < 1e-5
    back = retarget(there, "hml22")
    assert rotations.angle(rotations.mul(rotations.inv(back.rotations), motion.rotations)).max() < 1e-5
    assert torch.allclose(back.root, motion.root, atol=1e-5)


def test_through_all_skeletons_and_back(motion):
    there = motion
    for rig in (*PRESETS, "hml22"):
        there = retarget(there, rig)
    assert (there.joints - motion.joints).abs().max() < 1e-3
    # kit21 has no collars and one joint less in its spine; limbs keep their directions, the pelvis its place.
    kit = retarget(retarget(motion, "kit21"), "hml22")
    assert degrees(directions(kit), directions(motion)).max() < 0.1
    assert (kit.joints[:, [1, 2, 4, 5]] - motion.joints[:, [1, 2, 4, 5]]).norm(dim=-1).max() < 0.1


@pytest.mark.parametrize("target", [*PRESETS, other_body(), other_body(1.3, splay=30.0), other_body(0.5, splay=-20.0)])
def test_limbs_keep_their_world_directions(motion, target):
    assert degrees(directions(retarget(motion, target)), directions(motion)).max() < 0.1


@pytest.mark.parametrize("target", ["ue5", "mixamo", other_body(1.3, splay=30.0)])
def test_orientation_of_head_feet_and_hands_is_kept(motion, target):
    there = retarget(motion, target)
    found = roles(there.skeleton)
    for role in ("pelvis", "spine3", "head", "left_ankle", "right_foot"):
        turn = rotations.mul(
            rotations.inv(there.global_rotations[:, found[role]]), motion.global_rotations[:, HML22.index(role)]
        )
        assert rotations.angle(turn).max() < 1e-5
    # A hand follows the correction of its forearm: the same turn relative to it as before.
    for m, names in ((motion, roles(HML22)), (there, found)):
        wrist = m.rotations[:, names["left_wrist"]]
        assert torch.allclose(
            rotations.angle(wrist), rotations.angle(motion.rotations[:, HML22.index("left_wrist")]), atol=1e-4
        )


@pytest.mark.parametrize("target", ["ue5", "vrm", "smpl", "kit21", other_body(0.8, splay=10.0)])
def test_mirroring_commutes(motion, target):
    a, b = retarget(motion.mirrored(), target), retarget(motion, target).mirrored()
    assert (a.joints - b.joints).abs().max() < 1e-4
    assert rotations.angle(rotations.mul(rotations.inv(a.rotations), b.rotations)).max() < 1e-3


def test_turning_the_world_commutes(motion):
    q, t = rotations.yaw(torch.tensor(1.3)), torch.tensor([1.0, 0.0, -2.0])
    body = other_body(0.7)
    scale = leg_length(body, roles(body)) / leg_length(HML22, roles(HML22))
    a, b = retarget(motion.transformed(q, t), body), retarget(motion, body).transformed(q, scale * t)
    assert (a.joints - b.joints).abs().max() < 1e-4


@pytest.mark.parametrize("target", [*PRESETS, other_body(0.6), other_body(1.4)])
def test_planted_feet_stay_planted_on_the_floor(target):
    """The gait plants flat feet without sliding; on a body of any size they neither float, sink nor skate."""
    walk = gait(60)
    there = retarget(walk, target)
    size = leg_length(there.skeleton, roles(there.skeleton)) / leg_length(HML22, roles(HML22))
    toes = [there.skeleton.feet[k] for k in (1, 3)]
    before, after = walk.joints[:, [10, 11]], there.joints[:, toes]
    assert after[..., 1].min() == pytest.approx(0.0, abs=2e-3)
    down = (before[1:, :, 1] < 1e-3) & ((before[1:] - before[:-1]).norm(dim=-1) < 1e-4)
    assert down.any()
    assert after[1:][down][:, 1].abs().max() < 2e-3
    assert (after[1:] - after[:-1]).norm(dim=-1)[down].max() < 5e-3 * size


def test_travel_is_scaled_by_the_legs():
    walk = gait(60)
    there = retarget(walk, other_body(0.5))
    size = leg_length(there.skeleton, roles(there.skeleton)) / leg_length(HML22, roles(HML22))
    assert size == pytest.approx(0.45, abs=1e-3)
    way = (there.root[-1] - there.root[0])[2] / (walk.root[-1] - walk.root[0])[2]
    assert float(way) == pytest.approx(size, rel=1e-3)


def test_joints_without_a_counterpart_keep_their_rest_pose(motion):
    for rig, names in (("ue5", ("spine_02", "spine_04", "neck_02")), ("mixamo", ("mixamorig:LeftToe_End",))):
        there = retarget(motion, rig)
        for name in names:
            still = rotations.angle(there.rotations[:, there.skeleton.index(name)])
            assert still.max() < 1e-5


def test_a_root_above_the_pelvis_carries_the_heading(motion):
    rig = get_rig("ue5")
    joints, parents = ("root", *rig.joints), (-1, *(p + 1 for p in rig.parents))
    offsets = torch.cat((torch.zeros(1, 3), torch.tensor([[0.0, 0.97, 0.0]]), rig.offsets[1:]))
    there = retarget(motion, as_skeleton("manny", joints, parents, offsets))
    lean = there.global_rotations[:, 0]
    assert lean[:, [0, 2]].abs().max() < 1e-6
    found = roles(there.skeleton)
    hips = there.joints[:, [found["left_hip"], found["right_hip"]]]
    assert (hips - motion.joints[:, [1, 2]]).abs().max() < 1e-4


def test_presets_stand_in_their_pose():
    down = [get_rig("ue5").offsets[get_rig("ue5").index(name)] for name in ("lowerarm_l", "hand_r")]
    for offset, sign in zip(down, (1.0, -1.0), strict=True):
        assert torch.allclose(offset / offset.norm(), torch.tensor([sign, -1.0, 0.0]) / 2**0.5, atol=1e-6)
    for rig in PRESETS:
        skeleton = get_rig(rig)
        assert len(skeleton.feet) == 4
        assert (
            Motion(rotations.identity(1, len(skeleton)), torch.zeros(1, 3), 20.0, skeleton)
            .mirrored()
            .joints.allclose(skeleton.rest_positions[None], atol=1e-6)
        ), "the rest pose is symmetric, so mirroring is exact"
    assert [get_rig("mixamo").joints[j] for j in get_rig("mixamo").feet] == [
        "mixamorig:LeftFoot", "mixamorig:LeftToeBase", "mixamorig:RightFoot", "mixamorig:RightToeBase"
    ]  # fmt: skip


def test_names_are_recognised_with_and_without_prefix():
    rig = get_rig("mixamo")
    for change in (lambda n: n.split(":")[1], lambda n: n.replace("mixamorig:", "Armature:mixamorig9:"), str.upper):
        renamed = replace(rig, joints=tuple(map(change, rig.joints)))
        assert roles(renamed) == roles(rig)


def test_sides_are_found_by_name():
    assert pairs_by_name(("Hips", "arm.L", "arm.R", "l_leg", "r_leg", "lShin", "rShin", "leftEye", "rightEye")) == (
        (1, 2), (3, 4), (5, 6), (7, 8)
    )  # fmt: skip
    assert pairs_by_name(("leftover", "tail")) == ()


def test_what_cannot_be_retargeted_is_said(motion):
    with pytest.raises(InputError, match="no skeleton 'mixmo'; choose one of hml22"):
        retarget(motion, "mixmo")
    crane = Skeleton("crane", ("base", "arm"), (-1, 0), torch.tensor([[0, 0, 0], [0, 1.0, 0]]))
    with pytest.raises(InputError, match="'crane' has no joint recognisable as pelvis"):
        retarget(motion, crane)
    with pytest.raises(InputError, match="'crane'"):
        retarget(Motion(rotations.identity(2, 2), torch.zeros(2, 3), 20.0, crane), "vrm")


def test_to_the_same_body_nothing_changes_even_where_no_role_is_known(motion):
    crane = Skeleton("crane", ("base", "arm", "leg"), (-1, 0, 0), torch.eye(3))
    swung = Motion(rotations.normalize(torch.randn(9, 3, 4, generator=torch.Generator().manual_seed(1))),
                   torch.zeros(9, 3), 20.0, crane)  # fmt: skip
    order = [0, 2, 1]
    listed = Skeleton("listed", ("base", "leg", "arm"), (-1, 0, 0), crane.offsets[order])
    there = retarget(swung, listed)
    assert there.skeleton is listed
    assert torch.equal(there.joints, swung.joints[:, order])
    assert torch.equal(retarget(there, crane).rotations, swung.rotations)


@pytest.mark.parametrize("bones", ["legs", "all"])
def test_a_body_without_length_of_leg_is_refused(motion, bones):
    rig = get_rig("mixamo")
    offsets = rig.offsets.clone()
    offsets[[roles(rig)[f"{side}_{part}"] for side in ("left", "right") for part in ("knee", "ankle")]] = 0.0
    flat = replace(rig, name="flat", offsets=offsets if bones == "legs" else torch.zeros_like(offsets))
    with pytest.raises(InputError, match="'flat' has legs of no length"):
        retarget(Motion(retarget(motion, "mixamo").rotations, motion.root, 20.0, flat), "hml22")
    with pytest.raises(InputError, match="'flat' has legs of no length"):
        retarget(motion, flat)
