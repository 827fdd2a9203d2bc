"""Routes to what is seen of a job that is only typed: its surface in any colour, the path, the edge in contact."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import Field

from turnwright.web._models import Model, Problem, Question
from turnwright.web._packed import MEDIA_TYPE

__all__ = ["PACKED", "router"]

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


@router.post("/surface", response_class=Response, responses=PACKED)
async def view_surface(request: Request, question: SurfaceQuestion) -> Response:
    """Return the part coloured by a quantity: values, and heights [mm] for the shape."""
    state = request.app.state
    found = await state.workers.ask(
        "_seen:surface", question.data, str(state.folder), question.quantity, question.pixels,
        latest=f"surface {question.client}" if question.client else "", keep=True,
    )  # fmt: skip
    return Response(found, media_type=MEDIA_TYPE)


@router.post("/path", response_class=Response, responses=PACKED)
async def view_path(request: Request, question: PathQuestion) -> Response:
    """Return turns of the finishing path with the tip in contact at every place [mm, rad]."""
    state = request.app.state
    found = await state.workers.ask(
        "_seen:path", question.data, str(state.folder), question.points,
        latest=f"path {question.client}" if question.client else "", keep=True,
    )  # fmt: skip
    return Response(found, media_type=MEDIA_TYPE)


@router.post("/section", response_class=Response, responses=PACKED)
async def view_section(request: Request, question: SectionQuestion) -> Response:
    """Return part and edge in the plane of the edge at one place, and the cusps beside it [mm]."""
    state = request.app.state
    found = await state.workers.ask(
        "_seen:section", question.data, str(state.folder), question.at.angle, question.at.radius, question.at.y,
        latest=f"section {question.client}" if question.client else "",
    )  # fmt: skip
    return Response(found, media_type=MEDIA_TYPE)
