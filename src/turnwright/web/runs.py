"""Routes of runs: begin, look at, cancel and throw away, and what each has left."""

from __future__ import annotations

import asyncio
import io
import json
import zipfile
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Path, Query, Request
from fastapi.responses import FileResponse, Response, StreamingResponse

from turnwright.web import jobs
from turnwright.web.models import Id, Line, Lines, NewRun, RunDetail, RunFile, RunLine, archived
from turnwright.web.program import lines, near as nearest_line
from turnwright.web.queue import ENDED, Run, Runs
from turnwright.web.references import BUNDLE, CORRECTION, JOB, job_in

__all__ = ["RunId", "job_of", "line_of", "router", "the_run"]

router = APIRouter(prefix="/api/runs", tags=["runs"])

RunId = Annotated[str, Path(pattern="^[0-9a-f]{16}$", description="Of the run.")]
Kept = Literal["program", "table", "report", "job", "written", "bundle", "result", "archive", "correction"]
Coordinate = Annotated[float, Query(ge=-1e5, le=1e5, allow_inf_nan=False)]

NUMBERS = {"run": "result.json", "compare": "comparison.json", "measure": "diagnosis.json", "correct": "result.json"}
"""The file of numbers that a run leaves, by kind."""

A_FILE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The file, byte for byte.",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
JSON_FILE: dict[int | str, dict[str, Any]] = {
    200: {"description": "The file, byte for byte.", "content": {"application/json": {"schema": {"type": "object"}}}}
}


def told_as_events(description: str) -> dict[int | str, dict[str, Any]]:
    """Return what the schema says of an answer that is a stream of events."""
    return {200: {"description": description, "content": {"text/event-stream": {"schema": {"type": "string"}}}}}


def the_run(request: Request, name: str, *kinds: str, folder: bool = True) -> Run:
    """Return a run that there is, of some kinds, with its folder on the disk."""
    runs: Runs = request.app.state.runs
    run = runs.get(name)
    if run is None or (kinds and run.kind not in kinds):
        what = "measurement" if kinds == ("measure",) else "run"
        raise HTTPException(404, f"there is no {what} {name}: look at the list of runs")
    if folder and not runs.folder_of(run).is_dir():
        raise HTTPException(410, f"the folder of the run {name} was deleted outside the workbench: delete the run too")
    return run


def line_of(runs: Runs, run: Run) -> RunLine:
    """Return a run as a list has it."""
    return RunLine(
        id=run.id, name=run.name, kind=run.kind, state=run.state, created=run.created, started=run.started,  # type: ignore[arg-type]
        ended=run.ended, sentence=run.sentence, missed=run.missed, of=run.of,
        progress=runs.progress(run.id) if run.state == "running" else None,  # type: ignore[arg-type]
    )  # fmt: skip


def job_of(runs: Runs, run: Run) -> dict[str, Any]:
    """Return the job that a run carries out: that of a correction is the corrected one."""
    return job_in(runs.folder_of(run), runs.folder)


def _files(runs: Runs, run: Run) -> list[tuple[str, int, File]]:
    """Return what a run has left: the name of each file, its number among those of the name, and its place."""
    folder = runs.folder_of(run)
    out, better = folder / "out", folder / CORRECTION
    found = []
    with suppress(OSError, ValueError, KeyError, TypeError):
        told = json.loads((out / "result.json").read_text(encoding="utf-8"))
        names = [File(name).name for name in told["program"]["files"]]
        program = [name for name in names if not name.endswith(".csv")]
        found += [("program", part, out / name) for part, name in enumerate(program)]
        found += [("table", part, out / name) for part, name in enumerate(n for n in names if n.endswith(".csv"))]
    mine = better if run.kind == "correct" else out
    found += [("report", 0, mine / "report.html"), ("job", 0, mine / JOB), ("bundle", 0, out / BUNDLE)]
    if run.kind in ("run", "compare") and not (out / BUNDLE).is_file():  # it holds the text, with the names of files
        found.append(("written", 0, folder / JOB))
    found += [("result", 0, out / NUMBERS[run.kind]), ("archive", 0, out / "run.h5")]
    beside = ("correction.npz", "waviness.csv", "straightness.csv")
    there = [better / name for name in beside if (better / name).is_file()]
    found += [("correction", part, file) for part, file in enumerate(there)]
    return [one for one in found if one[2].is_file()]


def one_file(request: Request, run: Run, name: str, part: int) -> FileResponse:
    """Return a file that a run has left."""
    for kept, number, file in _files(request.app.state.runs, run):
        if (kept, number) == (name, part):
            return FileResponse(file, filename=file.name, media_type="application/octet-stream")
    raise HTTPException(404, f"the run has no {name}{f' of number {part}' if part else ''}: look at what it has left")


@router.post("", status_code=201)
async def begin(asked: NewRun, request: Request) -> Id:
    """Queue a job to be run, or its strategies to be compared."""
    state = request.app.state
    told = await state.workers.ask(jobs.check, asked.data, str(state.folder))
    if told["errors"]:
        raise HTTPException(422, "; ".join(one["sentence"] for one in told["errors"][:5]))
    part = asked.data.get("part")
    name = asked.name.strip() or (str(part.get("name") or "") if isinstance(part, dict) else "") or "job"
    text = ""
    if asked.toml:
        text = (await state.workers.ask(jobs.write, asked.data, str(state.folder), asked.toml))["toml"]
    runs: Runs = state.runs
    with runs.new_folder() as folder:
        return Id(id=runs.add(folder, asked.data, kind=asked.kind, name=name, text=text).id)


@router.get("")
async def list_runs(request: Request) -> list[RunLine]:
    """List all runs, the newest first."""
    runs: Runs = request.app.state.runs
    return [line_of(runs, run) for run in runs.all()]


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses=told_as_events("Events runs {changed}, at once and whenever the list of runs has changed, without end."),
)
async def changes(request: Request) -> StreamingResponse:
    """Tell when there is a run more or less in the list, or one in another state."""
    return _stream(request.app.state.runs.changes())


@router.get("/{id}")
async def run(id: RunId, request: Request) -> RunDetail:  # noqa: A002 - the word of the contract
    """Say all that is known of a run."""
    runs: Runs = request.app.state.runs
    run = the_run(request, id)
    files = [
        RunFile(name=name, part=part, file=file.name, bytes=file.stat().st_size)
        for name, part, file in _files(runs, run)
    ]
    return RunDetail(
        **line_of(runs, run).model_dump(), data=job_of(runs, run), toml=await asyncio.to_thread(runs.text, run),
        files=files,
    )  # fmt: skip


@router.post("/{id}/cancel")
async def cancel(id: RunId, request: Request) -> RunLine:  # noqa: A002
    """End a run that has not ended; its process is gone when this is answered."""
    runs: Runs = request.app.state.runs
    run = the_run(request, id, folder=False)
    if run.state in ENDED:
        raise HTTPException(409, f"the run is {run.state} already, only one that waits or goes on can be cancelled")
    await runs.cancel(id)
    return line_of(runs, the_run(request, id, folder=False))


@router.delete("/{id}", status_code=204)
async def remove(id: RunId, request: Request) -> Response:  # noqa: A002
    """Throw a run away, with all that it has left."""
    run = the_run(request, id, folder=False)
    if run.state not in ENDED:
        raise HTTPException(409, f"the run is {run.state}: cancel it first")
    await request.app.state.runs.remove(id)
    return Response(status_code=204)


@router.get(
    "/{id}/events",
    response_class=StreamingResponse,
    responses=told_as_events(
        "Events progress {stage, step, steps, fraction, left_s} and state {state, sentence} until the end."
    ),
)
async def events(id: RunId, request: Request) -> StreamingResponse:  # noqa: A002
    """Tell what happens to a run, beginning with its present state."""
    the_run(request, id)
    return _stream(request.app.state.runs.events(id))


def _stream(events: AsyncIterator[str]) -> StreamingResponse:
    return StreamingResponse(events, media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})


@router.get("/{id}/result", response_class=FileResponse, responses=JSON_FILE)
async def result(id: RunId, request: Request) -> FileResponse:  # noqa: A002
    """Return the numbers of a run as the command line writes them."""
    return _json(request, the_run(request, id))


@router.get("/{id}/comparison", response_class=FileResponse, responses=JSON_FILE)
async def comparison(id: RunId, request: Request) -> FileResponse:  # noqa: A002
    """Return the numbers of a comparison as the command line writes them."""
    return _json(request, the_run(request, id, "compare"))


def _json(request: Request, run: Run) -> FileResponse:
    file = request.app.state.runs.folder_of(run) / "out" / NUMBERS[run.kind]
    if not file.is_file():
        raise HTTPException(409, f"the run is {run.state} and has no results: wait until it is done")
    return FileResponse(file, media_type="application/json")


@router.get("/{id}/program")
async def program(
    id: RunId,  # noqa: A002
    request: Request,
    first: Annotated[int, Query(ge=0, le=10**10)] = 0,
    count: Annotated[int, Query(ge=1, le=2000)] = 200,
    near: Annotated[
        str | None, Query(max_length=80, description="x,y in mm: answers the line of the finishing pass there.")
    ] = None,
) -> Lines | Line:
    """Return some lines of the program, and where the tip is after each; or the line that belongs to a place."""
    run = the_run(request, id, "run", "correct")
    state = request.app.state
    out = state.runs.folder_of(run) / "out"
    if not out.is_dir():
        raise HTTPException(409, f"the run is {run.state} and has no program: wait until it is done")
    if near is None:
        return Lines(**await state.workers.ask(lines, str(out), first, count))
    try:
        x, y = (float(one) for one in near.split(","))
    except ValueError:
        x = y = float("inf")
    if not max(abs(x), abs(y)) < 1e5:
        raise HTTPException(422, "near must be two numbers in mm with a comma between them: write near=1.5,-2")
    return Line(**await state.workers.ask(nearest_line, str(out), x, y))


@router.get(
    "/{id}/files/programs",
    response_class=StreamingResponse,
    responses=archived("A ZIP archive of all files of the program, each byte for byte."),
)
async def programs(id: RunId, request: Request) -> StreamingResponse:  # noqa: A002
    """Return all files that the lathe needs: the program, its sub-programs, the table of a fast tool."""
    runs: Runs = request.app.state.runs
    files = [file for name, _, file in _files(runs, the_run(request, id)) if name in ("program", "table")]
    if not files:
        raise HTTPException(404, "the run has no program: look at what it has left")
    name = f'attachment; filename="{files[0].stem}.zip"'
    return StreamingResponse(_zipped(files), media_type="application/zip", headers={"Content-Disposition": name})


class _Sink(io.RawIOBase):
    """Keeps what is written until it is taken."""

    def __init__(self) -> None:
        self.held: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.held.append(bytes(data))
        return len(data)

    def taken(self) -> bytes:
        found, self.held = b"".join(self.held), []
        return found


def _zipped(files: list[File]) -> Iterator[bytes]:
    """Yield an archive piece by piece: a program can be larger than memory."""
    sink = _Sink()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for file in files:
            with file.open("rb") as source, archive.open(zipfile.ZipInfo.from_file(file, file.name), "w") as target:
                while piece := source.read(1 << 20):
                    target.write(piece)
                    yield sink.taken()
    yield sink.taken()


@router.get("/{id}/files/{name}", response_class=FileResponse, responses=A_FILE)
async def kept_file(
    id: RunId,  # noqa: A002
    name: Kept,
    request: Request,
    part: Annotated[int, Query(ge=0, le=100_000, description="Which of several.")] = 0,
) -> FileResponse:
    """Return a file that a run has left."""
    return one_file(request, the_run(request, id), name, part)
