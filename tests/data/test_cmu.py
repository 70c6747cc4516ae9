import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from moveset.data import cmu
from moveset.data.takes import RejectedTake
from moveset.errors import FormatError, InputError
from moveset.io.bvh import read_bvh
from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22


@pytest.fixture(scope="module")
def refs(real_data):
    return {ref.name: ref for ref in cmu.list_takes(real_data / "cmu")}


def test_the_list_prefers_amc_and_says_what_to_leave_out(refs):
    assert len(refs) == 218
    assert sum(ref.source == "cmu-amc" for ref in refs.values()) == 83
    assert refs["02_01"].source == "cmu-amc"
    assert refs["02_01"].path.suffix == ".amc"
    assert refs["06_10"].source == "cmu-bvh"
    assert sum(len(ref.sentences) for ref in refs.values()) == 39
    assert refs["60_01"].subject == refs["61_01"].subject
    assert refs["60_01"].fps == 60
    left_out = {name for name, ref in refs.items() if ref.leave_out}
    assert {"01_02", "03_02", "13_01", "13_33", "13_35", "14_29", "14_36"} <= left_out
    assert not {"01_01", "02_01", "13_10", "94_04"} & left_out
    with pytest.raises(RejectedTake, match="support"):
        cmu.read_take(refs["13_33"])


@pytest.mark.parametrize(
    ("trial", "mean", "median", "path"),
    [("02_07", 8, 6, 20), ("02_04", 9.5, 6, 35), ("02_01", 16, 9, 50), ("01_08", 17, 13, 50)],
)
def test_both_forms_of_a_take_agree(refs, trial, mean, median, path):
    """The AMC and the BVH of one take, read by different code and calibrated apart, in millimetres."""
    amc = refs[trial]
    bvh = replace(amc, skeleton=None, path=amc.path.with_suffix(".bvh"))
    local, root = cmu.read_whole(amc, start=7)
    # The BVH has its T-pose in front: its frame k is the AMC's k - 1.
    other_local, other_root = cmu.read_whole(bvh, start=8)
    count = min(len(root), len(other_root))
    assert count > 40
    ours = fk(local, root, HML22)[1][:count] - root[:count, None]
    theirs = fk(other_local, other_root, HML22)[1][:count] - other_root[:count, None]
    error = (ours - theirs).norm(dim=-1) * 1000
    assert error.mean() < mean
    assert error.median() < median
    assert (root[:count] - other_root[:count]).norm(dim=-1).median() * 1000 < path


def test_the_leading_t_pose_is_dropped(refs):
    ref = refs["06_10"]
    frames = len(read_bvh(ref.path).values)
    root = cmu.read_whole(ref)[1]
    assert len(root) == math.ceil((frames - 8) / 6)
    take = cmu.read_take(ref)
    # In a T-pose the wrists would be level with the shoulders.
    joints = take.motion.joints[0]
    assert joints[HML22.index("left_wrist"), 1] < joints[HML22.index("left_shoulder"), 1] - 0.2
    assert take.span == (0, len(root))


def test_left_turns_turn_left(refs):
    motion = cmu.read_take(refs["06_10"]).motion
    heading = np.unwrap(rotations.heading_angle(motion.rotations[:, 0]).numpy())
    assert math.degrees(heading[-1] - heading[0]) == pytest.approx(360.0, abs=20.0)


def test_a_walk(refs):
    take = cmu.read_take(refs["07_03"])
    motion = take.motion
    assert take.content == "walk"
    assert len(take.sentences) == 1
    assert motion.skeleton is HML22
    assert motion.root[0, [0, 2]].abs().max() < 1e-5
    assert rotations.heading_angle(motion.rotations[0, 0]).abs() < 1e-4
    assert 0.9 < motion.root[:, 1].median() < 1.0
    assert 0.9 < motion.root[-1, 2] / motion.seconds < 1.8
    assert motion.joints[:, :, 1].min() > -0.03
    # Upright, looking ahead: mean pitch of head and chest within 12 degrees of level.
    for joint in ("head", "spine3"):
        forward = rotations.rotate(motion.global_rotations[:, HML22.index(joint)], torch.tensor([0.0, 0.0, 1.0]))
        assert abs(math.degrees(math.asin(float(forward[:, 1].mean())))) < 12.0
    # Flat feet in stance: the sole's pitch of the lower foot is that of the rest pose.
    toes = motion.joints[:, [10, 11]]
    soles = rotations.rotate(motion.global_rotations[:, [7, 8]], torch.tensor([0.0, 0.0, 1.0]))[..., 1]
    still = (toes.diff(dim=0).norm(dim=-1) * 20 < 0.3) & (toes[1:, :, 1] < 0.05)
    assert still.sum() > 10
    assert abs(math.degrees(math.asin(float(soles[1:][still].median())))) < 8.0


def test_backward_elbows_are_rejected(refs):
    with pytest.raises(RejectedTake, match="bends backwards"):
        cmu.read_take(refs["13_18"])


def test_a_damaged_list_is_refused(tmp_path):
    with pytest.raises(InputError, match="missing"):
        cmu.list_takes(tmp_path)
    (tmp_path / "trials.jsonl").write_text('{"trial": "02_01"')
    with pytest.raises(FormatError, match="line 1"):
        cmu.list_takes(tmp_path)
    trial = {"trial": "02_01", "files": [], "description": "walk", "fps": 120, "kit_captions": []}
    (tmp_path / "trials.jsonl").write_text(json.dumps(trial))
    with pytest.raises(FormatError, match="line 1"):
        cmu.list_takes(tmp_path)
