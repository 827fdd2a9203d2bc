"""Command that simulates a whole part at micrometre resolution, in tiles."""

from __future__ import annotations

import json
import math
import os
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from turnwright._io import part_of, write_atomic
from turnwright.cli.shared import JobFile, Session, app, show_progress, warn
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from turnwright.job import Job
    from turnwright.studies import TiledMap

__all__: list[str] = []

MAP, CASE_FILE = "map.zarr", "case.json"
"""Names in the folder: the map, and the key of the job, tile size and version that started it."""

MIN_PIXELS_PER_FEED = 4
"""Pixels per cusp below which the map aliases the cusps."""


@app.command()
def tile(
    context: typer.Context,
    job: JobFile,
    pixel: Annotated[str, typer.Option(help='Pixel size, such as "1 um".', show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for the map; finished tiles of the same map are kept.")],
    size: Annotated[int, typer.Option("--tile", help="Approximate edge length of a tile in pixels.")] = 1024,
    cluster: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Dask scheduler whose workers can write the folder.")
    ] = None,
    device: Annotated[str, typer.Option(help='"cpu", or "cuda" for a graphics card of NVIDIA.')] = "cpu",
) -> None:
    """Simulate the whole part at micrometre resolution."""
    session: Session = context.obj
    from turnwright.generation import require_device  # noqa: PLC0415 - costly
    from turnwright.job import Job, finishing_motion  # noqa: PLC0415
    from turnwright.studies import (  # noqa: PLC0415
        case_key,
        generate_tiled,
        plan_tiles,
    )
    from turnwright.units import parse  # noqa: PLC0415

    recipe = Job.load(job)
    step = parse(pixel, "mm")
    part, store = recipe.part, out / MAP
    # Validate everything before planning, which may take minutes.
    _require_usable(out)
    if cluster is None:
        require_device(device)
    plan_tiles(store, step, radius=part.reach, tile=size)
    key = case_key({"job": recipe.table(whole=True), "pixel": step, "tile": size})
    _require_same_job(out, key)
    with ExitStack() as stack:
        progress = stack.enter_context(show_progress(session.stop, _steps(recipe, step)))
        workers = None
        if cluster is not None:
            from turnwright.studies import cluster as connect  # noqa: PLC0415 - needs an optional dependency

            workers = stack.enter_context(connect(cluster))
        motion, result = finishing_motion(recipe, progress=progress)
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(out / CASE_FILE, json.dumps({"key": key}) + "\n")
        session.partial = f"finished tiles are in {str(out)!r}: repeat the command to continue"
        tiled = generate_tiled(
            motion, recipe.actual_tool, machine=recipe.actual_machine, pixel=step, radius=part.reach,
            minus=part.surface, store=store, tile=size, device=device, executor=workers,
            progress=lambda done, total: progress("tiles", done, total),
        )  # fmt: skip
        requested = recipe.roughness.form
        form: Literal["none", "mean", "plane"] = (
            "none" if requested == "none" else "mean" if requested == "mean" else "plane"
        )
        rough = tiled.roughness(form=form, progress=lambda done, total: progress("roughness of the part", done, total))
        spectrum = tiled.area_psd(progress=lambda done, total: progress("spectrum", done, total)).radial()
        progress("report", 0, 1)
        from turnwright import report  # noqa: PLC0415 - imports matplotlib, needed only after success

        report.archive_tiled(tiled, rough, spectrum, out)
        report.write_tiled(recipe, tiled, rough, spectrum, out)
        progress("report", 1, 1)
    rows, columns = tiled.shape
    session.echo(f"map: {columns} x {rows} pixels, {rough.valid} heights, in {store}")
    session.echo(
        f"whole part: PV {rough.pv_nm:.4g} nm, Sq {rough.sq_nm:.4g} nm, Sa {rough.sa_nm:.4g} nm ({form} removed)"
    )
    if form != requested:
        warn([f"a tiled map can remove a plane at most, the job states {requested!r}: a plane was removed"])
    warn([*_check_map(tiled, result.passes[-1].feed), *result.warnings])
    session.echo(f"report: {out / 'report.html'}")


def _steps(job: Job, pixel: float) -> tuple[Step, ...]:
    """Return the stages: those of a run, then the tiles, their roughness and spectrum."""
    from turnwright.job import steps_of_run  # noqa: PLC0415 - costly

    heights = math.pi * (job.part.reach / pixel) ** 2
    stages = {"tiles": 2e-6, "roughness of the part": 2e-7, "spectrum": 5e-7}
    *before, report = steps_of_run(job)
    return (*before, *(Step(stage=stage, work=work * heights) for stage, work in stages.items()), report)


def _require_usable(out: Path) -> None:
    """Raise unless a map can be created or continued in a folder."""
    if out.is_dir():
        names = {path.name for path in out.iterdir()}
        if names - {CASE_FILE, part_of(out / CASE_FILE).name} and MAP not in names:
            raise InputError(f"{str(out)!r} already exists and holds other files: choose another folder")
    folder = out.absolute()
    while not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(f"{str(folder)!r} is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{str(folder)!r} is not writable: change its permissions, or choose another folder")


def _require_same_job(out: Path, key: str) -> None:
    """Raise if the map in a folder belongs to another job."""
    stored_key = key
    with suppress(OSError, ValueError, KeyError, TypeError):  # from an older version, or incomplete
        stored_key = json.loads((out / CASE_FILE).read_text(encoding="utf-8"))["key"]
    if stored_key != key and (out / MAP).exists():
        raise InputError(
            f"{str(out)!r} holds the map of another job, tile size or version: choose another folder, or delete it"
        )


def _check_map(tiled: TiledMap, feed: float) -> list[str]:
    """Return warnings about uncut pixels and about aliased cusps."""
    warnings = []
    if tiled.unreached:
        warnings.append(f"{tiled.unreached} pixels of the part are not cut")
    if max(tiled.pixel) > feed / MIN_PIXELS_PER_FEED:
        warnings.append(
            f"the pixel of {max(tiled.pixel) * 1e3:.3g} um aliases cusps at a feed of {feed * 1e3:.3g} um/rev: heights "
            f"are correct, slopes, pictures and spectrum need {feed / MIN_PIXELS_PER_FEED * 1e3:.3g} um or less"
        )
    return warnings
