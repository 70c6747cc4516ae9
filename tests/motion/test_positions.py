"""Rotations found from positions: the positions come back, and so do the rotations that positions can show."""

import pytest
import torch

from moveset.data import bandai_namco, cmu
from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.positions import positions_to_motion, solve_rotations
from moveset.motion.skeleton import HML22, KIT21, Skeleton
from tests.motions import gait, shaken, smooth_noise, wander
from tests.takes import motion_of


def degrees_apart(a: Motion, b: Motion):
    return torch.rad2deg(rotations.angle(rotations.mul(rotations.inv(a.global_rotations), b.global_rotations)))


def anatomical(frames: int, seed: int) -> Motion:
    """Trunk, shoulders and hips sway freely; elbows and knees bend as hinges between 10 and 90 degrees."""
    motion = wander(frames, seed, bend=0.2, turn=0.5)
    local = motion.rotations.clone()
    hinges = {18: (0.0, -1.0, 0.0), 19: (0.0, 1.0, 0.0), 4: (1.0, 0.0, 0.0), 5: (1.0, 0.0, 0.0)}
    for joint, axis in hinges.items():
        angle = torch.deg2rad(50.0 + 40.0 * torch.sin(smooth_noise(frames, 1, seed + joint)[:, 0])).float()
        local[:, joint] = rotations.from_axis_angle(torch.tensor(axis).expand(frames, 3), angle)
    return Motion(local, motion.root)


@pytest.mark.parametrize(
    "motion", [wander(40, 1), wander(40, 2, bend=0.8), gait(40), wander(20, 3, KIT21), wander(1, 4)], ids=range(5)
)
def test_joints_come_back(motion):
    found = positions_to_motion(motion.joints, motion.fps, motion.skeleton)
    assert (found.joints - motion.joints).norm(dim=-1).max() < 1e-5


def test_rotations_come_back_where_hinges_show_them():
    motion = anatomical(60, 5)
    error = degrees_apart(positions_to_motion(motion.joints, 20.0), motion)
    for joint in ("pelvis", "spine3"):
        assert error[:, HML22.index(joint)].max() < 0.1, joint
    for joint in ("left_hip", "right_hip", "left_knee", "right_knee", "left_shoulder", "right_shoulder"):
        assert error[:, HML22.index(joint)].median() < 2.0, joint
        assert error[:, HML22.index(joint)].max() < 25.0, joint


def test_turning_the_positions_turns_the_motion():
    motion = gait(40)
    turn = rotations.about("y", 100.0)
    plain = positions_to_motion(motion.joints, 20.0)
    turned = positions_to_motion(rotations.rotate(turn, motion.joints), 20.0)
    expected = plain.transformed(turn, torch.zeros(3))
    assert degrees_apart(turned, expected).max() < 0.1


def test_mirroring_the_positions_mirrors_the_motion():
    motion = anatomical(40, 6)
    mirrored = motion.mirrored()
    found = positions_to_motion(mirrored.joints, 20.0)
    assert degrees_apart(found, positions_to_motion(motion.joints, 20.0).mirrored()).max() < 0.1


def test_straight_limbs_do_not_spin():
    """Stretched arms and legs with a hair of noise: no twist to be seen, and none invented."""
    still = wander(1, 7, bend=0.0)
    joints = still.joints.repeat(60, 1, 1)
    joints = joints + 0.001 * smooth_noise(60, 66, 8, 0.05).reshape(60, 22, 3)
    found = positions_to_motion(joints, 20.0)
    step = torch.rad2deg(rotations.angle(rotations.mul(rotations.inv(found.rotations[1:]), found.rotations[:-1])))
    # A millimetre of noise tilts the shortest bone (6 cm) by about 2 degrees.
    assert step.max() < 6.0


@pytest.mark.parametrize("skeleton", [HML22, KIT21], ids=lambda skeleton: skeleton.name)
def test_a_straight_leg_turns_as_its_foot_points(skeleton):
    turned = torch.zeros(20, len(skeleton), 4)
    turned[..., 0] = 1.0
    hip = skeleton.index("left_hip")
    turned[:, hip] = rotations.about("y", 40.0)
    motion = Motion(turned, torch.zeros(20, 3), 20.0, skeleton)
    found = positions_to_motion(motion.joints, 20.0, skeleton)
    assert degrees_apart(found, motion)[:, hip].max() < 8.0


def test_noise_in_the_positions_is_not_amplified():
    clean = gait(60)
    noisy = clean.joints + 0.003 * smooth_noise(60, 66, 9, 0.1).reshape(60, 22, 3)
    found = positions_to_motion(noisy, 20.0)
    assert (found.joints - clean.joints).norm(dim=-1).mean() < 0.01
    assert torch.equal(found.root, noisy[:, 0].float())


def test_another_body_keeps_its_directions():
    joints = shaken(gait(30), 10).joints
    larger = positions_to_motion(1.3 * joints, 20.0)
    same = positions_to_motion(joints, 20.0)
    assert degrees_apart(larger, same).max() < 0.1
    torch.testing.assert_close(larger.root, 1.3 * same.root)


def test_another_body_can_keep_its_lengths():
    motion = shaken(gait(30), 10)
    assert solve_rotations(motion.joints, 20.0).skeleton is HML22
    larger = solve_rotations(1.3 * motion.joints, 20.0)
    assert larger.skeleton.name == "hml22"
    torch.testing.assert_close(larger.joints, 1.3 * motion.joints, atol=1e-4, rtol=0)


def test_bad_positions_are_named():
    with pytest.raises(InputError, match=r"\(5, 21, 3\)"):
        positions_to_motion(torch.zeros(5, 21, 3), 20.0)
    with pytest.raises(InputError, match="finite"):
        positions_to_motion(torch.full((5, 22, 3), torch.nan), 20.0)
    other = Skeleton("other", HML22.joints, HML22.parents, HML22.offsets)
    with pytest.raises(InputError, match="hml22 and kit21"):
        positions_to_motion(torch.zeros(5, 22, 3), 20.0, other)


def test_real_takes(real_data):
    takes = [motion_of(r) for r in bandai_namco.list_takes(real_data)[:2]]
    takes += [motion_of(r) for r in cmu.list_takes(real_data / "cmu") if r.name == "02_01"]
    for motion in takes:
        found = positions_to_motion(motion.joints, motion.fps)
        assert (found.joints - motion.joints).norm(dim=-1).max() < 1e-5
        error = degrees_apart(found, motion)
        assert error[:, [0, 9]].max() < 0.1
        assert error[:, [1, 2, 16, 17]].median(dim=0).values.max() < 5.0
