"""The mathematics of an armature: axes, bones, and what Blender calls a pose. No Blender in here.

Blender is Z up and its characters face -Y; moveset is Y up and faces +Z. Both are right-handed with left = +X, so a
quarter turn about X takes one to the other. A bone at rest has its own axes B (Y along the bone, turned about it by the
roll), and a pose channel holds what is done *before* B. With G the joint's turn from rest in the world, the bone stands
at G·B; with L the joint's local turn (G = G_parent·L) Blender's channel must hold B⁻¹·L·B, whatever the roll.
"""

from dataclasses import dataclass

import numpy as np

from . import quaternions as quat
from .take import Skeleton, Take

# How far a bone without a child reaches, metres, and how short a bone may be before Blender throws it away.
_END, _SHORTEST = 0.09, 1e-3
_FORWARD, _UP = np.array((0.0, -1.0, 0.0)), np.array((0.0, 0.0, 1.0))


def to_blender(v: np.ndarray) -> np.ndarray:
    """Vectors (..., 3), Y up facing +Z, as Blender has them: Z up facing -Y."""
    return np.stack((v[..., 0], -v[..., 2], v[..., 1]), axis=-1)


def from_blender(v: np.ndarray) -> np.ndarray:
    """The way back of ``to_blender``."""
    return np.stack((v[..., 0], v[..., 2], -v[..., 1]), axis=-1)


def turn_to_blender(q: np.ndarray) -> np.ndarray:
    """Rotations (..., 4) seen in Blender's axes."""
    return np.concatenate((to_blender(q[..., :3]), q[..., 3:]), axis=-1)


def turn_from_blender(q: np.ndarray) -> np.ndarray:
    """The way back of ``turn_to_blender``."""
    return np.concatenate((from_blender(q[..., :3]), q[..., 3:]), axis=-1)


@dataclass(frozen=True, eq=False)
class Bones:
    """An armature to build, in Blender's axes, standing on the floor.

    Args:
        heads: (J, 3) metres; where the joints are.
        tails: (J, 3) metres; where the bones point.
        rolls: (J, 3) directions that the bones' Z axes turn to.
    """

    heads: np.ndarray
    tails: np.ndarray
    rolls: np.ndarray


def bones_of(skeleton: Skeleton) -> Bones:
    """A bone for each joint, from the joint to the next; Z axes forward, or up where the bone itself points forward."""
    heads = to_blender(skeleton.rest_positions())
    heads[:, 2] -= heads[:, 2].min()
    children = [[c for c, p in enumerate(skeleton.parents) if p == j] for j in range(len(heads))]
    tails = np.empty_like(heads)
    for j, below in enumerate(children):
        # Of several the one in the middle: pelvis to spine, chest to neck.
        end = min(below, key=lambda c: (abs(heads[c, 0] - heads[j, 0]), -heads[c, 2]), default=None)
        bone = heads[end] - heads[j] if end is not None else np.zeros(3)
        if np.linalg.norm(bone) < _SHORTEST:
            bone = _END * _ending(skeleton, heads, j)
        tails[j] = heads[j] + bone
    along = (tails - heads) / np.linalg.norm(tails - heads, axis=1, keepdims=True)
    rolls = np.where((np.abs(along @ _FORWARD) > 0.7)[:, None], _UP, _FORWARD)
    return Bones(heads, tails, rolls)


def _ending(skeleton: Skeleton, heads: np.ndarray, j: int) -> np.ndarray:
    """Where the last bone of a chain points: toes ahead, a head up, hands as the arm does."""
    came = heads[j] - heads[skeleton.parents[j]] if j else _UP
    length = np.linalg.norm(came)
    came = came / length if length > _SHORTEST else _UP
    return max((_FORWARD, _UP, np.array((1.0, 0.0, 0.0)), np.array((-1.0, 0.0, 0.0)), -_UP), key=lambda d: came @ d)


@dataclass(frozen=True, eq=False)
class Rig:
    """An armature that is there, at rest in the world: metres, Blender's axes, its own place on the floor as origin.

    Args:
        name: of the armature.
        bones: names, parents before their children.
        parents: -1 where a bone has none.
        heads: (J, 3) metres.
        turns: (J, 4) the bones' axes.
    """

    name: str
    bones: tuple[str, ...]
    parents: tuple[int, ...]
    heads: np.ndarray
    turns: np.ndarray


@dataclass(frozen=True, eq=False)
class Pose:
    """What to key.

    Args:
        fps: frames a second.
        turned: index of a bone -> (F, 4) its channel's rotation.
        mover: index of the bone that carries the path.
        path: (F, 3) where that bone's head goes, metres, in the world as ``Rig`` has it.
        location: (F, 3) the same as its channel: along its own axes, from its place at rest, metres.
    """

    fps: float
    turned: dict[int, np.ndarray]
    mover: int
    path: np.ndarray
    location: np.ndarray


def pose_same(take: Take, rig: Rig) -> Pose:
    """The pose of a rig that has just the take's joints in their places: every joint turns, exactly."""
    local = turn_to_blender(take.rotations)
    # Blender keeps bones in an order of its own.
    bone_of = [rig.bones.index(joint) for joint in take.skeleton.joints]
    turned = {bone: channel(local[:, j], rig.turns[bone]) for j, bone in enumerate(bone_of)}
    path, mover = to_blender(take.root), bone_of[0]
    return Pose(take.fps, turned, mover, path, quat.rotate(quat.inv(rig.turns[mover]), path - rig.heads[mover]))


def channel(local: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """B⁻¹·L·B (F, 4), with signs that do not jump."""
    return quat.unroll(quat.normalize(quat.mul(quat.mul(quat.inv(rest), local), rest)))
