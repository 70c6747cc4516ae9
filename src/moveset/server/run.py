"""Serving an application until it is told to stop."""

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterator
from typing import Any

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from moveset.errors import InputError
from moveset.io.limits import system_errors
from moveset.io.process import handled_signals
from moveset.server.limits import Limits
from moveset.server.service import Service

_FRAMES = 16  # times the longest message: what is longer is not even read
_FLUSH = 5.0  # seconds in which what was said last must be taken


class Server(uvicorn.Server):
    """uvicorn, which tells streams before it closes them and for which being asked to stop is no failure."""

    def __init__(self, config: uvicorn.Config, the: Service, opened: Callable[[], None] | None) -> None:
        super().__init__(config)
        self._the, self._opened = the, opened

    async def startup(self, sockets: Any = None) -> None:
        await super().startup(sockets)
        if self.started and self._opened is not None:
            self._opened()

    async def shutdown(self, sockets: Any = None) -> None:
        """Stop the service while connections are still open, then these."""
        for server in self.servers:
            server.close()
        await self._the.stop()
        await super().shutdown(sockets)
        if self.force_exit:
            # uvicorn then leaves the application waiting, which ends in a traceback; everything has stopped already.
            await self.lifespan.shutdown()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """As uvicorn's, without sending the signals again afterwards."""
        with handled_signals(self.handle_exit):
            yield


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens.

    Args:
        port: 0 takes any that is free.

    Raises:
        InputError: it cannot be had.
    """
    with system_errors(f"listen on {host} port {port}", "choose another with --host or --port", InputError):
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        bound = socket.socket(found[0], socket.SOCK_STREAM)
        # A port that was left a moment ago may be had at once. Windows shares one with who asks so, unless told not to.
        bound.setsockopt(socket.SOL_SOCKET, getattr(socket, "SO_EXCLUSIVEADDRUSE", socket.SO_REUSEADDR), 1)
        bound.bind(found[4])
    return bound


def make_server(app: FastAPI, *, opened: Callable[[], None] | None = None) -> Server:
    """A server; ``run([listen(…)])`` serves until it is told to stop.

    Args:
        opened: called when it accepts connections.
    """
    the: Service = app.state.service
    limits = the.limits
    config = uvicorn.Config(
        app,
        http=_patient(limits),
        ws=_Reading,
        ws_max_size=_FRAMES * limits.message,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=round(limits.stopping),
        log_level="error",
        access_log=False,
        server_header=False,
        proxy_headers=False,
    )
    return Server(config, the, opened)


class _Reading(WebSocketsSansIOProtocol):
    """Reads no more from a client that does not read: answers to its pings would pile up. Refuses without a log."""

    async def send(self, message: Any) -> None:
        await super().send(message)
        if message["type"] == "websocket.http.response.body":
            # Refused and answered, which is a whole handshake; uvicorn would log that there was none.
            self.handshake_complete = True

    def pause_writing(self) -> None:
        super().pause_writing()
        self.transport.pause_reading()

    def resume_writing(self) -> None:
        super().resume_writing()
        if not self.read_paused:
            self.transport.resume_reading()

    def keepalive_timeout(self) -> None:
        super().keepalive_timeout()
        self._let_go()

    def on_task_complete(self, task: asyncio.Task[None]) -> None:
        super().on_task_complete(task)
        self._let_go()

    def _let_go(self) -> None:
        """Closing waits until everything was sent, which is never for a client that does not read."""
        self.loop.call_later(_FLUSH, self.transport.abort)


def _patient(limits: Limits) -> type[H11Protocol]:
    """HTTP for a limited number of connections, on which a request, once begun, must come before patience ends."""

    class Patient(H11Protocol):
        _timer: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            if len(self.connections) >= limits.sockets:
                transport.abort()
                return
            super().connection_made(transport)
            self._wait()

        def connection_lost(self, exc: Exception | None) -> None:
            if self._timer is not None:
                self._timer.cancel()
                super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            assert self._timer is not None
            if not self._waits():
                self._timer.cancel()
            elif self._timer.cancelled():
                # A piece of the next request. It ended uvicorn's wait for that; further pieces shall not prolong ours.
                self._wait()

        def _wait(self) -> None:
            self._timer = self.loop.call_later(limits.patience, self.transport.abort)

        def _waits(self) -> bool:
            """Whether neither a WebSocket took the connection over nor a request waits for its answer."""
            return self.transport.get_protocol() is self and (self.cycle is None or self.cycle.response_complete)

    return Patient
