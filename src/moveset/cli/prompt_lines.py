"""Prompts that arrive while a stream runs, one a line, from standard input, a named pipe or a file."""

import os
import queue
import sys
import threading
from pathlib import Path

from moveset.errors import InputError

_BYTES = 4096
_LONGEST = 64 * 1024


class PromptLines:
    """Lines as they come, read in a thread; empty ones are skipped. That a source broke off, or had none, is told on
    stderr.

    Args:
        source: "-" for standard input, or a path.

    Raises:
        InputError: no such file.
    """

    def __init__(self, source: Path) -> None:
        self._source, self._lines = source, queue.SimpleQueue[str]()
        if str(source) != "-" and (source.is_dir() or not source.exists()):
            raise InputError(f"there is no file {str(source)!r} to read prompts from; give a file, a pipe or -")
        # A named pipe ends when its last writer does: with this process among them the next one is heard, too.
        self._mode = os.O_RDWR if source.is_fifo() else os.O_RDONLY
        self._over = threading.Event()
        self._count = 0
        # A daemon: nobody can call off a read of standard input.
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def ended(self) -> bool:
        """Whether no more prompts can come, and all have been taken."""
        return self._over.is_set() and self._lines.empty()

    def new(self) -> list[str]:
        """What has come since the last call."""
        found = []
        while not self._lines.empty():
            found.append(self._lines.get())
        return found

    def _read(self) -> None:
        rest = b""
        try:
            # Not by way of sys.stdin, whose lock the interpreter wants when it ends.
            handle = _standard_input() if str(self._source) == "-" else os.open(self._source, self._mode)
            while data := os.read(handle, _BYTES):
                *lines, rest = (rest + data).split(b"\n")
                rest = rest[:_LONGEST]
                for line in lines:
                    self._put(line)
            self._put(rest)
            if not self._count:
                _say(f"there is no prompt in {self._named}; write one a line")
        except (OSError, ValueError) as error:  # a source that breaks off has no more prompts
            reason = getattr(error, "strerror", None) or error
            _say(f"no more prompts can be read from {self._named}: {reason}; give a file, a pipe or -")
        finally:
            self._over.set()

    @property
    def _named(self) -> str:
        return "standard input" if str(self._source) == "-" else repr(str(self._source))

    def _put(self, line: bytes) -> None:
        # Editors of Windows begin a file with a mark of its byte order.
        if text := line.decode(errors="replace").removeprefix("\ufeff").strip():
            self._lines.put(text)
            self._count += 1


def _say(text: str) -> None:
    print(f"moveset: {text}", file=sys.stderr)


def _standard_input() -> int:
    if sys.stdin is None:  # closed by whoever started this process
        raise OSError("there is no standard input")
    return sys.stdin.fileno()
