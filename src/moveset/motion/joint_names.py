"""Which joint plays which part of the body, by its name and its place in the tree.

A *role* is the name of one of the 22 joints of ``hml22`` ("left_knee"). Names are taken apart into a side and a word,
so that prefixes ("mixamorig:", "Character1_", "Bip01 ", "CC_Base_", "DEF-"), suffixes (".001", "_02") and ways to
write a side ("Left", "l", "_L", ".l", "Lf") do not matter; limbs are found by their words, the trunk by the tree.

Nothing but Python in here: the Blender add-on carries this file as it is.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

SIDES = ("left", "right")
NEEDED = ("pelvis", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle")

# Words of each role, most telling first. "leg" and "shoulder" mean different joints in different families, and "foot"
# is the toe joint where another joint is called ankle: see _leg and _arm.
_HIP = ("upleg", "upperleg", "legupper", "uleg", "thigh", "femur", "hip", "hipjoint")
_KNEE = ("knee", "shin", "calf", "tibia", "lowleg", "lowerleg", "leglower", "lleg")
_TOE = ("toebase", "toes", "toe", "toejoint", "ball", "forefoot", "football")
_SHOULDER = ("upperarm", "uparm", "armupper", "uarm", "humerus", "shldr", "arm")
_ELBOW = ("forearm", "lowerarm", "lowarm", "armlower", "elbow", "radius", "farm")
_WRIST = ("wrist", "hand", "palm")
_COLLAR = ("collar", "clavicle", "sternoclavicular", "torsoclavicle", "shoulderjoint", "scapula", "shoulder")
_HEAD = ("head", "skull", "skulla", "skullbase", "torsohead", "face")
_NECK = ("neck", "necka", "lowerneck", "upperneck", "headneck")
_TRUNK = (
    "spine", "chest", "torso", "thorax", "abdomen", "ab", "belly", "waist", "lowerback", "upperback", "upperchest",
    "lowerspine", "middlespine", "upperspine", "spinea", "spineb", "spinec", "pelvislowerback", "lowerbacktorso",
)  # fmt: skip
_SIDED = {*_HIP, *_KNEE, *_TOE, *_SHOULDER, *_ELBOW, *_WRIST, *_COLLAR, "leg", "ankle", "foot"}

_LEFT, _RIGHT = {"l", "left", "lf", "lft"}, {"r", "right", "rt", "rgt"}
_NAMESPACE = re.compile(r"^.*[:|]")
_PREFIX = re.compile(
    r"^(?:.*[:|]|mixamorig\d*_?|character\d*_|(?:valvebiped\.)?bip\d+[ _]|cc_base_|rl_|def[-_]|org[-_]|mch[-_]|"
    r"j_bip_(?:c_)?|jt(?=[A-Z])|bn_|b_|sk_|armature_|(?-i:[A-Za-z]+_rig_)|bind_|jnt_|joint_(?=[a-z]))",
    re.IGNORECASE,
)
# Copies of a joint (".001"), numbers that exporters append ("_02").
_SUFFIX = re.compile(r"(?:\.\d{3}|_\d+|_jnt|_bone|_joint)+$", re.IGNORECASE)
# Parts of a limb's name that say how it is rigged, letters for the middle.
_RIGGING = re.compile(r"(?:bend|stretch)$")
_MIDDLE = {"x", "c", "m"}
_JAPANESE = {
    "足": "thigh", "ひざ": "knee", "膝": "knee", "足首": "ankle", "つま先": "toe", "肩": "collar", "腕": "upperarm",
    "ひじ": "elbow", "肘": "elbow", "手首": "wrist", "首": "neck", "頭": "head", "上半身": "spine", "下半身": "waist",
}  # fmt: skip
_SHARED = 0.6  # of all joints: so many share what stands before "_" where it is no part of their names
_TOKEN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")

# Families, for people: a name for a set of names, found by a prefix or by words that only it has together.
_FAMILIES: tuple[tuple[str, str], ...] = (
    ("Mixamo", r"mixamorig"),
    ("MotionBuilder (Character1)", r"^Character\d_"),
    ("Biped (3ds Max)", r"(?i)\bbip\d+"),
    ("Character Creator (CC_Base)", r"^CC_Base"),
    ("Rigify (DEF)", r"^DEF-"),
    ("VRoid", r"^J_Bip"),
    ("SmartBody", r"^Jt[A-Z]|sternoclavicular|^LowerSpine$"),
    ("Unreal", r"(?i)^(?:thigh|calf|upperarm)_[lr]$"),
    ("Blender (metarig)", r"^(?:thigh|shin|upper_arm)\.[LR]"),
    ("Daz and conversions of CMU", r"^[lr](?:Thigh|Shldr|Shin)$"),
    ("ASF", r"^[lr]?(?:femur|humerus)$|^[LR]_(?:Femur|Humerus)$"),
    ("KIT", r"^left_heel$"),
    ("SMPL, hml22", r"^(?:left|right|[LR])_?(?:hip|collar)$"),
    ("SOMA", r"^LeftShin$"),
    ("MotionBuilder", r"(?i)^LeftUpLeg(?:[._]\d+)*$"),
    ("VRM, Unity", r"(?i)^left_?upper_?leg$"),
    ("Biovision", r"^LeftKnee$|^LeftLowLeg$|^lKnee$"),
)


@dataclass(frozen=True)
class Name:
    """A joint's name taken apart: side ("left", "right" or ""), word in lower case without digits."""

    side: str
    word: str


def take_apart(name: str) -> Name:
    """Side and word of a joint's name.

    >>> [take_apart(n) for n in ("mixamorig:LeftUpLeg", "upper_arm.R", "lfemur")]
    [Name(side='left', word='upleg'), Name(side='right', word='upperarm'), Name(side='left', word='femur')]
    """
    rest = name.strip()
    while (cut := _PREFIX.sub("", rest, count=1)) != rest and cut:
        rest = cut
    rest = _SUFFIX.sub("", rest)
    if rest.lstrip("左右").rstrip("0123456789") in _JAPANESE:
        return Name({"左": "left", "右": "right"}.get(rest[0], ""), _JAPANESE[rest.lstrip("左右").rstrip("0123456789")])
    side, words = "", []
    for token in _TOKEN.findall(rest):
        lower = token.lower()
        if not side and lower in _LEFT | _RIGHT and token != "LF":  # "LFArm" is a left forearm
            side = "left" if lower in _LEFT else "right"
        elif lower not in _MIDDLE:
            words.append(lower)
    word = _RIGGING.sub("", "".join(words))
    if not side:
        # Sides without a border: "lfemur", "rightupleg", "LEFTUPLEG".
        for start in ("left", "right", "l", "r"):
            if word.startswith(start) and word[len(start) :].removesuffix("dummy") in _SIDED:
                side, word = ("left" if start[0] == "l" else "right"), word[len(start) :]
                break
    return Name(side, word)


@dataclass(frozen=True)
class Recognition:
    """What was recognised.

    Args:
        roles: role -> index of the joint that plays it.
        reasons: role -> what it was recognised by.
        family: whose names these are, for people.
    """

    roles: dict[str, int]
    reasons: dict[str, str]
    family: str

    @property
    def missing(self) -> list[str]:
        """What retargeting needs and was not found."""
        return [role for role in NEEDED if role not in self.roles]


def recognise(joints: Sequence[str], parents: Sequence[int]) -> Recognition:
    """Roles by names, then the trunk by the tree.

    Args:
        joints: names, parents before their children.
        parents: index of each joint's parent, -1 for a root.
    """
    names = [take_apart(name) for name in _without_shared(joints)]
    only = [name.upper().startswith("DEF-") for name in joints]
    tree = _Tree(parents)
    found: dict[str, int] = {}
    reasons: dict[str, str] = {}
    for side in SIDES:
        of = _Words(names, side, only if any(only) else None, tree)
        for part, joint in (_leg(of) | _arm(of)).items():
            found[f"{side}_{part}"] = joint
            reasons[f"{side}_{part}"] = f"{side} {names[joint].word}"
    middle = _Words(names, "", only if any(only) else None, tree)
    for role, joint in _trunk(middle, found, tree).items():
        found[role], reasons[role] = joint, "its place in the tree"
        if names[joint].word in (*_HEAD, *_NECK, *_TRUNK, "hips", "hip", "pelvis", "root"):
            reasons[role] = names[joint].word
    return Recognition(found, reasons, family_of(joints))


def _without_shared(joints: Sequence[str]) -> list[str]:
    """Names without their namespaces, and without what most of them begin with ("Robot_Hips")."""
    names = [_NAMESPACE.sub("", name) for name in joints]
    starts = Counter(name.split("_")[0] for name in names if "_" in name and not _PREFIX.match(name))
    if not starts:
        return names
    start, count = starts.most_common(1)[0]
    if count < max(_SHARED * len(names), len(NEEDED)) or start.lower() in _LEFT | _RIGHT:
        return names
    return [name.removeprefix(f"{start}_") for name in names]


def family_of(joints: Sequence[str]) -> str:
    """Whose names these are, for people."""
    for family, sign in _FAMILIES:
        if any(re.search(sign, name) for name in joints):
            return family
    return "unknown"


class _Tree:
    def __init__(self, parents: Sequence[int]) -> None:
        self.parents = parents
        self.depth: list[int] = []
        for parent in parents:
            self.depth.append(self.depth[parent] + 1 if parent >= 0 else 0)

    def path(self, joint: int) -> list[int]:
        """From the root down to the joint itself."""
        path = [joint]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return path[::-1]

    def meeting(self, joints: Sequence[int]) -> int | None:
        """The deepest joint that all hang on, or are."""
        paths = [self.path(joint) for joint in joints]
        common = [level[0] for level in zip(*paths, strict=False) if len(set(level)) == 1]
        return common[-1] if common else None


class _Words:
    """Joints of one side by their words."""

    def __init__(self, names: Sequence[Name], side: str, only: Sequence[bool] | None, tree: _Tree) -> None:
        self.tree = tree
        self.by_word: dict[str, list[int]] = {}
        for j, name in enumerate(names):
            if name.side == side and name.word and (only is None or only[j]):
                self.by_word.setdefault(name.word, []).append(j)

    def first(self, words: Sequence[str]) -> int | None:
        """The joint of the most telling word, nearest to the root."""
        for word in words:
            if word in self.by_word:
                return min(self.by_word[word], key=lambda j: self.tree.depth[j])
        return None

    def above(self, joint: int | None, words: Sequence[str]) -> int | None:
        """The joint of the most telling word that ``joint`` hangs on, the upper one of two; else the first."""
        path = [] if joint is None else self.tree.path(joint)[:-1]
        for word in words:
            for above in path:
                if above in self.by_word.get(word, ()):
                    return above
        return self.first(words)

    def below(self, joint: int | None, words: Sequence[str]) -> int | None:
        """The joint of the most telling word that hangs on ``joint``, nearest to it; where none does, the first."""
        for word in words if joint is not None else ():
            inside = [j for j in self.by_word.get(word, ()) if joint in self.tree.path(j)[:-1]]
            if inside:
                return min(inside, key=lambda j: self.tree.depth[j])
        return self.first(words)


def _leg(of: _Words) -> dict[str, int]:
    knee = of.first(_KNEE)
    # SOMA calls the thigh "leg", all others the shin.
    hip = of.above(knee, (*_HIP, "leg") if knee is not None else _HIP)
    if knee is None:
        knee = of.below(hip, ("leg",)) if hip is not None else None
    ankle = of.below(knee, ("ankle", "foot"))
    foot = of.below(ankle, (*_TOE, "foot") if ankle in of.by_word.get("ankle", ()) else _TOE)
    found = {"hip": hip, "knee": knee, "ankle": ankle, "foot": foot}
    return {part: joint for part, joint in found.items() if joint is not None}


def _arm(of: _Words) -> dict[str, int]:
    elbow = of.first(_ELBOW)
    strong = of.first(_SHOULDER) is not None
    shoulder = of.above(elbow, _SHOULDER if strong else ("shoulder",))
    collar = of.above(shoulder, _COLLAR)
    collar = None if collar == shoulder else collar
    found = {"collar": collar, "shoulder": shoulder, "elbow": elbow, "wrist": of.below(elbow, _WRIST)}
    return {part: joint for part, joint in found.items() if joint is not None}


def _trunk(of: _Words, limbs: Mapping[str, int], tree: _Tree) -> dict[str, int]:
    """Pelvis, spine, neck and head: the path from where the legs meet, by where the arms meet, to the head."""
    hips = [limbs[f"{side}_hip"] for side in SIDES if f"{side}_hip" in limbs]
    if len(hips) < 2:
        return {}
    arms = [limbs[f"{side}_{part}"] for part in ("collar", "shoulder") for side in SIDES if f"{side}_{part}" in limbs]
    end = of.first(_HEAD)
    end = of.first(_NECK) if end is None else end
    trunk = [j for word in (*_TRUNK, *_NECK) for j in of.by_word.get(word, ())]
    chest = tree.meeting(arms) if len(arms) > 1 else None
    if end is None or (of.tree.depth[end] < max((tree.depth[j] for j in trunk), default=0) and chest is None):
        end = max(trunk, key=lambda j: tree.depth[j], default=end if end is not None else chest)
    if end is None:
        pelvis = tree.meeting(hips)
        return {} if pelvis is None else {"pelvis": pelvis}
    if chest is not None and chest in tree.path(end) and of.first(_HEAD) is None:
        # A metarig calls neck and head "spine", too.
        end = max((j for j in trunk if chest in tree.path(j)), key=lambda j: tree.depth[j], default=end)
    pelvis = tree.meeting([*hips, end])
    if pelvis is None:
        return {}
    dummies = {j for word, members in of.by_word.items() if word.endswith("dummy") for j in members}
    way = [j for j in tree.path(end) if tree.depth[j] > tree.depth[pelvis] and j not in dummies]
    roles = {"pelvis": pelvis}
    necks = {j for word in _NECK for j in of.by_word.get(word, ())}
    heads = {j for word in _HEAD for j in of.by_word.get(word, ())}
    last = max((k for k, j in enumerate(way) if chest is not None and j in tree.path(chest)), default=-1)
    first_up = next((k for k, j in enumerate(way) if j in necks | heads), len(way))
    last = min(last, first_up - 1) if last >= 0 else first_up - 1
    spine, up = way[: last + 1], way[last + 1 :]
    if len(spine) > 2:
        roles |= {"spine1": spine[0], "spine2": spine[len(spine) // 2], "spine3": spine[-1]}
    elif spine:
        roles |= {"spine1": spine[0], "spine3": spine[-1]} if len(spine) == 2 else {"spine3": spine[0]}
    if up:
        roles["head" if len(up) == 1 and up[0] not in necks else "neck"] = up[0]
    if len(up) > 1:
        roles["head"] = up[-1]
    return roles
