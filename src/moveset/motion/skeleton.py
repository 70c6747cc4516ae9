"""Skeletons: names, parents, rest pose. ``hml22`` (the first 22 joints of SMPL) and ``kit21`` are built in."""

import re
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from moveset.errors import InputError

_SAME_PLACE = 1e-4  # metres


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A joint tree with its rest pose.

    In the rest pose every joint's rotation is the identity, so ``offsets`` are at once local and world directions.

    Args:
        name: what it is called (``rigs.get_rig`` finds the built-in ones).
        joints: joint names, parents before children.
        parents: index of each joint's parent; -1 for the root, which comes first.
        offsets: (J, 3) position of each joint relative to its parent in the rest pose, metres, Y up, facing +Z.
        pairs: (left, right) joint indices, for mirroring.
        feet: indices of left ankle, left toe, right ankle, right toe; empty where unknown.
        roles: (joint of ``hml22``, index of the joint that plays it) where somebody said so; empty to recognise them.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Tensor
    pairs: tuple[tuple[int, int], ...] = ()
    feet: tuple[int, ...] = ()
    roles: tuple[tuple[str, int], ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.offsets, Tensor):
            raise InputError(
                f"skeleton {self.name!r} needs its offsets as a tensor, not {type(self.offsets).__name__}; convert "
                "them by torch.as_tensor"
            )
        if len(self.joints) != len(self.parents) or tuple(self.offsets.shape) != (len(self.joints), 3):
            raise InputError(
                f"skeleton {self.name!r}: {len(self.joints)} joints, {len(self.parents)} parents and offsets of shape "
                f"{tuple(self.offsets.shape)} do not belong together"
            )
        if any(p >= j or (p < 0) != (j == 0) for j, p in enumerate(self.parents)):
            raise InputError(f"skeleton {self.name!r}: parents must come before their children and joint 0 be the root")

    def __len__(self) -> int:
        return len(self.joints)

    def __repr__(self) -> str:
        return f"Skeleton({self.name!r}, {len(self)} joints)"

    def index(self, joint: str) -> int:
        """Index of a joint by name.

        Raises:
            InputError: there is no such joint.
        """
        if joint not in self.joints:
            raise InputError(f"skeleton {self.name!r} has no joint {joint!r}; it has {', '.join(self.joints)}")
        return self.joints.index(joint)

    def order_in(self, other: "Skeleton") -> list[int] | None:
        """Index in another skeleton of each joint of this one, or None where that is another body.

        Two skeletons are one body where joints of the same names hang under the same parents, 0.1 mm apart at most:
        files round. What they are called, in which order they list joints, where they put the root, and blanks in
        names, which BVH does not have, do not matter.
        """
        order = list(range(len(self)))
        if self is other:
            return order
        if self.joints != other.joints:
            names, place = [_plain(name) for name in self.joints], {_plain(n): j for j, n in enumerate(other.joints)}
            # Names that are used twice tell joints apart only by their order.
            if len(names) != len(other) or len(place) < len(other) or set(names) != set(place):
                return None
            order = [place[name] for name in names]
        if [order[p] for p in self.parents[1:]] != [other.parents[j] for j in order[1:]]:
            return None
        apart = (self.offsets[1:].double() - other.offsets[order[1:]].double().to(self.offsets.device)).norm(dim=-1)
        return order if bool((apart <= _SAME_PLACE).all()) else None

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        return tuple(tuple(c for c, p in enumerate(self.parents) if p == j) for j in range(len(self)))

    @cached_property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """Joints grouped by depth below the root, root first: forward kinematics runs level by level."""
        depth = [0] * len(self)
        for j, p in enumerate(self.parents[1:], start=1):
            depth[j] = depth[p] + 1
        return tuple(tuple(j for j in range(len(self)) if depth[j] == d) for d in range(max(depth) + 1))

    @cached_property
    def mirror_order(self) -> tuple[int, ...]:
        order = list(range(len(self)))
        for left, right in self.pairs:
            order[left], order[right] = right, left
        return tuple(order)

    @cached_property
    def rest_positions(self) -> Tensor:
        """(J, 3) rest pose with the root at the origin."""
        out = self.offsets.clone()
        for j, p in enumerate(self.parents[1:], start=1):
            out[j] = out[p] + self.offsets[j]
        return out


def _plain(name: str) -> str:
    return re.sub(r"[\s{}]+", "_", name)


def _unit(*rows: tuple[float, float, float]) -> Tensor:
    return torch.nn.functional.normalize(torch.tensor(rows, dtype=torch.float64), dim=-1)


_HML_JOINTS = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
_HML_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)

# Bone lengths of HumanML3D's target skeleton, metres (motionpcm.md §1.1), left/right averaged: the public skeleton is
# asymmetric by up to 7 mm, which would make a mirrored motion leave its own skeleton.
_HML_LENGTHS = (
    0.0, 0.106475, 0.106475, 0.13157, 0.391905, 0.391905, 0.14319, 0.429035, 0.429035, 0.05736, 0.1464, 0.1464,
    0.21936, 0.140435, 0.140435, 0.10304, 0.127295, 0.127295, 0.259965, 0.259965, 0.268, 0.268,
)  # fmt: skip
# Rest directions (retargeting.md §3): symmetric, SMPL-like, arms level, feet flat.
_HML_DIRECTIONS = _unit(
    (0, 1, 0), (0.57, -0.80, -0.18), (-0.57, -0.80, -0.18), (0, 0.96, -0.28), (0, -1, 0), (0, -1, 0), (0, 0.98, 0.19),
    (0, -1, 0), (0, -1, 0), (0, 1, 0.05), (0, -0.44, 0.90), (0, -0.44, 0.90), (0, 0.99, -0.15), (0.55, 0.82, -0.15),
    (-0.55, 0.82, -0.15), (0, 0.87, 0.49), (0.93, 0.35, -0.11), (-0.93, 0.35, -0.11), (1, 0, 0), (-1, 0, 0),
    (1, 0, 0), (-1, 0, 0),
)  # fmt: skip

HML22 = Skeleton(
    name="hml22",
    joints=_HML_JOINTS,
    parents=_HML_PARENTS,
    offsets=(_HML_DIRECTIONS * torch.tensor(_HML_LENGTHS, dtype=torch.float64)[:, None]).float(),
    pairs=((1, 2), (4, 5), (7, 8), (10, 11), (13, 14), (16, 17), (18, 19), (20, 21)),
    feet=(7, 10, 8, 11),
)

_KIT_JOINTS = (
    "root", "torso", "chest", "neck", "head", "left_shoulder", "left_elbow", "left_wrist", "right_shoulder",
    "right_elbow", "right_wrist", "left_hip", "left_knee", "left_ankle", "left_heel", "left_toe", "right_hip",
    "right_knee", "right_ankle", "right_heel", "right_toe",
)  # fmt: skip
_KIT_PARENTS = (-1, 0, 1, 2, 3, 3, 5, 6, 3, 8, 9, 0, 11, 12, 13, 14, 0, 16, 17, 18, 19)
# Canonical directions of KIT-ML (motionpcm.md §1.7). Lengths are those of hml22's body, scaled to KIT's stature of
# about one metre, for drawing only: KIT data brings its own lengths.
_KIT_DIRECTIONS = _unit(
    (0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, -1, 0), (0, -1, 0), (-1, 0, 0), (0, -1, 0),
    (0, -1, 0), (1, 0, 0), (0, -1, 0), (0, -1, 0), (0, 0, 1), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, -1, 0),
    (0, 0, 1), (0, 0, 1),
)  # fmt: skip
_KIT_LENGTHS = (
    0.0, 0.08, 0.12, 0.13, 0.08, 0.12, 0.15, 0.15, 0.12, 0.15, 0.15, 0.06, 0.25, 0.25, 0.03, 0.08, 0.06, 0.25, 0.25,
    0.03, 0.08,
)  # fmt: skip

KIT21 = Skeleton(
    name="kit21",
    joints=_KIT_JOINTS,
    parents=_KIT_PARENTS,
    offsets=(_KIT_DIRECTIONS * torch.tensor(_KIT_LENGTHS, dtype=torch.float64)[:, None]).float(),
    pairs=((5, 8), (6, 9), (7, 10), (11, 16), (12, 17), (13, 18), (14, 19), (15, 20)),
    feet=(14, 15, 19, 20),
)
