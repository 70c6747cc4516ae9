"""Names of real files, by family: which joint plays which role. The families are those of public repositories."""

import re
from pathlib import Path

import pytest

from moveset.motion.joint_names import NEEDED, recognise
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import HML22

# Trunk, leg and arm of each family; the file says how they are written.
TABLE = Path(__file__).with_name("joint_names.txt").read_text("utf-8")
FAMILIES = {name: parts.strip().splitlines() for name, parts in re.findall(r"^\[(.*)\]\n((?:.+\n){3})", TABLE, re.M)}
TRUNK = {"p": "pelvis", "1": "spine1", "2": "spine2", "3": "spine3", "n": "neck", "h": "head"}
LEG = {"h": "hip", "k": "knee", "a": "ankle", "f": "foot"}
ARM = {"c": "collar", "s": "shoulder", "e": "elbow", "w": "wrist"}
SWAPS = ("左右", "left right", "Left Right", "_l_ _r_", ".L .R", "_L_ _R_", "L_ R_", "Lf Rt")


def other_side(name):
    for swap in SWAPS:
        left, right = swap.split() if " " in swap else swap
        if left in name:
            return name.replace(left, right, 1)
    if name.endswith(("_l", ".l")):
        return name[:-1] + "r"
    return {"l": "r", "L": "R"}.get(name[0], name[0]) + name[1:]


def tree(parts):
    """Joints, parents, and role -> joint of one family."""
    trunk, leg, arm = (part.split() for part in parts)
    joints, parents, roles = [], [], {}

    def grow(chain, parent, tags, side=""):
        for entry in chain:
            name, _, tag = entry.rstrip("*").partition("=")
            joints.append(other_side(name) if side == "right" else name)
            parents.append(parent)
            parent = len(joints) - 1
            if tag:
                roles[f"{side}_{tags[tag]}" if side else tags[tag]] = parent

    grow(trunk, -1, TRUNK)
    chest = next(k for k, entry in enumerate(trunk) if entry.endswith("*"))
    for side in ("left", "right"):
        grow(leg, 0, LEG, side)
        grow(arm, chest, ARM, side)
    return joints, parents, roles


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("prefix", ["", "Armature|", "rig:"])
def test_families_of_real_files_are_recognised(family, prefix):
    joints, parents, roles = tree(FAMILIES[family])
    found = recognise([prefix + name for name in joints], parents)
    assert not found.missing
    assert {r: joints[j] for r, j in found.roles.items()} == {r: joints[j] for r, j in roles.items()}


@pytest.mark.parametrize("rig", RIGS)
def test_built_in_skeletons_are_recognised_whole(rig):
    found = recognise(RIGS[rig].joints, RIGS[rig].parents).roles
    assert set(HML22.joints) - set(found) == ({"spine2", "left_collar", "right_collar"} if rig == "kit21" else set())


@pytest.mark.parametrize(
    "names",
    [
        "root foot_0_0",
        "base child1 child2 child3",
        "link1 link2 link3 link4",
        "Hips",
        "root X_Axis X_Axis_Ornament X_Ornament_A Y_Axis Y_Axis_Ornament Z_Axis Z_Ornament_B2",
        "lHand metacarpal1.l finger2-1.l finger2-2.l lthumbBase lthumb finger1-2.l",
        "root Hips Spine.001 Spine.002 Head Front_Leg_Upper.R Front_Leg_Lower.R Front_Foot.R Tail_Base Back_Foot.L",
        "Hips Spine Neck Head shoulder_L wing_L wing.001_L shoulder_R wing_R wing.001_R Spine.002",
        "b_Root_00 b_Hip_01 b_Spine01_02 b_Neck_04 b_RightUpperArm_06 b_LeftLeg01_015 b_RightLeg01_019",
    ],
)
def test_what_is_no_human_body_is_not_recognised(names):
    joints = names.split()
    assert recognise(joints, range(-1, len(joints) - 1)).missing


def test_what_is_needed_are_roles():
    assert set(NEEDED) <= set(HML22.joints)
