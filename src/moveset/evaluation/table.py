"""A suite's rows with what was measured of them, from the files of a results folder.

``rows.json`` says which rows there are, where their result files lie, and why some have no numbers.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from moveset.errors import FormatError, InputError
from moveset.evaluation import same_code
from moveset.evaluation.columns import Column, Place, places
from moveset.evaluation.intervals import Interval
from moveset.evaluation.repeat_pairs import RepeatPairs, Values, repeat_pairs
from moveset.evaluation.suites import REAL, RECONSTRUCTION, Row, RowResult, Suite, get_suite
from moveset.evaluation.targets import Check, Difference, checks, differences
from moveset.io.limits import atomic_write
from moveset.io.manifest import json_object
from moveset.io.process import locked

ROWS = "rows.json"
OWN = ("result", "missing")  # of an entry of that file, beside the row itself
#: What all rows of a table have in common.
COMMON = ("items", "texts", "labels", "evaluator", "data", "wording", "split", "group")

Value = TypeVar("Value")


@dataclass(frozen=True)
class Measured:
    """What a report needs of a result.

    Args:
        metrics: by name.
        repeats: how many there were.
        values: every repeat's value by metric; none where they are not known.
        seed: what all repeats were drawn from.
        items, texts, labels: how many test items, distinct texts and distinct label combinations; None if unlabelled.
        evaluator, data: name and sha256.
        weights: sha256 of all files that take part, "" where there are none.
        wording: of the generator's prompts, "known" or "held-out".
        split: of the data.
        group: items among which R-precision looks.
        measures: sha256 of the code that measured.
        made: what made the motion, and the sha256 of its code; "" where a result does not say.
        feet: whether planted feet were held; None where nothing could be held.
        seconds: what an item took to generate, in batches, on average; None if nothing was generated.
        kept: whether other code made its repeats, and the first came out the same with today's (``confirm``).
    """

    metrics: Mapping[str, Interval]
    repeats: int
    values: Values
    seed: int
    items: int
    texts: int
    labels: int | None
    evaluator: tuple[str, str]
    data: tuple[str, str]
    weights: str
    wording: str
    split: str
    group: int
    measures: str
    made: tuple[str, str]
    seconds: float | None
    feet: bool | None = None
    kept: bool = False

    @classmethod
    def of(cls, raw: Mapping[str, Any], where: str) -> "Measured":
        """From a result's JSON.

        Raises:
            FormatError: something is missing, or of another type.
        """
        try:
            protocol = raw["protocol"]
            return cls(
                metrics={k: Interval.from_json(v) for k, v in raw["metrics"].items()},
                repeats=len(raw["repeats"]),
                values={k: [float(repeat[k]) for repeat in raw["repeats"] if repeat] for k in raw["metrics"]},
                seed=int(protocol["seed"]),
                items=int(raw["items"]),
                texts=int(raw["distinct_texts"]),
                labels=None if raw["labels"] is None else int(raw["labels"]),
                evaluator=(str(raw["evaluator"]["name"]), str(raw["evaluator"]["sha256"])),
                data=(str(raw["data"]["name"]), str(raw["data"]["sha256"])),
                weights=str(raw["weights_sha256"] or ""),
                wording=str(protocol["wording"]),
                split=str(protocol["split"]),
                group=int(protocol["group"]),
                measures=str(raw["measures_sha256"]),
                made=(str(raw.get("generator", "")), str(raw["generator_sha256"])),
                seconds=float(raw["seconds_per_item"]) if raw["weights_sha256"] else None,
                feet=raw.get("settings", {}).get("foot_lock"),
                kept="kept" in raw,
            )
        except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
            raise FormatError(f"{where} is no result of an evaluation: {error}; evaluate that row again") from error


@dataclass(frozen=True)
class Table:
    """A suite with its numbers: what every form of the report is made from."""

    suite: Suite
    rows: tuple[RowResult[Measured], ...]
    same: same_code.SameCode = field(default_factory=same_code.SameCode)

    @property
    def measured(self) -> dict[str, Measured]:
        """Results by key, of the rows that have one."""
        return {entry.row.key: entry.result for entry in self.rows if entry.result is not None}

    @property
    def metrics(self) -> dict[str, Mapping[str, Interval]]:
        """Intervals by key and metric."""
        return {key: found.metrics for key, found in self.measured.items()}

    @property
    def labels(self) -> dict[str, str]:
        """Names of the rows by key."""
        return {entry.row.key: entry.row.label for entry in self.rows}

    def columns(self, of: Sequence[Column]) -> list[Column]:
        """Those that some row has."""
        return [column for column in of if any(column.name in metrics for metrics in self.metrics.values())]

    def places(self, column: Column) -> dict[str, Place]:
        """Best and second best among the rows that are ranked."""
        ranked = {entry.row.key for entry in self.rows if entry.row.ranked}
        values = {k: m[column.name] for k, m in self.metrics.items() if k in ranked and column.name in m}
        return places(column, values, self.metrics.get(REAL, {}).get(column.name))

    def differences(self) -> list[Difference]:
        """Of every row against those it is compared with."""
        return differences(self.metrics, {entry.row.key: entry.row.against for entry in self.rows})

    def pairs(self) -> list[RepeatPairs]:
        """Of every row against those it is compared with, repeat by repeat, if both were drawn from one seed."""
        seed = _usual(found.seed for found in self.measured.values())
        values = {key: found.values for key, found in self.measured.items() if found.seed == seed}
        return repeat_pairs(values, {entry.row.key: entry.row.against for entry in self.rows})

    def checks(self) -> list[Check]:
        """Of the targets; of rows that are in the table."""
        labels = {row.key: row.label for row in self.suite.rows} | self.labels
        shipped = [entry.row.key for entry in self.rows if entry.row.shipped and entry.result is not None]
        return checks(self.suite.name, self.metrics, shipped, labels)

    def common(self) -> Measured:
        """What all results have in common: items, texts, labels, evaluator, data, wording, split, group and feet.

        Raises:
            InputError: they have not, or there are none.
        """
        if not self.measured:
            raise InputError(
                f"no row of {self.suite.name!r} has been evaluated yet; run `moveset evaluate --suite …` first"
            )
        key, first = next(iter(self.measured.items()))
        for name in COMMON:
            if others := self._unlike(name):
                raise InputError(
                    f"{'; '.join(others)}: other {name} than {self.labels[key]}; evaluate all rows in one way"
                )
        if {row.feet for row in self.measured.values()} >= {True, False}:
            loose = "; ".join(self.labels[key] for key, row in self.measured.items() if row.feet is False)
            raise InputError(f"{loose}: feet are not held, and those of other rows are; evaluate all rows in one way")
        return first

    @property
    def odd(self) -> list[str]:
        """Labels of the rows that were measured by other code than most, or made by other code than most of a kind.

        Code that was seen to give the same to the bit, be it on another row (``same_code``), is not other.
        """
        return self._unusual(self.same.of)

    @property
    def trusted(self) -> list[str]:
        """Labels of the rows of other code than most that is not taken for other, because of another row."""
        odd = self.odd
        return [label for label in self._unusual(lambda code: code) if label not in odd]

    def _unusual(self, name: Callable[[same_code.Code], same_code.Code]) -> list[str]:
        """Labels of the rows whose code is not the most frequent of its kind, by these names of it."""
        found = {key: (name((same_code.MEASURES, row.measures)), name(row.made)) for key, row in self.measured.items()}
        measures = _usual(measuring for measuring, _ in found.values())
        kinds = {made[0] for _, made in found.values()}
        usual = {kind: _usual(made for _, made in found.values() if made[0] == kind) for kind in kinds}
        return [
            self.labels[key]
            for key, (measuring, made) in found.items()
            if measuring != measures or not made[0] or made != usual[made[0]]
        ]

    @property
    def kept(self) -> list[str]:
        """Labels of the rows that other code made, and of which today's makes the first repeat alike."""
        return [self.labels[key] for key, row in self.measured.items() if row.kept]

    def _unlike(self, name: str) -> list[str]:
        """Labels of the rows whose results differ in a field from the first."""
        found = {self.labels[key]: getattr(result, name) for key, result in self.measured.items()}
        if name == "data":
            found = {label: (data, self.same.data(sha256)) for label, (data, sha256) in found.items()}
        first = next(iter(found.values()))
        return [label for label, value in found.items() if value != first]


def _usual(values: Iterable[Value]) -> Value | None:
    """The most frequent one, the first of several; None of none."""
    return next((value for value, _ in Counter(values).most_common(1)), None)


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


def check_alike(out: Path, name: str, rows: Sequence[Row], asked: Mapping[str, Any], feet: bool) -> None:
    """Refuses rows that no table could hold beside those that are there, before hours are spent on them.

    Args:
        out: the suite's folder; nothing need be in it.
        name: of the suite.
        rows: that are to be evaluated; their older results go.
        asked: how, by the fields of ``Measured`` that are in ``COMMON``.
        feet: whether planted feet will be held.

    Raises:
        InputError: rows that stay were evaluated in another way.
        FormatError: what is there cannot be read.
    """
    if not (out / ROWS).is_file():
        return
    holds = any(row.network not in (None, RECONSTRUCTION) for row in rows)
    anew, same = {row.key for row in rows}, same_code.load(out)
    for key, entry in _staying(out / ROWS, get_suite(name)).items():
        if key in anew or (there := _read(out, entry["result"])) is None:
            continue
        if same.same_data(there.data[1], asked["data"][1]):
            there = replace(there, data=asked["data"])
        found = {field: getattr(there, field) for field in COMMON} | {"feet held": there.feet}
        now = {**asked, "feet held": feet if holds and there.feet is not None else there.feet}
        if other := [field for field in found if found[field] != now[field]]:
            raise InputError(
                f"{out} has rows that stay, such as {entry['label']}, with {other[0]} {_said(found[other[0]])} instead "
                f"of {_said(now[other[0]])}, and no table holds both; give another --out, or evaluate all rows"
            )


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
    raw = json_object(index.read_bytes(), index, "give another --out, or delete it")
    if raw.get("suite") != suite.name:
        raise FormatError(f"{index} is of the suite {raw.get('suite')!r}; write {suite.name!r} to another folder")
    known, models = {row.key for row in suite.rows}, {row.model for row in suite.rows}
    try:
        entries = [(entry["key"], entry["model"], entry["result"], entry["label"], entry) for entry in raw["rows"]]
    except (KeyError, TypeError) as error:
        raise FormatError(f"{index} is no list of rows: {error!r}; give another --out, or delete it") from error
    return {key: entry for key, model, _, _, entry in entries if key in known or model not in models}


def load_table(folder: Path) -> Table:
    """A suite's table from its folder.

    Raises:
        InputError: no such folder.
        FormatError: something in it cannot be read.
    """
    index = folder / ROWS
    if not index.is_file():
        raise InputError(f"{folder} has no {ROWS}; run `moveset evaluate --suite …` first")
    raw = json_object(index.read_bytes(), index, "give another --out, or delete it")
    try:
        entries = [
            (Row(**{k: v for k, v in e.items() if k not in OWN}), e["result"], e["missing"]) for e in raw["rows"]
        ]
        suite = get_suite(raw["suite"])
    except (KeyError, TypeError, AttributeError, InputError) as error:
        raise FormatError(f"{index} is no list of rows: {error}; run `moveset evaluate --suite …` again") from error
    rows_read = tuple(RowResult(row, _read(folder, file), missing) for row, file, missing in entries)
    return Table(suite, rows_read, same_code.load(folder))


def _read(folder: Path, name: str | None) -> Measured | None:
    if name is None:
        return None
    file = folder / name
    if not file.is_file():
        raise FormatError(f"{folder / ROWS} names {name}, which is not there; evaluate that row again")
    return Measured.of(json_object(file.read_bytes(), file, "evaluate that row again"), str(file))
