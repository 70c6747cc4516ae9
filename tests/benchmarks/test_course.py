"""Pace, turns and arms of motions whose own are known."""

import math

import pytest
import torch

from tests.synthetic import synthetic_motion


@pytest.fixture
def course():
    import course

    return course


@pytest.mark.parametrize("speed", [0.8, 2.0])
def test_pace_is_what_somebody_walks_at_and_straight_ways_do_not_bend(course, speed):
    row = course.measured(synthetic_motion("walk", 100, speed=speed).joints, 20.0)
    assert row["metres_a_second"] == pytest.approx(speed, rel=0.05)
    assert abs(row["bends"]) < 1.0
    assert abs(row["turned"]) < 1.0


@pytest.mark.parametrize("a_second", [-30.0, 12.0])
def test_a_circle_bends_by_its_own_angle_to_the_left(course, a_second):
    angle = torch.arange(120) / 20.0 * math.radians(a_second)
    step = torch.stack((angle.sin(), torch.zeros(120), angle.cos()), dim=1) / 20.0
    assert course.bends(step.cumsum(dim=0), 20.0) == pytest.approx(a_second, rel=0.02)


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_arm_that_waves_travels_more(course, side):
    arms = course.measured(synthetic_motion(f"wave-{side}-hand", 80).joints, 20.0)["arms"]
    assert arms > 0.8 if side == "left" else arms < 0.2


def test_what_repeats_does_not_change_over_time(course):
    piece = synthetic_motion("wave-both-hands", 200)
    still = piece.joints.repeat(12, 1, 1)

    class Long:
        joints, fps = still, 20.0

    found = course.over_time([Long(), Long()])
    for row in found.values():
        assert row["first"] == pytest.approx(row["last"], abs=1e-3)
        assert row["a_minute"] == pytest.approx(0.0, abs=1e-3)
