"""What is done to finished motion: a loop stays closed at whatever frame rate."""

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.pipelines.postprocess import Postprocess
from tests.motions import gait, wander


def gap(loop: Motion) -> float:
    """Radians by which the last pose differs from the first, the way over the floor and its heading aside."""
    first, last = loop.canonical(), loop[len(loop) - 1 :].canonical()
    return float(rotations.angle(rotations.mul(rotations.inv(first.rotations[0]), last.rotations[0])).max())


@pytest.mark.parametrize("fps", [None, 12.0, 24.0, 25.0, 29.97, 30.0, 60.0, 240.0])
@pytest.mark.parametrize("frames", [4, 40, 41, 59, 60])
def test_a_loop_is_closed_at_every_frame_rate(frames, fps):
    loop = Postprocess(fps=fps, loop=True)(wander(frames, seed=frames, bend=0.5, turn=0.5))
    assert gap(loop) < 2e-3
    assert abs(float(loop.root[-1, 1] - loop.root[0, 1])) < 1e-5
    # As long as it was, to half of a frame of the new rate.
    assert abs((len(loop) - 1) / loop.fps - (frames - 1) / 20.0) <= 0.5 / loop.fps + 1e-9
    assert loop.fps == (fps or 20.0)


def test_a_loop_at_another_rate_passes_through_the_same_poses():
    walk = gait(41)
    slow, fast = Postprocess(loop=True)(walk), Postprocess(fps=40.0, loop=True)(walk)
    torch.testing.assert_close(fast.joints[::2], slow.joints, atol=1e-4, rtol=0)


@pytest.mark.parametrize("fps", [None, 30.0])
def test_a_loop_in_place_ends_where_and_as_it_began(fps):
    turning = wander(60, seed=2, bend=0.5, turn=1.0)
    ends = [float(rotations.heading_angle(turning.rotations[k, 0])) for k in (0, -1)]
    assert abs(ends[1] - ends[0]) > 0.2
    loop = Postprocess(fps=fps, loop=True, in_place=True)(turning)
    torch.testing.assert_close(loop.joints[-1], loop.joints[0], atol=2e-3, rtol=0)


def test_a_loop_too_short_for_its_rate_keeps_its_ends():
    loop = Postprocess(fps=1.0, loop=True)(wander(4, seed=1))
    assert (len(loop), loop.fps) == (2, 1.0)
    assert gap(loop) < 2e-3


def test_without_a_loop_nothing_is_stretched():
    motion = wander(60, seed=3)
    assert len(Postprocess(fps=30.0)(motion)) == 89
    torch.testing.assert_close(Postprocess(fps=40.0)(motion).joints[::2], motion.joints, atol=1e-4, rtol=0)
