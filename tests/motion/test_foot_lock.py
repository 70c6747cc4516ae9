"""Feet locked piece by piece: what stands holds still across seams, what flies is left alone, nothing jumps."""

import json
import math

import pytest
import torch

from moveset.errors import InputError
from moveset.motion import measures, rotations
from moveset.motion.clip import Motion
from moveset.motion.foot_lock import FootLock
from moveset.motion.skeleton import HML22

FPS = 20.0
LEFT_ANKLE, LEFT_TOE = HML22.feet[:2]


def sliding(frames, speed):
    """A body in a crouched rest pose that slides along x, metres a second, with its feet under it."""
    turned = rotations.identity(frames, len(HML22)).double()
    for hip, knee, ankle in (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle")):
        for joint, angle in ((hip, -0.3), (knee, 0.6), (ankle, -0.3)):
            turned[:, HML22.index(joint)] = torch.tensor([math.sin(angle / 2), 0, 0, math.cos(angle / 2)]).double()
    root = torch.zeros(frames, 3, dtype=torch.float64)
    root[:, 0] = torch.arange(frames) * speed / FPS
    root[:, 1] = 0.001 - Motion(turned, root, FPS).joints[..., 1].min()
    return Motion(turned, root, FPS)


def pieces(motion, contacts, size=14):
    lock = FootLock(HML22, FPS)
    done = [lock(motion[k : k + size], contacts[k : k + size]) for k in range(0, len(motion), size)]
    return torch.cat([piece.joints for piece in done])


def planted(frames, start, stop):
    contacts = torch.zeros(frames, 4, dtype=torch.bool)
    contacts[start:stop, :2] = True
    return contacts


def test_a_standing_foot_holds_still_across_seams():
    motion = sliding(42, 0.1)
    locked = pieces(motion, planted(42, 10, 32))
    assert float(motion.joints[:, LEFT_TOE, 0].diff().min()) > 0.004
    assert float(locked[11:31, LEFT_TOE].diff(dim=0)[:, [0, 2]].abs().max()) < 1e-3
    # The other foot and everything from the hips up stay as they were.
    others = [j for j in range(len(HML22)) if j not in (LEFT_ANKLE, LEFT_TOE, HML22.index("left_knee"))]
    assert torch.allclose(locked[:, others], motion.joints[:, others], atol=1e-9)


def test_nothing_jumps():
    motion = sliding(56, 0.3)
    locked = pieces(motion, planted(56, 5, 13) | planted(56, 20, 30))
    own = motion.joints[:, LEFT_TOE].diff(dim=0).norm(dim=-1).max()
    assert float(locked[:, LEFT_TOE].diff(dim=0).norm(dim=-1).max()) < 5 * float(own)
    assert torch.allclose(locked[-1], motion.joints[-1], atol=1e-6)


def test_a_foot_is_let_go_before_its_leg_is_stretched():
    motion = sliding(200, 0.2)
    locked = pieces(motion, planted(200, 0, 200), size=28)
    offset = (locked[:, LEFT_TOE] - motion.joints[:, LEFT_TOE])[:, [0, 2]].norm(dim=-1)
    assert 0.2 < float(offset.max()) < 0.35
    assert float(offset[-100:].min()) < 0.16


def test_feet_that_are_carried_off_take_steps_in_turn():
    motion = sliding(120, 0.6)
    locked = pieces(motion, torch.ones(120, 4, dtype=torch.bool), size=28)
    toes = locked[:, [LEFT_TOE, HML22.feet[3]], 1]
    raised = toes > toes[0] + 0.03
    assert measures.skating(motion.joints, FPS) == 1.0
    assert measures.skating(locked, FPS) < 0.5
    assert bool(raised.any(dim=0).all())
    assert not bool(raised.all(dim=1).any())


def test_nobody_steps_on_one_leg():
    motion = sliding(120, 0.6)
    locked = pieces(motion, planted(120, 0, 120), size=28)
    assert torch.allclose(locked[:, LEFT_TOE, 1], motion.joints[:, LEFT_TOE, 1], atol=0.02)


def test_feet_in_the_air_and_on_the_floor_are_left_alone():
    motion = sliding(28, 0.5)
    assert torch.allclose(pieces(motion, planted(28, 0, 0)), motion.joints, atol=1e-9)


def test_feet_below_the_floor_are_lifted_onto_it():
    sunk = sliding(28, 0.0).transformed(rotations.identity().double(), torch.tensor([0.0, -0.02, 0.0]).double())
    assert float(sunk.joints[..., 1].min()) == pytest.approx(-0.019, abs=1e-3)
    assert float(pieces(sunk, planted(28, 0, 0))[..., 1].min()) > -1e-3


def test_a_lock_goes_on_from_its_state():
    motion, contacts = sliding(42, 0.3), planted(42, 3, 20)
    lock = FootLock(HML22, FPS)
    lock(motion[:14], contacts[:14])
    again = FootLock.from_state(HML22, FPS, json.loads(json.dumps(lock.state())))
    for part in (slice(14, 28), slice(28, 42)):
        one, two = (held(motion[part], contacts[part]) for held in (lock, again))
        assert torch.equal(one.rotations, two.rotations)


def test_contacts_of_another_shape_are_refused():
    with pytest.raises(InputError, match=r"\(14, 4\)"):
        FootLock(HML22, FPS)(sliding(14, 0.0), torch.zeros(13, 4, dtype=torch.bool))
