"""Routes to what is seen of a job that is only typed: its surface in any colour, the path, the edge in contact."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import Field

from turnwright.web import jobs, seen
from turnwright.web.models import Model, Problem, Question
from turnwright.web.packed import MEDIA_TYPE
from turnwright.web.workers import Workers

__all__ = ["PACKED", "apart", "router"]

Quantity = Literal["height", "slope", "curvature", "clearance margin", "chip thickness"]


class SurfaceQuestion(Question):
    """What to colour a part with."""

    quantity: Quantity = "height"
    pixels: Annotated[int, Field(ge=16, le=768)] = 256


class PathQuestion(Question):
    """How much of a path to show."""

    points: Annotated[int, Field(ge=100, le=20_000)] = 6000


class Place(Model):
    """A place of the tip."""

    angle: Annotated[float, Field(ge=-1e7, le=1e7, description="Azimuth of the part under the tool. [rad]")]
    radius: Annotated[float, Field(ge=-1e4, le=1e4, description="Distance of the tip from the axis. [mm]")]
    y: Annotated[float, Field(ge=-1e4, le=1e4, description="Its height above centre. [mm]")] = 0.0
    feed: Annotated[float, Field(gt=0, le=1e3, description="How far apart turns stand there. [mm/rev]")] | None = None


class SectionQuestion(Question):
    """Where to look at the edge."""

    at: Place


router = APIRouter(prefix="/api/view", tags=["views"])

PACKED: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "TW01, the length of a JSON header (uint32, little-endian), the header, float32 arrays.",
        "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
    },
    413: {"model": Problem, "description": "The request is too large."},
    422: {"model": Problem, "description": "The job has an error, or cannot be seen so."},
    503: {"model": Problem, "description": "Too many questions wait."},
}
"""What a route answers that sends arrays."""


SLOW = ("adaptive tool servo", "quasi-elliptical tool servo")
"""Strategies whose points are only known when all of them are."""


def apart(request: Request) -> Workers:
    """Return the one process for what takes long, so that nobody waits behind it."""
    state = request.app.state
    if getattr(state, "path_worker", None) is None:
        state.path_worker = Workers(1, threads=1, warm=jobs.warm)
    found: Workers = state.path_worker
    return found


def _workers(request: Request, data: dict[str, Any]) -> Workers:
    """Return who finds the path of a job."""
    state = request.app.state
    strategy, passes = data.get("strategy"), data.get("passes")
    told = [one for one in (strategy, *(passes if isinstance(passes, list) else ())) if isinstance(one, dict)]
    if not any(one.get("kind") in SLOW or one.get("chord") is not None for one in told):
        return state.workers  # type: ignore[no-any-return]
    return apart(request)


async def _seen(
    workers: Workers, question: Question, what: Callable[..., bytes], *arguments: Any, keep: bool = True
) -> Response:
    """Return what one of the processes packs; of equal questions of one page only the last counts."""
    latest = f"{what.__name__} {question.client}" if question.client else ""
    found = await workers.ask(what, question.data, *arguments, latest=latest, keep=keep)
    return Response(found, media_type=MEDIA_TYPE)


@router.post("/surface", response_class=Response, responses=PACKED)
async def view_surface(request: Request, question: SurfaceQuestion) -> Response:
    """Return the part coloured by a quantity: values, and heights [mm] for the shape."""
    state = request.app.state
    workers = _workers(request, question.data) if question.quantity == "chip thickness" else state.workers
    return await _seen(workers, question, seen.surface, str(state.folder), question.quantity, question.pixels)


@router.post("/path", response_class=Response, responses=PACKED)
async def view_path(request: Request, question: PathQuestion) -> Response:
    """Return turns of the finishing path with the tip in contact at every place [mm, rad]."""
    workers = _workers(request, question.data)
    return await _seen(workers, question, seen.path, str(request.app.state.folder), question.points)


@router.post("/section", response_class=Response, responses=PACKED)
async def view_section(request: Request, question: SectionQuestion) -> Response:
    """Return part and edge in the plane of the edge at one place, and the cusps beside it [mm]."""
    at, state = question.at, request.app.state
    workers = state.workers if at.feed is not None else _workers(request, question.data)
    place = (at.angle, at.radius, at.y, at.feed)
    return await _seen(workers, question, seen.section, str(state.folder), *place, keep=False)
