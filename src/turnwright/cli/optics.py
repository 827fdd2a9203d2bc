"""Command that tells what a surface does to light."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.measuring import Keys, load_job, register_maps
from turnwright.cli.shared import Folder, Force, Session, Unit, app, new_folder, show_progress
from turnwright.progress import Step

if TYPE_CHECKING:
    from turnwright.job import Job, OpticalPerformance
    from turnwright.progress import StageProgress

__all__: list[str] = []


@app.command()
def optics(
    context: typer.Context,
    file: Annotated[
        Path, typer.Argument(metavar="JOB.toml|MAP", help="A job, or a measured map of it.", show_default=False)
    ],
    out: Folder,
    keys: Keys,
    job: Annotated[Path | None, typer.Option("--job", help="The job that cut the measured part.")] = None,
    unit: Unit = None,
    force: Force = False,
) -> None:
    """Predict wavefront, PSF, MTF and scatter.

    The table [optics] of the job states the light.
    """
    session: Session = context.obj
    with new_folder(out, session, force=force) as folder:
        steps = [Step(stage="optics", work=2.0), Step(stage="report", work=2.0)]
        with show_progress(session.stop, steps) as progress:
            recipe, performance = _performance(file, job, keys, unit, progress)
            progress("report", 0, 1)
            from turnwright.report import archive_optics, write_optics  # noqa: PLC0415 - costly to import

            archive_optics(performance, folder)
            write_optics(recipe, performance, folder)
            progress("report", 1, 1)
    from turnwright.report import optics_facts  # noqa: PLC0415

    for name, value in optics_facts(performance).items():
        session.echo(f"{name}: {value}")
    session.echo(f"report: {out / 'report.html'}")


def _performance(
    file: Path, job: Path | None, keys: list[str], unit: str | None, progress: StageProgress
) -> tuple[Job, OpticalPerformance]:
    """Return the job and its predicted performance, or that of a measured map."""
    from turnwright.job import Pipeline, measured_optics  # noqa: PLC0415 - costly

    if job is None:
        recipe = load_job(file, keys)
        return recipe, Pipeline(recipe, progress=progress).optics
    measured = register_maps([file], [job], progress, unit, keys)[0]
    return measured.job, measured_optics(measured)
