"""What a reconstruction is judged by, on motion that is wrong in one way only."""

from dataclasses import replace

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.features import Normalizer, get_codec
from moveset.motion.skeleton import HML22
from moveset.training.vae_loss import ReconstructionWeights, reconstruction_loss
from tests.motions import gait

CODEC = get_codec("native")
NORMALIZER = Normalizer(torch.zeros(CODEC.dim), torch.ones(CODEC.dim))
FRAMES = 60
ARMS = [HML22.index(f"{side}_shoulder") for side in ("left", "right")]


def walk(swing: float = 1.0, delay: int = 0):
    """A walk whose arms swing by a share of what they should, or some frames late."""
    full = gait(FRAMES + 20)
    local = full.rotations[:FRAMES].clone()
    arms = full.rotations[delay : FRAMES + delay, ARMS]
    hanging = gait(1).rotations[:, ARMS].expand_as(arms)
    local[:, ARMS] = rotations.slerp(hanging, arms, torch.full((FRAMES, 1), swing))
    return replace(full[:FRAMES], rotations=local)


def parts(made, lengths=(FRAMES,)):
    real = CODEC.encode(walk())[None]
    _, found = reconstruction_loss(made[None], real, torch.tensor(lengths), CODEC, NORMALIZER, ReconstructionWeights())
    return {name: float(value) for name, value in found.items()}


def test_a_perfect_reconstruction_costs_nothing():
    assert all(value < 1e-5 for value in parts(CODEC.encode(walk())).values())


def test_arms_that_swing_too_little_cost_posture_and_late_ones_cost_more():
    half, late = (parts(CODEC.encode(walk(**change))) for change in ({"swing": 0.5}, {"delay": 10}))
    for name in ("positions", "velocity", "acceleration"):
        assert late[name] > half[name] > 1e-4
    assert half["path"] < 1e-6
    assert half["heading"] < 1e-6


def test_nothing_is_counted_beyond_the_end_of_a_clip():
    made = CODEC.encode(walk())
    made[40:] = CODEC.encode(walk(swing=0.0))[40:]
    assert parts(made)["positions"] > 1e-4
    assert all(value < 1e-5 for value in parts(made, lengths=(40,)).values())


def test_a_foot_that_is_down_costs_what_it_slides():
    # Of sixty frames the first twenty are in the air.
    high = torch.zeros(FRAMES, 3)
    high[:20, 1] = 0.3
    real = CODEC.encode(replace(walk(), root=walk().root + high))
    # The body is carried a centimetre a frame too far: whatever stands slides by that, in metres a frame.
    made = real.clone()
    made[..., CODEC.groups["root_velocity"]] += torch.tensor([0.01, 0.0])
    _, found = reconstruction_loss(
        made[None], real[None], torch.tensor([FRAMES]), CODEC, NORMALIZER, ReconstructionWeights()
    )
    assert float(found["feet"]) == pytest.approx(0.01 * 39 / 59, rel=0.01)


def test_a_body_in_the_floor_costs_what_was_not_there_before():
    real = replace(walk(), root=walk().root - torch.tensor([0.0, 0.6, 0.0]))  # up to the knees in it
    deeper = replace(real, root=real.root - torch.tensor([0.0, 0.1, 0.0]))
    encoded, made = CODEC.encode(real), CODEC.encode(deeper)
    lengths, under = torch.tensor([FRAMES]), (real.joints[..., 1] < 0).float().mean()
    cost = [
        float(
            reconstruction_loss(x[None], encoded[None], lengths, CODEC, NORMALIZER, ReconstructionWeights())[1]["floor"]
        )
        for x in (encoded, made, CODEC.encode(walk()))
    ]
    assert cost[0] == pytest.approx(0.0, abs=1e-6)
    assert 0.1 * float(under) <= cost[1] <= 0.1
    assert cost[2] == pytest.approx(0.0, abs=1e-6)


NAMES = ["features", "positions", "velocity", "acceleration", "path", "heading", "feet", "floor"]


@pytest.mark.parametrize("name", NAMES)
def test_every_weight_counts(name):
    made, real = CODEC.encode(walk(swing=0.5))[None], CODEC.encode(walk())[None]
    made[..., CODEC.groups["root_yaw"]] += 0.01
    made[..., CODEC.groups["root_height"]] -= 0.5
    none = dict.fromkeys(NAMES, 0.0)
    total, found = reconstruction_loss(
        made, real, torch.tensor([FRAMES]), CODEC, NORMALIZER, ReconstructionWeights(**(none | {name: 3.0}))
    )
    assert float(total) > 0
    assert float(total) == pytest.approx(3.0 * float(found[name]), rel=1e-5)
