"""Rows of a table against each other, repeat by repeat.

What is random depends on (seed, repeat, item) alone (``evaluation.protocol``), so equal repeats of two rows were given
the same captions, lengths and groups, and what those do to a number cancels in the difference. It is a finer
look than two intervals that touch or not, at the same items: it does not say what other items would show.
"""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from moveset.evaluation.columns import QUALITY, Column
from moveset.evaluation.intervals import Interval

LEAST = 5  # common repeats; the spread of fewer differences is hardly known

Values = Mapping[str, Sequence[float]]  # every repeat's value, by metric


@dataclass(frozen=True)
class RepeatPairs:
    """A row against a reference row.

    Args:
        row, reference: their keys.
        repeats: how many both have.
        differences: row minus reference by metric, mean and 95 % interval over the repeats that both have.
    """

    row: str
    reference: str
    repeats: int
    differences: Mapping[str, Interval]


def repeat_pairs(rows: Mapping[str, Values], against: Mapping[str, Sequence[str]]) -> list[RepeatPairs]:
    """Rows against their reference rows, where both have five repeats in common, in metrics that have a better way.

    Args:
        rows: by key; all drawn from one seed.
        against: reference keys by key, in the order of what is returned.

    >>> rows = {"a": {"fid": [1.0, 2.0, 3.0, 4.0, 5.0]}, "b": {"fid": [0.5, 1.5, 2.5, 3.5, 4.5, 9.0]}}
    >>> [(found.repeats, found.differences["fid"].format(1)) for found in repeat_pairs(rows, {"b": ["a"]})]
    [(5, '-0.5 ± 0.0')]
    """
    out = []
    for key, references in against.items():
        for reference in references:
            one, other = rows.get(key, {}), rows.get(reference, {})
            found = {
                column.name: [a - b for a, b in zip(one[column.name], other[column.name], strict=False)]
                for column in QUALITY
                if column.better != "real" and column.name in one and column.name in other
            }
            repeats = min(map(len, found.values()), default=0)
            if key != reference and repeats >= LEAST:
                intervals = {name: student_interval(values) for name, values in found.items()}
                out.append(RepeatPairs(key, reference, repeats, intervals))
    return out


def student_interval(values: Sequence[float]) -> Interval:
    """Mean and 95 % interval by Student's t, which the papers' interval is too narrow for: of five values, by a third.

    The quantile is an asymptotic expansion (Abramowitz & Stegun, 26.7.5), within .3 % from four degrees of freedom on.

    >>> student_interval([1.0, 2.0, 3.0, 4.0, 5.0]).format(2)
    '3.00 ± 1.96'
    """
    z, free = 1.959964, len(values) - 1
    t = z + (z**3 + z) / (4 * free) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * free**2)
    t += (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * free**3)
    return Interval(statistics.fmean(values), t * statistics.stdev(values) / math.sqrt(len(values)))


def verdict(column: Column, difference: Interval) -> str:
    """What a difference says: "better", "worse", or "" where its interval holds zero.

    >>> verdict(Column("fid", "FID", "down"), Interval(-0.02, 0.01))
    'better'
    """
    if abs(difference.mean) <= difference.half_width:
        return ""
    return "better" if (difference.mean > 0) == (column.better == "up") else "worse"
