"""Quality against time: results of ``moveset evaluate`` beside the times of ``moveset bench``, and who is on the front.

Time is milliseconds for a second of motion, so that clips and streams share an axis: AITS of the longest clip, or the
time of a segment. Results that were judged in different ways (data, split, evaluator) are never put side by side.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moveset.errors import FormatError, InputError
from moveset.evaluation.intervals import Interval
from moveset.evaluation.plots import front
from moveset.io.limits import read_limited
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.stream_bundle import StreamBundle
from moveset.pipelines.stream_settings import check_stream

_SETTINGS = ("start", "lag", "past_lag", "eta", "guidance", "foot_lock", "stages", "shape")


@dataclass(frozen=True)
class Judged:
    """A row of a benchmark that was evaluated too.

    Args:
        name: of the row.
        way: how it was judged: split and number of items, data, evaluator.
        time: milliseconds for a second of motion, median.
        metrics: of the evaluation.
    """

    name: str
    way: str
    time: float
    metrics: Mapping[str, Interval]


@dataclass(frozen=True)
class Result:
    """What is read of a result of ``moveset evaluate``; ``way`` as in ``Judged``."""

    model: str
    network: str | None
    steps: int | None
    settings: Mapping[str, Any]
    way: str
    metrics: Mapping[str, Interval]

    @classmethod
    def of(cls, raw: Mapping[str, Any], where: Path) -> "Result":
        """From its JSON.

        Raises:
            FormatError: something is missing, or of another type.
        """
        try:
            data, evaluator = raw["data"], raw["evaluator"]
            return cls(
                model=raw["model"],
                network=raw["network"],
                steps=raw["steps"],
                settings=dict(raw["settings"]),
                way=f"{raw['items']} items of {data['name']} ({data['sha256'][:8]}), {raw['protocol']['split']}, "
                f"judged by {evaluator['name']} ({str(evaluator['sha256'])[:8]})",
                metrics={name: Interval.from_json(value) for name, value in raw["metrics"].items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
            raise FormatError(f"{where} is no result of an evaluation ({error!r}); evaluate that again") from error


def read_results(folders: Sequence[Path]) -> list[Result]:
    """Results of known wordings in folders, whatever else lies there.

    Raises:
        InputError: a folder that is not there.
        FormatError: a result that cannot be read.
    """
    found = []
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"there is no folder {folder}; give one with results of `moveset evaluate`")
        for path in sorted(folder.rglob("*.json")):
            try:
                raw = json.loads(read_limited(path))
            except (ValueError, RecursionError) as error:
                raise FormatError(f"{path} is not JSON: {error}; mend it, or move it elsewhere") from error
            protocol = raw.get("protocol") if isinstance(raw, dict) else None
            if not isinstance(protocol, dict) or not {"network", "metrics", "evaluator"} <= set(raw):
                continue
            if protocol.get("wording") == "known":
                found.append(Result.of(raw, path))
    return found


def judged(report: Mapping[str, Any], results: Sequence[Result]) -> list[Judged]:
    """The benchmark's rows for which there is a result, by name; a way with only one of them tells nothing.

    Raises:
        FormatError: not a report of ``bench``.
    """
    found: dict[tuple[str, str], Judged] = {}
    try:
        for kind, part in (("clips", "clips"), ("streams", "segment")):
            model, given = report["models"][kind], report["plan"][kind]
            seconds = model["frames"] / model["fps"]
            theirs = [result for result in results if result.model == model["name"]]
            for name, row in report.get(kind, {}).items():
                label = name if kind == "clips" else f"stream {name}"
                time = row["median_ms"]["total" if kind == "clips" else part] / seconds
                own = own_settings(kind, given, model["name"], row["network"], row["steps"]) if theirs else {}
                for result in theirs:
                    if _same(row, result, own):
                        found.setdefault((label, result.way), Judged(label, result.way, time, result.metrics))
    except (KeyError, TypeError, AttributeError) as error:
        raise FormatError(f"this is no report of `moveset bench`: {error!r}; measure again") from error
    ways = [judged.way for judged in found.values()]
    return [judged for judged in found.values() if ways.count(judged.way) > 1]


def own_settings(kind: str, given: str, name: str, network: str, steps: int) -> dict[str, Any]:
    """The settings that a model has of its own: what a row or a result means that does not say others.

    Args:
        kind: "clips" or "streams".
        given: name or folder of the model when it was measured.
        name: of the model, as it says itself.
        network, steps: of the row.

    Returns:
        Only what holds of every model, if this one is not here (any more).
    """
    own: dict[str, Any] = {"foot_lock": True, "stages": True, "shape": "parallelogram"}
    try:
        if kind == "clips":
            config = Bundle.find(given).config
            return own | ({"guidance": config.guidance[network]} if config.name == name else {})
        stream = StreamBundle.find(given).config
        said = vars(check_stream(stream, network=network, steps=steps).settings) if stream.name == name else {}
        return own | {key: said[key] for key in _SETTINGS if key in said}
    except (InputError, KeyError):
        return own


def pareto(rows: Sequence[Judged], metric: str = "fid") -> list[str]:
    """Names of the rows of one way that no other beats in both time and a metric (the smaller, the better).

    Times are compared to two digits: networks of one size take as long, whatever the clock said.
    """
    return front(
        {row.name: (float(f"{row.time:.2g}"), row.metrics[metric].mean) for row in rows if metric in row.metrics}
    )


def _same(row: Mapping[str, Any], result: Result, own: Mapping[str, Any]) -> bool:
    """Whether a result is of the network, steps and settings of a row."""
    ours, theirs = ({**own, **said} for said in (row.get("settings", {}), result.settings))
    if ours.get("guidance") and own.get("guidance"):
        # How strongly a text is followed takes no time: what the model chooses by now is what its results are of.
        ours["guidance"] = own["guidance"]
    return (row["network"], row["steps"]) == (result.network, result.steps) and all(
        ours.get(name) == theirs.get(name) for name in _SETTINGS
    )
