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


@pytest.mark.parametrize("name", ["features", "positions", "velocity", "acceleration", "path", "heading", "feet"])
def test_every_weight_counts(name):
    made, real = CODEC.encode(walk(swing=0.5))[None], CODEC.encode(walk())[None]
    made[..., CODEC.groups["root_yaw"]] += 0.01
    none = dict.fromkeys(("features", "positions", "velocity", "acceleration", "path", "heading", "feet"), 0.0)
    total, found = reconstruction_loss(
        made, real, torch.tensor([FRAMES]), CODEC, NORMALIZER, ReconstructionWeights(**(none | {name: 3.0}))
    )
    assert float(total) > 0
    assert float(total) == pytest.approx(3.0 * float(found[name]), rel=1e-5)
