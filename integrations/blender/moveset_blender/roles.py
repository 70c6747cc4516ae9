"""Which bone of an armature plays which part: name maps of common rigs. A *role* is a joint of hml22 ("left_knee")."""

import re
from collections.abc import Mapping, Sequence

from .hml22 import HML22
from .take import MotionError


def _sided(centre: Mapping[str, str], sides: Mapping[str, str], left: str, right: str) -> dict[str, str]:
    """Role -> bone, from names for the middle and names with a {} for either side."""
    names = dict(centre)
    for side, word in (("left", left), ("right", right)):
        names |= {f"{side}_{role}": name.format(word) for role, name in sides.items()}
    return names


# fmt: off
PRESETS: dict[str, dict[str, str]] = {
    "smpl": {role: role for role in HML22.joints},
    "mixamo": _sided(
        {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head"},
        {"hip": "{}UpLeg", "knee": "{}Leg", "ankle": "{}Foot", "foot": "{}ToeBase",
         "collar": "{}Shoulder", "shoulder": "{}Arm", "elbow": "{}ForeArm", "wrist": "{}Hand"},
        "Left", "Right",
    ),
    "vrm": _sided(
        {"pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck",
         "head": "head"},
        {"hip": "{}UpperLeg", "knee": "{}LowerLeg", "ankle": "{}Foot", "foot": "{}Toes",
         "collar": "{}Shoulder", "shoulder": "{}UpperArm", "elbow": "{}LowerArm", "wrist": "{}Hand"},
        "left", "right",
    ),
    # VRM tells roles apart from names; these are the names in the files of the most common VRM editor.
    "vroid": _sided(
        {"pelvis": "J_Bip_C_Hips", "spine1": "J_Bip_C_Spine", "spine2": "J_Bip_C_Chest",
         "spine3": "J_Bip_C_UpperChest", "neck": "J_Bip_C_Neck", "head": "J_Bip_C_Head"},
        {"hip": "J_Bip_{}_UpperLeg", "knee": "J_Bip_{}_LowerLeg", "ankle": "J_Bip_{}_Foot",
         "foot": "J_Bip_{}_ToeBase", "collar": "J_Bip_{}_Shoulder", "shoulder": "J_Bip_{}_UpperArm",
         "elbow": "J_Bip_{}_LowerArm", "wrist": "J_Bip_{}_Hand"},
        "L", "R",
    ),
    "ue5": _sided(
        {"pelvis": "pelvis", "spine1": "spine_01", "spine2": "spine_03", "spine3": "spine_05", "neck": "neck_01",
         "head": "head"},
        {"hip": "thigh_{}", "knee": "calf_{}", "ankle": "foot_{}", "foot": "ball_{}",
         "collar": "clavicle_{}", "shoulder": "upperarm_{}", "elbow": "lowerarm_{}", "wrist": "hand_{}"},
        "l", "r",
    ),
    "metarig": _sided(
        {"pelvis": "spine", "spine1": "spine.001", "spine2": "spine.002", "spine3": "spine.003", "neck": "spine.004",
         "head": "spine.006"},
        {"hip": "thigh.{}", "knee": "shin.{}", "ankle": "foot.{}", "foot": "toe.{}",
         "collar": "shoulder.{}", "shoulder": "upper_arm.{}", "elbow": "forearm.{}", "wrist": "hand.{}"},
        "L", "R",
    ),
}
# fmt: on
NEEDED = ("pelvis", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle")


def find_roles(bones: Sequence[str], preset: str | None = None, owner: str = "the armature") -> dict[str, int]:
    """Role -> index of the bone that plays it; case and prefixes that end in a colon ("mixamorig:") do not matter.

    Args:
        bones: their names.
        preset: a key of ``PRESETS``, or None for the one that most names belong to.
        owner: what the bones belong to, for the sentence of the error.

    Raises:
        MotionError: pelvis, hips, knees or ankles are not there under the preset's names.
    """
    plain = {re.sub(r"^.*:", "", name).lower(): j for j, name in reversed(list(enumerate(bones)))}
    found: dict[str, int] = {}
    chosen = preset or "smpl"
    for key in (preset,) if preset else PRESETS:
        match = {role: plain[name.lower()] for role, name in PRESETS[key].items() if name.lower() in plain}
        if len(match) > len(found):
            found, chosen = match, key
    missing = [PRESETS[chosen][role] for role in NEEDED if role not in found]
    if missing and (preset or len(found) > 6):
        raise MotionError(
            f"{owner} has no bone {', '.join(missing)}, which the names of {chosen} need; rename its bones"
        )
    if missing:
        raise MotionError(f"{owner} has bones of none of the known names ({', '.join(PRESETS)}); rename its bones")
    return found
