"""Compositions: nothing outside the seam changes, nothing jumps at it, arms and legs come from whom they should."""

import pytest
import torch

from moveset.data.augment import compose_body, compose_in_time, stretched
from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.skeleton import HML22
from tests.synthetic import KINDS, synthetic_motion

PAIRS = [("walk", "wave-left-hand"), ("wave-both-hands", "walk"), ("run", "walk-turn-left"), ("walk-turn-right", "bow")]
ARM = {
    side: [HML22.index(f"{side}_{j}") for j in ("collar", "shoulder", "elbow", "wrist")] for side in ("left", "right")
}
LEGS = [0, 1, 2, 3, 4, 5, 7, 8, 10, 11]


def rotation_error(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(rotations.angle(rotations.mul(rotations.inv(a), b)).max())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("blend", [1, 8, 20])
def test_a_motion_cut_in_two_and_composed_is_the_motion_again(kind, blend):
    motion = synthetic_motion(kind, 80, seed=3).canonical()
    again = compose_in_time(motion[: 40 + blend], motion[40:], blend)
    # The overlap sums up velocities, and its first step stands for a step of b one frame later.
    assert len(again) == 80
    assert rotation_error(again.rotations[:, 1:], motion.rotations[:, 1:]) < 2e-3
    assert (again.joints - motion.joints).norm(dim=-1).max() < 0.05


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_outside_the_overlap_both_parts_are_as_they_were(first, second):
    a, b = synthetic_motion(first, 60, seed=1).canonical(), synthetic_motion(second, 50, seed=2)
    made = compose_in_time(a, b, 12)
    assert len(made) == 98
    assert torch.allclose(made.joints[:48], a.joints[:48], atol=1e-5)
    assert torch.allclose(made[60:].canonical().joints, b[12 + 0 :].canonical().joints, atol=1e-4)


@pytest.mark.parametrize(("first", "second"), PAIRS)
@pytest.mark.parametrize("turned", [0.0, 2.5])
def test_nothing_jumps_at_the_seam(first, second, turned):
    a, b = synthetic_motion(first, 60, seed=1), synthetic_motion(second, 50, seed=2)
    b = b.transformed(rotations.yaw(torch.tensor(turned)), torch.tensor([5.0, 0.0, -3.0]))
    made = compose_in_time(a, b, 12)
    steps = made.joints.diff(dim=0).norm(dim=-1).amax(dim=1)
    within = max(float(m.joints.diff(dim=0).norm(dim=-1).max()) for m in (a, b))
    # What two poses differ in passes within 12 frames: a body's reach (1.5 m) in a smooth step of slope 1.5.
    assert steps[46:62].max() <= within + 1.5 * 1.5 / 13
    acceleration = made.root[:, [0, 2]].diff(n=2, dim=0).norm(dim=-1)[45:62].max()
    assert acceleration < 0.03  # 12 m/s² over the ground: from 2.7 m/s to standing within 12 frames


def test_where_b_stood_before_does_not_matter():
    a, b = synthetic_motion("walk", 60), synthetic_motion("run", 50)
    moved = b.transformed(rotations.yaw(torch.tensor(1.0)), torch.tensor([3.0, 0.0, 4.0]))
    assert torch.allclose(compose_in_time(a, b, 10).joints, compose_in_time(a, moved, 10).joints, atol=1e-4)


def test_the_second_part_goes_on_where_the_first_was_heading():
    turned = compose_in_time(synthetic_motion("walk-turn-left", 60), synthetic_motion("walk", 60), 12)
    straight = turned.root[-1] - turned.root[-30]
    assert straight[0] > 1.0  # after a left turn, forward is +X
    assert abs(straight[2]) < 0.4


@pytest.mark.parametrize("arms", ["left", "right", "both"])
def test_arms_and_legs_come_from_the_right_part(arms):
    upper, lower = synthetic_motion("wave-both-hands", 60, seed=4), synthetic_motion("walk", 60, seed=5).canonical()
    made = compose_body(upper, lower, arms)
    assert torch.equal(made.root, lower.root)
    assert rotation_error(made.rotations[:, LEGS], lower.rotations[:, LEGS]) < 1e-3
    for side in ("left", "right"):
        source = upper if arms in (side, "both") else lower
        assert torch.equal(made.rotations[:, ARM[side]], source.rotations[:, ARM[side]])


def test_a_body_composed_with_itself_is_itself():
    motion = synthetic_motion("run", 50).canonical()
    assert torch.allclose(compose_body(motion, motion).joints, motion.joints, atol=1e-5)


def test_stretching_keeps_both_ends():
    motion = synthetic_motion("wave-left-hand", 41)
    for frames in (30, 41, 81):
        long = stretched(motion, frames)
        assert len(long) == frames
        assert torch.allclose(long.joints[[0, -1]], motion.joints[[0, -1]], atol=1e-5)
    assert torch.allclose(stretched(motion, 81).joints[::2], motion.joints, atol=1e-5)


def test_what_does_not_fit_is_refused():
    walk, wave = synthetic_motion("walk", 120), synthetic_motion("wave-left-hand", 100)
    for call, words in (
        (lambda: compose_in_time(walk, wave, 10), "210 frames"),
        (lambda: compose_in_time(walk, wave, 0), "0 blend frames"),
        (lambda: compose_in_time(walk, wave[:10], 10), "10 blend frames"),
        (lambda: compose_in_time(walk, wave.resampled(30), 10), "30 fps"),
        (lambda: compose_body(wave[:30], walk), "factor of 1.5"),
    ):
        with pytest.raises(InputError, match=words):
            call()
