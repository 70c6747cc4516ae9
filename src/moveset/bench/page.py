"""The report of ``moveset bench`` as a page: Markdown tables and one picture, from its JSON alone."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moveset.evaluation.markdown import lined
from moveset.evaluation.plots import COLOURS, STYLE
from moveset.evaluation.published import tables
from moveset.io.limits import atomic_write, write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Report = Mapping[str, Any]

INTRODUCTION = """# What motion costs

Made by `moveset bench`; the numbers: [`{name}.json`]({name}.json). Times are medians (minima) in milliseconds of runs
in turns: in every round each row of a table runs a few times, in an order that changes, and the first of these runs
does not count. *×* is the median ratio to the table's first row within the same round: it holds on other machines
where milliseconds do not.
"""


def write_page(report: Report, path: Path) -> list[Path]:
    """Writes PATH (JSON), and beside it the Markdown page and, where there is something to draw, the picture.

    Raises:
        InputError: the folder cannot be written to.
    """
    written = [path, path.with_suffix(".md")]
    write_text(path, json.dumps(report, indent=1, ensure_ascii=False) + "\n")
    picture = path.with_suffix(".png")
    if draw(report, picture):
        written.append(picture)
    write_text(written[1], markdown(report, path.stem, pictured=len(written) > 2))
    return written


def markdown(report: Report, name: str = "benchmarks", pictured: bool = False) -> str:
    parts = [INTRODUCTION.format(name=name), machine(report)]
    if pictured:
        parts.append(f"![AITS by part, time by length and by batch]({name}.png)")
    for part, section in SECTIONS.items():
        if part in report:
            parts.append(section(report))
    parts.append(published())
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def machine(report: Report) -> str:
    """What it was measured on, and whether that was quiet."""
    m, load = report["machine"], report["load"]
    gpu = f", {m['gpu']}" if m["gpu"] and m["device"] != "cpu" else ""
    text = (
        f"{m['cpu']}{gpu}, threads: {m['threads']} of {m['cores']} (OpenMP waits: {m['waiting']}), "
        f"torch {m['torch']}, Python {m['python']}, {m['system']}; device {m['device']}; moveset {report['moveset']}, "
        f"{report['date']}; rounds: {report['plan']['rounds']}, {report['wall_seconds']:.0f} s in all"
    )
    if load["before"] is None:
        return f"{text}."
    busy = load["before"] > 0.5
    return f"{text}; load before {load['before']}" + (
        ": **the machine was busy, read ratios and minima**." if busy else "."
    )


def clips(report: Report) -> str:
    model, counts = report["models"]["clips"], report.get("operations", {}).get("clips", {})
    seconds = model["frames"] / model["fps"]
    body = []
    for name, row in report["clips"].items():
        aits = row["median_ms"]["total"]
        parts = [_ms(row, part) for part in ("text", "sample", "decode")]
        operations = _giga(sum(counts[name].values())) if name in counts else "–"
        cells = [*parts, f"**{_ms(row, 'total')}**", _ms(row, "joints"), _ms(row, "export"), f"{row['ratio']:.2f}"]
        body.append([name, str(row["evaluations"]), *cells, f"{model['frames'] / aits * 1e3:,.0f}", operations])
    head = ["", "calls", "text", "sample", "decode", "AITS", "joints", "export", "×", "frames/s", "GFLOP"]
    first = next(iter(report["clips"]))
    return f"""## A clip of {seconds:g} s: `{model["name"]}`

AITS, average inference time per sentence, is text + sample + decode at batch 1, from a sentence to rotations. Then
joints: all positions; export: feet held, and a BVH file written. × is to {first}, of AITS. Operations are those of
text, sampling and decoding.

{lined(head, body)}"""


def streams(report: Report) -> str:
    model, counts = report["models"]["streams"], report.get("operations", {}).get("streams", {})
    seconds = model["frames"] / model["fps"]
    body = []
    for name, row in report["streams"].items():
        settings = row["settings"]
        operations = _giga(counts[name]["segment"]) if name in counts else "–"
        times = f"{seconds * 1e3 / row['median_ms']['segment']:.1f}"
        cells = [str(row["steps"]), str(settings["start"]), f"{row['evaluations']:g}", _ms(row, "first")]
        body.append([name, *cells, f"**{_ms(row, 'segment')}**", f"{row['ratio']:.2f}", times, operations])
    head = ["", "K", "R", "calls", "first segment", "segment", "×", "× real time", "GFLOP"]
    return f"""## A stream, {seconds:g} s a segment: `{model["name"]}`

First segment: from a prompt never heard before to the motion it makes, text and all, with the segments that were in
work finished first. R: steps of a segment that follows another; calls are those of one segment.

{lined(head, body)}"""


def lengths(report: Report) -> str:
    body = [
        [
            label,
            f"{p['seconds']:g}",
            f"{p['median_ms']:.1f} ({p['min_ms']:.1f})",
            f"{p['median_ms'] / p['seconds']:.2f}",
        ]
        for label, points in report["lengths"].items()
        for p in points
    ]
    return f"""## Time by length

Text to rotations, without a file.

{lined(["", "seconds of motion", "ms", "ms a second"], body)}"""


def batches(report: Report) -> str:
    sizes = list(next(iter(report["batches"].values())))
    body = [
        [name, *(f"{_ms(row[size], 'clip')}, {row[size]['ratio']:.2f} ×" for size in sizes)]
        for name, row in report["batches"].items()
    ]
    return f"""## Time of one clip by batch

Milliseconds a clip, and × that of a batch of one; every clip has a sentence of its own, feet held, no file.

{lined(["batch", *sizes], body)}"""


def processes(report: Report) -> str:
    body = []
    for name, row in report["processes"].items():
        first = row.get("first_segment_seconds")
        cells = [row["seconds"], *([first] if first else [])]
        times = [f"{cell['median']:.2f} ({cell['min']:.2f})" for cell in cells]
        body.append([name, times[0], times[1] if first else "–", f"{row['peak_mb']['median']:.0f}"])
    return f"""## Whole processes

`moveset generate` and `moveset stream` from nothing to a written file: imports, weights, text encoder and all.
Memory is the most that was resident.

{lined(["", "seconds", "to the first segment, s", "peak memory, MB"], body)}"""


def operations(report: Report) -> str:
    """Operations by stage; the sums stand with the times."""
    found = report["operations"]
    body = [
        [name, *(_giga(row[part]) for part in ("text", "sample", "decode"))] for name, row in found["clips"].items()
    ]
    segments = [[name, _giga(row["text"]), _giga(row["segment"])] for name, row in found["streams"].items()]
    return f"""## Operations

10⁹, two for a multiplication and an addition (`torch.utils.flop_counter`), at batch 1. A segment's include the flow's.

{lined(["a clip", "text", "sample", "decode"], body)}

{lined(["a segment", "text (once a prompt)", "segment"], segments)}"""


def endless(report: Report) -> str:
    rows = report["endless"]
    body = [
        [f"{row['segments']}", f"{row['median_ms']:.1f} ({row['min_ms']:.1f})", f"{row['memory_mb']:.0f}"]
        for row in (rows[0], rows[len(rows) // 2], rows[-1])
    ]
    return f"""## A stream without end

Resident is the benchmark's own process, with all that it measured before: what matters is that it stays.

{lined(["after segments", "ms a segment", "resident, MB"], body)}"""


def published() -> str:
    """What the paper prints of times: another machine, another model, another data set."""
    table = next(t for t in tables("motionpcm") if "aits" in t.columns)
    body = [[row.method, row.cells["aits"], row.cells["fid"]] for row in table.rows if row.cells["aits"] != "–"]
    return f"""## The paper's own numbers

**Published, not measured here** ({table.source}; {table.dataset}, a GPU): compare nothing of this block with a number
above. {" ".join(table.notes)}

{lined(["", "AITS, s", "FID"], body)}"""


SECTIONS = {
    "clips": clips, "streams": streams, "lengths": lengths, "batches": batches, "processes": processes,
    "operations": operations, "endless": endless,
}  # fmt: skip


def draw(report: Report, path: Path) -> bool:
    """Writes the picture; whether there was anything to draw."""
    import matplotlib
    from matplotlib.figure import Figure

    panels = [(part, plot) for part, plot in PLOTS.items() if part in report]
    if not panels:
        return False
    with matplotlib.rc_context(STYLE):
        across = 2 if len(panels) > 1 else 1
        down = -(-len(panels) // across)
        figure = Figure(figsize=(5.2 * across, 3.6 * down), layout="constrained")
        axes = list(figure.subplots(down, across, squeeze=False).flat)
        for spare in axes[len(panels) :]:
            spare.remove()
        for (name, plot), place in zip(panels, axes, strict=False):
            plot(report, place)
            place.grid(axis="both" if name != "clips" else "x")
        with atomic_write(path) as file:
            figure.savefig(file, format="png", dpi=100, transparent=True)
    return True


def _aits(report: Report, axes: "Axes") -> None:
    names = list(report["clips"])
    left = [0.0] * len(names)
    for part, colour in zip(("text", "sample", "decode", "joints", "export"), COLOURS, strict=False):
        widths = [report["clips"][name]["median_ms"][part] for name in names]
        axes.barh(names, widths, left=left, color=colour, label=part, height=0.65)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.invert_yaxis()
    axes.set(title="one clip by stage", xlabel="ms")
    axes.legend(frameon=False)


def _by_length(report: Report, axes: "Axes") -> None:
    for (label, points), colour in zip(report["lengths"].items(), COLOURS, strict=False):
        xs, ys = [p["seconds"] for p in points], [p["median_ms"] for p in points]
        axes.plot(xs, ys, marker="o", ms=4, color=colour, label=label)
    axes.set(title="time by length", xlabel="seconds of motion", ylabel="ms", xscale="log", yscale="log")
    _plain(axes, "xy")
    axes.legend(frameon=False)


def _by_batch(report: Report, axes: "Axes") -> None:
    for (name, row), colour in zip(report["batches"].items(), COLOURS, strict=False):
        xs, ys = [int(size) for size in row], [found["median_ms"]["clip"] for found in row.values()]
        axes.plot(xs, ys, marker="o", ms=4, color=colour, label=name)
    axes.set(title="time of a clip by batch", xlabel="batch", ylabel="ms a clip", xscale="log", yscale="log")
    sizes = list(next(iter(report["batches"].values())))
    _plain(axes, "y")
    axes.set_xticks([int(size) for size in sizes], sizes)
    axes.set_xticks([], minor=True)
    axes.legend(frameon=False)


def _plain(axes: "Axes", which: str) -> None:
    """Numbers on logarithmic axes as people write them."""
    from matplotlib.ticker import LogFormatter

    class Plain(LogFormatter):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return f"{x:g}" if super().__call__(x, pos) else ""

    for axis in (axes.xaxis if name == "x" else axes.yaxis for name in which):
        axis.set_major_formatter(Plain())
        axis.set_minor_formatter(Plain(minor_thresholds=(1.5, 0.5)))


PLOTS = {"clips": _aits, "lengths": _by_length, "batches": _by_batch}


def _ms(row: Mapping[str, Any], part: str) -> str:
    median, low = row["median_ms"][part], row["min_ms"][part]
    return f"{median:.1f} ({low:.1f})" if median < 1000 else f"{median:,.0f} ({low:,.0f})"


def _giga(count: int) -> str:
    return f"{count / 1e9:.3g}"
