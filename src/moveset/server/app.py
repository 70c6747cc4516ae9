"""The application: every route, behind one guard, and every error as JSON."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import Match, Mount

from moveset import __version__
from moveset.errors import MovesetError
from moveset.server import page, rest, socket
from moveset.server.failures import RequestError, told
from moveset.server.guard import Guard
from moveset.server.protocol import NO_JSON, sentence
from moveset.server.service import Options, Service


def create_app(options: Options) -> FastAPI:
    """A server's application; its ``state.service`` is what ``run`` stops.

    Raises:
        InputError: no such model or device.
        FormatError: a damaged model.
    """
    the = Service(options)

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        the.start()
        yield
        await the.stop()

    app = FastAPI(
        title="moveset",
        version=__version__,
        description="Text to human motion: clips by HTTP, endless streams by WebSocket.",
        docs_url=None,
        redoc_url=None,
        lifespan=life,
    )
    app.state.service = the
    app.include_router(rest.router)
    app.include_router(socket.router)
    page.add_page(app)
    for kind in (RequestError, MovesetError, RequestValidationError, HTTPException):
        app.add_exception_handler(kind, _refused)
    app.add_exception_handler(Exception, _failed)
    app.add_middleware(
        Guard,
        limits=the.limits,
        hosts=the.options.hosts,
        origins=the.options.origins,
        metrics=the.metrics,
    )
    return app


async def _refused(request: Request, error: Exception) -> JSONResponse:
    found = _as_request_error(request, error)
    request.app.state.service.metrics.refused.labels(found.code).inc()
    headers = {"Allow": _methods(request)} if found.status == 405 else {}
    return JSONResponse(found.body(), found.status, headers | found.headers())


def _methods(request: Request) -> str:
    """Methods that this address takes, in whichever of its routes: the framework names those of one."""
    routes = [route for route in request.app.routes if not isinstance(route, Mount)]
    found = [
        method
        for method in ("GET", "POST", "DELETE")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)
    ] or ["GET"]  # the page's files
    return ", ".join(found + ["HEAD"] * ("GET" in found))


def _as_request_error(request: Request, error: Exception) -> RequestError:
    if isinstance(error, RequestError):
        return error
    if isinstance(error, MovesetError):
        return told(error)
    if isinstance(error, RequestValidationError):
        return RequestError(422, "invalid", sentence(list(error.errors())))
    assert isinstance(error, HTTPException)
    if error.status_code == 404:
        return RequestError(404, "not_found", "there is nothing at this address; /docs lists what there is")
    if error.status_code == 405:
        message = f"{request.url.path!r} does not take {request.method}; use {_methods(request)}"
        return RequestError(405, "wrong_method", message)
    if error.status_code == 400:
        # The framework's word for a body that breaks its reader: no UTF-8, or lists in lists in lists.
        return RequestError(422, "invalid", NO_JSON)
    return RequestError(error.status_code, "invalid", str(error.detail))


async def _failed(request: Request, error: Exception) -> JSONResponse:
    """A fault of ours: its kind, but nothing of where. The log has the traceback."""
    return JSONResponse(RequestError(500, "internal", f"{type(error).__name__} in the server; see its log").body(), 500)
