"""Seams and loops: nothing lost, nothing jumps, poses and speeds continue."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from moveset.data import bandai_namco
from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import foot_contacts
from moveset.motion.join import join, make_loop
from moveset.motion.retarget import retarget
from moveset.motion.rigs import get_rig
from moveset.motion.skeleton import HML22, KIT21
from tests.motions import gait, wander
from tests.takes import motion_of


def jerk(motion: Motion) -> torch.Tensor:
    """(F - 3,) mean over joints, m/s³."""
    return torch.diff(motion.joints.double(), n=3, dim=0).norm(dim=-1).mean(dim=-1) * motion.fps**3


def heading(motion: Motion, frame: int) -> torch.Tensor:
    return rotations.heading_angle(motion.rotations[frame, 0])


def yaw_gap(a: torch.Tensor, b: torch.Tensor) -> float:
    return torch.remainder(a - b + torch.pi, 2 * torch.pi).sub(torch.pi).abs().item()


def test_no_frame_is_added_or_lost():
    clips = [wander(30, 1), wander(41, 2), wander(25, 3)]
    assert len(join(clips)) == 96
    assert join(clips[:1]) is clips[0]


def test_nothing_changes_beyond_the_blend():
    a, b = wander(40, 4), wander(50, 5, turn=0.5)
    joined = join([a, b], 0.3)
    torch.testing.assert_close(joined.joints[:28], a.joints[:28], atol=1e-5, rtol=0)
    tail, expected = joined[52:], b[12:]
    torch.testing.assert_close(tail.canonical().joints, expected.canonical().joints, atol=1e-4, rtol=0)


def test_the_next_clip_goes_on_from_place_and_heading():
    a = gait(60).transformed(rotations.about("y", 75.0), torch.tensor([5.0, 0.0, -2.0]))
    b = gait(60).transformed(rotations.about("y", -160.0), torch.tensor([0.0, 0.0, 40.0]))
    joined = join([a, b])
    direction = rotations.rotate(rotations.about("y", 75.0), torch.tensor([0.0, 0.0, 1.0]))
    path = joined.root * torch.tensor([1.0, 0.0, 1.0])
    steps = torch.diff(path, dim=0)
    torch.testing.assert_close(steps, (0.05 * direction).expand(119, 3), atol=1e-3, rtol=0)
    for frame in (59, 60, 61, 119):
        assert yaw_gap(heading(joined, frame), torch.tensor(1.309)) < 0.02


@pytest.mark.parametrize("seed", range(5))
def test_a_seam_of_unlike_poses_is_gentle(seed):
    a, b = wander(50, 10 + seed, bend=0.2), wander(60, 20 + seed, bend=0.2)
    around = jerk(join([a, b]))[50 - 15 : 50 + 13]
    hard = jerk(join([a, b], 0.0))[47:50]
    assert around.max() < 0.06 * hard.max()


@pytest.mark.parametrize("skip", [3, 7, 10, 15])
def test_a_seam_within_a_walk_jerks_no_more_than_the_walk(skip):
    a, b = gait(60), gait(60 + skip)[skip:]
    joined = jerk(join([a, b]))
    assert joined.max() < 1.5 * jerk(a).max()
    assert joined.mean() < 1.1 * jerk(a).mean()


def test_clips_that_fit_already_stay_as_they_are():
    whole = gait(100)
    joined = join([whole[:55], whole[55:]])
    assert (joined.joints - whole.joints).norm(dim=-1).max() < 1e-3


def test_a_longer_blend_is_gentler():
    a, b = wander(80, 30), wander(80, 31)
    peaks = [jerk(join([a, b], seconds))[60:100].max().item() for seconds in (0.0, 0.1, 0.2, 0.4)]
    assert peaks == sorted(peaks, reverse=True)


OMEGA, SWING = math.pi / 10, 0.3  # of bobbing: radians a frame, metres
STEP = 2 * SWING * math.sin(OMEGA / 2)  # the fastest it gets, metres a frame
USUAL = STEP * (2 * math.sin(OMEGA / 2)) ** 2 * 2 / math.pi  # its mean jerk, metres a frame³


def bobbing(phases: torch.Tensor, height: float = 0.0) -> Motion:
    """A stiff body that goes up and down."""
    root = torch.zeros(len(phases), 3)
    root[:, 1] = 1.0 + height + SWING * torch.sin(phases)
    return Motion(rotations.identity(len(phases), len(HML22)), root, 20.0)


@pytest.mark.parametrize(
    ("gap", "kink", "frames"),
    [
        (8.5**3 * USUAL / 30, 0.0, 8),  # half of the way, in time T: 60 / T³ times half of it
        (10.5**3 * USUAL / 30, 0.0, 10),
        (0.0, 9.5**2 * USUAL / 18, 9),  # half of the speed: 36 / T² times half of it
        (0.0, 7.5**2 * USUAL / 18, 7),
        (0.0, 0.0, 0),  # goes on as it is
        (14**3 * USUAL / 30, 0.0, 12),  # not more than twice what was asked for
    ],
)
def test_a_blend_is_as_long_as_it_must_be_to_jerk_like_its_clips(gap, kink, frames):
    """Asked for six frames."""
    before = OMEGA * (torch.arange(-80, 0) + 0.5)
    if kink:
        # Down as it came up, from a phase before which it is that slow: no gap, and twice the speed to be lost.
        turned = math.acos(kink / (2 * STEP)) + OMEGA
        a = bobbing(turned + before)
        b = Motion(a.rotations, a.root.flip(0), a.fps)
    else:
        # On its way at its fastest: it would go on by a step of its own.
        a, b = bobbing(before), bobbing(-before.flip(0), height=gap - STEP if gap else 0.0)
    changed = (join([a, b], 0.3).root[:, 1] - torch.cat((a.root, b.root))[:, 1]).abs() > 1e-6
    assert changed[:80].sum() == changed[80:].sum() == frames
    assert changed[80 - frames : 80 + frames].all()


def test_short_clips_give_way_by_half_of_themselves():
    clips = [wander(n, 40 + n, bend=0.2) for n in (2, 3, 4, 9, 2)]
    joined = join(clips, 1.0)
    assert len(joined) == 20
    assert torch.isfinite(joined.joints).all()
    assert (torch.diff(joined.root, dim=0).norm(dim=-1)).max() < 0.2


def test_joining_is_independent_of_where_the_first_clip_stands():
    clips = [wander(30, 50), wander(30, 51)]
    turn, shift = rotations.about("y", 40.0), torch.tensor([1.0, 0.0, 2.0])
    moved = join([clips[0].transformed(turn, shift), clips[1]])
    torch.testing.assert_close(moved.joints, join(clips).transformed(turn, shift).joints, atol=1e-4, rtol=0)


def test_clips_of_one_body_are_joined_whatever_their_skeletons_are_called():
    a, b = wander(20, 55), wander(30, 56)
    joined = join([a, replace(b, skeleton=replace(HML22, name="run"))])
    assert joined.skeleton is HML22
    assert torch.equal(joined.joints, join([a, b]).joints)


@pytest.mark.parametrize("other", [replace(HML22, offsets=1.2 * HML22.offsets), replace(get_rig("vrm"), name="hml22")])
def test_clips_of_different_bodies_are_refused_whatever_their_skeletons_are_called(other):
    clips = [wander(9, 0), retarget(wander(9, 1), other)]
    with pytest.raises(InputError, match=r"clip 2 .* other joints or bones .*retarget\(clip, clips\[0\]\.skeleton\)"):
        join(clips)
    assert len(join([clips[0], retarget(clips[1], clips[0].skeleton)])) == 18


def twice(loop: Motion) -> Motion:
    """A loop played two times: the first frame of the second round is the last of the first."""
    turn = rotations.mul(
        rotations.heading(loop.rotations[-1, 0]), rotations.inv(rotations.heading(loop.rotations[0, 0]))
    )
    shift = (loop.root[-1] - rotations.rotate(turn, loop.root[0])) * torch.tensor([1.0, 0.0, 1.0])
    again = loop.transformed(turn, shift)[1:]
    return Motion(torch.cat((loop.rotations, again.rotations)), torch.cat((loop.root, again.root)), loop.fps)


@pytest.mark.parametrize("motion", [wander(60, 60), wander(60, 61, turn=0.8), gait(55), wander(5, 62)], ids=range(4))
def test_a_loop_ends_in_the_pose_it_starts_with(motion):
    loop = make_loop(motion)
    assert len(loop) == len(motion)
    gap = rotations.angle(rotations.mul(rotations.inv(loop.rotations[0, 1:]), loop.rotations[-1, 1:]))
    assert gap.max() < 2e-3

    def tilt(q):
        return rotations.mul(rotations.inv(rotations.heading(q)), q)

    first, last = tilt(loop.rotations[0, 0]), tilt(loop.rotations[-1, 0])
    assert rotations.angle(rotations.mul(rotations.inv(first), last)) < 2e-3
    assert (loop.root[0, 1] - loop.root[-1, 1]).abs() < 1e-5


def test_a_loop_runs_on_without_a_pop():
    for seed in range(4):
        motion = wander(60, 70 + seed, bend=0.2, turn=0.3)
        rounds = jerk(twice(make_loop(motion)))
        hard = jerk(twice(make_loop(motion, 0.0)))
        assert rounds[59 - 22 : 59 + 20].max() < 0.06 * hard.max()
        walk = gait(64)
        assert jerk(twice(make_loop(walk))).max() < 1.5 * jerk(walk).max()


def slides(motion: Motion, planted: torch.Tensor) -> int:
    """Frames in which a toe that is planted (F, 4) goes over the floor, faster than 0.5 m/s, and takes no step."""
    toes = motion.joints[:, [10, 11]]
    fast = torch.diff(toes, dim=0)[..., [0, 2]].norm(dim=-1) * motion.fps > 0.5
    down = planted[:, [1, 3]] & (toes[..., 1] < 0.02)
    return int((fast & down[1:] & down[:-1]).sum())


@pytest.mark.parametrize("frames", [52, 54, 57, 69, 75])
def test_a_walk_that_loops_keeps_its_feet_where_they_stand(frames, monkeypatch):
    """Cut anywhere in its stride: pose and speed of the ends differ, and the blend pulls legs along the floor."""
    walk = gait(frames)
    planted, held = foot_contacts(walk.joints, walk.fps, HML22), make_loop(walk)
    monkeypatch.setattr("moveset.motion.join.HINGES", {})
    bare = make_loop(walk)
    assert slides(walk, planted) == 0
    assert slides(bare, planted) >= 7
    assert slides(held, planted) < 0.5 * slides(bare, planted)


@pytest.mark.parametrize("skeleton", [HML22, KIT21], ids=lambda s: s.name)
@pytest.mark.parametrize("frames", [54, 69])
def test_no_foot_is_lower_in_a_loop_than_in_its_clip_or_the_floor(frames, skeleton):
    walk = retarget(gait(frames), skeleton)
    lowest, own = (m.joints[:, list(skeleton.feet), 1].min() for m in (make_loop(walk), walk))
    assert lowest > own.clamp(max=0.0) - 1e-3


def test_a_loop_is_not_lifted_onto_a_floor_that_is_not_its_own():
    down = torch.tensor([0.0, -0.8, 0.0])
    walk = gait(57)
    deep = make_loop(walk.transformed(rotations.identity(), down))
    torch.testing.assert_close(deep.joints, make_loop(walk).joints + down, atol=2e-3, rtol=0)


def test_a_loop_on_any_skeleton_closes_whatever_it_is_called():
    for body in (get_rig("mixamo"), replace(get_rig("vrm"), name="hml22")):
        loop = make_loop(retarget(gait(57), body))
        apart = rotations.angle(rotations.mul(rotations.inv(loop.rotations[0, 1:]), loop.rotations[-1, 1:]))
        assert apart.max() < 2e-3


def test_a_loop_changes_nothing_in_its_middle():
    motion = wander(60, 80)
    torch.testing.assert_close(make_loop(motion, 0.5).joints[21:39], motion.joints[21:39], atol=1e-5, rtol=0)
    walk = gait(117)
    torch.testing.assert_close(make_loop(walk, 0.5).joints[41:76], walk.joints[41:76], atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: join([]), "0 clips"),
        (lambda: join([wander(5, 0)], -1.0), "-1.0 s"),
        (lambda: join([wander(5, 0), wander(5, 0, fps=30.0)]), "one frame rate"),
        (lambda: join([wander(5, 0), wander(5, 0, KIT21)]), "one skeleton"),
        (lambda: join([wander(5, 0), wander(1, 0)]), "at least 2 frames"),
        (lambda: make_loop(wander(3, 0)), "got 3"),
        (lambda: make_loop(wander(9, 0), -0.5), "-0.5 s"),
        *((lambda s=s: join([wander(9, 0), wander(9, 1)], s), f"{s} s") for s in (float("nan"), float("inf"))),
        *((lambda s=s: make_loop(wander(9, 0), s), f"{s} s") for s in (float("nan"), float("inf"))),
    ],
)
def test_bad_requests_are_named(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_real_takes_join_without_a_pop(real_data):
    takes = [motion_of(r) for r in bandai_namco.list_takes(real_data)[:6]]
    takes = [motion for motion in takes if len(motion) >= 30]
    for a, b in pairwise(takes):
        around = jerk(join([a, b]))[len(a) - 15 : len(a) + 13]
        hard = jerk(join([a, b], 0.0))[len(a) - 3 : len(a)]
        assert around.max() < max(0.25 * hard.max(), 1.2 * jerk(a).max(), 1.2 * jerk(b).max())
