"""The physical measures against motions whose sliding, jitter and height are known."""

import numpy as np
import pytest
import torch

from moveset.errors import InputError
from moveset.evaluation import physical
from moveset.motion.skeleton import HML22, KIT21

FPS = 20.0
LEFT_TOE, RIGHT_TOE = 10, 11


def standing(frames: int) -> torch.Tensor:
    """(F, 22, 3) the rest pose with its toes on the floor."""
    rest = HML22.rest_positions.double()
    rest[:, 1] -= float(rest[LEFT_TOE, 1])
    return rest.expand(frames, -1, -1).clone()


def moved(frames: int, speed: float, height: float, joint: int = LEFT_TOE) -> torch.Tensor:
    """Standing, but one joint glides along +X at ``speed`` (m/s) and ``height`` (m)."""
    joints = standing(frames)
    joints[:, joint, 0] += torch.arange(frames) * speed / FPS
    joints[:, joint, 1] = height
    return joints


def test_a_standing_body_has_no_faults():
    assert physical.measure(standing(10), FPS).mean() == {
        "skating": 0.0, "jerk": 0.0, "acceleration": 0.0, "penetration": 0.0, "floating": 0.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("speed", "height", "expected"),
    [(1.0, 0.02, 1.0), (0.51, 0.02, 1.0), (0.49, 0.02, 0.0), (1.0, 0.051, 0.0), (1.0, 0.049, 1.0), (0.0, 0.02, 0.0)],
)
@pytest.mark.parametrize("joint", [LEFT_TOE, RIGHT_TOE])
def test_skating_needs_a_low_and_a_fast_toe(speed, height, expected, joint):
    assert physical.skating(moved(12, speed, height, joint), FPS).item() == expected


def test_skating_counts_steps_with_both_ends_low():
    joints = moved(11, 1.0, 0.02)
    joints[5, LEFT_TOE, 1] = 0.2  # spoils the steps into and out of frame 5
    assert physical.skating(joints, FPS).item() == pytest.approx(8 / 10)


def test_skating_ignores_vertical_speed_and_ankles():
    joints = standing(10)
    joints[:, LEFT_TOE, 1] += torch.tensor([0.0, 0.04] * 5)
    joints[:, 7, 0] += torch.arange(10) * 0.2
    assert physical.skating(joints, FPS).item() == 0.0


def test_windowed_skating_equals_the_published_procedure():
    """A literal, scipy-based reading of the skating ratio of GMD and OmniControl."""
    from scipy.ndimage import uniform_filter1d

    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(40, 22, 3, generator=generator, dtype=torch.float64)
    joints = standing(40) + noise * torch.tensor([0.015, 0.03, 0.015])
    feet = joints[:, [10, 11]].numpy()
    velocity = np.linalg.norm(np.diff(feet[:, :, [0, 2]], axis=0), axis=-1) * FPS
    average = uniform_filter1d(velocity, axis=0, size=5, mode="constant")
    low = (feet[:-1, :, 1] < 0.05) & (feet[1:, :, 1] < 0.05)
    expected = (low & (velocity > 0.5) & (average > 0.5)).any(axis=1).mean()
    assert 0.1 < expected < 0.9
    assert physical.skating(joints, FPS, window=5).item() == pytest.approx(expected)
    assert physical.skating(joints, FPS, window=5).item() < physical.skating(joints, FPS).item()


def test_jerk_and_acceleration_of_polynomials():
    t = torch.arange(20, dtype=torch.float64) / FPS
    cubic = standing(20) + (0.5 * t**3)[:, None, None] * torch.tensor([1.0, 0.0, 0.0])
    assert physical.jerk(cubic, FPS).item() == pytest.approx(3.0, rel=1e-5)
    square = standing(20) + (2.0 * t**2)[:, None, None] * torch.tensor([0.0, 0.6, 0.8])
    assert physical.acceleration(square, FPS).item() == pytest.approx(4.0, rel=1e-5)
    assert physical.jerk(square, FPS).item() == pytest.approx(0.0, abs=1e-6)


def test_jerk_does_not_see_where_the_body_is():
    walk = standing(20).float() + 0.01 * torch.randn(20, 22, 3, generator=torch.Generator().manual_seed(1))
    far = (walk.double() + torch.tensor([100.0, 0.0, -50.0])).float()
    assert physical.jerk(far, FPS).item() == pytest.approx(physical.jerk(walk, FPS).item(), rel=1e-2)


def test_penetration_and_floating_are_metres_averaged_over_frames():
    joints = standing(4)
    joints[0, :, 1] -= 0.03
    joints[1, :, 1] += 0.20
    assert physical.penetration(joints).item() == pytest.approx(0.03 / 4, rel=1e-5)
    assert physical.floating(joints).item() == pytest.approx(0.15 / 4, rel=1e-5)


def test_root_drift_is_the_planar_gap_at_the_last_real_frame():
    reference = standing(10)
    joints = reference + torch.tensor([5.0, 1.0, 0.0])  # another start is not drift
    joints[:, :, 0] += 0.3 * torch.arange(10)[:, None]
    joints[:, :, 2] += 0.4 * torch.arange(10)[:, None]
    assert physical.root_drift(joints, reference).item() == pytest.approx(9 * 0.5, rel=1e-5)
    assert physical.root_drift(joints, reference[:1], torch.tensor(4)).item() == pytest.approx(3 * 0.5, rel=1e-5)


def test_padding_never_counts_and_batches_equal_single_clips():
    generator = torch.Generator().manual_seed(2)
    clips = standing(30) + 0.03 * torch.randn(2, 3, 30, 22, 3, generator=generator, dtype=torch.float64)
    lengths = torch.tensor([[30, 4, 12], [7, 29, 5]])
    for i in range(2):
        for k in range(3):
            clips[i, k, lengths[i, k] :] = float("nan")
    batch = physical.measure(clips, FPS, lengths)
    windowed = physical.skating(clips, FPS, lengths, window=5)
    for i in range(2):
        for k in range(3):
            one = clips[i, k, : lengths[i, k]]
            single = physical.measure(one, FPS)
            for name in single.__dataclass_fields__:
                torch.testing.assert_close(getattr(batch, name)[i, k], getattr(single, name), msg=name)
            assert windowed[i, k] == physical.skating(one, FPS, window=5)
    assert batch.jerk.shape == (2, 3)


def test_kit_feet_are_known():
    joints = KIT21.rest_positions.expand(10, -1, -1).clone()
    joints[:, :, 1] -= float(joints[0, 15, 1])
    assert physical.skating(joints, 12.5, skeleton=KIT21).item() == 0.0
    joints[:, 20, 2] += torch.arange(10) * 0.1
    assert physical.skating(joints, 12.5, skeleton=KIT21).item() == 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: physical.jerk(standing(3), FPS), "4 to 3 frames"),
        (lambda: physical.skating(standing(1), FPS), "2 to 1 frames"),
        (lambda: physical.jerk(standing(9), FPS, torch.tensor(10)), "4 to 9 frames"),
        (lambda: physical.jerk(standing(9)[None], FPS, torch.tensor([3])), "leave shorter clips out"),
        (lambda: physical.jerk(standing(9), FPS, torch.tensor([9])), "give one each"),
        (lambda: physical.skating(standing(9), FPS, window=4), "odd number"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
