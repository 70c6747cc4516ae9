"""Ways that are bent: they go where they should, and nothing but the way is another."""

import math

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.bend import arc, led, steps, turn, turned_by
from moveset.motion.features import get_codec
from tests.motion.synthetic_features import NATIVE, features

CODECS = pytest.mark.parametrize("name", ["native", "hml", "kit"])
YAW = NATIVE.groups["root_yaw"]


def turned(x, codec=NATIVE):
    """Degrees from the first frame to the last, to the left, of the decoded motion."""
    heading = rotations.heading_angle(codec.decode(x).rotations[:, 0].double())
    return math.degrees(float((torch.remainder(heading.diff() + math.pi, 2 * math.pi) - math.pi).sum()))


@CODECS
def test_steps_and_turns_are_those_of_the_decoded_motion(name):
    codec = get_codec(name)
    x = features("walk-turn-left", codec=codec)
    way = codec.decode(x).root[:, [0, 2]].double().diff(dim=0).norm(dim=1)
    assert torch.allclose(steps(x, codec)[:-1], way, atol=1e-3)
    assert math.degrees(turned_by(x, codec)) == pytest.approx(turned(x, codec), abs=2.0 if name == "native" else 8.0)


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
def test_a_path_that_turns_evenly_is_an_arc_and_corners_are_where_they_should_be(name):
    codec = get_codec(name)
    x = features(codec=codec)
    assert torch.allclose(led(x, codec, lambda metres: 0.7 * metres), arc(x, codec, 0.7), atol=1e-6)
    half = float(steps(x, codec).sum()) / 2
    yaw = (led(x, codec, lambda metres: 0.3 * (metres > half)) - x)[:, codec.groups["root_yaw"]][:, 0]
    [corner] = yaw.nonzero().flatten().tolist()
    assert float(steps(x[:corner], codec).sum()) <= half < float(steps(x[: corner + 1], codec).sum())


@CODECS
@pytest.mark.parametrize("degrees", [45, 135, 180, 300, -90])
@pytest.mark.parametrize("kind", ["walk", "walk-turn-left", "run"])
def test_a_turn_ends_at_its_angle_whatever_was_made(name, degrees, kind):
    codec = get_codec(name)
    x = features(kind, codec=codec)
    bent = turn(x, codec, math.radians(degrees))
    # A pelvis that is decoded from positions is not quite where the features look.
    assert turned(bent, codec) == pytest.approx(degrees, abs=2.0 if name == "native" else 8.0)
    rest = torch.arange(x.shape[1]) != codec.groups["root_yaw"].start
    assert torch.equal(bent[:, rest], x[:, rest])


def test_a_turn_that_is_there_stays_where_it_is():
    x = torch.cat((features("walk", 60), features("walk-turn-left", 60), features("walk", 60)))
    yaw = turn(x, NATIVE, math.radians(150))[:, YAW][:, 0]
    assert math.degrees(float(yaw[60:120].sum())) == pytest.approx(150, abs=5)
    assert float(yaw[:60].abs().sum() + yaw[120:].abs().sum()) < math.radians(5)


BENDS = {
    "arc": lambda x, side: arc(x, NATIVE, side * 1.2),
    "led": lambda x, side: led(x, NATIVE, lambda metres: side * (2 * metres).sin()),
    "turn": lambda x, side: turn(x, NATIVE, side * 2.0),
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
