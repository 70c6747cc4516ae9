"""The measures of motion against motions whose sliding, jitter and height are known."""

import itertools

import numpy as np
import pytest
import torch

from moveset.errors import InputError
from moveset.motion import measures
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
    found = measures.measure(standing(10), FPS)
    assert list(found) == ["skating", "jerk", "acceleration", "penetration", "floating", "root_drift"]
    assert not any(found.values())


@pytest.mark.parametrize(
    ("speed", "height", "expected"),
    [(1.0, 0.02, 1.0), (0.51, 0.02, 1.0), (0.49, 0.02, 0.0), (1.0, 0.051, 0.0), (1.0, 0.049, 1.0), (0.0, 0.02, 0.0)],
)
@pytest.mark.parametrize("joint", [LEFT_TOE, RIGHT_TOE])
def test_skating_needs_a_low_and_a_fast_toe(speed, height, expected, joint):
    assert measures.skating(moved(12, speed, height, joint), FPS).item() == expected


def test_skating_counts_steps_with_both_ends_low():
    joints = moved(11, 1.0, 0.02)
    joints[5, LEFT_TOE, 1] = 0.2  # spoils the steps into and out of frame 5
    assert measures.skating(joints, FPS).item() == pytest.approx(8 / 10)


def test_skating_ignores_vertical_speed_and_ankles():
    joints = standing(10)
    joints[:, LEFT_TOE, 1] += torch.tensor([0.0, 0.04] * 5)
    joints[:, 7, 0] += torch.arange(10) * 0.2
    assert measures.skating(joints, FPS).item() == 0.0


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
    assert measures.skating(joints, FPS, window=5).item() == pytest.approx(expected)
    assert measures.skating(joints, FPS, window=5).item() < measures.skating(joints, FPS).item()


def test_jerk_and_acceleration_of_polynomials():
    t = torch.arange(20, dtype=torch.float64) / FPS
    cubic = standing(20) + (0.5 * t**3)[:, None, None] * torch.tensor([1.0, 0.0, 0.0])
    assert measures.jerk(cubic, FPS).item() == pytest.approx(3.0, rel=1e-5)
    square = standing(20) + (2.0 * t**2)[:, None, None] * torch.tensor([0.0, 0.6, 0.8])
    assert measures.acceleration(square, FPS).item() == pytest.approx(4.0, rel=1e-5)
    assert measures.jerk(square, FPS).item() == pytest.approx(0.0, abs=1e-6)


def test_jerk_does_not_see_where_the_body_is():
    walk = standing(20).float() + 0.01 * torch.randn(20, 22, 3, generator=torch.Generator().manual_seed(1))
    far = (walk.double() + torch.tensor([100.0, 0.0, -50.0])).float()
    assert measures.jerk(far, FPS).item() == pytest.approx(measures.jerk(walk, FPS).item(), rel=1e-2)


def test_penetration_and_floating_are_metres_averaged_over_frames():
    joints = standing(4)
    joints[0, :, 1] -= 0.03
    joints[1, :, 1] += 0.20
    assert measures.penetration(joints).item() == pytest.approx(0.03 / 4, rel=1e-5)
    assert measures.floating(joints).item() == pytest.approx(0.15 / 4, rel=1e-5)


def test_root_drift_compares_the_first_second_with_the_last():
    joints = standing(100)
    joints[:, :, 1] -= torch.arange(100)[:, None] * 0.001
    assert measures.root_drift(joints, FPS).item() == pytest.approx(0.080, rel=1e-4)  # from frame 9.5 to 89.5
    assert measures.root_drift(joints[:24], FPS).item() == pytest.approx(0.012, rel=1e-4)  # halves
    dipped = standing(100)
    dipped[40:60, :, 1] -= 0.4  # a squat in between is no drift
    assert measures.root_drift(dipped, FPS).item() == 0.0
    glided = standing(100)
    glided[:, :, 0] += torch.arange(100)[:, None]
    assert measures.root_drift(glided, FPS).item() == 0.0


def popped(seam: int, frames: int = 60) -> torch.Tensor:
    """Standing in one place up to a seam, and in another after it."""
    joints = standing(frames)
    joints[seam:, :, 0] += 0.01
    return joints


def test_a_jump_at_a_seam_is_near_it_and_nowhere_else():
    found = measures.boundary_jerk(popped(28), FPS, [28], reach=1)
    # Third differences of a step of 1 cm: 1, 2, 1 (times fps^3).
    assert found.near.item() == pytest.approx(0.01 * 4 / 3 * FPS**3, rel=1e-4)
    assert found.elsewhere.item() == 0.0
    wider = measures.boundary_jerk(popped(28), FPS, [28])
    assert wider.near.item() == pytest.approx(0.01 * 4 / 5 * FPS**3, rel=1e-4)
    for other in (26, 27, 29, 30):
        assert measures.boundary_jerk(popped(other), FPS, [28], reach=1).elsewhere.item() > 0


def test_windows_near_a_seam_are_those_that_span_or_touch_it():
    """Four frames span the seam between s - 1 and s if they hold both of these; they touch it if they hold one."""
    frames, seam = 20, 9
    spans = [t <= seam - 1 and t + 3 >= seam for t in range(frames - 3)]
    touches = [t <= seam and t + 3 >= seam - 1 for t in range(frames - 3)]
    assert measures.near_seams(frames, [seam], 1).tolist() == spans
    assert measures.near_seams(frames, [seam], 2).tolist() == touches
    assert not measures.near_seams(frames, [0, -1, 20, 21], 2).any()


def test_jerk_near_seams_and_elsewhere_are_all_of_the_jerk():
    joints = standing(84) + 0.02 * torch.randn(84, 22, 3, generator=torch.Generator().manual_seed(3))
    found = measures.boundary_jerk(joints, FPS, [28, 56])
    whole = (10 * found.near + 71 * found.elsewhere) / 81
    assert whole.item() == pytest.approx(measures.jerk(joints, FPS).item(), rel=1e-5)


def test_windows_of_a_stream_show_what_drifts():
    minute = torch.arange(1200) / 1200
    stream = standing(1230)[None].repeat(2, 1, 1, 1)
    stream[0, :1200, :, 1] -= 0.3 * minute[:, None]
    fading = 0.1 * torch.sin(torch.arange(1200) * 2.0) * (1 - minute)
    stream[1, :1200, :, 2] += fading[:, None]
    found = measures.windows(stream, FPS)
    assert found.height.shape == (2, 6)
    assert found.drift("height").tolist() == pytest.approx([-0.3, 0.0], abs=1e-5)
    assert found.drift("speed")[1] < -0.5
    assert found.drift("jerk")[1] < 0
    torch.testing.assert_close(found.jerk[1, 2], measures.jerk(stream[1, 400:600], FPS))
    torch.testing.assert_close(found.skating[1, 2], measures.skating(stream[1, 400:600], FPS))
    with pytest.raises(InputError, match="at least 2 windows"):
        measures.windows(stream, FPS, 40.0).drift("height")
    with pytest.raises(InputError, match="no window of 2000 frames"):
        measures.windows(stream, FPS, 100.0)


def test_what_is_not_finite_is_counted():
    clips = standing(10).repeat(3, 1, 1, 1)
    clips[1, 4, 3, 2] = float("nan")
    clips[2, 7, 3, 2] = float("inf")
    with pytest.raises(InputError, match="2 of 3 clips"):
        measures.measure(clips, FPS)


def test_kit_feet_are_known():
    joints = KIT21.rest_positions.expand(10, -1, -1).clone()
    joints[:, :, 1] -= float(joints[0, 15, 1])
    assert measures.skating(joints, 12.5, skeleton=KIT21).item() == 0.0
    joints[:, 20, 2] += torch.arange(10) * 0.1
    assert measures.skating(joints, 12.5, skeleton=KIT21).item() == 1.0


def test_batches_equal_single_clips():
    generator = torch.Generator().manual_seed(2)
    clips = standing(30) + 0.03 * torch.randn(2, 3, 30, 22, 3, generator=generator, dtype=torch.float64)
    batch, windowed = measures.measure(clips, FPS), measures.skating(clips, FPS, window=5)
    near = measures.boundary_jerk(clips, FPS, [10, 20]).near
    for place in itertools.product(range(2), range(3)):
        single = measures.measure(clips[place], FPS)
        for name, value in single.items():
            torch.testing.assert_close(batch[name][place], value, msg=name)
        assert windowed[place] == measures.skating(clips[place], FPS, window=5)
        torch.testing.assert_close(near[place], measures.boundary_jerk(clips[place], FPS, [10, 20]).near)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: measures.jerk(standing(3), FPS), "a clip of 3 frames is too short for a measure of 4"),
        (lambda: measures.skating(standing(1), FPS), "a clip of 1 frames is too short for a measure of 2"),
        (lambda: measures.boundary_jerk(standing(60), FPS, []), "no seam, or no place away from one"),
        (lambda: measures.boundary_jerk(standing(60), FPS, [60]), "no seam"),
        (lambda: measures.boundary_jerk(standing(20), FPS, range(3, 20, 3)), "no place away from one"),
        (lambda: measures.skating(standing(9), FPS, window=4), "odd number"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
