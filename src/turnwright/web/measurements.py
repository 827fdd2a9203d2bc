"""Routes of measured parts: the instrument's file, what is found in it, and the job that takes it into account."""

from __future__ import annotations

import json
import secrets
import shutil
from contextlib import suppress
from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import FileResponse, Response

from turnwright.web import shown
from turnwright.web.files import RAW_BODY, stored
from turnwright.web.guard import UPLOAD_BYTES
from turnwright.web.limits import FILE_BYTES, FILE_S, MAP_TYPES
from turnwright.web.models import Causes, Id, Measurement
from turnwright.web.packed import MEDIA_TYPE
from turnwright.web.queue import Run, Runs
from turnwright.web.references import CORRECTION, shown_name
from turnwright.web.runs import A_FILE, RunId, job_of, line_of, one_file, the_run

__all__ = ["router"]

router = APIRouter(prefix="/api/measurements", tags=["measurements"])

Pixels = Annotated[int, Query(ge=2, le=2048)]
PACKED = "TW01, the length of a JSON header (uint32, little-endian), the header, float32 arrays."
PICTURES = {"measured": "error.npz", "residual": "left-1.npz", "predicted": "predicted.npz"}


def _map_suffix(name: str) -> str:
    """Return the ending of the name of a map's file.

    Raises
    ------
    HTTPException
        If no map ends so.
    """
    suffix = File(name.replace("\\", "/")).suffix.lower()
    if suffix not in MAP_TYPES:
        raise HTTPException(
            422, f"the file ends in {suffix[:12]!r}, it can end in {', '.join(MAP_TYPES)}: bring one of these"
        )
    return suffix


@router.post(
    "",
    status_code=201,
    openapi_extra=RAW_BODY,
)
async def bring(
    request: Request,
    run: Annotated[str, Query(pattern="^[0-9a-f]{16}$", description="That cut the part.")],
    name: Annotated[str, Query(min_length=1, max_length=200, description="What the file is called.")],
) -> Id:
    """Bring the file of an instrument, to be registered to its part and explained."""
    runs: Runs = request.app.state.runs
    cut = the_run(request, run, "run", "correct")
    if cut.state != "done":
        raise HTTPException(409, f"the run is {cut.state}: measure a part whose run is done")
    suffix = _map_suffix(name)
    with runs.new_folder() as folder:
        # Whatever the file is called, its place and name on this disk are the server's own.
        file = folder / f"measured{suffix}"
        await stored(request, file, UPLOAD_BYTES)
        measured = runs.add(
            folder, job_of(runs, cut), kind="measure", name=shown_name(name), text=runs.text(cut), of=cut.id,
            file=file.name, called=shown_name(name),
        )  # fmt: skip
    return Id(id=measured.id)


@router.post(
    "/show",
    response_class=Response,
    openapi_extra=RAW_BODY,
    responses={
        200: {"description": PACKED, "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
    },
)
async def show(
    request: Request,
    name: Annotated[str, Query(min_length=1, max_length=200, description="What the file is called.")],
) -> Response:
    """Return the picture of an instrument's map without a job, and what can be said of it; nothing is kept."""
    state = request.app.state
    suffix = _map_suffix(name)
    file = state.folder / "files" / f".{secrets.token_hex(16)}{suffix}"
    try:
        await stored(request, file, FILE_BYTES)
        packed = await state.workers.ask(shown.lone_map, str(file), shown_name(name), limit_s=FILE_S)
    finally:
        file.unlink(missing_ok=True)
    return Response(packed, media_type=MEDIA_TYPE)


@router.get("/{id}")
async def measurement(id: RunId, request: Request) -> Measurement:  # noqa: A002 - the word of the contract
    """Say what was found in a measured map."""
    runs: Runs = request.app.state.runs
    run = the_run(request, id, "measure")
    line = line_of(runs, run)
    found: dict[str, Any] = {}
    with suppress(OSError, ValueError):
        found = json.loads((runs.folder_of(run) / "out" / "shown.json").read_text(encoding="utf-8"))
    found.pop("name", None)
    better, predicted = _correction(runs, run), None
    if better is not None:
        with suppress(OSError, ValueError):
            text = (runs.folder_of(better) / CORRECTION / "shown.json").read_text(encoding="utf-8")
            predicted = json.loads(text)
    return Measurement(
        id=run.id, name=run.name, run=run.of, state=line.state, sentence=run.sentence, progress=line.progress,
        correction=None if better is None else better.id, predicted=predicted, **found,
    )  # fmt: skip


def _correction(runs: Runs, run: Run) -> Run | None:
    """Return the last run that corrects by a measurement."""
    return next((one for one in runs.all() if one.kind == "correct" and one.of == run.id), None)


@router.get(
    "/{id}/map",
    response_class=Response,
    responses={
        200: {
            "description": PACKED,
            "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def measured_map(
    id: RunId,  # noqa: A002
    request: Request,
    name: Literal["measured", "residual", "predicted"] = "measured",
    nx: Pixels = 400,
    ny: Pixels = 400,
) -> Response:
    """Return the error as it was measured, what no cause explains of it, or what is predicted after the correction."""
    state = request.app.state
    run = the_run(request, id, "measure")
    folder = state.runs.folder_of(run) / "out"
    if name == "predicted":
        better = _correction(state.runs, run)
        if better is None:
            raise HTTPException(409, "nothing is predicted yet: choose what to correct first")
        folder = state.runs.folder_of(better) / CORRECTION
    file = folder / PICTURES[name]
    if not file.is_file():
        raise HTTPException(409, f"there is no {name} map yet: wait until it is done")
    packed = await state.workers.ask(shown.shown_map, str(file), state.runs.data(run), str(state.folder), nx, ny)
    return Response(packed, media_type=MEDIA_TYPE)


@router.post("/{id}/correct", status_code=201)
async def correct(id: RunId, chosen: Causes, request: Request) -> Id:  # noqa: A002
    """Queue a run that writes the job with some causes taken into account, and its program."""
    runs: Runs = request.app.state.runs
    run = the_run(request, id, "measure")
    if run.state != "done":
        raise HTTPException(409, f"the measurement is {run.state}: wait until it is done")
    told = json.loads((runs.folder_of(run) / "out" / "shown.json").read_text(encoding="utf-8"))
    known = list(dict.fromkeys(one["cause"] for one in told["findings"]))
    wrong = [cause for cause in chosen.causes if cause not in known]
    if wrong:
        raise HTTPException(
            422, f"the causes to correct can be {', '.join(known)}, {wrong} was chosen: choose of these"
        )
    data = runs.data(run)
    before = [cause for cause in known if cause in chosen.causes]
    # As at the command line: the job states which causes are corrected, the rest is compensated as form.
    data = {**data, "measurement": {**(data.get("measurement") or {}), "correct": before}}
    with runs.new_folder() as folder:
        try:
            (folder / run.file).hardlink_to(runs.folder_of(run) / run.file)
        except OSError:
            shutil.copyfile(runs.folder_of(run) / run.file, folder / run.file)
        name = f"{run.name}, corrected"
        made = runs.add(
            folder, data, kind="correct", name=name, text=runs.text(run), of=run.id, file=run.file,
            called=run.called, causes=tuple(before),
        )  # fmt: skip
    return Id(id=made.id)


@router.get("/{id}/files/{name}", response_class=FileResponse, responses=A_FILE)
async def measured_file(
    id: RunId,  # noqa: A002
    name: Literal["job", "program", "table", "report", "correction", "result"],
    request: Request,
    part: Annotated[int, Query(ge=0, le=100_000, description="Which of several.")] = 0,
) -> FileResponse:
    """Return the report and the numbers of a measurement, or the corrected job and program once they are there."""
    run = the_run(request, id, "measure")
    if name in ("report", "result"):
        return one_file(request, run, name, part)
    better = _correction(request.app.state.runs, run)
    if better is None:
        raise HTTPException(409, "nothing is corrected yet: choose what to correct first")
    return one_file(request, better, name, part)
