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


def test_longest_clean_run():
    assert glitches.longest_clean_run(torch.zeros(7, dtype=torch.bool)) == (0, 7)
    assert glitches.longest_clean_run(torch.ones(7, dtype=torch.bool)) == (0, 0)
    assert glitches.longest_clean_run(torch.tensor([0, 0, 1, 0, 0, 0, 1, 0]).bool()) == (3, 6)


@pytest.mark.parametrize(("side", "out"), [("left", 1.0), ("right", -1.0)])
def test_elbows_that_bend_backwards_are_told_from_those_that_flex(side, out):
    local, _ = swing()
    j = HML22.index(f"{side}_elbow")
    # The left forearm points to +x and flexes towards +z: a turn of minus 90 degrees about y.
    local[:, j] = rotations.about("y", torch.tensor(-90.0 * out).double())
    assert glitches.backward_elbow(local) == 0.0
    local[:20, j] = rotations.about("y", torch.tensor(90.0 * out).double())
    assert glitches.backward_elbow(local) == pytest.approx(0.25)
    # Twist of the forearm is no bend.
    local[:, j] = rotations.about("x", torch.tensor(170.0).double())
    assert glitches.backward_elbow(local) == 0.0


def test_a_head_that_is_turned_round():
    local, root = swing()
    local[10:20, HML22.index("neck")] = rotations.about("y", torch.tensor(140.0).double())
    local[30:40, HML22.index("neck")] = rotations.about("y", torch.tensor(80.0).double())
    turned = glitches.turned_head(fk(local, root, HML22)[0])
    assert turned.nonzero()[:, 0].tolist() == list(range(10, 20))


def test_limbs_that_no_one_can_hold_so():
    local, _ = swing()
    ankle, elbow = HML22.index("left_ankle"), HML22.index("right_elbow")
    local[10:15, ankle] = rotations.about("z", torch.tensor(170.0).double())
    local[20:25, ankle] = rotations.about("x", torch.tensor(80.0).double())
    local[30:35, elbow] = rotations.about("x", torch.tensor(-150.0).double())
    # Flexion is no twist, and 100 degrees of pronation can be done.
    local[40:45, elbow] = rotations.about("y", torch.tensor(140.0).double())
    local[50:55, elbow] = -rotations.about("x", torch.tensor(100.0).double())
    bad = glitches.impossible_posture(local).nonzero()[:, 0].tolist()
    assert bad == [*range(10, 15), *range(30, 35)]
