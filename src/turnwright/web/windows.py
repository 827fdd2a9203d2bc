"""Routes for the results of a run: map windows, profiles, axis motion and spectra."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.exceptions import HTTPException
from pydantic import Field

from turnwright.progress import cores
from turnwright.web import budget, results
from turnwright.web.limits import STORED_PIXEL_RATIO
from turnwright.web.models import Coordinate, Model, RunId
from turnwright.web.views import PACKED, PackedResponse, path_worker
from turnwright.web.workers import Workers

__all__ = ["close", "router"]

MAX_PIXELS = 2048
"""Largest number of pixels along a side of a map."""

ANSWER_LIMIT_S = 600.0
"""Time limit for a window, including reading the program of a large part. [s]"""

DEFAULT_PIXELS = 700
"""Default number of pixels along a side of a polar map."""


class Map(Model):
    """A map that a run has stored."""

    name: str
    unit: str = Field(description="Unit of the heights and of windows.")
    shape: list[int]
    x: tuple[float, float] | None = Field(description="First and last column. [mm]")
    y: tuple[float, float] | None = Field(description="First and last row. [mm]")
    radius: tuple[float, float] | None = Field(description="Of a polar map, first and last column. [mm]")
    angle: tuple[float, float] | None = Field(description="Of a polar map, first and last row. [rad]")
    pixel: float | None = Field(description="Column spacing. [mm]")
    pv_nm: float | None
    sq_nm: float | None
    tracking: bool = Field(description="Whether the servo contribution is included.")


class Budget(Model):
    """Error budget of a finishing pass: simulated peak-to-valley contributions to the form error. [nm]."""

    cusp_nm: float | None = Field(description="Error of an exact path.")
    cusp_away_nm: float | None = Field(description="The same at two feeds or more from the axis.")
    chord_nm: float | None = Field(description="Largest change by the interpolation between points.")
    rounding_nm: float | None = Field(description="Largest change by rounding in the program.")
    tracking_nm: float | None = Field(description="Largest change by the servo response.")
    pv_nm: float | None = Field(description="Peak to valley of the total error.")
    rms_nm: float | None = Field(description="Root mean square of the total error.")
    sq_nm: float | None = Field(description="Finish: largest Sq of an annulus a few feeds wide.")
    servos: bool = Field(description="Whether the machine states the response of any axis.")


router = APIRouter(prefix="/api/runs", tags=["maps"])

Client = Annotated[str, Query(max_length=64)]
Pixels = Annotated[int, Query(ge=2, le=MAX_PIXELS)]
NOT_FOUND: dict[int | str, dict[str, Any]] = {**PACKED, 404: {**PACKED[422], "description": "The run does not exist."}}
JSON_ERRORS = {code: answer for code, answer in NOT_FOUND.items() if code != 200}


def _out(request: Request, run: str) -> str:
    """Return the result folder of a run."""
    out = File(request.app.state.folder) / "runs" / run / "out"
    if not out.is_dir():
        raise HTTPException(404, f"run {run} does not exist or has no results")
    return str(out)


def _motion_worker(request: Request) -> Workers:
    """Return the worker process that caches motions."""
    state = request.app.state
    if getattr(state, "window_worker", None) is None:
        state.window_worker = Workers(1, threads=cores(), warm=results.warm)
    workers: Workers = state.window_worker
    return workers


def close(app: Any) -> None:
    """End the worker processes that are not among the `Workers` of the app."""
    for name in ("window_worker", "path_worker"):
        if getattr(app.state, name, None) is not None:
            getattr(app.state, name).close()


async def _compute(
    request: Request, function: Callable[..., Any], *arguments: Any, latest: str = "", keep: bool = True
) -> Any:
    return await _motion_worker(request).ask(function, *arguments, latest=latest, keep=keep, limit_s=ANSWER_LIMIT_S)


@router.get("/{id}/maps", responses=JSON_ERRORS)
async def run_maps(request: Request, id: RunId) -> list[Map]:  # noqa: A002 - the name in the API
    """List the stored maps of a run."""
    _motion_worker(request)  # start it early: a finer window usually follows
    return [Map(**one) for one in await request.app.state.workers.ask(results.list_maps, _out(request, id), keep=True)]


@router.get("/{id}/map", response_class=Response, responses=NOT_FOUND)
async def run_map(
    request: Request,
    id: RunId,  # noqa: A002
    name: Annotated[str, Query(max_length=200)] = "whole part",
    x0: Coordinate | None = None,
    x1: Coordinate | None = None,
    y0: Coordinate | None = None,
    y1: Coordinate | None = None,
    nx: Pixels | None = None,
    ny: Pixels | None = None,
    quantity: Literal["error", "height"] = "error",
    client: Client = "",
) -> Response:
    """Return a window of a map, by default all of it; a window finer than the stored map is simulated."""
    out = _out(request, id)
    maps = await request.app.state.workers.ask(results.list_maps, out, keep=True)
    entry = next((each for each in maps if each["name"] == name), None)
    if entry is None:
        raise HTTPException(404, f"map must be one of {', '.join(each['name'] for each in maps)}")
    rim = entry["radius"][1] if entry["radius"] else 0.0
    extent = (entry["x"] or [-rim, rim]), (entry["y"] or [-rim, rim])
    x = (extent[0][0] if x0 is None else x0, extent[0][1] if x1 is None else x1)
    y = (extent[1][0] if y0 is None else y0, extent[1][1] if y1 is None else y1)
    for axis, (low, high) in (("x", x), ("y", y)):
        if not high - low > 1e-9:
            raise HTTPException(
                422, f"a window must be wider than 1e-9 mm, got {axis}0 = {low:g} mm and {axis}1 = {high:g} mm"
            )
    shape = entry["shape"] if entry["x"] else [DEFAULT_PIXELS] * 2
    ny, nx = ny or min(shape[0], MAX_PIXELS), nx or min(shape[1], MAX_PIXELS)
    step = min((x[1] - x[0]) / (nx - 1), (y[1] - y[0]) / (ny - 1))
    # Stored maps need no motion, so any worker can answer without reading the program.
    within = x[0] >= extent[0][0] and x[1] <= extent[0][1] and y[0] >= extent[1][0] and y[1] <= extent[1][1]
    stored = step >= STORED_PIXEL_RATIO * (entry["pixel"] or math.inf) and (within or not entry["x"])
    arguments = (out, name, list(x), list(y), [ny, nx], quantity)
    if stored:
        packed = await request.app.state.workers.ask(results.window, *arguments, keep=True)
    else:
        packed = await _compute(request, results.window, *arguments, latest=f"window {client}" if client else "")
    return PackedResponse(packed)


@router.get("/{id}/chips", response_class=Response, responses=NOT_FOUND)
async def run_chips(
    request: Request,
    id: RunId,  # noqa: A002
    pixels: Annotated[int, Query(ge=16, le=768)] = 288,
) -> Response:
    """Return the maximum uncut chip thickness of the finishing pass over the part [mm]."""
    packed = await request.app.state.workers.ask(results.chips, _out(request, id), pixels, keep=True)
    return PackedResponse(packed)


@router.get("/{id}/budget", responses=JSON_ERRORS)
async def run_budget(request: Request, id: RunId) -> Budget:  # noqa: A002
    """Return the error budget of a run; it takes about as long as planning its path."""
    return Budget(**await path_worker(request).ask(budget.budget, _out(request, id), keep=True, limit_s=ANSWER_LIMIT_S))


@router.get("/{id}/profile", response_class=Response, responses=NOT_FOUND)
async def run_profile(
    request: Request,
    id: RunId,  # noqa: A002
    x0: Coordinate,
    y0: Coordinate,
    x1: Coordinate,
    y1: Coordinate,
    n: Annotated[int, Query(ge=2, le=20_000)] = 1000,
    client: Client = "",
) -> Response:
    """Return the error along a line."""
    if math.hypot(x1 - x0, y1 - y0) < 1e-9:
        raise HTTPException(422, "the profile must be longer than 1e-9 mm")
    packed = await _compute(
        request, results.profile, _out(request, id), [x0, y0, x1, y1], n, latest=f"profile {client}" if client else ""
    )
    return PackedResponse(packed)


@router.get("/{id}/motion", response_class=Response, responses=NOT_FOUND)
async def run_motion(
    request: Request,
    id: RunId,  # noqa: A002
    points: Annotated[int, Query(ge=10, le=20_000)] = 1500,
) -> Response:
    """Return the axis motion of the finishing pass and the machine limits."""
    return PackedResponse(await _compute(request, results.motion, _out(request, id), points))


@router.get("/{id}/spectrum", response_class=Response, responses=NOT_FOUND)
async def run_spectrum(
    request: Request,
    id: RunId,  # noqa: A002
    axis: Annotated[str, Query(pattern="^[A-Z]$")] = "Z",
) -> Response:
    """Return the amplitude spectrum of an axis, and the largest sine amplitude within its limits."""
    return PackedResponse(await _compute(request, results.spectrum, _out(request, id), axis))
