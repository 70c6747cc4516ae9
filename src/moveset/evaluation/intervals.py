"""Repeats to intervals.

An interval over repeats says how much a number moves when captions, crops, noise and groups are drawn again. It does
not say what another set of test items would give.
"""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from moveset.errors import InputError

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A mean and the half width of its 95 % interval; infinite where there was only one repeat."""

    mean: float
    half_width: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Interval":
        """Of n repeats: mean ± t s / √n, with Student's t of n - 1 degrees of freedom and the sample's deviation s.

        The papers print 1.96 times the population's deviation, which for five repeats is 1.6 times too narrow.

        Raises:
            InputError: no values, or values that are not finite.

        >>> Interval.of([1.0, 2.0, 3.0, 4.0, 5.0]).format(2)
        '3.00 ± 1.96'
        """
        if not values or not all(map(math.isfinite, values)):
            raise InputError(f"an interval needs one or more finite values, not {list(values)}")
        mean, count = statistics.fmean(values), len(values)
        if count == 1:
            return cls(mean, math.inf)
        return cls(mean, student_quantile(count - 1) * statistics.stdev(values) / math.sqrt(count))

    def to_json(self) -> dict[str, float | None]:
        """``{"mean", "interval"}``; the interval is the half width, null where it is unknown."""
        return {"mean": self.mean, "interval": self.half_width if math.isfinite(self.half_width) else None}

    @classmethod
    def from_json(cls, value: Mapping[str, float | None]) -> "Interval":
        """The inverse of ``to_json``.

        Raises:
            InputError: there is no mean.
        """
        mean, half = value.get("mean"), value.get("interval")
        if mean is None:
            raise InputError(f"an interval needs a 'mean', and {dict(value)} has none")
        return cls(mean, math.inf if half is None else half)

    def format(self, digits: int = 3) -> str:
        """As in a table.

        >>> Interval(0.5, 0.0123).format(), Interval(0.5, math.inf).format()
        ('0.500 ± 0.012', '0.500')
        """
        half = f" ± {self.half_width:.{digits}f}" if math.isfinite(self.half_width) else ""
        return f"{self.mean:.{digits}f}{half}"


@cache
def student_quantile(freedom: int) -> float:
    """t which Student's T of so many degrees of freedom exceeds in size with a chance of 5 %, by bisection.

    >>> round(student_quantile(4), 3), round(student_quantile(19), 3)
    (2.776, 2.093)
    """
    low, high = 0.0, math.pi / 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _within(middle, freedom) < CONFIDENCE else (low, middle)
    return math.sqrt(freedom) * math.tan((low + high) / 2)


def _within(angle: float, freedom: int) -> float:
    """P(|T| <= √freedom tan(angle)) (Abramowitz & Stegun 1964, 26.7.3 and 26.7.4)."""
    odd, cosine = freedom % 2, math.cos(angle)
    term = cosine if odd else 1.0
    total = term if freedom > 1 else 0.0
    for k in range(2 + odd, freedom - 1, 2):
        term *= cosine**2 * (k - 1) / k
        total += term
    return 2 / math.pi * (angle + math.sin(angle) * total) if odd else math.sin(angle) * total
