"""Ways that are bent: they go where they should, and nothing but the way is another."""

import math

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.bend import led, steps
from tests.motion.synthetic_features import NATIVE, features

YAW = NATIVE.groups["root_yaw"]


def turned(x):
    """Degrees from the first frame to the last, to the left, of the decoded motion."""
    heading = rotations.heading_angle(NATIVE.decode(x).rotations[:, 0].double())
    return math.degrees(float((torch.remainder(heading.diff() + math.pi, 2 * math.pi) - math.pi).sum()))


def arc(x, curvature):
    """Bent evenly, by so many radians a metre."""
    return led(x, NATIVE, lambda metres: curvature * metres)


def test_steps_are_those_of_the_decoded_motion():
    x = features("walk-turn-left")
    way = NATIVE.decode(x).root[:, [0, 2]].double().diff(dim=0).norm(dim=1)
    assert torch.allclose(steps(x, NATIVE)[:-1], way, atol=1e-3)


@pytest.mark.parametrize("side", [1, -1])
def test_an_arc_as_long_as_its_circle_ends_where_it_began(side):
    x = features()
    x = arc(x, side * 2 * math.pi / float(steps(x[:-1], NATIVE).sum()))
    assert turned(x) == pytest.approx(side * 360.0, abs=2.0)
    root = NATIVE.decode(x).root[:, [0, 2]]
    way = root.diff(dim=0).norm(dim=1).sum()
    assert (root[-1] - root[0]).norm() < 0.02 * way
    centre = root.mean(dim=0)
    radii = (root - centre).norm(dim=1)
    assert float(radii.min()) > 0.9 * float(radii.max())
    assert float(radii.mean()) == pytest.approx(float(way) / (2 * math.pi), rel=0.05)
    to_left = torch.linalg.det(torch.stack((root[10] - centre, root[0] - centre)))  # seen from above, z runs down
    assert to_left * side > 0


def test_corners_are_where_they_should_be():
    x = features()
    half = float(steps(x, NATIVE).sum()) / 2
    yaw = (led(x, NATIVE, lambda metres: 0.3 * (metres > half)) - x)[:, NATIVE.groups["root_yaw"]][:, 0]
    [corner] = yaw.nonzero().flatten().tolist()
    assert float(steps(x[:corner], NATIVE).sum()) <= half < float(steps(x[: corner + 1], NATIVE).sum())


BENDS = {
    "arc": lambda x, side: arc(x, side * 1.2),
    "led": lambda x, side: led(x, NATIVE, lambda metres: side * (2 * metres).sin()),
}


@pytest.mark.parametrize("bend", BENDS.values(), ids=BENDS)
def test_the_mirror_image_is_bent_to_the_other_side(bend):
    order, signs = NATIVE.mirror()
    x = features("walk-turn-left")
    assert torch.allclose(bend(x, 1)[:, order] * signs, bend(x[:, order] * signs, -1), atol=1e-6)


@pytest.mark.parametrize("bend", BENDS.values(), ids=BENDS)
def test_who_stands_does_not_spin_and_who_runs_does_not_trip(bend):
    still = features("wave-left-hand")
    assert turned(bend(still, 1)) == pytest.approx(turned(still), abs=1.0)
    run = features("run")
    fastest = float((bend(10 * run, 1) - 10 * run)[:, YAW].abs().max()) * NATIVE.fps
    assert fastest <= math.radians(120.0) + 1e-4


def test_arcs_add_up():
    x = features()
    assert torch.allclose(arc(arc(x, 0.4), 0.3), arc(x, 0.7), atol=1e-6)
    assert torch.equal(arc(x, 0.0), x)
