"""A take: local rotations and a root path on a skeleton. Metres, Y up, facing +Z, right-handed, quaternions x y z w.

F frames, J joints.
"""

from dataclasses import dataclass, replace

import numpy as np

from . import quaternions as quat

MAX_FRAMES = 1_000_000


class MotionError(ValueError):
    """Something that cannot be used; its text is one sentence for whoever sits in front of the screen."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A joint tree. At rest every joint's axes are the world's.

    Args:
        name: of the skeleton.
        joints: names, parents before their children.
        parents: index of each joint's parent; -1 for the root, which comes first.
        offsets: (J, 3) from the parent at rest, metres.

    Raises:
        MotionError: parts that do not belong together.
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.joints)
        fits = 1 <= count == len(self.parents) and self.offsets.shape == (count, 3)
        if not fits or any(p >= j or (p < 0) != (j == 0) for j, p in enumerate(self.parents)):
            raise MotionError(
                f"the skeleton {self.name!r} is no tree of joints with the root first; save the take again"
            )
        if len(set(self.joints)) < count or not np.isfinite(self.offsets).all() or np.abs(self.offsets).max() > 100:
            raise MotionError(f"the skeleton {self.name!r} has joints of one name or absurd bones; save the take again")

    def rest_positions(self) -> np.ndarray:
        """(J, 3) rest pose with the root at the origin."""
        out = np.array(self.offsets, dtype=np.float64)
        out[0] = 0.0
        for j, p in enumerate(self.parents[1:], start=1):
            out[j] = out[p] + self.offsets[j]
        return out


@dataclass(frozen=True, eq=False)
class Take:
    """Motion on a skeleton.

    Args:
        skeleton: the joint tree.
        fps: frames a second.
        root: (F, 3) position of the root joint, metres.
        rotations: (F, J, 4) local, unit.
        title: what to call it.

    Raises:
        MotionError: sizes that do not fit, numbers that are not finite, rotations that are none.
    """

    skeleton: Skeleton
    fps: float
    root: np.ndarray
    rotations: np.ndarray
    title: str = "take"

    def __post_init__(self) -> None:
        frames, joints = len(self.root), len(self.skeleton.joints)
        if self.root.shape != (frames, 3) or self.rotations.shape != (frames, joints, 4):
            raise MotionError(
                f"{self.rotations.shape} rotations and {self.root.shape} root positions do not fit {joints} joints; "
                "the take is damaged"
            )
        if not 1 <= frames <= MAX_FRAMES or not 0 < self.fps <= 1000:
            raise MotionError(f"{frames} frames at {self.fps:g} a second are no take; give 1 to {MAX_FRAMES} frames")
        if not (np.isfinite(self.rotations).all() and np.isfinite(self.root).all() and np.abs(self.root).max() < 1e6):
            raise MotionError("the take holds NaN, infinite or absurd numbers; make it again")
        if np.abs(np.linalg.norm(self.rotations, axis=-1) - 1.0).max() > 1e-2:
            raise MotionError("the take's rotations are not unit quaternions; it is damaged")

    def world(self) -> tuple[np.ndarray, np.ndarray]:
        """Global rotations (F, J, 4) and joint positions (F, J, 3)."""
        turned, placed = np.array(self.rotations, dtype=np.float64), np.empty((*self.rotations.shape[:2], 3))
        placed[:, 0] = self.root
        for j, p in enumerate(self.skeleton.parents[1:], start=1):
            turned[:, j] = quat.mul(turned[:, p], turned[:, j])
            placed[:, j] = placed[:, p] + quat.rotate(turned[:, p], self.skeleton.offsets[j])
        return turned, placed

    def resampled(self, fps: float) -> "Take":
        """At another frame rate: slerp and linear; the last frame is the last instant within the take."""
        if fps == self.fps or len(self.root) == 1:
            return replace(self, fps=fps)
        count = int(np.floor((len(self.root) - 1) / self.fps * fps + 1e-6)) + 1
        where = np.arange(count) / fps * self.fps
        low = np.minimum(np.floor(where).astype(int), len(self.root) - 2)
        t = np.clip(where - low, 0.0, 1.0)
        root = self.root[low] * (1.0 - t[:, None]) + self.root[low + 1] * t[:, None]
        turned = quat.slerp(self.rotations[low], self.rotations[low + 1], t[:, None])
        return replace(self, fps=fps, root=root, rotations=turned)
