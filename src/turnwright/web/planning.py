"""Routes for planning a job: schema, examples, conversion between text and data, and checks."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import Response

from turnwright import __version__
from turnwright.web import bundles, jobs
from turnwright.web.examples import examples
from turnwright.web.guard import BODY_BYTES, UPLOAD_BYTES
from turnwright.web.limits import FILE_BYTES, MAP_TYPES, MAX_POINTS
from turnwright.web.models import (
    About,
    Check,
    Edited,
    ExampleJob,
    ExampleLine,
    Limits,
    Parsed,
    Question,
    Toml,
    Written,
    answer_of,
)
from turnwright.web.schema import job_schema

__all__ = ["router"]

router = APIRouter(prefix="/api", tags=["planning"])


@router.get("/about", response_model=About)
async def about(request: Request) -> About:
    """Return version and limits of the server."""
    return About(
        version=__version__,
        examples=list(examples()),
        limits=Limits(
            body_bytes=BODY_BYTES,
            upload_bytes=UPLOAD_BYTES,
            file_bytes=FILE_BYTES,
            points=MAX_POINTS,
            at_a_time=request.app.state.at_a_time,
            map_types=list(MAP_TYPES),
        ),
    )


@router.get("/schema", response_model=dict[str, Any])
async def schema(request: Request) -> Any:
    """Return the JSON schema of a job: title, description, unit and default of each field."""
    return await request.app.state.workers.ask(job_schema, keep=True)


@router.get("/examples", response_model=list[ExampleLine])
async def list_examples() -> list[ExampleLine]:
    """List the examples."""
    return [ExampleLine(name=one.name, title=one.title, summary=one.summary) for one in examples().values()]


@router.get("/examples/{name}", response_model=ExampleJob)
async def example(name: str, request: Request) -> Any:
    """Return an example."""
    if name not in examples():
        raise HTTPException(404, f"example must be one of {', '.join(examples())}")
    toml = examples()[name].toml
    state = request.app.state
    return {"toml": toml, **await state.workers.ask(jobs.parse, toml, str(state.folder), keep=True)}


@router.post("/job/parse", response_model=Parsed)
async def parse(job: Toml, request: Request) -> Any:
    """Read a job file."""
    state = request.app.state
    return await state.workers.ask(jobs.parse, job.toml, str(state.folder))


@router.post("/job/write", response_model=Written)
async def write(job: Edited, request: Request) -> Any:
    """Write a job as a file."""
    state = request.app.state
    return await state.workers.ask(jobs.write, job.data, str(state.folder), job.toml)


@router.post(
    "/job/bundle",
    response_class=Response,
    responses=answer_of("ZIP archive of job.toml and its files, for the command line.", "application/zip"),
)
async def bundle(job: Edited, request: Request) -> Response:
    """Return an archive of a job and the files that it names."""
    state = request.app.state
    archive = await state.workers.ask(bundles.bundle, job.data, str(state.folder), job.toml)
    return Response(
        archive, media_type="application/zip", headers={"Content-Disposition": 'attachment; filename="job.zip"'}
    )


@router.post("/job/check", response_model=Check)
async def check(job: Question, request: Request) -> Any:
    """Check tool access, length of the program and uncut chip thickness."""
    state = request.app.state
    latest = f"check {job.client}" if job.client else ""
    return await state.workers.ask(jobs.check, job.data, str(state.folder), latest=latest)
