"""A thread that writes answers, so that it takes no time from the worker's lock or the event loop."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch

from moveset.server.jobs import Answer


class Writer:
    """One thread; used by the event loop alone.

    Attributes:
        writing: answers that wait to be written or are in work.
    """

    def __init__(self, name: str) -> None:
        self.thread = ThreadPoolExecutor(1, name)
        self.writing = 0

    async def write(self, make: Callable[[], Answer]) -> Answer:
        """What ``make`` returns, called on the thread."""

        def calm() -> Answer:
            with torch.inference_mode():
                return make()

        self.writing += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self.thread, calm)
        finally:
            self.writing -= 1

    def stop(self) -> None:
        """Write nothing more; what is in work goes on."""
        self.thread.shutdown(wait=False, cancel_futures=True)
