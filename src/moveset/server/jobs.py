"""Clips to be made: a bounded line of them, and the last few that were finished."""

import asyncio
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from moveset.pipelines.postprocess import Postprocess
from moveset.pipelines.request import Method, Request
from moveset.pipelines.text_to_motion import Generation, TextToMotion
from moveset.server.failures import RequestError
from moveset.server.limits import Limits

State = Literal["queued", "running", "done", "failed", "cancelled"]


@dataclass(frozen=True)
class Answer:
    """The bytes of an answer.

    Args:
        filename: to save them as; None for JSON.
        headers: what a file has no place for.
    """

    content: bytes
    media_type: str
    filename: str | None = None
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Order:
    """A checked request: one ``Request`` for every variant."""

    t2m: TextToMotion
    requests: tuple[Request, ...]
    method: Method
    format: str
    finish: Postprocess


@dataclass(eq=False)
class Job:
    """An order on its way.

    Attributes:
        id: cannot be guessed.
        progress: 0 to 1.
        made: variants so far.
        done: set when the state is final; belongs to the event loop.
    """

    order: Order
    id: str = field(default_factory=lambda: secrets.token_hex(8))
    state: State = "queued"
    progress: float = 0.0
    finished: float | None = None
    made: list[Generation] = field(default_factory=list)
    answer: Answer | None = None
    error: RequestError | None = None
    cancelled: bool = False
    done: asyncio.Event = field(default_factory=asyncio.Event)

    def end(self, state: State, answer: Answer | None = None, error: RequestError | None = None) -> None:
        self.state, self.answer, self.error, self.finished = state, answer, error, time.monotonic()
        self.made.clear()
        self.progress = 1.0 if state == "done" else self.progress
        self.done.set()


class JobBook:
    """Jobs by number; used by the event loop alone.

    Args:
        limits: how many are kept, for how long, and of what size together.
        position: place of a job in the line, from 0.
    """

    def __init__(self, limits: Limits, position: Callable[[Job], int]) -> None:
        self._limits, self._position = limits, position
        self._jobs: dict[str, Job] = {}

    def add(self, job: Job) -> None:
        self._jobs[job.id] = job
        self.forget()

    def find(self, number: str) -> Job:
        """A job by number.

        Raises:
            RequestError: there is none, or it was forgotten.
        """
        self.forget()
        if number not in self._jobs:
            raise RequestError(
                404, "unknown_job", "there is no such job; finished ones are kept for a few minutes, so ask sooner"
            )
        return self._jobs[number]

    def unfinished(self) -> list[Job]:
        return [job for job in self._jobs.values() if job.finished is None]

    def describe(self, job: Job) -> dict[str, Any]:
        return {
            "id": job.id,
            "state": job.state,
            "position": self._position(job) if job.state == "queued" else 0,
            "progress": round(job.progress, 3),
            "error": None if job.error is None else job.error.body()["error"],
        }

    def forget(self) -> None:
        """Drop finished jobs: the oldest first, until number, age and size are within their limits."""
        over = sorted(
            (job for job in self._jobs.values() if job.finished is not None), key=lambda job: job.finished or 0
        )
        size = sum(len(job.answer.content) for job in over if job.answer)
        now = time.monotonic()
        for k, job in enumerate(over):
            old = now - (job.finished or now) > self._limits.kept_seconds
            if old or len(over) - k > self._limits.kept_jobs or (size > self._limits.kept_bytes and k + 1 < len(over)):
                del self._jobs[job.id]
                size -= len(job.answer.content) if job.answer else 0
