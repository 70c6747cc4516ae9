"""What the papers print: the tables of MotionPCM and RDM, digit for digit, from ``published.json``.

None of these numbers was measured here, and none can be compared with one that was: other data, other evaluator, other
machine. A cell is kept as printed (``0.511±.003``); a dash is a number that the paper does not give. Numbers that
contradict each other or the text are kept too, and named in the table's notes.

Sources: MotionPCM is arXiv 2501.19083, version 1; RDM (Mohamed, Cunningham, Deisenroth, Agapito) is arXiv 2406.07169.
"""

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from moveset.errors import InputError


@dataclass(frozen=True)
class PublishedRow:
    """A method and the cells of its table by column; ``own`` rows are of the paper's method and its ablations."""

    method: str
    cells: dict[str, str]
    own: bool


@dataclass(frozen=True)
class PublishedTable:
    """A table of a paper.

    Args:
        suite: the suite of ours that it belongs to.
        number: as the paper counts.
        source: paper, table and section.
        columns: names of the metrics, ours where we have them; ``time_K`` and ``flops_K`` are seconds and 1e12
            operations at K steps.
        spread: what follows the ±.
        notes: what in it is known to be wrong or in another unit.
    """

    suite: str
    number: int
    dataset: str
    about: str
    source: str
    columns: tuple[str, ...]
    spread: str
    rows: tuple[PublishedRow, ...]
    notes: tuple[str, ...]


@cache
def tables(suite: str) -> tuple[PublishedTable, ...]:
    """The tables of the paper that a suite repeats.

    Raises:
        InputError: no such suite.
    """
    written = json.loads(files("moveset.evaluation").joinpath("published.json").read_text("utf-8"))["tables"]
    if not (found := [entry for entry in written if entry["suite"] == suite]):
        raise InputError(f"no published tables of {suite!r}; there are those of motionpcm and rdm")
    return tuple(_table(**entry) for entry in found)


def _table(
    suite: str, number: int, dataset: str, about: str, source: str, columns: str, spread: str, own: list[str],
    rows: dict[str, str], notes: list[str],
) -> PublishedTable:  # fmt: skip
    names = tuple(columns.split())
    read = (
        PublishedRow(method, dict(zip(names, cells.split(), strict=True)), method in own)
        for method, cells in rows.items()
    )
    return PublishedTable(suite, number, dataset, about, source, names, spread, tuple(read), tuple(notes))
