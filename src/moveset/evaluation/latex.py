"""A table of results as LaTeX (package booktabs), to be pasted into a paper."""

from collections.abc import Sequence

from moveset.evaluation.columns import PHYSICAL, QUALITY, Column, Direction, Place
from moveset.evaluation.intervals import Interval
from moveset.evaluation.table import Table

ARROWS: dict[Direction, str] = {"up": r"$\uparrow$", "down": r"$\downarrow$", "real": r"$\rightarrow$"}
_SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "³": r"$^3$", "→": r"$\rightarrow$", "×": r"$\times$",
}  # fmt: skip


def latex(table: Table) -> str:
    """The table of quality and, if they were measured, that of the physical metrics.

    Raises:
        InputError: rows that were judged in different ways.
    """
    parts = ["% needs \\usepackage{booktabs}"]
    if table.measured:
        state = table.state()
        note = (
            f"{escape(table.suite.title)}. {state.items} items, {state.texts} distinct texts; mean and 95\\,\\% "
            f"interval over repeats; evaluator {escape(state.evaluator[0])} ({state.evaluator[1][:8]})."
        )
        for columns in (table.columns(QUALITY), table.columns(PHYSICAL)):
            if columns:
                parts.append(tabular(table, columns, note, ranked=columns[0] in QUALITY))
    return "\n\n".join(parts) + "\n"


def tabular(table: Table, columns: Sequence[Column], caption: str, ranked: bool) -> str:
    """One ``table*`` environment: groups between rules, best in bold, second best underlined."""
    ranks = {column.name: table.places(column) if ranked else {} for column in columns}
    heads = [f"{escape(c.label)}{', ' + escape(c.unit) if c.unit else ''} {ARROWS[c.better]}" for c in columns]
    lines, group = [], None
    for row in (row for row in table.rows if row.key in table.measured):
        if group not in (None, row.group):
            lines.append(r"\midrule")
        group = row.group
        cells = [_cell(c, table.value(row.key, c.name), ranks[c.name].get(row.key, "")) for c in columns]
        lines.append(rf"{escape(row.label)} & {' & '.join(cells)} \\")
    return "\n".join(
        [
            r"\begin{table*}", r"\centering", rf"\caption{{{caption}}}", rf"\begin{{tabular}}{{l{'c' * len(columns)}}}",
            r"\toprule", rf"Method & {' & '.join(heads)} \\", r"\midrule", *lines, r"\bottomrule", r"\end{tabular}",
            r"\end{table*}",
        ]
    )  # fmt: skip


def escape(text: str) -> str:
    r"""Text with LaTeX's special characters made harmless.

    >>> print(escape("50 % of x_1"))
    50 \% of x\_1
    """
    return "".join(_SPECIAL.get(c, c) for c in text)


def _cell(column: Column, value: Interval | None, place: Place) -> str:
    if value is None:
        return "--"
    mean, half = column.format(value)
    # The papers drop the zero before the point of an interval.
    exponent = rf"^{{\pm {half.removeprefix('0') if half.startswith('0.') else half}}}" if half else ""
    body = {"best": rf"\mathbf{{{mean}}}", "second": rf"\underline{{{mean}}}", "": mean}[place]
    return f"${body}{exponent}$"
