"""The server: routes, middleware, error handlers and static files. It computes nothing itself."""

from __future__ import annotations

import asyncio
import traceback
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware

from turnwright import __version__
from turnwright.errors import TurnwrightError, shorten_message
from turnwright.web import files, measurements, planning, runs, views, windows
from turnwright.web.data_folders import shipped_folder
from turnwright.web.files import tidy
from turnwright.web.guard import Guard, require_token
from turnwright.web.limits import PARSE_BYTES, PARSE_S
from turnwright.web.models import Problem
from turnwright.web.queue import Runs
from turnwright.web.workers import Busy, Superseded, planners

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Mapping
    from os import PathLike

    from turnwright.web.workers import Workers

__all__ = ["create_app"]

STATIC = Path(__file__).resolve().parent / "static"

REFUSED: dict[int | str, dict[str, Any]] = {
    status: {"model": Problem, "description": text}
    for status, text in {
        400: "the request cannot be read",
        401: "the token is missing or wrong",
        403: "the request comes from a page of another origin",
        404: "the resource does not exist",
        409: "the state of the resource does not allow this, or a later request replaced it",
        410: "the files were deleted outside the workbench",
        413: "the request is too large",
        421: "the host name is not that of this server",
        422: "the request is invalid",
        500: "a defect of Turnwright",
        503: "too many requests are waiting",
    }.items()
}

UNPROCESSABLE = 422

NICE = 10
"""Niceness of runs, so that the page gets about nine tenths of a shared processor."""


def create_app(
    folder: str | PathLike[str],
    *,
    token: str | None = None,
    origin: str | None = None,
    at_a_time: int = 1,
    nice: int = NICE,
    parse_s: float = PARSE_S,
    parse_bytes: int = PARSE_BYTES,
    workers: Workers | None = None,
) -> FastAPI:
    """Return the ASGI application of the workbench.

    Parameters
    ----------
    folder
        Folder of runs and measurements; created if missing.
    token
        Access token of at least 16 characters; needed if other computers can reach the server.
    origin
        Public address of the page behind a reverse proxy, such as "https://lathe.example".
    at_a_time
        Number of parallel runs; the others wait.
    nice
        Niceness of runs, 0 to 19.
    parse_s, parse_bytes
        Time limit, and memory limit beyond the start, for reading a measured file. [s, byte]
    workers
        Worker processes, if already started; they end with the server.

    Raises
    ------
    InputError
        If the token is too short.
    """
    require_token(token)
    folder = Path(folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    workers = workers or planners()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        app.state.runs.start()
        try:
            yield
        finally:
            await app.state.runs.close()
            await asyncio.to_thread(workers.close)
            await asyncio.to_thread(windows.close, app)

    app = FastAPI(
        title="Turnwright workbench",
        version=__version__,
        lifespan=lifespan,
        docs_url=None,  # its page loads scripts from another host
        redoc_url=None,
        openapi_url="/api/openapi.json",
        separate_input_output_schemas=False,
        responses=REFUSED,
        middleware=[Middleware(Guard, token=token, origin=origin)],
        exception_handlers={
            HTTPException: _answer_http_error,
            RequestValidationError: _answer_invalid,
            TurnwrightError: _answer_refusal,
            FileNotFoundError: _answer_missing_file,
            Exception: _answer_defect,
        },
    )
    app.state.folder, app.state.workers, app.state.at_a_time = folder, workers, at_a_time
    app.state.runs = Runs(folder, at_a_time=at_a_time, nice=nice, parse_s=parse_s, parse_bytes=parse_bytes)
    tidy(folder)
    for routes in (planning, files, views, runs, windows, measurements):
        app.include_router(routes.router)
    if (drawings := shipped_folder("drawings", "docs/images/drawings")) is not None:
        app.mount("/drawings", StaticFiles(directory=drawings), name="drawings")
    app.mount("/", StaticFiles(directory=STATIC, html=True), name="page")
    return app


def _problem(status: int, sentence: str, headers: Mapping[str, str] | None = None) -> Response:
    return JSONResponse({"detail": shorten_message(sentence)}, status, headers=headers)


async def _answer_http_error(_request: Request, error: Exception) -> Response:
    """Answer an HTTP error of the framework."""
    if not isinstance(error, HTTPException):
        raise error
    plain = {
        400: "the request is not valid JSON",
        404: "not found: see /api/openapi.json",
        405: "method not allowed: see /api/openapi.json",
    }
    words = {"Not Found", "Method Not Allowed", "There was an error parsing the body"}
    sentence = plain.get(error.status_code, error.detail) if error.detail in words else error.detail
    return _problem(error.status_code, sentence, error.headers)


async def _answer_invalid(_request: Request, error: Exception) -> Response:
    """Answer a request that fails validation, without echoing it."""
    if not isinstance(error, RequestValidationError):
        raise error
    problems = []
    for one in error.errors()[:5]:
        place = ".".join(str(step) for step in one["loc"][1:])
        problems.append(f"{place[:60] or 'the request'}: {one['msg']}")
    return _problem(UNPROCESSABLE, "; ".join(problems))


async def _answer_refusal(_request: Request, error: Exception) -> Response:
    """Answer an error that Turnwright raises."""
    status = 409 if isinstance(error, Superseded) else 503 if isinstance(error, Busy) else UNPROCESSABLE
    return _problem(status, str(error))


async def _answer_missing_file(request: Request, error: Exception) -> Response:
    """Answer a request for a deleted file of a run."""
    file = Path(getattr(error, "filename", None) or "")
    if request.app.state.folder not in file.parents:
        raise error
    return _problem(410, f"{file.name} of this run was deleted outside the workbench: run the job again")


async def _answer_defect(request: Request, error: Exception) -> Response:
    """Write the traceback of a defect to a log file and answer with its name."""
    log = request.app.state.folder / "defects.log"
    with suppress(OSError), log.open("a", encoding="utf-8") as file:
        file.write(f"{request.method} {request.url.path!r}\n")
        traceback.print_exception(error, file=file)
    return _problem(500, f"this is a defect of Turnwright ({type(error).__name__}), its traceback is in {log.name}")
