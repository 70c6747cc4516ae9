"""Laws of motions: mirroring, resampling, placing, kinematics, and two-bone inverse kinematics."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.kinematics import fk, fk_matrices, global_to_local
from moveset.motion.skeleton import HML22, KIT21
from moveset.motion.two_bone_ik import two_bone
from tests.motions import gait, smooth_noise, wander

seeds = st.integers(0, 10_000)
skeletons = st.sampled_from([HML22, KIT21])
law = settings(max_examples=15, deadline=None)


def apart(a: Motion, b: Motion) -> float:
    """Largest distance of joints, metres."""
    return (a.joints - b.joints).norm(dim=-1).max().item()


def moved(motion: Motion, seed: int) -> Motion:
    turn = torch.tensor(float(seed % 360))
    return motion.transformed(rotations.about("y", turn), torch.tensor([seed % 7 - 3.0, 0.0, seed % 5 - 2.0]))


@law
@given(seeds, skeletons)
def test_mirroring_twice_changes_nothing(seed, skeleton):
    motion = wander(6, seed, skeleton, bend=0.7)
    assert apart(motion.mirrored().mirrored(), motion) < 1e-6
    torch.testing.assert_close(motion.mirrored().mirrored().rotations, motion.rotations)


@law
@given(seeds, skeletons)
def test_mirroring_commutes_with_kinematics(seed, skeleton):
    motion = wander(6, seed, skeleton, bend=0.7)
    reflected = motion.joints[:, list(skeleton.mirror_order)] * torch.tensor([-1.0, 1.0, 1.0])
    torch.testing.assert_close(motion.mirrored().joints, reflected, atol=1e-5, rtol=0)


@law
@given(seeds)
def test_mirroring_commutes_with_canonical_and_resampling(seed):
    motion = moved(wander(8, seed), seed)
    assert apart(motion.mirrored().canonical(), motion.canonical().mirrored()) < 1e-4
    assert apart(motion.mirrored().resampled(33.0), motion.resampled(33.0).mirrored()) < 1e-5


@law
@given(seeds)
def test_canonical_is_idempotent_and_forgets_place_and_heading(seed):
    motion = wander(6, seed, turn=1.0)
    canonical = motion.canonical()
    assert apart(canonical.canonical(), canonical) < 1e-5
    assert apart(moved(motion, seed).canonical(), canonical) < 1e-4


@law
@given(seeds)
def test_transforms_compose(seed):
    motion = wander(4, seed)
    generator = torch.Generator().manual_seed(seed)
    q, p = rotations.normalize(torch.randn(2, 4, generator=generator))
    s, t = torch.randn(2, 3, generator=generator)
    one_by_one = motion.transformed(q, s).transformed(p, t)
    at_once = motion.transformed(rotations.mul(p, q), rotations.rotate(p, s) + t)
    assert apart(one_by_one, at_once) < 1e-5


@law
@given(seeds)
def test_resampling_up_and_down_comes_back(seed):
    """20 → 60 → 20: every frame is hit again, so only rounding remains; 20 → 30 → 20 interpolates twice."""
    motion = wander(21, seed)
    assert apart(motion.resampled(60.0).resampled(20.0), motion) < 1e-4
    acceleration = torch.diff(motion.joints, n=2, dim=0).norm(dim=-1).max().item()
    assert apart(motion.resampled(30.0).resampled(20.0), motion) < 0.5 * acceleration + 1e-4


def test_resampling_error_is_of_second_order():
    """Slerp and linear interpolation against a motion known at 80 fps: a quarter of the error at twice the rate."""
    fine = gait(321, fps=80.0)
    coarse = [Motion(fine.rotations[::step], fine.root[::step], 80.0 / step) for step in (8, 4, 2)]
    errors = [apart(motion.resampled(80.0), fine) for motion in coarse]
    assert errors[0] > 2.5 * errors[1] > 6.25 * errors[2]
    assert errors[2] < 0.01


@law
@given(seeds)
def test_reversing_time_commutes_with_resampling(seed):
    motion = wander(21, seed)
    back = Motion(motion.rotations.flip(0), motion.root.flip(0), motion.fps)
    forward = motion.resampled(60.0)
    assert apart(back.resampled(60.0), Motion(forward.rotations.flip(0), forward.root.flip(0), 60.0)) < 1e-4


@law
@given(seeds, skeletons)
def test_kinematics_undo_themselves_and_agree_with_matrices(seed, skeleton):
    generator = torch.Generator().manual_seed(seed)
    local = rotations.normalize(torch.randn(3, len(skeleton), 4, generator=generator, dtype=torch.float64))
    root = torch.randn(3, 3, generator=generator, dtype=torch.float64)
    turned, placed = fk(local, root, skeleton)
    back = global_to_local(turned, skeleton)
    assert ((back * local).sum(-1).abs() - 1.0).abs().max() < 1e-12
    again, _ = fk(back, root, skeleton)
    assert ((again * turned).sum(-1).abs() - 1.0).abs().max() < 1e-12
    by_matrices = fk_matrices(rotations.to_matrix(local), root, skeleton)
    torch.testing.assert_close(by_matrices, placed, atol=1e-9, rtol=0)


@law
@given(seeds)
def test_kinematics_follow_rigid_motion(seed):
    motion = wander(4, seed)
    turn = rotations.normalize(torch.randn(4, generator=torch.Generator().manual_seed(seed)))
    shift = torch.tensor([1.0, 2.0, 3.0])
    expected = rotations.rotate(turn, motion.joints) + shift
    torch.testing.assert_close(motion.transformed(turn, shift).joints, expected, atol=1e-5, rtol=0)


HINGE = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
DOWN = torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
bone = st.floats(0.05, 1.0)
bends = st.floats(0.0, 2.6)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 0.1)


class Leg:
    """A leg with its hip at the origin: thigh and shin hang down, the knee bends about +X."""

    def __init__(self, thigh: float, shin: float, bend: float, seed: int) -> None:
        self.thigh, self.shin = thigh * DOWN, shin * DOWN
        generator = torch.Generator().manual_seed(seed)
        self.upper = rotations.normalize(torch.randn(4, generator=generator, dtype=torch.float64))
        knee = rotations.from_axis_angle(HINGE, torch.tensor(bend, dtype=torch.float64))
        self.lower = rotations.mul(self.upper, knee)

    def ankle(self, upper, lower):
        return rotations.rotate(upper, self.thigh) + rotations.rotate(lower, self.shin)

    def reach_for(self, target):
        hip, knee = torch.zeros(3, dtype=torch.float64), rotations.rotate(self.upper, self.thigh)
        ankle = self.ankle(self.upper, self.lower)
        return two_bone(self.upper, self.lower, hip, knee, ankle, target, rotations.rotate(self.upper, HINGE))


@settings(max_examples=150, deadline=None)
@given(bone, bone, bends, seeds, directions, st.floats(0.02, 0.99))
def test_reachable_targets_are_reached(thigh, shin, bend, seed, direction, share):
    leg = Leg(thigh, shin, bend, seed)
    near, far = abs(thigh - shin), thigh + shin
    aim = torch.nn.functional.normalize(torch.tensor(direction, dtype=torch.float64), dim=-1)
    target = (near + share * (far - near)) * aim
    upper, lower = leg.reach_for(target)
    assert (leg.ankle(upper, lower) - target).norm() < 1e-6
    assert upper.norm().item() == pytest.approx(1.0)
    assert lower.norm().item() == pytest.approx(1.0)


@settings(max_examples=60, deadline=None)
@given(bone, bone, bends, seeds, directions, st.floats(0.0, 3.0))
def test_the_knee_stays_a_hinge_that_bends_forward(thigh, shin, bend, seed, direction, distance):
    leg = Leg(thigh, shin, bend, seed)
    upper, lower = leg.reach_for((distance + 0.01) * torch.tensor(direction, dtype=torch.float64))
    knee = rotations.mul(rotations.inv(upper), lower)
    knee = knee * knee[3].sign()
    assert knee[1:3].abs().max() < 1e-6
    assert knee[0] > -1e-9


@settings(max_examples=60, deadline=None)
@given(bone, bone, bends, seeds, directions, st.floats(1.001, 50.0))
def test_targets_out_of_reach_are_pointed_at(thigh, shin, bend, seed, direction, factor):
    leg = Leg(thigh, shin, bend, seed)
    aim = torch.nn.functional.normalize(torch.tensor(direction, dtype=torch.float64), dim=-1)
    ankle = leg.ankle(*leg.reach_for(factor * (thigh + shin) * aim))
    assert 0.999 * (thigh + shin) < ankle @ aim <= ankle.norm() + 1e-12 <= thigh + shin + 1e-9


@settings(max_examples=60, deadline=None)
@given(bone, bone, bends, seeds)
def test_a_limb_already_there_does_not_move(thigh, shin, bend, seed):
    leg = Leg(thigh, shin, bend, seed)
    upper, lower = leg.reach_for(leg.ankle(leg.upper, leg.lower))
    if leg.ankle(leg.upper, leg.lower).norm() > 1e-3:
        assert rotations.angle(rotations.mul(rotations.inv(leg.upper), upper)) < 1e-4
        assert rotations.angle(rotations.mul(rotations.inv(leg.lower), lower)) < 1e-4


def test_a_limb_that_bends_backward_keeps_doing_so():
    leg = Leg(0.4, 0.4, -0.5, 0)
    upper, lower = leg.reach_for(0.6 * torch.nn.functional.normalize(torch.ones(3, dtype=torch.float64), dim=-1))
    knee = rotations.mul(rotations.inv(upper), lower)
    assert (knee * knee[3].sign())[0] < 0


def test_limbs_go_in_batches_and_follow_smooth_targets_smoothly():
    frames = 200
    path = torch.tensor([0.0, -0.6, 0.1], dtype=torch.float64) + 0.08 * smooth_noise(frames, 3, 1)
    leg = Leg(0.4, 0.42, 0.6, 3)
    leg.upper, leg.lower = rotations.identity(1)[0].double(), rotations.about("x", torch.tensor(35.0)).double()
    still = [x.expand(frames, -1) for x in (leg.upper, leg.lower)]
    hip, knee = torch.zeros(frames, 3, dtype=torch.float64), leg.thigh.expand(frames, 3)
    ankle = leg.ankle(leg.upper, leg.lower).expand(frames, 3)
    upper, lower = two_bone(*still, hip, knee, ankle, path, HINGE.expand(frames, 3))
    one = two_bone(still[0][7], still[1][7], hip[7], knee[7], ankle[7], path[7], HINGE)
    torch.testing.assert_close(upper[7], one[0])
    torch.testing.assert_close(lower[7], one[1])
    step = rotations.angle(rotations.mul(rotations.inv(upper[1:]), upper[:-1]))
    assert step.max() < 10 * torch.diff(path, dim=0).norm(dim=-1).max()
