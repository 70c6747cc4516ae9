"""The same motion on another skeleton: joints matched by role, rest poses reconciled, feet kept on the floor."""

import itertools
import warnings

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.body_axes import Roles, ankle_height, centre, leg_length
from moveset.motion.clip import Motion
from moveset.motion.kinematics import global_to_local
from moveset.motion.reference import as_before, find_reference, on_floor, reference_at_rest, standing, stood
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
_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")


def retarget(motion: Motion, target: str | Skeleton) -> Motion:
    """The motion on another skeleton.

    Both bodies are compared in a pose in which they stand (``motion.reference``), so that neither the axes of joints
    nor the zero pose matter. With G the world rotation of a joint in the source from there and d_s, d_t the directions
    of the same limb in that pose, the target's joint turns by G·C, where C is the shortest arc from d_t to d_s: both
    limbs then point the same way. Joints of the trunk that only the target has share the turn of those around them;
    other joints without a counterpart keep their rest pose. The path of the centre between the hips is scaled by the
    leg lengths, and raised or lowered once, so that a foot that stands flat on the floor does so afterwards (exactly
    where thigh and shin have the same proportions in both, as in the presets).

    Where both skeletons are one body (``Skeleton.order_in``) nothing moves, be there roles or not.

    Args:
        motion: on a skeleton whose joints ``rigs.roles`` recognises.
        target: "smpl", "mixamo", "vrm", "ue5", "hml22", "kit21", or any skeleton with recognisable joints; the result
            has its up axis.

    Warns:
        UserWarning: how the source's joints are turned had to be worked out.

    Raises:
        InputError: an unknown name, or a skeleton without recognisable legs or with legs of no length.
    """
    skeleton = get_rig(target) if isinstance(target, str) else target
    source = motion.skeleton
    if skeleton is source:
        return motion
    if (order := skeleton.order_in(source)) is not None:
        return Motion(motion.rotations[:, order], motion.root, motion.fps, skeleton)
    for body in (source, skeleton):
        if leg_length(body, roles(body)) < _SHORTEST_LEG:
            raise InputError(f"skeleton {body.name!r} has legs of no length, which say no size; give its bones lengths")
    theirs, ours = find_reference(motion), reference_at_rest(skeleton)
    if theirs.how == "derived":
        warnings.warn(
            f"skeleton {source.name!r} stands neither at rest nor in any frame as in a T-pose: how its joints are "
            "turned was worked out from bones, hinges and soles; look at the result",
            stacklevel=2,
        )
    there = _retarget_standing(
        on_floor(standing(motion, theirs)), stood(skeleton, ours), roles(source), roles(skeleton)
    )
    return as_before(there, skeleton, ours)


def _retarget_standing(motion: Motion, skeleton: Skeleton, theirs: Roles, ours: Roles) -> Motion:
    """Between skeletons that rest Y up, facing +Z."""
    source = motion.skeleton
    turned = motion.global_rotations
    wanted = {
        ours[role]: rotations.mul(turned[:, theirs[role]], _correction(source, theirs, skeleton, ours, role))
        for role in ours
        if role in theirs
    }
    wanted |= _between(turned, theirs, ours)
    above = ours["pelvis"]
    while (above := skeleton.parents[above]) >= 0:
        wanted[above] = rotations.heading(turned[:, theirs["pelvis"]])

    world: list[Tensor] = []
    for j, parent in enumerate(skeleton.parents):
        world.append(wanted[j] if j in wanted else world[parent])
    local = global_to_local(torch.stack(world, dim=1), skeleton)
    rigid = Motion(local, torch.zeros_like(motion.root), motion.fps, skeleton)
    root = _hip_centre(motion, skeleton, theirs, ours) - centre(rigid.joints, ours, "hip")
    return Motion(rotations.unroll(local), root, motion.fps, skeleton)


def _between(turned: Tensor, theirs: Roles, ours: Roles) -> dict[int, Tensor]:
    """Turns (F, 4) of joints of the trunk that only the target has: evenly between those that both have."""
    known = [k for k, role in enumerate(_TRUNK) if role in theirs]
    found = {}
    for low, high in itertools.pairwise(known):
        for k in range(low + 1, high):
            if _TRUNK[k] in ours:
                ends = (turned[:, theirs[_TRUNK[low]]], turned[:, theirs[_TRUNK[high]]])
                found[ours[_TRUNK[k]]] = rotations.slerp(*ends, (k - low) / (high - low))
    return found


def _correction(source: Skeleton, theirs: Roles, skeleton: Skeleton, ours: Roles, role: str) -> Tensor:
    """C (4,): from the target's rest direction of a limb to the source's; the identity for what is no limb."""
    start, end = _LIMBS.get(role, ("", ""))
    if not all(name in found for name in (start, end) for found in (theirs, ours)):
        # A forearm that ends nowhere goes on as the upper arm does at rest.
        above = role.replace("elbow", "shoulder").replace("wrist", "elbow")
        return _correction(source, theirs, skeleton, ours, above) if start and above != role else rotations.identity()
    d_s = source.rest_positions[theirs[end]] - source.rest_positions[theirs[start]]
    d_t = skeleton.rest_positions[ours[end]] - skeleton.rest_positions[ours[start]]
    return rotations.between(d_t, d_s)


def _hip_centre(motion: Motion, skeleton: Skeleton, theirs: Roles, ours: Roles) -> Tensor:
    """Where the point between the target's hips goes: (F, 3)."""
    scale = leg_length(skeleton, ours) / leg_length(motion.skeleton, theirs)
    lift = ankle_height(skeleton, ours) - scale * ankle_height(motion.skeleton, theirs)
    hips = centre(motion.joints, theirs, "hip")
    return scale * hips + hips.new_tensor((0.0, lift, 0.0))
