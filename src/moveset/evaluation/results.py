"""Repeats as files, so that an evaluation resumes and is shared out; and the result that they make together.

``OUT/repeats/NAME-KEY/000.json`` is a repeat; KEY is a hash of what ``head`` lists: weights, settings, data, evaluator,
protocol and the commit of the code. A file that is there is taken for right whoever made it. Whoever finds all repeats
there writes ``OUT/NAME.json``. Nothing but "seconds" and "date" differs between two runs.
"""

import hashlib
import json
import platform
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import torch

import moveset
from moveset.errors import FormatError, InputError
from moveset.evaluation.intervals import Interval
from moveset.evaluation.protocol import Session
from moveset.io.limits import read_limited, system_errors, write_text
from moveset.io.manifest import json_object

#: What a repeat counts besides what it measures.
_COUNTS = ("groups", "texts", "rollouts", "windows", "shortened")
_REMEDY = "delete it, or give another --out"


class Results:
    """The files of one evaluation.

    Args:
        name: of the result; None for the generator's and the split.

    Raises:
        InputError: a folder that cannot be written to, or another evaluation's result in this one's place.
        FormatError: something else in its place.
    """

    def __init__(self, session: Session, out: Path, name: str | None = None) -> None:
        self._session = session
        self.name = name or f"{session.generator.slug}-{session.protocol.split}"
        self.head = head(session)
        depends = {**self.head, "protocol": {**self.head["protocol"], "repeats": None}}
        key = hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()[:12]
        self.path, self._folder = out / f"{self.name}.json", out / "repeats" / f"{self.name}-{key}"
        self._refuse_another_question()
        with system_errors(f"write to {str(out)!r}", "choose another --out", InputError):
            self._folder.mkdir(parents=True, exist_ok=True)
            write_text(self._folder / "about.json", _json(depends))

    @property
    def repeats(self) -> int:
        """How many repeats there are to be."""
        return self._session.protocol.repeats

    @property
    def done(self) -> list[int]:
        return [number for number in range(self.repeats) if self._file(number).is_file()]

    def missing(self, rank: int = 0, world: int = 1) -> list[int]:
        """Repeats that are not there, of those that a process of several makes."""
        return [number for number in range(rank, self.repeats, world) if not self._file(number).is_file()]

    def forget(self) -> None:
        """Delete all repeats; no other process may be at work on them."""
        # Of more repeats than are asked for now, too: they would be taken for new when more are asked for again.
        for path in self._folder.glob("[0-9]*.json"):
            path.unlink(missing_ok=True)

    def add(self, repeat: Mapping[str, Any]) -> None:
        """Keep a repeat; its file appears whole or not at all."""
        write_text(self._file(int(repeat["repeat"])), _json(repeat))

    def finish(self) -> dict[str, Any] | None:
        """Write and return the result, if every repeat is there.

        Raises:
            FormatError: a repeat's file is damaged.
        """
        if len(self.done) < self.repeats:
            return None
        repeats = [self._read(number) for number in range(self.repeats)]
        versions = {"moveset": moveset.__version__, "torch": torch.__version__, "python": platform.python_version()}
        made = {"date": datetime.now(UTC).date().isoformat(), "versions": versions}
        result = {**self.head, **made, **summary(repeats, len(self._session.judged))}
        write_text(self.path, _json(result))
        return result

    def _refuse_another_question(self) -> None:
        """What was asked of the result that is there must be what is asked now; its name does not say all of it.

        Other weights, code, settings of the model's own or repeats are another answer to the same question, and take
        the place of the older one.
        """
        if not self.path.is_file():
            return
        try:
            there, now = asked(json_object(read_limited(self.path), self.path, _REMEDY)), asked(self.head)
        except (KeyError, TypeError, AttributeError) as error:
            raise FormatError(f"{self.path} is no result of an evaluation ({error!r}); give another --out") from error
        if other := [name for name in now if there.get(name) != now[name]]:
            said = ", ".join(f"{name} {there.get(name)} instead of {now[name]}" for name in other)
            raise InputError(f"{self.path} is the result of another evaluation ({said}); give another --out")

    def _file(self, number: int) -> Path:
        return self._folder / f"{number:03d}.json"

    def _read(self, number: int) -> dict[str, Any]:
        path = self._file(number)
        try:
            found = json.loads(read_limited(path))
            if found["repeat"] != number or not found["metrics"]:
                raise ValueError("another repeat")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise FormatError(f"{path} is not what an evaluation wrote ({error}); delete it and run again") from None
        return dict(found)


def head(session: Session) -> dict[str, Any]:
    """What a result depends on."""
    generator, items, judged, card = session.generator, session.items, session.judged, session.evaluator.card
    weights = generator.weights()
    return {
        "model": generator.model,
        "network": generator.network,
        "steps": generator.steps,
        "settings": generator.describe(),
        "protocol": asdict(session.protocol),
        "items": len(judged),
        "distinct_texts": judged.texts,
        "labels": None if judged.labels is None else len(set(judged.labels)),
        "dropped": judged.dropped,
        "evaluator": {"name": card.name, "sha256": session.evaluator.sha256},
        "data": {"name": items.name, "sha256": items.sha256, "items": len(items)},
        "weights_sha256": hashlib.sha256(json.dumps(weights, sort_keys=True).encode()).hexdigest() if weights else None,
        "weights": weights,
        "commit": commit(),
    }


def asked(described: Mapping[str, Any]) -> dict[str, Any]:
    """What a result answers, by names for people: who is judged, on what, by whom and how, whatever came out.

    Settings are not among it: those that were asked for are in the name of the file.
    """
    judge, data = described["evaluator"], described["data"]
    return {
        "model": described["model"],
        "network": described["network"],
        "motions": str(described["settings"].get("motions_sha256"))[:8],
        "items": described["items"],
        "texts": described["distinct_texts"],
        "data": f"{data['name']} ({str(data['sha256'])[:8]})",
        "evaluator": f"{judge['name']} ({str(judge['sha256'])[:8]})",
        **{name: value for name, value in described["protocol"].items() if name != "repeats"},
    }


def summary(repeats: Sequence[Mapping[str, Any]], items: int) -> dict[str, Any]:
    """Means and intervals of repeats; a measure that not all of them have is left out."""
    names = [name for name in repeats[0]["metrics"] if all(name in repeat["metrics"] for repeat in repeats)]
    columns = {name: [float(repeat["metrics"][name]) for repeat in repeats] for name in names}
    spent = [repeat["seconds"] for repeat in repeats]
    return {
        **{name: repeats[0][name] for name in _COUNTS if name in repeats[0]},
        "metrics": {name: Interval.of(values).to_json() for name, values in columns.items()},
        "repeats": [{name: float(repeat["metrics"][name]) for name in names} for repeat in repeats],
        "seconds": round(sum(s["all"] for s in spent), 1),
        # The quickest repeat: what else the machine was doing can only add to it.
        "seconds_per_item": round(min(s["generating"] for s in spent) / items, 5),
    }


@cache
def commit() -> str:
    """The last commit that changed this package, and what tells changes apart that are not committed.

    Where the package lies in no checkout: its version.
    """
    folder = Path(moveset.__file__).parent
    if not (last := _git(folder, "log", "-1", "--format=%h", "--abbrev=12")):
        return f"version {moveset.__version__}"
    changes = _git(folder, "diff", "HEAD").encode()
    for name in _git(folder, "ls-files", "--others", "--exclude-standard", "-z").split("\0"):
        if name.endswith(".py"):  # of what is new, code alone: weights are told apart by hashes of their own
            changes += f"\0{name}\0".encode() + (folder / name).read_bytes()
    return f"{last}+{hashlib.sha256(changes).hexdigest()[:6]}" if changes else last


def _git(folder: Path, *arguments: str) -> str:
    """What git says of a folder; "" if it knows nothing of it, or is not there."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments, "--", "."], capture_output=True, text=True, check=False
        )
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _json(value: Mapping[str, Any]) -> str:
    return json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
