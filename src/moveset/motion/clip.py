"""``Motion``: local rotations and a root path on a skeleton. Metres, seconds, Y up, facing +Z, right-handed."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22, Skeleton


@dataclass(frozen=True, eq=False)
class Motion:
    """A clip of motion.

    Args:
        rotations: (F, J, 4) local joint rotations, unit quaternions xyzw, float32; float64 in a stream's segments.
        root: (F, 3) world position of the root joint, metres, likewise.
        fps: frames per second.
        skeleton: the joint tree and its rest pose.

    Raises:
        InputError: shapes that do not belong together, no frames, or values that are not finite.
    """

    rotations: Tensor
    root: Tensor
    fps: float = 20.0
    skeleton: Skeleton = HML22

    def __post_init__(self) -> None:
        frames, joints = len(self.root), len(self.skeleton)
        if frames < 1 or tuple(self.rotations.shape) != (frames, joints, 4) or tuple(self.root.shape) != (frames, 3):
            raise InputError(
                f"a motion on {self.skeleton.name!r} needs rotations (F, {joints}, 4) and root (F, 3) with F >= 1; got "
                f"{tuple(self.rotations.shape)} and {tuple(self.root.shape)}"
            )
        # Zero times anything finite is zero: two operations, where asking each number takes five.
        zero = (self.rotations * 0.0).sum() + (self.root * 0.0).sum()
        if not (self.fps > 0 and bool(zero == 0.0)):
            raise InputError("a motion needs finite rotations and root positions and a frame rate above 0")

    def __len__(self) -> int:
        return len(self.root)

    @property
    def seconds(self) -> float:
        """Duration: frames / fps."""
        return len(self) / self.fps

    @cached_property
    def _world(self) -> tuple[Tensor, Tensor]:
        return fk(self.rotations, self.root, self.skeleton)

    @property
    def joints(self) -> Tensor:
        """(F, J, 3) joint positions in metres, by forward kinematics."""
        return self._world[1]

    @property
    def global_rotations(self) -> Tensor:
        """(F, J, 4) world rotations of the joints."""
        return self._world[0]

    def __getitem__(self, frames: slice) -> "Motion":
        """Frames of a slice, with nothing moved: ``motion[10:50]``."""
        return replace(self, rotations=self.rotations[frames], root=self.root[frames])

    def transformed(self, rotation: Tensor, translation: Tensor) -> "Motion":
        """The whole clip turned by one world rotation (4,), then shifted by (3,)."""
        turned = torch.cat((rotations.mul(rotation, self.rotations[:, :1]), self.rotations[:, 1:]), dim=1)
        return replace(self, rotations=turned, root=rotations.rotate(rotation, self.root) + translation)

    def canonical(self) -> "Motion":
        """Starting above the origin and facing +Z: heading and planar position of frame 0 removed."""
        turn = rotations.inv(rotations.heading(self.rotations[0, 0]))
        start = rotations.rotate(turn, self.root[0]) * self.root.new_tensor((1.0, 0.0, 1.0))
        return self.transformed(turn, -start)

    def mirrored(self) -> "Motion":
        """Left and right exchanged: reflected in the plane x = 0, so the rest pose must be symmetric."""
        order = list(self.skeleton.mirror_order)
        flip = self.rotations.new_tensor((1.0, -1.0, -1.0, 1.0))
        return replace(
            self, rotations=self.rotations[:, order] * flip, root=self.root * self.root.new_tensor((-1.0, 1.0, 1.0))
        )

    def resampled(self, fps: float) -> "Motion":
        """At another frame rate: slerp between frames, linear for the root.

        The first frame stays; the last is the last instant of the new rate that lies within the clip.

        Raises:
            InputError: fps not in (0, 1000].
        """
        if not 0 < fps <= 1000:
            raise InputError(f"frame rate {fps} is not in (0, 1000]; give a rate such as 20, 24, 30 or 60")
        if fps == self.fps:
            return self
        if len(self) == 1:
            return replace(self, fps=fps)
        count = math.floor((len(self) - 1) / self.fps * fps + 1e-6) + 1
        where = torch.arange(count, dtype=torch.float64) / fps * self.fps
        low = where.floor().clamp(max=len(self) - 2).long()
        t = (where - low).clamp(0.0, 1.0).to(self.root.dtype)
        turned = rotations.slerp(self.rotations[low], self.rotations[low + 1], t[:, None])
        root = torch.lerp(self.root[low], self.root[low + 1], t[:, None])
        return replace(self, rotations=turned, root=root, fps=fps)

    def in_place(self) -> "Motion":
        """Without travel over the ground: the planar root path is held at its first frame."""
        root = self.root.clone()
        root[:, [0, 2]] = self.root[0, [0, 2]]
        return replace(self, root=root)

    def save(self, path: str | Path) -> Path:
        """Write to a file; the format follows the extension (see ``moveset.io.save``)."""
        from moveset.io import save

        return save(self, path)

    def _repr_html_(self) -> str:
        """The player, for notebooks (see ``moveset.io.html.inline_player``)."""
        from moveset.io.html import inline_player

        return inline_player(self)
