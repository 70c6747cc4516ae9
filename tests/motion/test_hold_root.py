"""Who stands on both feet does not glide."""

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.hold_root import hold_root
from moveset.motion.native import NativeCodec
from moveset.motion.skeleton import HML22

CODEC = NativeCodec()
STEPS = CODEC.groups["root_velocity"]
BOTH = torch.ones(28, 4, dtype=torch.bool)


def gliding(speed=(0.06, 0.07), turn=0.0, frames=28):
    """Features of a person who stands, breathes, and glides over the floor (m/s in x and z), turning steadily."""
    turned = rotations.identity(frames, len(HML22))
    time = torch.arange(frames) / CODEC.fps
    turned[:, 0] = rotations.yaw(turn * time)
    turned[:, HML22.index("spine1")] = rotations.about("x", 2 * torch.sin(3 * time))
    root = torch.zeros(frames, 3)
    root[:, 1] = -float(HML22.rest_positions[:, 1].min())
    root[:, [0, 2]] = time[:, None] * torch.tensor(speed)
    return CODEC.encode(Motion(turned, root, CODEC.fps, HML22))


def travel(features):
    """Metres that feet travel over the floor, frame by frame (F - 1, 4)."""
    return CODEC.joints(features)[:, list(HML22.feet)].diff(dim=0)[..., [0, 2]].norm(dim=-1)


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_planted_feet_stay_whatever_the_heading(heading):
    features = gliding((0.02 * heading, 0.07))
    features[0, CODEC.groups["root_yaw"]] = heading  # from the second frame on the body faces another way
    inside = slice(4, -1)  # the turn itself is no drift
    assert travel(features)[inside].min() > 0.003
    held = hold_root(features, BOTH, CODEC)
    assert travel(held)[inside].max() < 1e-5
    # The last step leads out of the segment: the next one goes on from a body that stands.
    assert held[-1, STEPS].abs().max() < 1e-5


def test_nothing_but_the_roots_steps_changes():
    features = gliding()
    held = hold_root(features, BOTH, CODEC)
    changed = (held != features).any(dim=0).nonzero()[:, 0].tolist()
    assert changed == list(range(STEPS.start, STEPS.stop))
    assert features[0, STEPS].abs().max() > 0  # the input is left alone


def test_who_flies_goes_where_they_go():
    features = gliding()
    assert torch.equal(hold_root(features, ~BOTH, CODEC), features)


@pytest.mark.parametrize("planted", [(1, 1, 0, 0), (0, 0, 0, 1)])
def test_over_one_foot_that_drifts_the_root_slows_by_half_of_it(planted):
    features = gliding()
    told = torch.tensor(planted, dtype=torch.bool).expand(28, 4)
    before, after = (x[1:-1, STEPS].norm(dim=1) * CODEC.fps for x in (features, hold_root(features, told, CODEC)))
    torch.testing.assert_close(before - after, 0.5 * before, atol=1e-4, rtol=0)


@pytest.mark.parametrize("planted", [(1, 1, 1, 1), (1, 1, 0, 0)])
def test_who_drifts_is_held_in_full_and_who_travels_is_not(planted):
    told = torch.tensor(planted, dtype=torch.bool).expand(28, 4)
    lost = []
    for speed in (0.09, 0.2, 0.35):  # of feet: who drifts, who is between, who travels
        features = gliding((0.0, speed))
        before, after = (x[2:-1, STEPS].norm(dim=1) * CODEC.fps for x in (features, hold_root(features, told, CODEC)))
        lost.append(float(((before - after) / before).mean()))
    whole = 1.0 if all(planted) else 0.5
    assert lost[0] == pytest.approx(whole, abs=0.02)
    assert lost[1] == pytest.approx(whole / 2, abs=0.05)
    assert lost[2] == 0.0


def test_who_stands_still_already_stays_as_they_are():
    features = gliding((0.0, 0.0))
    assert torch.allclose(hold_root(features, BOTH, CODEC), features, atol=1e-6)


def test_only_the_steps_between_planted_frames_are_held_and_without_a_jolt():
    features, told = gliding(), BOTH.clone()
    told[:10] = False
    held = hold_root(features, told, CODEC)
    assert torch.equal(held[:9], features[:9])
    before, after = (x[8:14, STEPS].norm(dim=1) for x in (features, held))
    left = after / before
    assert left[0] == 1.0
    assert (left.diff() < 0)[:4].all()
    assert left.diff().min() > -0.4
    assert left[5] < 1e-4


def test_feet_that_slide_apart_keep_their_middle():
    """The drift is the mean of the feet's: what they do against each other is for the lock."""
    features = gliding((0.0, 0.0))
    hip = HML22.index("left_hip")
    spread = rotations.about("x", torch.linspace(0, 6, 28))
    columns = CODEC.groups["rotations"].start + 6 * hip
    features[:, columns : columns + 6] = rotations.to_6d(spread)
    held = hold_root(features, BOTH, CODEC)
    feet = CODEC.joints(held)[:, list(HML22.feet)][..., [0, 2]]
    assert feet.mean(dim=1).diff(dim=0)[1:-1].norm(dim=-1).max() < 1e-5
