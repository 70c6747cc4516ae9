"""Repairs of finished motions: feet that hold still while they stand, bodies above the floor. F frames."""

from itertools import pairwise
from math import dist

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import stances, stands_on
from moveset.motion.floor import above_floor
from moveset.motion.hover import SOLE, set_down
from moveset.motion.kinematics import global_to_local
from moveset.motion.positions import HINGES
from moveset.motion.skeleton import Skeleton
from moveset.motion.smoothing import gaussian_smooth, settle, spans
from moveset.motion.two_bone_ik import two_bone

_BLEND = 0.25  # seconds for a foot to leave or reach its locked place
_HEEL = 0.35  # radians by which a heel rises at most to let its toe stay
_STRIDE = 0.3  # metres that the body may carry a standing foot before it takes a step
_CLEARANCE = 0.07  # metres that such a step rises
ALONE = 1.5  # times as far it is carried while the other foot is in the air, and then it slides
LANDING = 0.1  # seconds in which a planted foot that is above the floor comes down to it
_GENTLE = 0.1  # seconds before and after a foot is under the floor in which it rises and falls


def lock_feet(motion: Motion, contacts: Tensor | None = None) -> Motion:
    """Feet that stay where they stand: planted toes (or ankles) are pinned in place and legs follow by two-bone IK.

    Each stance is pinned to where its foot moves least; on the way into and out of it the shift dies away smoothly. A
    foot that the body carries far off takes a step instead of sliding. Planted feet above the floor y = 0 come down to
    it, and feet below it are lifted onto it; otherwise they keep their height, and their orientation as long as legs
    reach (``move_feet``). A body that hovers is set down (``hover.set_down``), and what is in the floor comes
    out of it (``floor.above_floor``); else nothing above the hips moves. Feet of somebody who sits, kneels, lies or is
    upside down are free.

    Args:
        motion: on a skeleton with feet and known knees (hml22, kit21).
        contacts: (F, 4) bool planted left ankle, left toe, right ankle, right toe, e.g. a model's own; by default found
            by height and speed.

    Returns:
        The same number of frames.

    Raises:
        InputError: contacts of another shape, or a skeleton without known knees.
    """
    if contacts is not None and tuple(contacts.shape) != (len(motion), 4):
        raise InputError(f"contacts must be (F, 4) = ({len(motion)}, 4), got {tuple(contacts.shape)}")
    legs = _legs(motion.skeleton)
    if len(motion) < 4:
        return motion
    motion = set_down(motion)
    joints = motion.joints.double()
    carried = stands_on(joints, motion.skeleton)
    planted = stances(joints, motion.fps, motion.skeleton, contacts) & carried[:, None]
    shifts = []
    for side in range(len(legs)):
        pair = list(motion.skeleton.feet[2 * side : 2 * side + 2])
        blend = max(round(_BLEND * motion.fps), 2)
        own = slice(2 * side, 2 * side + 2)
        others = planted[:, 2 - 2 * side : 4 - 2 * side].any(dim=1)
        planted[:, own], height = _take_steps(joints[:, pair], planted[:, own], others, blend)
        lowest = joints[:, pair, 1].amin(dim=1)
        down = _touch_down(lowest, planted[:, own].any(dim=1), motion.fps)
        up = height - down + _lift((lowest - down) * carried, motion.fps)
        shifts.append(_pinned(joints[:, pair], planted[:, own], blend) + _upward(up))
    locked = move_feet(motion, torch.stack(shifts, dim=1))
    return above_floor(Motion(locked.rotations.float(), motion.root, motion.fps, motion.skeleton))


def move_feet(motion: Motion, shifts: Tensor) -> Motion:
    """The left and the right foot moved by ``shifts`` (F, 2, 3) metres; legs follow by two-bone IK, in float64.

    Nothing above the hips moves. Feet keep their orientation while their legs reach that far; then heels rise with the
    toes in place, and what even that does not reach slides over the floor, for a foot must not be drawn up into the
    air.

    Raises:
        InputError: a skeleton without known knees.
    """
    joints, turned = motion.joints.double(), motion.global_rotations.double().clone()
    hips, knees, ankles = (list(row) for row in zip(*_legs(motion.skeleton), strict=True))
    toes = [motion.skeleton.children[ankle][0] for ankle in ankles]
    bends = turned.new_tensor([HINGES[motion.skeleton.name][motion.skeleton.joints[knee]] for knee in knees])
    leg = torch.stack((joints[:, hips], joints[:, knees], joints[:, ankles]), dim=-2)
    reach = reachable(leg, joints[:, ankles] + shifts)
    target, heel = raise_heels(leg[..., 0, :], joints[:, ankles] + shifts, joints[:, toes] + shifts, reach)
    start, middle, end = leg.unbind(-2)
    hinge = rotations.rotate(turned[:, hips], bends)
    turned[:, hips], turned[:, knees] = two_bone(turned[:, hips], turned[:, knees], start, middle, end, target, hinge)
    turned[:, ankles] = rotations.mul(heel, turned[:, ankles])
    local = rotations.unroll(rotations.normalize(global_to_local(turned, motion.skeleton)))
    return Motion(local, motion.root, motion.fps, motion.skeleton)


def _legs(skeleton: Skeleton) -> list[tuple[int, int, int]]:
    """Hip, knee and ankle of the left and the right leg."""
    knees = [skeleton.joints.index(joint) for joint in HINGES.get(skeleton.name, {}) if joint.endswith("knee")]
    if len(knees) != 2 or len(skeleton.feet) != 4:
        raise InputError(f"feet can be locked on {' and '.join(HINGES)} only, not on {skeleton.name!r}; retarget after")
    return [(skeleton.parents[knee], knee, skeleton.children[knee][0]) for knee in sorted(knees)]


def step_heights(frames: int) -> Tensor:
    """How high (frames,) a foot is raised that comes to another place instead of sliding there."""
    at = torch.arange(1, frames + 1, dtype=torch.float64) / (frames + 1)
    return _CLEARANCE * (at * torch.pi).sin() ** 2


def _take_steps(foot: Tensor, planted: Tensor, other: Tensor, blend: int) -> tuple[Tensor, Tensor]:
    """Stances in which the body carries a foot (F, 2, 3) far, taken apart: (F, 2) planted, and (F,) how high it steps.

    Pinned to one place, such a foot would slide when its leg is stretched. Nobody steps while the ``other`` foot (F,)
    does not stand.
    """
    path, stands, supported = foot.mean(dim=1)[:, [0, 2]].tolist(), planted.any(dim=1).tolist(), other.tolist()
    planted, height, start = planted.clone(), foot.new_zeros(len(foot)), 0
    for frame in range(len(foot)):
        if frame < start or not stands[frame] or not stands[start]:
            start = max(start, frame)
        elif dist(path[frame], path[start]) > _STRIDE * (1.0 if supported[frame] else ALONE):
            start = min(frame + blend // 2 + 1, len(foot))
            steps = slice(max(start - blend, 0), start)
            planted[steps] = False
            if supported[frame]:
                height[steps] = step_heights(start - steps.start)
    return planted, height


def _pinned(foot: Tensor, planted: Tensor, blend: int) -> Tensor:
    """(F, 3) horizontal shifts of one foot (F, 2, 3: ankle, toe) that hold its planted joint (F, 2) in place."""
    shift = torch.zeros_like(foot[:, 0])
    flat = foot * foot.new_tensor((1.0, 0.0, 1.0))
    # The toe is the pivot wherever it is down; the ankle only while the foot stands on its heel.
    pivot, stands = planted[:, 1].int().tolist(), planted.any(dim=1)
    for start, end in spans(stands):
        shift[start:end] = _stance(flat[start:end], pivot[start:end])
    return settle(shift, stands, blend)


def _stance(flat: Tensor, pivot: list[int]) -> Tensor:
    """Shifts of one stance (N, 2, 3): its longest run is pinned to where it moves least, the others follow from it."""
    edges = [0, *(n for n in range(1, len(pivot)) if pivot[n] != pivot[n - 1]), len(pivot)]
    runs = list(pairwise(edges))
    main = max(range(len(runs)), key=lambda k: (runs[k][1] - runs[k][0], pivot[runs[k][0]]))
    start, end = runs[main]
    held = flat[start:end, pivot[start]]
    shift = torch.zeros_like(flat[:, 0])
    shift[start:end] = _stillest(held) - held
    for begin, stop in runs[main + 1 :]:
        p = flat[:, pivot[begin]]
        shift[begin:stop] = p[begin - 1] + shift[begin - 1] - p[begin:stop]
    for begin, stop in reversed(runs[:main]):
        p = flat[:, pivot[begin]]
        shift[begin:stop] = p[stop] + shift[stop] - p[begin:stop]
    return shift


def reachable(leg: Tensor, ankle: Tensor) -> Tensor:
    """How far from the hip an ankle (..., 3) that is wanted there may be (...): a knee never snaps straight.

    All of the way up to the present reach of the leg (..., 3, 3: hip, knee, ankle), of what is left of its length ever
    less.
    """
    bones = torch.diff(leg, dim=-2).norm(dim=-1).sum(dim=-1)
    reach = (leg[..., 2, :] - leg[..., 0, :]).norm(dim=-1)
    wanted = (ankle - leg[..., 0, :]).norm(dim=-1)
    room = (bones - reach).clamp_min(1e-9)
    stretch = (wanted - reach).clamp_min(0.0)
    return torch.minimum(wanted, reach) + room * -torch.expm1(-stretch / room)


def raise_heels(hip: Tensor, ankle: Tensor, toe: Tensor, reach: Tensor) -> tuple[Tensor, Tensor]:
    """Where ankles come to that are wanted beyond the leg's reach, and the world rotations (..., 4) of their feet.

    The foot turns about its toe, in the plane of hip, toe and ankle, until the ankle is near enough, by up to
    ``_HEEL``; then it slides towards the spot below the hip, at the height that it has.

    Args:
        hip: (..., 3).
        ankle: (..., 3), where it is wanted.
        toe: (..., 3), likewise.
        reach: (...), the longest distance from hip to ankle.
    """
    foot, leg = ankle - toe, hip - toe
    length, far = foot.norm(dim=-1), leg.norm(dim=-1)

    def opening(distance: Tensor) -> Tensor:
        """Angle at the toe between hip and ankle, where these are so far apart."""
        return ((length**2 + far**2 - distance**2) / (2 * length * far).clamp_min(1e-12)).clamp(-1.0, 1.0).acos()

    short = (ankle - hip).norm(dim=-1) > reach + 1e-9
    needed = (opening((ankle - hip).norm(dim=-1)) - opening(reach)).clamp(0.0, _HEEL)
    axis = torch.nn.functional.normalize(torch.linalg.cross(foot, leg), dim=-1)
    angle = torch.where(short, needed, 0.0)
    heel = rotations.from_axis_angle(axis, angle)
    risen = toe + rotations.rotate(heel, foot)
    # The rest: level, so that nothing leaves the floor.
    to = risen - hip
    level = to[..., [0, 2]].norm(dim=-1)
    room = (reach**2 - to[..., 1] ** 2).clamp_min(0.0).sqrt()
    share = torch.where(short, (room / level.clamp_min(1e-9)).clamp(max=1.0), 1.0)
    return hip + to * torch.stack((share, torch.ones_like(share), share), dim=-1), heel


def _stillest(path: Tensor) -> Tensor:
    """Mean (3,) of a path (N, 3), its slow parts weighing most."""
    step = torch.diff(path, dim=0).norm(dim=-1)
    if len(step) == 0:
        return path[0]
    speed = torch.maximum(torch.cat((step[:1], step)), torch.cat((step, step[-1:])))
    weight = 1.0 / (speed + 0.1 * speed.mean() + 1e-6) ** 2
    return (path * weight[:, None]).sum(dim=0) / weight.sum()


def _lift(lowest: Tensor, fps: float) -> Tensor:
    """How far (F,) the lowest point (F,) of a foot must rise to the floor, rising and falling gently around that."""
    reach = max(round(_GENTLE * fps), 1)
    depth = torch.nn.functional.max_pool1d((-lowest).clamp_min(0.0)[None], 2 * reach + 1, stride=1, padding=reach)
    return gaussian_smooth(depth.T, 0.5 * reach)[:, 0]


def _touch_down(lowest: Tensor, planted: Tensor, fps: float) -> Tensor:
    """How far (F,) a foot with its lowest point at ``lowest`` (F,) comes down, to stand on the floor where planted."""
    return gaussian_smooth(((lowest - SOLE).clamp_min(0.0) * planted)[:, None], LANDING * fps)[:, 0]


def _upward(height: Tensor) -> Tensor:
    return torch.stack((torch.zeros_like(height), height, torch.zeros_like(height)), dim=-1)
