import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline

from moveset.data import cmu, glitches, posture
from moveset.data.takes import RejectedTake
from moveset.errors import FormatError, InputError
from moveset.io.bvh_parser import read_bvh
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22


@pytest.fixture(scope="module")
def refs(real_data):
    return {ref.name: ref for ref in cmu.list_takes(real_data / "cmu")}


def test_the_list_prefers_amc_and_keeps_partners_together(refs):
    assert len(refs) == 218
    assert sum(ref.source == "cmu-amc" for ref in refs.values()) == 83
    assert refs["02_01"].source == "cmu-amc"
    assert refs["02_01"].path.suffix == ".amc"
    assert refs["06_10"].source == "cmu-bvh"
    assert refs["60_01"].group == refs["61_01"].group
    assert refs["60_01"].fps == 60
    # Ladders and stools are not in the data, but people ask for them.
    assert {name for name, ref in refs.items() if ref.leave_out} == {"14_36"}
    with pytest.raises(RejectedTake, match="same motion"):
        cmu.read_take(refs["14_36"])


@pytest.mark.parametrize(
    ("trial", "mean", "median", "path"),
    [("02_07", 8, 6, 20), ("02_04", 9.5, 6, 35), ("02_01", 16, 9, 50), ("01_08", 17, 13, 50)],
)
def test_both_forms_of_a_take_agree(refs, trial, mean, median, path):
    """The AMC and the BVH of one take, read by different code and calibrated apart, in millimetres."""
    amc = refs[trial]
    bvh = replace(amc, skeleton=None, path=amc.path.with_suffix(".bvh"), drop=8)
    # The BVH has its T-pose in front, of which eight frames are dropped: it begins with the capture's frame 12.
    first, local, root = cmu.read_whole(amc)[0]
    later, other_local, other_root = cmu.read_whole(bvh)[0]
    assert (first, later) == (0, 2)
    local, root = local[2:], root[2:]
    count = min(len(root), len(other_root))
    assert count > 40
    ours = fk(local, root, HML22)[1][:count] - root[:count, None]
    theirs = fk(other_local, other_root, HML22)[1][:count] - other_root[:count, None]
    error = (ours - theirs).norm(dim=-1) * 1000
    assert error.mean() < mean
    assert error.median() < median
    assert (root[:count] - other_root[:count]).norm(dim=-1).median() * 1000 < path


def upright(refs, name: str) -> Motion:
    take = cmu.read_take(refs[name])
    (run,) = take.runs
    local, root = posture.upright(run.rotations, run.root, posture.leanings([(run.rotations, run.root)]) or LEVEL)
    return posture.on_floor(local, root, posture.floor_of(local, root))


LEVEL = {"pelvis": 0.0, "head": 6.0, "ankle": 0.0}


def test_the_leading_t_pose_is_dropped(refs):
    ref = refs["06_10"]
    frames = len(read_bvh(ref.path).values)
    (run,) = cmu.read_take(ref).runs
    assert run.first_frame == 2
    assert len(run) == math.ceil((frames - 13) / 6)
    # In a T-pose the wrists would be level with the shoulders.
    joints = upright(refs, "06_10").joints[0]
    assert joints[HML22.index("left_wrist"), 1] < joints[HML22.index("left_shoulder"), 1] - 0.2


def test_left_turns_turn_left(refs):
    heading = np.unwrap(rotations.heading_angle(upright(refs, "06_10").rotations[:, 0]).numpy())
    assert math.degrees(heading[-1] - heading[0]) == pytest.approx(360.0, abs=20.0)


def test_a_walk(refs):
    motion = upright(refs, "07_03")
    assert refs["07_03"].description == "walk"
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


def test_elbows_that_bend_backwards_are_turned(refs):
    ref = refs["13_18"]
    local, root = cmu._from_bvh(ref)
    faced = glitches.faced_elbows(local)
    assert not torch.equal(local, faced)
    assert torch.allclose(fk(faced, root, HML22)[1], fk(local, root, HML22)[1], atol=1e-6)
    assert glitches.faced_elbows(faced).sub(faced).abs().max() < 1e-9
    assert cmu.read_take(ref).runs


def test_times_of_thinned_conversions_are_those_of_the_capture(refs, tmp_path):
    """Every fifth frame of a full-rate BVH, read as the library's 24 fps files are.

    Frame k of the conversion is k - 1 of the capture, 6 n of the capture is n of ours: where n is 4 modulo 5, a frame
    that was kept is at the time of one of ours, and nothing is lost. Between those no more is lost than by a spline
    through the places of joints in the frames that were kept (4 cm of the fastest feet), but for the 2 mm by which
    splines of rotations and of places differ.
    """
    ref = refs["06_10"]
    lines = ref.path.read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("Frame Time"))
    rows = lines[head + 1 :: 5]
    lines = [*lines[: head - 1], f"Frames: {len(rows)}", f"Frame Time: {5 / 120:.7f}", *rows]
    (tmp_path / "thin.bvh").write_text("\n".join(lines) + "\n")
    thin = replace(ref, path=tmp_path / "thin.bvh", source="cmu-more", fps=24.0, capture_hz=120.0, drop=2)
    (run,), (other,) = cmu.read_take(ref).runs, cmu.read_take(thin).runs
    assert run.first_frame == other.first_frame == 2
    count = min(len(run), len(other))
    ours, theirs = (fk(r.rotations[:count], r.root[:count], HML22)[1] for r in (run, other))
    lost, frames = (ours - theirs).norm(dim=-1), torch.arange(2, 2 + count)
    assert lost[frames % 5 == 4].max() < 1e-5
    kept = fk(*cmu._from_bvh(ref), HML22)[1][::5]
    splined = CubicSpline((5 * np.arange(len(kept)) - 1)[2:] / 120, kept[2:])(frames / 20)
    by_places = (ours - torch.from_numpy(splined)).norm(dim=-1)
    assert (lost - by_places).max() < 0.002
    assert lost.mean() < 1.02 * by_places.mean()
    assert lost.max() < 0.045
    assert lost.mean() < 0.0025


def test_a_damaged_list_is_refused(tmp_path):
    with pytest.raises(InputError, match="missing"):
        cmu.list_takes(tmp_path)
    (tmp_path / "trials.jsonl").write_text('{"trial": "02_01"')
    with pytest.raises(FormatError, match="line 1"):
        cmu.list_takes(tmp_path)
    trial = {"trial": "02_01", "files": [], "description": "walk", "fps": 120}
    (tmp_path / "trials.jsonl").write_text(json.dumps(trial))
    with pytest.raises(FormatError, match="line 1"):
        cmu.list_takes(tmp_path)
