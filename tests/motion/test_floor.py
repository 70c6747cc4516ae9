"""Nobody is in the floor: legs that stand are left alone, who is down comes out of it, each limb by itself."""

from dataclasses import replace

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import leg_share
from moveset.motion.floor import above_floor
from moveset.motion.skeleton import HML22, KIT21, Skeleton
from tests.motions import gait, standing, wander

ELBOW, WRIST = HML22.index("right_elbow"), HML22.index("right_wrist")


def on_all_fours(frames: int, skeleton: Skeleton = HML22) -> Motion:
    """Trunk level, arms and nearly thighs straight down, shins level."""
    turned = rotations.identity(frames, len(skeleton)).clone()
    turned[:, 0] = rotations.about("x", torch.tensor(90.0))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        turned[:, skeleton.index(f"{side}_hip")] = rotations.about("x", torch.tensor(-80.0))
        turned[:, skeleton.index(f"{side}_knee")] = rotations.about("x", torch.tensor(80.0))
        turned[:, skeleton.index(f"{side}_shoulder")] = rotations.about("y", torch.tensor(90.0 * sign))
    low = Motion(turned, torch.zeros(frames, 3), 20.0, skeleton)
    return moved(low, 0.05 - low.joints[..., 1].amin())


def moved(motion: Motion, height: torch.Tensor | float) -> Motion:
    """Higher by (F,) or as many metres throughout."""
    up = torch.zeros_like(motion.root)
    up[:, 1] = torch.as_tensor(height)
    return replace(motion, root=motion.root + up)


def sinking(frames: int = 30, skeleton: Skeleton = HML22) -> Motion:
    """On all fours, and deeper in the floor frame by frame."""
    return moved(on_all_fours(frames, skeleton), -torch.linspace(0.0, 0.3, frames))


@pytest.mark.parametrize("motion", [gait(60), standing(5), on_all_fours(5)], ids=["walks", "stands", "on all fours"])
def test_who_is_on_the_floor_stays_bit_for_bit(motion):
    assert above_floor(motion) is motion


@pytest.mark.parametrize("motion", [moved(gait(60), -0.2), moved(standing(5), -0.3)], ids=["walks", "stands"])
def test_who_stands_in_the_floor_is_for_the_feet_to_mend(motion):
    assert above_floor(motion) is motion


@pytest.mark.parametrize("skeleton", [HML22, KIT21], ids=lambda skeleton: skeleton.name)
@pytest.mark.parametrize("pose", ["all fours", "any"])
def test_who_is_down_comes_out(skeleton, pose):
    if pose == "any":  # lies on the belly, with all joints somewhere
        limp = wander(60, 3, skeleton, bend=0.5)
        lying = rotations.mul(rotations.about("x", torch.linspace(60.0, 120.0, 60)), limp.rotations[:, 0])
        limp = replace(limp, rotations=torch.cat((lying[:, None], limp.rotations[:, 1:]), dim=1))
        motion = moved(limp, -limp.root[:, 1])
        assert motion.joints[..., 1].min() < -0.2
    else:
        motion = sinking(30, skeleton)
    out = above_floor(motion)
    down = leg_share(motion.joints, skeleton) < 0.5
    assert down.sum() > 10
    assert out.joints[down, :, 1].min() > -1e-5
    deep = (-motion.joints[..., 1].amin(dim=1)).clamp_min(0.0)
    assert ((out.root - motion.root)[:, 1] <= deep + 0.02).all()
    assert torch.equal(out.root[:, [0, 2]], motion.root[:, [0, 2]])
    assert (out.rotations.norm(dim=-1) - 1).abs().max() < 1e-5
    assert (out.skeleton, out.fps, len(out)) == (motion.skeleton, motion.fps, len(motion))


def test_limbs_bend_and_nothing_else_moves():
    motion = moved(on_all_fours(1), -0.12)  # trunk, knees and ankles are above the floor, hands and toes in it
    raised = motion.rotations.clone()
    left = HML22.index("left_shoulder")
    raised[:, left] = rotations.about("y", torch.tensor(-30.0))
    motion = replace(motion, rotations=raised)
    low = motion.joints[0, :, 1] < 0.02
    assert [name for name, deep in zip(HML22.joints, low, strict=True) if deep] == [
        "left_foot", "right_foot", "right_wrist",
    ]  # fmt: skip
    out = above_floor(motion)
    assert torch.equal(out.root, motion.root)
    shift = (out.joints - motion.joints)[0]
    still = [k for k in range(len(HML22)) if k not in (*HML22.feet, ELBOW, WRIST)]
    assert shift[still].abs().max() < 1e-6
    assert shift[[left, left + 2, left + 4]].abs().max() < 1e-6
    assert shift[WRIST, [0, 2]].abs().max() < 1e-3  # the hand rises where it is
    bend = rotations.mul(rotations.inv(motion.rotations[0, ELBOW]), out.rotations[0, ELBOW])
    assert rotations.to_rotvec(bend)[1] > 0.3  # forward, as elbows do


def test_who_stands_and_reaches_into_the_floor_does_not_with_the_legs():
    upright = standing(1)
    turned = upright.rotations.clone()
    turned[:, HML22.index("spine1")] = rotations.about("x", torch.tensor(150.0))
    for side, up in (("left", 75.0), ("right", -75.0)):
        turned[:, HML22.index(f"{side}_shoulder")] = rotations.about("z", torch.tensor(up))
    bowed = replace(upright, rotations=turned)
    motion = moved(bowed, -0.1 - bowed.joints[0, WRIST, 1])
    out = above_floor(motion)
    assert out.joints[0, [WRIST - 1, WRIST], 1].min() > -1e-5
    assert torch.equal(out.root, motion.root)
    legs = [k for k, name in enumerate(HML22.joints) if name.endswith(("knee", "ankle", "foot"))]
    assert torch.allclose(out.rotations[:, legs], motion.rotations[:, legs], atol=1e-6)


def test_each_frame_is_by_itself():
    motion = sinking()
    motion = replace(motion, rotations=motion.rotations.double(), root=motion.root.double())
    before = motion.joints.clone()
    whole = above_floor(motion)
    assert torch.equal(motion.joints, before)
    parts = [above_floor(motion[k : k + 7]) for k in range(0, len(motion), 7)]
    assert torch.equal(torch.cat([part.root for part in parts]), whole.root)
    assert (torch.cat([part.joints for part in parts]) - whole.joints).abs().max() < 1e-6


def test_sinking_comes_on_smoothly():
    """What is near the floor is held back already."""
    motion = moved(on_all_fours(300), -torch.linspace(0.0, 0.3, 300))
    assert above_floor(motion).joints.diff(dim=0).norm(dim=-1).max() < 0.01  # straight elbows begin to bend fast
