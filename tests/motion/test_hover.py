"""Nobody hovers: jumps stay as they are, what lasts longer than a jump is taken off, in clips and in streams."""

import json
import math
from dataclasses import replace

import pytest
import torch
from scipy.ndimage import grey_opening

from moveset.motion import rotations
from moveset.motion.cleanup import lock_feet
from moveset.motion.clip import Motion
from moveset.motion.contacts import stances
from moveset.motion.foot_lock import FootLock
from moveset.motion.hover import LONGEST, Hovering, clearance, lasting, seated, set_down
from moveset.motion.skeleton import HML22
from tests.motions import gait

FPS = 20.0
GRAVITY = 9.81


def above(heights: torch.Tensor) -> Motion:
    """A body in its rest pose, ``heights`` (F,) metres above the floor on which it stands."""
    turned = rotations.identity(len(heights), len(HML22))
    root = torch.zeros(len(heights), 3)
    root[:, 1] = heights - Motion(turned, root, FPS).joints[..., 1].min()
    return Motion(turned, root, FPS)


def jump(frames: int, start: int, seconds: float) -> torch.Tensor:
    """Heights (F,) of a body that falls as bodies fall."""
    at = (torch.arange(frames) - start) / FPS
    return (0.5 * GRAVITY * at * (seconds - at)).clamp_min(0.0)


def hover(frames: int, start: int, stop: int, height: float) -> torch.Tensor:
    """Rises in a quarter of a second, stays, and comes down as fast."""
    ramp = torch.minimum(torch.arange(frames) - start, stop - torch.arange(frames)) / (0.25 * FPS)
    return height * ramp.clamp(0.0, 1.0)


def seated_at(heights: torch.Tensor) -> Motion:
    """Thighs level and shins straight down, feet ``heights`` (F,) above the floor."""
    motion = above(heights)
    turned = motion.rotations.clone()
    for side in ("left", "right"):
        turned[:, HML22.index(f"{side}_hip")] = rotations.about("x", torch.tensor(-90.0))
        turned[:, HML22.index(f"{side}_knee")] = rotations.about("x", torch.tensor(90.0))
    sitting = replace(motion, rotations=turned)
    root = motion.root.clone()
    root[:, 1] += heights - sitting.joints[..., 1].amin(dim=1)
    return replace(sitting, root=root)


def streamed(motion: Motion, size: int, planted: torch.Tensor | None = None) -> torch.Tensor:
    """What a stream takes off, in pieces; by default of a body that plants no foot."""
    planted = torch.zeros(len(motion), 2, dtype=torch.bool) if planted is None else planted
    feet = motion.joints[:, list(HML22.feet), 1].unflatten(1, (2, 2)).amin(dim=2)
    low = motion.joints[..., 1].amin(dim=1)
    held = Hovering(FPS)
    parts = []
    for k in range(0, len(motion), size):
        piece = slice(k, k + size)
        parts.append(held(low[piece], feet[piece], planted[piece]))
        held = Hovering(FPS, **json.loads(json.dumps(held.state())))
    return torch.cat(parts)


@pytest.mark.parametrize("height", [0.0, 0.15, 0.35])
def test_who_sits_on_nothing_is_set_down(height):
    """In a clip exactly, in a stream after the length of a jump; nobody floats, and nothing else moves."""
    up = seated_at(hover(120, 20, 100, height))
    down = seated(up)
    assert down.joints[30:90, :, 1].amin(dim=1).max() < 0.07
    assert torch.equal(down.root[:, [0, 2]], up.root[:, [0, 2]])
    assert torch.equal(down.rotations, up.rotations)
    assert torch.equal(down.root[:15], up.root[:15])
    low = up.joints[..., 1].amin(dim=1) - streamed(up, 14)
    assert low[45:95].max() < 0.07


def test_who_stands_jumps_or_is_high_up_is_not_seated():
    for motion in (
        above(hover(120, 20, 100, 0.2)), seated_at(jump(60, 20, 0.9 * LONGEST)), seated_at(hover(120, 20, 100, 0.6))
    ):  # fmt: skip
        assert seated(motion) is motion


def test_who_stands_walks_or_jumps_is_left_alone():
    for motion in (above(torch.zeros(40)), gait(80), above(jump(60, 20, LONGEST)), above(jump(40, -5, LONGEST))):
        assert set_down(motion) is motion
        assert not streamed(motion, 14).any()
    walk = gait(80)
    planted = stances(walk.joints, FPS, HML22).unflatten(1, (2, 2)).any(dim=2)
    assert planted.any()
    assert not streamed(walk, 14, planted).any()


def test_who_stays_up_is_set_down_and_what_a_jump_explains_is_left():
    heights = hover(100, 20, 75, 0.15) + jump(100, 40, 0.5)
    motion = above(heights)
    left = clearance(set_down(motion).joints)
    assert float(clearance(motion.joints).max()) > 0.4
    # The jump from up there is a jump from the floor; only its tolerance of five centimetres may be left of the rest.
    assert float(left.max()) < float(jump(100, 40, 0.5).max()) + 0.05
    assert float(left[22:36].max()) < 0.08
    assert float(left[56:73].max()) < 0.08
    assert float(set_down(motion).joints[..., 1].min()) > -0.05
    # Only the root moves, and only down or up.
    assert torch.equal(set_down(motion).rotations, motion.rotations)
    assert torch.equal(set_down(motion).root[:, [0, 2]], motion.root[:, [0, 2]])


def test_who_may_have_climbed_is_set_down_only_after_flying_there_and_no_higher_than_people_jump():
    rising = 0.15 * (torch.linspace(-1.0, 6.0, 80).clamp(0.0, 1.0))
    carried, aloft = above(rising), above(torch.full((80,), 0.15))
    flown, far_up = above(hover(112, 10, 100, 0.15)), above(hover(112, 10, 100, 0.4))
    for motion in (carried, aloft, far_up):
        assert set_down(motion) is motion
    assert float(clearance(set_down(flown).joints).max()) < 0.09


@pytest.mark.parametrize("seed", range(4))
def test_opening_equals_scipys(seed: int):
    heights = torch.randn(200, generator=torch.Generator().manual_seed(seed)).cumsum(0).clamp_min(0.0)
    width = round(LONGEST * FPS) + 1
    inner = slice(2 * width, -2 * width)  # at the ends scipy goes on with what it chooses
    expected = torch.from_numpy(grey_opening(heights.numpy(), size=width))
    assert torch.allclose(lasting(heights, FPS)[inner], expected[inner], atol=1e-6)


@pytest.mark.parametrize("frames", [1, 2, 12, 13, 14])
def test_clips_of_any_length(frames: int):
    high = above(torch.full((frames,), 0.3))
    assert torch.allclose(lasting(clearance(high.joints), FPS), clearance(high.joints))
    assert set_down(high) is high
    assert len(streamed(high, 5)) == frames


def test_a_stream_sinks_after_the_time_of_a_jump_whatever_its_pieces():
    motion = above(hover(160, 20, 140, 0.3))
    one = streamed(motion, 160)
    for size in (1, 14, 28):
        assert torch.equal(streamed(motion, size), one)
    left = motion.joints[..., 1].amin(dim=1) - one
    assert float(left[: 20 + round(LONGEST * FPS)].max()) > 0.25  # nobody knows yet
    assert float(left[50:135].max()) < 0.05
    # It neither drops nor jumps: slower than a body falls from there.
    assert float(one.diff().abs().max()) * FPS < math.sqrt(2 * GRAVITY * 0.3)
    assert float(one[-1]) < 0.05


@pytest.mark.parametrize("period", [1.6, 3.0, 5.0])
def test_who_goes_up_and_down_without_ever_landing_is_never_up_for_longer_than_a_jump(period: float):
    """The least height of the last moments would lag behind: such a body floated by a hand's breadth for ever."""
    motion = above(0.25 + 0.1 * (2.0 * math.pi * torch.arange(240) / FPS / period).sin())
    left = motion.joints[..., 1].amin(dim=1) - streamed(motion, 28)
    up, longest = 0, 0
    for high in (left > 0.05).tolist():
        up = up + 1 if high else 0
        longest = max(longest, up)
    assert longest / FPS < LONGEST + 0.4  # and the time that it takes to come down
    assert float(left.min()) > -0.05


def test_planted_feet_far_above_the_floor_bring_it_up_at_once_and_slowly():
    motion = above(torch.full((100,), 0.12))
    both, none = torch.ones(100, 2, dtype=torch.bool), torch.zeros(100, 2, dtype=torch.bool)
    one = streamed(motion, 28, both)
    assert 0.0 < float(one[0]) < 0.01
    assert (one.diff() >= 0).all()
    assert float(one[-1]) == pytest.approx(0.07, abs=0.002)  # the last five centimetres are for the legs
    assert not streamed(motion, 28, none)[: round(LONGEST * FPS)].any()


@pytest.mark.parametrize("way", ["clip", "stream"])
def test_a_planted_foot_comes_down_and_one_in_the_air_stays_up(way: str):
    walk = gait(112)
    planted = stances(walk.joints, FPS, HML22)
    high = Motion(walk.rotations, walk.root + torch.tensor([0.0, 0.04, 0.0]), FPS)
    lock = FootLock(HML22, FPS)
    done = lock_feet(high, contacts=planted) if way == "clip" else lock(high, planted)
    feet = [motion.joints[:, list(HML22.feet), 1].unflatten(1, (2, 2)).amin(dim=2) for motion in (walk, high, done)]
    stands = planted.unflatten(1, (2, 2)).any(dim=2)
    standing = stands & (stands.roll(3, 0) & stands.roll(-3, 0))
    assert float((feet[2] - feet[0])[standing].median()) < 0.025
    assert float((feet[1] - feet[0])[standing].median()) == pytest.approx(0.04, abs=1e-4)
    assert torch.equal(done.root.float(), high.root)


def test_locks_set_down_and_take_up_again():
    motion = above(hover(112, 10, 112, 0.4))
    free = torch.zeros(112, 4, dtype=torch.bool)
    low = above(hover(112, 10, 112, 0.15))
    assert float(clearance(lock_feet(low, contacts=free).joints)[20:].max()) < 0.08
    # Who is that high for that long is on something.
    assert torch.equal(lock_feet(motion, contacts=free).root, motion.root)

    def locked(again: bool) -> torch.Tensor:
        lock, done = FootLock(HML22, FPS), []
        for k in range(0, 112, 28):
            if again:
                lock = FootLock.from_state(HML22, FPS, json.loads(json.dumps(lock.state())))
            done.append(lock(motion[k : k + 28], free[k : k + 28]).joints)
        return torch.cat(done)

    assert torch.equal(locked(again=True), locked(again=False))
    assert float(clearance(locked(again=False))[40:].max()) < 0.08
