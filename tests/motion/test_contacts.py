"""Stances of a walk whose stances are known, and the removal of flicker."""

import pytest
import torch

from moveset.motion.contacts import foot_contacts, stances, stands_on
from moveset.motion.rigs import get_rig
from moveset.motion.skeleton import HML22, KIT21
from tests.motions import gait, shaken


def test_a_walks_stances_are_found():
    """Six tenths of each cycle of 22 frames; the edges may be off by a frame or two, since lifting starts slowly."""
    motion = gait(110, cycle=1.1)
    planted = stances(motion.joints, 20.0, HML22)
    assert planted.dtype == torch.bool
    share = planted[22:88].float().mean(dim=0)
    assert (share - 0.6).abs().max() < 0.15
    stance_left = torch.remainder(torch.arange(110) / 22, 1.0)
    sure = (stance_left > 0.05) & (stance_left < 0.55)
    assert planted[sure][:, 1].all()
    swing = (stance_left > 0.72) & (stance_left < 0.88)
    assert not planted[swing][:, :2].any()


def test_low_is_not_enough_and_slow_is_not_enough():
    motion = gait(66)
    joints = motion.joints.clone()
    joints[:, [7, 10], 1] *= 0.2  # a swinging foot that hardly leaves the floor
    joints[:, [8, 11], 1] += 0.5  # a foot in the air
    planted = foot_contacts(joints, 20.0, HML22)
    assert planted[:, 1].float().mean() < 0.8
    assert not planted[:, 2:].any()


@pytest.mark.parametrize("skeleton", [HML22, KIT21, get_rig("mixamo")], ids=lambda skeleton: skeleton.name)
def test_whose_hips_are_at_the_ankles_stands_on_no_legs(skeleton):
    """Squatting, with the knees as high as ever."""
    standing = skeleton.rest_positions
    squatting = standing.clone()
    pelvis = skeleton.children[0]
    squatting[[0, *pelvis], 1] -= 0.75 * (standing[0, 1] - standing[:, 1].min())
    assert stands_on(torch.stack((standing, squatting)), skeleton).tolist() == [True, False]


def test_jitter_makes_no_flicker():
    motion = shaken(gait(110), 0, degrees=0.8, metres=0.004)
    switches = (torch.diff(stances(motion.joints, 20.0, HML22).int(), dim=0) != 0).sum(dim=0)
    raw = (torch.diff(foot_contacts(motion.joints, 20.0, HML22).int(), dim=0) != 0).sum(dim=0)
    assert switches.max() <= 12  # five cycles
    assert switches.sum() < raw.sum()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("1110111", "1111111"),  # a gap of one frame is closed
        ("1110011", "1111111"),  # of two
        ("1110001", "1110000"),  # not of three; and one frame is no stance
        ("0110111", "0111111"),
        ("0011000", "0000000"),
        ("0011100", "0011100"),
        ("0000000", "0000000"),
        ("1111111", "1111111"),
    ],
)
def test_given_contacts_are_closed_and_dropped(given, expected):
    column = torch.tensor([int(c) for c in given])[:, None].repeat(1, 4)
    joints = torch.zeros(len(given), 22, 3)
    out = stances(joints, 20.0, HML22, column)
    assert "".join(str(int(c)) for c in out[:, 2]) == expected
