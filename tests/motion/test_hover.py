"""Nobody hovers: jumps stay as they are, what lasts longer than a jump is taken off, in clips and in streams."""

import json
import math

import pytest
import torch
from scipy.ndimage import grey_opening

from moveset.motion import rotations
from moveset.motion.cleanup import lock_feet
from moveset.motion.clip import Motion
from moveset.motion.foot_lock import FootLock
from moveset.motion.hover import LONGEST, Hovering, clearance, hovering, set_down
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


def streamed(motion: Motion, size: int) -> torch.Tensor:
    held = Hovering(FPS)
    parts = []
    for k in range(0, len(motion), size):
        parts.append(held(motion.joints[k : k + size]))
        held = Hovering(FPS, **json.loads(json.dumps(held.state())))
    return torch.cat(parts)


def test_who_stands_walks_or_jumps_is_left_alone():
    for motion in (above(torch.zeros(40)), gait(80), above(jump(60, 20, LONGEST)), above(jump(40, -5, LONGEST))):
        assert set_down(motion) is motion
        assert not streamed(motion, 14).any()


def test_who_stays_up_is_set_down_and_what_a_jump_explains_is_left():
    heights = hover(100, 20, 75, 0.3) + jump(100, 40, 0.5)
    motion = above(heights)
    left = clearance(set_down(motion).joints)
    assert float(clearance(motion.joints).max()) > 0.5
    # The jump from up there is a jump from the floor; only its tolerance of five centimetres may be left of the rest.
    assert float(left.max()) < float(jump(100, 40, 0.5).max()) + 0.05
    assert float(left[22:36].max()) < 0.08
    assert float(left[56:73].max()) < 0.08
    assert float(set_down(motion).joints[..., 1].min()) > -0.05
    # Only the root moves, and only down or up.
    assert torch.equal(set_down(motion).rotations, motion.rotations)
    assert torch.equal(set_down(motion).root[:, [0, 2]], motion.root[:, [0, 2]])


def test_half_of_it():
    motion = above(hover(80, 20, 60, 0.3))
    whole, half = (motion.root[:, 1] - set_down(motion, strength).root[:, 1] for strength in (1.0, 0.5))
    assert torch.allclose(half, 0.5 * whole, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_opening_equals_scipys(seed: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("moveset.motion.hover._SMOOTH", 1e-3)  # a Gaussian of one sample
    heights = torch.randn(200, generator=torch.Generator().manual_seed(seed)).cumsum(0).clamp_min(0.0)
    width = round(LONGEST * FPS) + 1
    inner = slice(2 * width, -2 * width)  # at the ends scipy goes on with what it chooses
    expected = torch.from_numpy(grey_opening(heights.numpy(), size=width))
    assert torch.allclose(hovering(heights, FPS)[inner], expected[inner], atol=1e-6)


@pytest.mark.parametrize("frames", [1, 2, 12, 13, 14])
def test_clips_of_any_length(frames: int):
    high = above(torch.full((frames,), 0.3))
    assert float(clearance(set_down(high).joints).max()) < 1e-6
    assert len(streamed(high, 5)) == frames


def test_a_stream_sinks_after_the_time_of_a_jump_whatever_its_pieces():
    motion = above(hover(160, 20, 140, 0.3))
    one = streamed(motion, 160)
    for size in (1, 14, 28):
        assert torch.equal(streamed(motion, size), one)
    left = motion.joints[..., 1].amin(dim=1) - one
    assert float(left[: 20 + round(LONGEST * FPS)].max()) > 0.25  # nobody knows yet
    assert float(left[50:135].max()) < 0.08
    # It neither drops nor jumps: slower than a body falls from there.
    assert float(one.diff().abs().max()) * FPS < math.sqrt(2 * GRAVITY * 0.3)
    assert float(one[-1]) < 0.05


def test_locks_set_down_and_take_up_again():
    motion = above(hover(112, 10, 112, 0.4))
    free = torch.zeros(112, 4, dtype=torch.bool)
    assert float(clearance(lock_feet(motion, contacts=free).joints)[20:].max()) < 0.08
    assert torch.equal(lock_feet(motion, 0.0, free).root, motion.root)

    def locked(again: bool) -> torch.Tensor:
        lock, done = FootLock(HML22, FPS), []
        for k in range(0, 112, 28):
            if again:
                lock = FootLock.from_state(HML22, FPS, json.loads(json.dumps(lock.state())))
            done.append(lock(motion[k : k + 28], free[k : k + 28]).joints)
        return torch.cat(done)

    assert torch.equal(locked(again=True), locked(again=False))
    assert float(clearance(locked(again=False))[40:].max()) < 0.08
