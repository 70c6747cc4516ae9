"""Lists as data sets have them and people write them: a JSON object a line."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from moveset.errors import FormatError
from moveset.io.limits import read_limited

_Listed = TypeVar("_Listed")


def read_listing(path: Path, read: Callable[[int, dict[str, Any]], _Listed], what: str) -> list[_Listed]:
    """What the lines of a file say; empty ones, and a mark of the byte order, count for nothing.

    Args:
        read: makes something of a line's number and its object; what is wrong with it is a ValueError, a KeyError or a
            TypeError.
        what: that a line is to be, for people.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is not UTF-8, far too large, or a line is damaged.
    """
    try:
        # Not splitlines, which also parts a sentence at the line ends of Unicode.
        lines = read_limited(path).decode("utf-8-sig").split("\n")
    except UnicodeDecodeError:
        raise FormatError(f"{path} is not UTF-8 text; save it as UTF-8, or restore the original file") from None
    found = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            held = json.loads(line)
            if not isinstance(held, dict):
                raise TypeError("it is no JSON object")
            found.append(read(number, held))
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            reason = f"it has no {error.args[0]}" if isinstance(error, KeyError) else error
            remedy = "mend the line, or restore the original file"
            raise FormatError(f"{path}, line {number}: not {what} ({reason}); {remedy}") from error
    return found
