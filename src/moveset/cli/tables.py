"""What ``moveset evaluate`` runs and prints: one model, or all rows of a paper's tables."""

import importlib.util
import json as jsonlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moveset.cli.bulk import share
from moveset.cli.output import check_folder
from moveset.errors import FormatError, InputError

if TYPE_CHECKING:
    from moveset.evaluation.run import EvaluationConfig
    from moveset.evaluation.table import State


@dataclass(frozen=True)
class How:
    """Where results go, whether repeats that are there are kept, and among how many processes they are shared."""

    out: Path
    resume: bool
    processes: int | None


def run_one(config: "EvaluationConfig", how: How) -> tuple[dict[str, Any] | None, Path]:
    """One model, behind a progress bar where stderr is a terminal."""
    from tqdm import tqdm

    from moveset.evaluation.run import evaluate

    name = config.model if config.motions is None else config.motions.resolve().name
    with tqdm(desc=name, unit="repeat", disable=not sys.stderr.isatty(), leave=False) as bar:

        def progress(done: int, count: int, stage: str) -> None:
            bar.total, bar.n = count, done
            bar.set_postfix_str(stage)

        return evaluate(
            config, how.out, share=share(), processes=how.processes, again=not how.resume, progress=progress
        )


def run_suite(
    name: str,
    folders: Sequence[str],
    common: "EvaluationConfig",
    only: Sequence[str],
    how: How,
    json: bool,
    *,
    alone: bool = False,
) -> int:
    """All rows of a paper's tables whose weights are there, one after the other, and the tables.

    A row that its model cannot be sampled as is left out, with the reason, unless ``only`` asks for it.

    Args:
        alone: the folders' rows alone, without the models that ship.
    """
    from dataclasses import replace

    from moveset.evaluation.report import write_report
    from moveset.evaluation.run import open_source
    from moveset.evaluation.suites import REAL, chosen_rows, get_suite, plural
    from moveset.evaluation.table import load_table

    if common.motions is not None or common.network or common.steps is not None or common.settings:
        raise InputError("a suite says itself what is evaluated; leave --motions, --network, --steps and settings out")
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("the tables of a suite have pictures, which need matplotlib; `pip install 'moveset[train]'`")
    rows, out = [], how.out / name
    for row, folder, missing in chosen_rows(name, tuple(map(Path, folders)), only, alone=alone):
        # Real motion's jerk is measured as far apart as the seams of the suite's streams, to compare them with.
        seams = get_suite(name).seams if row.model == REAL else 0.0
        protocol = replace(common.protocol, repeats=row.times(common.protocol.repeats), seams=seams)
        config = replace(
            common, model=row.model if folder is None else str(folder), network=row.network, steps=row.steps,
            settings=tuple(row.settings.items()), protocol=protocol, name=row.key,
        )  # fmt: skip
        try:
            if not missing:
                open_source(config)
        except FormatError:
            raise
        except InputError as error:
            # A model of another recipe may have no such staircase, and not everything can be rolled out.
            if row.key in only:
                raise
            missing = str(error)
        rows.append((row, config, missing))
    if out.is_dir() and (there := load_table(out)).measured:
        there.check_alike([row for row, _, missing in rows if not missing], state_now(common), common.foot_lock)
    for row, config, missing in rows:
        print(f"moveset: {row.label}: {missing or plural(config.protocol.repeats, 'repeat')}", file=sys.stderr)
        if not missing:
            run_one(config, replace(how, out=out))
    results_folder(out)
    path = write_report(out)
    print(jsonlib.dumps({"suite": name, "table": str(path)}) if json else path.read_text("utf-8"))
    return 0


def results_folder(out: Path) -> None:
    """A folder for results, if it is not there.

    Raises:
        InputError: it cannot be made, or nothing can be written to it.
    """
    from moveset.io.limits import make_folder

    check_folder(make_folder(out, "choose another --out"))


def state_now(common: "EvaluationConfig") -> "State":
    """How rows are measured now."""
    from moveset.evaluation.evaluator import Evaluator
    from moveset.evaluation.results import commit
    from moveset.evaluation.run import open_set
    from moveset.evaluation.table import State
    from moveset.pipelines.device import pick_device

    items, protocol = open_set(common), common.protocol
    judge = Evaluator.open(common.evaluator, pick_device(common.device))
    return State(
        commit=commit(), evaluator=(judge.card.name, str(judge.sha256)), data=(items.name, items.sha256),
        items=len(items), texts=items.texts, labels=None if items.labels is None else len(set(items.labels)),
        split=protocol.split, group=protocol.group, seed=protocol.seed,
    )  # fmt: skip


def print_results(done: Sequence[tuple[dict[str, Any], Path]], json: bool) -> None:
    """Print results as one JSON object, or as a table that can be pasted into a paper, with its size below it."""
    if not done:
        return
    if json:
        print(jsonlib.dumps({"results": [{**result, "file": str(path)} for result, path in done]}))
        return
    from moveset.evaluation.columns import ALL, Column
    from moveset.evaluation.intervals import Interval

    extra = (
        Column("mpjpe", "MPJPE", "down", 2, "mm", 1000.0),
        Column("mpjpe_aligned", "MPJPE, root aligned", "down", 2, "mm", 1000.0),
        Column("drift_height", "Height a minute", "real", 1, "mm", 1000.0),
        Column("drift_speed", "Speed a minute", "real", 2, "m/s"),
        Column("spread_change", "Spread at the end", "real", 2),
    )
    known = {**ALL, **{column.name: column for column in extra}}
    columns = [column for name, column in known.items() if any(name in result["metrics"] for result, _ in done)]
    print("| model | " + " | ".join(column.head for column in columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    for result, _ in done:
        cells = []
        for column in columns:
            value = result["metrics"].get(column.name)
            mean, half = column.format(Interval.from_json(value)) if value else ("–", "")
            cells.append(f"{mean} ± {half}" if half else mean)
        print(f"| {title(result)} | " + " | ".join(cells) + " |")
    print()
    for line in dict.fromkeys(line for result, _ in done for line in notes(result)):
        print(line)
    for _, path in done:
        print(path)


def title(result: dict[str, Any]) -> str:
    """A result's row."""
    from moveset.evaluation.suites import plural

    steps = "" if result["steps"] is None else f", {plural(result['steps'], 'step')}"
    return " ".join(filter(None, (result["model"], result["network"]))) + steps


def notes(result: dict[str, Any]) -> list[str]:
    """How much there was to judge, and what the protocol could not do as asked for."""
    from moveset.evaluation.suites import plural

    protocol, count, data = result["protocol"], len(result["repeats"]), result["data"]
    labels = f" of {result['labels']} kinds" if result["labels"] else ""
    texts = f"{result['items']} items{labels} with {result['distinct_texts']} distinct texts of"
    how = f"{data['name']}, {protocol['split']}"
    # Motions with prompts of their own: FID is larger the fewer real ones it is to, so it must be said how many.
    given = result.get("settings", {}).get("motions")
    how = f"{given}; FID to {data['items']} items of {how}" if given else how
    said = [
        f"{texts} {how}; {plural(result['groups'], 'group')} of {protocol['group']}; mean ± 95 % interval of "
        f"{plural(count, 'repeat')}; judged by {result['evaluator']['name']}."
    ]
    if "rollouts" in result:
        said.append(f"{result['rollouts']} rollouts of the items one after the other, {result['windows']} windows.")
    said += [f"Left out: {number} ({reason})." for reason, number in result["dropped"].items()]
    if result["shortened"]:
        said.append(
            f"{title(result)}: {result['shortened']} motions are shorter than asked for; the model has a limit."
        )
    if "multimodality" in result["metrics"]:
        texts = result.get("texts", protocol["multimodality"])
        said.append(f"Multimodality over {texts} texts with {protocol['samples']} motions each.")
    if protocol["diversity"] < 300:
        said.append(f"Diversity over {protocol['diversity']} pairs, for want of items.")
    return said
