"""Pickles of plain words and numbers, read without unpickling: word lists that others saved with ``pickle.dump``.

A pickle is a program. Its operations are walked here one by one, and only those that make strings, whole numbers, lists
and dictionaries mean something; one that names a class or calls anything ends the reading before it could happen.
"""

import pickletools
from pathlib import Path
from typing import Any

from moveset.errors import FormatError
from moveset.io.limits import read_limited

MAX_BYTES = 64 * 2**20
_STRINGS = {"UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"}
_NUMBERS = {"INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1"}
_STORE = {"PUT", "BINPUT", "LONG_BINPUT"}
_FETCH = {"GET", "BINGET", "LONG_BINGET"}
_MARK = object()


def read_plain_pickle(path: str | Path) -> list[Any] | dict[Any, Any]:
    """The list or dictionary of strings and whole numbers in a pickle of any protocol.

    Raises:
        InputError: the file is missing or unreadable.
        FormatError: it is damaged, larger than 64 MB, or holds anything else.
    """
    data = read_limited(path, MAX_BYTES)
    machine = _Machine()
    try:
        for operation, argument, _ in pickletools.genops(data):
            machine.step(operation.name, argument)
        (found,) = machine.stack
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError) as error:
        reason = str(error)[:80] or type(error).__name__
        raise FormatError(
            f"{path} is no pickled list or dictionary of plain words and numbers ({reason}); restore the original"
        ) from None
    if not isinstance(found, list | dict):
        raise FormatError(f"{path} holds one {type(found).__name__}, no list or dictionary; restore the original")
    return found


class _Machine:
    """A stack, a memo, and the few operations that build lists and dictionaries."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def step(self, name: str, argument: Any) -> None:
        stack = self.stack
        if name in ("PROTO", "FRAME", "STOP"):
            return
        if name in _STRINGS or name in _NUMBERS:
            if isinstance(argument, bool):
                raise ValueError("a truth value")
            stack.append(argument)
        elif name in _STORE:
            self.memo[int(argument)] = stack[-1]
        elif name == "MEMOIZE":
            self.memo[len(self.memo)] = stack[-1]
        elif name in _FETCH:
            stack.append(self.memo[int(argument)])
        elif name == "MARK":
            stack.append(_MARK)
        elif name in ("EMPTY_LIST", "EMPTY_DICT"):
            stack.append([] if name == "EMPTY_LIST" else {})
        elif name == "LIST":
            stack.append(self._since_mark())
        elif name == "DICT":
            stack.append(_pairs(self._since_mark()))
        elif name in ("APPEND", "APPENDS"):
            values = self._since_mark() if name == "APPENDS" else [stack.pop()]
            _plain(values)
            stack[-1].extend(values)
        elif name in ("SETITEM", "SETITEMS"):
            values = self._since_mark() if name == "SETITEMS" else [stack.pop(-2), stack.pop()]
            stack[-1].update(_pairs(values))
        else:
            raise ValueError(f"operation {name}")

    def _since_mark(self) -> list[Any]:
        for start in range(len(self.stack) - 1, -1, -1):
            if self.stack[start] is _MARK:
                values = self.stack[start + 1 :]
                del self.stack[start:]
                return values
        raise ValueError("no mark")


def _pairs(values: list[Any]) -> dict[Any, Any]:
    _plain(values)
    return dict(zip(values[::2], values[1::2], strict=True))


def _plain(values: list[Any]) -> None:
    """Nothing within anything: word lists are flat."""
    if wrong := [v for v in values if type(v) not in (str, int)]:
        raise ValueError(f"a {type(wrong[0]).__name__} within")
