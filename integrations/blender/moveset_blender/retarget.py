"""A take on somebody's armature: bones found by name, rest poses reconciled, legs measured, feet kept on the floor.

The rule is that of ``moveset.motion.retarget``, for bones with axes of their own. With G the turn of a joint in the
take, d_s and d_t the rest directions of a limb in take and armature and C the shortest arc from d_t to d_s, the bone
turns by G·C: arms and legs point the same way whether the character rests in T or A pose. Trunk, collars, head and feet
keep their orientation, because there a rest direction says where the next bone sits rather than where the part points.
Bones without a counterpart follow their parents. The take plays where the armature stands and the way it looks.
"""

import numpy as np

from . import quaternions as quat
from .armature import Pose, Rig, channel, to_blender, turn_to_blender
from .roles import find_roles
from .take import MotionError, Take

_LIMBS = {
    f"{side}_{role}": (f"{side}_{start}", f"{side}_{end}")
    for side in ("left", "right")
    for role, start, end in (
        ("hip", "hip", "knee"),
        ("knee", "knee", "ankle"),
        ("shoulder", "shoulder", "elbow"),
        ("elbow", "elbow", "wrist"),
        ("wrist", "elbow", "wrist"),
    )
}


def retarget(take: Take, rig: Rig) -> Pose:
    """The pose of an armature that moves as the take does.

    Args:
        take: on a skeleton whose joints have known names.
        rig: the armature at rest, upright.

    Raises:
        MotionError: bones are missing, or the armature does not stand upright at rest.
    """
    theirs = find_roles(take.skeleton.joints, take.skeleton.parents, "the take")
    ours = find_roles(rig.bones, rig.parents, rig.name)
    source = to_blender(take.skeleton.rest_positions())
    turned, placed = take.world()
    turned, placed = turn_to_blender(turned), to_blender(placed)
    look = facing(rig, ours)

    turns: dict[int, np.ndarray] = {}
    for role in (role for role in ours if role in theirs):
        start, end = _LIMBS.get(role, ("", ""))
        arc = quat.IDENTITY
        if all(name in found for name in (start, end) for found in (theirs, ours)):
            bone = quat.rotate(look, rig.heads[ours[end]] - rig.heads[ours[start]])
            arc = quat.between(bone, source[theirs[end]] - source[theirs[start]])
        arc = quat.mul(arc, look)
        turns[ours[role]] = quat.mul(quat.inv(look), quat.mul(turned[:, theirs[role]], arc))

    still = np.broadcast_to(quat.IDENTITY, (len(take.root), 4))
    world: list[np.ndarray] = []
    keyed: dict[int, np.ndarray] = {}
    for j, parent in enumerate(rig.parents):
        above = world[parent] if parent >= 0 else still
        world.append(turns.get(j, above))
        if j in turns:
            keyed[j] = channel(quat.mul(quat.inv(above), turns[j]), rig.turns[j])

    pelvis, hips = ours["pelvis"], [ours["left_hip"], ours["right_hip"]]
    scale = _leg(rig.heads, ours) / _leg(source, theirs)
    centre = scale * placed[:, [theirs["left_hip"], theirs["right_hip"]]].mean(axis=1)
    below, above = _ankle(source, theirs, on_floor=False), _ankle(rig.heads, ours, on_floor=True)
    if below is not None and above is not None:
        centre[:, 2] += above - scale * below
    arm = rig.heads[hips].mean(axis=0) - rig.heads[pelvis]
    path = quat.rotate(quat.inv(look), centre) - quat.rotate(turns[pelvis], arm)
    location = quat.rotate(quat.inv(rig.turns[pelvis]), path - rig.heads[pelvis])
    return Pose(take.fps, keyed, pelvis, path, location)


def facing(rig: Rig, found: dict[str, int]) -> np.ndarray:
    """(4,) the turn about Z that makes the armature at rest look along -Y.

    Raises:
        MotionError: its head is not above its feet or its hips are one above the other.
    """
    feet = rig.heads[[found["left_ankle"], found["right_ankle"]]].mean(axis=0)
    up = rig.heads[found.get("head", found["pelvis"])] - feet
    left = rig.heads[found["left_hip"]] - rig.heads[found["right_hip"]]
    if up[2] < 0.8 * np.linalg.norm(up) or np.hypot(left[0], left[1]) < 0.5 * np.linalg.norm(left) or not left.any():
        raise MotionError(f"{rig.name} does not stand upright at rest; turn the armature until its rest pose does")
    angle = -np.arctan2(left[1], left[0])
    return np.array((0.0, 0.0, np.sin(0.5 * angle), np.cos(0.5 * angle)))


def _leg(heads: np.ndarray, found: dict[str, int]) -> float:
    """Hip to knee to ankle, metres, mean of both sides."""
    length = 0.0
    for side in ("left", "right"):
        hip, knee, ankle = (heads[found[f"{side}_{part}"]] for part in ("hip", "knee", "ankle"))
        length += 0.5 * float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))
    if length < 1e-6:
        raise MotionError("the legs have no length; give an armature whose hips, knees and ankles are apart")
    return length


def _ankle(heads: np.ndarray, found: dict[str, int], *, on_floor: bool) -> float | None:
    """Height of the ankles above the sole, metres; None where there are no toes to tell.

    A character that stands on its origin says itself where its sole is (``on_floor``); else it is at the toe joints.
    """
    sides = [side for side in ("left", "right") if f"{side}_foot" in found]
    if not sides:
        return None
    ankle = float(np.mean([heads[found[f"{side}_ankle"], 2] for side in sides]))
    toes = float(np.mean([heads[found[f"{side}_foot"], 2] for side in sides]))
    stands = on_floor and -1e-3 <= toes < 0.2 * _leg(heads, found)
    return ankle if stands else max(0.0, ankle - toes)
