"""Bars of a table, with intervals.

They are read on light and on dark pages: the ground is transparent, and lines and letters are of a grey that both show.
"""

from pathlib import Path

from moveset.evaluation.columns import ALL
from moveset.evaluation.suites import REAL
from moveset.evaluation.table import Table
from moveset.io.limits import atomic_write

WIDE = 20.0  # ratio of distances from which on an axis is logarithmic: else bad rows would press the good ones together
GREY = "#808890"
COLOURS = ("#3b82f6", "#e8833a", "#2ea36b", "#c157c9", "#d94f4f", "#9a8b1f", "#4fa7b5")
STYLE = {
    "text.color": GREY, "axes.labelcolor": GREY, "axes.edgecolor": GREY, "xtick.color": GREY, "ytick.color": GREY,
    "axes.titlecolor": GREY, "grid.color": GREY, "grid.alpha": 0.25, "axes.spines.top": False,
    "axes.spines.right": False, "font.size": 9,
}  # fmt: skip


def draw(table: Table, folder: Path) -> list[str]:
    """Writes SUITE-bars.png, FID and R@1 of the rows that sample, if there are two; names of what was written."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    rows = [row for row in table.rows if row.ranked and all(table.value(row.key, name) for name in ("fid", "r1"))]
    if len(rows) < 2:
        return []
    groups = list(dict.fromkeys(row.group for row in table.rows))
    colours = [COLOURS[groups.index(row.group) % len(COLOURS)] for row in rows]
    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.0, max(3.4, 0.26 * len(rows) + 1.2)), layout="constrained")
        for axes, metric in zip(figure.subplots(1, 2, sharey=True), ("fid", "r1"), strict=True):
            found = [table.measured[row.key].metrics[metric] for row in rows]
            means = [value.mean for value in found]
            halves = [value.half_width if value.half_width < float("inf") else 0.0 for value in found]
            error = {"ecolor": GREY, "lw": 1.2}
            axes.barh(range(len(rows)), means, xerr=halves, color=colours, height=0.7, error_kw=error)
            axes.set(xlabel=ALL[metric].head, yticks=range(len(rows)), yticklabels=[row.label for row in rows])
            if metric == "fid" and 0 < WIDE * min(means) < max(means):
                axes.set_xscale("log")
                axes.set_xlim(left=0.5 * min(means))
                axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axes.xaxis.set_major_formatter(ScalarFormatter())
                axes.xaxis.set_minor_formatter(NullFormatter())
            elif real := table.value(REAL, metric):
                axes.axvline(real.mean, color=GREY, lw=1, ls=":")
            axes.grid(axis="x")
        axes.invert_yaxis()  # shared, so once
        name = f"{table.suite.name}-bars.png"
        with atomic_write(folder / name) as file:
            figure.savefig(file, format="png", dpi=100, transparent=True)
    return [name]
