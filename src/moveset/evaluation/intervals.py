"""Repeats to intervals, and whether two of them are apart.

An interval over repeats says how much a number moves when captions, crops, noise and groups are drawn again. It does
not say what another set of test items would give; ``evaluation.paired`` resamples items for that, and
``evaluation.repeat_pairs`` compares rows repeat by repeat.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch

from moveset.errors import InputError


@dataclass(frozen=True)
class Interval:
    """A mean and the half width of its 95 % interval; infinite where there was only one repeat."""

    mean: float
    half_width: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Interval":
        """Of repeats: mean ± 1.96 std / sqrt(n), with the population's standard deviation, as the papers print it.

        Raises:
            InputError: no values, or values that are not finite.

        >>> Interval.of([1.0, 3.0])
        Interval(mean=2.0, half_width=1.3859292911256331)
        """
        x = torch.tensor(list(values), dtype=torch.float64)
        if not len(x) or not torch.isfinite(x).all():
            raise InputError(f"an interval needs one or more finite values, not {list(values)}")
        spread = 1.96 * float(x.std(unbiased=False)) / math.sqrt(len(x)) if len(x) > 1 else math.inf
        return cls(float(x.mean()), spread)

    @property
    def low(self) -> float:
        """Lower end."""
        return self.mean - self.half_width

    @property
    def high(self) -> float:
        """Upper end."""
        return self.mean + self.half_width

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


def clear(a: Interval, b: Interval) -> bool:
    """Whether two intervals are disjoint: the difference of their means is more than what repeats make.

    >>> clear(Interval(1.0, 0.1), Interval(1.3, 0.1)), clear(Interval(1.0, 0.1), Interval(1.3, 0.2))
    (True, False)
    """
    return a.high < b.low or b.high < a.low
