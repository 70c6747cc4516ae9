"""A body that does nothing: its arms hang, and nothing but an arm is another."""

from dataclasses import replace

import pytest
import torch

from moveset.data.synthetic import synthetic_motion
from moveset.motion import rotations
from moveset.motion.features import get_codec
from moveset.motion.native import NativeCodec
from moveset.motion.retarget import retarget
from moveset.motion.standing import Stand

NATIVE = NativeCodec()


def features(kind, frames=100):
    return NATIVE.encode(synthetic_motion(kind, frames))


def height(x, joint):
    """Metres (F,) of a joint above the hips."""
    motion = NATIVE.decode(x)
    return motion.joints[:, motion.skeleton.index(joint), 1] - motion.joints[:, 0, 1]


def test_whoever_waves_and_stands_does_nothing():
    x = features("wave-left-hand")
    still = Stand().clip(x, NATIVE)
    assert float(height(x, "left_wrist").max()) > 0.3
    assert float(height(still, "left_wrist").max()) < 0.1
    right = Stand(waves="right").clip(features("wave-right-hand"), NATIVE)
    assert float(height(right, "right_wrist").max()) < 0.1


def test_nothing_below_the_spine_is_another():
    x = leaning()
    still = Stand().clip(x, NATIVE)
    first, index = NATIVE.groups["rotations"].start, NATIVE.skeleton.index
    touched = [index(f"left_{joint}") for joint in ("collar", "shoulder", "elbow", "wrist")]
    touched += [index(joint) for joint in ("spine1", "spine2", "spine3", "neck", "head", "right_shoulder")]
    columns = {first + 6 * joint + k for joint in touched for k in range(6)}
    assert set((still != x).any(dim=0).nonzero().flatten().tolist()) <= columns
    moved = NATIVE.decode(still).joints - NATIVE.decode(x).joints
    legs = [k for k, name in enumerate(NATIVE.skeleton.joints) if name.endswith(("hip", "knee", "ankle", "foot"))]
    assert float(moved[:, legs].abs().max()) < 1e-5


def leaning(frames=100):
    """Whoever waves leans to the other side, and forward; the arm that does not wave hangs down all the same."""
    motion = synthetic_motion("wave-left-hand", frames)
    index, turned = motion.skeleton.index, motion.rotations.clone()
    side, ahead = rotations.about("z", -15.0).float(), rotations.about("x", 10.0).float()
    for joint, lean in (("spine2", side), ("spine1", ahead)):
        turned[:, index(joint)] = rotations.mul(lean, turned[:, index(joint)])
    return NATIVE.encode(replace(motion, rotations=turned))


def test_nobody_leans_away_from_an_arm_that_hangs():
    x = leaning()
    bent, still = NATIVE.decode(x).joints, NATIVE.decode(Stand().clip(x, NATIVE)).joints
    neck, wrists = NATIVE.skeleton.index("neck"), [NATIVE.skeleton.index(f"{s}_wrist") for s in ("left", "right")]
    assert float(bent[:, neck, 0].abs().min()) > 0.05
    assert float(still[:, neck, 0].abs().max()) < 0.005
    assert torch.allclose(still[:, neck, 2], bent[:, neck, 2], atol=0.02)  # and as far forward
    sides = still[:, wrists, 0]
    assert torch.allclose(sides[:, 0], -sides[:, 1], atol=0.01)
    shoulders = [NATIVE.skeleton.index(f"{s}_shoulder") for s in ("left", "right")]
    arm = bent[:, wrists[1]] - bent[:, shoulders[1]]
    assert torch.allclose(still[:, wrists[1]] - still[:, shoulders[1]], arm, atol=1e-4)  # hangs in the world as it did


def test_the_arm_hangs_as_the_other_one_a_moment_ago():
    x = features("wave-left-hand")
    x[:, NATIVE.groups["rotations"]] += 0.05 * torch.sin(torch.arange(100) * 0.2)[:, None]  # so that it sways
    still = NATIVE.decode(Stand().clip(x, NATIVE)).rotations
    left, right = (NATIVE.skeleton.index(f"{side}_elbow") for side in ("left", "right"))
    mirrored = still[:, right] * torch.tensor((1.0, -1.0, -1.0, 1.0))
    assert torch.allclose(still[8:, left], mirrored[:-8], atol=1e-5)
    assert torch.allclose(still[:8, left], mirrored[:1].expand(8, -1), atol=1e-5)


@pytest.mark.parametrize("walk_first", [True, False])
def test_on_his_way_he_swings_his_arms_as_he_did(walk_first):
    walk, wave = features("walk"), features("wave-left-hand")
    x = torch.cat((walk, wave) if walk_first else (wave, walk))
    still = Stand().clip(x, NATIVE)
    changed = (still - x).abs().amax(dim=1)
    walks, stands = (slice(0, 84), slice(100, 200)) if walk_first else (slice(116, 200), slice(0, 100))
    assert float(changed[walks].max()) == 0.0
    assert float(height(still, "left_wrist")[stands].max()) < 0.1
    # Within a second, and not at once.
    blend = changed[85:115]
    assert float((still - x)[85:115].diff(dim=0).abs().max()) < 0.5 * float(blend.max())


def test_slow_walkers_walk_and_pieces_are_treated_alike():
    slow = NATIVE.encode(synthetic_motion("walk", 100, speed=0.45))
    assert torch.equal(Stand().clip(slow, NATIVE), slow)
    x = features("wave-left-hand")
    assert torch.equal(Stand().piece(x, NATIVE, 0.0), Stand().clip(x, NATIVE))


@pytest.mark.parametrize("name", ["hml", "kit"])
def test_features_that_decode_by_positions_have_an_arm_that_hangs_as_well(name):
    codec = get_codec(name)
    motion = synthetic_motion("wave-left-hand", 60, fps=codec.fps)
    x = codec.encode(retarget(motion, codec.skeleton) if name == "kit" else motion)
    still = Stand().clip(x, codec)
    before, after = codec.joints(x), codec.joints(still)
    wrist, other = (codec.skeleton.index(f"{side}_wrist") for side in ("left", "right"))
    assert float((before[:, wrist, 1] - before[:, 0, 1]).max()) > 0.3
    assert torch.allclose(after[8:, wrist, 1], after[:-8, other, 1], atol=1e-5)
    hip = after[:, 0]
    to_left, to_right = ((after[20:, joint] - hip[20:]).norm(dim=-1) for joint in (wrist, other))
    assert torch.allclose(to_left, to_right, atol=0.05)
    assert float((after[:, wrist] - after[:, other]).norm(dim=-1).min()) > 0.2  # not on the other side's
    arm = [codec.skeleton.index(f"left_{joint}") for joint in ("shoulder", "elbow", "wrist")]
    if "left_collar" in codec.skeleton.joints:
        arm.append(codec.skeleton.index("left_collar"))
    rest = [joint for joint in range(len(codec.skeleton)) if joint not in arm]
    assert torch.equal(after[:, rest], before[:, rest])
