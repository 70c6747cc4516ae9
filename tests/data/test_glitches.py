import math

import pytest
import torch

from moveset.data import glitches
from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22

FPS = 20.0


def swing(frames=80):
    """Arms swinging while the body walks at 1.2 m/s."""
    time = torch.arange(frames, dtype=torch.float64) / FPS
    local = torch.zeros(frames, len(HML22), 4, dtype=torch.float64)
    local[..., 3] = 1.0
    for joint in ("left_shoulder", "right_shoulder"):
        local[:, HML22.index(joint)] = rotations.about("y", 30 * torch.sin(2 * math.pi * time))
    root = torch.stack((0 * time, 0 * time + 0.94, 1.2 * time), dim=-1)
    return local, root


def mask(local, root):
    return glitches.glitch_mask(local, root, fk(local, root, HML22)[1], FPS)


def test_ordinary_motion_has_no_glitch():
    assert not mask(*swing()).any()


@pytest.mark.parametrize("joint", ["left_knee", "spine1", "left_elbow"])
def test_a_flip_is_found_with_its_surroundings(joint):
    local, root = swing()
    j = HML22.index(joint)
    local[40:50, j] = rotations.mul(local[40:50, j], rotations.about("y", torch.tensor(120.0).double()))
    bad = mask(local, root)
    # The jumps are between frames 39 and 40, and 49 and 50.
    assert bad[36:44].all()
    assert bad[46:54].all()
    assert not bad[:35].any()
    assert not bad[55:].any()


def test_a_flip_smoothed_over_frames_is_found():
    local, root = swing()
    j = HML22.index("left_knee")
    angle = torch.zeros(len(root), dtype=torch.float64)
    angle[40:] = 180.0
    angle[38:41] = torch.tensor([60.0, 120.0, 180.0])
    local[:, j] = rotations.about("y", angle)
    assert float(glitches.steps(local)[:, j].max()) < glitches.MAX_STEP
    assert mask(local, root)[36:42].all()


def test_a_flipping_wrist_is_no_glitch_and_is_held_straight():
    local, root = swing()
    left, right = HML22.index("left_wrist"), HML22.index("right_wrist")
    local[:, left] = rotations.about("x", 20 * torch.sin(torch.arange(len(root)).double() / 5))
    local[40:, right] = rotations.about("y", torch.tensor(170.0).double())
    assert not mask(local, root).any()
    calm = glitches.calm_wrists(local)
    assert torch.equal(calm[:, left], local[:, left])
    assert (rotations.angle(calm[:, right]) == 0).all()
    assert torch.equal(fk(calm, root, HML22)[1], fk(local, root, HML22)[1])


@pytest.mark.parametrize("jump", [0.4, 0.9])
def test_a_body_that_hops_is_found(jump):
    local, root = swing()
    root[40:, 0] += jump
    assert mask(local, root)[36:44].all()


def test_a_flip_of_one_joint_is_mended_and_the_rest_left_alone():
    local, root = swing()
    broken = local.clone()
    knee, hip, ankle = (HML22.index(f"left_{part}") for part in ("knee", "hip", "ankle"))
    broken[40:46, knee] = rotations.mul(broken[40:46, knee], rotations.about("y", torch.tensor(170.0).double()))
    broken[:10, ankle] = rotations.about("z", torch.tensor(175.0).double())
    # A hip that turns and stays so has moved.
    broken[60:, hip] = rotations.about("y", torch.tensor(120.0).double())
    mended = glitches.mended(broken, FPS)
    assert float(rotations.angle(rotations.mul(rotations.inv(local), mended))[:55].max()) < 1e-3
    assert torch.allclose(mended[55:], broken[55:])
    assert not mask(mended[:55], root[:55]).any()
    assert torch.allclose(glitches.mended(local, FPS), local)


def test_captures_are_split_where_the_whole_body_jumps():
    _, root = swing()
    root[40:, 2] += 1.0
    assert glitches.whole_body_jumps(root, FPS) == [(0, 40), (40, 80)]


@pytest.mark.parametrize(("side", "out"), [("left", 1.0), ("right", -1.0)])
def test_elbows_that_bend_backwards_are_told_from_those_that_flex(side, out):
    local, root = swing()
    j = HML22.index(f"{side}_elbow")
    # The left forearm points to +x and flexes towards +z: a turn of minus 90 degrees about y.
    local[:, j] = rotations.about("y", torch.tensor(-90.0 * out).double())
    assert torch.equal(glitches.faced_elbows(local), local)
    local[:, j] = rotations.about("y", torch.tensor(90.0 * out).double())
    faced = glitches.faced_elbows(local)
    assert not torch.equal(faced, local)
    assert torch.allclose(fk(faced, root, HML22)[1], fk(local, root, HML22)[1], atol=1e-6)
    # Twist of the forearm is no bend.
    local[:, j] = rotations.about("x", torch.tensor(170.0).double())
    assert torch.equal(glitches.faced_elbows(local), local)


def test_a_head_that_is_turned_round():
    local, root = swing()
    local[10:20, HML22.index("neck")] = rotations.about("y", torch.tensor(140.0).double())
    local[30:40, HML22.index("neck")] = rotations.about("y", torch.tensor(80.0).double())
    turned = glitches.turned_head(fk(local, root, HML22)[0])
    assert turned.nonzero()[:, 0].tolist() == list(range(10, 20))


def test_feet_that_no_one_can_hold_so():
    local, _ = swing()
    ankle = HML22.index("left_ankle")
    local[10:15, ankle] = rotations.about("z", torch.tensor(170.0).double())
    local[20:25, ankle] = rotations.about("x", torch.tensor(80.0).double())
    assert glitches.impossible_foot(local).nonzero()[:, 0].tolist() == list(range(10, 15))
