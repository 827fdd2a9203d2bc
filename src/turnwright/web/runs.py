"""Routes of runs: start, inspect, cancel and delete runs, and download their files."""

from __future__ import annotations

import asyncio
import io
import json
import zipfile
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import FileResponse, Response, StreamingResponse

from turnwright.web import jobs
from turnwright.web.models import Id, Line, Lines, NewRun, RunDetail, RunFile, RunId, RunLine, RunState, answer_of
from turnwright.web.program import lines, nearest_line
from turnwright.web.queue import ENDED, Run, Runs
from turnwright.web.references import BUNDLE, CORRECTION, JOB, job_in

__all__ = ["A_FILE", "find_run", "job_of", "line_of", "router", "send_file"]

router = APIRouter(prefix="/api/runs", tags=["runs"])

Kept = Literal["program", "table", "report", "job", "written", "bundle", "result", "archive", "correction"]

NUMBERS = {"run": "result.json", "compare": "comparison.json", "measure": "diagnosis.json", "correct": "result.json"}
"""Result file of a run, by kind."""

A_FILE = answer_of("The file, byte for byte.", "application/octet-stream")
JSON_FILE = answer_of("The file, byte for byte.", "application/json", {"type": "object"})


def events_of(description: str) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI responses of a route that streams events."""
    return answer_of(description, "text/event-stream", {"type": "string"})


def find_run(request: Request, name: str, *kinds: str, folder: bool = True) -> Run:
    """Return a run of given kinds; raise unless it and its folder exist."""
    runs: Runs = request.app.state.runs
    run = runs.get(name)
    if run is None or (kinds and run.kind not in kinds):
        what = "measurement" if kinds == ("measure",) else "run"
        raise HTTPException(404, f"{what} {name} does not exist")
    if folder and not runs.folder_of(run).is_dir():
        raise HTTPException(410, f"the folder of run {name} was deleted outside the workbench: delete the run, too")
    return run


def line_of(runs: Runs, run: Run) -> RunLine:
    """Return the list entry of a run."""
    progress = runs.progress(run.id) if run.state == "running" else None
    return RunLine(**run.model_dump(include=set(RunState.model_fields)), progress=progress)  # type: ignore[arg-type]


def job_of(runs: Runs, run: Run) -> dict[str, Any]:
    """Return the job of a run; for a correction, the corrected job."""
    return job_in(runs.folder_of(run), runs.folder)


def _files(runs: Runs, run: Run) -> list[tuple[str, int, File]]:
    """Return the files of a run: label, number among files of this label, and path."""
    folder = runs.folder_of(run)
    out, correction = folder / "out", folder / CORRECTION
    files = []
    with suppress(OSError, ValueError, KeyError, TypeError):
        numbers = json.loads((out / "result.json").read_text(encoding="utf-8"))
        names = [File(name).name for name in numbers["program"]["files"]]
        program = [name for name in names if not name.endswith(".csv")]
        files += [("program", part, out / name) for part, name in enumerate(program)]
        files += [("table", part, out / name) for part, name in enumerate(n for n in names if n.endswith(".csv"))]
    owner = correction if run.kind == "correct" else out
    files += [("report", 0, owner / "report.html"), ("job", 0, owner / JOB), ("bundle", 0, out / BUNDLE)]
    if (
        run.kind in ("run", "compare") and not (out / BUNDLE).is_file()
    ):  # the archive contains this text, with file names
        files.append(("written", 0, folder / JOB))
    files += [("result", 0, out / NUMBERS[run.kind]), ("archive", 0, out / "run.h5")]
    extra_names = ("correction.npz", "waviness.csv", "straightness.csv")
    extras = [correction / name for name in extra_names if (correction / name).is_file()]
    files += [("correction", part, file) for part, file in enumerate(extras)]
    return [one for one in files if one[2].is_file()]


def send_file(request: Request, run: Run, name: str, part: int) -> FileResponse:
    """Return a file of a run."""
    for label, number, file in _files(request.app.state.runs, run):
        if (label, number) == (name, part):
            return FileResponse(file, filename=file.name, media_type="application/octet-stream")
    raise HTTPException(404, f"the run has no {name}{f' number {part}' if part else ''}")


@router.post("", status_code=201)
async def begin(new_run: NewRun, request: Request) -> Id:
    """Queue a run, or a comparison of strategies."""
    state = request.app.state
    result = await state.workers.ask(jobs.check, new_run.data, str(state.folder))
    if result["errors"]:
        raise HTTPException(422, "; ".join(one["sentence"] for one in result["errors"][:5]))
    part = new_run.data.get("part")
    name = new_run.name.strip() or (str(part.get("name") or "") if isinstance(part, dict) else "") or "job"
    text = ""
    if new_run.toml:
        text = (await state.workers.ask(jobs.write, new_run.data, str(state.folder), new_run.toml))["toml"]
    runs: Runs = state.runs
    with runs.new_folder() as folder:
        return Id(id=runs.add(folder, new_run.data, kind=new_run.kind, name=name, text=text).id)


@router.get("")
async def list_runs(request: Request) -> list[RunLine]:
    """List all runs, the newest first."""
    runs: Runs = request.app.state.runs
    return [line_of(runs, run) for run in runs.all()]


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses=events_of("Endless stream of events runs {changed}: at once, and whenever the list of runs changes."),
)
async def changes(request: Request) -> StreamingResponse:
    """Stream an event whenever a run is added, removed or changes its state."""
    return _stream(request.app.state.runs.changes())


@router.get("/{id}")
async def run(id: RunId, request: Request) -> RunDetail:  # noqa: A002 - the name in the API
    """Return the details of a run."""
    runs: Runs = request.app.state.runs
    run = find_run(request, id)
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
    """Cancel a run; its process has ended when this returns."""
    runs: Runs = request.app.state.runs
    run = find_run(request, id, folder=False)
    if run.state in ENDED:
        raise HTTPException(409, f"the run is already {run.state}")
    await runs.cancel(id)
    return line_of(runs, find_run(request, id, folder=False))


@router.delete("/{id}", status_code=204)
async def remove(id: RunId, request: Request) -> Response:  # noqa: A002
    """Delete a run with all its files."""
    run = find_run(request, id, folder=False)
    if run.state not in ENDED:
        raise HTTPException(409, f"the run is {run.state}: cancel it first")
    await request.app.state.runs.remove(id)
    return Response(status_code=204)


@router.get(
    "/{id}/events",
    response_class=StreamingResponse,
    responses=events_of(
        "Events progress {stage, step, steps, fraction, left_s} and state {state, sentence} until the end."
    ),
)
async def events(id: RunId, request: Request) -> StreamingResponse:  # noqa: A002
    """Stream the state and the progress of a run."""
    find_run(request, id)
    return _stream(request.app.state.runs.events(id))


def _stream(events: AsyncIterator[str]) -> StreamingResponse:
    return StreamingResponse(events, media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})


@router.get("/{id}/result", response_class=FileResponse, responses=JSON_FILE)
async def result(id: RunId, request: Request) -> FileResponse:  # noqa: A002
    """Return the numbers of a run as the command line writes them."""
    return _json(request, find_run(request, id))


@router.get("/{id}/comparison", response_class=FileResponse, responses=JSON_FILE)
async def comparison(id: RunId, request: Request) -> FileResponse:  # noqa: A002
    """Return the numbers of a comparison as the command line writes them."""
    return _json(request, find_run(request, id, "compare"))


def _json(request: Request, run: Run) -> FileResponse:
    file = request.app.state.runs.folder_of(run) / "out" / NUMBERS[run.kind]
    if not file.is_file():
        raise HTTPException(409, f"the run is {run.state} and has no results")
    return FileResponse(file, media_type="application/json")


@router.get("/{id}/program")
async def program(
    id: RunId,  # noqa: A002
    request: Request,
    first: Annotated[int, Query(ge=0, le=10**10)] = 0,
    count: Annotated[int, Query(ge=1, le=2000)] = 200,
    near: Annotated[
        str | None,
        Query(max_length=80, description="x,y in mm: return the line of the finishing pass nearest to this point."),
    ] = None,
) -> Lines | Line:
    """Return lines of the program with the tip position after each, or the line nearest to a point."""
    run = find_run(request, id, "run", "correct")
    state = request.app.state
    out = state.runs.folder_of(run) / "out"
    if not out.is_dir():
        raise HTTPException(409, f"the run is {run.state} and has no program")
    if near is None:
        return Lines(**await state.workers.ask(lines, str(out), first, count))
    try:
        x, y = (float(one) for one in near.split(","))
    except ValueError:
        x = y = float("inf")
    if not max(abs(x), abs(y)) < 1e5:
        raise HTTPException(422, "near must be two numbers in mm separated by a comma, such as near=1.5,-2")
    return Line(**await state.workers.ask(nearest_line, str(out), x, y))


@router.get(
    "/{id}/files/programs",
    response_class=StreamingResponse,
    responses=answer_of("ZIP archive of all files of the program.", "application/zip"),
)
async def programs(id: RunId, request: Request) -> StreamingResponse:  # noqa: A002
    """Return all files for the lathe: program, sub-programs and fast tool servo table."""
    runs: Runs = request.app.state.runs
    files = [file for name, _, file in _files(runs, find_run(request, id)) if name in ("program", "table")]
    if not files:
        raise HTTPException(404, "the run has no program")
    name = f'attachment; filename="{files[0].stem}.zip"'
    return StreamingResponse(_zipped(files), media_type="application/zip", headers={"Content-Disposition": name})


class _Sink(io.RawIOBase):
    """Collects written bytes until they are taken."""

    def __init__(self) -> None:
        self.held: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.held.append(bytes(data))
        return len(data)

    def taken(self) -> bytes:
        data, self.held = b"".join(self.held), []
        return data


def _zipped(files: list[File]) -> Iterator[bytes]:
    """Yield an archive in pieces, since a program can be larger than memory."""
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
    """Return a file of a run."""
    return send_file(request, find_run(request, id), name, part)
