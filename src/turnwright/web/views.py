"""Routes for views of a job before it is run: surface maps, tool path and section through the cutting edge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import Field

from turnwright.web import jobs, previews
from turnwright.web.binary import MEDIA_TYPE
from turnwright.web.models import Model, Problem, Question, answer_of
from turnwright.web.workers import Workers

__all__ = ["ARRAYS", "PACKED", "PackedResponse", "path_worker", "router"]

Quantity = Literal["height", "slope", "curvature", "clearance margin", "chip thickness"]


class SurfaceQuestion(Question):
    """A request for a surface map."""

    quantity: Quantity = "height"
    pixels: Annotated[int, Field(ge=16, le=768)] = 256


class PathQuestion(Question):
    """A request for the tool path."""

    points: Annotated[int, Field(ge=100, le=20_000)] = 6000


class Place(Model):
    """A position of the tool tip."""

    angle: Annotated[float, Field(ge=-1e7, le=1e7, description="Azimuth of the part under the tool. [rad]")]
    radius: Annotated[float, Field(ge=-1e4, le=1e4, description="Distance of the tip from the axis. [mm]")]
    y: Annotated[float, Field(ge=-1e4, le=1e4, description="Y position of the tip. [mm]")] = 0.0
    feed: Annotated[float, Field(gt=0, le=1e3, description="Feed there. [mm/rev]")] | None = None


class SectionQuestion(Question):
    """A request for a section."""

    at: Place


router = APIRouter(prefix="/api/view", tags=["views"])

ARRAYS = answer_of("TW01, the length of a JSON header (uint32, little-endian), the header, float32 arrays.", MEDIA_TYPE)
PACKED: dict[int | str, dict[str, Any]] = {
    **ARRAYS,
    413: {"model": Problem, "description": "The request is too large."},
    422: {"model": Problem, "description": "The job is invalid or cannot be shown."},
    503: {"model": Problem, "description": "Too many requests are waiting."},
}
"""OpenAPI responses of a route that returns arrays."""


class PackedResponse(Response):
    """Answer with arrays, see `turnwright.web.binary`."""

    media_type = MEDIA_TYPE


SLOW_STRATEGIES = ("adaptive tool servo", "quasi-elliptical tool servo")
"""Strategies that must be planned completely before any point is known."""


def path_worker(request: Request) -> Workers:
    """Return the separate worker process for slow paths."""
    state = request.app.state
    if getattr(state, "path_worker", None) is None:
        state.path_worker = Workers(1, threads=1, warm=jobs.warm)
    workers: Workers = state.path_worker
    return workers


def _workers(request: Request, data: dict[str, Any]) -> Workers:
    """Return the workers that compute the path of a job."""
    state = request.app.state
    strategy, passes = data.get("strategy"), data.get("passes")
    tables = [one for one in (strategy, *(passes if isinstance(passes, list) else ())) if isinstance(one, dict)]
    if not any(one.get("kind") in SLOW_STRATEGIES or one.get("chord") is not None for one in tables):
        return state.workers  # type: ignore[no-any-return]
    return path_worker(request)


async def _answer(
    workers: Workers, question: Question, what: Callable[..., bytes], *arguments: Any, keep: bool = True
) -> Response:
    """Return the packed answer of a worker; only the last request of a kind by a client counts."""
    latest = f"{what.__name__} {question.client}" if question.client else ""
    packed = await workers.ask(what, question.data, *arguments, latest=latest, keep=keep)
    return PackedResponse(packed)


@router.post("/surface", response_class=Response, responses=PACKED)
async def view_surface(request: Request, question: SurfaceQuestion) -> Response:
    """Return a surface map: heights [mm], and values of a quantity."""
    state = request.app.state
    workers = _workers(request, question.data) if question.quantity == "chip thickness" else state.workers
    return await _answer(workers, question, previews.surface, str(state.folder), question.quantity, question.pixels)


@router.post("/path", response_class=Response, responses=PACKED)
async def view_path(request: Request, question: PathQuestion) -> Response:
    """Return revolutions of the finishing path with exact contact points [mm, rad]."""
    workers = _workers(request, question.data)
    return await _answer(workers, question, previews.path, str(request.app.state.folder), question.points)


@router.post("/section", response_class=Response, responses=PACKED)
async def view_section(request: Request, question: SectionQuestion) -> Response:
    """Return the section of part and cutting edge at one position, with the neighbouring cusps [mm]."""
    at, state = question.at, request.app.state
    workers = state.workers if at.feed is not None else _workers(request, question.data)
    place = (at.angle, at.radius, at.y, at.feed)
    return await _answer(workers, question, previews.section, str(state.folder), *place, keep=False)
