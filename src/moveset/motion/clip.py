"""``Motion``: local rotations and a root path on a skeleton. Metres, seconds, Y up, facing +Z, right-handed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22, Skeleton

# What every format that is written is also read with.
_SLOWEST, _FASTEST = 0.01, 1000.0


@dataclass(frozen=True, eq=False)
class Motion:
    """A clip of motion.

    Args:
        rotations: (F, J, 4) local joint rotations, unit quaternions xyzw, float32; float64 in a stream's segments.
        root: (F, 3) world position of the root joint, metres. Of different types both become the wider one.
        fps: frames per second, 0.01 to 1000.
        skeleton: the joint tree and its rest pose.

    Raises:
        InputError: other types, shapes that do not belong together, no frames, values that are not finite, quaternions
            that are not of length 1, or another frame rate.
    """

    rotations: Tensor
    root: Tensor
    fps: float = 20.0
    skeleton: Skeleton = HML22

    def __post_init__(self) -> None:
        turned, root = self.rotations, self.root
        if not (isinstance(turned, Tensor) and isinstance(root, Tensor)):
            raise InputError(
                f"a motion needs rotations and root as tensors; got {type(turned).__name__} and {type(root).__name__}; "
                "convert them by torch.as_tensor"
            )
        frames, joints = len(root) if root.ndim else 0, len(self.skeleton)
        if frames < 1 or tuple(turned.shape) != (frames, joints, 4) or tuple(root.shape) != (frames, 3):
            raise InputError(
                f"a motion on {self.skeleton.name!r} needs rotations (F, {joints}, 4) and root (F, 3) with F >= 1; got "
                f"{tuple(turned.shape)} and {tuple(root.shape)}"
            )
        if not (turned.is_floating_point() and root.is_floating_point()):
            raise InputError(f"a motion needs floats, not {turned.dtype} and {root.dtype}; convert them by .float()")
        kind = torch.promote_types(turned.dtype, root.dtype)
        kind = torch.float32 if kind is torch.bfloat16 else kind  # which NumPy, and so no file, has
        if not turned.dtype == root.dtype == kind:
            object.__setattr__(self, "rotations", turned := turned.to(kind))
            object.__setattr__(self, "root", root := root.to(kind))
        # A NaN among the rotations is a NaN among their lengths, and zero times anything finite is zero: few
        # operations, where asking each number takes five.
        shortest, longest = torch.linalg.vector_norm(turned.detach(), dim=-1).aminmax()
        if not (math.isfinite(longest) and bool((root.detach() * 0.0).sum() == 0.0)):
            raise InputError("a motion needs finite rotations and root positions; these hold NaN or infinite numbers")
        if not 0.99 <= float(shortest) <= float(longest) <= 1.01:
            raise InputError(
                f"a motion's rotations are unit quaternions xyzw, not of lengths {float(shortest):.3g} to "
                f"{float(longest):.3g}; divide them by their lengths"
            )
        if not _SLOWEST <= self.fps <= _FASTEST:
            raise InputError(f"frame rate {self.fps:g} is not in {_SLOWEST:g} to {_FASTEST:g}; give one such as 20")
        if torch.is_inference_mode_enabled():
            # Whoever gets the motion may change it, or differentiate by it: tensors made in this mode forbid both.
            with torch.inference_mode(False):
                object.__setattr__(self, "rotations", turned.clone())
                object.__setattr__(self, "root", root.clone())

    def __repr__(self) -> str:
        # Thousands of numbers say less.
        return f"Motion({len(self)} frames at {self.fps:g} fps on {self.skeleton.name!r}, {self.seconds:g} s)"

    def __len__(self) -> int:
        return len(self.root)

    @property
    def seconds(self) -> float:
        """Duration: frames / fps."""
        return len(self) / self.fps

    @cached_property
    def _world(self) -> tuple[Tensor, Tensor]:
        with torch.inference_mode(False):  # kept beyond whoever asks first
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
        """Frames of a slice, with nothing moved: ``motion[10:50]``.

        Raises:
            InputError: no frames, or the number of one.
        """
        if isinstance(frames, int):
            raise InputError(f"frame {frames} alone is no motion; take a slice such as motion[10:50]")
        return replace(self, rotations=self.rotations[frames], root=self.root[frames])

    def transformed(self, rotation: Tensor | Sequence[float], translation: Tensor | Sequence[float]) -> "Motion":
        """The whole clip turned by one world rotation (4,), then shifted by (3,) metres; of whatever type they are."""
        rotation, translation = (
            torch.as_tensor(x, dtype=self.root.dtype, device=self.root.device) for x in (rotation, translation)
        )
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
        return replace(between_frames(self, torch.arange(count, dtype=torch.float64) / fps * self.fps), fps=fps)

    def in_place(self) -> "Motion":
        """Without travel over the ground: the planar root path is held at its first frame."""
        root = self.root.clone()
        root[:, [0, 2]] = self.root[0, [0, 2]]
        return replace(self, root=root)

    def detached(self) -> "Motion":
        """In the processor's memory and outside of any gradient, as files need it; itself if it is so already."""
        if self.root.device.type == "cpu" and not (self.rotations.requires_grad or self.root.requires_grad):
            return self
        return replace(self, rotations=self.rotations.detach().cpu(), root=self.root.detach().cpu())

    def save(self, path: str | Path) -> Path:
        """Write to a file; the format follows the extension (see ``moveset.io.save``)."""
        from moveset.io import save

        return save(self, path)

    def _repr_html_(self) -> str:
        """The player, for notebooks (see ``moveset.io.html.inline_player``)."""
        from moveset.io.html import inline_player

        return inline_player(self.detached())


def between_frames(motion: Motion, where: Tensor) -> Motion:
    """The motion at places (G,) between its frames: slerp, linear for the root."""
    low = where.long().clamp(max=max(len(motion) - 2, 0))
    high = (low + 1).clamp(max=len(motion) - 1)
    t = (where - low).clamp(0.0, 1.0).to(motion.root.dtype)[:, None]
    turned = rotations.slerp(motion.rotations[low], motion.rotations[high], t)
    return replace(motion, rotations=turned, root=torch.lerp(motion.root[low], motion.root[high], t))


def concatenate(pieces: Sequence[Motion]) -> Motion:
    """Frames of several motions on one skeleton as they are, one after the other."""
    turned, root = (torch.cat([getattr(piece, name) for piece in pieces]) for name in ("rotations", "root"))
    return Motion(turned, root, pieces[0].fps, pieces[0].skeleton)
