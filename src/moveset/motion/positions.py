"""From joint positions to rotations. F frames, J joints; world axes, metres; float64 inside.

Positions do not determine rotations: a bone may turn about itself unseen. Here is what is decided, and by what:

* Joints with several children (pelvis and chest) by all their children at once, in the least-squares sense.
* Bones between those two by their direction; their twist is spread evenly between pelvis and chest.
* Upper arms and thighs by their direction and the plane in which elbow and knee bend, since these are hinges. A limb
  too straight to show a plane takes it from the frames around; a leg also looks at where its toes point.
* Everything else by the shortest arc from its parent.

So there is never a twist of the forearm, a turn or nod of the head beyond the neck's own, a roll of the foot, or any
rotation of hands and toes. ``positions_to_motion`` puts any body's positions onto the skeleton as it is;
``solve_rotations`` gives the skeleton the body's bone lengths instead.
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.kinematics import global_to_local
from moveset.motion.skeleton import HML22, Skeleton
from moveset.motion.smoothing import gaussian_smooth

# Local axis about which each hinge bends, per skeleton. On hml22 measured on real takes: elbows and knees stay within
# a degree of it.
HINGES: dict[str, dict[str, tuple[float, float, float]]] = {
    "hml22": {
        "left_elbow": (0.0, -1.0, 0.0),
        "right_elbow": (0.0, 1.0, 0.0),
        "left_knee": (1.0, 0.0, 0.0),
        "right_knee": (1.0, 0.0, 0.0),
    },
    "kit21": {
        "left_elbow": (-1.0, 0.0, 0.0),
        "right_elbow": (-1.0, 0.0, 0.0),
        "left_knee": (1.0, 0.0, 0.0),
        "right_knee": (1.0, 0.0, 0.0),
    },
}
_BENT = (math.radians(5.0), math.radians(20.0))  # from no to full confidence in the plane of the bend
_TOE_CONFIDENCE, _NEIGHBOUR_CONFIDENCE, _PRIOR_CONFIDENCE = 0.1, 0.1, 0.01
_NEIGHBOURS = 0.15  # seconds


def positions_to_motion(joints: Tensor, fps: float, skeleton: Skeleton = HML22) -> Motion:
    """The motion whose joints lie at (or, with other bone lengths, in the directions of) ``joints`` (F, J, 3).

    Raises:
        InputError: another shape, values that are not finite, or a skeleton without known hinges.
    """
    if joints.ndim != 3 or len(joints) < 1 or tuple(joints.shape[1:]) != (len(skeleton), 3):
        raise InputError(
            f"positions on {skeleton.name!r} must be (F >= 1, {len(skeleton)}, 3); got {tuple(joints.shape)}"
        )
    if not torch.isfinite(joints).all():
        raise InputError("joint positions must be finite; repair or cut the clip")
    if skeleton.name not in HINGES:
        raise InputError(
            f"rotations can be found on {' and '.join(HINGES)} only, not on {skeleton.name!r}; retarget after"
        )
    p = joints.detach().double().cpu()
    turned = _Solver(p, fps, skeleton).solve()
    local = rotations.unroll(rotations.normalize(global_to_local(turned, skeleton)))
    return Motion(local.float(), p[:, 0].float(), fps, skeleton)


def solve_rotations(joints: Tensor, fps: float, skeleton: Skeleton = HML22) -> Motion:
    """As ``positions_to_motion``, on the skeleton with the bone lengths of the positions, averaged over time.

    Lengths that agree with the skeleton's within a millimetre leave it as it is.

    Raises:
        InputError: as there.
    """
    motion = positions_to_motion(joints, fps, skeleton)
    bones = joints[:, 1:].double() - joints[:, list(skeleton.parents[1:])].double()
    lengths, own = bones.norm(dim=-1).mean(dim=0).cpu(), skeleton.offsets[1:].double().norm(dim=-1)
    if (lengths - own).abs().max() < 1e-3:
        return motion
    scaled = skeleton.offsets[1:].double() * (lengths / own.clamp_min(1e-9))[:, None]
    fitted = replace(skeleton, offsets=torch.cat((skeleton.offsets[:1], scaled.float())))
    return Motion(motion.rotations, motion.root, fps, fitted)


class _Solver:
    """Global rotations, joint by joint from the root."""

    def __init__(self, p: Tensor, fps: float, skeleton: Skeleton) -> None:
        self.p, self.fps, self.skeleton = p, fps, skeleton
        self.rest = skeleton.offsets.double()
        self.hinges = {skeleton.index(joint): axis for joint, axis in HINGES[skeleton.name].items()}
        self.rigid = {j: self._register(j) for j, children in enumerate(skeleton.children) if len(children) > 1}

    def solve(self) -> Tensor:
        turned: list[Tensor] = []
        for j, children in enumerate(self.skeleton.children):
            if j in self.rigid:
                turned.append(self.rigid[j])
            elif not children:
                turned.append(turned[self.skeleton.parents[j]])
            else:
                start = self._start(j, turned)
                arc = rotations.between(rotations.rotate(start, self.rest[children[0]]), self._bone(children[0]))
                turn = rotations.mul(arc, start)
                turned.append(self._twisted(turn, children[0]) if children[0] in self.hinges else turn)
        return torch.stack(turned, dim=1)

    def _bone(self, j: int) -> Tensor:
        return self.p[:, j] - self.p[:, self.skeleton.parents[j]]

    def _register(self, j: int) -> Tensor:
        """Rotation of a joint that best takes its children's rest offsets to where they are."""
        children = list(self.skeleton.children[j])
        there = torch.stack([self._bone(c) for c in children], dim=1)
        u, _, v = torch.linalg.svd(there.mT @ self.rest[children])
        # A reflection would fit flat arrangements equally well.
        proper = torch.ones_like(there[:, :, 0])[:, :1].repeat(1, 3)
        proper[:, 2] = torch.linalg.det(u @ v)
        return rotations.from_matrix(u * proper[:, None, :] @ v)

    def _start(self, j: int, turned: list[Tensor]) -> Tensor:
        """The rotation that the shortest arc starts from: the parent's, or between two rigid joints a share of both."""
        above, below = [j], [j]
        while above[-1] not in self.rigid:
            above.append(self.skeleton.parents[above[-1]])
        while below[-1] not in self.rigid and len(self.skeleton.children[below[-1]]) == 1:
            below.append(self.skeleton.children[below[-1]][0])
        if below[-1] not in self.rigid:
            return turned[self.skeleton.parents[j]]
        share = (len(above) - 1) / (len(above) + len(below) - 2)
        return rotations.slerp(self.rigid[above[-1]], self.rigid[below[-1]], share)

    def _twisted(self, turn: Tensor, hinge: int) -> Tensor:
        """The rotation of an upper limb, twisted about its bone until the hinge's axis is the axis of the bend."""
        end = self.skeleton.children[hinge][0]
        bone = torch.nn.functional.normalize(self._bone(hinge), dim=-1)
        axis = rotations.rotate(turn, turn.new_tensor(self.hinges[hinge]))
        across = torch.linalg.cross(bone, axis)

        def seen(direction: Tensor) -> Tensor:
            """A world direction as (cos, sin) about the bone, counted from the axis."""
            flat = torch.stack(((direction * axis).sum(-1), (direction * across).sum(-1)), dim=-1)
            return torch.nn.functional.normalize(flat, dim=-1)

        bend = torch.linalg.cross(bone, torch.nn.functional.normalize(self._bone(end), dim=-1))
        low, high = math.sin(_BENT[0]), math.sin(_BENT[1])
        sure = ((bend.norm(dim=-1, keepdim=True) - low) / (high - low)).clamp(0.0, 1.0)
        sure = sure * sure * (3.0 - 2.0 * sure)
        unsure = 1.0 - sure
        evidence = sure * seen(bend)
        below = self.skeleton.children[end]
        if below and {end, *below} & {*self.skeleton.feet}:  # an ankle, of which kit21's feet begin at the heel
            toe = below[0]
            evidence = evidence + unsure * _TOE_CONFIDENCE * seen(torch.linalg.cross(self._bone(toe), bone))
        evidence = evidence + unsure * evidence.new_tensor((_PRIOR_CONFIDENCE, 0.0))
        around = gaussian_smooth(evidence, max(_NEIGHBOURS * self.fps, 0.5))
        cos, sin = (evidence + unsure * _NEIGHBOUR_CONFIDENCE * around).unbind(-1)
        return rotations.mul(rotations.from_axis_angle(bone, torch.atan2(sin, cos)), turn)
