"""A table of results as Markdown: quality, physical metrics, what differs, settings, and what is published.

Published numbers stand in a block of their own, said to be not comparable.
"""

from collections.abc import Sequence
from pathlib import Path

from moveset.evaluation.columns import PHYSICAL, QUALITY, Column, Place
from moveset.evaluation.comparison import verdict
from moveset.evaluation.intervals import Interval
from moveset.evaluation.published import PublishedTable, tables
from moveset.evaluation.suites import REAL
from moveset.evaluation.table import Table, days

MISSING = "not evaluated"


def markdown(table: Table, pictures: Sequence[str] = (), level: int = 1) -> str:
    """The whole report of a suite.

    Args:
        pictures: names of images, relative to where the text will be.

    Raises:
        InputError: rows that were measured in different ways.
    """
    sharp = "#" * (level + 1)
    parts = [f"{'#' * level} {table.suite.title}", about(table), grid(table)]
    if physical := physical_grid(table):
        parts += [f"{sharp} Physical metrics", physical]
    parts += [f"![{Path(name).stem}]({name})" for name in pictures]
    if compared := comparisons(table):
        parts += [f"{sharp} What differs", compared]
    parts += [f"{sharp} How the rows were made", settings(table)]
    parts += [published(printed, level + 1) for printed in tables(table.suite.name)]
    return "\n\n".join(parts) + "\n"


def about(table: Table) -> str:
    """What was measured on what, by what; the same for all rows.

    Raises:
        InputError: it is not the same for all rows.
    """
    if not table.measured:
        return "No row has been evaluated yet."
    state = table.state()
    labels = "" if state.labels is None else f", {state.labels} distinct contents"
    lines = [
        f"**{state.items} items, {state.texts} distinct texts{labels}** of the split “{state.split}” of "
        f"{state.data[0]} ({_short(state.data[1])}); evaluator {state.evaluator[0]} ({_short(state.evaluator[1])}); "
        f"commit {state.commit}; measured {days(table)}.",
        f"R@k: how often the own sentence's motion is among the k nearest of {state.group}. "
        "Mean ± 95 % interval over repeats (Student's t), in which captions, lengths, noise and groups were drawn "
        "again; it does not say what other test items would give. ↑ more is better, ↓ less is better, → nearer to real "
        "motion is better. **Best** and <u>second best</u> of the rows that generate.",
    ]
    return "\n\n".join(lines)


def grid(table: Table) -> str:
    columns = table.columns(QUALITY)
    ranks = {column.name: table.places(column) for column in columns}
    head = ["", "repeats", *(column.head for column in columns)]
    body, group = [], None
    for row in table.rows:
        if row.group != group:
            group = row.group
            body.append([f"*{group}*", *[""] * (len(head) - 1)])
        repeats = str(table.measured[row.key].repeats) if row.key in table.measured else MISSING
        cells = [_cell(c, table.value(row.key, c.name), ranks[c.name].get(row.key, "")) for c in columns]
        body.append([row.label, repeats, *cells])
    return lined(head, body)


def physical_grid(table: Table) -> str:
    """Physical metrics, each with its ratio to real motion; "" if none was measured."""
    if not (columns := table.columns(PHYSICAL)):
        return ""
    body = []
    for row in (row for row in table.rows if row.key in table.measured):
        cells = []
        for column in columns:
            value, real = table.value(row.key, column.name), table.value(REAL, column.name)
            ratio = f" ({value.mean / real.mean:.2f} ×)" if value and real and real.mean > 0 else ""
            cells.append(_cell(column, value, "") + (ratio if row.key != REAL else ""))
        body.append([row.label, *cells])
    return "In parentheses: times the value of real motion.\n\n" + lined(["", *(c.head for c in columns)], body)


def comparisons(table: Table) -> str:
    """Differences of equal repeats; "" if no two rows to compare have enough of them."""
    found, labels = table.comparisons(), table.labels
    if not found:
        return ""
    columns = [column for column in QUALITY if any(column.name in row.differences for row in found)]
    body = []
    for row in found:
        cells = [_difference(column, row.differences.get(column.name)) for column in columns]
        body.append([f"{labels[row.row]} − {labels[row.reference]}", str(row.repeats), *cells])
    return (
        "Equal repeats of two rows have the same captions, lengths and groups, which cancel in their difference: mean "
        "± 95 % interval (Student's t) over the repeats that both have. **Better** and <u>worse</u> where the interval "
        "leaves out zero, which one in twenty does by chance. These are differences on the same items.\n\n"
    ) + lined(["", "repeats", *(column.head for column in columns)], body)


def settings(table: Table) -> str:
    body = []
    for row in table.rows:
        weights = _short(table.measured[row.key].weights) if row.key in table.measured else MISSING
        words = ", ".join(f"{key} = {value}" for key, value in row.settings.items())
        body.append([row.label, row.model, row.network or "–", str(row.steps or "–"), words or "–", weights])
    return lined(["", "model", "network", "steps", "other settings than the folder's", "weights"], body)


def published(printed: PublishedTable, level: int) -> str:
    """A paper's own table, labelled as what it is."""
    other = "other evaluator" if "fid" in printed.columns else "other machine"
    heads = [_published_head(name) for name in printed.columns]
    body = [[f"**{row.method}**" if row.own else row.method, *row.cells.values()] for row in printed.rows]
    return "\n\n".join(
        [
            f"{'#' * level} The paper's Table {printed.number}: {printed.about[:1].lower()}{printed.about[1:]}",
            f"**Published, on {printed.dataset}, {other}: not comparable.** {printed.source}; ± is the "
            f"{printed.spread}; "
            "bold rows are the paper's own method.",
            lined(["", *heads], body),
            "\n".join(f"- {note}" for note in printed.notes),
        ]
    )


def lined(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *body]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _cell(column: Column, value: Interval | None, place: Place) -> str:
    if value is None:
        return "–"
    mean, half = column.format(value)
    text = f"{mean} ± {half}" if half else mean
    return {"best": f"**{text}**", "second": f"<u>{text}</u>", "": text}[place]


def _difference(column: Column, value: Interval | None) -> str:
    if value is None:
        return "–"
    mean, half = column.format(value)
    text = f"{'−' if value.mean < 0 else '+'}{mean.lstrip('-')} ± {half}"
    return {"better": f"**{text}**", "worse": f"<u>{text}</u>", "": text}[verdict(column, value)]


def _short(sha256: str) -> str:
    return f"`{sha256[:8]}`" if sha256 else "–"


def _published_head(name: str) -> str:
    known = {column.name: column.head for column in QUALITY} | {"aits": "AITS, s ↓"}
    if name in known:
        return known[name]
    kind, steps = name.split("_")
    return f"{'s' if kind == 'time' else '10¹²'}, {steps} steps"
