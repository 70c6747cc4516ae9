"""Ways that are bent: they go where they should, and nothing but the way is another."""

import math

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.bend import led, steps
from moveset.motion.features import get_codec
from tests.motion.synthetic_features import NATIVE, features

CODECS = pytest.mark.parametrize("name", ["native", "hml", "kit"])
YAW = NATIVE.groups["root_yaw"]


def turned(x, codec=NATIVE):
    """Degrees from the first frame to the last, to the left, of the decoded motion."""
    heading = rotations.heading_angle(codec.decode(x).rotations[:, 0].double())
    return math.degrees(float((torch.remainder(heading.diff() + math.pi, 2 * math.pi) - math.pi).sum()))


def arc(x, codec, curvature):
    """Bent evenly, by so many radians a metre."""
    return led(x, codec, lambda metres: curvature * metres)


@CODECS
def test_steps_are_those_of_the_decoded_motion(name):
    codec = get_codec(name)
    x = features("walk-turn-left", codec=codec)
    way = codec.decode(x).root[:, [0, 2]].double().diff(dim=0).norm(dim=1)
    assert torch.allclose(steps(x, codec)[:-1], way, atol=1e-3)


@CODECS
@pytest.mark.parametrize("side", [1, -1])
def test_an_arc_as_long_as_its_circle_ends_where_it_began(name, side):
    codec = get_codec(name)
    x = features(codec=codec)
    x = arc(x, codec, side * 2 * math.pi / float(steps(x[:-1], codec).sum()))
    assert turned(x, codec) == pytest.approx(side * 360.0, abs=2.0)
    root = codec.decode(x).root[:, [0, 2]]
    way = root.diff(dim=0).norm(dim=1).sum()
    assert (root[-1] - root[0]).norm() < 0.02 * way
    centre = root.mean(dim=0)
    radii = (root - centre).norm(dim=1)
    assert float(radii.min()) > 0.9 * float(radii.max())
    assert float(radii.mean()) == pytest.approx(float(way) / (2 * math.pi), rel=0.05)
    to_left = torch.linalg.det(torch.stack((root[10] - centre, root[0] - centre)))  # seen from above, z runs down
    assert to_left * side > 0


@CODECS
def test_corners_are_where_they_should_be(name):
    codec = get_codec(name)
    x = features(codec=codec)
    half = float(steps(x, codec).sum()) / 2
    yaw = (led(x, codec, lambda metres: 0.3 * (metres > half)) - x)[:, codec.groups["root_yaw"]][:, 0]
    [corner] = yaw.nonzero().flatten().tolist()
    assert float(steps(x[:corner], codec).sum()) <= half < float(steps(x[: corner + 1], codec).sum())


BENDS = {
    "arc": lambda x, side: arc(x, NATIVE, side * 1.2),
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
    assert torch.allclose(arc(arc(x, NATIVE, 0.4), NATIVE, 0.3), arc(x, NATIVE, 0.7), atol=1e-6)
    assert torch.equal(arc(x, NATIVE, 0.0), x)
