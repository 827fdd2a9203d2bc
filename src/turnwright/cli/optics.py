"""Command that tells what a surface does to light."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.measuring import Keys, load_job, register_maps
from turnwright.cli.shared import Folder, Force, Session, Unit, app, new_folder, show_progress
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from turnwright.job import Job, OpticalPerformance
    from turnwright.progress import StageProgress

__all__: list[str] = []


@app.command()
def optics(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="JOB.toml|MAP", help="A job, or a measured map.", show_default=False)],
    out: Folder,
    keys: Keys,
    job: Annotated[Path | None, typer.Option("--job", help="The job that cut the measured part.")] = None,
    wavelength: Annotated[str | None, typer.Option(help='Wavelength for a map alone, such as "633 nm".')] = None,
    index: Annotated[float | None, typer.Option(help="Index of the material of such a map, unless a mirror.")] = None,
    form: Annotated[str, typer.Option(help='Form to remove from it: "mean", "plane", "sphere" or a degree.')] = "plane",
    unit: Unit = None,
    force: Force = False,
) -> None:
    """Predict wavefront, PSF, MTF and scatter.

    The table [optics] of the job states the light. A map without a job is that of the error itself: of a flat, or of
    a surface whose form is removed.
    """
    session: Session = context.obj
    with new_folder(out, session, force=force) as folder:
        steps = [Step(stage="optics", work=2.0), Step(stage="report", work=2.0)]
        with show_progress(session.stop, steps) as progress:
            if job is None and file.suffix.lower() != ".toml":
                recipe, performance = None, _of_map(file, unit, wavelength, index, form)
            elif wavelength is not None or index is not None:
                raise InputError("--wavelength and --index apply to a map without a job: state [optics] in the job")
            else:
                recipe, performance = _of_job(file, job, keys, unit, progress)
            progress("report", 0, 1)
            from turnwright.report import archive_optics, write_optics  # noqa: PLC0415 - costly to import

            archive_optics(performance, folder)
            if recipe is not None:
                write_optics(recipe, performance, folder)
            progress("report", 1, 1)
    from turnwright.report import optics_facts  # noqa: PLC0415

    for name, value in optics_facts(performance).items():
        session.echo(f"{name}: {value}")
    session.echo(f"report: {out / 'report.html'}" if recipe is not None else f"numbers: {out / 'result.json'}")


def _of_map(file: Path, unit: str | None, wavelength: str | None, index: float | None, form: str) -> OpticalPerformance:
    """Return the performance of a map without a job, and its scatter as far as its pixels resolve marks."""
    from turnwright.files import read_map  # noqa: PLC0415 - costly
    from turnwright.job import OpticalPerformance  # noqa: PLC0415
    from turnwright.metrology import remove_form  # noqa: PLC0415
    from turnwright.optics import scatter, wavefront  # noqa: PLC0415
    from turnwright.units import parse  # noqa: PLC0415

    if wavelength is None:
        raise InputError(f"{file.name} is a map, it needs --wavelength, or --job with an [optics] table: state one")
    kind = int(form) if form.isdigit() else form
    error, light = remove_form(read_map(file, unit=unit), kind), parse(wavelength, "mm")
    marks = {} if error.polar else {error.name or "map": scatter(error, wavelength=light, index=index, form=kind)}
    return OpticalPerformance(wavefront=wavefront(error, wavelength=light, index=index), marks=marks)


def _of_job(
    file: Path, job: Path | None, keys: list[str], unit: str | None, progress: StageProgress
) -> tuple[Job, OpticalPerformance]:
    """Return the job and its predicted performance, or that of a measured map."""
    from turnwright.job import Pipeline, measured_optics  # noqa: PLC0415 - costly

    if job is None:
        recipe = load_job(file, keys)
        return recipe, Pipeline(recipe, progress=progress).optics
    measured = register_maps([file], [job], progress, unit, keys)[0]
    return measured.job, measured_optics(measured)
