"""A standing pose made up for a body that shows none: what cannot be otherwise, then what is so on average.

Everything is found in each joint's own axes, from where its bones point there and from directions of the world seen
from there (R⁻¹·v), so that other axes or another zero pose change nothing. F frames, J joints; float64.
"""

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.body_axes import Roles, across, body_frame, centre, frame, shoulder_line, top, unit
from moveset.motion.skeleton import HML22, Skeleton

_X, _Y, _ = torch.eye(3, dtype=torch.float64)
_UPRIGHT = 0.94  # cosine, 20 degrees: trunk of somebody who stands
_STRETCHED = 0.88  # of a leg: how far the lower foot is below the hips
_CALM = 2.0  # legs a second: faster is running
_BENT = 0.2  # of a hinge that shows: sine
_CLEAR, _ENOUGH, _AGREED = 0.35, 10, 0.9  # sine of a clear bend, frames that show one, length of their mean axis
_SLOW, _LOW = 0.25, 0.06  # legs a second, legs above the lowest: a foot on the floor
_NOTHING = 1e-3


def derived_pose(skeleton: Skeleton, roles: Roles, turned: Tensor, placed: Tensor, fps: float) -> Tensor:
    """(J, 4) world rotation of each joint's axes while the body stands Y up, facing +Z, arms level.

    Args:
        skeleton: its offsets are bones in their parents' axes.
        roles: which joint plays which part.
        turned, placed: (F, J, 4), (F, J, 3) world rotations and positions, Y up; F may be 0.
    """
    return _Body(skeleton, roles, turned, placed, fps).pose()


def by_hinges(turns: Tensor, roles: Roles, turned: Tensor, placed: Tensor) -> Tensor:
    """A standing pose (J, 4) with thighs and upper arms turned about themselves until knees bend about +X and elbows
    of level arms about the vertical; those whose bends show no axis stay.

    Args:
        turns: the pose; roles, turned, placed: as for ``derived_pose``.
    """
    out = turns.clone()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for (start, joint, end), axis in (
            (("hip", "knee", "ankle"), _X),
            (("shoulder", "elbow", "wrist"), -sign * _Y),
        ):
            if any(f"{side}_{part}" not in roles for part in (start, joint, end)):
                continue
            a, b, c = (roles[f"{side}_{part}"] for part in (start, joint, end))
            upper, lower = unit(placed[:, b] - placed[:, a]), unit(placed[:, c] - placed[:, b])
            undo = rotations.inv(turned[:, a])
            seen = rotations.rotate(undo, torch.linalg.cross(upper, lower))
            seen = seen[seen.norm(dim=-1) > _CLEAR]
            if len(seen) < _ENOUGH or float(unit(seen).mean(dim=0).norm()) < _AGREED:
                continue
            bone = unit(rotations.rotate(turns[a], rotations.rotate(undo, upper).mean(dim=0)))
            level = -_Y if start == "hip" else sign * _X
            wanted = rotations.rotate(rotations.between(level, bone), axis)
            shown = rotations.rotate(turns[a], seen.mean(dim=0))
            shown = unit(shown - (shown @ bone) * bone)
            angle = torch.atan2(torch.linalg.cross(shown, wanted) @ bone, shown @ wanted)
            out[a] = rotations.mul(rotations.from_axis_angle(bone, angle), turns[a])
    return out


def _mean(q: Tensor) -> Tensor:
    """(4,) mean of rotations (F, 4): the eigenvector of their outer products (Markley et al. 2007)."""
    mean = torch.linalg.eigh(q.T @ q).eigenvectors[:, -1]
    return mean * (1.0 if mean[3] >= 0 else -1.0)


class _Body:
    def __init__(self, skeleton: Skeleton, roles: Roles, turned: Tensor, placed: Tensor, fps: float) -> None:
        self.skeleton, self.roles, self.turned, self.placed = skeleton, roles, turned, placed
        self.rest = skeleton.offsets.double()
        self.frames, self.fps = len(placed), fps
        if self.frames:
            self.axes = body_frame(placed, roles)
            self.upright = self._standing()
        self.out: dict[int, Tensor] = {}

    def _standing(self) -> Tensor:
        """(F,) bool: trunk upright on legs that are nearly stretched."""
        hips = centre(self.placed, self.roles, "hip")
        good = unit(top(self.placed, self.roles) - hips)[:, 1] > _UPRIGHT
        drop, length = torch.zeros(self.frames).double(), torch.zeros(self.frames).double()
        for side in ("left", "right"):
            hip, knee, ankle = (self.placed[:, self.roles[f"{side}_{part}"]] for part in ("hip", "knee", "ankle"))
            drop = torch.maximum(drop, hip[:, 1] - ankle[:, 1])
            length = length + 0.5 * ((knee - hip).norm(dim=-1) + (ankle - knee).norm(dim=-1))
        good &= drop > _STRETCHED * length
        if self.frames > 1:
            # Who runs leans.
            speed = self.fps * (hips[1:, [0, 2]] - hips[:-1, [0, 2]]).norm(dim=-1)
            good &= torch.cat((speed[:1], speed)) < _CALM * length
        return good

    def mean(self, joint: int, v: Tensor, where: Tensor | None = None) -> Tensor:
        """(3,) a direction of the world (F, 3) as the joint sees it, on average; zero where it is never seen."""
        if not self.frames:
            return torch.zeros(3, dtype=torch.float64)
        seen = rotations.rotate(rotations.inv(self.turned[:, joint]), v.expand(self.frames, 3))
        seen = seen if where is None else seen[where]
        return seen.sum(dim=0) / max(1, len(seen))

    def bone(self, joint: int, end: int) -> Tensor:
        """(3,) direction from a joint to another one below it, in the joint's axes."""
        way, j = [], end
        while j not in (joint, -1):
            way.append(j)
            j = self.skeleton.parents[j]
        if len(way) == 1 or not self.frames:
            # Between them at zero rotation, which is all that is known without frames.
            return unit(sum((self.rest[k] for k in way), torch.zeros(3, dtype=torch.float64)))
        return unit(self.mean(joint, self.placed[:, end] - self.placed[:, joint]))

    def settle(self, joint: int, left: Tensor, up: Tensor, rest_left: Tensor = _X, rest_up: Tensor = _Y) -> None:
        """The joint's axes stand so that ``left`` and ``up`` (3,), as it sees them, point as they do at rest."""
        local, world = frame(left, up), frame(rest_left, rest_up)
        if torch.isfinite(local).all() and abs(float(torch.linalg.det(local)) - 1.0) < _NOTHING:
            self.out[joint] = rotations.from_matrix(world @ local.T)

    def pose(self) -> Tensor:
        self._trunk()
        for side, sign in (("left", 1.0), ("right", -1.0)):
            self._leg(side)
            self._arm(side, sign)
        turns: list[Tensor] = []
        for j, parent in enumerate(self.skeleton.parents):
            above = turns[parent] if parent >= 0 else rotations.identity().double()
            turns.append(self.out.get(j, rotations.mul(above, self._usual(j, parent))))
        return torch.stack(turns)

    def _usual(self, joint: int, above: int) -> Tensor:
        """(4,) mean rotation of a joint as one above it sees it."""
        if not self.frames or above < 0:
            return rotations.identity().double()
        return _mean(rotations.mul(rotations.inv(self.turned[:, above]), self.turned[:, joint]))

    def _settle_trunk(self, role: str, above: str | None, left: Tensor) -> None:
        """A joint of the trunk: the world's up while the body stands, else its bone as on hml22."""
        joint, usual = self.roles[role], _Y
        if self.frames and int(self.upright.sum()) >= _ENOUGH:
            up = unit(self.mean(joint, _Y, self.upright))
        elif above is not None and float((bone := self._trunk_bone(joint, role, above)).norm()) > 0.5:
            places = HML22.rest_positions.double()
            start = places[1:3].mean(dim=0) if role == "pelvis" else places[HML22.index(role)]
            up, usual = bone, unit(places[HML22.index(above)] - start)
        else:
            up = unit(self.mean(joint, self.axes[..., 1])) if self.frames else _Y
        self.settle(joint, left, up, rest_up=usual)

    def _trunk_bone(self, joint: int, role: str, above: str) -> Tensor:
        """(3,) from a joint to the next one of the trunk; of the pelvis, from between the hips."""
        if role != "pelvis":
            return self.bone(joint, self.roles[above])
        if self.frames:
            hips = centre(self.placed, self.roles, "hip")
            return unit(self.mean(joint, self.placed[:, self.roles[above]] - hips))
        rest = self.skeleton.rest_positions.double()
        return unit(rest[self.roles[above]] - centre(rest, self.roles, "hip"))

    def _trunk(self) -> None:
        chain = [role for role in ("pelvis", "spine1", "spine2", "spine3", "neck", "head") if role in self.roles]
        hips = unit(self._pair("pelvis", "hip"))
        chest_role = next((role for role in ("spine3", "spine2", "spine1") if role in self.roles), "pelvis")
        line = unit(self._pair(chest_role, "shoulder"))
        line = line if float(line.norm()) > 0.5 else unit(self._pair(chest_role, "collar"))
        for role, above in zip(chain, [*chain[1:], None], strict=True):
            left = hips if role == "pelvis" else line
            if role not in ("pelvis", chest_role):
                left = self._left(self.roles[role], role in ("neck", "head"))
            if float(left.norm()) > _NOTHING:
                self._settle_trunk(role, above, left)
        chest = self.roles[chest_role]
        for side in ("left", "right"):
            joint = self.roles.get(f"{side}_collar")
            if joint is not None and chest in self.out:
                # Collars move little: on average they turn as the chest does.
                self.out[joint] = self._as(chest, joint)

    def _as(self, above: int, joint: int) -> Tensor:
        """(4,) how a joint's axes stand that on average turns as a settled one does."""
        if not self.frames:
            return self.out[above]
        return rotations.mul(self.out[above], self._usual(joint, above))

    def _pair(self, role: str, part: str) -> Tensor:
        """From the right to the left one of a part as the joint of a role sees it."""
        joint, pair = self.roles[role], [self.roles.get(f"{side}_{part}", -1) for side in ("left", "right")]
        if min(pair) < 0:
            return torch.zeros(3, dtype=torch.float64)
        if self.frames:
            return self.mean(joint, self.placed[:, pair[0]] - self.placed[:, pair[1]])
        rest = self.skeleton.rest_positions.double()
        return rest[pair[0]] - rest[pair[1]]

    def _left(self, joint: int, head: bool) -> Tensor:
        if not self.frames:
            return unit(self._pair("pelvis", "hip"))
        shoulders, hips = shoulder_line(self.placed, self.roles), across(self.placed, self.roles, "hip")
        return unit(self.mean(joint, shoulders if head else unit(shoulders + hips)))

    def _hinge(self, start: int, joint: int, end: int, usual: Tensor) -> Tensor:
        """(F, 3) the axis of a knee or elbow where it is bent, and a little of where it usually is."""
        upper = unit(self.placed[:, joint] - self.placed[:, start])
        lower = unit(self.placed[:, end] - self.placed[:, joint])
        axis = torch.linalg.cross(upper, lower)
        size = axis.norm(dim=-1, keepdim=True)
        return torch.where(size > _BENT, axis, 0.0) + 0.05 * usual

    def _limb(self, joint: int, end: int, points: Tensor, axis: Tensor, rest: Tensor) -> None:
        """A limb's bone points along ``points``; its hinge, as it sees it, along ``rest``."""
        bone = self.bone(joint, end)
        if float(bone.norm()) < 0.5:
            return
        seen = unit(axis)
        if float(seen.norm()) < 0.5:
            above = self._above(joint)
            self.out[joint] = rotations.mul(rotations.between(rotations.rotate(above, bone), points), above)
            return
        self.settle(joint, seen, bone, rest, points)

    def _above(self, joint: int) -> Tensor:
        """(4,) how the nearest settled joint above stands."""
        parent = self.skeleton.parents[joint]
        while parent >= 0 and parent not in self.out:
            parent = self.skeleton.parents[parent]
        return self.out[parent] if parent >= 0 else rotations.identity().double()

    def _leg(self, side: str) -> None:
        hip, knee, ankle = (self.roles[f"{side}_{part}"] for part in ("hip", "knee", "ankle"))
        nothing = torch.zeros(3, dtype=torch.float64)
        axis = self._hinge(hip, knee, ankle, across(self.placed, self.roles, "hip")) if self.frames else nothing
        self._limb(hip, knee, -_Y, self.mean(hip, axis), _X)
        self._limb(knee, ankle, -_Y, self.mean(knee, axis), _X)
        self._foot(side, ankle, knee, axis)

    def _foot(self, side: str, ankle: int, knee: int, axis: Tensor) -> None:
        toe = self.roles.get(f"{side}_foot")
        bone = None if toe is None else self.bone(ankle, toe)
        pitch = HML22.offsets[HML22.index("left_foot")].double()
        if not self.frames:
            if bone is not None and knee in self.out:
                above = self.out[knee]
                self.out[ankle] = rotations.mul(rotations.between(rotations.rotate(above, bone), unit(pitch)), above)
            return
        flat = self._planted(ankle)
        left = unit(self.mean(ankle, axis))
        if int(flat.sum()) >= 3:
            up = unit(self.mean(ankle, _Y, flat))
            if bone is not None and float(bone.norm()) > 0.5:
                left = unit(torch.linalg.cross(up, bone))
            self.settle(ankle, left, up)
        elif bone is not None and float(bone.norm()) > 0.5:
            world = frame(_X, unit(pitch))
            local = frame(left, bone)
            self.out[ankle] = rotations.from_matrix(world @ local.T)
        if toe is not None and ankle in self.out:
            self.out[toe] = self._as(ankle, toe)

    def _planted(self, ankle: int) -> Tensor:
        """(F,) bool: the ankle rests at its lowest."""
        legs = (self.placed[:, ankle] - self.placed[:, self.skeleton.parents[ankle]]).norm(dim=-1).mean() * 2.0
        place = self.placed[:, ankle]
        low = place[:, 1] < place[:, 1].quantile(0.05) + _LOW * legs
        if self.frames < 2:
            return low
        step = (place[1:] - place[:-1]).norm(dim=-1)
        step = torch.cat((step, step[-1:]))
        return low & (self.fps * step < torch.maximum(self.fps * step.quantile(0.2), _SLOW * legs))

    def _arm(self, side: str, sign: float) -> None:
        names = [self.roles.get(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")]
        shoulder, elbow, wrist = names
        if shoulder is None or elbow is None:
            return
        axis = torch.zeros(3, dtype=torch.float64)
        if self.frames:
            # An arm that hangs bends about the line of the shoulders, and that axis swings with the arm.
            upper = (self.axes.mT @ unit(self.placed[:, elbow] - self.placed[:, shoulder])[..., None])[..., 0]
            swung = rotations.rotate(rotations.between(-_Y.expand_as(upper), upper), -_X)
            usual = (self.axes @ swung[..., None])[..., 0]
            axis = self._hinge(shoulder, elbow, wrist, usual) if wrist is not None else usual
        self._limb(shoulder, elbow, sign * _X, self.mean(shoulder, axis), -sign * _Y)
        if wrist is None:
            return
        self._limb(elbow, wrist, sign * _X, self.mean(elbow, axis), -sign * _Y)
        if elbow in self.out:
            self.out[wrist] = self._as(elbow, wrist)
