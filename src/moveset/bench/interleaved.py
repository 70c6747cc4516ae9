"""Timing by paired, interleaved runs: what is compared is run in turns, so that a busy moment of a machine hits it all.

A *case* is a function that does its work once and says how long its parts took. In a round every case has a burst of
calls, in an order that changes from round to round; the first call of a burst is not counted: it finds the caches full
of another case's weights, while who uses a model calls it again and again. Ratios are taken within a round, between the
same call of two bursts.
"""

import random
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any

#: A case: from the number of the call to milliseconds (or counts) by part.
Case = Callable[[int], Mapping[str, float]]
Runs = Mapping[str, Sequence[Mapping[str, float]]]


def interleave(
    cases: Mapping[str, Case],
    rounds: int,
    *,
    warmup: int = 1,
    burst: int = 2,
    tick: Callable[[], object] = lambda: None,
) -> dict[str, list[Mapping[str, float]]]:
    """What every counted call of every case said, in order.

    Args:
        burst: calls of a case in a round; the first does not count unless it is the only one.
        tick: called after every case of every round.
    """
    found: dict[str, list[Mapping[str, float]]] = {name: [] for name in cases}
    order, shuffle = list(cases), random.Random(0)
    for k in range(-warmup, rounds):
        shuffle.shuffle(order)
        for name in order:
            said = [cases[name]((k + warmup) * burst + i) for i in range(burst)]
            if k >= 0:
                found[name] += said[1:] or said
            tick()
    return found


def summarise(runs: Runs, total: Sequence[str], parts: Sequence[str] = ()) -> dict[str, dict[str, Any]]:
    """Of every case: medians and minima of its parts and of their total, and the ratio to the first case.

    Args:
        total: parts that are added up.
        parts: all that are told; by default those of the total.

    Returns:
        By name of the case ``median_ms``, ``min_ms`` and ``mean_ms`` by part and of "total", ``calls``, and ``ratio``:
        the median over calls of this case's total to the first case's.
    """
    parts = parts or total
    totals = {name: [sum(row[part] for part in total) for row in rows] for name, rows in runs.items()}
    base = next(iter(totals.values()))
    out = {}
    for name, rows in runs.items():
        columns = {part: [row[part] for row in rows] for part in parts} | {"total": totals[name]}
        out[name] = {
            "median_ms": {part: round(statistics.median(values), 3) for part, values in columns.items()},
            "min_ms": {part: round(min(values), 3) for part, values in columns.items()},
            "mean_ms": {part: round(statistics.fmean(values), 3) for part, values in columns.items()},
            "calls": len(rows),
            "ratio": round(statistics.median(a / b for a, b in zip(totals[name], base, strict=True)), 3),
        }
    return out
