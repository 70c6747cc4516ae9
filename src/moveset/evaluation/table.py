"""A suite's rows with what was measured of them, from the files of a results folder.

``rows.json`` says which rows there are, where their result files lie, and why some have no numbers. All results of a
table are of one ``State``: of rows that were measured otherwise there is no table.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from moveset.errors import FormatError, InputError
from moveset.evaluation.columns import Column, Place, places
from moveset.evaluation.comparison import Comparison, Values, compare
from moveset.evaluation.intervals import Interval
from moveset.evaluation.suites import REAL, RECONSTRUCTION, Row, RowResult, Suite, get_suite
from moveset.io.limits import atomic_write
from moveset.io.manifest import json_object
from moveset.io.process import locked

ROWS = "rows.json"
OWN = ("result", "missing")  # of an entry of that file, beside the row itself
_AGAIN = "give another --out, or delete it"


@dataclass(frozen=True, kw_only=True)
class State:
    """How rows were measured: what all of a table have in common.

    Args:
        commit: of the code.
        evaluator, data: name and sha256.
        items, texts, labels: how many test items, distinct texts and distinct label combinations; None if unlabelled.
        split: of the data.
        group: items among which R-precision looks.
        seed: what all repeats were drawn from.
    """

    commit: str
    evaluator: tuple[str, str]
    data: tuple[str, str]
    items: int
    texts: int
    labels: int | None
    split: str
    group: int
    seed: int

    def unlike(self, other: "State") -> str:
        """Name of the first field in which another state differs; "" if there is none."""
        return next((f.name for f in fields(self) if getattr(self, f.name) != getattr(other, f.name)), "")


@dataclass(frozen=True)
class Measured:
    """What a report needs of a result.

    Args:
        state: how it was measured.
        date: when, as YYYY-MM-DD.
        metrics: by name.
        values: every repeat's value by metric.
        weights: sha256 of all files that take part, "" where there are none.
        feet: whether planted feet were held; None where nothing could be held.
        seconds: what an item took to generate, in batches, on average; None if nothing was generated.
    """

    state: State
    date: str
    metrics: Mapping[str, Interval]
    values: Values
    weights: str
    feet: bool | None
    seconds: float | None

    @property
    def repeats(self) -> int:
        """How many repeats there were."""
        return len(next(iter(self.values.values())))

    @classmethod
    def of(cls, raw: Mapping[str, Any], where: str) -> "Measured":
        """From a result's JSON.

        Raises:
            FormatError: something is missing, or of another type.
        """
        try:
            protocol = raw["protocol"]
            state = State(
                commit=str(raw["commit"]),
                evaluator=(str(raw["evaluator"]["name"]), str(raw["evaluator"]["sha256"])),
                data=(str(raw["data"]["name"]), str(raw["data"]["sha256"])),
                items=int(raw["items"]),
                texts=int(raw["distinct_texts"]),
                labels=None if raw["labels"] is None else int(raw["labels"]),
                split=str(protocol["split"]),
                group=int(protocol["group"]),
                seed=int(protocol["seed"]),
            )
            values = {name: [float(repeat[name]) for repeat in raw["repeats"]] for name in raw["metrics"]}
            if not values or not raw["repeats"]:
                raise ValueError("no measures")
            return cls(
                state=state,
                date=str(raw["date"]),
                metrics={name: Interval.from_json(value) for name, value in raw["metrics"].items()},
                values=values,
                weights=str(raw["weights_sha256"] or ""),
                feet=raw["settings"].get("foot_lock"),
                seconds=float(raw["seconds_per_item"]) if raw["weights_sha256"] else None,
            )
        except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
            raise FormatError(f"{where} is no result of an evaluation: {error}; evaluate that row again") from error


@dataclass(frozen=True)
class Table:
    """A suite with its numbers: what every form of the report is made from."""

    suite: Suite
    rows: tuple[RowResult[Measured], ...]

    @property
    def measured(self) -> dict[str, Measured]:
        """Rows with numbers, by key."""
        return {entry.row.key: entry.result for entry in self.rows if entry.result is not None}

    @property
    def metrics(self) -> dict[str, Mapping[str, Interval]]:
        """Their metrics."""
        return {key: found.metrics for key, found in self.measured.items()}

    @property
    def labels(self) -> dict[str, str]:
        """Labels of all rows, by key."""
        return {entry.row.key: entry.row.label for entry in self.rows}

    def columns(self, of: Sequence[Column]) -> list[Column]:
        """Those that at least one row has."""
        return [column for column in of if any(column.name in metrics for metrics in self.metrics.values())]

    def places(self, column: Column) -> dict[str, Place]:
        """Best and second best among the rows that are ranked."""
        ranked = {entry.row.key for entry in self.rows if entry.row.ranked}
        values = {k: m[column.name] for k, m in self.metrics.items() if k in ranked and column.name in m}
        return places(column, values, self.metrics.get(REAL, {}).get(column.name))

    def comparisons(self) -> list[Comparison]:
        """Of every row with those it is compared with."""
        values = {key: found.values for key, found in self.measured.items()}
        return compare(values, {entry.row.key: entry.row.against for entry in self.rows})

    def state(self) -> State:
        """How all rows were measured.

        Raises:
            InputError: not all in one way, or there are none.
        """
        if not self.measured:
            raise InputError(
                f"no row of {self.suite.name!r} has been evaluated yet; run `moveset evaluate --suite …` first"
            )
        first, *others = self.measured.items()
        for key, row in others:
            if name := first[1].state.unlike(row.state):
                raise InputError(
                    f"{self.labels[key]}: other {name} than {self.labels[first[0]]}; evaluate all rows in one way"
                )
        if {row.feet for row in self.measured.values()} >= {True, False}:
            loose = "; ".join(self.labels[key] for key, row in self.measured.items() if row.feet is False)
            raise InputError(f"{loose}: feet are not held, and those of other rows are; evaluate all rows in one way")
        return first[1].state


def days(*tables: Table) -> str:
    """The first and the last day on which rows of tables were measured; "–" if none was."""
    found = sorted({row.date for table in tables for row in table.measured.values()})
    return " to ".join(dict.fromkeys((found[0], found[-1]))) if found else "–"


@contextmanager
def in_turn(out: Path) -> Iterator[None]:
    """Waits until no other process is in here with the same folder of results.

    All processes of torchrun write the rows and the report, for none of them knows whether it will be the last.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(out / "repeats"))
        except OSError as error:
            said = error.strerror or error
            raise InputError(f"cannot write to {str(out)!r}: {said}; choose another --out") from error
        yield


def save_rows(name: str, rows: Sequence[tuple[Row, str, str]], out: Path) -> None:
    """Writes ``rows.json``: every row with its result file's path below OUT, or with what is missing.

    Rows that are there already and not among these stay, in the suite's order: a suite may be run a row at a time. So
    does the result of a row that has none now, for whoever runs the suite may not have all weights. Rows of its models
    that the suite has no more go. Where several processes may do so, each does it ``in_turn``.

    Raises:
        InputError: the folder cannot be made or written to.
        FormatError: there is a ``rows.json`` that cannot be read, or one of another suite.
    """
    new = {row.key: {**asdict(row), "result": result or None, "missing": missing} for row, result, missing in rows}
    index, suite = out / ROWS, get_suite(name)
    if index.is_file():
        stay = _staying(index, suite)
        measured = {key for key, entry in stay.items() if entry["result"]}
        new = stay | {key: entry for key, entry in new.items() if entry["result"] or key not in measured}
    order = [row.key for row in suite.rows if row.key in new]
    entries = [new[key] for key in dict.fromkeys([*order, *new])]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {str(out)!r}: {error.strerror or error}; choose another --out") from error
    with atomic_write(index) as file:
        file.write(json.dumps({"suite": name, "rows": entries}, indent=1, ensure_ascii=False).encode() + b"\n")


def check_alike(out: Path, name: str, rows: Sequence[Row], now: State, feet: bool) -> None:
    """Refuses rows that no table could hold beside those that are there, before hours are spent on them.

    Args:
        out: the suite's folder; nothing need be in it.
        name: of the suite.
        rows: that are to be evaluated; their older results go.
        now: how.
        feet: whether planted feet will be held.

    Raises:
        InputError: rows that stay were evaluated in another way.
        FormatError: what is there cannot be read.
    """
    if not (out / ROWS).is_file():
        return
    holds = any(row.network not in (None, RECONSTRUCTION) for row in rows)
    anew = {row.key for row in rows}
    for key, entry in _staying(out / ROWS, get_suite(name)).items():
        if key in anew or (there := _read(out, entry["result"])) is None:
            continue
        other = there.state.unlike(now)
        found = (other, getattr(there.state, other), getattr(now, other)) if other else ("feet held", there.feet, feet)
        if other or (holds and there.feet is not None and there.feet != feet):
            raise InputError(
                f"{out} has rows that stay, such as {entry['label']}, with {found[0]} {_said(found[1])} instead of "
                f"{_said(found[2])}, and no table holds both; give another --out, or delete {out / ROWS}"
            )


def load_table(folder: Path) -> Table:
    """A suite's table from its folder.

    Raises:
        InputError: no such folder.
        FormatError: something in it cannot be read.
    """
    index = folder / ROWS
    if not index.is_file():
        raise InputError(f"{folder} has no {ROWS}; run `moveset evaluate --suite …` first")
    raw = json_object(index.read_bytes(), index, _AGAIN)
    try:
        entries = [
            (Row(**{k: v for k, v in e.items() if k not in OWN}), e["result"], e["missing"]) for e in raw["rows"]
        ]
        suite = get_suite(raw["suite"])
    except (KeyError, TypeError, AttributeError, InputError) as error:
        raise FormatError(f"{index} is no list of rows: {error}; run `moveset evaluate --suite …` again") from error
    return Table(suite, tuple(RowResult(row, _read(folder, file), missing) for row, file, missing in entries))


def _said(value: object) -> str:
    """A value for people; of a name and a sha256 as much as tells them apart.

    >>> _said(("corpus", "0123456789")), _said(7)
    ('corpus (01234567)', '7')
    """
    return f"{value[0]} ({value[1][:8]})" if isinstance(value, tuple) else str(value)


def _staying(index: Path, suite: Suite) -> dict[str, Any]:
    """Entries of ``rows.json`` by key, but those of the suite's models that it has no more.

    Raises:
        FormatError: it cannot be read, or is of another suite.
    """
    raw = json_object(index.read_bytes(), index, _AGAIN)
    if raw.get("suite") != suite.name:
        raise FormatError(f"{index} is of the suite {raw.get('suite')!r}; write {suite.name!r} to another folder")
    known, models = {row.key for row in suite.rows}, {row.model for row in suite.rows}
    try:
        entries = [(entry["key"], entry["model"], entry["result"], entry["label"], entry) for entry in raw["rows"]]
    except (KeyError, TypeError) as error:
        raise FormatError(f"{index} is no list of rows: {error!r}; {_AGAIN}") from error
    return {key: entry for key, model, _, _, entry in entries if key in known or model not in models}


def _read(folder: Path, name: str | None) -> Measured | None:
    if name is None:
        return None
    file = folder / name
    if not file.is_file():
        raise FormatError(f"{folder / ROWS} names {name}, which is not there; evaluate that row again")
    return Measured.of(json_object(file.read_bytes(), file, "evaluate that row again"), str(file))
