"""What the tables are expected to show, checked number by number; and which rows really differ from which.

A difference counts where two rows' 95 % intervals do not touch; where nearer to real motion is better, those of the
distance to it. Everything else is a tie, in either direction.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from moveset.evaluation.columns import ALL, PHYSICAL, QUALITY, Column
from moveset.evaluation.intervals import Interval, clear

Verdict = Literal["met", "met within the intervals", "not met", "undecided by a single repeat", "not measured"]
Metrics = Mapping[str, Interval]
Rows = Mapping[str, Metrics]  # metrics by the row's key

PRECISION = ("r1", "r2", "r3")
PHYSICAL_LIMIT = 1.3
REAL = "real"


@dataclass(frozen=True)
class Check:
    """A target, whether it is met, and the numbers that say so."""

    target: str
    verdict: Verdict
    numbers: str


@dataclass(frozen=True)
class Difference:
    """How a row stands to a reference row: metrics that are better, worse, tied, and open, by their labels.

    Open is what one of the two has a single repeat of: there is no interval to be outside of.
    """

    row: str
    reference: str
    better: tuple[str, ...]
    worse: tuple[str, ...]
    tied: tuple[str, ...]
    open: tuple[str, ...] = ()

    def sentence(self, labels: Mapping[str, str]) -> str:
        """In words.

        >>> Difference("a", "b", ("FID",), (), ("MM-Dist", "Diversity")).sentence({"a": "PCM", "b": "LCM"})
        'PCM against LCM: better in FID; no difference outside the intervals in MM-Dist, Diversity.'
        """
        parts = [f"{said} in {', '.join(names)}" for said, names in (
            ("better", self.better), ("worse", self.worse), ("no difference outside the intervals", self.tied),
            ("undecided by a single repeat", self.open),
        ) if names]  # fmt: skip
        return f"{labels[self.row]} against {labels[self.reference]}: {'; '.join(parts)}."


def differences(rows: Rows, against: Mapping[str, Sequence[str]]) -> list[Difference]:
    """Rows against their reference rows, where both have been measured, in the metrics of quality that both have.

    Args:
        rows: by key.
        against: reference keys by key, in the order of what is returned.
    """
    real = rows.get(REAL, {})
    out = []
    for key, references in against.items():
        for reference in references:
            if key == reference or key not in rows or reference not in rows:
                continue
            found: dict[str, list[str]] = {"better": [], "worse": [], "tied": [], "open": []}
            for column in QUALITY:
                if column.name in rows[key] and column.name in rows[reference]:
                    a, b = rows[key][column.name], rows[reference][column.name]
                    found[_against(column, a, b, real) if _decided(a, b) else "open"].append(column.label)
            if any(found.values()):
                out.append(Difference(key, reference, **{verdict: tuple(names) for verdict, names in found.items()}))
    return out


def checks(suite: str, rows: Rows, shipped: Sequence[str], labels: Mapping[str, str]) -> list[Check]:
    """The targets of a suite.

    Args:
        suite: "motionpcm" or "rdm".
        rows: by key.
        shipped: keys of the rows of what ships, for the physical metrics.
        labels: of the rows.
    """
    if suite == "motionpcm":
        out = [
            *(
                outside(rows, "pcm-1", "lcm-1", column, "One-step PCM is better than one-step LCM in {}")
                for column in ("fid", *PRECISION)
            ),
            *(
                at_least(rows, "pcm-4", "teacher", column, "Four-step PCM is at or above the 50-step teacher in {}")
                for column in ("fid", *PRECISION)
            ),
        ]
    else:
        out = [
            within(rows, "rdm-7", "md-7", "fid", 0.1, "RDM-7's FID is at most a tenth of MD-7's"),
            *(
                check
                for student in ("rdm-pcm-1", "rdm-pcm-2")
                for check in (
                    within(rows, student, "rdm-7", "fid", 1.2, f"{labels[student]}: FID within 20 % of RDM-7's"),
                    *(
                        within(
                            rows, student, "rdm-7", column, 0.8,
                            f"{labels[student]}: {ALL[column].label} within 20 % of RDM-7's",
                        )
                        for column in PRECISION
                    ),
                )
            ),
        ]  # fmt: skip
    return [
        *out,
        *(
            physical(rows, key, column, labels[key])
            for key in shipped
            for column in PHYSICAL
            if column.name in rows[key]
        ),
    ]


def outside(rows: Rows, key: str, reference: str, metric: str, target: str) -> Check:
    """Better than a reference, with intervals that do not touch."""
    column, target = ALL[metric], target.format(ALL[metric].label)
    a, b = _pair(rows, key, reference, metric)
    if a is None or b is None:
        return Check(target, "not measured", "")
    if not _decided(a, b):
        return Check(target, "undecided by a single repeat", _numbers(column, a, b))
    met = _against(column, a, b, {}) == "better"
    return Check(target, "met" if met else "not met", _numbers(column, a, b))


def at_least(rows: Rows, key: str, reference: str, metric: str, target: str) -> Check:
    """As good as a reference: a mean that is no worse, or intervals that touch."""
    column, target = ALL[metric], target.format(ALL[metric].label)
    a, b = _pair(rows, key, reference, metric)
    if a is None or b is None:
        return Check(target, "not measured", "")
    no_worse = a.mean <= b.mean if column.better == "down" else a.mean >= b.mean
    verdict: Verdict = "met" if no_worse else "not met"
    if verdict == "not met" and not clear(a, b):
        verdict = "met within the intervals" if _decided(a, b) else "undecided by a single repeat"
    return Check(target, verdict, _numbers(column, a, b))


def within(rows: Rows, key: str, reference: str, metric: str, factor: float, target: str) -> Check:
    """At most (metrics that are better down) or at least (up) a factor times a reference's mean."""
    column = ALL[metric]
    a, b = _pair(rows, key, reference, metric)
    if a is None or b is None:
        return Check(target, "not measured", "")
    met = a.mean <= factor * b.mean if column.better == "down" else a.mean >= factor * b.mean
    return Check(target, "met" if met else "not met", f"{_numbers(column, a, b)}{_times(a, b)}")


def physical(rows: Rows, key: str, column: Column, label: str) -> Check:
    """At most 1.3 times the value of real motion."""
    target = f"{label}: {column.label} at most {PHYSICAL_LIMIT} times that of real motion"
    a, b = _pair(rows, key, REAL, column.name)
    if a is None or b is None:
        return Check(target, "not measured", "")
    if b.mean <= 0:
        return Check(target, "not measured", f"{_numbers(column, a, b)}: no ratio to zero")
    met = a.mean <= PHYSICAL_LIMIT * b.mean
    return Check(target, "met" if met else "not met", f"{_numbers(column, a, b)}{_times(a, b)}")


def _pair(rows: Rows, key: str, reference: str, metric: str) -> tuple[Interval | None, Interval | None]:
    return rows.get(key, {}).get(metric), rows.get(reference, {}).get(metric)


def _decided(a: Interval, b: Interval) -> bool:
    """Whether both have an interval to be outside of."""
    return math.isfinite(a.half_width) and math.isfinite(b.half_width)


def _against(column: Column, a: Interval, b: Interval, real: Metrics) -> Literal["better", "worse", "tied"]:
    value = real.get(column.name)
    nearest = None if value is None else value.mean
    ours, theirs = _reach(column, a, nearest), _reach(column, b, nearest)
    if ours is None or theirs is None:
        return "tied"
    return "better" if ours[1] < theirs[0] else "worse" if theirs[1] < ours[0] else "tied"


def _reach(column: Column, value: Interval, real: float | None) -> tuple[float, float] | None:
    """The least and the greatest ``Column.distance`` in an interval."""
    low, high = column.distance(value.low, real), column.distance(value.high, real)
    if low is None or high is None:
        return None
    # On both sides of real motion the nearest is none of the ends.
    inside = column.better == "real" and real is not None and value.low < real < value.high
    return 0.0 if inside else min(low, high), max(low, high)


def _numbers(column: Column, a: Interval, b: Interval) -> str:
    return f"{_one(column, a)} against {_one(column, b)}"


def _one(column: Column, value: Interval) -> str:
    mean, half = column.format(value)
    return f"{mean} ± {half}" if half else mean


def _times(a: Interval, b: Interval) -> str:
    return f", {a.mean / b.mean:.2f} times" if b.mean else ""
