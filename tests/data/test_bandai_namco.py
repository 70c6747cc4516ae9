import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from moveset.data import bandai_namco
from moveset.data.resample import resampled
from moveset.errors import FormatError, InputError
from moveset.io.bvh import local_frames
from moveset.io.bvh_parser import read_bvh
from moveset.motion import rotations
from moveset.motion.skeleton import HML22
from tests.takes import motion_of


@pytest.fixture(scope="module")
def refs(real_data):
    return {ref.name: ref for ref in bandai_namco.list_takes(real_data)}


@pytest.fixture(scope="module")
def takes(refs):
    names = [
        "dataset-1_walk-back_normal_001",
        "dataset-1_bow_active_001",
        "dataset-2_walk_active_002",
        "dataset-2_walk-turn-left_normal_001",
        "dataset-2_walk-turn-right_normal_002",
        "dataset-2_wave-left-hand_normal_001",
    ]
    return {name: motion_of(refs[name]) for name in names}


def test_what_a_take_says_about_itself(refs):
    ref = refs["dataset-2_walk-turn-left_normal_001"]
    assert (ref.content, ref.style, ref.source) == ("walk-turn-left", "normal", "bandai2")
    assert refs["dataset-1_bow_active_001"].source == "bandai1"


def test_every_take_is_canonical_and_stands_on_the_floor(takes):
    for motion in takes.values():
        assert motion.skeleton is HML22
        assert motion.fps == 20.0
        assert motion.root[0, [0, 2]].abs().max() < 1e-5
        assert rotations.heading_angle(motion.rotations[0, 0]).abs() < 1e-4
        lowest = motion.joints[:, [7, 8, 10, 11], 1].amin(dim=1)
        assert torch.quantile(lowest, 0.01).abs() < 1e-4
        assert motion.joints[..., 1].min() > -0.012
        # Left is +x.
        assert motion.joints[0, HML22.index("left_hip"), 0] > 0.03
        assert motion.joints[0, HML22.index("left_shoulder"), 0] > 0.1
    for name in ("dataset-2_walk_active_002", "dataset-2_wave-left-hand_normal_001"):
        assert takes[name].joints[0, HML22.index("left_wrist"), 0] > 0.1
        assert 0.90 < takes[name].root[:, 1].median() < 0.97


def test_turns_go_the_way_their_label_says(takes):
    for side, sign in (("left_normal_001", 1), ("right_normal_002", -1)):
        motion = takes[f"dataset-2_walk-turn-{side}"]
        heading = np.unwrap(rotations.heading_angle(motion.rotations[:, 0]).numpy())
        assert math.degrees(heading[-1] - heading[0]) * sign == pytest.approx(93.0, abs=15.0)


def test_a_loop_whose_travel_sits_in_the_outermost_joint_goes_backwards(takes):
    motion = takes["dataset-1_walk-back_normal_001"]
    assert -1.4 < motion.root[-1, 2] < -1.0
    assert motion.root[-1, 0].abs() < 0.2


def test_the_left_wrist_is_the_one_that_waves(takes):
    joints = takes["dataset-2_wave-left-hand_normal_001"].joints
    assert joints[:, HML22.index("left_wrist"), 1].max() > joints[:, HML22.index("left_shoulder"), 1].max()
    assert (joints[:, HML22.index("right_wrist"), 1] < joints[:, HML22.index("right_shoulder"), 1]).all()


def test_limbs_point_where_the_capture_has_them(refs, takes):
    """Every second frame at 20 fps is every third of the capture at 30 fps."""
    limbs = {
        ("left_hip", "left_knee"): ("UpperLeg_L", "LowerLeg_L"),
        ("left_knee", "left_ankle"): ("LowerLeg_L", "Foot_L"),
        ("right_hip", "right_knee"): ("UpperLeg_R", "LowerLeg_R"),
        ("right_knee", "right_ankle"): ("LowerLeg_R", "Foot_R"),
        ("left_shoulder", "left_elbow"): ("UpperArm_L", "LowerArm_L"),
        ("left_elbow", "left_wrist"): ("LowerArm_L", "Hand_L"),
        ("right_shoulder", "right_elbow"): ("UpperArm_R", "LowerArm_R"),
        ("right_elbow", "right_wrist"): ("LowerArm_R", "Hand_R"),
    }
    for name in ("dataset-2_walk_active_002", "dataset-1_bow_active_001"):
        frames = local_frames(read_bvh(refs[name].path), root="Hips")
        theirs = frames.world()[1][::3]
        ours = takes[name].joints[::2].double()
        count = min(len(ours), len(theirs))

        def bone(places, a, b, count=count):
            direction = places[:count, b] - places[:count, a]
            return direction / direction.norm(dim=-1, keepdim=True)

        mine, source = [], []
        for (a, b), (c, d) in limbs.items():
            mine.append(bone(ours, HML22.index(a), HML22.index(b)))
            source.append(bone(theirs, frames.joints.index(c), frames.joints.index(d)))
        mine, source = torch.stack(mine), torch.stack(source)
        # The clip was turned to face +z: one yaw for all of it.
        cross = (source[..., 2] * mine[..., 0] - source[..., 0] * mine[..., 2]).sum()
        angle = torch.atan2(cross, (source[..., 0] * mine[..., 0] + source[..., 2] * mine[..., 2]).sum())
        turned = rotations.rotate(rotations.yaw(angle), source)
        error = torch.rad2deg(torch.linalg.vector_norm(turned - mine, dim=-1))
        assert error.mean() < 0.1
        assert error.max() < 0.5


def test_knees_and_elbows_are_hinges(takes):
    motion = takes["dataset-2_walk_active_002"]
    for side, out in (("left", 1.0), ("right", -1.0)):
        knee = motion.rotations[:, HML22.index(f"{side}_knee")]
        knee = knee * torch.where(knee[:, 3:] < 0, -1.0, 1.0)
        # Flexion brings the heel back: a positive turn about x, and nothing else.
        assert torch.rad2deg(2 * knee[:, 1:3].norm(dim=-1).asin()).max() < 1.5
        assert (knee[:, 0] > -0.05).all()
        forearm = rotations.rotate(motion.rotations[:, HML22.index(f"{side}_elbow")], torch.tensor([out, 0.0, 0.0]))
        bent = forearm[:, 0] * out < math.cos(math.radians(10))
        assert bent.any()
        azimuth = torch.rad2deg(torch.atan2(forearm[bent, 1], forearm[bent, 2]))
        assert azimuth.abs().max() < 1.0


def test_resampling_does_not_ripple():
    """A swing at 30 fps, resampled, is the same swing at 20 fps; slerp is off by ten times as much."""
    time = torch.arange(60, dtype=torch.float64) / 30

    def swing(t):
        return 60 * torch.sin(2 * math.pi * 1.5 * t)

    turned = rotations.about("x", swing(time))[:, None]
    root = torch.stack((swing(time), 0 * time, time), dim=-1)
    truth = torch.arange(40, dtype=torch.float64) / 20
    new, path = resampled(turned, root, time, truth)
    assert (path[:, 0] - swing(truth)).abs()[2:-2].max() < 0.05
    error = rotations.angle(rotations.mul(rotations.inv(rotations.about("x", swing(truth))), new[:, 0]))
    assert torch.rad2deg(error)[2:-2].max() < 0.05
    middle = rotations.slerp(turned[1:-1:3], turned[2::3], 0.5)[:, 0]
    slerp_error = rotations.angle(rotations.mul(rotations.inv(rotations.about("x", swing(truth[1::2]))), middle))
    assert torch.rad2deg(slerp_error).max() > 0.5


def test_files_of_another_kind_are_refused(refs, tmp_path):
    ref = refs["dataset-1_walk-back_normal_001"]
    renamed = tmp_path / "other.bvh"
    renamed.write_bytes(ref.path.read_bytes().replace(b"UpperArm_L", b"Arm_L"))
    with pytest.raises(FormatError, match="no joint 'UpperArm_L'"):
        bandai_namco.read_take(replace(ref, path=renamed))
    with pytest.raises(InputError, match="holds no dataset-1"):
        bandai_namco.list_takes(tmp_path)
    (tmp_path / "dataset-1" / "data").mkdir(parents=True)
    (tmp_path / "dataset-1" / "data" / "walk.bvh").write_bytes(b"")
    with pytest.raises(InputError, match="is not named"):
        bandai_namco.list_takes(tmp_path)
