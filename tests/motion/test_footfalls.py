"""Walks of so many steps: as many feet come down, and whoever stands does so for as long as is wanted."""

import pytest
import torch

from moveset.data.synthetic import synthetic_motion
from moveset.motion.cleanup import lock_feet
from moveset.motion.footfalls import Steps, footfalls, stand_on
from moveset.motion.native import NativeCodec

NATIVE = NativeCodec()
ROOT = NATIVE.groups["root_velocity"]


def walk_then_stand(frames=100, kind="walk"):
    walk, wave = (NATIVE.encode(synthetic_motion(k, frames)) for k in (kind, "wave-left-hand"))
    return torch.cat((walk, wave))


def made(x):
    """As users get it."""
    return lock_feet(NATIVE.decode(x), contacts=x[:, NATIVE.groups["contacts"]] > 0.15)


def test_every_half_of_a_cycle_a_foot_comes_down():
    motion = lock_feet(synthetic_motion("walk", 120))
    falls = footfalls(motion)
    gaps = torch.tensor(falls).diff()
    assert len(falls) >= 5
    # A cycle of this body is 1.3 m at 1.2 m/s.
    assert float(gaps.double().mean()) / 20.0 == pytest.approx(1.3 / 1.2 / 2, rel=0.25)
    assert footfalls(lock_feet(synthetic_motion("wave-left-hand", 120))) == []


@pytest.mark.parametrize("kind", ["walk", "walk-back"])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_so_many_feet_come_down(kind, count):
    x = walk_then_stand(kind=kind)
    cut = Steps(count).clip(x, NATIVE)
    assert len(cut) < len(x)
    at = (x[:, ROOT.start] == cut[0, ROOT.start]).nonzero()
    assert any(torch.equal(x[k : k + len(cut)], cut) for k in at.flatten().tolist())  # a piece of it
    falls = footfalls(made(x))
    begin = falls[-count - 1]
    assert begin < falls[-count]
    assert torch.equal(cut[0], x[begin])
    assert len([fall for fall in falls if fall > begin]) == count


def test_standing_is_cut_unless_something_is_done_then():
    x = walk_then_stand()
    rests, waves = Steps(2).clip(x, NATIVE), Steps(2, then=True).clip(x, NATIVE)
    assert torch.equal(waves[-1], x[-1])
    assert len(waves) - len(rests) == 100 - round(2.5 * 20) + 1
    assert torch.equal(rests, waves[: len(rests)])


def test_who_takes_fewer_steps_keeps_them_all():
    x = walk_then_stand()
    assert torch.equal(Steps(30, then=True).clip(x, NATIVE), x)
    still = NATIVE.encode(synthetic_motion("wave-left-hand", 60))
    assert torch.equal(Steps(1, then=True).clip(still, NATIVE), still)
    assert torch.equal(Steps(1).piece(x, NATIVE, 0.0), x)


def test_a_motion_is_made_long_enough_for_its_steps():
    assert Steps(1).cuts
    assert Steps(2).says == "what comes before the last 2 is cut off"
    assert [Steps(count).seconds for count in (1, 3, 5, 6)] == pytest.approx([7.0, 7.0, 8.5, 9.6])


@pytest.mark.parametrize("frames", [201, 230, 400])
def test_who_stands_stands_on(frames):
    x = walk_then_stand()
    longer = stand_on(x, NATIVE, frames)
    assert len(longer) == frames
    assert torch.equal(longer[:100], x[:100])
    before, after = NATIVE.decode(x), NATIVE.decode(longer)
    assert torch.allclose(before.root[-1], after.root[-1], atol=0.02)
    assert torch.allclose(before.rotations[-1].abs(), after.rotations[-1].abs(), atol=1e-3)
    assert float(after.joints.diff(dim=0).abs().max()) <= float(before.joints.diff(dim=0).abs().max()) + 1e-4


def test_who_drifts_and_turns_while_he_stands_does_not_do_so_for_longer():
    x = walk_then_stand()
    x[100:, ROOT] = torch.tensor((0.004, 0.002))  # metres a frame, of a body that sways
    x[100:, NATIVE.groups["root_yaw"]] = 0.002
    before, after = NATIVE.decode(x), NATIVE.decode(stand_on(x, NATIVE, 400))
    assert float((before.root[-1] - before.root[100]).norm()) > 0.3
    assert torch.allclose(before.root[-1], after.root[-1], atol=0.01)
    assert torch.allclose(before.rotations[-1, 0], after.rotations[-1, 0], atol=0.005)


def test_more_than_is_wanted_is_cut_off():
    x = walk_then_stand()
    assert torch.equal(stand_on(x, NATIVE, 70), x[:70])
    walks = NATIVE.encode(synthetic_motion("walk", 60))
    assert len(stand_on(walks, NATIVE, 90)) == 90  # even of who never stands
