"""One stream as the server keeps it: what its client wants, and how far it has got.

The event loop writes what the client wants, the worker what was made; both hold the worker's lock while they do.
n frames of a segment.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from moveset.pipelines.stream_batch import Stream, StreamBatch
from moveset.server.protocol import Start

Message = Mapping[str, Any] | bytes


@dataclass(eq=False)
class Session:
    """A stream.

    Args:
        number: of the stream, for people.
        deliver: hands messages to the client's connection; called by the worker, never waits.
        buffer: seconds that may be made ahead of what was acknowledged.
        commit: frames after the acknowledged one that a new prompt leaves alone, as far as they were sent; None leaves
            all that was sent alone.
        begin: what it is to be, with its seed; None once it has begun.

    Attributes:
        asked: a prompt that was not taken up yet; a newer one takes its place.
        wishes: steps and guidance that were not taken up yet.
        unsaid: paused and resumed, in order, that the client was not told yet.
        unsent: packets that are on their way to the connection.
        sent: frames handed to the connection.
        played: frames acknowledged.
    """

    number: int
    deliver: Callable[[Sequence[Message]], None]
    buffer: float
    commit: int | None
    begin: Start | None
    asked: str | None = None
    wishes: dict[str, Any] = field(default_factory=dict)
    unsaid: list[str] = field(default_factory=list)
    batch: StreamBatch | None = None
    stream: Stream | None = None
    fps: float = 20.0
    segment: int = 1
    paused: bool = False
    over: bool = False
    unsent: int = 0
    sent: int = 0
    played: int = 0
    kept: dict[int, Stream] = field(default_factory=dict)
    due_since: float | None = None
    _clock: float = 0.0
    _heard: float = 0.0
    _paused_at: float = 0.0

    @property
    def waiting(self) -> bool:
        """Whether the client wants something that the worker has to do."""
        wants = self.begin is not None or self.asked is not None or bool(self.wishes) or bool(self.unsaid)
        return wants and not self.over

    @property
    def due(self) -> bool:
        """Whether it is time to make the next segment: less than the buffer is ahead, and the last one was sent."""
        ahead = self.sent - self.played
        return not (self.over or self.paused or self.stream is None or self.unsent) and ahead < self.buffer * self.fps

    @property
    def deadline(self) -> float:
        """When a client that plays in real time runs out of frames.

        One that acknowledges faster than real time does not get ahead of others by it.
        """
        return max(self._clock + self.sent / self.fps, self._heard + (self.sent - self.played) / self.fps)

    def started(self, batch: StreamBatch, stream: Stream) -> None:
        """It begins to play now."""
        self.batch, self.stream = batch, stream
        self.fps, self.segment = batch.bundle.config.fps, batch.bundle.config.segment
        self._clock = self._heard = time.monotonic()
        self.look()

    def went_out(self) -> None:
        """A packet has been handed to the connection."""
        self.unsent -= 1
        self.look()

    def acknowledge(self, frame: int) -> None:
        """The client has played all frames before this one; what was never sent does not count."""
        self._heard = time.monotonic()
        self.played = max(self.played, min(frame, self.sent))
        self.look()

    def pause(self) -> None:
        """Make nothing more until it is resumed; what is in work still comes, and then the client is told."""
        self.unsaid.append("paused")
        if not self.paused:
            self.paused, self._paused_at, self.due_since = True, time.monotonic(), None

    def resume(self) -> None:
        self.unsaid.append("resumed")
        if self.paused:
            now = time.monotonic()
            self.paused, self._clock, self._heard = False, self._clock + now - self._paused_at, now
            self.look()

    def look(self) -> None:
        """Note since when the stream is due."""
        if not self.due:
            self.due_since = None
        elif self.due_since is None:
            self.due_since = time.monotonic()

    def keep(self) -> None:
        """Remember where the next segment begins, in case a prompt is to go back there; forget what was played.

        The next segment must then be made with a copy of it.
        """
        assert self.stream is not None
        if self.commit is not None:
            oldest = self.played // self.segment
            self.kept = {number: stream for number, stream in self.kept.items() if number >= oldest}
            self.kept[self.stream.number] = self.stream

    def go_back(self) -> None:
        """To the first segment that is not committed, if that was made already; the newest prompt begins there."""
        now = self.stream
        assert now is not None
        if self.commit is None:
            return
        number = math.ceil((self.played + self.commit) / self.segment)
        if number < now.number:
            self.stream = now.back_at(self.kept[number])
            self.sent = number * self.segment
            self.look()
