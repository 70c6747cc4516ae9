"""Ways that are bent: they end where they should, and nothing but the way is another."""

import math
from dataclasses import replace

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.features import get_codec
from moveset.motion.footfalls import Steps
from moveset.motion.steering import Circle, During, Spin, Stay, Together, Turn
from tests.motion.synthetic_features import NATIVE, features


def turned(x, codec=NATIVE):
    """Degrees from the first frame to the last, to the left, of the decoded motion."""
    heading = rotations.heading_angle(codec.decode(x).rotations[:, 0].double())
    return math.degrees(float((torch.remainder(heading.diff() + math.pi, 2 * math.pi) - math.pi).sum()))


def in_pieces(steering, x, sizes):
    """What a stream makes of features that are bent piece by piece."""
    out, before = [], 0.0
    for piece in x.split(sizes):
        out.append(steering.piece(piece, NATIVE, before))
        before += float(piece[:, NATIVE.groups["root_yaw"]].double().sum())
    return torch.cat(out)


@pytest.mark.parametrize("name", ["native", "hml", "kit"])
@pytest.mark.parametrize("side", [1, -1])
def test_a_circle_ends_where_it_began_whatever_the_features(name, side):
    codec = get_codec(name)
    x = Circle(side).clip(features(codec=codec), codec)
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


@pytest.mark.parametrize("name", ["native", "hml", "kit"])
@pytest.mark.parametrize("degrees", [45, 135, 180, 300, -90])
@pytest.mark.parametrize("kind", ["walk", "walk-turn-left", "run"])
def test_a_turn_ends_at_its_angle_whatever_was_made(name, degrees, kind):
    codec = get_codec(name)
    x = features(kind, codec=codec)
    bent = Turn(math.radians(degrees)).clip(x, codec)
    # A pelvis that is decoded from positions is not quite where the features look.
    assert turned(bent, codec) == pytest.approx(degrees, abs=2.0 if name == "native" else 8.0)
    rest = torch.arange(x.shape[1]) != codec.groups["root_yaw"].start
    assert torch.equal(bent[:, rest], x[:, rest])


def test_a_turn_that_is_there_stays_where_it_is():
    x = torch.cat((features("walk", 60), features("walk-turn-left", 60), features("walk", 60)))
    bent = Turn(math.radians(150)).clip(x, NATIVE)
    yaw = bent[:, NATIVE.groups["root_yaw"]][:, 0]
    assert math.degrees(float(yaw[60:120].sum())) == pytest.approx(150, abs=5)
    assert float(yaw[:60].abs().sum() + yaw[120:].abs().sum()) < math.radians(5)


def test_who_stands_does_not_spin_and_who_runs_does_not_trip():
    for steering in (Circle(1), Circle(1, once=False), Turn(math.pi), Turn(-math.pi)):
        still = features("wave-left-hand")
        assert turned(steering.clip(still, NATIVE)) == pytest.approx(turned(still), abs=1.0)
        assert turned(steering.piece(still, NATIVE, 0.0)) == pytest.approx(turned(still), abs=1.0)
    x = Circle(-1, once=False, radius=0.5).clip(features("run"), NATIVE)
    assert float(x[:, NATIVE.groups["root_yaw"]].abs().max()) * NATIVE.fps <= math.radians(120.0) + 1e-6
    for side in (1, -1):  # a metre is too little to go round
        assert 90 < side * turned(Circle(side).clip(features("walk", 20), NATIVE)) < 180


def test_circles_of_a_radius_have_it_in_every_codec():
    for name in ("native", "hml", "kit"):
        codec = get_codec(name)
        root = codec.decode(Circle(1, once=False, radius=2.0).clip(features(codec=codec), codec)).root[:, [0, 2]]
        way = float(root.diff(dim=0).norm(dim=1).sum())
        chord = float((root[-1] - root[0]).norm())
        assert chord == pytest.approx(4.0 * abs(math.sin(way / 4.0)), abs=0.1)


@pytest.mark.parametrize("radius", [0.8, 1.5, 4.0])
def test_a_stream_goes_round_on_its_radius_however_it_is_cut(radius):
    x = features("walk", 560)
    steering = Circle(1, radius=radius)
    whole, pieces = in_pieces(steering, x, 560), in_pieces(steering, x, 28)
    assert torch.equal(whole, pieces)
    root = NATIVE.decode(pieces).root.double()[:, [0, 2]]
    way = root.diff(dim=0).norm(dim=1).sum()
    assert math.radians(turned(pieces)) == pytest.approx(float(way) / radius, rel=0.02)
    once = root[: int(560 * 2 * math.pi * radius / float(way))]
    assert float((once - once.mean(dim=0)).norm(dim=1).mean()) == pytest.approx(radius, rel=0.05)


@pytest.mark.parametrize("degrees", [90, 180, -180])
@pytest.mark.parametrize("own", [100, 160, 250])
def test_a_stream_ends_at_the_angle_however_far_it_turns_by_itself(degrees, own):
    x = features("walk", 280)
    yaw = x[:, NATIVE.groups["root_yaw"]]
    yaw[20:160] += math.copysign(math.radians(own) / 140, degrees)
    bent = in_pieces(Turn(math.radians(degrees)), x, 28)
    assert 0.94 < turned(bent) / degrees < 1.11
    late = turned(bent) - turned(bent[:200])
    assert abs(late) < 0.05 * abs(degrees)  # nor does it turn back


def test_what_is_turned_by_decides_what_is_added():
    x = features("walk", 28)
    x[:, NATIVE.groups["root_yaw"]] += math.radians(75.0) / 28
    made = float(Turn(math.pi).piece(x, NATIVE, 0.0)[:, NATIVE.groups["root_yaw"]].sum())
    assert made == pytest.approx(1.1 * math.pi * math.tanh(1.0), rel=1e-3)


def test_hips_sway_as_they_did():
    x = features("walk", 280)
    x[:, NATIVE.groups["root_yaw"]] += 0.03 * torch.sin(torch.arange(280) * 0.6)[:, None]
    bent = in_pieces(Turn(math.pi / 2), x, 28)
    added = (bent - x)[:, NATIVE.groups["root_yaw"]][:, 0]
    for piece in added.split(28):  # along the way, which this body goes at a steady pace
        assert float(piece.std()) < 0.02 * 0.03


@pytest.mark.parametrize("steering", [Circle(1), Circle(1, once=False, radius=0.8), Turn(2.0), Stay()])
def test_the_mirror_image_is_bent_to_the_other_side(steering):
    order, signs = NATIVE.mirror()
    other = {Turn: Turn(-2.0), Stay: Stay()}.get(type(steering)) or replace(steering, side=-1)
    x = features("walk-turn-left")
    mirrored = x[:, order] * signs
    assert torch.allclose(steering.clip(x, NATIVE)[:, order] * signs, other.clip(mirrored, NATIVE), atol=1e-6)
    assert torch.allclose(
        steering.piece(x, NATIVE, 0.3)[:, order] * signs, other.piece(mirrored, NATIVE, -0.3), atol=1e-6
    )


def test_what_is_bent_is_told():
    assert Circle(-1).says == "the way is bent to the right, onto a circle"
    assert Turn(math.pi).says == "the way is bent to the left, by 180 degrees in all"
    assert Turn(-math.pi / 2).says == "the way is bent to the right, by 90 degrees in all"


@pytest.mark.parametrize("kind", ["walk", "run", "walk-turn-left", "walk-back"])
def test_who_stays_steps_below_his_hips(kind):
    x = features(kind)
    bent = Stay().clip(x, NATIVE)
    went, stays = NATIVE.decode(x), NATIVE.decode(bent)
    assert torch.equal(stays.root[:, 1], went.root[:, 1])
    assert (stays.root[:, [0, 2]] == 0).all()
    joints, legs = stays.joints.double(), [stays.skeleton.index(f"left_{name}") for name in ("hip", "ankle")]
    ahead = rotations.rotate(rotations.heading(stays.rotations[:, 0].double()), torch.tensor((0.0, 0.0, 1.0)).double())
    swing = ((joints[:, legs[1]] - joints[:, legs[0]]) * ahead).sum(dim=-1)
    assert float(swing.abs().max()) < 0.02
    # Feet rise as they did, and everything above the hips is as it was.
    feet = list(stays.skeleton.feet)
    assert (joints[:, feet, 1] - went.joints.double()[:, feet, 1]).abs().max() < 0.02
    moved = (stays.rotations * went.rotations).sum(dim=-1).abs() < 1 - 1e-6
    leg = [stays.skeleton.index(f"{side}_{name}") for side in ("left", "right") for name in ("hip", "knee", "ankle")]
    assert set(moved.any(dim=0).nonzero().flatten().tolist()) <= set(leg)
    assert torch.equal(bent[:, NATIVE.groups["contacts"]], x[:, NATIVE.groups["contacts"]])


def test_pieces_that_stay_are_the_whole_that_does():
    x = features("walk")
    assert torch.allclose(in_pieces(Stay(), x, 28), Stay().clip(x, NATIVE), atol=1e-6)


@pytest.mark.parametrize("name", ["hml", "kit"])
def test_other_features_stay_where_they_are(name):
    codec = get_codec(name)
    assert float(codec.decode(Stay().clip(features(codec=codec), codec)).root[:, [0, 2]].abs().max()) < 1e-6


def test_one_of_several_ways_is_bent():
    x = torch.cat((features("walk", 100), features("wave-left-hand", 40), features("walk", 60)))
    yaw = NATIVE.groups["root_yaw"]
    for begin, end, frames in ((0.0, 0.5, (0, 80)), (0.5, 1.0, (80, 200))):
        bent = During(Circle(1), begin, end).clip(x, NATIVE)
        added = math.degrees(float((bent - x)[:, yaw].sum()))
        assert added == pytest.approx(360.0, abs=8.0)
        outside = torch.ones(200, dtype=torch.bool)
        outside[frames[0] : frames[1]] = False
        assert torch.equal(bent[outside], x[outside])
    assert During(Circle(-1), 0.0, 0.5).says == Circle(-1).says
    still = features("wave-left-hand", 40)
    assert During(Circle(1), 0.0, 0.5).clip(still, NATIVE) is still
    assert torch.equal(During(Stay(), 0.5, 1.0).piece(x, NATIVE, 0.0), Stay().piece(x, NATIVE, 0.0))


def test_several_are_done_one_after_the_other():
    x = features("walk")
    both = Together((Circle(1), Stay()))
    assert torch.equal(both.clip(x, NATIVE), Stay().clip(Circle(1).clip(x, NATIVE), NATIVE))
    assert torch.equal(both.piece(x, NATIVE, 0.1, 2.0), Stay().piece(Circle(1).piece(x, NATIVE, 0.1), NATIVE, 0.1))
    assert both.says == f"{Circle(1).says}; {Stay().says}"
    assert both.seconds == Together(()).seconds == During(Stay(), 0.0, 1.0).seconds == 0.0
    assert [both.cuts, Together(()).cuts, During(both, 0.0, 0.5).cuts] == [False] * 3
    assert Together((Stay(), Steps(1))).cuts
    assert During(Steps(1), 0.0, 0.5).cuts


@pytest.mark.parametrize("degrees", [90, -180, 360])
def test_who_spins_turns_on_the_spot_while_he_is_on_his_way(degrees):
    x = torch.cat((features("walk", 80), features("wave-left-hand", 60)))
    bent = Spin(math.radians(degrees)).clip(x, NATIVE)
    assert turned(bent) == pytest.approx(degrees, abs=2.0)
    assert (NATIVE.decode(bent).root[:, [0, 2]] == 0).all()
    yaw = (bent - x)[:, NATIVE.groups["root_yaw"]][:, 0]
    assert float(yaw[:80].sum()) == pytest.approx(math.radians(degrees), abs=1e-3)
    assert float(yaw[80:].abs().max()) == 0.0
    # Gently at first and in the end.
    assert float(yaw[:3].abs().max()) < 0.2 * float(yaw.abs().max()) > float(yaw[77:80].abs().max())
    stays = Stay().clip(x, NATIVE)
    rest = torch.arange(x.shape[1]) != NATIVE.groups["root_yaw"].start
    assert torch.equal(bent[:, rest], stays[:, rest])


def test_nobody_spins_faster_than_feet_can_follow():
    x = features("walk", 60)
    assert turned(Spin(20.0).clip(x, NATIVE)) == pytest.approx(3.0 * 220.0, rel=0.05)
    still = features("wave-left-hand", 60)
    assert torch.equal(Spin(1.0).clip(still, NATIVE), Stay().clip(still, NATIVE))
    assert Spin(2 * math.pi).seconds == pytest.approx(2 * 360 / 110)
    assert Spin(-0.5).seconds == 4.0
    assert During(Spin(2 * math.pi), 0.5, 1.0).seconds == pytest.approx(2 * Spin(2 * math.pi).seconds)
    assert not Spin(1.0).cuts


@pytest.mark.parametrize("name", ["native", "hml", "kit"])
def test_a_stream_spins_on_and_on_in_every_codec(name):
    codec = get_codec(name)
    x = features("walk", 60, codec)
    bent = Spin(-3.0).piece(x, codec, 0.0)
    assert turned(bent, codec) - turned(x, codec) == pytest.approx(-110.0 * 59 / codec.fps, rel=0.05)
    assert Spin(math.pi).says == "feet step on the spot and turn to the left, by 180 degrees"
