"""What stands before every route: who may ask, how much may be sent, and what browsers are told of the page."""

import asyncio
import re
from collections.abc import Mapping, Sequence
from urllib.parse import urlsplit

from fastapi.responses import JSONResponse, Response
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from moveset.server.failures import RequestError, busy
from moveset.server.limits import Limits
from moveset.server.metrics import Metrics

_HOST = re.compile(r"(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+)(?::(\d{1,5}))?")
_SAFE = ("GET", "OPTIONS")
MEDIA_TYPE = "application/octet-stream"
_TYPES = {"/v1/generate": "application/json", "/v1/jobs": "application/json", "/v1/export": MEDIA_TYPE}
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}
_READABLE = "Content-Disposition, Retry-After, X-Moveset-Seed, X-Moveset-Warnings"  # by scripts of other sites
_PREFLIGHT = {
    "Access-Control-Allow-Methods": "GET, POST, DELETE",
    "Access-Control-Allow-Headers": "Content-Type",
    "Access-Control-Max-Age": "600",
}


class Guard:
    """Middleware.

    - Host: where the server listens on this machine alone, only its own names are answered, so that a page that makes
      its name point here (DNS rebinding) gets nothing.
    - Origin: other sites' pages may neither change anything nor open a WebSocket, nor read an answer; those that may
      are told so in CORS's words.
    - Size and type of what is sent.
    - HEAD is GET without the body, everywhere.

    Args:
        hosts: names without port; None allows any.
        origins: other sites that may.
    """

    def __init__(
        self, app: ASGIApp, limits: Limits, hosts: Sequence[str] | None, origins: Sequence[str], metrics: Metrics
    ) -> None:
        self._app, self._limits, self._metrics = app, limits, metrics
        self._hosts, self._origins = hosts, origins
        self._uploads = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        if scope["type"] == "http" and scope["method"] == "HEAD":
            # What asks whether the server runs often asks so. uvicorn, which has its own scope, sends no body.
            scope = {**scope, "method": "GET"}
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        answer = self._answering(scope, headers, send)
        try:
            self._check(scope, headers, host)
            if self._asks(scope, headers):
                await Response(status_code=204, headers=_PREFLIGHT)(scope, receive, answer)
                return
            if scope["type"] == "http" and scope["method"] not in _SAFE:
                receive = _again(await self._read(scope, headers, receive), receive)
            await self._app(scope, receive, answer)
        except RequestError as error:
            self._metrics.refused.labels(error.code).inc()
            # A WebSocket that is refused before it is accepted is answered as HTTP, too.
            await JSONResponse(error.body(), error.status, error.headers())(scope, receive, answer)

    def _check(self, scope: Scope, headers: Headers, host: str) -> None:
        match = _HOST.fullmatch(host)
        if match is None or (self._hosts is not None and match[1].lower() not in self._hosts):
            raise RequestError(403, "foreign_host", "this server is not known by that name; use 127.0.0.1")
        origin = headers.get("origin")
        changes = scope["type"] == "websocket" or scope["method"] not in _SAFE
        if changes and origin is not None and not self._own(origin, host):
            raise RequestError(
                403, "foreign_origin", "pages of other sites may not use this server; start it with --allow-origin"
            )
        if scope["type"] == "http" and scope["method"] == "POST" and scope["path"] in _TYPES:
            wanted = _TYPES[scope["path"]]
            if headers.get("content-type", "").partition(";")[0].strip().lower() != wanted:
                raise RequestError(415, "wrong_type", f"send this with the content type {wanted}")

    def _asks(self, scope: Scope, headers: Headers) -> bool:
        """Whether a browser asks what a page of another site, which may, may send."""
        preflight = scope["type"] == "http" and scope["method"] == "OPTIONS"
        return preflight and "access-control-request-method" in headers and headers.get("origin") in self._origins

    def _own(self, origin: str, host: str) -> bool:
        try:
            site = urlsplit(origin).netloc
        except ValueError:
            return False
        return site.lower() == host.lower() or origin in self._origins

    async def _read(self, scope: Scope, headers: Headers, receive: Receive) -> bytes:
        """All that was sent, if that is not too much and comes without long pauses and not by drops."""
        large = scope["path"] == "/v1/export"
        limit = self._limits.export if large else self._limits.body
        error = RequestError(413, "too_large", f"what was sent is larger than the limit of {limit:,} bytes; send less")
        length = headers.get("content-length", "")
        if length.isdecimal() and int(length[:20]) > limit:
            raise error
        if large and self._uploads >= self._limits.exports:
            raise busy("files", self._limits.exports)
        self._uploads += large
        clock = asyncio.get_running_loop().time
        begun = clock()
        try:
            body = bytearray()
            while True:
                # Each byte earns a little time, never a whole new pause: a few that drip would keep all others out.
                last = min(clock(), begun + len(body) / self._limits.pace) + self._limits.patience
                try:
                    async with asyncio.timeout_at(last):
                        message = await receive()
                except TimeoutError:
                    raise RequestError(
                        408, "too_slow", "the rest of the request did not come in time; send it at once"
                    ) from None
                body += message.get("body", b"")
                if len(body) > limit:
                    raise error
                if not message.get("more_body", False):
                    return bytes(body)
        finally:
            self._uploads -= large

    def _answering(self, scope: Scope, headers: Headers, send: Send) -> Send:
        host, origin = headers.get("host", ""), headers.get("origin")
        known = host if _HOST.fullmatch(host) else ""

        async def answer(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                own = MutableHeaders(scope=message)
                for name, value in _with_policy(known).items():
                    own.setdefault(name, value)
                if self._origins:
                    own.add_vary_header("Origin")
                if origin is not None and origin in self._origins:
                    own["Access-Control-Allow-Origin"] = origin
                    own["Access-Control-Expose-Headers"] = _READABLE
                if scope["path"].startswith("/v1") or scope["path"] in ("/healthz", "/metrics"):
                    own.setdefault("Cache-Control", "no-store")
                if scope["type"] == "http":
                    self._metrics.requests.labels(str(message["status"])).inc()
            await send(message)

        return answer


def _again(body: bytes, receive: Receive) -> Receive:
    """Receives what was read already, then what comes after it."""
    told = False

    async def replay() -> Message:
        nonlocal told
        if told:
            return await receive()
        told = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replay


def _with_policy(host: str) -> Mapping[str, str]:
    # Some browsers do not count WebSockets of the same host as 'self'.
    sockets = f" ws://{host} wss://{host}" if host else ""
    policy = (
        "default-src 'self'; img-src 'self' data: blob:; media-src 'self' blob:; "
        f"connect-src 'self'{sockets}; style-src 'self'; script-src 'self'; object-src 'none'; base-uri 'none'; "
        "form-action 'self'; frame-ancestors 'none'"
    )
    return {"Content-Security-Policy": policy, **_HEADERS}
