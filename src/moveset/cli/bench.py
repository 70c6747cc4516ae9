"""``moveset bench``: what motion costs on this machine, as JSON, a page and a picture."""

import importlib.util
import json as jsonlib
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from moveset.cli.output import check_folder
from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.bench.run import Plan

Part = Literal["clips", "streams", "lengths", "batches", "operations", "processes", "endless"]


def bench(
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE.json")] = None,
    parts: tuple[Part, ...] = (),
    clips: Annotated[str, tyro.conf.arg(metavar="NAME")] = "motionpcm-small",
    streams: Annotated[str, tyro.conf.arg(metavar="NAME")] = "rdm-small",
    rounds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    processes: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    endless: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    quick: tyro.conf.FlagCreatePairsOff[bool] = False,
    threads: Annotated[int, tyro.conf.arg(metavar="N")] = 1,
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto",
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Measure what motion costs here: time per sentence by stage, segments of streams, length, batch, memory.

    Everything that is compared runs in turns, so that ratios hold on a busy machine too; milliseconds need a quiet one.

    Args:
        output: Where the report goes; the page and the picture go beside it, as FILE.md and FILE.png.
        parts: What to measure; everything without it.
        clips: A text-to-motion model, shipped or a folder.
        streams: A stream model, shipped or a folder.
        rounds: Rounds that count (20).
        processes: Whole processes of each kind (5).
        endless: Segments of the long stream (2000).
        quick: One round of the least: does it run?
        threads: CPU threads; one is how clips and segments are made.
        device: auto, cpu, cuda or mps.
        json: Print the report as JSON on stdout and nothing else.
    """
    from moveset.bench.page import markdown, write_page
    from moveset.bench.run import PARTS, Plan, shortest

    if output is not None:
        if output.suffix != ".json":
            raise InputError(f"a report is a .json file, not {output.name!r}; choose such a name")
        check_folder(output.parent)
        if taken := [path for path in map(output.with_suffix, (".json", ".md", ".png")) if path.is_dir()]:
            raise InputError(f"cannot write {str(taken[0])!r}: it is a folder; choose another --output")
        if importlib.util.find_spec("matplotlib") is None:
            raise InputError(
                "a report with a picture needs matplotlib; `pip install 'moveset[train]'`, or leave --output"
            )
    plan = Plan(clips=clips, streams=streams, device=device, parts=parts or PARTS)
    given = {"rounds": rounds, "count": processes, "endless": endless}
    asked: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    report = _measure(replace(shortest(plan) if quick else plan, **asked), threads)
    # Printed first: what took an hour to measure must not be lost to a disk that has filled up meanwhile.
    name = output.stem if output is not None else "benchmarks"
    print(jsonlib.dumps(report) if json else markdown(report, name), flush=True)
    if output is not None:
        print(f"wrote {', '.join(map(str, write_page(report, output)))}", file=sys.stderr)
    return 0


def _measure(plan: "Plan", threads: int) -> dict[str, Any]:
    import torch

    from moveset.bench.run import Bench
    from moveset.io.process import cores

    if not 1 <= threads <= 4 * cores():
        raise InputError(f"{threads} threads on {cores()} cores; use 1 to {4 * cores()}")
    torch.set_num_threads(threads)
    # So that one clip at a time is made with as many, here and in processes.
    os.environ["OMP_NUM_THREADS"] = str(threads)
    return Bench(plan, _bar).run()


def _bar(name: str, count: int) -> Callable[[], object]:
    """A progress bar on a terminal."""
    from tqdm import tqdm

    bar = tqdm(total=count, desc=name, disable=None, leave=False)

    def tick() -> None:
        bar.update()
        if bar.n >= count:
            bar.close()

    return tick
