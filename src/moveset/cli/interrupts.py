"""Ctrl-C and SIGTERM as requests to stop at the next good moment, so that what was made is kept."""

import signal
import threading
from types import FrameType
from typing import Any, Self

from moveset.errors import MovesetError

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """While in its ``with`` block, the first signal is noted and a second one interrupts at once.

    Attributes:
        pending: the signal that came, or 0.
    """

    def __init__(self) -> None:
        self.pending = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        # Only the main thread may set handlers; elsewhere signals do what they always did.
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in _SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """End as the signal asks for, once everything is in order.

        Raises:
            KeyboardInterrupt: Ctrl-C.
            MovesetError: SIGTERM.
        """
        if self.pending == signal.SIGINT:
            raise KeyboardInterrupt
        if self.pending:
            raise MovesetError("stopped by SIGTERM; what was made until then is in the files")

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.pending:
            raise KeyboardInterrupt
        self.pending = number
