"""The routes of clips and files, under ``/v1``."""

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import JSONResponse

from moveset.pipelines.postprocess import Postprocess
from moveset.server.failures import RequestError
from moveset.server.files import FILES, SEED, WARNINGS
from moveset.server.guard import MEDIA_TYPE
from moveset.server.jobs import Answer, Job
from moveset.server.protocol import GenerateBody, Name, plain
from moveset.server.service import Service

_LOOK = 0.5  # seconds between two looks at whether a client is still there

_ERROR = {
    "content": {
        "application/json": {
            "schema": {
                "type": "object",
                "properties": {
                    "error": {
                        "type": "object",
                        "properties": {"code": {"type": "string"}, "message": {"type": "string"}},
                        "required": ["code", "message"],
                    }
                },
                "required": ["error"],
            }
        }
    }
}
_SAID = {
    400: "A number or a word that does not go.",
    403: "Another site's page.",
    404: "There is none of that name.",
    408: "The rest of the request did not come in time.",
    409: "Not in this state.",
    413: "Too large.",
    415: "Another content type.",
    422: "Not of this form.",
    500: "A fault of the server; its log tells more.",
    503: "Busy or stopping; see Retry-After.",
}


_FILE: dict[str, Any] = {kind: {"schema": {"type": "string", "format": "binary"}} for kind in FILES}
# Of a clip: JSON, or a file whose seed and warnings stand in the headers.
_CLIP: dict[str, Any] = {
    "content": _FILE,
    "headers": {
        SEED: {"description": "Of a file: the seed it was made from.", "schema": {"type": "integer"}},
        WARNINGS: {
            "description": "Of a file: a JSON list of warnings about the prompts, in ASCII, of 4,096 bytes at most.",
            "schema": {"type": "string"},
        },
    },
}


def errors(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """For the description: what an error answer looks like."""
    return {status: {"description": _SAID[status], **_ERROR} for status in sorted((400, 403, 500, *statuses))}


def service(request: Request) -> Service:
    """The server's state."""
    return request.app.state.service


The = Annotated[Service, Depends(service)]
router = APIRouter(prefix="/v1", tags=["clips"])


@router.get("/models", summary="What there is to choose from", responses=errors())
async def models(the: The) -> JSONResponse:
    """Models, defaults, limits, formats and the skeleton that frames move."""
    return JSONResponse(the.models())


@router.get("/prompts", summary="Sentences that a model knows", responses=errors(404, 422))
async def prompts(the: The, model: Annotated[Name | None, Query()] = None) -> JSONResponse:
    """A short list of sentences to begin with, as suggestions."""
    return JSONResponse({"prompts": await asyncio.to_thread(the.catalog.suggestions, model)})


@router.post(
    "/generate",
    summary="Make a clip and wait for it",
    responses={**errors(404, 408, 409, 413, 415, 422, 503), 200: _CLIP},
)
async def generate(the: The, request: Request, body: GenerateBody) -> Response:
    """JSON with packets of frames, or one file, by ``format``. Who hangs up gives the clip up."""
    job = the.submit(the.order(body))
    while not job.done.is_set():
        try:
            async with asyncio.timeout(_LOOK):
                await job.done.wait()
        except TimeoutError:
            if await request.is_disconnected():
                the.cancel(job)
    return _result(job)


@router.post("/jobs", status_code=202, summary="Make a clip later", responses=errors(404, 408, 413, 415, 422, 503))
async def submit(the: The, body: GenerateBody) -> JSONResponse:
    """The same request as for ``/v1/generate``; answers at once."""
    return JSONResponse(the.book.describe(the.submit(the.order(body))), 202)


@router.get("/jobs/{number}", summary="How far a clip has got", responses=errors(404, 422))
async def look(the: The, number: Name) -> JSONResponse:
    """State (queued, running, done, failed, cancelled), place in the line, and progress from 0 to 1."""
    return JSONResponse(the.book.describe(the.book.find(number)))


@router.get(
    "/jobs/{number}/result",
    summary="What became of it",
    responses={**errors(404, 409, 422, 503), 200: _CLIP},
)
async def result(the: The, number: Name) -> Response:
    """What ``/v1/generate`` would have answered."""
    return _result(the.book.find(number))


@router.delete("/jobs/{number}", summary="Give a clip up", responses=errors(404, 408, 413, 422))
async def cancel(the: The, number: Name) -> JSONResponse:
    """One in work ends after the clip that is being made, or the file that is being written."""
    job = the.book.find(number)
    the.cancel(job)
    return JSONResponse(the.book.describe(job))


@router.post(
    "/export",
    tags=["files"],
    summary="Frames to a file",
    response_class=Response,  # else the description says that it may be JSON
    responses={**errors(408, 413, 415, 422, 503), 200: {"content": _FILE}},
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def export(
    the: The,
    request: Request,
    format: Annotated[str, Query(max_length=16)],
    skeleton: Annotated[Name | None, Query()] = None,
    fps: Annotated[float | None, Query(ge=1.0, le=240.0, allow_inf_nan=False)] = None,
    in_place: bool = False,
    loop: bool = False,
    title: Annotated[str, Query(max_length=512)] = "",
) -> Response:
    """Packets of frames, as the server sends them, to BVH, GLB, npz or a picture."""
    finish = Postprocess(fps=fps, skeleton=skeleton, in_place=in_place, loop=loop)
    try:
        said = plain(title) if title.strip() else ""
    except ValueError as error:
        raise RequestError(400, "invalid", str(error)) from None
    return _file(await the.export(await request.body(), format, finish, said))


def _result(job: Job) -> Response:
    if job.error is not None:
        raise job.error
    if job.answer is None:
        raise RequestError(409, "not_done", f"this job is {job.state}; ask again when it is done", 1)
    return _file(job.answer)


def _file(answer: Answer) -> Response:
    headers = {} if answer.filename is None else {"Content-Disposition": f'attachment; filename="{answer.filename}"'}
    return Response(answer.content, media_type=answer.media_type, headers={**headers, **answer.headers})
