"""Repeats to intervals, and which rows of a table really differ from one of them.

An interval over repeats says how much a number moves when captions, crops, noise and groups are drawn again. It does
not say what another set of test items would give; ``evaluation.paired`` resamples items for that.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import torch

from moveset.errors import InputError

Verdict = Literal["better", "worse", "not apart"]


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


@dataclass(frozen=True)
class Comparison:
    """A row of a table against the reference row, in one metric.

    Args:
        difference: row minus reference. From the differences of equal repeats where both rows give them (the same
            items and groups were drawn in both, which cancels), else of the means with the half widths added.
        verdict: "better" or "worse" where the two rows' intervals are disjoint, "not apart" elsewhere.
    """

    row: str
    reference: str
    difference: Interval
    verdict: Verdict

    @property
    def paired_clear(self) -> bool:
        """Whether the interval of the difference leaves out zero: a finer test than disjoint intervals."""
        return abs(self.difference.mean) > self.difference.half_width


def compare(
    rows: Mapping[str, Interval | Sequence[float]], reference: str, *, higher_is_better: bool
) -> list[Comparison]:
    """Every other row of a table against one of them.

    Args:
        rows: by name, the repeats' values in their order, or only their interval.

    Raises:
        InputError: there is no such reference row, or two rows have different numbers of repeats.
    """
    if reference not in rows:
        raise InputError(f"there is no row {reference!r} to compare with; rows are {', '.join(map(repr, rows))}")
    against = rows[reference]
    found = []
    for name, row in rows.items():
        if name == reference:
            continue
        one, other = _interval(row), _interval(against)
        if isinstance(row, Interval) or isinstance(against, Interval):
            difference = Interval(one.mean - other.mean, one.half_width + other.half_width)
        elif len(row) != len(against):
            raise InputError(
                f"row {name!r} has {len(row)} repeats and {reference!r} {len(against)}; run both as often, or compare "
                "their intervals"
            )
        else:
            difference = Interval.of([a - b for a, b in zip(row, against, strict=True)])
        verdict: Verdict = "not apart"
        if clear(one, other):
            verdict = "better" if (one.mean > other.mean) == higher_is_better else "worse"
        found.append(Comparison(name, reference, difference, verdict))
    return found


def statement(metric: str, comparisons: Sequence[Comparison]) -> str:
    """One sentence for below a table: which rows are outside the reference's interval.

    Raises:
        InputError: nothing to state, or different reference rows.
    """
    references = {c.reference for c in comparisons}
    if len(references) != 1:
        raise InputError(f"a statement needs comparisons with one reference row, not with {sorted(references)}")
    verdicts: tuple[Verdict, ...] = ("better", "worse", "not apart")
    parts = []
    for verdict in verdicts:
        if names := [c.row for c in comparisons if c.verdict == verdict]:
            said = "within the interval" if verdict == "not apart" else f"{verdict}, outside the intervals"
            parts.append(f"{', '.join(names)} ({said})")
    return f"{metric} against {references.pop()}: {'; '.join(parts)}."


def _interval(row: Interval | Sequence[float]) -> Interval:
    return row if isinstance(row, Interval) else Interval.of(row)
