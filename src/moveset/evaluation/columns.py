"""What the columns of a results table are called, which way is better, and which rows of a column are best."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from moveset.evaluation.intervals import Interval

Direction = Literal["up", "down", "real"]
Place = Literal["best", "second", ""]
ARROWS: dict[Direction, str] = {"up": "↑", "down": "↓", "real": "→"}


@dataclass(frozen=True)
class Column:
    """A metric as a column.

    Args:
        name: in results.
        label: in tables.
        better: "up", "down", or "real": the nearer to real motion.
        digits: behind the point.
        unit: of the printed numbers; "" for none.
        scale: from a result's number to the printed one.
    """

    name: str
    label: str
    better: Direction
    digits: int = 3
    unit: str = ""
    scale: float = 1.0

    @property
    def head(self) -> str:
        """Label, unit and arrow.

        >>> Column("jerk", "Jerk", "real", 1, "m/s³").head
        'Jerk, m/s³ →'
        """
        return f"{self.label}{', ' if self.unit else ''}{self.unit} {ARROWS[self.better]}"

    def printed(self, value: float) -> float:
        return round(value * self.scale, self.digits)

    def format(self, value: Interval) -> tuple[str, str]:
        """Mean and half width as printed; "" for a half width that one repeat cannot give.

        >>> Column("floating", "Floating", "real", 1, "mm", 1000.0).format(Interval(0.0123, 0.0004))
        ('12.3', '0.4')
        """
        mean = f"{value.mean * self.scale:.{self.digits}f}"
        return mean, f"{value.half_width * self.scale:.{self.digits}f}" if math.isfinite(value.half_width) else ""

    def distance(self, value: float, real: float | None) -> float | None:
        """What is smallest in the best row; None where real motion has no value to be near to."""
        if self.better == "real":
            return None if real is None else abs(value - real)
        return -value if self.better == "up" else value


QUALITY = (
    Column("r1", "R@1", "up"),
    Column("r2", "R@2", "up"),
    Column("r3", "R@3", "up"),
    Column("fid", "FID", "down"),
    Column("mm_dist", "MM-Dist", "down"),
    Column("diversity", "Diversity", "real"),
    Column("multimodality", "MModality", "up"),
    Column("sides", "Sides", "up"),
)
PHYSICAL = (
    Column("skating", "Skating", "real", 3, "share of frames"),
    Column("penetration", "Penetration", "real", 2, "mm", 1000.0),
    Column("floating", "Floating", "real", 2, "mm", 1000.0),
    Column("jerk", "Jerk", "real", 1, "m/s³"),
    Column("boundary_jerk", "Jerk at seams", "real", 1, "m/s³"),
    Column("root_drift", "Root drift", "real", 3, "m"),
)
ALL = {column.name: column for column in (*QUALITY, *PHYSICAL)}


def places(column: Column, values: Mapping[str, Interval], real: Interval | None) -> dict[str, Place]:
    """Which rows are best and second best, by key; rows whose printed numbers are equal share a place.

    >>> rows = {"a": Interval(0.5, 0.0), "b": Interval(0.50004, 0.0), "c": Interval(0.4, 0.0), "d": Interval(0.1, 0.0)}
    >>> places(Column("r1", "R", "up"), rows, None)
    {'a': 'best', 'b': 'best', 'c': 'second', 'd': ''}
    """
    nearest = None if real is None else column.printed(real.mean)
    distances = {key: column.distance(column.printed(value.mean), nearest) for key, value in values.items()}
    ranked = sorted({round(d, column.digits) for d in distances.values() if d is not None})
    names: dict[float, Place] = dict(zip(ranked, ("best", "second"), strict=False))
    return {key: "" if d is None else names.get(round(d, column.digits), "") for key, d in distances.items()}
