"""The report of a suite: tables as Markdown, LaTeX and JSON, and plots, from the result files in its folder.

It is a function of these files alone, so it can be written again at any time.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from moveset.errors import exit_code_of
from moveset.evaluation.columns import QUALITY
from moveset.evaluation.latex import latex
from moveset.evaluation.markdown import markdown
from moveset.evaluation.plots import draw
from moveset.evaluation.table import REPORT, Table, days, load_table
from moveset.io.limits import write_text
from moveset.io.process import locked

PAGE = """# Results

**Commit {commits}; measured {days}.**

Written from the results of `moveset evaluate --suite motionpcm` and `--suite rdm` (`make tables` makes all of them
anew, by up to twenty repeats); do not edit by hand. The protocol is that of the papers, the data and the evaluator are
this repository's own, so numbers compare within a table and with nothing else. What the papers print stands below each
table for the order of its rows only."""


def write_report(folder: Path) -> Path:
    """Writes ``table.md``, ``table.tex``, ``table.json`` and the bars into a suite's folder; the Markdown's path.

    All processes of torchrun do so, for none of them knows whether it will be the last: one after the other.

    Raises:
        InputError: no such folder, or rows that were measured in different ways.
        FormatError: something in it cannot be read.
    """
    _whole(folder)  # what cannot be is said before anything is made
    with locked(folder / "repeats"):
        table = _whole(folder)
        pictures = draw(table, folder)
        write_text(folder / "table.md", markdown(table, pictures))
        write_text(folder / "table.tex", latex(table))
        write_text(folder / REPORT, json.dumps(to_json(table), indent=1, ensure_ascii=False) + "\n")
    return folder / "table.md"


def to_json(table: Table) -> dict[str, Any]:
    return {
        "suite": table.suite.name,
        "state": asdict(table.state()) if table.measured else None,
        "rows": [
            {
                **asdict(row),
                "repeats": found.repeats if found else 0,
                "weights_sha256": found.weights if found else None,
                "metrics": {k: v.to_json() for k, v in found.metrics.items()} if found else {},
            }
            for row in table.rows
            for found in [table.measured.get(row.key)]
        ],
        "places": {column.name: table.places(column) for column in table.columns(QUALITY)},
        "comparisons": [
            {**asdict(found), "differences": {k: v.to_json() for k, v in found.differences.items()}}
            for found in table.comparisons()
        ],
    }


def page(folders: Sequence[Path], path: Path) -> None:
    """One page of several suites, with their plots in ``images`` beside it.

    Raises:
        InputError: no such folder, or rows that were judged in different ways.
        FormatError: something in one cannot be read.
    """
    tables = [_whole(folder) for folder in folders]
    commits = dict.fromkeys(table.state().commit for table in tables if table.measured)
    parts = [PAGE.format(commits=", ".join(commits) or "–", days=days(*tables))]
    images = path.parent / "images"
    for table in tables:
        names = [f"{images.name}/{name}" for name in draw(table, images)]
        parts.append(markdown(table, names, level=2))
    write_text(path, "\n\n".join(part.strip() for part in parts) + "\n")


def _whole(folder: Path) -> Table:
    """A table whose rows may stand in one, which is asked before older files go."""
    table = load_table(folder)
    if table.measured:
        table.state()
    return table


def main() -> None:
    """Command line: ``python -m moveset.evaluation.report results/motionpcm results/rdm --page docs/results.md``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--page", type=Path, help="one Markdown file of all")
    given = parser.parse_args()
    for folder in given.folders:
        print(write_report(folder))
    if given.page:
        page(given.folders, given.page)
        print(given.page)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
