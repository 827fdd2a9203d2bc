"""The commands of a part that is to be cut."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.batch import run_batch, run_into
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
from turnwright.errors import InputError, JobError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.job import Job, Prediction
    from turnwright.path import Motion
    from turnwright.progress import StageProgress

__all__: list[str] = []

BYTES_PER_S = 5e7
"""Of a program that is read."""


@app.command()
def run(
    context: typer.Context,
    jobs: Annotated[
        list[Path], typer.Argument(metavar="JOB.toml...", help="The job file, or several.", show_default=False)
    ],
    out: Folder,
    force: Force = False,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="How many of several jobs run at a time.", show_default="as cores and memory allow"
        ),
    ] = None,
) -> None:
    """Check, plan, place, drive, write the program, read it back, predict the surface it leaves, and report.

    Several jobs run side by side, each into a folder of its own in the folder for the results; one that fails does not
    hold up the others, and one that is done already is not done again.
    """
    door: Door = context.obj
    if len(jobs) > 1:
        run_batch(jobs, out, door, force=force, workers=workers)
        return
    with new_folder(out, door, force=force) as folder:
        from turnwright.job import Job, steps_of_run  # noqa: PLC0415 - costly

        recipe = Job.load(jobs[0])
        with progress_of(door.stop, steps_of_run(recipe)) as progress:
            result = run_into(folder, recipe, progress)
    for cut in result.passes:
        door.say(
            f"{cut.name}: {cut.points} points, {cut.limits.cycle_time_s / 60:.1f} min at {cut.spindle_rpm:.4g} rpm, "
            f"{cut.limits.binding} binds"
        )
        if cut.chips is not None:
            door.say(f"{cut.name}: {cut.chips.sentence}")
    _say_predictions(door, result.predictions)
    door.say(
        f"program: {out / result.program.files[0].name}, its surface within {result.rounding_nm:.2f} nm of the planned "
        f"one (its decimals allow {result.rounding_limit_nm:.2f} nm)"
    )
    door.say(f"time and memory: {sum(result.timings.values()):.1f} s, {result.peak_memory_gb:.2f} GB")
    warn(result.warnings)
    door.say(f"report: {out / 'report.html'}")
    end_by(door, result.verdicts)


@app.command()
def new(
    context: typer.Context,
    family: Annotated[
        str, typer.Argument(metavar="FAMILY", help='Of the surface, such as "even asphere".', show_default=False)
    ],
    out: Annotated[Path, typer.Option(metavar="JOB.toml", help="The job file.", show_default=False)],
    strategy: Annotated[str, typer.Option(metavar="KIND", help="How it is cut.")] = "slow tool servo",
) -> None:
    """Write a job file to start from, every key explained."""
    door: Door = context.obj
    from turnwright._io import write_whole  # noqa: PLC0415
    from turnwright.job import job_template  # noqa: PLC0415 - costly

    require_new(out)
    write_whole(out, job_template(family, strategy))
    door.say(f"job: {out}")


@app.command()
def check(context: typer.Context, job: JobFile) -> None:
    """Read a job and say whether the tool reaches the part, and how long the program will be."""
    door: Door = context.obj
    from turnwright.job import Job, preview, steps_of_preview, unjudged  # noqa: PLC0415

    recipe = Job.load(job)
    with progress_of(door.stop, steps_of_preview(recipe)) as progress:
        plan = preview(recipe, progress=progress)
    for sentence in (*plan.remarks, *plan.shape.sentences):
        door.say(sentence)
    for finding in plan.access.findings:
        door.say(f"{'ok' if finding.ok else 'NO'}: {finding.sentence}")
    for name, points in plan.points.items():
        door.say(f"{name}: {points} points, at least {plan.shortest_s[name] / 60:.1f} min")
    for name, sentence in plan.chips.items():
        door.say(f"{name}: {sentence}")
    for verdict in unjudged(recipe, "check predicts no surface, run does"):
        door.say(verdict.sentence)
    warn(plan.warnings)
    if plan.refused:
        raise JobError("\n".join(plan.refused))


@app.command()
def plan(
    context: typer.Context,
    job: JobFile,
    out: Annotated[Path, typer.Option(metavar="JOB.toml", help="The job with the plan in it.", show_default=False)],
) -> None:
    """Choose feed, points and spindle speed so that the part keeps its tolerances, and prove it."""
    door: Door = context.obj
    from turnwright._io import write_whole  # noqa: PLC0415
    from turnwright.job import Job, edited, plan, steps_of_plan  # noqa: PLC0415

    require_new(out)
    recipe = Job.load(job)
    text = job.read_bytes().decode("utf-8")
    with progress_of(door.stop, steps_of_plan(recipe)) as progress:
        chosen = plan(recipe, progress=progress)
    write_whole(out, edited(text, recipe, chosen.job, folder=job.absolute().parent, into=out.absolute().parent))
    for one in chosen.tried if len(chosen.tried) > 1 else ():
        door.say(f"{one.interpolation}: {one.refused or f'{one.points} points, {one.minutes:.1f} min'}")
    found = chosen.shares
    door.say(
        f"{chosen.limits.points} points, {chosen.limits.cycle_time_s / 60:.1f} min at "
        f"{chosen.limits.spindle_rpm:.4g} rpm, {chosen.limits.nearest} is nearest to its limit"
    )
    door.say(f"form error PV {found.pv_nm:.3g} nm: {found.sentence}; Sq {found.sq_nm:.3g} nm")
    for verdict in chosen.verdicts:
        door.say(verdict.sentence)
    door.say(f"job: {out}")
    end_by(door, chosen.verdicts)


@app.command()
def compare(
    context: typer.Context,
    job: JobFile,
    out: Folder,
    force: Force = False,
) -> None:
    """Plan the finishing pass by every strategy that the machine can do, and put what each leaves side by side."""
    door: Door = context.obj
    with new_folder(out, door, force=force) as folder:
        from turnwright.job import Job, compare, steps_of_comparison  # noqa: PLC0415

        recipe = Job.load(job)
        with progress_of(door.stop, steps_of_comparison(recipe)) as progress:
            found = compare(recipe, progress=progress)
            progress("report", 0, 1)
            from turnwright.report import archive_comparison, write_comparison  # noqa: PLC0415 - costly to import

            archive_comparison(found, folder)
            write_comparison(found, folder)
            progress("report", 1, 1)
    for one in found.candidates:
        if one.refused or one.limits is None or one.shares is None:
            door.say(f"{one.name}: {one.refused}")
            continue
        door.say(
            f"{one.name}: {one.turns:.0f} turns, {one.limits.points} points, {one.limits.cycle_time_s / 60:.1f} min at "
            f"{one.limits.spindle_rpm:.4g} rpm, {one.limits.binding} binds; PV {one.shares.pv_nm:.3g} nm"
        )
    door.say(f"report: {out / 'report.html'}")


@app.command()
def backplot(
    context: typer.Context,
    program: Annotated[
        Path, typer.Argument(metavar="FILE.nc", help="A program, or a CSV table of C, X, Z.", show_default=False)
    ],
    job: Annotated[Path, typer.Option(help="The job that says part, tool and machine.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder for the maps; it is made when all is done.")] = None,
    cut: Annotated[str | None, typer.Option("--pass", help="The pass to read; the last one if not given.")] = None,
    block_delete: Annotated[
        bool | None,
        typer.Option("--block-delete/--no-block-delete", help="Leave out, or cut, the blocks that begin with a slash."),
    ] = None,
    track: Annotated[
        bool, typer.Option("--track", help="Let the axes move as the machine's servos do, and say what that adds.")
    ] = False,
    force: Force = False,
) -> None:
    """Predict the surface that a program leaves, anybody's."""
    door: Door = context.obj
    from turnwright.job import Job, judge, predict, steps_of_prediction  # noqa: PLC0415
    from turnwright.motion import check_limits  # noqa: PLC0415
    from turnwright.progress import Step  # noqa: PLC0415

    with ExitStack() as stack:
        folder = None if out is None else stack.enter_context(new_folder(out, door, force=force))
        recipe = Job.load(job)
        read = Step(stage="read program", work=program.stat().st_size / BYTES_PER_S if program.is_file() else 0.0)
        steps = (read, *steps_of_prediction(recipe, tracking=track or None))
        with progress_of(door.stop, steps) as progress:
            motion = _read(program, recipe, cut, progress, block_delete=block_delete)
            limits = check_limits(motion, recipe.machine)
            predictions = predict(recipe, motion, tracking=track or None, progress=progress)
        if folder is not None:
            import json  # noqa: PLC0415

            from turnwright.report import write_backplot, write_maps  # noqa: PLC0415 - costly to import

            told = write_maps(predictions, folder)
            (folder / "backplot.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
            write_backplot(program, recipe, motion, limits, predictions, folder)
    door.say(
        f"{program.name}: {limits.points} points, {limits.cycle_time_s / 60:.1f} min at {limits.spindle_rpm:.4g} rpm, "
        f"{limits.nearest} is nearest to its limit"
    )
    _say_predictions(door, predictions)
    warn([*limits.findings, *(sentence for one in predictions for sentence in one.remarks)])
    if out is not None:
        door.say(f"maps: {out / 'maps'}")
        door.say(f"report: {out / 'report.html'}")
    verdicts = judge(recipe, predictions)
    warn([one.sentence for one in verdicts if not one.kept])
    end_by(door, verdicts)


def _read(program: Path, recipe: Job, cut: str | None, progress: StageProgress, *, block_delete: bool | None) -> Motion:
    """Read a program by its dialect, or a table of axis positions."""
    from turnwright.post import read_fast_tool, read_nc, read_table  # noqa: PLC0415

    machine = recipe.machine
    if program.suffix.lower() == ".csv" and cut is not None:
        raise InputError(f"a table holds one pass without a name, --pass is {cut!r}: leave it out")
    if program.suffix.lower() != ".csv":

        def told(done: int, total: int) -> None:
            progress("read program", done, total)

        if cut is None and program.with_name(f"{program.stem}.fast.csv").is_file():
            return read_fast_tool(program, machine, progress=told)
        return read_nc(program, machine, name=cut, block_delete=block_delete, progress=told)
    speed = recipe.strategy.spindle_rpm
    if speed is not None:
        return read_table(program, machine, spindle_rpm=speed)
    return read_table(program, machine, block_rate_hz=machine.block_rate_hz)


def _say_predictions(door: Door, predictions: Sequence[Prediction]) -> None:
    for one in predictions:
        door.say(
            f"{one.name}: {'rms' if one.roughness.form == 'none' else 'Sq'} {one.roughness.sq_nm:.3g} nm, PV "
            f"{one.pv_nm:.4g} nm"
            + (" from the design" if one.roughness.form == "none" else f" after form removal ({one.roughness.form})")
            + (
                f"; of it the servos {servos[0]:.4g} nm PV, {servos[1]:.3g} nm rms"
                if (servos := one.tracking_nm)
                else ""
            )
        )
