"""The commands of a part that was measured."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright._io import write_whole
from turnwright.cli.shared import (
    Door,
    Folder,
    Force,
    JobFile,
    app,
    end_by,
    new_folder,
    progress_of,
    require_new,
    warn,
)
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.diagnosis import Diagnosis
    from turnwright.job import Job, Measured
    from turnwright.progress import StageProgress

__all__: list[str] = []

SAID = 0.1
"""Share of what was measured from which a source is named that is not corrected."""

HEIGHT_BYTES = 8
"""Of a height in a file, usually."""

Maps = Annotated[
    list[Path],
    typer.Argument(metavar="MAP...", help="What the instrument wrote, in any of its formats.", show_default=False),
]
MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="What the instrument wrote.", show_default=False)]
JobOption = Annotated[Path, typer.Option("--job", help="The job that cut the part.", show_default=False)]
Unit = Annotated[str | None, typer.Option(help='Of the heights of a text file that states none, such as "um".')]
Keys = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help='A key of the job\'s table measurement for this run, such as "clocking=20 deg"; may be repeated.',
        default_factory=list,
        show_default=False,
    ),
]
Jobs = Annotated[
    list[Path],
    typer.Option(
        "--job", help="The job that cut the part; for several maps one for all, or one for each.", show_default=False
    ),
]


@app.command()
def artefact(
    context: typer.Context,
    job: JobFile,
    kind: Annotated[str, typer.Option(metavar="KIND", help='"tilted flat" or "concave sphere".', show_default=False)],
    out: Annotated[Path, typer.Option(metavar="JOB.toml", help="The job of the artefact.", show_default=False)],
    radius: Annotated[
        str | None, typer.Option(help='Clear radius such as "5 mm"; that of the part if not given.')
    ] = None,
    slope: Annotated[
        str | None,
        typer.Option(help='Tilt, or slope at the rim, such as "3 deg"; what the part asks of the nose if not given.'),
    ] = None,
) -> None:
    """Write the job of an artefact that is cut as the part will be, to find out tool and machine beforehand."""
    door: Door = context.obj
    from turnwright.job import Job, artefact, edited  # noqa: PLC0415
    from turnwright.units import parse  # noqa: PLC0415

    require_new(out)
    recipe = Job.load(job)
    text = job.read_bytes().decode()
    with progress_of(door.stop, [Step(stage="speed of the part", work=3.0)]) as progress:
        made = artefact(
            recipe,
            kind,  # type: ignore[arg-type] # any other is refused in words
            radius=None if radius is None else parse(radius, "mm"),
            slope=None if slope is None else parse(slope, "rad"),
            progress=progress,
        )
    write_whole(out, edited(text, recipe, made, folder=job.absolute().parent, into=out.absolute().parent))
    door.say(f"{made.part.name}: radius {made.part.radius:g} mm, {made.strategy.spindle_rpm:.4g} rpm")
    door.say(f"job: {out}")


@app.command()
def measure(
    context: typer.Context, file: MapFile, job: JobOption, out: Folder, keys: Keys, unit: Unit = None,
    force: Force = False,
) -> None:  # fmt: skip
    """Register a measured map to its part and say how far the part is off."""
    door: Door = context.obj
    from turnwright.job import steps_of_measurement  # noqa: PLC0415

    with (
        new_folder(out, door, force=force) as folder,
        progress_of(door.stop, steps_of_measurement(_heights([file]))) as progress,
    ):
        measured = _measured([file], [job], progress, unit, keys)[0]
        progress("report", 0, 1)
        from turnwright.report import archive_measured, write_measured  # noqa: PLC0415 - costly to import

        archive_measured(measured, folder)
        write_measured(measured, folder)
        progress("report", 1, 1)
    _say_measured(door, [measured])
    for verdict in measured.verdicts:
        door.say(verdict.sentence)
    door.say(f"report: {out / 'report.html'}")
    end_by(door, measured.verdicts)


@app.command()
def diagnose(
    context: typer.Context, files: Maps, job: Jobs, out: Folder, keys: Keys, unit: Unit = None, force: Force = False
) -> None:
    """Say why measured parts are off: tool, machine or mount, each with its uncertainty."""
    door: Door = context.obj
    from turnwright.job import steps_of_diagnosis  # noqa: PLC0415

    with (
        new_folder(out, door, force=force) as folder,
        progress_of(door.stop, steps_of_diagnosis(_heights(files))) as progress,
    ):
        from turnwright.job import diagnose  # noqa: PLC0415

        measured = _measured(files, job, progress, unit, keys)
        found = diagnose(measured, progress=progress)
        progress("report", 0, 1)
        from turnwright.report import archive_diagnosis, write_diagnosis  # noqa: PLC0415 - costly to import

        archive_diagnosis(measured, found, folder)
        write_diagnosis(measured, found, folder)
        progress("report", 1, 1)
    _say_measured(door, measured)
    _say_causes(door, found)
    door.say(f"report: {out / 'report.html'}")


@app.command()
def correct(
    context: typer.Context,
    files: Maps,
    job: Jobs,
    out: Folder,
    keys: Keys,
    of: Annotated[
        Path | None,
        typer.Option("--of", metavar="JOB.toml", help="The job to correct, if it is not the one that was measured."),
    ] = None,
    unit: Unit = None,
    force: Force = False,
) -> None:
    """Write the job that takes what was found into account, and predict what it leaves."""
    door: Door = context.obj
    from turnwright.job import steps_of_correction  # noqa: PLC0415

    with (
        new_folder(out, door, force=force) as folder,
        progress_of(door.stop, steps_of_correction(_heights(files))) as progress,
    ):
        from turnwright.job import correct, diagnose  # noqa: PLC0415

        measured = _measured(files, job, progress, unit, keys)
        found = diagnose(measured, progress=progress)
        if of is None:
            better = correct(measured[0].job, found, measured, out=folder, source=job[0], progress=progress)
        else:
            better = correct(_job(of, keys), found, measured, out=folder, source=of, progress=progress)
        progress("report", 0, 1)
        from turnwright.report import archive_correction, write_correction  # noqa: PLC0415 - costly to import

        archive_correction(measured, found, better, folder)
        write_correction(measured, found, better, folder)
        progress("report", 1, 1)
    _say_measured(door, measured)
    _say_causes(door, found)
    for sentence in better.sentences:
        door.say(sentence)
    for name, (pv, rms) in better.numbers_nm.items():
        door.say(f"{name}: PV {pv:.4g} nm, rms {rms:.4g} nm")
    for verdict in better.verdicts:
        door.say(f"corrected: {verdict.sentence}")
    door.say(f"job: {out / 'job.toml'}")
    door.say(f"report: {out / 'report.html'}")
    end_by(door, better.verdicts)


def _heights(files: Sequence[Path]) -> list[float]:
    """Return about how many heights maps have."""
    return [file.stat().st_size / HEIGHT_BYTES if file.is_file() else 0.0 for file in files]


def _job(file: Path, keys: Sequence[str]) -> Job:
    """Load a job with some keys of its measurement replaced."""
    from turnwright.job import Job  # noqa: PLC0415

    job = Job.load(file)
    if not keys:
        return job
    table = job.table()
    for one in keys:
        key, equals, value = (part.strip() for part in one.partition("="))
        if not (key and equals and value):
            raise InputError(f'--set is {one!r}, it must be KEY=VALUE, such as "clocking=20 deg"')
        try:
            stated = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            stated = value  # a word or a quantity need no quotes here
        table.setdefault("measurement", {})[key] = stated
    return Job.read(table)


def _measured(
    files: Sequence[Path], jobs: Sequence[Path], progress: StageProgress, unit: str | None, keys: Sequence[str]
) -> list[Measured]:
    """Read every map and register it to its part."""
    from turnwright.job import measure, read_measurement  # noqa: PLC0415

    if len(jobs) not in (1, len(files)):
        raise InputError(
            f"{len(files)} maps and {len(jobs)} jobs are given, there must be 1 job for all, or one for each map in "
            "their order: state --job as often"
        )
    recipes = [_job(job, keys) for job in jobs]
    return [
        measure(recipe, read_measurement(recipe, file, unit=unit), progress=progress)
        for file, recipe in zip(files, recipes * (len(files) // len(recipes)), strict=True)
    ]


def _say_measured(door: Door, measured: Sequence[Measured]) -> None:
    for one in measured:
        door.say(
            f"{one.heights.name or one.job.part.name}: form error PV {one.form_pv_nm:.4g} nm, rms "
            f"{one.form_rms_nm:.4g} nm; {one.spikes} spikes taken out"
        )
        if one.lenslets is not None:
            door.say(one.lenslets.summary)
        for sentence in one.as_seen:
            door.say(sentence)
        if one.axis is not None:
            door.say(f"axis of turning from the {one.axis.source}, within {1e3 * max(one.axis.std):.2g} um")
        warn(one.open_questions)


def _say_causes(door: Door, found: Diagnosis) -> None:
    for one in found:
        if one.verdict == "correct" or one.rms_nm > SAID * found.measured_rms_nm:
            door.say(f"{one.verdict}: {one.why}")
    for term in found.contributions:
        if term.rms_nm > SAID * found.measured_rms_nm:
            door.say(term.why)
    door.say(found.summary)
