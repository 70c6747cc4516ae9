"""The report of ``efficiency.py``: Markdown tables of every size that was measured, a plot of time against length."""

import json
from collections.abc import Callable
from pathlib import Path

import matplotlib

from moveset.evaluation.intervals import Interval

matplotlib.use("Agg")
from matplotlib import pyplot as plt

TITLES = {"small": "Shipped sizes", "paper": "Published sizes", "tiny": "Sizes of the tests"}
BASELINES = ("MD-7", "DiP", "MotionDiffuse")
COLOURS = {"RDM-4": "C0", "RDM-7": "C1", "RDM-14": "C2", "DiP": "k"}

INTRODUCTION = """# What the recurrent model costs

Made by {made}; the numbers: [`{name}.json`]({name}.json).
Costs only, of networks with random weights, which cost what trained ones cost: nothing here says how good a motion is.

- K: sampler steps. *Calls* are evaluations of the network for one sample: of a segment of RDM and MD, of a chunk of
  DiP, of the whole clip of MotionDiffuse; guidance by two evaluations counts both. *Waves* are evaluations one after
  the other: a staircase evaluates all segments of a wave in one batch. What is bold was counted while it ran, and is
  equal to the sampler's closed form; the rest is that form.
- RDM's staircases: *triangle R = N* is the paper's fast setting, *full R = K* denoises every segment for as long as MD
  does, *parallelogram R = ⌈K/3⌉* lies between. The flow is applied to a later segment once, there and back (depth 1),
  where the paper composes it.
- MD-N: the network of RDM-N, all K steps of a segment after all of the one before. DiP: chunks of 40 frames, made for
  ten DDPM steps. Guidance, as published, doubles its calls; compare RDM, which has none here, with the row without it.
- Operations are those of **one sample in every row**, two for a multiplication and an addition
  (`torch.utils.flop_counter`). The frozen text encoder is in no number. *Text* is the network's own text layers: once a
  sample, or with every call where the network reads its text anew; its two numbers are those of the first and last K.
- Times are medians (minima) of interleaved runs, of sampling alone, or of one run where it says so. ≈ marks an
  estimate: the formula's calls of every wave, times the measured cost of a wave that wide.{lengths}
"""

PUBLISHED = """## The paper's own numbers

**Published, not measured here:** Table 3 of arXiv 2406.07169, KIT-ML, 196 frames, one NVIDIA H100, batch 128. Do not
compare a number of this block with one above: machine, batch and units differ.

| | DDIM 10 | 50 | 100 | 200 | DDPM 1000 |
|---|---|---|---|---|---|
| **time, s** | | | | | |
| MotionDiffuse | – | 2.71 | 4.92 | 9.79 | 52.07 |
| CLoSD (DiP) | 1.77 | 8.73 | 17.5 | 34.87 | (93.18) |
| MD-7 | – | 5.40 | 11.39 | 21.34 | 113.20 |
| RDM-4 | 0.21 | 1.95 | 2 | 3.26 | 10.89 |
| RDM-7 | 0.59 | 2.61 | 2.48 | 3.86 | 11.7 |
| RDM-14 | 0.20 | 4.26 | 3.66 | 5.2 | 13.17 |
| **FLOPs, T** | | | | | |
| MotionDiffuse | – | 64.64 | 128.44 | 256.02 | 1276.71 |
| CLoSD (DiP) | 45.89 | 229.44 | 458.88 | 917.76 | (2617.93) |
| MD-7 | – | 83.41 | 165.97 | 331.08 | 1652.01 |
| RDM-4 | 0.275 | 0.282 | 0.458 | 0.809 | 3.62 |
| RDM-7 | 0.66 | 0.533 | 0.644 | 0.866 | 2.32 |
| RDM-14 | 0.162 | 3 | 3.07 | 3.21 | 1.48 |

Its FLOPs mix units: the slope of MotionDiffuse's row, 1.276 T a step, is a batch of 128 at 9.93 G (likewise MD-7 and
DiP), while RDM-7's 2.22 G a step is one segment of one sample, so that in equal units its 1000 steps are 297 T against
1277 T: 4.3 times fewer, not 550 times.
"""


def write(data: dict, out: Path) -> str:
    """Writes OUT.json, OUT.md and, where lengths were measured, OUT.png; the Markdown."""
    out.parent.mkdir(parents=True, exist_ok=True)
    out.with_suffix(".json").write_text(json.dumps(data, indent=1) + "\n")
    drawn = next((found["lengths"] for found in data.values() if found["lengths"]), None)
    text = [introduction(data, out.name)]
    if drawn:
        plot(drawn, out.with_suffix(".png"))
        text.append(f"![time against length]({out.name}.png)\n")
    text += [section(name, found) for name, found in data.items()]
    out.with_suffix(".md").write_text("\n".join([*text, PUBLISHED]))
    return out.with_suffix(".md").read_text()


def introduction(data: dict, name: str) -> str:
    """What the numbers are, and which of them the file has."""
    made = " and ".join(f"`python benchmarks/efficiency.py --size {size.replace(', ', ' --device ')}`" for size in data)
    if not any(size.startswith("paper") for size in data):
        made += " (published sizes were not run)"
    items = [item for found in data.values() for item in found["lengths"]]
    lengths = ""
    if items and not any(_several(item) for item in items):
        lengths = "\n- Time against length is of one run each, so it scatters with the machine's load."
        if not any(map(_compared, items)):
            lengths += "\n  An earlier version of the command made it, and compared nothing."
    return INTRODUCTION.format(made=made, name=name, lengths=lengths)


def section(name: str, found: dict) -> str:
    """The tables of one size."""
    load, machine = found["load"], found["machine"]
    title = TITLES[name.partition(",")[0]] + (f", on {machine['device']}" if "device" in machine else "")
    busy = max(load.values()) > found["threads"] + 0.5
    parts = [
        f"## {title}\n\n{found['about'][:1].upper()}{found['about'][1:]}; {found['frames']} frames.\n",
        f"{machine['cpu']}, {found['threads']} of {machine['cores']} cores, torch {found['torch']}, {found['date']}; "
        f"rounds: {found['rounds']}, in {found['seconds']} s; load {load['before']} before, {load['after']} after"
        + (": **the machine was busy, read the minima only**.\n" if busy else ".\n"),
        grid(found, "Calls / waves of a sample", lambda c: _bold(f"{c['calls']} / {c['waves']}", c["counted"])),
        grid(
            found,
            "Operations of a sample, GFLOP: network + flow (applications of it)",
            lambda c: (
                _g(c["operations"]["network"])
                + (f" + {_g(c['operations']['flow'])} ({c['flow_applications']})" if c["flow_applications"] else "")
            ),
            extra=("text", lambda row: _text(row["columns"])),
        ),
    ]
    for batch in next(iter(found["rows"][0]["columns"].values()))["time"]:
        sequences = "1 sequence" if batch == "1" else f"{batch} sequences at once"
        parts.append(grid(found, f"Time of {sequences}, ms: median (minimum)", lambda c, b=batch: _time(c["time"][b])))
    parts += [accuracy(found), flow_share(found), against(found), memory(found), lengths(found)]
    return "\n".join(part for part in parts if part)


def grid(found: dict, title: str, cell: Callable[[dict], str], extra: tuple[str, Callable] | None = None) -> str:
    """A table of rows by K."""
    steps = list(found["rows"][0]["columns"])
    head = [f"K = {steps[0]}", *steps[1:], *([extra[0]] if extra else [])]
    rows = [
        [row["label"], *(cell(row["columns"][k]) for k in steps), *([extra[1](row)] if extra else [])]
        for row in found["rows"]
    ]
    return table(title, ["", *head], rows)


def table(title: str, head: list[str], rows: list[list[str]]) -> str:
    """Markdown of a table."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
    return f"### {title}\n\n" + "\n".join(lines) + "\n"


def accuracy(found: dict) -> str:
    """How well the estimates met the long runs, which they do not know of."""
    longest = [list(row["columns"].items())[-1] for row in found["rows"]]
    misses = [c["time"]["1"]["estimate_ms"] / c["time"]["1"]["median_ms"] - 1 for _, c in longest if c["counted"]]
    if not misses:
        return ""
    return f"Estimates of the runs of K = {longest[0][0]} missed them by {min(misses):+.0%} to {max(misses):+.0%}.\n"


def against(found: dict) -> str:
    """RDM-7 beside its baselines, in operations and in time."""
    measured = [
        k
        for k in found["rows"][0]["columns"]
        if all(r["columns"][k]["time"]["1"].get("runs", 0) > 1 for r in found["rows"])
    ] or steps_measured(found)
    few, many = measured[0], measured[-1]
    others = [(row, few if row["model"] == "DiP" else many) for row in found["rows"] if row["model"] in BASELINES]
    rows = []
    for row in (row for row in found["rows"] if row["model"] == "RDM-7"):
        own = row["columns"][many]
        cells = []
        for other, k in others:
            theirs = other["columns"][k]
            less = sum(theirs["operations"].values()) / sum(own["operations"].values())
            cells.append(f"{less:.2f} / {theirs['time']['1']['min_ms'] / own['time']['1']['min_ms']:.2f}")
        rows.append([f"{row['label']}, K = {many}", *cells])
    title = "How many times as much the others take: operations / time of 1 sequence (minima)"
    return table(title, ["", *(f"{other['label']}, K = {k}" for other, k in others)], rows)


def steps_measured(found: dict) -> list[str]:
    """Every K that was measured, once or more often."""
    return [k for k, c in found["rows"][0]["columns"].items() if "median_ms" in c["time"]["1"]]


def flow_share(found: dict) -> str:
    """The flow's share of time, where it was measured."""
    steps = steps_measured(found)
    rows = [row for row in found["rows"] if row["model"].startswith("RDM")]
    cells = [[row["label"], *(_flow(row["columns"][k]["time"]["1"]) for k in steps)] for row in rows]
    head = [f"K = {k}" for k in steps]
    return table("The flow's part of the time of 1 sequence, ms (share)", ["", *head], cells)


def memory(found: dict) -> str:
    """Peak memory, if it was measured."""
    if found["rows"][0]["memory"] is None:
        return ""
    held = found["rows"][0]["memory"]
    rows = [
        [
            row["label"],
            f"{row['memory']['peak_mb']:.0f}",
            f"{row['memory']['peak_mb'] - row['memory']['libraries_mb']:.0f}",
            f"{_parameters(row, found) * 4e-6:.1f}",
        ]
        for row in found["rows"]
    ]
    title = (
        f"Peak memory of a process of its own, MB (resident; batch {held['batch']}, K = {held['steps']}, one thread)"
    )
    return table(title, ["", "all", "more than Python and torch", "weights in it"], rows)


def lengths(found: dict) -> str:
    """Time by length and, where it was compared, how many times longer DiP's ten steps take."""
    if not found["lengths"]:
        return ""
    frames = sorted({item["frames"] for item in found["lengths"]})
    several, compared = (any(map(has, found["lengths"])) for has in (_several, _compared))
    lines, rows = curves(found["lengths"]), []
    for (label, steps), points in lines.items():
        cells = []
        for k in frames:
            if item := points.get(k):
                more = [_ms(item["min_ms"])] * several
                if _compared(item):
                    more.append(f"{_faster(item).format(2)} ×")
                cells.append(_ms(item["median_ms"]) + (f" ({', '.join(more)})" if more else ""))
            else:
                cells.append("–")
        rows.append([f"{label}, K = {steps}", *cells])
    ratio = f"times as fast as DiP at K = {min(k for _, k in lines)} in the same round"
    more = ["minimum"] * several + [ratio + ", with its 95 % interval" * several] * compared
    title = "Time against length, ms: " + ("median" if several else "one run each")
    return table(title + (f" ({', '.join(more)})" if more else ""), ["frames", *map(str, frames)], rows)


def curves(items: list[dict]) -> dict[tuple[str, int], dict[int, dict]]:
    """(row, K) -> frames -> entry."""
    out: dict[tuple[str, int], dict[int, dict]] = {}
    for item in items:
        out.setdefault((item["label"], item["steps"]), {})[item["frames"]] = item
    return out


def plot(items: list[dict], path: Path) -> None:
    """The paper's Figures 6, 9 and 10 in one: time and, if compared, times as fast as DiP at its own steps."""
    lines, compared = curves(items), any(map(_compared, items))
    steps = sorted({k for _, k in lines}, reverse=True)
    figure, row = plt.subplots(1, 1 + compared, figsize=(11, 5.2), squeeze=False)
    axes = row[0]
    for (label, k), points in lines.items():
        frames, model = sorted(points), label.split(",")[0]
        default = "parallelogram" in label
        style = {
            "color": COLOURS[model], "lw": 2.2 if default else 1.3, "ls": ("-", "--", ":")[steps.index(k) % 3],
            "marker": "s" if default else "o", "ms": 4, "label": f"{label}, K = {k}",
        }  # fmt: skip
        axes[0].plot(frames, [points[n]["min_ms"] / 1e3 for n in frames], **style)
        if compared and (label, k) != ("DiP", steps[-1]):
            ratios = [_faster(points[n]) for n in frames]
            halves = [ratio.half_width if ratio.half_width < float("inf") else 0.0 for ratio in ratios]
            axes[1].errorbar(frames, [ratio.mean for ratio in ratios], halves, capsize=2, **style)
    axes[0].set_ylabel("s (minimum)" if any(map(_several, items)) else "s (one run)")
    if compared:
        axes[1].axhline(1.0, color=COLOURS["DiP"], lw=0.8)
        axes[1].set_ylabel(f"times as fast as DiP, K = {steps[-1]}")
    for axis in axes:
        axis.set_yscale("log")
        axis.set_xlabel("frames")
        axis.grid(alpha=0.3, which="both")
    figure.tight_layout(rect=(0, 0.15, 1, 1))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncol=len(steps) * 2, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _several(item: dict) -> bool:
    return item["runs"] > 1


def _compared(item: dict) -> bool:
    """Whether it was compared with DiP of the same length and round; earlier versions of the command did not."""
    return "times_as_fast" in item


def _faster(item: dict) -> Interval:
    """How many times as fast as that."""
    return Interval.from_json(item["times_as_fast"])


def _parameters(row: dict, found: dict) -> int:
    return row["parameters"] + (found["flow_parameters"] if row["model"].startswith("RDM") else 0)


def _bold(text: str, yes: bool) -> str:
    return f"**{text}**" if yes else text


def _g(operations: int) -> str:
    return f"{operations / 1e9:.4g}"


def _text(columns: dict[str, dict]) -> str:
    """Operations of the text layers: one number, or the range over the K of the table."""
    few, many = (_g(columns[k]["operations"]["text"]) for k in (next(iter(columns)), list(columns)[-1]))
    return few if few == many else f"{few} … {many}"


def _ms(value: float) -> str:
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def _time(found: dict) -> str:
    if "median_ms" not in found:
        return f"≈ {_ms(found['estimate_ms'])}" if found else "–"
    if found["runs"] == 1:
        return f"{_ms(found['median_ms'])} (one run)"
    return f"{_ms(found['median_ms'])} ({_ms(found['min_ms'])})"


def _flow(found: dict) -> str:
    if "median_ms" not in found:
        return "–"
    return f"{_ms(found['flow_ms'])} ({100 * found['flow_ms'] / found['median_ms']:.0f} %)"
