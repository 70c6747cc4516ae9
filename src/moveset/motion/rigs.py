"""Named skeletons of other tools, and what their joints mean.

A *role* is the name of one of the 22 joints of ``hml22`` ("left_knee"); ``roles`` finds which joint of a skeleton plays
which. The presets ``smpl``, ``mixamo``, ``vrm`` and ``ue5`` carry the joint names, hierarchy and rest pose (T, or A for
``ue5``) of those tools on hml22's body, so that nothing of a motion is lost in changing to them.

What is approximated: bone lengths are hml22's, not those of a character; at rest every joint's axes are the world's
axes, which is what VRM 1.0 calls normalised, while Mixamo's and Unreal's own files turn them along the bones (tools
that retarget compare with the rest pose, so they need names and pose only); fingers, twist bones and Unreal's ``root``
bone are left out, and the arms of ``ue5`` hang by exactly 45 degrees.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.body_shape import body_shape
from moveset.motion.joint_names import NEEDED, Recognition, recognise
from moveset.motion.skeleton import HML22, KIT21, Skeleton


def _sided(centre: Mapping[str, str], sides: Mapping[str, str], left: str, right: str) -> dict[str, str]:
    """Role -> joint name, from names for the middle and names with a {} for either side."""
    names = dict(centre)
    for side, word in (("left", left), ("right", right)):
        names |= {f"{side}_{role}": name.format(word) for role, name in sides.items()}
    return names


_MIXAMO = _sided(
    {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head"},
    {
        "hip": "{}UpLeg", "knee": "{}Leg", "ankle": "{}Foot", "foot": "{}ToeBase",
        "collar": "{}Shoulder", "shoulder": "{}Arm", "elbow": "{}ForeArm", "wrist": "{}Hand",
    },
    "Left",
    "Right",
)  # fmt: skip
_VRM = _sided(
    {"pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck", "head": "head"},
    {
        "hip": "{}UpperLeg", "knee": "{}LowerLeg", "ankle": "{}Foot", "foot": "{}Toes",
        "collar": "{}Shoulder", "shoulder": "{}UpperArm", "elbow": "{}LowerArm", "wrist": "{}Hand",
    },
    "left",
    "right",
)  # fmt: skip
_UE5 = _sided(
    {"pelvis": "pelvis", "spine1": "spine_01", "spine2": "spine_03", "spine3": "spine_05", "neck": "neck_01",
     "head": "head"},
    {
        "hip": "thigh_{}", "knee": "calf_{}", "ankle": "foot_{}", "foot": "ball_{}",
        "collar": "clavicle_{}", "shoulder": "upperarm_{}", "elbow": "lowerarm_{}", "wrist": "hand_{}",
    },
    "l",
    "r",
)  # fmt: skip
# Joints of ue5 half-way between two roles: they keep their rest pose, so that the others stay exactly in place.
_UE5_BETWEEN = {
    "spine_02": ("spine1", "spine2"),
    "spine_04": ("spine2", "spine3"),
    "neck_02": ("neck", "head"),
}


def roles(skeleton: Skeleton) -> dict[str, int]:
    """Which joint plays which role: as the skeleton says, else by names and tree (``joint_names``), else by shape.

    Raises:
        InputError: fewer than pelvis, hips, knees and ankles can be recognised.
    """
    return recognised(skeleton).roles


def recognised(skeleton: Skeleton) -> Recognition:
    """The same, and by what each joint was recognised.

    Raises:
        InputError: fewer than pelvis, hips, knees and ankles can be recognised.
    """
    found = _recognised(skeleton)
    if found.missing:
        raise InputError(
            f"skeleton {skeleton.name!r} has no joint recognisable as {', '.join(found.missing)}; name its joints as "
            f"one of {', '.join(RIGS)} does, or say which joint is which"
        )
    return found


@lru_cache(maxsize=64)
def _recognised(skeleton: Skeleton) -> Recognition:
    if skeleton.roles:
        return Recognition(dict(skeleton.roles), {role: "as given" for role, _ in skeleton.roles}, "as given")
    found = recognise(skeleton.joints, skeleton.parents)
    if found.missing and (shape := body_shape(skeleton)) is not None:
        return Recognition(shape, dict.fromkeys(shape, "the body's shape"), "unknown names")
    return found


def with_roles(skeleton: Skeleton, joints: Mapping[str, str]) -> Skeleton:
    """The skeleton with roles as somebody says, the others as they are recognised.

    Args:
        skeleton: any.
        joints: role -> name of the joint that plays it, or "" where none does.

    Raises:
        InputError: a role or a joint that is not there, or a body without recognisable legs.
    """
    if unknown := sorted(set(joints) - set(HML22.joints)):
        raise InputError(f"there is no part {unknown[0]!r} of a body; give one of {', '.join(HML22.joints)}")
    given = {role: skeleton.index(name) for role, name in joints.items() if name}
    known = recognise(skeleton.joints, skeleton.parents).roles if len(given) < len(HML22) else {}
    taken = set(given.values())
    found = {role: j for role, j in known.items() if role not in joints and j not in taken} | given
    if missing := [role for role in NEEDED if role not in found]:
        raise InputError(f"skeleton {skeleton.name!r} has no joint for {', '.join(missing)}; say which joint is which")
    return replace(skeleton, roles=tuple(sorted(found.items())), feet=feet_by_role(found))


def pairs_by_name(joints: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """(left, right) indices of joints whose names differ only in their side.

    >>> pairs_by_name(("hips", "LeftArm", "RightArm", "thigh_l", "thigh_r"))
    ((1, 2), (3, 4))
    """
    swaps = ((r"left", "right"), (r"Left", "Right"), (r"LEFT", "RIGHT"), (r"(?<=[_.])l$", "r"), (r"(?<=[_.])L$", "R"),
             (r"^l(?=[_.A-Z])", "r"), (r"^L(?=[_.])", "R"))  # fmt: skip
    index = {name: j for j, name in enumerate(joints)}
    pairs = []
    for j, name in enumerate(joints):
        for left, right in swaps:
            other = re.sub(left, right, name, count=1)
            if other != name and other in index:
                pairs.append((j, index[other]))
                break
    return tuple(pairs)


def feet_by_role(found: Mapping[str, int]) -> tuple[int, ...]:
    """Left ankle, left toe, right ankle, right toe, or () where one is missing."""
    wanted = ("left_ankle", "left_foot", "right_ankle", "right_foot")
    return tuple(found[role] for role in wanted) if all(role in found for role in wanted) else ()


def _rest(drop_degrees: float = 0.0) -> dict[str, Tensor]:
    """hml22's rest position of each role, arms turned down by some degrees about the shoulders."""
    rest = dict(zip(HML22.joints, HML22.rest_positions, strict=True))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        shoulder = rest[f"{side}_shoulder"]
        turn = rotations.about("z", sign * drop_degrees)
        for part in ("elbow", "wrist"):
            rest[f"{side}_{part}"] = shoulder + rotations.rotate(turn, rest[f"{side}_{part}"] - shoulder)
    return rest


def _build(
    name: str,
    names: Mapping[str, str],
    *,
    prefix: str = "",
    ends: Mapping[str, tuple[str, tuple[float, float, float]]] | None = None,
    between: Mapping[str, tuple[str, str]] | None = None,
    drop_degrees: float = 0.0,
) -> Skeleton:
    """A preset: hml22's joints under other names, depth first, with joints in between and joints at the ends."""
    rest = _rest(drop_degrees)
    before = {above: (joint, below) for joint, (below, above) in (between or {}).items()}
    joints: list[str] = []
    parents: list[int] = []
    places: list[Tensor] = []

    def add(joint: str, parent: int, place: Tensor) -> int:
        joints.append(prefix + joint)
        parents.append(parent)
        places.append(place)
        return len(joints) - 1

    def grow(role: str, parent: int) -> None:
        if role in before:
            joint, below = before[role]
            parent = add(joint, parent, 0.5 * (rest[below] + rest[role]))
        here = add(names[role], parent, rest[role])
        for child in HML22.children[HML22.index(role)]:
            grow(HML22.joints[child], here)
        for joint, (owner, offset) in (ends or {}).items():
            if owner == role:
                add(joint, here, rest[role] + torch.tensor(offset))

    grow("pelvis", -1)
    placed = torch.stack(places)
    offsets = torch.cat((torch.zeros(1, 3), placed[1:] - placed[parents[1:]]))
    return as_skeleton(name, tuple(joints), tuple(parents), offsets)


def get_rig(name: str) -> Skeleton:
    """A skeleton by name.

    Raises:
        InputError: no such name.
    """
    if name not in RIGS:
        raise InputError(f"there is no skeleton {name!r}; choose one of {', '.join(RIGS)}")
    return RIGS[name]


def as_skeleton(name: str, joints: tuple[str, ...], parents: tuple[int, ...], offsets: Tensor) -> Skeleton:
    """The skeleton that a file describes: a built-in one where it is the same, else with pairs and feet by name.

    Raises:
        InputError: the parts do not belong together.
    """
    for rig in RIGS.values():
        if rig.joints == joints and rig.parents == parents and torch.allclose(rig.offsets, offsets, atol=2e-5):
            return rig
    skeleton = Skeleton(name, joints, parents, offsets, pairs_by_name(joints))
    try:
        return replace(skeleton, feet=feet_by_role(roles(skeleton)))
    except InputError:
        return skeleton


def name_after(path: Path) -> str:
    """What the skeleton of a file is called that does not say: as the file is.

    A built-in skeleton's name would promise its joints, so there the extension stays.
    """
    return (path.name if path.stem in RIGS else path.stem)[:64]


_HAND, _TOE, _CROWN = 0.085, (0.0, 0.0, 0.07), (0.0, 0.17, 0.02)

RIGS: dict[str, Skeleton] = {}
RIGS |= {
    "hml22": HML22,
    "kit21": KIT21,
    "smpl": Skeleton(
        "smpl",
        (*HML22.joints, "left_hand", "right_hand"),
        (*HML22.parents, HML22.index("left_wrist"), HML22.index("right_wrist")),
        torch.cat((HML22.offsets, torch.tensor([[_HAND, 0.0, 0.0], [-_HAND, 0.0, 0.0]]))),
        (*HML22.pairs, (22, 23)),
        HML22.feet,
    ),
    "mixamo": _build(
        "mixamo",
        _MIXAMO,
        prefix="mixamorig:",
        ends={
            "HeadTop_End": ("head", _CROWN),
            "LeftToe_End": ("left_foot", _TOE),
            "RightToe_End": ("right_foot", _TOE),
        },
    ),
    "vrm": _build("vrm", _VRM),
    "ue5": _build("ue5", _UE5, between=_UE5_BETWEEN, drop_degrees=45.0),
}
