"""The server: routes, what stands before them, and the page's own files. It computes nothing itself."""

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
from turnwright.errors import TurnwrightError, shortened
from turnwright.web import files, measurements, planning, runs, views, windows
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
        404: "there is no such thing",
        409: "the state of what is asked for does not allow it, or a later question took its place",
        410: "its files were deleted outside the workbench",
        413: "the request is too large",
        421: "the request names another host",
        422: "what is asked for is wrong",
        500: "a defect of Turnwright",
        503: "more questions wait than the server takes",
    }.items()
}

UNPROCESSABLE = 422

NICE = 10
"""A page that waits gets nine tenths of a processor that a run wants too."""


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
    """Return the server of the workbench, to be run by any ASGI server.

    Parameters
    ----------
    folder
        Where runs and measurements are kept; it is made if there is none.
    token
        What whoever asks must know, 16 characters or more; needed where others reach the server.
    origin
        The address of the page, such as "https://lathe.example", where a proxy stands before the server.
    at_a_time
        How many runs are carried out at a time; the others wait.
    nice
        How far runs stand back behind everything else on this computer, 0 to 19.
    parse_s, parse_bytes
        How long reading a measured file may take, and how much memory beyond what its process starts with. [s, byte]
    workers
        Who plans, if they were started before; they end with the server.

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
        docs_url=None,  # its page would load scripts of another host
        redoc_url=None,
        openapi_url="/api/openapi.json",
        separate_input_output_schemas=False,
        responses=REFUSED,
        middleware=[Middleware(Guard, token=token, origin=origin)],
        exception_handlers={
            HTTPException: _say_http,
            RequestValidationError: _say_invalid,
            TurnwrightError: _say_refused,
            FileNotFoundError: _say_gone,
            Exception: _say_defect,
        },
    )
    app.state.folder, app.state.workers, app.state.at_a_time = folder, workers, at_a_time
    app.state.runs = Runs(folder, at_a_time=at_a_time, nice=nice, parse_s=parse_s, parse_bytes=parse_bytes)
    tidy(folder)
    for routes in (planning, files, views, runs, windows, measurements):
        app.include_router(routes.router)
    app.mount("/", StaticFiles(directory=STATIC, html=True), name="page")
    return app


def _problem(status: int, sentence: str, headers: Mapping[str, str] | None = None) -> Response:
    return JSONResponse({"detail": shortened(sentence)}, status, headers=headers)


async def _say_http(_request: Request, error: Exception) -> Response:
    """Say what the framework refuses."""
    if not isinstance(error, HTTPException):
        raise error
    plain = {
        400: "the request is not JSON that can be read: correct it",
        404: "there is nothing of that name: ask for /api/openapi.json to see what there is",
        405: "that cannot be done with this address: ask for /api/openapi.json to see what can",
    }
    words = {"Not Found", "Method Not Allowed", "There was an error parsing the body"}
    sentence = plain.get(error.status_code, error.detail) if error.detail in words else error.detail
    return _problem(error.status_code, sentence, error.headers)


async def _say_invalid(_request: Request, error: Exception) -> Response:
    """Say what in a request is not of its kind, without showing it again."""
    if not isinstance(error, RequestValidationError):
        raise error
    told = []
    for one in error.errors()[:5]:
        place = ".".join(str(step) for step in one["loc"][1:])
        told.append(f"{place[:60] or 'the request'}: {one['msg']}")
    return _problem(UNPROCESSABLE, "; ".join(told))


async def _say_refused(_request: Request, error: Exception) -> Response:
    """Say what Turnwright raises on purpose."""
    status = 409 if isinstance(error, Superseded) else 503 if isinstance(error, Busy) else UNPROCESSABLE
    return _problem(status, str(error))


async def _say_gone(request: Request, error: Exception) -> Response:
    """Name a file of a run that is no longer there."""
    file = Path(getattr(error, "filename", None) or "")
    if request.app.state.folder not in file.parents:
        raise error
    return _problem(410, f"{file.name} of this run was deleted outside the workbench: run it again")


async def _say_defect(request: Request, error: Exception) -> Response:
    """Keep the traceback of a defect where its finder may look, and say so without showing it."""
    log = request.app.state.folder / "defects.log"
    with suppress(OSError), log.open("a", encoding="utf-8") as file:
        file.write(f"{request.method} {request.url.path!r}\n")
        traceback.print_exception(error, file=file)
    return _problem(500, f"this is a defect of Turnwright ({type(error).__name__}), its traceback is in {log.name}")
