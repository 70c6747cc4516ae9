"""Plots of a table: quality against time with the Pareto front, and bars with intervals.

They are read on light and on dark pages: the ground is transparent, and lines and letters are of a grey that both show.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from moveset.evaluation.columns import ALL, Column
from moveset.evaluation.suites import REAL
from moveset.evaluation.table import Table
from moveset.io.limits import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

_WIDE = 20.0  # ratio of values from which on an axis is logarithmic
GREY = "#808890"
COLOURS = ("#3b82f6", "#e8833a", "#2ea36b", "#c157c9", "#d94f4f", "#9a8b1f", "#4fa7b5")
STYLE = {
    "text.color": GREY, "axes.labelcolor": GREY, "axes.edgecolor": GREY, "xtick.color": GREY, "ytick.color": GREY,
    "axes.titlecolor": GREY, "grid.color": GREY, "grid.alpha": 0.25, "axes.spines.top": False,
    "axes.spines.right": False, "font.size": 9,
}  # fmt: skip


def draw(table: Table, folder: Path) -> list[str]:
    """Writes the plots that the numbers allow, as SUITE-time.png and SUITE-bars.png; their names.

    Bars need two rows with numbers, the front two rows with times.
    """
    import matplotlib
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    ranked = [e.row.key for e in table.rows if e.row.ranked and e.result is not None]
    out = []
    with matplotlib.rc_context(STYLE):
        for name, keys, plot in (
            ("time", [key for key in ranked if table.measured[key].seconds is not None], _fronts),
            ("bars", [key for key in ranked if {"fid", "r1"} & set(table.metrics[key])], _bars),
        ):
            if len(keys) < 2:
                continue
            figure = Figure(figsize=(10.0, max(3.4, 0.26 * len(keys) + 1.2)), layout="constrained")
            plot(table, keys, figure)
            out.append(f"{table.suite.name}-{name}.png")
            with atomic_write(folder / out[-1]) as file:
                figure.savefig(file, format="png", dpi=100, transparent=True)
    return out


def front(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Keys of the points that no other beats in both: (time, badness), each the smaller the better; by time.

    >>> front({"a": (1.0, 5.0), "b": (2.0, 3.0), "c": (2.0, 4.0), "d": (3.0, 3.0)})
    ['a', 'b']
    """
    best, out = float("inf"), []
    for key, (_, bad) in sorted(points.items(), key=lambda item: item[1]):
        if bad < best:
            best = bad
            out.append(key)
    return out


def _fronts(table: Table, keys: Sequence[str], figure: "Figure") -> None:
    handles = {}
    for axes, metric in zip(figure.subplots(1, 2), ("fid", "r1"), strict=True):
        column = ALL[metric]
        sign = -1.0 if column.better == "up" else 1.0
        points = {}
        for key in keys:
            seconds, metrics = table.measured[key].seconds, table.metrics[key]
            if seconds is not None and metric in metrics:
                points[key] = (1e3 * seconds, metrics[metric].mean)
        for key, (x, y) in points.items():
            dot = axes.scatter(x, y, s=26, color=_colour(table, key), zorder=3)
            axes.annotate(str(keys.index(key) + 1), (x, y), xytext=(4, 3), textcoords="offset points")
            handles[key] = dot
        best = front({key: (x, sign * y) for key, (x, y) in points.items()})
        axes.step(*zip(*(points[key] for key in best), strict=True), where="post", color=GREY, lw=1, ls="--")
        axes.set(xlabel="ms an item", ylabel=column.head)
        _logarithmic(axes.xaxis)
        if _wide(column, [y for _, y in points.values()]):
            _logarithmic(axes.yaxis)
        else:
            _real(table, metric, axes, vertical=False)
        axes.grid()
    names = [f"{keys.index(key) + 1}  {table.labels[key]}" for key in handles]
    figure.legend(handles.values(), names, loc="outside right center", frameon=False, fontsize=8)


def _wide(column: Column, values: Sequence[float]) -> bool:
    """Whether bad rows would press the good ones together at the end of a linear axis."""
    return column.better == "down" and 0 < _WIDE * min(values, default=0.0) < max(values, default=0.0)


def _logarithmic(axis: "Axis") -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    getattr(axis.axes, f"set_{axis.axis_name}scale")("log")
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(ScalarFormatter())
    axis.set_minor_formatter(NullFormatter())


def _bars(table: Table, keys: Sequence[str], figure: "Figure") -> None:
    places = range(len(keys))
    for axes, metric in zip(figure.subplots(1, 2, sharey=True), ("fid", "r1"), strict=True):
        for place, key in zip(places, keys, strict=True):
            value = table.metrics[key].get(metric)
            if value is None:
                continue
            half = value.half_width if value.half_width < float("inf") else None
            axes.barh(
                place,
                value.mean,
                xerr=half,
                color=_colour(table, key),
                height=0.7,
                error_kw={"ecolor": GREY, "lw": 1.2},
            )
        axes.set(xlabel=ALL[metric].head, yticks=list(places), yticklabels=[table.labels[key] for key in keys])
        known = [table.metrics[key][metric].mean for key in keys if metric in table.metrics[key]]
        if _wide(ALL[metric], known):
            _logarithmic(axes.xaxis)
            axes.set_xlim(left=0.5 * min(known))
        else:
            _real(table, metric, axes, vertical=True)
        axes.grid(axis="x")
    axes.invert_yaxis()  # shared, so once


def _real(table: Table, metric: str, axes: "Axes", vertical: bool) -> None:
    found = table.metrics.get(REAL, {}).get(metric)
    if found is not None:
        (axes.axvline if vertical else axes.axhline)(found.mean, color=GREY, lw=1, ls=":")


def _colour(table: Table, key: str) -> str:
    groups = list(dict.fromkeys(entry.row.group for entry in table.rows))
    group = next(entry.row.group for entry in table.rows if entry.row.key == key)
    return COLOURS[groups.index(group) % len(COLOURS)]
