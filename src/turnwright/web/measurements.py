"""Routes of measured parts: upload, diagnosis and correction."""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import FileResponse, Response

from turnwright.web import measurement_data
from turnwright.web.files import RAW_BODY, stored, uploaded
from turnwright.web.guard import UPLOAD_BYTES
from turnwright.web.limits import MAP_TYPES, MAX_FILE_READ_S
from turnwright.web.models import ErrorSources, FileName, Id, Measurement, RunId
from turnwright.web.queue import Run, Runs
from turnwright.web.references import CORRECTION, display_name
from turnwright.web.runs import A_FILE, find_run, job_of, line_of, send_file
from turnwright.web.views import ARRAYS, PackedResponse

__all__ = ["router"]

router = APIRouter(prefix="/api/measurements", tags=["measurements"])

Pixels = Annotated[int, Query(ge=2, le=2048)]
PICTURES = {"measured": "error.npz", "residual": "left-1.npz", "predicted": "predicted.npz"}


def _map_suffix(name: str) -> str:
    """Return the extension of a map file; refuse any that is not of a supported format."""
    suffix = File(name.replace("\\", "/")).suffix.lower()
    if suffix not in MAP_TYPES:
        raise HTTPException(422, f"a measured map must end in {', '.join(MAP_TYPES)}, got {suffix[:12]!r}")
    return suffix


@router.post("", status_code=201, openapi_extra=RAW_BODY)
async def bring(
    request: Request,
    run: Annotated[str, Query(pattern="^[0-9a-f]{16}$", description="Identifier of the run that cut the part.")],
    name: FileName,
) -> Id:
    """Upload a measured map; it is registered to its part and diagnosed."""
    runs: Runs = request.app.state.runs
    cut = find_run(request, run, "run", "correct")
    if cut.state != "done":
        raise HTTPException(409, f"the run must be done, it is {cut.state}")
    suffix = _map_suffix(name)
    with runs.new_folder() as folder:
        # The name on disk does not depend on the name of the upload.
        file = folder / f"measured{suffix}"
        await stored(request, file, UPLOAD_BYTES)
        measured = runs.add(
            folder, job_of(runs, cut), kind="measure", name=display_name(name), text=runs.text(cut), of=cut.id,
            file=file.name, called=display_name(name),
        )  # fmt: skip
    return Id(id=measured.id)


@router.post("/show", response_class=Response, openapi_extra=RAW_BODY, responses=ARRAYS)
async def show(
    request: Request,
    name: FileName,
) -> Response:
    """Return the picture and the facts of a measured map without a job; nothing is stored."""
    state = request.app.state
    suffix = _map_suffix(name)
    async with uploaded(request, suffix) as (file, *_):
        packed = await state.workers.ask(
            measurement_data.lone_map, str(file), display_name(name), limit_s=MAX_FILE_READ_S
        )
    return PackedResponse(packed)


@router.get("/{id}")
async def measurement(id: RunId, request: Request) -> Measurement:  # noqa: A002 - the name in the API
    """Return the diagnosis of a measured map."""
    runs: Runs = request.app.state.runs
    run = find_run(request, id, "measure")
    line = line_of(runs, run)
    numbers: dict[str, Any] = {}
    with suppress(OSError, ValueError):
        numbers = json.loads((runs.folder_of(run) / "out" / "shown.json").read_text(encoding="utf-8"))
    numbers.pop("name", None)
    correction, predicted = _correction(runs, run), None
    if correction is not None:
        with suppress(OSError, ValueError):
            text = (runs.folder_of(correction) / CORRECTION / "shown.json").read_text(encoding="utf-8")
            predicted = json.loads(text)
    return Measurement(
        id=run.id, name=run.name, run=run.of, state=line.state, sentence=run.sentence, progress=line.progress,
        correction=None if correction is None else correction.id, predicted=predicted, **numbers,
    )  # fmt: skip


def _correction(runs: Runs, run: Run) -> Run | None:
    """Return the last correction of a measurement."""
    return next((one for one in runs.all() if one.kind == "correct" and one.of == run.id), None)


@router.get("/{id}/map", response_class=Response, responses=ARRAYS)
async def measured_map(
    id: RunId,  # noqa: A002
    request: Request,
    name: Literal["measured", "residual", "predicted"] = "measured",
    nx: Pixels = 400,
    ny: Pixels = 400,
) -> Response:
    """Return the measured error, its residual after diagnosis, or the predicted residual after correction."""
    state = request.app.state
    run = find_run(request, id, "measure")
    folder = state.runs.folder_of(run) / "out"
    if name == "predicted":
        better = _correction(state.runs, run)
        if better is None:
            raise HTTPException(409, "nothing is predicted yet: choose the error sources to correct")
        folder = state.runs.folder_of(better) / CORRECTION
    file = folder / PICTURES[name]
    if not file.is_file():
        raise HTTPException(409, f"there is no {name} map yet")
    packed = await state.workers.ask(
        measurement_data.map_picture, str(file), state.runs.data(run), str(state.folder), nx, ny
    )
    return PackedResponse(packed)


@router.post("/{id}/correct", status_code=201)
async def correct(id: RunId, chosen: ErrorSources, request: Request) -> Id:  # noqa: A002
    """Queue a run that corrects some error sources and writes the job and its program."""
    runs: Runs = request.app.state.runs
    run = find_run(request, id, "measure")
    if run.state != "done":
        raise HTTPException(409, f"the measurement must be done, it is {run.state}")
    shown_numbers = json.loads((runs.folder_of(run) / "out" / "shown.json").read_text(encoding="utf-8"))
    error_sources = list(dict.fromkeys(one["error_source"] for one in shown_numbers["findings"]))
    unknown = [error_source for error_source in chosen.error_sources if error_source not in error_sources]
    if unknown:
        raise HTTPException(422, f"error_sources must be among {', '.join(error_sources)}, got {unknown}")
    data = runs.data(run)
    chosen_sources = [error_source for error_source in error_sources if error_source in chosen.error_sources]
    # As on the command line: the job states the sources to correct, all others are compensated as form.
    data = {**data, "measurement": {**(data.get("measurement") or {}), "correct": chosen_sources}}
    with runs.new_folder() as folder:
        try:
            (folder / run.file).hardlink_to(runs.folder_of(run) / run.file)
        except OSError:
            shutil.copyfile(runs.folder_of(run) / run.file, folder / run.file)
        name = f"{run.name}, corrected"
        new_run = runs.add(
            folder, data, kind="correct", name=name, text=runs.text(run), of=run.id, file=run.file,
            called=run.called, error_sources=tuple(chosen_sources),
        )  # fmt: skip
    return Id(id=new_run.id)


@router.get("/{id}/files/{name}", response_class=FileResponse, responses=A_FILE)
async def measured_file(
    id: RunId,  # noqa: A002
    name: Literal["job", "program", "table", "report", "correction", "result"],
    request: Request,
    part: Annotated[int, Query(ge=0, le=100_000, description="Which of several.")] = 0,
) -> FileResponse:
    """Return the report and numbers of a measurement, or the corrected job and program."""
    run = find_run(request, id, "measure")
    if name in ("report", "result"):
        return send_file(request, run, name, part)
    better = _correction(request.app.state.runs, run)
    if better is None:
        raise HTTPException(409, "nothing is corrected yet: choose the error sources to correct")
    return send_file(request, better, name, part)
