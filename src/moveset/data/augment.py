"""New clips out of takes: one after the other, the arms of one on the legs of another, bent ways, other paces, gaits
on the spot.

F frames, J joints. All of it works on ``hml22`` at one frame rate.
"""

import math
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from moveset.data.posture import standing
from moveset.errors import InputError
from moveset.motion import bend, rotations
from moveset.motion.cleanup import move_feet
from moveset.motion.clip import Motion, between_frames, concatenate
from moveset.motion.native import NativeCodec
from moveset.motion.skeleton import HML22
from moveset.motion.smoothing import gaussian_smooth, smoothstep, spans

MAX_FRAMES = 196

_QUIET = 0.25  # m/s that no joint exceeds
_HANGING = 0.15  # metres over the pelvis that no wrist is
_WRISTS = [HML22.index(f"{side}_wrist") for side in ("left", "right")]
_CORNER = 0.6  # metres of the radius of a corner, at least
_TURNING = math.radians(100.0)  # a second

_TOES = [HML22.index(f"{side}_foot") for side in ("left", "right")]
_STRIDE = 0.4  # seconds over which the way of a gait is smoothed: what is left of it is how the body sways
_LIFTED, _HIGHEST = 0.12, 0.3  # of a stride, and metres, by which a foot rises more that goes nowhere

Arms = Literal["left", "right", "both"]

_ARM = ("collar", "shoulder", "elbow", "wrist")
_TRUNK = ("spine3", "neck", "head")


def _upper_joints(arms: Arms) -> list[int]:
    sides = ("left", "right") if arms == "both" else (arms,)
    names = [f"{side}_{part}" for side in sides for part in _ARM]
    return [HML22.index(name) for name in (*_TRUNK, *names)] if arms == "both" else [HML22.index(n) for n in names]


def _same_kind(a: Motion, b: Motion) -> None:
    if a.skeleton.name != "hml22" or b.skeleton.name != "hml22" or a.fps != b.fps:
        raise InputError(
            f"only motions on 'hml22' with one frame rate can be composed; got {a.skeleton.name!r} at {a.fps:g} fps "
            f"and {b.skeleton.name!r} at {b.fps:g} fps"
        )


def _travel(motion: Motion) -> tuple[Tensor, Tensor]:
    """Steps between frames, in the heading of the earlier one: yaw (F-1,) radians, displacement (F-1, 3) metres."""
    facing = rotations.heading(motion.rotations[:, 0])
    turn = rotations.heading_angle(rotations.mul(facing[1:], rotations.inv(facing[:-1])))
    return turn, rotations.rotate(rotations.inv(facing[:-1]), motion.root[1:] - motion.root[:-1])


def compose_in_time(a: Motion, b: Motion, blend_frames: int) -> Motion:
    """First ``a``, then ``b``, which starts where ``a`` leads: the last frames of ``a`` fade into the first of ``b``.

    In the overlap joint rotations are interpolated, and so are the *velocities* of the root (turning rate, planar
    velocity in the body's own heading), which are then summed up: no jump in place, heading or speed.

    Args:
        a: (F_a, J) motion.
        b: (F_b, J) motion; only its relative travel matters, it is put where ``a`` ends.
        blend_frames: frames of overlap, at least 1 and fewer than either motion has.

    Returns:
        F_a + F_b - blend_frames frames, at most 196.

    Raises:
        InputError: motions that do not fit together, a blend that does not fit, or too many frames.
    """
    _same_kind(a, b)
    n = blend_frames
    if not 1 <= n < min(len(a), len(b)):
        raise InputError(f"{n} blend frames do not fit motions of {len(a)} and {len(b)} frames; use fewer")
    total = len(a) + len(b) - n
    if total > MAX_FRAMES:
        raise InputError(f"the composition has {total} frames, more than the limit of {MAX_FRAMES}; shorten the parts")
    w = smoothstep(torch.arange(1, n + 1) / (n + 1))
    tail = a[len(a) - n - 1 :]
    (turn_a, step_a), (turn_b, step_b) = _travel(tail), _travel(b[: n + 1])
    # Frame k of the overlap is reached by the step of ``a`` into it and by the step of ``b`` out of its counterpart.
    turn = torch.lerp(turn_a, turn_b, w)
    step = torch.lerp(step_a, step_b, w[:, None])
    angle = rotations.heading_angle(tail.rotations[0, 0]) + torch.cat((turn.new_zeros(1), turn.cumsum(0)))
    place = tail.root[0] + rotations.rotate(rotations.yaw(angle[:-1]), step).cumsum(0)
    place[:, 1] = torch.lerp(tail.root[1:, 1], b.root[:n, 1], w)
    local = rotations.slerp(_without_heading(tail[1:]), _without_heading(b[:n]), w[:, None])
    local[:, 0] = rotations.mul(rotations.yaw(angle[1:]), local[:, 0])
    blended = replace(a, rotations=local, root=place)
    # The rest of b follows rigidly: its first step after the overlap continues from the last blended frame.
    last = b[n - 1 :]
    turned = rotations.mul(rotations.yaw(angle[-1]), rotations.inv(rotations.heading(last.rotations[0, 0])))
    shift = (place[-1] - rotations.rotate(turned, last.root[0])) * torch.tensor((1.0, 0.0, 1.0))
    rest = last.transformed(turned, shift)[1:]
    return concatenate([a[: len(a) - n], blended, rest]).canonical()


def _without_heading(motion: Motion) -> Tensor:
    """(F, J, 4) local rotations with the heading of the root removed."""
    facing = rotations.inv(rotations.heading(motion.rotations[:, 0]))
    return torch.cat((rotations.mul(facing, motion.rotations[:, 0])[:, None], motion.rotations[:, 1:]), dim=1)


def stretched(motion: Motion, frames: int) -> Motion:
    """The whole motion, slower or faster, in another number of frames: slerp between frames, linear for the root."""
    if frames == len(motion):
        return motion
    return between_frames(motion, torch.linspace(0, len(motion) - 1, frames))


def compose_body(upper: Motion, lower: Motion, arms: Arms = "both") -> Motion:
    """The arms of ``upper``, stretched to the length of ``lower``, on the legs, hips and travel of ``lower``.

    With both arms the chest, neck and head come from ``upper`` too; with one arm only that arm does, so that the other
    one keeps swinging.

    Raises:
        InputError: motions that do not fit together, or whose lengths differ by more than a factor of 1.5: that would
            make the arms unnaturally fast or slow.
    """
    _same_kind(upper, lower)
    if not 2 / 3 <= len(upper) / len(lower) <= 1.5:
        raise InputError(
            f"the upper body has {len(upper)} frames and the lower {len(lower)}; crop them to within a factor of 1.5"
        )
    local = lower.rotations.clone()
    joints = _upper_joints(arms)
    local[:, joints] = stretched(upper, len(lower)).rotations[:, joints]
    return replace(lower, rotations=local).canonical()


def bent(motion: Motion, turn: float, sharp: bool) -> Motion:
    """The same steps on a way that turns by ``turn`` radians to the left in all, as far as feet can follow.

    Args:
        turn: radians.
        sharp: in the middle of the way, as around a corner; otherwise all along it.
    """
    codec = NativeCodec()
    features = codec.encode(motion)
    way = float(bend.steps(features[:-1], codec).sum())
    width = min(abs(turn) * corner_radius(motion), way) if sharp else way

    def heading(gone: Tensor) -> Tensor:
        return turn * ((gone - 0.5 * (way - width)) / max(width, 1e-6)).clamp(0.0, 1.0)

    return codec.decode(bend.led(features, codec, heading)).canonical()


def corner_radius(motion: Motion) -> float:
    """Metres of the radius of the sharpest corner that somebody goes round who is as fast as this."""
    path = motion.root[:, [0, 2]]
    return max(_CORNER, float(path.diff(dim=0).norm(dim=1).mean()) * motion.fps / _TURNING)


def quiet_moments(motion: Motion, least: int) -> list[tuple[int, int]]:
    """Stretches (start, stop) of at least so many frames in which somebody stands upright with hanging hands."""
    joints = motion.joints
    if len(joints) < least:
        return []
    speed = joints.diff(dim=0).norm(dim=-1).amax(dim=1) * motion.fps
    hanging = (joints[:, _WRISTS, 1] < joints[:, :1, 1] + _HANGING).all(dim=1)
    still = (speed < _QUIET) & hanging[1:] & hanging[:-1] & standing(motion.global_rotations, joints)[:-1]
    return [(start, stop + 1) for start, stop in spans(still) if stop + 1 - start >= least]


def legs_differ(a: Motion, b: Motion) -> bool:
    """Whether pelvis and thighs of two motions point so differently that the arms of one look wrong on the other."""
    frames = min(len(a), len(b))
    down = a.root.new_tensor((0.0, -1.0, 0.0))
    tilt = [rotations.rotate(m.global_rotations[:frames, 0], down)[:, 1].amax() for m in (a, b)]
    height = [m.root[:frames, 1].amin() for m in (a, b)]
    return bool(max(tilt) > -0.9 or min(height) < 0.75)


def on_the_spot(motion: Motion) -> Motion:
    """A gait without its way: the body sways as it did, and each foot rises and comes down where it is.

    Feet keep their height over the floor and their angle; one that went far rises higher.

    Args:
        motion: (F, J) somebody who walks or runs ahead; ways may be bent.
    """
    toes, level = motion.joints[:, _TOES].double(), motion.root.new_tensor((1.0, 0.0, 1.0)).double()
    line = torch.lerp(*(motion.root[end].double().expand(len(motion), 3) for end in (0, -1)), _shares(len(motion)))
    way = (line + gaussian_smooth(motion.root.double() - line, _STRIDE * motion.fps)) * level
    ahead = torch.gradient(way, dim=0)[0]
    pace = float(ahead.norm(dim=-1).mean())
    ahead = torch.nn.functional.normalize(ahead, dim=-1)[:, None]
    along = ((toes - way[:, None]) * ahead).sum(dim=-1)
    shift = (along.mean(dim=0) - along)[..., None] * ahead
    gone = torch.gradient(toes * level, dim=0)[0].norm(dim=-1)
    for side in (0, 1):
        for start, stop in spans(gone[:, side] > pace):
            stride = float((toes[stop - 1, side] - toes[start, side]).norm())
            rise = torch.sin(_shares(stop - start)[:, 0] * math.pi).square()
            shift[start:stop, side, 1] += min(_LIFTED * stride, _HIGHEST) * rise
    moved = move_feet(replace(motion, root=motion.root - (way - way[0]).to(motion.root)), shift)
    return replace(moved, rotations=moved.rotations.float(), root=moved.root.float()).canonical()


def _shares(count: int) -> Tensor:
    """(count, 1) float64 from 0 to 1."""
    return torch.linspace(0.0, 1.0, count, dtype=torch.float64)[:, None]
