"""Last touches of a motion before it is written: loop, in place, frame rate, skeleton."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.motion.clip import Motion


@dataclass(frozen=True)
class Finish:
    """Last touches of a motion: loop, in place, frame rate, skeleton, in this order."""

    fps: float | None = None
    skeleton: str | None = None
    in_place: bool = False
    loop: bool = False

    @classmethod
    def check(
        cls, fps: float | None = None, skeleton: str | None = None, in_place: bool = False, loop: bool = False
    ) -> "Finish":
        """The same, checked.

        Raises:
            InputError: a frame rate out of range, or an unknown skeleton.
        """
        from moveset.motion.rigs import RIGS

        if fps is not None and not 1 <= fps <= 240:
            raise InputError(f"frame rate {fps:g} is not in 1 to 240; give a rate such as 20, 24, 30 or 60")
        if skeleton is not None and skeleton not in RIGS:
            raise InputError(f"unknown skeleton {skeleton!r}; choose one of {', '.join(RIGS)}")
        return cls(fps, skeleton, in_place, loop)

    def __call__(self, motion: "Motion") -> "Motion":
        """The motion as it is written."""
        if self.loop:
            from moveset.motion.join import make_loop

            motion = make_loop(motion)
        if self.in_place:
            motion = motion.in_place()
        if self.fps is not None:
            motion = motion.resampled(self.fps)
        if self.skeleton is not None:
            from moveset.motion.retarget import retarget

            motion = retarget(motion, self.skeleton)
        return motion
