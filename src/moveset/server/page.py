"""The studio page and its files, health, numbers, and the description of the interface; nothing from elsewhere."""

from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.staticfiles import StaticFiles

from moveset.server.reference import reference_page
from moveset.server.rest import The

STUDIO = Path(__file__).parents[1] / "viewer" / "studio"
_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_CSS = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }
:root { color-scheme: light dark }
h2 { margin-top: 2.5rem } h3 { font-size: 1rem; margin-bottom: 0 } p { margin-top: .3rem }
code, pre { font: 14px/1.45 ui-monospace, monospace; overflow-wrap: anywhere } pre { overflow-x: auto }
table { border-collapse: collapse; width: 100% }
td { text-align: left; vertical-align: top; padding: .2rem .6rem .2rem 0 }
"""
_NO_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>moveset</title>
<meta name="viewport" content="width=device-width"><link rel="stylesheet" href="/docs.css"></head><body>
<h1>moveset</h1><p>The server runs, but its page was not built into this installation: run <code>make viewer</code>.</p>
<p><a href="/docs">What the server understands</a></p></body></html>"""

router = APIRouter(include_in_schema=False)


@router.get("/")
async def page() -> Response:
    """The studio."""
    index = STUDIO / "index.html"
    if not index.is_file():
        return HTMLResponse(_NO_PAGE)
    return FileResponse(index, headers={"Cache-Control": "no-cache"}, media_type="text/html")


@router.get("/healthz")
async def health(the: The) -> JSONResponse:
    """Whether the server runs."""
    found = the.health()
    return JSONResponse(found, 200 if found["status"] == "ok" else 503)


@router.get("/metrics")
async def metrics(the: The) -> Response:
    """Numbers for Prometheus."""
    return Response(the.metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")


@router.get("/docs")
async def docs(request: Request) -> HTMLResponse:
    """The description of the interface, for people."""
    return HTMLResponse(reference_page(request.app.openapi()))


@router.get("/docs.css")
async def style() -> PlainTextResponse:
    """How it looks."""
    return PlainTextResponse(_CSS, media_type="text/css")


@router.get("/favicon.ico")
async def icon() -> Response:
    """The page's picture, if it has one."""
    found = STUDIO / "favicon.svg"
    return FileResponse(found, media_type="image/svg+xml") if found.is_file() else Response(status_code=204)


class _Assets(StaticFiles):
    """Files of the page, of the same types everywhere: Windows may take .js for text/plain, which no browser runs."""

    def file_response(self, full_path: Any, *rest: Any, **more: Any) -> Response:
        found = super().file_response(full_path, *rest, **more)
        if isinstance(found, FileResponse) and (known := _TYPES.get(Path(full_path).suffix)):
            found.headers["Content-Type"] = known
        return found


def add_page(app: FastAPI) -> None:
    app.include_router(router)
    assets = STUDIO / "assets"
    if assets.is_dir():
        app.mount("/assets", _Assets(directory=assets), "assets")
