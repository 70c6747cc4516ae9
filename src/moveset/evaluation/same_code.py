"""Which code was seen to give the same as which: what ``--confirm`` found, kept beside the results.

A result whose weights are no longer at hand cannot be made again, but others of its table can. Where one of them, made
by earlier code, came out the same to the bit by later code, the two are taken for the same for all rows whose motion
the same kind of generator made, and those who measured for all rows of the folder.

``OUT/same-code.json`` lists what was found: "what" is "measures" or a kind of generator, "then" and "now" are sha256 of
sources, "by" is the result that was confirmed. Where "what" is "data" they are of data (``same_data``).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from moveset.errors import FormatError
from moveset.io.limits import atomic_write, read_limited
from moveset.io.manifest import json_object
from moveset.io.process import locked

FILE = "same-code.json"
MEASURES = "measures"
DATA = "data"
_REMEDY = "delete it, and confirm a row again"

Code = tuple[str, str]  # what it does, and the sha256 of its source


@dataclass(frozen=True)
class SameCode:
    """Classes of code that gives the same, and of data that are the same but for rounding.

    Args:
        parents: of each code but one of a class, another of it; nothing goes round in circles.
    """

    parents: Mapping[Code, Code] = field(default_factory=dict)

    def of(self, code: Code) -> Code:
        """The one that stands for a class.

        >>> same = SameCode({("measures", "a"): ("measures", "b")})
        >>> same.of(("measures", "a")), same.of(("Streams", "a"))
        (('measures', 'b'), ('Streams', 'a'))
        """
        while code in self.parents:
            code = self.parents[code]
        return code

    def same_data(self, one: str, other: str) -> bool:
        """Whether data of these sha256 are the same, or the same but for rounding."""
        return self.data(one) == self.data(other)

    def data(self, sha256: str) -> str:
        """The sha256 that stands for all data like these."""
        return self.of((DATA, sha256))[1]


def note(folder: Path, then: Mapping[str, Any], now: Mapping[str, Any], by: str) -> None:
    """Write down that two results of the same repeat, of other code, are the same.

    Args:
        folder: of results.
        then, now: heads of these results, of which the code is read.
        by: name of the result.

    Raises:
        FormatError: the file that is there is damaged.
        OSError: the folder cannot be written to.
    """
    keys = ((MEASURES, "measures_sha256"), (str(now["generator"]), "generator_sha256"))
    _note(folder, [{"what": what, "then": then[key], "now": now[key], "by": by} for what, key in keys])


def note_data(folder: Path, then: str, now: str, by: str) -> None:
    """Write down that data of two sha256 are the same but for rounding.

    Args:
        folder: of results.
        then, now: sha256 of the data.
        by: name of the result that shows it.

    Raises:
        FormatError: the file that is there is damaged.
        OSError: the folder cannot be written to.
    """
    _note(folder, [{"what": DATA, "then": then, "now": now, "by": by}])


def _note(folder: Path, new: Sequence[dict[str, str]]) -> None:
    # Several processes may confirm rows of one folder.
    with locked(folder / "repeats"):
        entries = _read(folder)
        for found in new:
            if found["then"] != found["now"] and found not in entries:
                entries.append(found)
        if entries:
            with atomic_write(folder / FILE) as file:
                file.write((json.dumps({"same": entries}, indent=1, ensure_ascii=False) + "\n").encode())


def load(folder: Path) -> SameCode:
    """What was found so far; nothing if nobody looked.

    Raises:
        FormatError: the file that is there is damaged.
    """
    parents: dict[Code, Code] = {}
    for entry in _read(folder):
        then, now = ((entry["what"], entry[when]) for when in ("then", "now"))
        so_far = SameCode(parents)
        if (one := so_far.of(then)) != (other := so_far.of(now)):
            parents[one] = other
    return SameCode(parents)


def _read(folder: Path) -> list[dict[str, str]]:
    path = folder / FILE
    if not path.is_file():
        return []
    try:
        entries = json_object(read_limited(path), path, _REMEDY)["same"]
        return [{name: str(entry[name]) for name in ("what", "then", "now", "by")} for entry in entries]
    except (KeyError, TypeError) as error:
        raise FormatError(f"{path} does not list what code gives the same ({error!r}); {_REMEDY}") from error
