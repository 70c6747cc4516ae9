"""Ways with corners end where they should, whatever is cut into pieces, and nothing but the way is another."""

import math
from dataclasses import replace

import pytest
import torch

from moveset.motion.corners import Corners, FigureEight
from moveset.motion.features import get_codec
from moveset.motion.way import way_of
from tests.motion.synthetic_features import NATIVE, features

THERE_AND_BACK, SQUARE = Corners(1, math.pi, 2, 3.0), Corners(1, math.pi / 2, 4)
ZIGZAG = Corners(1, math.pi / 2, 1, 1.0, zigzag=True)
ALL = [THERE_AND_BACK, SQUARE, ZIGZAG, FigureEight(1)]


def root(x, codec=NATIVE):
    return codec.decode(x).root.double()[:, [0, 2]]


def added(bent, x):
    """Degrees (F,) by which ways are bent from the first frame to each."""
    yaw = NATIVE.groups["root_yaw"]
    return (bent - x)[:, yaw][:, 0].double().cumsum(0).rad2deg()


def in_pieces(steering, x, size):
    out, gone = [], 0.0
    for piece in x.split(size):
        out.append(steering.piece(piece, NATIVE, 0.0, gone))
        gone += way_of(piece, NATIVE)
    return torch.cat(out)


@pytest.mark.parametrize("name", ["native", "hml", "kit"])
@pytest.mark.parametrize("steering", [SQUARE, Corners(-1, 2 * math.pi / 3, 3), FigureEight(-1)])
def test_closed_ways_end_where_they_began_whatever_the_features(name, steering):
    codec = get_codec(name)
    x = features(codec=codec)
    way = root(steering.clip(x, codec), codec)
    length = float(way.diff(dim=0).norm(dim=1).sum())
    assert float((way[-1] - way[0]).norm()) < 0.08 * length
    assert float((way - way[0]).norm(dim=1).max()) > 0.15 * length
    rest = torch.arange(x.shape[1]) != codec.groups["root_yaw"].start
    assert torch.equal(steering.clip(x, codec)[:, rest], x[:, rest])


def test_who_goes_back_and_forth_walks_beside_where_he_came():
    x = features("walk", 196)
    way = root(THERE_AND_BACK.clip(x, NATIVE))
    furthest = int((way - way[0]).norm(dim=1).argmax())
    assert 0.4 < furthest / len(way) < 0.6
    assert float((way[-1] - way[0]).norm()) < 2.0  # no further off than a turn is wide, and a half of a step
    assert float(added(THERE_AND_BACK.clip(x, NATIVE), x)[-1]) == pytest.approx(180.0, abs=1.0)


def test_a_long_way_back_and_forth_has_more_legs():
    x = features("walk", 600)
    turns = float(added(THERE_AND_BACK.clip(x, NATIVE), x)[-1]) / 180.0
    assert turns == pytest.approx(round(turns), abs=0.02)
    assert round(turns) % 2 == 1  # which leads back
    assert round(turns) >= 3


def test_a_zigzag_goes_to_one_side_and_to_the_other():
    x = features("walk", 196)
    bend = added(ZIGZAG.clip(x, NATIVE), x)
    assert float(bend.max()) == pytest.approx(45.0, abs=2.0)
    assert float(bend.min()) == pytest.approx(-45.0, abs=2.0)
    signs = torch.sign(bend[bend.abs() > 30.0])
    changes = int((signs.diff() != 0).sum())
    assert changes >= 1
    assert float(signs[0]) == 1.0
    short = features("walk", 60)
    legs = (added(ZIGZAG.clip(short, NATIVE), short).abs() > 40.0).int().diff().abs().sum()
    assert int(legs) >= 3  # straight on, to the left, through the middle, to the right


def test_a_figure_of_eight_goes_round_on_either_side():
    x = features("walk", 196)
    bend = added(FigureEight(1).clip(x, NATIVE), x)
    assert float(bend.max()) == pytest.approx(360.0, abs=10.0)
    assert abs(float(bend[-1])) < 10.0
    assert float(bend.min()) > -1.0
    assert torch.allclose(added(FigureEight(-1).clip(x, NATIVE), x), -bend, atol=1e-3)


@pytest.mark.parametrize(("kind", "radius"), [("walk", 1.2), ("run", 3.0 / math.radians(120.0))])
def test_eights_of_streams_have_a_radius_that_feet_can_follow(kind, radius):
    x = features(kind, 40)
    bend = math.radians(float(added(FigureEight(1).piece(x, NATIVE, 0.0), x)[-1]))
    assert bend == pytest.approx(way_of(x, NATIVE) / radius, rel=0.01)


@pytest.mark.parametrize("kind", ["walk", "run"])
@pytest.mark.parametrize("steering", ALL)
def test_nobody_turns_faster_than_feet_can_follow(kind, steering):
    x = features(kind, 100)
    for bent in (steering.clip(x, NATIVE), steering.piece(x, NATIVE, 0.0)):
        assert float((bent - x).abs().max()) * NATIVE.fps <= math.radians(120.0) + 1e-4


@pytest.mark.parametrize("steering", ALL)
def test_who_stands_does_not_turn(steering):
    still = features("wave-left-hand")
    for bent in (steering.clip(still, NATIVE), steering.piece(still, NATIVE, 0.0)):
        assert float(added(bent, still).abs().max()) < 15.0
    nowhere = still.clone()
    nowhere[:, NATIVE.groups["root_velocity"]] = 0.0
    assert torch.equal(steering.clip(nowhere, NATIVE), nowhere)


@pytest.mark.parametrize("kind", ["walk", "run"])
@pytest.mark.parametrize("steering", ALL)
def test_a_stream_goes_on_so_however_it_is_cut(kind, steering):
    x = features(kind, 560)
    whole, pieces = in_pieces(steering, x, 560), in_pieces(steering, x, 28)
    assert torch.allclose(whole, pieces, atol=1e-5)
    corners = added(pieces, x)
    if steering is SQUARE:
        legs = way_of(x, NATIVE) / (2.5 + 1.13 if kind == "walk" else 2.5 * 2.5 + 2.81)
        assert float(corners[-1]) / 90.0 == pytest.approx(legs, abs=1.0)
    else:
        assert float(corners.abs().max()) > 40.0


@pytest.mark.parametrize("steering", ALL)
def test_the_mirror_image_is_bent_to_the_other_side(steering):
    order, signs = NATIVE.mirror()
    x = features("walk")
    mirrored, other = x[:, order] * signs, replace(steering, side=-1)
    assert torch.allclose(steering.clip(x, NATIVE)[:, order] * signs, other.clip(mirrored, NATIVE), atol=1e-5)
    piece = steering.piece(x, NATIVE, 0.0, 2.0)
    assert torch.allclose(piece[:, order] * signs, other.piece(mirrored, NATIVE, 0.0, 2.0), atol=1e-5)


def test_what_is_bent_is_told():
    assert SQUARE.says == "the way is bent to the left again and again, by 90 degrees"
    assert ZIGZAG.says == "the way is bent to one side and to the other, by 90 degrees"
    assert FigureEight(-1).says == "the way is bent onto a circle to the right and one to the left"
    assert not any(steering.seconds for steering in ALL)
