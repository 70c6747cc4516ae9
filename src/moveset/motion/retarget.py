"""The same motion on another skeleton: joints matched by role, rest poses reconciled, feet kept on the floor."""

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.kinematics import global_to_local
from moveset.motion.rigs import get_rig, roles
from moveset.motion.skeleton import Skeleton

# Limbs keep their world direction: role -> (from, to), the two roles whose rest positions give that direction. Hands
# have no joint beyond them here and go with their forearm. All other joints (trunk, collars, head, feet) keep their
# orientation, because there a rest direction says where the next joint sits rather than where the part points: a flat
# foot stays flat and a level gaze level.
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
_SHORTEST_LEG = 1e-6  # metres


def retarget(motion: Motion, target: str | Skeleton) -> Motion:
    """The motion on another skeleton.

    With G the world rotation of a joint in the source and d_s, d_t the rest directions of the same limb in source and
    target, the target's joint turns by G·C, where C is the shortest arc from d_t to d_s: both limbs then point the same
    way. Joints without a counterpart keep their rest pose. The path of the
    centre between the hips is scaled by the leg lengths, and raised or lowered once, so that a foot that stands flat on
    the floor does so afterwards (exactly where thigh and shin have the same proportions in both, as in the presets).

    Where both skeletons are one body (``Skeleton.order_in``) nothing moves, be there roles or not.

    Args:
        motion: on a skeleton whose joints ``rigs.roles`` recognises.
        target: "smpl", "mixamo", "vrm", "ue5", "hml22", "kit21", or any skeleton with recognisable joints.

    Raises:
        InputError: an unknown name, or a skeleton without recognisable legs or with legs of no length.
    """
    skeleton = get_rig(target) if isinstance(target, str) else target
    source = motion.skeleton
    if skeleton is source:
        return motion
    if (order := skeleton.order_in(source)) is not None:
        return Motion(motion.rotations[:, order], motion.root, motion.fps, skeleton)
    theirs, ours = roles(source), roles(skeleton)
    for body, found in ((source, theirs), (skeleton, ours)):
        if leg_length(body, found) < _SHORTEST_LEG:
            raise InputError(f"skeleton {body.name!r} has legs of no length, which say no size; give its bones lengths")
    turned = motion.global_rotations
    wanted = {
        ours[role]: rotations.mul(turned[:, theirs[role]], _correction(source, theirs, skeleton, ours, role))
        for role in ours
        if role in theirs
    }
    for above_pelvis in _ancestors(skeleton, ours["pelvis"]):
        wanted[above_pelvis] = rotations.heading(turned[:, theirs["pelvis"]])

    world: list[Tensor] = []
    for j, parent in enumerate(skeleton.parents):
        world.append(wanted[j] if j in wanted else world[parent])
    local = global_to_local(torch.stack(world, dim=1), skeleton)
    rigid = Motion(local, torch.zeros_like(motion.root), motion.fps, skeleton)
    hips = [ours["left_hip"], ours["right_hip"]]
    root = _hip_centre(motion, skeleton, theirs, ours) - rigid.joints[:, hips].mean(dim=1)
    return Motion(rotations.unroll(local), root, motion.fps, skeleton)


def _correction(
    source: Skeleton, theirs: dict[str, int], skeleton: Skeleton, ours: dict[str, int], role: str
) -> Tensor:
    """C (4,): from the target's rest direction of a limb to the source's; the identity for what is no limb."""
    start, end = _LIMBS.get(role, ("", ""))
    if not all(name in found for name in (start, end) for found in (theirs, ours)):
        return rotations.identity()
    d_s = source.rest_positions[theirs[end]] - source.rest_positions[theirs[start]]
    d_t = skeleton.rest_positions[ours[end]] - skeleton.rest_positions[ours[start]]
    return rotations.between(d_t, d_s)


def _ancestors(skeleton: Skeleton, joint: int) -> list[int]:
    above = []
    while joint > 0:
        joint = skeleton.parents[joint]
        above.append(joint)
    return above


def _hip_centre(motion: Motion, skeleton: Skeleton, theirs: dict[str, int], ours: dict[str, int]) -> Tensor:
    """Where the point between the target's hips goes: (F, 3)."""
    scale = leg_length(skeleton, ours) / leg_length(motion.skeleton, theirs)
    below, above = _ankle_height(motion.skeleton, theirs), _ankle_height(skeleton, ours)
    lift = 0.0 if below is None or above is None else above - scale * below
    centre = motion.joints[:, [theirs["left_hip"], theirs["right_hip"]]].mean(dim=1)
    return scale * centre + centre.new_tensor((0.0, lift, 0.0))


def leg_length(skeleton: Skeleton, found: dict[str, int]) -> float:
    """Hip to knee to ankle, metres, mean of both sides."""
    rest = skeleton.rest_positions
    length = 0.0
    for side in ("left", "right"):
        hip, knee, ankle = (rest[found[f"{side}_{part}"]] for part in ("hip", "knee", "ankle"))
        length += 0.5 * float((knee - hip).norm() + (ankle - knee).norm())
    return length


def _ankle_height(skeleton: Skeleton, found: dict[str, int]) -> float | None:
    """Height of the ankles above the toe joints at rest, metres; None where there are no toe joints."""
    rest = skeleton.rest_positions
    sides = [side for side in ("left", "right") if f"{side}_foot" in found]
    drops = [float(rest[found[f"{side}_ankle"], 1] - rest[found[f"{side}_foot"], 1]) for side in sides]
    return max(0.0, sum(drops) / len(drops)) if drops else None
