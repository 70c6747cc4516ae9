"""The WebSocket of a stream: control messages in, events and packets of frames out."""

import asyncio
import json
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from moveset.server.failures import RequestError
from moveset.server.protocol import ChangePrompt, Plain, Played, Set, Start, read_message
from moveset.server.service import Service
from moveset.server.sessions import Message, Session

VERSION = 1
_ROOM = 64  # messages that may wait to be sent before no more is read from this client
_BURST = 50  # messages that may come at once

router = APIRouter(prefix="/v1")


class _Closed(Exception):
    """The connection is to be closed with a code."""

    def __init__(self, close: int, code: str, message: str) -> None:
        super().__init__(message)
        self.close, self.code, self.message = close, code, message


@router.websocket("/stream")
async def stream(socket: WebSocket, model: str | None = None) -> None:
    """A connection, on which one stream at a time may run."""
    the: Service = socket.app.state.service
    await socket.accept()
    # Decided by those who came before: of a burst that arrives at once, as many stay as there is room for.
    admitted = the.connections < the.limits.connections
    the.connections += admitted
    the.metrics.connections.set(the.connections)
    connection = _Connection(socket, the, model, admitted)
    the.farewells.add(connection.farewell)
    try:
        await connection.run()
    finally:
        the.farewells.discard(connection.farewell)
        the.connections -= admitted
        the.metrics.connections.set(the.connections)


class _Connection:
    """One client. Its sender is the only one that writes to it; its reader stops while much is waiting to be sent."""

    def __init__(self, socket: WebSocket, the: Service, model: str | None, admitted: bool) -> None:
        self._socket, self._the, self._model, self._admitted = socket, the, model, admitted
        self._loop = asyncio.get_running_loop()
        self._outbox: asyncio.Queue[tuple[Session | None, Message] | _Closed] = asyncio.Queue()
        self._room = asyncio.Event()
        self._room.set()
        self._session: Session | None = None
        self._bad = 0
        self._rate = _Rate(the.limits.messages_per_second, _BURST)

    async def run(self) -> None:
        sender = asyncio.create_task(self._send())
        reader = asyncio.create_task(self._read())
        try:
            done, _ = await asyncio.wait((sender, reader), return_when=asyncio.FIRST_COMPLETED)
            if sender not in done:
                # The reader has ended: with a reason to tell, or because the client is gone.
                problem = reader.exception()
                if isinstance(problem, _Closed):
                    self._outbox.put_nowait(problem)
                    await asyncio.wait((sender,), timeout=5.0)
            for task in done:
                error = task.exception()
                if error and not isinstance(error, (_Closed, WebSocketDisconnect, RuntimeError, OSError)):
                    raise error
        finally:
            for task in (sender, reader):
                task.cancel()
            self._end()
            # Not gather: cancelled meanwhile, it tells of its children's cancellation instead of this task's.
            ended, _ = await asyncio.wait((sender, reader))
            for task in ended:
                if not task.cancelled():
                    task.exception()  # seen; what matters was raised above

    async def farewell(self) -> None:
        """Tell the client that the server stops."""
        if self._session is not None:
            self._say({"type": "stopped", "frames": self._session.sent, "reason": "server stopping"})
        self._end()
        self._outbox.put_nowait(_Closed(1001, "stopping", "the server is stopping"))

    async def _read(self) -> None:
        limits = self._the.limits
        if self._the.stopping:
            raise _Closed(1013, "stopping", "the server is stopping; try again when it is back")
        if not self._admitted:
            raise _Closed(
                1013, "busy", f"{limits.connections} connections are open, which is the limit; try again later"
            )
        self._say({"type": "hello", "version": VERSION, **self._the.models()})
        while True:
            await self._room.wait()
            try:
                # Not wait_for: it may swallow that this task is cancelled.
                async with asyncio.timeout(limits.idle):
                    got = await self._socket.receive()
            except TimeoutError:
                raise _Closed(1008, "idle", f"no message came for {limits.idle:g} s; acknowledge frames") from None
            if got["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(got.get("code", 1006))
            await self._rate.wait()
            self._hear(got.get("text"))

    def _hear(self, text: str | None) -> None:
        limit = self._the.limits.message
        if text is None:
            raise _Closed(1008, "binary", "clients send text; leave binary messages to the server")
        if len(text.encode("utf-8", "surrogatepass")) > limit:
            raise _Closed(1009, "too_large", f"a message is longer than the limit of {limit} bytes; send less")
        try:
            message = read_message(text)
        except ValueError as error:
            self._bad += 1
            if self._bad > self._the.limits.bad_messages:
                raise _Closed(1008, "invalid", "too many messages could not be read; see the documentation") from None
            self._refuse("invalid", str(error))
            return
        try:
            self._obey(message)
        except RequestError as error:
            self._refuse(error.code, error.message)

    def _obey(self, message: Start | ChangePrompt | Played | Set | Plain) -> None:
        if isinstance(message, Start):
            self._start(message)
            return
        session = self._session
        if session is None:
            raise RequestError(409, "not_started", f"there is no stream to {message.type}; send start first")
        worker = self._the.worker
        if isinstance(message, Played):
            worker.tell(lambda: session.acknowledge(message.frame))
        elif isinstance(message, ChangePrompt):
            worker.tell(lambda: setattr(session, "asked", message.text))
        elif isinstance(message, Set):
            self._set(session, message)
        elif message.type == "stop":
            self._end()
            self._say({"type": "stopped", "frames": session.sent, "reason": "asked"})
        else:
            worker.tell(session.pause if message.type == "pause" else session.resume)

    def _start(self, wish: Start) -> None:
        if self._session is not None:
            raise RequestError(409, "already_started", "a stream is running on this connection; send stop first")
        model = self._the.catalog.stream(wish.model or self._model).config.name
        seed = secrets.randbelow(2**31) if wish.seed is None else wish.seed
        begin = wish.model_copy(update={"model": model, "seed": seed})
        session: Session

        def deliver(messages: Sequence[Message]) -> None:
            self._loop.call_soon_threadsafe(self._take, session, messages)

        session = Session(next(self._the.stream_numbers), deliver, wish.buffer, wish.commit, begin)
        self._the.worker.join_stream(session)
        self._session = session

    def _set(self, session: Session, wish: Set) -> None:
        given = wish.model_dump(exclude_unset=True, exclude_none=True, exclude={"type", "buffer"})

        def change() -> None:
            session.buffer = session.buffer if wish.buffer is None else wish.buffer
            session.wishes |= given
            session.look()

        self._the.worker.tell(change)
        if not given:
            self._say({"type": "set", "buffer": session.buffer})

    def _take(self, session: Session, messages: Sequence[Message]) -> None:
        """What the worker delivers; on the event loop."""
        if session is not self._session:
            return
        for message in messages:
            self._say(message, session)
            if isinstance(message, dict) and message["type"] == "stopped":
                self._end()

    def _say(self, message: Message, session: Session | None = None) -> None:
        self._outbox.put_nowait((session, message))
        if self._outbox.qsize() >= _ROOM:
            self._room.clear()

    def _refuse(self, code: str, message: str) -> None:
        self._the.metrics.refused.labels(code).inc()
        self._say({"type": "error", "code": code, "message": message})

    def _end(self) -> None:
        if self._session is not None:
            self._the.worker.leave(self._session)
            self._session = None

    async def _send(self) -> None:
        while True:
            item = await self._outbox.get()
            if isinstance(item, _Closed):
                self._the.metrics.refused.labels(item.code).inc()
                if item.code != "stopping":
                    await self._socket.send_text(_text({"type": "error", "code": item.code, "message": item.message}))
                await self._socket.close(item.close, item.code)
                return
            session, message = item
            if isinstance(message, bytes):
                await self._socket.send_bytes(message)
                if session is not None:
                    self._the.worker.tell(session.went_out)
            else:
                await self._socket.send_text(_text(message))
            if self._outbox.qsize() < _ROOM // 2:
                self._room.set()


@dataclass
class _Rate:
    """At most ``per_second`` on average; who is faster waits."""

    per_second: float
    burst: int
    _left: float = 0.0
    _last: float = 0.0

    async def wait(self) -> None:
        """Until the next one may pass; others get their turn in any case."""
        now = time.monotonic()
        self._left = min(self.burst, self._left + (now - self._last) * self.per_second)
        self._last = now
        self._left -= 1.0
        await asyncio.sleep(max(0.0, -self._left / self.per_second))


def _text(message: Message) -> str:
    return json.dumps(message, ensure_ascii=False)
