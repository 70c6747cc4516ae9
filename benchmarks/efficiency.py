"""What the recurrent model costs beside its baselines: calls, waves, operations, time and memory; time by length.

    python benchmarks/efficiency.py --size small      # shipped sizes, less than an hour on a quiet two-core machine
    python benchmarks/efficiency.py --size paper      # published sizes, about eight minutes
    python benchmarks/efficiency.py --size paper --device cuda      # with batches of 128 and lengths, as in the paper
    python benchmarks/efficiency.py --quick --out /tmp/efficiency      # does it run? a minute

Random weights are right here: what a call costs does not depend on them. Nothing is said about quality.

One round runs every sampler, number of steps, batch and length once, in an order that changes, so that a busy moment
of the machine hits all of them; what is long is run in the first round only, the rest until the time is used up. Time
against length (the paper's Figures 6, 9 and 10) is compared within each round: with DiP of the same length in it.
Calls and waves are counted in every run, and operations in one of its own; a run that differs from the closed form of
its sampler ends the benchmark. Quote minima beside medians, and look at the load that is printed with them.

JSON, Markdown and (if lengths were measured) a plot are written to OUT.json, OUT.md, OUT.png. One file holds all
sizes: a run replaces its own.
"""

import argparse
import json
import os
import platform
import random
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import NamedTuple

import torch

from arguments import Parser, at_least, positive, report_path
from efficiency_methods import HORIZON, PARALLELOGRAM, ROWS, SIZES, TRIANGLE, Methods, Row, expected, pieces, staircase
from efficiency_tally import Meter, Tally
from moveset.bench.machine import cpu_name, peak_mb
from moveset.errors import InputError, exit_code_of
from moveset.evaluation.intervals import Interval
from moveset.io.manifest import json_object

LENGTH_ROWS = (
    *(Row(f"RDM-{n}", TRIANGLE) for n in (4, 7, 14)),
    Row("RDM-7", PARALLELOGRAM),
    Row("DiP"),
)
DIP_STEPS = 10


class Cell(NamedTuple):
    """What is timed: a sampler at K steps, for a batch of sequences of so many frames."""

    row: Row
    steps: int
    batch: int = 1
    frames: int = HORIZON


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is measured.

    Args:
        repeated: (K, batch) of the cells of every round.
        once: (K, batch) of those of the first round only.
        columns: K of the tables; those not measured are estimated.
        long: K of the longest column, measured once; None leaves it out.
        lengths: frames of the sequences that are timed by length in every round, at ``length_steps``.
        rounds: at most.
        minutes: after which no further round begins.
        memory_batch: sequences in the processes whose memory is measured; None measures none.
    """

    repeated: tuple[tuple[int, int], ...]
    once: tuple[tuple[int, int], ...] = ()
    columns: tuple[int, ...] = (10, 50, 100, 200, 1000)
    long: int | None = None
    lengths: tuple[int, ...] = ()
    length_steps: tuple[int, ...] = (DIP_STEPS, 50, 100)
    rounds: int = 7
    minutes: float = 4.0
    memory_batch: int | None = 8

    @property
    def fewest(self) -> int:
        """The smallest K: what operations are counted at."""
        return min(steps for steps, _ in self.repeated)

    def cells(self) -> tuple[list[Cell], list[Cell]]:
        """(cells of every round, further cells of the first)."""
        every = [Cell(row, *how) for how in self.repeated for row in ROWS]
        first = [Cell(row, *how) for how in self.once for row in ROWS]
        first += [Cell(row, self.long) for row in ROWS if self.long]
        ends = (*self.lengths[:1], *self.lengths[-1:])
        for frames in self.lengths:
            for row in LENGTH_ROWS:
                for steps in self.length_steps:
                    # DiP repeats one chunk: at steps that it is not made for the ends of its straight line suffice.
                    if row.model != "DiP" or steps == min(self.length_steps) or frames in ends:
                        every.append(Cell(row, steps, 1, frames))
        every = list(dict.fromkeys(every))
        return every, [cell for cell in dict.fromkeys(first) if cell not in every]


LENGTHS = (196, 490, 980, 1470, 1960)
# Of either size; the paper's batch is 128.
ON_GPU = Plan(
    repeated=((10, 1), (50, 1), (10, 128)), once=((50, 128), (100, 1), (200, 1)), long=1000, lengths=LENGTHS,
    minutes=8.0, rounds=20, memory_batch=None,
)  # fmt: skip
PLANS = {
    "small": Plan(
        repeated=((10, 1), (50, 1), (10, 8)), once=((50, 8), (100, 1), (200, 1)), long=1000,
        lengths=LENGTHS, minutes=40.0, rounds=5,
    ),
    "paper": Plan(repeated=((10, 1),), once=((50, 1), (10, 8)), minutes=7.5, rounds=5, memory_batch=1),
    "tiny": Plan(
        repeated=((2, 1),), once=((3, 1), (2, 2)), columns=(2, 3, 4, 5), long=5, lengths=(196, 240),
        length_steps=(2, 3), rounds=1, memory_batch=None,
    ),
}  # fmt: skip


def quick(plan: Plan) -> Plan:
    """The least that runs every row: no batches, no long runs, no memory."""
    least = plan.fewest
    return replace(
        plan, repeated=((least, 1),), once=(), long=None, rounds=1, lengths=plan.lengths[:2], length_steps=(least,),
        memory_batch=None,
    )  # fmt: skip


def count(methods: Methods, steps: int) -> dict[Row, dict[str, int]]:
    """Operations of one row of every part, for every row; rows of one model must agree, whatever their staircase."""
    units: dict[Row, dict[str, int]] = {}
    for row in ROWS:
        meter = Meter()
        tally = methods.run(row, steps, meter=meter)
        units[row] = meter.units(tally.calls)
        same = [other for other in units if other.model == row.model]
        if any(units[other] != units[row] for other in same):
            raise RuntimeError(f"a call of {row.model} costs {[units[other] for other in same]} by its staircase")
    return units


def timed(methods: Methods, plan: Plan, deadline: float) -> tuple[dict[Cell, list[Tally]], int]:
    """All runs of all cells, and the number of rounds."""
    every, first = plan.cells()
    runs: dict[Cell, list[Tally]] = {cell: [] for cell in (*every, *first)}
    for row, batch in {(cell.row, cell.batch) for cell in runs}:
        methods.run(row, 2, batch=batch)  # warm
    shuffle, rounds = random.Random(0), 0
    while rounds < plan.rounds and (rounds == 0 or time.perf_counter() < deadline):
        order = every if rounds else [*every, *first]
        shuffle.shuffle(order)
        for cell in order:
            eta = float(cell.steps == 1000)  # DDPM
            runs[cell].append(methods.run(cell.row, cell.steps, batch=cell.batch, frames=cell.frames, eta=eta))
        rounds += 1
    return runs, rounds


def wave_times(runs: dict[Cell, list[Tally]], plan: Plan, row: Row, batch: int) -> dict[int, float]:
    """Median seconds of a wave by its width (calls of a sample in it), over a row's runs at the short numbers of K."""
    spans: dict[int, list[float]] = {}
    for cell, tallies in runs.items():
        if cell[0] == row and cell[1:3] in (*plan.repeated, *plan.once) and cell[2:] == (batch, HORIZON):
            for width, seconds in (span for tally in tallies for span in tally.spans()):
                spans.setdefault(width, []).append(seconds)
    return {width: statistics.median(times) for width, times in spans.items()}


def estimate(waves: dict[int, float], row: Row, steps: int, should: Counter[str]) -> float | None:
    """Seconds of a run that was not measured: its calls, wave by wave, times the measured cost of a wave that wide."""
    if not waves:
        return None
    if row.model.startswith("RDM"):
        widths = [len(cells) for cells in staircase(row, steps, pieces(row)).wavefront()]
    else:
        widths = [should["network"] // should["waves"]] * should["waves"]
    widest = max(waves)
    # Wider waves than any seen: as many calls more, as much time more.
    return sum(waves[w] if w in waves else waves[widest] * w / widest for w in widths)


def table_row(row: Row, plan: Plan, methods: Methods, units: dict[str, int], runs: dict[Cell, list[Tally]]) -> dict:
    """Everything about one row, for JSON."""
    batches = sorted({batch for _, batch in (*plan.repeated, *plan.once)})
    waves = {batch: wave_times(runs, plan, row, batch) for batch in batches}
    columns = {}
    for steps in plan.columns:
        should = expected(methods.size, row, steps)
        flow = sum(should[part] * units.get(part, 0) for part in ("flow", "flow text"))
        columns[str(steps)] = {
            "calls": should["network"],
            "waves": should["waves"],
            "counted": any(runs.get(Cell(row, steps, batch)) for batch in batches),
            "flow_applications": should["flow"],
            "operations": {
                "network": sum(should[part] * units.get(part, 0) for part in ("network", "context")),
                "text": should["text"] * units["text"],
                "flow": flow,
            },
            "time": {
                str(batch): times(runs.get(Cell(row, steps, batch), []), estimate(waves[batch], row, steps, should))
                for batch in batches
            },
        }
    return {
        "label": row.label, "model": row.model, "variant": row.variant, "frames_per_call": row.frames,
        "parameters": sum(p.numel() for p in methods.network(row).parameters()), "columns": columns,
    }  # fmt: skip


def times(tallies: list[Tally], estimated: float | None) -> dict:
    """Milliseconds of a cell: measured where it was, else estimated."""
    out = {} if estimated is None else {"estimate_ms": round(estimated * 1e3, 2)}
    if tallies:
        seconds = [tally.seconds for tally in tallies]
        out |= {
            "median_ms": round(statistics.median(seconds) * 1e3, 2),
            "min_ms": round(min(seconds) * 1e3, 2),
            "flow_ms": round(statistics.median(tally.flow_seconds for tally in tallies) * 1e3, 2),
            "runs": len(seconds),
        }
    return out


def by_length(plan: Plan, runs: dict[Cell, list[Tally]]) -> list[dict]:
    """Time against length, for JSON."""
    cells = [Cell(row, k, 1, frames) for row in LENGTH_ROWS for k in plan.length_steps for frames in plan.lengths]
    found = []
    for cell in (cell for cell in cells if runs.get(cell)):
        native = runs[Cell(Row("DiP"), min(plan.length_steps), 1, cell.frames)]
        ratios = [dip.seconds / run.seconds for dip, run in zip(native, runs[cell], strict=True)]
        found.append(
            {"label": cell.row.label, "steps": cell.steps, "frames": cell.frames}
            | {"calls": runs[cell][0].calls, "waves": len(runs[cell][0].marks)}
            | times(runs[cell], None)
            | {"times_as_fast": Interval.of(ratios).to_json()}
        )
    return found


def peak(size: str, number: int, steps: int, batch: int) -> dict:
    """Memory of this process: with the libraries loaded, and after a run of one row."""
    torch.set_num_threads(1)
    loaded, methods = peak_mb(), Methods(SIZES[size])
    methods.run(ROWS[number], steps, batch=batch)
    return {"libraries_mb": round(loaded, 1), "peak_mb": round(peak_mb(), 1), "steps": steps, "batch": batch}


def peaks(size: str, steps: int, batch: int, rows: Iterable[int] = range(len(ROWS))) -> list[dict]:
    """``peak`` of rows by their number, each in a process of its own, two at a time."""

    def child(number: int) -> dict:
        command = [sys.executable, __file__, "--size", size, "--peak", *map(str, (number, steps, batch))]
        return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(child, rows))


def measure(size: str, plan: Plan, threads: int, device: str) -> dict:
    """Everything at one size, for JSON."""
    start, load = time.perf_counter(), os.getloadavg()[0]
    torch.set_num_threads(threads)
    methods = Methods(SIZES[size], device)
    memory = None if plan.memory_batch is None else peaks(size, plan.fewest, plan.memory_batch)
    units = count(methods, plan.fewest)
    runs, rounds = timed(methods, plan, start + plan.minutes * 60)
    rows = [table_row(row, plan, methods, units[row], runs) for row in ROWS]
    for row, held in zip(rows, memory or [None] * len(rows), strict=True):
        row["memory"] = held
    return {
        "about": SIZES[size].about, "date": date.today().isoformat(), "threads": threads, "rounds": rounds,
        "seconds": round(time.perf_counter() - start), "frames": HORIZON,
        "load": {"before": round(load, 2), "after": round(os.getloadavg()[0], 2)},
        "machine": {
            "cpu": cpu_name(), "cores": os.cpu_count(), "python": platform.python_version(),
            **({"device": torch.cuda.get_device_name()} if device == "cuda" else {}),
        },
        "torch": torch.__version__, "flow_parameters": sum(p.numel() for p in methods.flow.parameters()),
        "units": {row.label: units[row] for row in ROWS}, "rows": rows, "lengths": by_length(plan, runs),
    }  # fmt: skip


def main() -> None:
    """Measure one size and write the report of all."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", choices=SIZES, default="small")
    parser.add_argument("--out", type=report_path, default=Path("docs/streaming/efficiency"))
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--threads", type=at_least(1), default=2)
    parser.add_argument("--minutes", type=positive, help="no further round begins after this")
    parser.add_argument("--quick", action="store_true", help="one round of the shortest runs")
    parser.add_argument("--peak", type=int, nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.peak:
        print(json.dumps(peak(given.size, *given.peak)))
        return
    from efficiency_report import write

    if given.device == "cuda" and not torch.cuda.is_available():
        raise InputError("there is no CUDA device here; leave --device out")
    plan = PLANS[given.size] if given.device == "cpu" else ON_GPU
    plan = quick(plan) if given.quick else plan
    plan = replace(plan, minutes=given.minutes or plan.minutes)
    path = given.out.with_suffix(".json")
    found = json_object(path.read_bytes(), path, "delete it, or give another --out") if path.is_file() else {}
    name = given.size if given.device == "cpu" else f"{given.size}, {given.device}"
    print(write({**found, name: measure(given.size, plan, given.threads, given.device)}, given.out))


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
