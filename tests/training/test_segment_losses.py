"""The course of a segment, what its steps of turning add up to; and the limbs that move more."""

import math

import pytest
import torch

from moveset.motion.features import Normalizer, get_codec
from moveset.training.condition_dropout import perturb_past
from moveset.training.segment_losses import KNEE, below_floor, heading_error, placed, side_shortfall
from tests.evaluation.test_sides import moving
from tests.synthetic import synthetic_motion

CODEC = get_codec("native")


@pytest.fixture(scope="module")
def walks():
    """Normalised features (3, 28, D) and the normaliser."""
    clips = [CODEC.encode(synthetic_motion("walk", 28, seed=seed)) for seed in range(3)]
    normalizer = Normalizer.fit(clips, CODEC.groups)
    return torch.stack([normalizer.normalize(clip) for clip in clips]), normalizer


def bent(walks, rate, index=(1, 2, 0)):
    features, normalizer = walks
    generator = torch.Generator().manual_seed(0)
    return perturb_past(features, torch.tensor(index), rate, CODEC, normalizer, generator)


def test_a_bent_walk_turns_steadily_and_is_otherwise_the_same(walks):
    features, normalizer = walks
    changed = bent(walks, 0.5)
    turn = normalizer.denormalize(changed) - normalizer.denormalize(features)
    yaw = CODEC.groups["root_yaw"]
    assert torch.allclose(turn[..., yaw], turn[:, :1, yaw].expand(-1, 28, -1), atol=1e-5)
    turn[..., yaw] = 0.0
    assert turn.abs().max() < 1e-5
    assert not torch.equal(changed[:2], features[:2])
    assert torch.equal(changed[2], features[2])  # a first segment has none before it


def test_bends_are_as_wide_as_asked_for(walks):
    _, normalizer = walks
    still = torch.zeros(4000, 2, CODEC.dim)
    generator = torch.Generator().manual_seed(1)
    made = perturb_past(still, torch.ones(4000), 0.1, CODEC, normalizer, generator)
    steps = normalizer.denormalize(made)[:, 0, CODEC.groups["root_yaw"]] - normalizer.mean[CODEC.groups["root_yaw"]]
    assert float(steps.std() * CODEC.fps) == pytest.approx(0.1, rel=0.05)


def test_only_what_is_deeper_in_the_floor_than_the_take_counts():
    take = torch.tensor([0.4, 0.0, -0.1, -0.1])
    made = torch.tensor([0.1, -0.2, -0.1, -0.3])
    assert float(below_floor(made, take)) == pytest.approx((0.2 + 0.2) / 4)
    assert float(below_floor(take, take)) == 0.0


def test_the_error_of_a_steady_turn_in_closed_form(walks):
    features, normalizer = walks
    turned = features.clone()
    turned[..., CODEC.groups["root_yaw"]] += 0.01 / normalizer.std[CODEC.groups["root_yaw"]]
    valid = torch.ones(3, 28, dtype=torch.bool)
    found = heading_error(turned, features, valid, CODEC, normalizer)
    expected = sum(math.sqrt((0.01 * k) ** 2 + KNEE**2) - KNEE for k in range(1, 29)) / 28
    assert torch.allclose(found, torch.full((3,), expected), rtol=1e-4)
    assert heading_error(features, features, valid, CODEC, normalizer).abs().max() == 0.0


def test_a_swing_that_comes_back_costs_less_than_a_turn(walks):
    features, normalizer = walks
    yaw, step = CODEC.groups["root_yaw"], torch.full((28, 1), 0.02)
    swing = step * torch.tensor([1.0, -1.0]).repeat(14)[:, None]
    valid = torch.ones(3, 28, dtype=torch.bool)
    errors = []
    for added in (step, swing):
        made = features.clone()
        made[..., yaw] += added / normalizer.std[yaw]
        errors.append(heading_error(made, features, valid, CODEC, normalizer))
    assert (errors[1] < errors[0] / 10).all()


def test_what_is_beyond_the_clip_does_not_count(walks):
    features, normalizer = walks
    valid = torch.arange(28) < torch.tensor([10, 28, 0])[:, None]
    made = features.clone()
    made[0, 10:] += 5.0
    found = heading_error(made, features, valid, CODEC, normalizer)
    assert torch.equal(found, torch.zeros(3))


def test_gradients_reach_the_turn_alone(walks):
    features, normalizer = walks
    made = (features + 0.1).requires_grad_(True)
    heading_error(made, features, torch.ones(3, 28, dtype=torch.bool), CODEC, normalizer).sum().backward()
    yaw = CODEC.groups["root_yaw"]
    assert made.grad is not None
    assert (made.grad[..., yaw] > 0).all()
    made.grad[..., yaw] = 0.0
    assert not made.grad.any()


def test_who_moves_the_limb_that_is_told_falls_short_by_nothing_and_the_mirror_image_by_much(walks):
    _, normalizer = walks
    arm, leg = (normalizer.normalize(CODEC.encode(moving(limb, "left")))[:28] for limb in ("arm", "leg"))
    order, signs = CODEC.mirror()
    real = torch.stack((arm, leg))
    other = normalizer.normalize((normalizer.denormalize(real) * signs)[..., order])
    valid, evenly = torch.ones(2, 28, dtype=torch.bool), torch.ones(2)

    def short(made, told, weight=evenly):
        joints = (placed(x, CODEC, normalizer) for x in (made, real))
        return float(side_shortfall(*joints, valid, torch.tensor(told), weight, CODEC.skeleton))

    nan, left = float("nan"), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    assert short(real, left) == 0
    assert short(other, left) > 1
    # Nothing is asked for that is not told, or that the real segment does not do either.
    assert short(other, [[nan, nan, 1.0], [0.0, nan, nan]]) == 0
    assert short(other, [[-1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]) == 0
    # … and no more of it than there.
    little = real.lerp(other, 0.45)
    assert 0 < short(little, left) < short(other, left)
    joints = placed(little, CODEC, normalizer)
    assert float(side_shortfall(joints, joints, valid, torch.tensor(left), evenly, CODEC.skeleton)) == 0
    mixed = torch.stack((other[0], real[1]))
    assert short(mixed, left, torch.tensor([0.0, 1.0])) == 0
    assert short(mixed, left) == pytest.approx(short(mixed, left, torch.tensor([1.0, 0.0])) / 2)
