"""Routes to what is seen of a finished run: its maps at any size, profiles, and how its axes move."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.exceptions import HTTPException
from pydantic import Field

from turnwright.progress import cores
from turnwright.web import budget, made
from turnwright.web.limits import FINER
from turnwright.web.models import Model
from turnwright.web.packed import MEDIA_TYPE
from turnwright.web.views import PACKED, apart
from turnwright.web.workers import Workers

__all__ = ["close", "router"]

MOST = 2048
"""Pixels along a map at most."""

LONGEST_S = 600.0
"""How long a window may take at most; the program of a large part must be read first."""

WHOLE_PIXELS = 700
"""Pixels along a map where nobody says how many."""


class Map(Model):
    """A map that a run has stored."""

    name: str
    unit: str = Field(description="Of the heights; windows come in it.")
    shape: list[int]
    x: tuple[float, float] | None = Field(description="First and last column. [mm]")
    y: tuple[float, float] | None = Field(description="First and last row. [mm]")
    radius: tuple[float, float] | None = Field(description="Of a polar map, first and last column. [mm]")
    angle: tuple[float, float] | None = Field(description="Of a polar map, first and last row. [rad]")
    pixel: float | None = Field(description="How far apart its columns stand. [mm]")
    pv_nm: float | None
    sq_nm: float | None
    tracking: bool = Field(description="Whether it tells what the servos add.")


class Budget(Model):
    """Where the form error of a finishing pass comes from; each share peak to valley, by simulation. [nm]."""

    cusp_nm: float | None = Field(description="Of what an exact path leaves.")
    cusp_away_nm: float | None = Field(description="The same two feeds or more away from the axis.")
    chord_nm: float | None = Field(description="Largest change by what the controller makes between the points.")
    rounding_nm: float | None = Field(description="Largest change by the decimals of the program.")
    tracking_nm: float | None = Field(description="Largest change by how the servos answer.")
    pv_nm: float | None = Field(description="Of all together.")
    rms_nm: float | None = Field(description="Root mean square of all together.")
    sq_nm: float | None = Field(description="Finish: largest Sq of a ring a few feeds wide.")
    servos: bool = Field(description="Whether the machine states how any of its axes answers.")


router = APIRouter(prefix="/api/runs", tags=["maps"])

Id = Annotated[str, Path(pattern="^[0-9a-f]{16}$", description="Of the run.")]
Coordinate = Annotated[float, Query(ge=-1e5, le=1e5, allow_inf_nan=False, description="[mm]")]
Pixels = Annotated[int, Query(ge=2, le=MOST)]
NOT_FOUND: dict[int | str, dict[str, Any]] = {**PACKED, 404: {**PACKED[422], "description": "There is no such run."}}
JSON_ERRORS = {code: told for code, told in NOT_FOUND.items() if code != 200}


def _out(request: Request, run: str) -> str:
    """Return the folder that a run writes into, if there is one."""
    out = File(request.app.state.folder) / "runs" / run / "out"
    if not out.is_dir():
        raise HTTPException(404, f"there is no run {run} with results: look at the list of runs")
    return str(out)


def _lane(request: Request) -> Workers:
    """Return the one process that keeps motions ready."""
    state = request.app.state
    if getattr(state, "window_worker", None) is None:
        state.window_worker = Workers(1, threads=cores(), warm=made.warm)
    found: Workers = state.window_worker
    return found


def close(app: Any) -> None:
    """End the processes that were started beside the `Workers` of the app."""
    for name in ("window_worker", "path_worker"):
        if getattr(app.state, name, None) is not None:
            getattr(app.state, name).close()


async def _asked(
    request: Request, function: Callable[..., Any], *arguments: Any, latest: str = "", keep: bool = True
) -> Any:
    return await _lane(request).ask(function, *arguments, latest=latest, keep=keep, limit_s=LONGEST_S)


@router.get("/{id}/maps", responses=JSON_ERRORS)
async def run_maps(request: Request, id: Id) -> list[Map]:  # noqa: A002 - the word of the contract
    """List the maps that a run has stored."""
    _lane(request)  # whoever looks at maps will soon look closer: its process warms up meanwhile
    return [Map(**one) for one in await request.app.state.workers.ask(made.listed, _out(request, id), keep=True)]


@router.get("/{id}/map", response_class=Response, responses=NOT_FOUND)
async def run_map(
    request: Request,
    id: Id,  # noqa: A002
    name: Annotated[str, Query(max_length=200)] = "whole part",
    x0: Coordinate | None = None,
    x1: Coordinate | None = None,
    y0: Coordinate | None = None,
    y1: Coordinate | None = None,
    nx: Pixels | None = None,
    ny: Pixels | None = None,
    quantity: Literal["error", "height"] = "error",
    client: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Return a window of a map; finer than the run has stored it, it is generated. All of it where nothing is said."""
    out = _out(request, id)
    told = await request.app.state.workers.ask(made.listed, out, keep=True)
    one = next((each for each in told if each["name"] == name), None)
    if one is None:
        raise HTTPException(404, f"the run has no map {name[:60]!r}: it has {', '.join(each['name'] for each in told)}")
    rim = one["radius"][1] if one["radius"] else 0.0
    whole = (one["x"] or [-rim, rim]), (one["y"] or [-rim, rim])
    x = (whole[0][0] if x0 is None else x0, whole[0][1] if x1 is None else x1)
    y = (whole[1][0] if y0 is None else y0, whole[1][1] if y1 is None else y1)
    for axis, (low, high) in (("x", x), ("y", y)):
        if not high - low > 1e-9:
            raise HTTPException(
                422, f"{axis}0 is {low:g} mm and {axis}1 {high:g} mm: let a window be wider than 1e-9 mm"
            )
    shape = one["shape"] if one["x"] else [WHOLE_PIXELS] * 2
    ny, nx = ny or min(shape[0], MOST), nx or min(shape[1], MOST)
    step = min((x[1] - x[0]) / (nx - 1), (y[1] - y[0]) / (ny - 1))
    # What is stored needs no motion: then any of the processes answers, and no window waits for a program to be read.
    within = x[0] >= whole[0][0] and x[1] <= whole[0][1] and y[0] >= whole[1][0] and y[1] <= whole[1][1]
    stored = step >= FINER * (one["pixel"] or math.inf) and (within or not one["x"])
    arguments = (out, name, list(x), list(y), [ny, nx], quantity)
    if stored:
        found = await request.app.state.workers.ask(made.window, *arguments, keep=True)
    else:
        found = await _asked(request, made.window, *arguments, latest=f"window {client}" if client else "")
    return Response(found, media_type=MEDIA_TYPE)


@router.get("/{id}/chips", response_class=Response, responses=NOT_FOUND)
async def run_chips(
    request: Request,
    id: Id,  # noqa: A002
    pixels: Annotated[int, Query(ge=16, le=768)] = 288,
) -> Response:
    """Return the thickest chip of the finishing pass over the part [mm]."""
    found = await request.app.state.workers.ask(made.chips, _out(request, id), pixels, keep=True)
    return Response(found, media_type=MEDIA_TYPE)


@router.get("/{id}/budget", responses=JSON_ERRORS)
async def run_budget(request: Request, id: Id) -> Budget:  # noqa: A002
    """Return where the error of a run comes from; it takes about as long as planning its path."""
    return Budget(**await apart(request).ask(budget.budget, _out(request, id), keep=True, limit_s=LONGEST_S))


@router.get("/{id}/profile", response_class=Response, responses=NOT_FOUND)
async def run_profile(
    request: Request,
    id: Id,  # noqa: A002
    x0: Coordinate,
    y0: Coordinate,
    x1: Coordinate,
    y1: Coordinate,
    n: Annotated[int, Query(ge=2, le=20_000)] = 1000,
    client: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Return the error along a line."""
    if math.hypot(x1 - x0, y1 - y0) < 1e-9:
        raise HTTPException(422, "the line of the profile is shorter than 1e-9 mm: give it two ends")
    found = await _asked(
        request, made.profile, _out(request, id), [x0, y0, x1, y1], n, latest=f"profile {client}" if client else ""
    )
    return Response(found, media_type=MEDIA_TYPE)


@router.get("/{id}/motion", response_class=Response, responses=NOT_FOUND)
async def run_motion(
    request: Request,
    id: Id,  # noqa: A002
    points: Annotated[int, Query(ge=10, le=20_000)] = 1500,
) -> Response:
    """Return how the axes of the finishing pass move, against the limits of the machine."""
    return Response(await _asked(request, made.motion, _out(request, id), points), media_type=MEDIA_TYPE)


@router.get("/{id}/spectrum", response_class=Response, responses=NOT_FOUND)
async def run_spectrum(
    request: Request,
    id: Id,  # noqa: A002
    axis: Annotated[str, Query(pattern="^[A-Z]$")] = "Z",
) -> Response:
    """Return what an axis moves at each frequency, and the largest sine that its limits allow."""
    return Response(await _asked(request, made.spectrum, _out(request, id), axis), media_type=MEDIA_TYPE)
