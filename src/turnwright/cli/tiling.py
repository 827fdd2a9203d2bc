"""The command of a whole part at a pixel of micrometres."""

from __future__ import annotations

import json
import math
import os
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from turnwright._io import part_of, write_whole
from turnwright.cli.shared import Door, JobFile, app, progress_of, warn
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from turnwright.job import Job
    from turnwright.studies import TiledMap

__all__: list[str] = []

MAP, BEGUN = "map.zarr", "case.json"
"""The map in its folder, and what says by which job, tile and program it was begun."""

PER_FEED = 4
"""Pixels from cusp to cusp below which a map beats with them."""


@app.command()
def tile(
    context: typer.Context,
    job: JobFile,
    pixel: Annotated[str, typer.Option(help='Of the map, such as "1 um".', show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for the map; what is in it of the same map is not made again.")],
    size: Annotated[int, typer.Option("--tile", help="Pixels along a tile, about.")] = 1024,
    cluster: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="A Dask scheduler whose workers see the folder.")
    ] = None,
) -> None:
    """Predict the error of the whole part at a pixel, of any size, in tiles: a map on disk, its roughness, a report."""
    door: Door = context.obj
    from turnwright.job import Job, finishing_motion  # noqa: PLC0415 - costly
    from turnwright.studies import (  # noqa: PLC0415
        case_key,
        generate_tiled,
        planned_layout,
    )
    from turnwright.units import parse  # noqa: PLC0415

    recipe = Job.load(job)
    step = parse(pixel, "mm")
    part, store = recipe.part, out / MAP
    # Whatever can be refused is refused before the part is planned, which may take minutes.
    _require_own(out)
    planned_layout(store, step, radius=part.radius, tile=size)
    key = case_key({"job": recipe.table(whole=True), "pixel": step, "tile": size})
    _require_same(out, key)
    with ExitStack() as stack:
        progress = stack.enter_context(progress_of(door.stop, _steps(recipe, step)))
        workers = None
        if cluster is not None:
            from turnwright.studies import cluster as workers_of  # noqa: PLC0415 - of an extra

            workers = stack.enter_context(workers_of(cluster))
        motion, result = finishing_motion(recipe, progress=progress)
        out.mkdir(parents=True, exist_ok=True)
        write_whole(out / BEGUN, json.dumps({"key": key}) + "\n")
        door.partly = f"the finished tiles stay in {str(out)!r}: the same command makes the others"
        made = generate_tiled(
            motion, recipe.actual_tool, machine=recipe.actual_machine, pixel=step, radius=part.radius,
            minus=part.surface, store=store, tile=size, executor=workers,
            progress=lambda done, total: progress("tiles", done, total),
        )  # fmt: skip
        asked = recipe.roughness.form
        form: Literal["none", "mean", "plane"] = "none" if asked == "none" else "mean" if asked == "mean" else "plane"
        rough = made.roughness(form=form, progress=lambda done, total: progress("roughness of the part", done, total))
        spectrum = made.area_psd(progress=lambda done, total: progress("spectrum", done, total)).radial()
        progress("report", 0, 1)
        from turnwright import report  # noqa: PLC0415 - matplotlib, only for a map that is there

        report.archive_tiled(made, rough, spectrum, out)
        report.write_tiled(recipe, made, rough, spectrum, out)
        progress("report", 1, 1)
    rows, columns = made.shape
    door.say(f"map: {columns} x {rows} pixels, {rough.valid} heights, in {store}")
    door.say(f"whole part: PV {rough.pv_nm:.4g} nm, Sq {rough.sq_nm:.4g} nm, Sa {rough.sa_nm:.4g} nm ({form} removed)")
    if form != asked:
        warn([f"the job removes {asked!r} before its roughness, a map in tiles takes a plane at most: a plane it was"])
    warn([*_doubts(made, result.passes[-1].feed), *result.warnings])
    door.say(f"report: {out / 'report.html'}")


def _steps(job: Job, pixel: float) -> tuple[Step, ...]:
    """Return what a map of a job takes: the program is planned and read again, then come the tiles."""
    from turnwright.job import steps_of_run  # noqa: PLC0415 - costly

    heights = math.pi * (job.part.radius / pixel) ** 2
    stages = {"tiles": 2e-6, "roughness of the part": 2e-7, "spectrum": 5e-7}
    *before, report = steps_of_run(job)
    return (*before, *(Step(stage=stage, work=work * heights) for stage, work in stages.items()), report)


def _require_own(out: Path) -> None:
    """Raise unless a map can be made, or gone on with, in a folder."""
    if out.is_dir():
        names = {one.name for one in out.iterdir()}
        if names - {BEGUN, part_of(out / BEGUN).name} and MAP not in names:
            raise InputError(f"{str(out)!r} is there already and holds something else: name another folder")
    folder = out.absolute()
    while not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(f"{str(folder)!r} is no folder, and the map needs one: name another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{str(folder)!r} cannot be written: change its rights, or name another folder")


def _require_same(out: Path, key: str) -> None:
    """Raise if the map in a folder was begun by another job."""
    begun = key
    with suppress(OSError, ValueError, KeyError, TypeError):  # of an older version, or not written to its end
        begun = json.loads((out / BEGUN).read_text(encoding="utf-8"))["key"]
    if begun != key and (out / MAP).exists():
        raise InputError(
            f"{str(out)!r} holds the map of another job, tile or version: name another folder, or delete it"
        )


def _doubts(made: TiledMap, feed: float) -> list[str]:
    """Say what is missing from a map, and whether its pixel shows the cusps as they are."""
    found = []
    if made.unreached:
        found.append(f"{made.unreached} pixels of the part are not reached by any pass")
    if max(made.pixel) > feed / PER_FEED:
        found.append(
            f"the pixel of {max(made.pixel) * 1e3:.3g} um beats with cusps {feed * 1e3:.3g} um apart: its heights are "
            f"right, slopes, pictures and spectrum want {feed / PER_FEED * 1e3:.3g} um or less"
        )
    return found
