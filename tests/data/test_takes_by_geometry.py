"""Real takes retargeted by geometry alone, against constants that were measured on the takes, and against anatomy."""

import json

import pytest
import torch

from moveset.data import bandai_namco, cmu
from moveset.io import Body, load
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.kinematics import fk
from moveset.motion.reference import find_reference
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import HML22

pytestmark = pytest.mark.filterwarnings("ignore:.*was worked out")


def apart(a, b):
    """Mean distance of joints (F, J, 3) from each other, root-aligned, metres."""
    frames = min(len(a), len(b))
    a, b = a[:frames].double(), b[:frames].double()
    return float((a - a[:, :1] - (b - b[:, :1])).norm(dim=-1).mean())


@pytest.mark.parametrize(
    "name",
    ["dataset-1_bow_active_001", "dataset-2_walk-turn-left_normal_001", "dataset-2_wave-left-hand_normal_001"],
)
def test_a_zero_pose_without_meaning_is_seen_through(real_data, name):
    """Bandai-Namco's zero pose is none: what geometry makes of it is what was measured, within two centimetres."""
    ref = next(ref for ref in bandai_namco.list_takes(real_data) if ref.name == name)
    run = bandai_namco.read_take(ref).runs[0]
    measured = Motion(rotations.normalize(run.rotations).float(), run.root.float(), 20.0, HML22).canonical()
    take = load(ref.path)
    assert find_reference(take).how == "derived"
    assert apart(retarget(take, "hml22").resampled(20.0).canonical().joints, measured.joints) < 0.02


@pytest.mark.parametrize("trial", ["02_01", "02_04", "02_07", "01_08"])
def test_both_forms_of_a_take_agree_by_geometry(real_data, trial):
    """The BVH of a CMU take, by its T-pose, against the AMC, by constants: within five centimetres."""
    amc = next(ref for ref in cmu.list_takes(real_data / "cmu") if ref.name == trial)
    _, local, root = cmu.read_whole(amc)[0]
    there = retarget(load(amc.path.with_suffix(".bvh")), "hml22")[13::6]
    assert apart(there.joints, fk(local[2:], root[2:], HML22)[1]) < 0.05


def test_takes_of_many_skeletons_stand_upright(real_data):
    """One take a set of more-mocap: heads up, feet down, knees that bend backward, forearms that bend forward."""
    folder = real_data / "more-mocap"
    if not folder.is_dir():
        pytest.skip("no more-mocap here")
    takes = {}
    for line in (folder / "takes.jsonl").read_text().splitlines():
        take = json.loads(line)
        if take["seconds"] < 20 and (folder / take["file"]).is_file():
            takes.setdefault(take["source"], take)
    assert len(takes) >= 9
    for source, take in takes.items():
        motion = load(folder / take["file"], body=Body(unit=take["unit_m"]))
        motion = retarget(motion[:: max(1, len(motion) // 300)], "hml22")
        placed, turned = motion.joints, motion.global_rotations
        head, feet = placed[:, HML22.index("head"), 1], placed[:, list(HML22.feet), 1].amin(dim=1)
        assert 1.1 < float((head - feet).quantile(0.9)) < 1.75, source
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for joints, axis in (
                (("hip", "knee", "ankle"), (1.0, 0.0, 0.0)),
                (("shoulder", "elbow", "wrist"), (0.0, -sign, 0.0)),
            ):
                a, b, c = (HML22.index(f"{side}_{part}") for part in joints)
                bend = torch.linalg.cross(placed[:, b] - placed[:, a], placed[:, c] - placed[:, b])
                bend = bend / (placed[:, c] - placed[:, b]).norm(dim=-1, keepdim=True) / 0.35
                along = (bend * rotations.rotate(turned[:, a], torch.tensor(axis))).sum(-1)
                bent = bend.norm(dim=-1) > 0.5
                assert not bent.any() or float((along[bent] > 0).float().mean()) > 0.9, (source, side, joints)
