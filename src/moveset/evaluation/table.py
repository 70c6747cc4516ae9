"""A suite's rows with what was measured of them, from the files of a results folder.

All results of a table are of one ``State``: of rows that were measured otherwise there is no table.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from moveset.errors import FormatError, InputError
from moveset.evaluation.columns import Column, Place, places
from moveset.evaluation.comparison import Comparison, Values, compare
from moveset.evaluation.intervals import Interval
from moveset.evaluation.suites import REAL, RECONSTRUCTION, TRAINING, Row, Suite, get_suite, given_row
from moveset.io.limits import read_limited
from moveset.io.manifest import json_object

REPORT = "table.json"  # in a folder of results, not a result


@dataclass(frozen=True, kw_only=True)
class State:
    """How rows were measured: what all of a table have in common.

    Args:
        evaluator, data: name and sha256.
        items, texts, labels: how many test items, distinct texts and distinct label combinations; None if unlabelled.
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
        date: when, as YYYY-MM-DD.
        values: every repeat's value by metric.
        weights: sha256 of all files that take part, "" where there are none.
        feet: whether planted feet were held; None where nothing could be held.
    """

    state: State
    date: str
    metrics: Mapping[str, Interval]
    values: Values
    weights: str
    feet: bool | None

    @property
    def repeats(self) -> int:
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
            )
        except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
            raise FormatError(f"{where} is no result of an evaluation: {error}; evaluate that row again") from error


@dataclass(frozen=True)
class Table:
    """A suite with its numbers: what every form of the report is made from.

    Args:
        rows: its rows, and those of models besides, in order.
        measured: what was measured, by a row's key.
    """

    suite: Suite
    rows: tuple[Row, ...]
    measured: Mapping[str, Measured]

    @property
    def labels(self) -> dict[str, str]:
        return {row.key: row.label for row in self.rows}

    def value(self, key: str, metric: str) -> Interval | None:
        """A row's measure; None where there is none."""
        return self.measured[key].metrics.get(metric) if key in self.measured else None

    def columns(self, of: Sequence[Column]) -> list[Column]:
        return [column for column in of if any(column.name in row.metrics for row in self.measured.values())]

    def places(self, column: Column) -> dict[str, Place]:
        """Best and second best among the rows that are ranked."""
        found = {row.key: self.value(row.key, column.name) for row in self.rows if row.ranked}
        return places(column, {k: v for k, v in found.items() if v is not None}, self.value(REAL, column.name))

    def comparisons(self) -> list[Comparison]:
        values = {key: found.values for key, found in self.measured.items()}
        return compare(values, {row.key: row.against for row in self.rows})

    def state(self) -> State:
        """How all rows were measured.

        Raises:
            InputError: not all in one way, or there are none.
        """
        if not self.measured:
            raise InputError(
                f"no row of {self.suite.name!r} has been evaluated yet; run `moveset evaluate --suite …` first"
            )
        first, *_ = sorted(self.measured, key=lambda key: key == TRAINING)
        state = self.measured[first].state
        for key in self.measured:
            if name := state.unlike(self._state_of(key, state)):
                raise InputError(
                    f"{self.labels[key]}: other {name} than {self.labels[first]}; evaluate all rows in one way"
                )
        if {row.feet for row in self.measured.values()} >= {True, False}:
            loose = "; ".join(self.labels[key] for key, row in self.measured.items() if row.feet is False)
            raise InputError(f"{loose}: feet are not held, and those of other rows are; evaluate all rows in one way")
        return state

    def _state_of(self, key: str, beside: State) -> State:
        """A row's, to be compared with another's: training motion has sentences of its own."""
        found = self.measured[key].state
        own = {"items": beside.items, "texts": beside.texts, "labels": beside.labels} if key == TRAINING else {}
        return replace(found, **own)  # type: ignore[arg-type]

    def check_alike(self, rows: Sequence[Row], now: State, feet: bool) -> None:
        """Refuses rows that could not stand beside those that are there, before hours are spent on them.

        Args:
            rows: that are to be evaluated; their older results go.
            feet: whether planted feet will be held.

        Raises:
            InputError: rows that stay were evaluated in another way.
        """
        anew = {row.key for row in rows}
        holds = any(row.network not in (None, RECONSTRUCTION) for row in rows)
        for key, there in self.measured.items():
            other = self._state_of(key, now).unlike(now)
            found = (
                (other, getattr(there.state, other), getattr(now, other)) if other else ("feet held", there.feet, feet)
            )
            if key not in anew and (other or (holds and there.feet is not None and there.feet != feet)):
                raise InputError(
                    f"rows that stay, such as {self.labels[key]}, have {found[0]} {_said(found[1])} instead of "
                    f"{_said(found[2])}, and no table holds both; give another --out, or delete them"
                )


def days(*tables: Table) -> str:
    """The first and the last day on which rows of tables were measured; "–" if none was."""
    found = sorted({row.date for table in tables for row in table.measured.values()})
    return " to ".join(dict.fromkeys((found[0], found[-1]))) if found else "–"


def load_table(folder: Path) -> Table:
    """A suite's table from its folder, which has the suite's name and a result ``KEY.json`` for each row.

    Raises:
        InputError: no such suite or folder.
        FormatError: something in it cannot be read.
    """
    suite = get_suite(folder.name)
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; run `moveset evaluate --suite …` first")
    files = {path.stem: path for path in sorted(folder.glob("*.json")) if path.name != REPORT}
    raw = {key: json_object(read_limited(path), path, "evaluate that row again") for key, path in files.items()}
    measured = {key: Measured.of(result, str(files[key])) for key, result in raw.items()}
    others = sorted(raw.keys() - {row.key for row in suite.rows})
    given = (
        replace(given_row(suite, one["model"], one["network"] or REAL, one["steps"]), key=key)
        for key, one in ((key, raw[key]) for key in others)
    )
    rows = (*suite.rows, *given)
    return Table(suite, rows, {row.key: measured[row.key] for row in rows if row.key in measured})


def _said(value: object) -> str:
    """A value for people; of a name and a sha256 as much as tells them apart.

    >>> _said(("corpus", "0123456789")), _said(7)
    ('corpus (01234567)', '7')
    """
    return f"{value[0]} ({value[1][:8]})" if isinstance(value, tuple) else str(value)
