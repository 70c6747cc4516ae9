"""Foot locking: feet hold still, nothing else moves, nothing pops."""

import pytest
import torch

from moveset.data import bandai_namco, cmu
from moveset.errors import InputError
from moveset.motion import measures, rotations
from moveset.motion.cleanup import lock_feet, move_feet
from moveset.motion.clip import Motion
from moveset.motion.contacts import stances
from moveset.motion.skeleton import HML22, Skeleton
from moveset.motion.smoothing import decay, settle
from tests.motions import gait, shaken, slid, sliding, smooth_noise, wander
from tests.takes import motion_of

LEGS = [1, 2, 4, 5]
ANKLES = [7, 8]
BELOW_HIPS = [4, 5, 7, 8, 10, 11]


def leg_jerk(motion: Motion) -> torch.Tensor:
    return torch.diff(motion.joints.double()[:, BELOW_HIPS], n=3, dim=0).norm(dim=-1) * motion.fps**3


def test_a_clean_walk_stays_as_it_is():
    motion = gait(80)
    locked = lock_feet(motion)
    assert (locked.joints - motion.joints).norm(dim=-1).max() < 0.005
    assert sliding(locked, stances(motion.joints, 20.0, HML22)) < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_a_shaking_walk_gets_still_feet(seed):
    motion = shaken(gait(120), seed, degrees=1.0, metres=0.006)
    planted = stances(motion.joints.double(), 20.0, HML22)
    locked = lock_feet(motion)
    assert sliding(motion, planted) > 0.2
    assert sliding(locked, planted) < 0.02
    assert measures.skating(locked.joints, 20.0) <= measures.skating(motion.joints, 20.0)
    assert leg_jerk(locked).mean() < leg_jerk(motion).mean()


@pytest.mark.parametrize("factor", [1.15, 0.85])
def test_a_sliding_walk_stops_sliding_without_a_pop(factor):
    motion = slid(gait(120), factor)
    planted = stances(motion.joints.double(), 20.0, HML22)
    locked = lock_feet(motion)
    assert sliding(motion, planted) > 0.12
    assert sliding(locked, planted) < 0.03
    assert leg_jerk(locked).max() < 1.5 * leg_jerk(motion).max()
    assert leg_jerk(locked).mean() < 1.25 * leg_jerk(motion).mean()


def test_feet_that_are_carried_off_take_steps():
    still = gait(120)
    root = torch.stack((torch.zeros(120), still.root[:1, 1].expand(120), 0.04 * torch.arange(120)), dim=1)
    motion = Motion(still.rotations[:1].expand(120, -1, -1).clone(), root, 20.0, HML22)
    locked = lock_feet(motion, contacts=torch.ones(120, 4, dtype=torch.bool))
    assert measures.skating(motion.joints, 20.0) == 1.0
    assert measures.skating(locked.joints, 20.0) < 0.6
    risen = (locked.joints - motion.joints)[:, [10, 11], 1]
    torch.testing.assert_close(risen.amax(dim=0), torch.full((2,), 0.07), atol=0.01, rtol=0)
    assert not bool((risen > 0.03).all(dim=1).any())  # one foot after the other


@pytest.mark.parametrize("away", [0.1, 0.3, 0.8])
@pytest.mark.parametrize("side", [0, 1])
def test_feet_that_are_out_of_reach_stay_on_the_floor(away, side):
    """A foot used to be drawn towards its hip, that is up: running people pawed the air."""
    motion = gait(40)
    shifts = torch.zeros(40, 2, 3)
    shifts[:, side, 2] = -away
    moved = move_feet(motion, shifts)
    ankle, toe = HML22.feet[2 * side : 2 * side + 2]
    height = (moved.joints - motion.joints)[..., 1]
    assert height[:, toe].abs().max() < 5e-4
    assert height[:, ankle].min() > -1e-4  # heels rise, they do not sink
    back = (motion.joints - moved.joints)[:, toe, 2]
    assert back.max() <= away + 1e-4
    assert back.min() > min(away, 0.05)
    # No knee is straighter than the leg is long, and nothing else moves.
    others = [j for j in range(22) if j not in LEGS]
    assert (moved.joints - motion.joints)[:, [j for j in others if j not in BELOW_HIPS]].norm(dim=-1).max() < 1e-5


def test_the_toe_stays_where_it_is_wanted_as_long_as_the_heel_may_rise():
    motion = gait(40)
    shifts = torch.zeros(40, 2, 3)
    shifts[:, 0, 2] = -0.2
    moved = move_feet(motion, shifts)
    turned = rotations.angle(rotations.mul(rotations.inv(motion.global_rotations), moved.global_rotations))
    ankle, toe = HML22.feet[:2]
    risen = (turned[:, ankle] > 1e-3) & (turned[:, ankle] < 0.3)
    assert risen.any()
    wanted = motion.joints[:, toe] + shifts[:, 0]
    assert (moved.joints[:, toe] - wanted)[risen].norm(dim=-1).max() < 2e-3
    assert turned[:, ankle].max() < 0.36


def test_only_legs_move_and_feet_keep_height_and_orientation():
    motion = shaken(gait(80), 5, degrees=0.5, metres=0.004)
    lowest = motion.joints[:, [7, 10, 8, 11], 1].amin()
    motion = Motion(motion.rotations, motion.root - lowest * torch.tensor([0.0, 1.0, 0.0]))  # nothing to lift
    contacts = stances(gait(80).joints, 20.0, HML22)
    locked = lock_feet(motion, contacts=contacts)
    assert torch.equal(locked.root, motion.root)
    above = [j for j in range(22) if j not in BELOW_HIPS]
    assert (locked.joints - motion.joints)[:, above].norm(dim=-1).max() < 1e-5
    turned = rotations.angle(rotations.mul(rotations.inv(motion.global_rotations), locked.global_rotations))
    assert turned[:, [j for j in range(22) if j not in (*LEGS, *ANKLES)]].max() < 2e-3
    assert turned[:, ANKLES].quantile(0.95) < 2e-3  # heels rise where a leg is too short
    stretched = (locked.joints - motion.joints)[:, [7, 10, 8, 11], 1].abs()
    assert stretched.median() < 1e-5


def test_knees_keep_bending_forward():
    motion = shaken(gait(120), 6, degrees=2.0, metres=0.01)
    local = lock_feet(motion).rotations[:, [4, 5]].double()
    straight = torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64)
    shin = rotations.rotate(local, straight.expand(*local.shape[:-1], 3))
    assert shin[..., 2].max() < 0.1  # never ahead of the thigh by more than the noise


def test_feet_below_the_floor_are_lifted():
    motion = gait(60)
    sunk = Motion(motion.rotations, motion.root - torch.tensor([0.0, 0.03, 0.0]))
    assert measures.penetration(sunk.joints) > 0.025
    assert measures.penetration(lock_feet(sunk).joints) < 1e-4


def test_given_contacts_decide():
    motion = slid(gait(80), 1.15)
    never = torch.zeros(80, 4, dtype=torch.bool)
    assert (lock_feet(motion, contacts=never).joints - motion.joints).norm(dim=-1).max() < 1e-5


@pytest.mark.parametrize(
    "motion", [wander(3, 0), wander(1, 0), wander(4, 0, bend=1.0), wander(60, 1, bend=1.0)], ids=len
)
def test_any_motion_survives(motion):
    locked = lock_feet(motion)
    assert len(locked) == len(motion)
    assert torch.isfinite(locked.joints).all()
    assert (locked.rotations.norm(dim=-1) - 1.0).abs().max() < 1e-5


def test_bad_requests_are_named():
    with pytest.raises(InputError, match=r"\(5, 4\), got \(4, 4\)"):
        lock_feet(wander(5, 0), contacts=torch.zeros(4, 4))
    other = Skeleton("other", HML22.joints, HML22.parents, HML22.offsets, HML22.pairs, HML22.feet)
    with pytest.raises(InputError, match="not on 'other'"):
        lock_feet(wander(5, 0, other))


def test_decay_starts_as_told_and_ends_at_rest():
    at = torch.linspace(0.0, 3.0, 3001, dtype=torch.float64)
    x, v = torch.tensor([2.0, -1.0], dtype=torch.float64), torch.tensor([5.0, 0.0], dtype=torch.float64)
    path = decay(x, v, 2.0, at)
    rate = torch.diff(path, dim=0) / 0.001
    torch.testing.assert_close(path[0], x)
    torch.testing.assert_close(rate[0], v, atol=1e-2, rtol=0)
    assert path[2000:].abs().max() < 1e-12
    assert rate[1998:].abs().max() < 1e-4
    assert (torch.diff(rate, dim=0) / 0.001)[[0, 1997]].abs().max() < 0.1


def test_settling_keeps_the_fixed_and_joins_them_smoothly():
    x = smooth_noise(60, 3, 8)
    fixed = torch.zeros(60, dtype=torch.bool)
    fixed[10:20] = fixed[24:30] = fixed[50:] = True
    out = settle(x, fixed, blend=6)
    assert torch.equal(out[fixed], x[fixed])
    assert out[:4].abs().max() == 0.0
    assert out[37:44].abs().max() < 1e-12
    assert torch.diff(out, dim=0).norm(dim=-1).max() < 2.0 * torch.diff(x, dim=0).norm(dim=-1).max() + 0.5
    assert settle(x, torch.zeros(60, dtype=torch.bool), 6).abs().max() == 0.0


def test_real_takes(real_data):
    """Real feet slide little: locking holds them and adds no jerk; with noise it takes the sliding away again."""
    refs = bandai_namco.list_takes(real_data)[:6]
    refs += [r for r in cmu.list_takes(real_data / "cmu") if r.name in ("02_01", "07_03")]
    for take, motion in ((ref, motion_of(ref)) for ref in refs):
        planted = stances(motion.joints.double(), 20.0, HML22)
        if not planted[:, [1, 3]].any():
            continue
        locked = lock_feet(motion)
        assert sliding(locked, planted) < 0.02, take.name
        assert leg_jerk(locked).mean() < 1.15 * leg_jerk(motion).mean(), take.name
        assert leg_jerk(locked).max() < 1.5 * leg_jerk(motion).max(), take.name
        noisy = shaken(motion, 9, degrees=1.0, metres=0.006)
        planted = stances(noisy.joints.double(), 20.0, HML22)
        locked = lock_feet(noisy)
        assert sliding(locked, planted) < 0.2 * sliding(noisy, planted), take.name
        assert leg_jerk(locked).mean() < leg_jerk(noisy).mean(), take.name
