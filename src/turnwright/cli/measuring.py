"""Commands for measured parts: test-part, measure, diagnose and correct."""

from __future__ import annotations

import tomllib
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import (
    Folder,
    Force,
    JobFile,
    Session,
    Unit,
    app,
    exit_on_missed,
    new_folder,
    parse_option,
    require_unused,
    show_progress,
    warn,
    write_edited,
)
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.diagnosis import Diagnosis
    from turnwright.job import Job, Measured
    from turnwright.progress import StageProgress

__all__ = ["Keys", "load_job", "register_maps"]

MIN_LISTED_FRACTION = 0.1
"""Smallest contribution to the measured rms at which an error source that is not corrected is listed."""

TYPICAL_HEIGHT_BYTES = 8
"""File size per measured height, for the progress estimate."""

Maps = Annotated[
    list[Path],
    typer.Argument(metavar="MAP...", help="Measured maps, in any supported format.", show_default=False),
]
MapFile = Annotated[
    Path, typer.Argument(metavar="MAP", help="Measured map, in any supported format.", show_default=False)
]
JobOption = Annotated[Path, typer.Option("--job", help="The job that cut the part.", show_default=False)]
Keys = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help='Override a key of the job\'s measurement table, such as "clocking=20 deg"; repeatable.',
        default_factory=list,
        show_default=False,
    ),
]
Jobs = Annotated[
    list[Path],
    typer.Option("--job", help="The job that cut the part: one for all maps, or one per map.", show_default=False),
]


@app.command("test-part")
def write_test_part(
    context: typer.Context,
    job: JobFile,
    kind: Annotated[str, typer.Option(metavar="KIND", help='"tilted flat" or "concave sphere".', show_default=False)],
    out: Annotated[
        Path, typer.Option(metavar="JOB.toml", help="The job of the test part to write.", show_default=False)
    ],
    radius: Annotated[
        str | None,
        typer.Option(help='Semi-diameter of the clear aperture, such as "5 mm"; by default that of the part.'),
    ] = None,
    slope: Annotated[
        str | None,
        typer.Option(
            help='Tilt or edge slope, such as "3 deg"; by default it uses the same arc of the tool nose as the part.'
        ),
    ] = None,
) -> None:
    """Write the job of a diamond-turned test part.

    It is cut like the part, so that measuring it reveals tool and machine errors before the part is cut.
    """
    session: Session = context.obj
    from turnwright.job import Job, make_test_part  # noqa: PLC0415
    from turnwright.units import parse  # noqa: PLC0415

    require_unused(out)
    recipe = Job.load(job)
    with show_progress(session.stop, [Step(stage="speed of the part", work=3.0)]) as progress:
        made = make_test_part(
            recipe,
            kind,  # type: ignore[arg-type] # any other kind raises InputError
            radius=None if radius is None else parse(radius, "mm"),
            slope=None if slope is None else parse(slope, "rad"),
            progress=progress,
        )
    write_edited(out, job, recipe, made)
    session.echo(f"{made.part.name}: radius {made.part.reach:g} mm, {made.strategy.spindle_rpm:.4g} rpm")
    session.echo(f"job: {out}")


@app.command()
def measure(
    context: typer.Context, file: MapFile, job: JobOption, out: Folder, keys: Keys, unit: Unit = None,
    force: Force = False,
) -> None:  # fmt: skip
    """Register a measured map and report form error."""
    session: Session = context.obj
    from turnwright.job import steps_of_measurement  # noqa: PLC0415

    with (
        new_folder(out, session, force=force) as folder,
        show_progress(session.stop, steps_of_measurement(_heights([file]))) as progress,
    ):
        measured = register_maps([file], [job], progress, unit, keys)[0]
        progress("report", 0, 1)
        from turnwright.report import archive_measured, write_certificate, write_measured  # noqa: PLC0415 - costly to import

        archive_measured(measured, folder)
        write_measured(measured, folder)
        write_certificate(measured, folder, [file])
        progress("report", 1, 1)
    _print_measured(session, [measured])
    for verdict in measured.verdicts:
        session.echo(verdict.sentence)
    session.echo(f"report: {out / 'report.html'}")
    if measured.verdicts:
        session.echo(f"certificate: {out / 'certificate.html'}")
    exit_on_missed(session, measured.verdicts)


@app.command()
def diagnose(
    context: typer.Context, files: Maps, job: Jobs, out: Folder, keys: Keys, unit: Unit = None, force: Force = False
) -> None:
    """Attribute form error to tool, machine or mount."""
    session: Session = context.obj
    from turnwright.job import steps_of_diagnosis  # noqa: PLC0415

    with (
        new_folder(out, session, force=force) as folder,
        show_progress(session.stop, steps_of_diagnosis(_heights(files))) as progress,
    ):
        from turnwright.job import diagnose  # noqa: PLC0415

        measured = register_maps(files, job, progress, unit, keys)
        diagnosis = diagnose(measured, progress=progress)
        progress("report", 0, 1)
        from turnwright.report import archive_diagnosis, write_diagnosis  # noqa: PLC0415 - costly to import

        archive_diagnosis(measured, diagnosis, folder)
        write_diagnosis(measured, diagnosis, folder)
        progress("report", 1, 1)
    _print_measured(session, measured)
    _print_sources(session, diagnosis)
    session.echo(f"report: {out / 'report.html'}")


@app.command()
def correct(
    context: typer.Context,
    files: Maps,
    job: Jobs,
    out: Folder,
    keys: Keys,
    of: Annotated[
        Path | None,
        typer.Option("--of", metavar="JOB.toml", help="The job to correct; by default the job that cut the part."),
    ] = None,
    unit: Unit = None,
    force: Force = False,
) -> None:
    """Write a corrected job and predict its residual."""
    session: Session = context.obj
    from turnwright.job import steps_of_correction  # noqa: PLC0415

    with (
        new_folder(out, session, force=force) as folder,
        show_progress(session.stop, steps_of_correction(_heights(files))) as progress,
    ):
        from turnwright.job import correct, diagnose  # noqa: PLC0415

        measured = register_maps(files, job, progress, unit, keys)
        diagnosis = diagnose(measured, progress=progress)
        base = load_job(of or job[0], keys)
        correction = correct(base, diagnosis, measured, out=folder, source=of or job[0], progress=progress)
        progress("report", 0, 1)
        from turnwright.report import archive_correction, write_correction  # noqa: PLC0415 - costly to import

        archive_correction(measured, diagnosis, correction, folder)
        write_correction(measured, diagnosis, correction, folder)
        progress("report", 1, 1)
    _print_measured(session, measured)
    _print_sources(session, diagnosis)
    for sentence in correction.sentences:
        session.echo(sentence)
    for name, (pv, rms) in correction.numbers_nm.items():
        session.echo(f"{name}: PV {pv:.4g} nm, rms {rms:.4g} nm")
    for verdict in correction.verdicts:
        session.echo(f"corrected: {verdict.sentence}")
    session.echo(f"job: {out / 'job.toml'}")
    session.echo(f"report: {out / 'report.html'}")
    exit_on_missed(session, correction.verdicts)


def _heights(files: Sequence[Path]) -> list[float]:
    """Estimate the number of heights of each map from its file size."""
    return [file.stat().st_size / TYPICAL_HEIGHT_BYTES if file.is_file() else 0.0 for file in files]


def load_job(file: Path, keys: Sequence[str]) -> Job:
    """Load a job and apply the ``--set`` options to its measurement table."""
    from turnwright.job import Job  # noqa: PLC0415

    job = Job.load(file)
    if not keys:
        return job
    table = job.table()
    for option in keys:
        key, value = parse_option("--set", option, "KEY=VALUE", "clocking=20 deg")
        stated: object = value  # words and quantities need no quotes on the command line
        with suppress(tomllib.TOMLDecodeError):
            stated = tomllib.loads(f"value = {value}")["value"]
        table.setdefault("measurement", {})[key] = stated
    return Job.read(table)


def register_maps(
    files: Sequence[Path], jobs: Sequence[Path], progress: StageProgress, unit: str | None, keys: Sequence[str]
) -> list[Measured]:
    """Read each map and register it to its part."""
    from turnwright.job import measure, read_measurement  # noqa: PLC0415

    if len(jobs) not in (1, len(files)):
        raise InputError(
            f"--job must be given once, or once for each map in their order, got {len(jobs)} jobs for {len(files)} maps"
        )
    recipes = [load_job(job, keys) for job in jobs]
    return [
        measure(recipe, read_measurement(recipe, file, unit=unit), progress=progress)
        for file, recipe in zip(files, recipes * (len(files) // len(recipes)), strict=True)
    ]


def _print_measured(session: Session, measured: Sequence[Measured]) -> None:
    for part in measured:
        session.echo(
            f"{part.heights.name or part.job.part.name}: form error PV {part.form_pv_nm:.4g} nm, rms "
            f"{part.form_rms_nm:.4g} nm; {part.outliers} outliers removed"
        )
        if part.lenslets is not None:
            session.echo(part.lenslets.summary)
        for sentence in part.as_seen:
            session.echo(sentence)
        if part.axis is not None:
            session.echo(
                f"turning axis from the {part.axis.source}, standard uncertainty {1e3 * max(part.axis.std):.2g} um"
            )
        warn(part.open_questions)


def _print_sources(session: Session, diagnosis: Diagnosis) -> None:
    smallest = MIN_LISTED_FRACTION * diagnosis.measured_rms_nm
    for source in diagnosis:
        if source.verdict == "correct" or source.rms_nm > smallest:
            session.echo(f"{source.verdict}: {source.explanation}")
    for term in diagnosis.contributions:
        if term.rms_nm > smallest:
            session.echo(term.explanation)
    session.echo(diagnosis.summary)
