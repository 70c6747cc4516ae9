"""Clips one after the other, and clips that repeat, without a pop. F frames, J joints.

At a seam two clips differ in pose and in speed. Both sides give way by half: an offset that is half the difference at
the seam, and starts with half the difference of the speeds, dies away into either clip (``smoothing.decay``). Poses and
their speeds are then continuous, and nothing changes beyond the blend.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.cleanup import lock_feet
from moveset.motion.clip import Motion, concatenate
from moveset.motion.contacts import stances
from moveset.motion.positions import HINGES
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import Skeleton
from moveset.motion.smoothing import decay

_SEAM = 0.5  # frames outside the clips
_TREND = 0.5  # share of the acceleration at its edge with which a clip is taken to go on
_LONGEST = 2.0  # times the blend asked for


def join(motions: Sequence[Motion], blend_seconds: float = 0.3) -> Motion:
    """One motion of all clips: each goes on from where, and in the direction in which, the one before it ended.

    The first frame of a clip follows one frame after the last of the clip before; no frame is added or lost. The blend
    reaches ``blend_seconds`` into both clips, or up to twice that where their poses differ so much that it would jerk
    more than the clips themselves do, and at most half of a clip; clips that fit as they are stay so. Feet may slide in
    a blend: ``lock_feet`` after.

    Raises:
        InputError: no clips, a clip of one frame, different skeletons (``Skeleton.order_in``) or frame rates, or a
            duration that is negative or not finite.
    """
    if not motions or not 0 <= blend_seconds < math.inf:
        raise InputError(
            f"joining takes clips and a blend of 0 s or more; got {len(motions)} clips and {blend_seconds} s"
        )
    first = motions[0]
    for number, motion in enumerate(motions[1:], start=2):
        if first.skeleton.order_in(motion.skeleton) is None:
            raise InputError(
                f"clips to join must be on one skeleton; clip {number} is on {motion.skeleton.name!r} and has other "
                f"joints or bones than clip 1 on {first.skeleton.name!r}: retarget it first "
                "(moveset.motion.retarget.retarget(clip, clips[0].skeleton))"
            )
        if motion.fps != first.fps:
            raise InputError(
                f"clips to join must have one frame rate; clip {number} has {motion.fps:g} and clip 1 {first.fps:g} "
                "fps: resample it first (clip.resampled)"
            )
    if len(motions) == 1:
        return first
    if min(len(m) for m in motions) < 2:
        raise InputError("a clip of one frame has no direction to go on in; join clips of at least 2 frames")

    done = [_doubled(first)]
    for motion in motions[1:]:
        # The seam is the instant halfway between the last frame and the first.
        end, clip = _Edge.of(done[-1], last=True, beyond=_SEAM), _doubled(retarget(motion, first.skeleton))
        clip = clip.transformed(*_placement(end, _Edge.of(clip, last=False, beyond=_SEAM)))
        gap = _Gap.between(end, _Edge.of(clip, last=False, beyond=_SEAM), beyond=_SEAM)
        reach = 0.0 if _fit(done[-1], clip) else _gentle(done[-1], clip, blend_seconds * first.fps)
        done[-1] = gap.closed(done[-1], reach, last=True)
        done.append(gap.closed(clip, reach, last=False))
    turned = rotations.unroll(torch.cat([m.rotations for m in done]))
    return Motion(turned.float(), torch.cat([m.root for m in done]).float(), first.fps, first.skeleton)


def make_loop(motion: Motion, blend_seconds: float = 0.5) -> Motion:
    """The motion made to repeat: its last frame has the pose and the speed of its first, and takes its place.

    Equal are all local rotations, the pelvis' tilt and its height; place and heading go on from cycle to cycle, as a
    walk does (play it again from ``canonical`` placement, or take ``in_place`` first to stay). The difference between
    end and start is shared by both and dies away within ``blend_seconds``, or up to twice that as in ``join``. On
    skeletons with known knees (hml22, kit21) feet that the clip has planted there stay planted, and none goes further
    under the floor y = 0 than the clip's own do; what that changes dies away within as much again.

    Raises:
        InputError: fewer than 4 frames, or a duration that is negative or not finite.
    """
    if len(motion) < 4 or not 0 <= blend_seconds < math.inf:
        raise InputError(
            f"a loop takes 4 frames or more and a blend of 0 s or more; got {len(motion)}, {blend_seconds} s"
        )
    clip = _doubled(motion)
    end, start = _Edge.of(clip, last=True, beyond=0.0), _Edge.of(clip, last=False, beyond=0.0)
    turn, shift = _placement(end, start)
    again = clip.transformed(turn, shift)
    gap = _Gap.between(end, _Edge.of(again, last=False, beyond=0.0), beyond=0.0)
    reach, half = _gentle(clip, again, blend_seconds * motion.fps), len(clip) // 2
    ended, started = gap.closed(clip, reach, last=True)[half:], gap.closed(again, reach, last=False)[1:half]
    # One cycle with the seam inside: what is done to the seam's frame is done to the loop's first and its last.
    around, seam = _one_after_the_other(ended, started), len(ended) - 1
    if reach and _knees_known(motion.skeleton):
        around = _with_feet_held(around, clip, seam, reach)
    back = rotations.inv(turn)
    started = around[seam:].transformed(back, -rotations.rotate(back, shift))
    loop = _one_after_the_other(started, around[: seam + 1])
    return Motion(loop.rotations.float(), loop.root.float(), motion.fps, motion.skeleton)


def without_net_turn(motion: Motion) -> Motion:
    """The motion ending as it began in its heading: the turn between first and last frame is taken back evenly."""
    heading_F = rotations.heading_angle(motion.rotations[:, 0].double())
    turn = rotations.heading_angle(rotations.yaw(heading_F[-1] - heading_F[0]))
    back_F = -turn * torch.linspace(0.0, 1.0, len(motion), dtype=torch.float64)
    turned = motion.rotations.clone()
    turned[:, 0] = rotations.yawed(turned[:, 0].double(), back_F).to(turned)
    return replace(motion, rotations=turned)


def _knees_known(skeleton: Skeleton) -> bool:
    """Whether its feet can be locked; a name alone promises no joints."""
    hinges = HINGES.get(skeleton.name, {})
    return bool(hinges) and hinges.keys() <= {*skeleton.joints} and len(skeleton.feet) == 4


def _one_after_the_other(before: Motion, after: Motion) -> Motion:
    """Frames of two clips as they are."""
    both = concatenate([before, after])
    return replace(both, rotations=rotations.unroll(both.rotations))


def _with_feet_held(around: Motion, clip: Motion, seam: int, reach: float) -> Motion:
    """A cycle ``around`` the seam of a loop, its feet near the seam held where the clip has planted them.

    A foot that slides in the blend is not found planted by its speed there, hence the contacts of the clip itself; at
    the seam those of its end and of its start.
    """
    floor = clip.joints[:, list(clip.skeleton.feet), 1].min().clamp(max=0.0)
    up = torch.stack((torch.zeros_like(floor), -floor, torch.zeros_like(floor)))
    planted = stances(clip.joints + up, clip.fps, clip.skeleton)
    half = len(clip) - 1 - seam
    contacts = torch.cat((planted[half:-1], planted[:1] | planted[-1:], planted[1:half]))
    upright = rotations.identity()
    held = lock_feet(around.transformed(upright, up), contacts=contacts).transformed(upright, -up)
    # Nothing at the far end, where both halves of the clip meet as they are.
    away, far = (torch.arange(len(around)) - seam).abs(), min(2.0 * reach, seam + 1.0, half)
    share = ((far - away) / (far - min(reach, 0.5 * far))).clamp(0.0, 1.0).double()
    share = share**2 * (3.0 - 2.0 * share)
    turned = rotations.slerp(around.rotations, held.rotations.double(), share[:, None])
    return Motion(turned, torch.lerp(around.root, held.root.double(), share[:, None]), clip.fps, clip.skeleton)


@dataclass(frozen=True, eq=False)
class _Edge:
    """Pose and speed of a clip at a seam: rotations (J, 4), root (3,), and their change a frame (J, 3) and (3,)."""

    turned: Tensor
    root: Tensor
    spin: Tensor
    step: Tensor

    @classmethod
    def of(cls, motion: Motion, last: bool, beyond: float) -> "_Edge":
        """At the end or the start of a motion, ``beyond`` frames outside, where it goes on as it does at its edge."""
        edge = motion[-3:] if last else motion[:3]
        spins = rotations.to_rotvec(rotations.mul(edge.rotations[1:], rotations.inv(edge.rotations[:-1])))
        steps = torch.diff(edge.root, dim=0)
        # Differences of frames are speeds half a frame inside the edge.
        ahead = (0.5 + beyond) * _TREND
        spin = spins[-1] + ahead * (spins[-1] - spins[0]) if last else spins[0] + ahead * (spins[0] - spins[-1])
        step = steps[-1] + ahead * (steps[-1] - steps[0]) if last else steps[0] + ahead * (steps[0] - steps[-1])
        near, out = (-1, beyond) if last else (0, -beyond)
        turned = rotations.mul(rotations.from_rotvec(out * spin), edge.rotations[near])
        return cls(turned, edge.root[near] + out * step, spin, step)


@dataclass(frozen=True, eq=False)
class _Gap:
    """What a clip's start lacks to be the end before it: half of it goes to either side."""

    beyond: float
    turned: Tensor
    spin: Tensor
    root: Tensor
    step: Tensor

    @classmethod
    def between(cls, end: _Edge, start: _Edge, beyond: float) -> "_Gap":
        turned = rotations.to_rotvec(rotations.mul(end.turned, rotations.inv(start.turned)))
        # Spins are compared in the pose in the middle, where both sides will meet.
        spin = rotations.rotate(rotations.from_rotvec(-0.5 * turned), end.spin) - rotations.rotate(
            rotations.from_rotvec(0.5 * turned), start.spin
        )
        return cls(beyond, turned, spin, end.root - start.root, end.step - start.step)

    def closed(self, motion: Motion, reach: float, last: bool) -> Motion:
        """The clip before (``last``) or after the seam, having given way within ``reach`` frames."""
        count = int(min(reach, len(motion) // 2))
        if count == 0:
            return motion
        sign = -1.0 if last else 1.0
        at = torch.arange(count, dtype=torch.float64) + self.beyond
        # Time runs away from the seam on both sides, which turns the sign of the speeds before it.
        turn = decay(0.5 * sign * self.turned, 0.5 * self.spin, count + self.beyond, at)
        shift = decay(0.5 * sign * self.root, 0.5 * self.step, count + self.beyond, at)
        if last:
            turn, shift = turn.flip(0), shift.flip(0)
        frames = slice(len(motion) - count, None) if last else slice(0, count)
        turned, root = motion.rotations.clone(), motion.root.clone()
        turned[frames] = rotations.mul(rotations.from_rotvec(turn), turned[frames])
        root[frames] += shift
        return Motion(rotations.normalize(turned), root, motion.fps, motion.skeleton)


def _placement(end: _Edge, start: _Edge) -> tuple[Tensor, Tensor]:
    """Turn about Y and horizontal shift that bring a clip's start to where, and how headed, another ended."""
    turn = rotations.mul(rotations.heading(end.turned[0]), rotations.inv(rotations.heading(start.turned[0])))
    shift = end.root - rotations.rotate(turn, start.root)
    return turn, shift * shift.new_tensor((1.0, 0.0, 1.0))


def _fit(before: Motion, after: Motion) -> bool:
    """Whether one clip goes on in the other without jerking more than the clips themselves do."""
    if min(len(before), len(after)) < 4:
        return False
    own = torch.maximum(_jerk(before.joints).max(), _jerk(after.joints).max())
    return bool(_jerk(torch.cat((before.joints[-3:], after.joints[:3]))).max() <= own)


def _gentle(before: Motion, after: Motion, reach: float) -> float:
    """Frames to blend over, from ``reach`` to ``_LONGEST`` times that, so as to jerk about as much as the clips do."""
    if min(len(before), len(after)) < 4 or reach == 0:
        return reach
    end, start = before.joints[-2:], after.joints[:2]
    gap = (start[0] - end[1]).norm(dim=-1).mean()
    speed = (start[1] - start[0] - end[1] + end[0]).norm(dim=-1).mean()
    usual = torch.cat((_jerk(before.joints), _jerk(after.joints))).mean().clamp_min(1e-9)
    # Third derivatives of ``decay`` at its start, for half of the gap and half of the speed.
    needed = torch.maximum((30.0 * gap / usual) ** (1 / 3), (18.0 * speed / usual) ** 0.5)
    return reach * float((needed / reach).clamp(1.0, _LONGEST))


def _jerk(joints: Tensor) -> Tensor:
    """(F - 3,) third differences, mean over joints."""
    size: Tensor = torch.diff(joints, n=3, dim=0).norm(dim=-1).mean(dim=-1)
    return size


def _doubled(motion: Motion) -> Motion:
    return Motion(motion.rotations.double(), motion.root.double(), motion.fps, motion.skeleton)
