"""Rows of a table against each other, repeat by repeat.

What is random depends on (seed, repeat, item) alone (``evaluation.protocol``), so equal repeats of two rows were given
the same captions, lengths and groups, and what those do to a number cancels in the difference. It does not say what
other items would show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from moveset.evaluation.columns import QUALITY, Column
from moveset.evaluation.intervals import Interval

Values = Mapping[str, Sequence[float]]  # every repeat's value, by metric


@dataclass(frozen=True)
class Comparison:
    """A row against a reference row.

    Args:
        differences: row minus reference by metric, mean and 95 % interval over the repeats that both have.
    """

    row: str
    reference: str
    repeats: int
    differences: Mapping[str, Interval]


def compare(rows: Mapping[str, Values], against: Mapping[str, Sequence[str]]) -> list[Comparison]:
    """Rows against their reference rows, where both have two repeats, in metrics that have a better way.

    Args:
        rows: by key; all drawn from one seed.
        against: reference keys by key, in the order of what is returned.

    >>> rows = {"a": {"fid": [1.0, 2.0, 3.0]}, "b": {"fid": [0.5, 1.5, 2.5, 9.0]}}
    >>> [(found.repeats, found.differences["fid"].format(1)) for found in compare(rows, {"b": ["a"]})]
    [(3, '-0.5 ± 0.0')]
    """
    out = []
    for key, reference in ((key, reference) for key, references in against.items() for reference in references):
        one, other = rows.get(key, {}), rows.get(reference, {})
        found = {
            column.name: [a - b for a, b in zip(one[column.name], other[column.name], strict=False)]
            for column in QUALITY
            if column.better != "real" and column.name in one and column.name in other
        }
        repeats = min(map(len, found.values()), default=0)
        if key != reference and repeats > 1:
            intervals = {name: Interval.of(values) for name, values in found.items()}
            out.append(Comparison(key, reference, repeats, intervals))
    return out


def verdict(column: Column, difference: Interval) -> Literal["better", "worse", ""]:
    """What a difference says; "" where its interval holds zero.

    >>> verdict(Column("fid", "FID", "down"), Interval(-0.02, 0.01))
    'better'
    """
    if abs(difference.mean) <= difference.half_width:
        return ""
    return "better" if (difference.mean > 0) == (column.better == "up") else "worse"
