"""Ways with corners: back and forth, round a square, in a zigzag; and in a figure eight.

Angles are radians, to the left above zero. F frames, D features.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.motion.features import FeatureCodec
from moveset.motion.way import FASTEST, led, pace_of, side_of, way_of

_CORNER = 0.5  # metres, radius of a corner that is walked round; runs need more
_UNHURRIED = 0.8  # times as fast as may be a corner is turned: steps are not alike
_PACES = (1.2, 3.0)  # metres a second, of the walks and runs of streams, whose pieces must agree on where corners are
_RUNS = 1.8  # metres a second; who is faster runs, and goes straight on for longer
_LONGER = 2.5  # times
_FEWEST = 3  # legs of a zigzag


class _Pattern:
    """A way whose heading follows from how far it has come, and which repeats itself."""

    seconds = 0.0
    cuts = False

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion, which ends where a repeat does."""
        whole, pace = way_of(features[:-1], codec), pace_of(features, codec)
        if whole <= 0.0:
            return features
        repeats = self._repeats(whole / self._unit(pace))
        unit = whole / repeats
        return led(features, codec, 0.0, lambda way: self._heading(way, unit, pace, repeats))

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion."""
        pace = _PACES[pace_of(features, codec) > _RUNS]
        unit = self._unit(pace)
        return led(features, codec, gone, lambda way: self._heading(way, unit, pace, math.inf))

    def _unit(self, pace: float) -> float:
        """Metres of one repeat, for whoever goes ``pace`` metres a second."""
        raise NotImplementedError

    def _repeats(self, units: float) -> int:
        """How many repeats a whole motion has whose way is ``units`` long."""
        raise NotImplementedError

    def _heading(self, way: Tensor, unit: float, pace: float, repeats: float) -> Tensor:
        """Radians after each ``way``, where each of so many repeats has ``unit`` metres."""
        raise NotImplementedError


@dataclass(frozen=True)
class Corners(_Pattern):
    """Whoever goes turns a corner after every leg: back and forth, round a square, in a zigzag.

    Args:
        side: of the first corner: 1 to the left, -1 to the right.
        angle: radians of a corner.
        legs: a whole motion has as many, or a multiple of it.
        leg: metres of whoever walks between two corners, about; runs are longer.
        zigzag: corners lie to one side and to the other, the first being half a one.
    """

    side: int
    angle: float
    legs: int
    leg: float = 2.5
    zigzag: bool = False

    @property
    def says(self) -> str:
        """What is done, for users."""
        by = f"by {math.degrees(self.angle):.0f} degrees"
        if self.zigzag:
            return f"the way is bent to one side and to the other, {by}"
        return f"the way is bent to the {side_of(self.side)} again and again, {by}"

    def _unit(self, pace: float) -> float:
        return self.leg * (_LONGER if pace > _RUNS else 1.0) + self._corner(pace)

    def _corner(self, pace: float) -> float:
        """Metres along which one corner is turned."""
        return self.angle * max(_CORNER, pace / (_UNHURRIED * FASTEST))

    def _repeats(self, units: float) -> int:
        return self.legs * max(round(units / self.legs), _FEWEST if self.zigzag else 1)

    def _heading(self, way: Tensor, unit: float, pace: float, repeats: float) -> Tensor:
        corner = (way / unit).round().clamp_max(repeats - 1.0)  # the nearest
        done = ((way - corner * unit) / min(self._corner(pace), unit) + 0.5).clamp(0.0, 1.0)
        before, after = self._after(corner - 1.0), self._after(corner)
        return self.side * self.angle * torch.lerp(before, after, done)

    def _after(self, corner: Tensor) -> Tensor:
        """Corners to the side that lie behind whoever has turned this one; the first is 1."""
        if not self.zigzag:
            return corner.clamp_min(0.0)
        return torch.where(corner > 0.0, 0.5 - (corner + 1.0) % 2.0, 0.0)


@dataclass(frozen=True)
class FigureEight(_Pattern):
    """Whoever goes, goes round on one side and then on the other.

    Args:
        side: of the first circle: 1 to the left, -1 to the right.
        radius: metres, in a motion without an end; a whole one is one figure.
    """

    side: int
    radius: float = 1.2

    @property
    def says(self) -> str:
        """What is done, for users."""
        return f"the way is bent onto a circle to the {side_of(self.side)} and one to the {side_of(-self.side)}"

    def _unit(self, pace: float) -> float:
        return 4.0 * math.pi * max(self.radius, pace / FASTEST)

    def _repeats(self, units: float) -> int:
        return 1

    def _heading(self, way: Tensor, unit: float, pace: float, repeats: float) -> Tensor:
        return self.side * 2.0 * math.pi * (1.0 - (way / unit * 2.0 % 2.0 - 1.0).abs())
