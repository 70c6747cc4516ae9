"""What segments are told of their course, and what ways that went astray take back."""

import pytest
import torch

from moveset.motion.features import Normalizer, get_codec
from moveset.motion.native import NativeCodec
from moveset.training.condition_dropout import (
    CORRECTED,
    drop_captions,
    drop_heading_change,
    perturb_heading,
    perturb_past,
)

CODEC = NativeCodec()
ROWS, FRAMES = 400, 28
NORMALIZER = Normalizer(torch.full((CODEC.dim,), 0.01), torch.full((CODEC.dim,), 0.05))
YAW = CODEC.groups["root_yaw"]


def segments(speed):
    """Normalised segments of people who go forward at this speed, and are otherwise all alike."""
    features = torch.zeros(ROWS, FRAMES, CODEC.dim)
    features[..., CODEC.groups["root_velocity"]] = torch.tensor([0.0, speed / CODEC.fps])
    return (features - NORMALIZER.mean) / NORMALIZER.std


def strayed(speed, deviation=0.3, begun=True):
    clean, draws = segments(speed), torch.Generator().manual_seed(0)
    begun_B = torch.full((ROWS,), begun)
    made, turned = perturb_heading(clean, torch.full((ROWS,), 2.0), begun_B, deviation, CODEC, NORMALIZER, draws)
    change = (made - clean) * NORMALIZER.std
    assert not change[..., YAW.stop :].any()
    return change[..., YAW][..., 0], turned - 2.0


def test_who_walks_takes_half_of_it_back_gently():
    change, heading_noise = strayed(1.2)
    assert float(heading_noise.std()) == pytest.approx(0.3, rel=0.1)
    torch.testing.assert_close(change.sum(dim=1), -CORRECTED * heading_noise, atol=1e-5, rtol=0)
    # It sets in and ends where it would not be seen: a tenth of its fastest.
    assert (change[:, [0, -1]].abs().amax(dim=1) <= 0.1 * change.abs().amax(dim=1)).all()


def test_who_stands_takes_nothing_back():
    change, heading_noise = strayed(0.1)
    assert not change.any()
    assert heading_noise.abs().min() > 0


@pytest.mark.parametrize("name", ["native", "hml", "kit"])
@pytest.mark.parametrize("metres_a_second", [0.1, 0.4])
def test_speeds_are_metres_a_second_in_any_codec(name, metres_a_second):
    """Half as fast as who takes all of the share back takes half of it; KIT-ML's lengths are millimetres."""
    codec = get_codec(name)
    plain, clean = Normalizer(torch.zeros(codec.dim), torch.ones(codec.dim)), torch.zeros(ROWS, FRAMES, codec.dim)
    one = torch.zeros(3, codec.dim)
    one[:, codec.groups["root_velocity"]] = torch.tensor([0.0, 1.0])
    unit = float(codec.root_path(one)[1][1].norm())
    clean[..., codec.groups["root_velocity"]] = torch.tensor([0.0, metres_a_second / codec.fps / unit])
    begun_B, draws = torch.ones(ROWS, dtype=torch.bool), torch.Generator().manual_seed(0)
    made, turned = perturb_heading(clean, torch.zeros(ROWS), begun_B, 0.3, codec, plain, draws)
    back = (clean - made)[..., codec.groups["root_yaw"]].sum(dim=(1, 2))
    share = CORRECTED * {0.1: 0.0, 0.4: 0.5}[metres_a_second]
    torch.testing.assert_close(back, share * turned, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("name", ["native", "hml"])
def test_turns_are_radians_in_any_codec(name):
    """What a second's features turn, as the codec itself has it, is spread as it was asked for."""
    codec = get_codec(name)
    plain = Normalizer(torch.zeros(codec.dim), torch.ones(codec.dim))
    still, draws = torch.zeros(ROWS, round(codec.fps) + 1, codec.dim), torch.Generator().manual_seed(0)
    bent = perturb_past(still, torch.ones(ROWS), 0.2, codec, plain, draws)
    heading_BF, _ = codec.root_path(bent)
    assert float((heading_BF[:, -1] - heading_BF[:, 0]).std()) == pytest.approx(0.2, rel=0.15)
    _, turned = perturb_heading(still, torch.zeros(ROWS), torch.ones(ROWS), 0.3, codec, plain, draws)
    assert float(turned.std()) == pytest.approx({"native": 0.3, "hml": 0.15}[name], rel=0.15)


def test_who_has_just_been_told_cannot_have_gone_astray():
    change, heading_noise = strayed(1.2, begun=False)
    assert not change.any()
    assert not heading_noise.any()


def test_a_share_of_captions_is_dropped():
    said = drop_captions(["walk", "bow"] * 5000, 0.1, torch.Generator().manual_seed(0))
    assert said.count("") / len(said) == pytest.approx(0.1, abs=0.01)
    assert all(caption in ("", expected) for caption, expected in zip(said, ["walk", "bow"] * 5000, strict=True))


def test_a_share_is_told_and_the_rest_is_unknown():
    draws = torch.Generator().manual_seed(0)
    told = drop_heading_change(torch.ones(10_000), 0.7, draws)
    assert float(told.isnan().float().mean()) == pytest.approx(0.3, abs=0.02)
    assert (told[~told.isnan()] == 1).all()


def test_nothing_is_drawn_for_a_share_of_none():
    draws = torch.Generator().manual_seed(0)
    state = draws.get_state()
    assert drop_heading_change(torch.ones(5), 0.0, draws).isnan().all()
    assert torch.equal(draws.get_state(), state)
