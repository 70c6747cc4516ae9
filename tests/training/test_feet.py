"""How far feet slide that are said to stand."""

from dataclasses import replace

import pytest
import torch

from moveset.motion.features import Normalizer, get_codec
from moveset.training.feet import sliding
from tests.motions import gait

CODEC = get_codec("native")
NORMALIZER = Normalizer(torch.full((CODEC.dim,), 0.2), torch.full((CODEC.dim,), 1.5))
LENGTHS = torch.tensor([30])


def standing(speed: float, contacts: float = 1.0, frames: int = 30) -> torch.Tensor:
    """Normalised features (1, F, D) of a body that stands still and is carried forward at a speed in m/s."""
    pose = gait(1)
    way = torch.arange(frames)[:, None] * torch.tensor([0.0, 0.0, speed / 20.0])
    still = replace(pose, rotations=pose.rotations.expand(frames, -1, -1), root=pose.root[:1] + way)
    features = CODEC.encode(still)
    features[:, CODEC.groups["contacts"]] = contacts
    return NORMALIZER.normalize(features)[None]


def slid(features: torch.Tensor, lengths: torch.Tensor = LENGTHS) -> float:
    return float(sliding(features, lengths, CODEC, NORMALIZER))


@pytest.mark.parametrize("speed", [0.0, 0.5, 1.2])
def test_it_is_the_square_of_the_speed_that_a_standing_body_is_carried_at(speed):
    assert slid(standing(speed)) == pytest.approx(speed**2, abs=1e-4)


def test_what_is_in_the_air_may_move():
    assert slid(standing(1.0, contacts=0.3)) == 0.0
    half = standing(1.0)
    half[:, :15, CODEC.groups["contacts"]] = NORMALIZER.normalize(torch.zeros(CODEC.dim))[CODEC.groups["contacts"]]
    assert slid(half) == pytest.approx(1.0, abs=1e-4)


def test_nothing_counts_beyond_the_end_of_a_clip():
    features = torch.cat((standing(0.5), standing(3.0)), dim=1)
    assert slid(features) == pytest.approx(0.25, abs=1e-4)
    assert slid(torch.cat((features, features)), torch.tensor([30, 10])) == pytest.approx(0.25, abs=1e-4)


def test_a_step_is_learned_and_not_that_there_is_none():
    features = standing(0.5).requires_grad_()
    sliding(features, LENGTHS, CODEC, NORMALIZER).backward()
    assert features.grad is not None
    assert features.grad[..., CODEC.groups["root_velocity"]].abs().sum() > 0.1
    assert features.grad[..., CODEC.groups["contacts"]].abs().sum() == 0
