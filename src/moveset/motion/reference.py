"""A standing pose to compare bodies by: which way every joint's axes are turned while the body stands.

Rotations say nothing by themselves: a file's joints may have any axes and any zero pose (a T-pose, all bones along +X,
the axes of the world). What two bodies have in common is how they stand: upright, facing +Z, arms level or lowered.
The *reference* of a skeleton is the world rotation of each of its joints in such a pose, found in this order:

1. the rest pose, where that is one, whatever its up axis and facing;
2. the frame that is unmistakably a T- or A-pose;
3. made up from what cannot be otherwise (``moveset.motion.derived_pose``): hips and shoulders left and right, bones
   along their offsets, knees and elbows bending about their hinges, soles flat on the floor.

Thighs and upper arms are then turned about themselves so that knees and elbows bend about the same axes in all bodies,
where the motion shows these axes clearly. All but 1 depends on joint positions and on how joints turn relative to where
they were, so that equal positions give equal results, whatever the axes. F frames, J joints; float64.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.body_axes import (
    Roles,
    ankle_height,
    body_frame,
    centre,
    frame,
    leg_length,
    nearest_axis,
    snapped,
    to_upright,
    top,
    unit,
    unlike_standing,
    unlike_t_pose,
)
from moveset.motion.clip import Motion
from moveset.motion.derived_pose import by_hinges, derived_pose
from moveset.motion.rigs import RIGS, roles
from moveset.motion.skeleton import Skeleton

AXES = ("x", "y", "z", "-x", "-y", "-z")
_FRAMES = 400  # looked at, evenly spaced
_NEAR = 1e-6
_SURE, _MOSTLY = 0.7, 0.85  # of the mean body axis, along an axis of the world
_Y = torch.tensor((0.0, 1.0, 0.0), dtype=torch.float64)
_SOLE, _FAR = 0.09, 0.5  # of a leg


@dataclass(frozen=True, eq=False)
class Reference:
    """How a body stands.

    Args:
        turns: (J, 4) world rotation of each joint's axes in the reference pose, which is Y up and faces +Z.
        up: (4,) rotation that takes the world of the motion to Y up.
        how: "rest pose", "T-pose" or "derived".
    """

    turns: Tensor
    up: Tensor
    how: str

    @property
    def plain(self) -> bool:
        """Whether the rest pose itself stands Y up and faces +Z: nothing needs to be turned."""
        still = torch.cat((self.turns, self.up[None]))
        return bool((still[:, :3].abs() < _NEAR).all())


def axis_vector(name: str) -> Tensor:
    """(3,) float64 of "x", "-z", …

    Raises:
        InputError: another name.
    """
    if name not in AXES:
        raise InputError(f"axis {name!r} is not one of {', '.join(AXES)}; give one of these")
    out = torch.zeros(3, dtype=torch.float64)
    out["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return out


def find_reference(motion: Motion) -> Reference:
    """The reference of the body of a motion.

    Args:
        motion: whose joints ``rigs.roles`` recognises.

    Raises:
        InputError: legs cannot be recognised.
    """
    skeleton = motion.skeleton
    if skeleton in RIGS.values():
        return _still(len(skeleton))
    found, few = roles(skeleton), _few(motion)
    rest, upward = _world(few, None, None)
    turned, placed = few.global_rotations.double(), few.joints.double()
    placed, turned = rotations.rotate(upward, placed), rotations.mul(upward, turned)
    if rest is not None:
        return Reference(by_hinges(rest.turns, found, turned, placed), upward, "rest pose")
    if (turns := _t_pose(turned, placed, found)) is not None:
        return Reference(by_hinges(turns, found, turned, placed), upward, "T-pose")
    return Reference(derived_pose(skeleton, found, turned, placed, few.fps), upward, "derived")


def _few(motion: Motion) -> Motion:
    stride = max(1, -(-len(motion) // _FRAMES))
    few = motion[::stride]
    return replace(few, fps=max(motion.fps / stride, 0.01))


def _world(few: Motion, up: str | None, facing: str | None) -> tuple[Reference | None, Tensor]:
    """The reference by the rest pose, if that is a standing one, and (4,) the turn that makes the world Y up."""
    skeleton = few.skeleton
    rest = _of_rest(skeleton)
    upward = _world_up(rest, few.joints.double(), roles(skeleton)) if up is None else _turn_up(axis_vector(up))
    if facing is not None:
        # Where the rest pose looks is to be ahead: the whole world is turned.
        upward = _turn_up(rotations.rotate(rotations.inv(upward), _Y), axis_vector(facing))
        rest = None if rest is None else replace(rest, turns=upward.expand(len(skeleton), 4))
    return None if rest is None else replace(rest, up=upward), upward


@lru_cache(maxsize=64)
def reference_at_rest(skeleton: Skeleton) -> Reference:
    """The reference of a body of which there is no motion.

    Raises:
        InputError: legs cannot be recognised.
    """
    if skeleton in RIGS.values():
        return _still(len(skeleton))
    if (rest := _of_rest(skeleton)) is not None:
        return rest
    nothing = torch.zeros(0, len(skeleton), 4, dtype=torch.float64)
    return Reference(derived_pose(skeleton, roles(skeleton), nothing, nothing[..., :3], 1.0), _still(1).up, "derived")


def standing(motion: Motion, reference: Reference) -> Motion:
    """The same motion, Y up, on a skeleton whose rest pose is the reference pose: no joint moves."""
    if reference.plain:
        return motion
    return _turned(motion, stood(motion.skeleton, reference), reference.up, reference.turns)


def stood(skeleton: Skeleton, reference: Reference) -> Skeleton:
    """The skeleton at rest in its reference pose."""
    if reference.plain:
        return skeleton
    offsets = skeleton.offsets.double().clone()
    offsets[1:] = rotations.rotate(reference.turns[list(skeleton.parents[1:])], offsets[1:])
    # The root joint has no parent: where it says how high it rests, that is in the axes of the world.
    offsets[0] = rotations.rotate(reference.up, offsets[0])
    return replace(skeleton, offsets=offsets.to(skeleton.offsets.dtype))


def as_before(motion: Motion, skeleton: Skeleton, reference: Reference) -> Motion:
    """The way back of ``standing``: onto the skeleton with its own zero pose and its own up axis."""
    if reference.plain:
        return motion
    return _turned(motion, skeleton, rotations.inv(reference.up), rotations.inv(reference.turns))


def _turned(motion: Motion, skeleton: Skeleton, up: Tensor, turns: Tensor) -> Motion:
    """The motion on a skeleton whose joints' axes are those of the motion's turned by (J, 4), the world by (4,)."""
    up, turns = up.to(motion.root), turns.to(motion.root)
    above = torch.cat((_still(1).turns.to(turns), turns[list(skeleton.parents[1:])]))
    local = rotations.mul(above, rotations.mul(motion.rotations, rotations.inv(turns)))
    local[:, 0] = rotations.mul(up, local[:, 0])
    return Motion(rotations.unroll(rotations.normalize(local)), rotations.rotate(up, motion.root), motion.fps, skeleton)


def upright(motion: Motion, *, up: str | None = None, facing: str | None = None) -> Motion:
    """A motion from a file whose world or rest pose has another up axis or facing, Y up and facing +Z at rest.

    Where the rest pose is no standing one, the world alone is turned; where no legs are recognised, as ``up`` and
    ``facing`` say.

    Raises:
        InputError: an unknown axis.
    """
    skeleton = motion.skeleton
    if up is None and facing is None and skeleton in RIGS.values():
        return motion
    try:
        rest, upward = _world(_few(motion), up, facing)
    except InputError:
        if up is None and facing is None:
            return motion
        upward = _turn_up(axis_vector(up or "y"), None if facing is None else axis_vector(facing))
        rest = Reference(upward.expand(len(skeleton), 4), upward, "rest pose")
    if rest is not None:
        return standing(motion, rest)
    return motion if bool((upward[:3].abs() < _NEAR).all()) else motion.transformed(upward, torch.zeros(3))


def resting_upright(motion: Motion) -> Motion:
    """The motion on a skeleton that stands at rest, as pictures and skinned bodies need it: no joint moves.

    The same where the rest pose is a standing one, whichever way it faces, or where no legs are recognised.
    """
    if motion.skeleton in RIGS.values():
        return motion
    try:
        still = _of_rest(motion.skeleton) is not None
    except InputError:
        return motion
    if still:
        return motion
    found = find_reference(motion)
    return standing(motion, replace(found, up=_still(1).up))


def on_floor(motion: Motion) -> Motion:
    """Lowered by a little where all the time the toe joints stay above the floor as high as soles are thick, and set
    on the floor where the body is far from it, as where a file's root stands at height zero. In between it may well be
    off the floor: on steps, or in the air.

    The lowest 1 % of frames say where toe joints, and what is as far below the ankles, are; the body rests Y up.
    """
    skeleton, found = motion.skeleton, roles(motion.skeleton)
    if skeleton in RIGS.values():
        return motion
    leg = leg_length(skeleton, found)
    placed = motion.joints[..., 1]
    soles = [placed[:, found[f"{side}_ankle"]] - ankle_height(skeleton, found) for side in ("left", "right")]
    soles += [placed[:, found[role]] for role in ("left_foot", "right_foot") if role in found]
    low = torch.stack(soles).amin(dim=0).quantile(0.01)
    if not 0.0 < float(low) < _SOLE * leg and float(low.abs()) < _FAR * leg:
        return motion
    return replace(motion, root=motion.root - torch.stack((low * 0.0, low, low * 0.0)))


def _still(joints: int) -> Reference:
    one = rotations.identity(joints).double()
    return Reference(one, one[0], "rest pose")


def _turn_up(up: Tensor, facing: Tensor | None = None) -> Tensor:
    """(4,) the rotation that takes ``up`` to +Y and, if given, ``facing`` to +Z."""
    if facing is None:
        # Z up files face -Y, so that the shortest turn lets them face +Z.
        return rotations.between(up, _Y)
    if bool((up * facing).sum().abs() > 0.5):
        raise InputError("up and facing lie along one axis; give two different ones")
    return to_upright(torch.stack((torch.linalg.cross(up, facing), up, facing), dim=-1))


@lru_cache(maxsize=64)
def _of_rest(skeleton: Skeleton) -> Reference | None:
    """By the rest pose; None where nobody stands so."""
    found, placed = roles(skeleton), skeleton.rest_positions.double()
    axes = body_frame(placed, found)
    if not torch.isfinite(axes).all() or float(torch.linalg.det(axes)) < 0.5:
        return None
    axes = snapped(axes)
    if float(unlike_standing(placed, found, axes)) > 1.0:
        return None
    turn = to_upright(axes)
    # The world is turned up with the rest pose, but not about it: who looks elsewhere at rest walks as before.
    return Reference(turn.expand(len(skeleton), 4).clone(), _turn_up(nearest_axis(axes[:, 1])), "rest pose")


def _world_up(rest: Reference | None, placed: Tensor, found: Roles) -> Tensor:
    """(4,) the turn that makes the world Y up, by how the body stands in it."""
    ankles, hips = centre(placed, found, "ankle"), centre(placed, found, "hip")
    body = unit(top(placed, found) - ankles).mean(dim=0)
    along = nearest_axis(body)
    expected = rest.up if rest is not None else rotations.identity().double()
    if torch.equal(rotations.rotate(expected, along).round(), _Y):
        return expected
    # Somebody who lies all the time is not standing in a world turned over: there the feet would be at height zero.
    leg = (hips - ankles).norm(dim=-1).median()
    low, high = float((ankles @ along / leg).quantile(0.1)), float((hips @ along / leg).median())
    sure = float(body.abs().max()) > (_SURE if rest is None else _MOSTLY)
    if not (sure and -0.2 < low < 0.3 and 0.5 < high < 1.4):
        return expected
    return _turn_up(along)


def _t_pose(turned: Tensor, placed: Tensor, found: Roles) -> Tensor | None:
    """(J, 4) joints' axes in the frame that is unmistakably a T- or A-pose, turned to face +Z; None without one."""
    axes = body_frame(placed, found)
    unlike = unlike_t_pose(placed, found, axes)
    tilt = torch.rad2deg(torch.acos(axes[..., 1, 1].clamp(-1.0, 1.0)))
    unlike = torch.maximum(unlike, tilt / 15.0)
    best = int(unlike.argmin())
    if not float(unlike[best]) <= 1.0:
        return None
    level = frame(axes[best, :, 0], _Y) if float(tilt[best]) > 0.0 else axes[best]
    return rotations.mul(to_upright(level), turned[best])
