"""What happens to motion after the networks, in order: joined, feet held, looped, in place, frame rate, skeleton."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from moveset.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from moveset.motion.clip import Motion


def assembled(clips: "Sequence[tuple[Motion, Tensor]]", foot_lock: bool) -> "tuple[Motion, Motion]":
    """One motion of clips that follow one another, before and after its feet are held.

    Args:
        clips: with the feet (F, 4) that each has planted by the model's own account: a foot that slides is not found
            planted by its speed, which is what is to be mended.
        foot_lock: also set down who sits or lies on nothing.
    """
    import torch

    from moveset.motion.cleanup import lock_feet
    from moveset.motion.hover import seated
    from moveset.motion.join import join

    raw = join([motion for motion, _ in clips])
    planted = torch.cat([planted for _, planted in clips])
    return raw, lock_feet(seated(raw), contacts=planted) if foot_lock else raw


@dataclass(frozen=True)
class Postprocess:
    """What is done to a motion before it is written: loop, in place, frame rate, skeleton, in this order.

    Raises:
        InputError: a frame rate out of range, or an unknown skeleton.
    """

    fps: float | None = None
    skeleton: str | None = None
    in_place: bool = False
    loop: bool = False

    def __post_init__(self) -> None:
        from moveset.motion.rigs import RIGS

        if self.fps is not None and not 1 <= self.fps <= 240:
            raise InputError(f"frame rate {self.fps:g} is not in 1 to 240; give a rate such as 20, 24, 30 or 60")
        if self.skeleton is not None and self.skeleton not in RIGS:
            raise InputError(f"unknown skeleton {self.skeleton!r}; choose one of {', '.join(RIGS)}")

    def __call__(self, motion: "Motion") -> "Motion":
        if self.loop:
            from moveset.motion.join import make_loop, without_net_turn

            motion = make_loop(motion)
            if self.in_place:  # who goes on from cycle to cycle goes on turning; who stays must end as it began
                motion = without_net_turn(motion)
        if self.in_place:
            motion = motion.in_place()
        if self.fps is not None:
            motion = _loop_at(motion, self.fps) if self.loop else motion.resampled(self.fps)
        if self.skeleton is not None:
            from moveset.motion.retarget import retarget

            motion = retarget(motion, self.skeleton)
        return motion


def _loop_at(motion: "Motion", fps: float) -> "Motion":
    """A loop at another frame rate, still closed: whole frames over exactly its cycle, about as long as it was."""
    steps = len(motion) - 1
    kept = max(round(steps / motion.fps * fps), 1)
    return replace(motion.resampled(kept / steps * motion.fps), fps=fps)
