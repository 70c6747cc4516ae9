"""Whole processes, from nothing to written file: how long they take, and the most memory that they hold.

A process runs the command line as users do, and says at its end how much memory it has held.
"""

import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from moveset.errors import MovesetError

_MARK = "peak memory MB: "
# The command line itself, and one line more on stderr.
_RUN = f"""
import sys
from moveset.cli.__main__ import main
code = main(sys.argv[1:])
sys.stdout.flush()
from moveset.bench.machine import peak_mb
print("{_MARK}%.1f" % peak_mb(), file=sys.stderr)
sys.exit(code)
"""


def run_process(arguments: Sequence[str]) -> dict[str, float]:
    """Seconds until the end and, of a stream, until its first segment is told; the peak memory in MB.

    Raises:
        MovesetError: it failed; with the last line that it said.
    """
    start = time.perf_counter()
    with tempfile.TemporaryFile("w+") as errors:
        command = [sys.executable, "-c", _RUN, *arguments]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process:
            assert process.stdout is not None
            process.stdout.readline()
            seen = time.perf_counter() - start
            process.stdout.read()
        spent = time.perf_counter() - start
        errors.seek(0)
        said = errors.read().splitlines()
    if process.returncode or not said or not said[-1].startswith(_MARK):
        raise MovesetError(f"`moveset {' '.join(arguments)}` failed: {said[-2:]}")
    found = {"seconds": spent, "peak_mb": float(said[-1].removeprefix(_MARK))}
    return found | ({"first_segment_seconds": seen} if arguments[0] == "stream" else {})


def processes(
    commands: Mapping[str, Sequence[str]], count: int, tick: Callable[[], object] = lambda: None
) -> dict[str, dict[str, Any]]:
    """Medians and minima of ``count`` processes of every command, in turns.

    Args:
        commands: arguments of the command line by name; ``OUT/`` at the beginning of one is a folder for files.
    """
    found: dict[str, list[dict[str, float]]] = {name: [] for name in commands}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(count):
            for name, arguments in commands.items():
                found[name].append(run_process([re.sub(r"^OUT(?=/)", lambda _: folder, a) for a in arguments]))
                tick()
    return {
        name: {
            part: {
                "median": round(statistics.median(row[part] for row in rows), 3),
                "min": round(min(row[part] for row in rows), 3),
            }
            for part in rows[0]
        }
        for name, rows in found.items()
    }


def clip_command(model: str, solver: str, steps: int, seconds: float, device: str) -> list[str]:
    """The arguments that make one clip into a file."""
    given = {"--solver": solver, "--steps": steps, "--seconds": seconds, "--model": model, "--device": device}
    return ["generate", "a person walks forward and waves", *_flat(given), "-o", "OUT/clip.bvh"]


def stream_command(model: str, network: str, total: float, device: str) -> list[str]:
    """The arguments that make some seconds of a stream into a file, a line of output a segment."""
    given = {"--network": network, "--total": f"{total:g}", "--model": model, "--device": device}
    return ["stream", "a person walks forward and waves", *_flat(given), "--json", "-o", "OUT/stream.bvh"]


def _flat(given: Mapping[str, object]) -> list[str]:
    return [str(part) for pair in given.items() for part in pair]
