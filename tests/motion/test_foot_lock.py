"""Foot locking piece by piece: nearly what locking the whole motion gives, and nothing shows where pieces meet."""

import json

import pytest
import torch

from moveset.errors import InputError
from moveset.motion import measures, rotations
from moveset.motion.cleanup import lock_feet
from moveset.motion.clip import Motion
from moveset.motion.contacts import foot_contacts, stances
from moveset.motion.foot_lock import FootLock
from moveset.motion.skeleton import HML22
from tests.motions import gait, shaken, slid, sliding, wander

N = 28
BELOW_HIPS = [4, 5, 7, 8, 10, 11]
FEET = list(HML22.feet)


CASES = {
    "clean": gait(280),
    "shaken": shaken(gait(280), 1, degrees=1.0, metres=0.006),
    "too far": slid(gait(280), 1.08),
    "not far enough": slid(gait(280), 0.85),
    "shaken and too far": shaken(slid(gait(280), 1.08), 3, degrees=1.0, metres=0.006),
    "another rhythm": shaken(slid(gait(280, speed=1.2, cycle=1.3), 1.05), 4, degrees=1.0, metres=0.004),
}


def locked(motion: Motion, contacts: torch.Tensor, n: int = N) -> Motion:
    lock = FootLock(motion.skeleton, motion.fps)
    pieces = [lock(motion[k : k + n], contacts[k : k + n]) for k in range(0, len(motion), n)]
    return Motion(torch.cat([p.rotations for p in pieces]), torch.cat([p.root for p in pieces]).float())


def raw_contacts(motion: Motion) -> torch.Tensor:
    return foot_contacts(motion.joints.double(), 20.0, HML22)


def jerks(motion: Motion) -> tuple[torch.Tensor, torch.Tensor]:
    """Third differences of the legs that reach over a seam, and all, m/s³."""
    size = torch.diff(motion.joints.double()[:, BELOW_HIPS], n=3, dim=0).norm(dim=-1) * motion.fps**3
    frames = torch.arange(len(size))
    return size[(frames % N >= N - 3) & (frames < len(motion) - N)], size


@pytest.mark.parametrize("case", CASES)
def test_pieces_are_locked_about_as_well_as_the_whole(case):
    motion = CASES[case]
    contacts, planted = raw_contacts(motion), stances(motion.joints.double(), 20.0, HML22)
    whole, stream = lock_feet(motion, contacts=contacts), locked(motion, contacts)
    assert measures.skating(stream.joints.float(), 20.0) <= 1.1 * measures.skating(whole.joints, 20.0)
    assert sliding(stream, planted) <= sliding(whole, planted) + 0.02
    assert measures.penetration(stream.joints.float()) < 1e-4
    (seams, everything), (_, of_whole) = jerks(stream), jerks(whole)
    assert everything.mean() < 1.1 * of_whole.mean()
    assert everything.max() < 1.4 * of_whole.max()
    # Where pieces meet is no worse a place than any other.
    assert seams.mean() < 1.25 * everything.mean()
    assert seams.max() <= everything.max()


def test_a_walk_that_slides_by_far_is_held_too():
    """Without a look ahead a foot is pinned where it lands, not midway: it has twice as far to catch up."""
    motion = slid(gait(280), 1.15)
    contacts, planted = raw_contacts(motion), stances(motion.joints.double(), 20.0, HML22)
    stream = locked(motion, contacts)
    assert sliding(motion, planted) > 0.12
    assert sliding(stream, planted) < 0.01
    assert jerks(stream)[1].max() < 1.1 * jerks(lock_feet(motion, contacts=contacts))[1].max()


def test_a_foot_that_stands_through_many_pieces_does_not_move():
    still = gait(1)
    sway = 0.03 * torch.sin(torch.arange(6 * N) / 9.0)[:, None] * torch.tensor([1.0, 0.0, 0.5])
    motion = Motion(still.rotations.expand(6 * N, 22, 4).clone(), still.root + sway)
    stream = locked(motion, torch.ones(6 * N, 4, dtype=torch.bool))
    toes = stream.joints[:, [10, 11]]
    assert (motion.joints[:, [10, 11]] - toes[0]).norm(dim=-1).max() > 0.03
    # A leg that is nearly straight gives way by half a millimetre rather than snap.
    assert (toes - toes[0]).norm(dim=-1).max() < 1e-3


def test_a_foot_is_let_go_before_its_leg_is_dragged_along():
    still = gait(1)
    away = torch.arange(20 * N)[:, None] * torch.tensor([0.0, 0.0, 0.01])
    motion = Motion(still.rotations.expand(20 * N, 22, 4).clone(), still.root + away)
    stream = locked(motion, torch.ones(20 * N, 4, dtype=torch.bool))
    off = (stream.joints - motion.joints)[:, FEET].norm(dim=-1)
    assert 0.2 < off.max() < 0.35
    assert jerks(stream)[1].max() < 900.0


def test_a_foot_rises_on_its_way_back_the_higher_the_further():
    def rise(factor: float) -> float:
        motion = slid(gait(280), factor)
        raised = locked(motion, raw_contacts(motion)).joints - motion.joints
        return raised[:, FEET, 1].amax().item()

    assert rise(1.0) < 0.01 < rise(1.05) < rise(1.1) < rise(1.15) < 0.08


def test_nobody_steps_on_one_leg():
    motion = slid(gait(280), 1.15)
    contacts = raw_contacts(motion)
    contacts[:, 2:] = False  # as if the right foot never stood
    raised = locked(motion, contacts).joints - motion.joints
    assert raised[:, FEET[1], 1].amax() < 1e-4  # the toe; its heel rises where the leg is too short


def crouched(frames: int, speed: float) -> Motion:
    """A body in a crouch that slides along x, metres a second, with its feet under it."""
    turned = rotations.identity(frames, len(HML22)).double()
    for side in ("left", "right"):
        for joint, angle in ((f"{side}_hip", -0.3), (f"{side}_knee", 0.6), (f"{side}_ankle", -0.3)):
            turned[:, HML22.index(joint)] = rotations.about("x", torch.rad2deg(torch.tensor(angle)).double())
    root = torch.zeros(frames, 3, dtype=torch.float64)
    root[:, 0] = torch.arange(frames) * speed / 20.0
    root[:, 1] = 0.001 - Motion(turned, root, 20.0).joints[..., 1].min()
    return Motion(turned, root, 20.0)


def test_feet_that_are_carried_off_take_steps_in_turn():
    motion = crouched(120, 0.6)
    stream = locked(motion, torch.ones(120, 4, dtype=torch.bool)).joints
    raised = stream[:, [10, 11], 1] > stream[0, [10, 11], 1] + 0.03
    assert measures.skating(motion.joints, 20.0) == 1.0
    assert measures.skating(stream, 20.0) < 0.5
    assert bool(raised.any(dim=0).all())
    assert not bool(raised.all(dim=1).any())


def test_feet_in_the_air_are_left_alone_and_those_below_the_floor_are_lifted_onto_it():
    motion, air = crouched(28, 0.5), torch.zeros(28, 4, dtype=torch.bool)
    assert torch.allclose(locked(motion, air).joints.double(), motion.joints.double(), atol=1e-5)
    sunk = Motion(motion.rotations, motion.root - 0.02 * torch.tensor([0.0, 1.0, 0.0]), 20.0)
    assert float(sunk.joints[..., 1].min()) == pytest.approx(-0.019, abs=1e-3)
    assert float(locked(sunk, air).joints[..., 1].min()) > -1e-3


def test_only_legs_move():
    motion = CASES["shaken"]
    stream = locked(motion, raw_contacts(motion))
    above = [j for j in range(22) if j not in BELOW_HIPS]
    assert (stream.joints - motion.joints)[:, above].norm(dim=-1).max() < 1e-5


@pytest.mark.parametrize("n", [1, 2, 7, 112])
def test_pieces_of_any_length(n):
    motion = CASES["shaken"][:112]
    contacts = stances(motion.joints.double(), 20.0, HML22)
    stream = locked(motion, contacts, n)
    assert len(stream) == 112
    assert jerks(stream)[1].max() < 1.5 * jerks(motion)[1].max()
    if n >= 7:
        assert sliding(stream, contacts) < 0.06


def test_a_resumed_lock_goes_on_as_if_nothing_had_happened_and_its_state_does_not_grow():
    motion = CASES["shaken and too far"]
    contacts, lock = raw_contacts(motion), FootLock(HML22, 20.0)
    sizes = []
    for k in range(0, 280, N):
        resumed = FootLock.from_state(HML22, 20.0, json.loads(json.dumps(lock.state())))
        a, b = (each(motion[k : k + N], contacts[k : k + N]) for each in (lock, resumed))
        assert torch.equal(a.rotations, b.rotations)
        assert json.dumps(resumed.state()) == json.dumps(lock.state())
        sizes.append(len(json.dumps(lock.state())))
    assert max(sizes) < 2000


def test_bad_requests_are_named():
    with pytest.raises(InputError, match=r"\(5, 4\), got \(4, 4\)"):
        FootLock(HML22, 20.0)(wander(5, 0), torch.zeros(4, 4))
