"""Bulk generation from a JSONL file or standard input: validated whole, batched, resumable, shared out under torchrun.

One line is one motion: ``{"prompt": "a person walks", "seconds": 4.0, "seed": 7, "name": "walk"}``. ``prompt`` may be
a list (a timeline), ``seconds`` a list beside it; all but ``prompt`` may be absent. The seed is 0 and the name the
line's number by default.

Blocks of ``batch`` motions are cut from the whole file before finished ones are left out, and processes take whole
blocks: the bytes of a file depend neither on interruptions nor on how many processes there are.
"""

import json as jsonlib
import os
import re
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moveset.cli.generate import progress, stage_times, warn
from moveset.cli.output import Postprocess, plan_outputs, write
from moveset.errors import FormatError, InputError
from moveset.io.limits import MAX_BYTES, read_limited
from moveset.pipelines.request import Method, Request, check_request

if TYPE_CHECKING:
    from moveset.pipelines.model_config import ClipConfig
    from moveset.pipelines.text_to_motion import TextToMotion

MAX_LINES = 100_000
_KEYS = {"prompt", "seconds", "seed", "name"}


@dataclass(frozen=True)
class Job:
    """One motion and the name that its files carry."""

    name: str
    request: Request


def bulk(
    t2m: "TextToMotion",
    method: Method,
    source: Path,
    outputs: Sequence[Path],
    finish: Postprocess,
    *,
    num: int,
    batch: int,
    foot_lock: bool,
    json: bool,
) -> int:
    """Make every motion of ``source`` whose files are not there yet; files are named ``stem-name.suffix``."""
    if not 1 <= batch <= 1024:
        raise InputError(f"batch {batch} is not in 1 to 1024; give 1 on a CPU, 32 or 64 on a GPU")
    jobs = read_jobs(source, t2m.bundle.config, num)
    planned = plan_outputs(outputs, [job.name for job in jobs])
    rank, world = share()
    blocks = [slice(k, k + batch) for k in range(0, len(jobs), batch)][rank::world]
    timings: Counter[str] = Counter()
    made: list[str] = []
    skipped, warnings = 0, []
    for block in progress(blocks):
        missing = [not all(path.exists() for path in paths) for paths in planned[block]]
        skipped += missing.count(False)
        if not any(missing):
            continue
        motions = t2m.generate([job.request for job in jobs[block]], method, foot_lock=foot_lock, batch=batch)
        timings.update(motions[0].timings_ms)
        for wanted, motion, paths in zip(missing, motions, planned[block], strict=True):
            if wanted:
                timings["export"] += write(motion.motion, paths, finish, motion.metadata)[1]
                made += map(str, paths)
                warnings += motion.warnings
    report = {
        "model": t2m.bundle.config.name,
        "prompts_file": str(source),
        "steps": method.steps,
        "rank": rank,
        "world_size": world,
        "made": len(made) // len(outputs),
        "skipped": skipped,
        "files": made,
        "timings_ms": stage_times(timings),
        "warnings": list(dict.fromkeys(warnings)),
    }
    warn(report["warnings"])
    if json:
        print(jsonlib.dumps(report))
    else:
        print(f"made {report['made']} motion{'s' * (report['made'] != 1)}, skipped {skipped} that were there")
    return 0


def read_jobs(source: Path, config: "ClipConfig", num: int = 1) -> list[Job]:
    """All jobs of a JSONL file ("-": of standard input), ``num`` variants each.

    Raises:
        FormatError: a line that is not what it should be, by its number.
    """
    where = "standard input" if str(source) == "-" else source
    try:
        text = _bytes(source).decode("utf-8-sig")  # Windows likes to mark UTF-8
    except UnicodeDecodeError:
        raise FormatError(f"{where} is not UTF-8 text; save it as UTF-8") from None
    lines = [(k, line) for k, line in enumerate(text.split("\n"), start=1) if line.strip()]
    if not 1 <= len(lines) <= MAX_LINES:
        raise FormatError(f"{where} has {len(lines)} prompts; give 1 to {MAX_LINES:,}, one JSON object a line")
    jobs: list[Job] = []
    for number, line in lines:
        try:
            jobs += _jobs_of(line, f"{number:06d}", config, num)
        except InputError as error:
            raise FormatError(f"{where} line {number}: {error}") from None
    twice = [name for name, count in Counter(job.name for job in jobs).items() if count > 1]
    if twice:
        raise FormatError(f"{where} uses the name {twice[0]!r} more than once; names must differ")
    return jobs


def _bytes(source: Path) -> bytes:
    """The bytes of a file, or of standard input for "-", as ``moveset stream`` has it."""
    if str(source) != "-":
        return read_limited(source)
    if sys.stdin is None:  # closed by whoever started this process
        raise InputError("there is no standard input to read prompts from; give a file")
    data = sys.stdin.buffer.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(f"standard input has more than {MAX_BYTES >> 20} MiB, the limit; split it")
    return data


def _jobs_of(line: str, number: str, config: "ClipConfig", num: int) -> list[Job]:
    try:
        entry: Any = jsonlib.loads(line)
    except (ValueError, RecursionError):
        entry = None
    if not isinstance(entry, dict) or "prompt" not in entry or not set(entry) <= _KEYS:
        raise FormatError('a line must be a JSON object with "prompt" and perhaps "seconds", "seed" and "name"')
    name, seed = entry.get("name", number), entry.get("seed", 0)
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.-]{0,99}", name):
        raise FormatError(f"name {name!r} must be 1 to 100 letters, digits, '.', '_' or '-'")
    if type(seed) is not int:
        raise FormatError(f"seed {seed!r} must be a whole number")
    prompt, seconds = entry["prompt"], entry.get("seconds")
    if not _all(prompt, str):
        raise FormatError(f"prompt {prompt!r} must be a text or a list of texts")
    if seconds is not None and not _all(seconds, int | float):
        raise FormatError(f"seconds {seconds!r} must be a number or a list of numbers")
    requests = check_request(config, prompt, seconds, seed, num)
    return [Job(name if num == 1 else f"{name}-{k}", request) for k, request in enumerate(requests)]


def _all(value: Any, kind: Any) -> bool:
    items = value if isinstance(value, list) else [value]
    return all(isinstance(item, kind) and not isinstance(item, bool) for item in items)


def share() -> tuple[int, int]:
    """Rank and world size that torchrun sets; (0, 1) without it."""
    rank, world = os.environ.get("RANK", "0"), os.environ.get("WORLD_SIZE", "1")
    if not (rank.isdigit() and world.isdigit() and int(rank) < int(world)):
        raise InputError(f"RANK={rank!r} and WORLD_SIZE={world!r} do not belong together; unset both or use torchrun")
    return int(rank), int(world)
