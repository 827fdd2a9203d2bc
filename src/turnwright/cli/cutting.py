"""Commands that plan and simulate cutting: run, new, check, plan, compare and backplot."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.batch import run_batch, run_into
from turnwright.cli.shared import (
    Folder,
    Force,
    JobFile,
    Session,
    app,
    exit_on_missed,
    new_folder,
    require_unused,
    show_progress,
    warn,
    write_edited,
)
from turnwright.errors import GougeError, InputError, JobError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.job import Job, Prediction
    from turnwright.path import Motion
    from turnwright.progress import StageProgress

__all__: list[str] = []

READ_BYTES_PER_S = 5e7
"""Typical rate of reading a program, for the progress estimate. [byte/s]"""


@app.command()
def run(
    context: typer.Context,
    jobs: Annotated[
        list[Path], typer.Argument(metavar="JOB.toml...", help="One or more job files.", show_default=False)
    ],
    out: Folder,
    force: Force = False,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Number of parallel jobs.", show_default="limited by cores and memory"),
    ] = None,
) -> None:
    """Plan, check, write and simulate an NC program.

    Several jobs run in parallel, each in its own subfolder of the results. A failed job does not stop the others, and
    finished jobs are skipped when the command is repeated.
    """
    session: Session = context.obj
    if len(jobs) > 1:
        run_batch(jobs, out, session, force=force, workers=workers)
        return
    with new_folder(out, session, force=force) as folder:
        from turnwright.job import Job, compile_simulation_ahead, steps_of_run  # noqa: PLC0415 - costly
        from turnwright.report import draw_apart  # noqa: PLC0415

        recipe = Job.load(jobs[0])
        compile_simulation_ahead()
        with draw_apart(), show_progress(session.stop, steps_of_run(recipe)) as progress:
            result = run_into(folder, recipe, progress)
    for cut in result.passes:
        session.echo(
            f"{cut.name}: {cut.points} points, {cut.limits.cycle_time_s / 60:.1f} min at {cut.spindle_rpm:.4g} rpm, "
            f"limited by {cut.limits.binding}"
        )
        if cut.chips is not None:
            session.echo(f"{cut.name}: {cut.chips.sentence}")
    _print_predictions(session, result.predictions)
    session.echo(
        f"program: {out / result.program.files[0].name}; rounding changes the surface by {result.rounding_nm:.2f} nm "
        f"(at most {result.rounding_limit_nm:.2f} nm at its decimals)"
    )
    session.echo(f"time and memory: {sum(result.timings.values()):.1f} s, {result.peak_memory_gb:.2f} GB")
    warn(result.warnings)
    session.echo(f"report: {out / 'report.html'}")
    if result.verdicts:
        session.echo(f"certificate: {out / 'certificate.html'}")
    exit_on_missed(session, result.verdicts)


@app.command()
def new(
    context: typer.Context,
    family: Annotated[
        str, typer.Argument(metavar="FAMILY", help='Surface family, such as "even asphere".', show_default=False)
    ],
    out: Annotated[Path, typer.Option(metavar="JOB.toml", help="The job file.", show_default=False)],
    strategy: Annotated[str, typer.Option(metavar="KIND", help="Cutting strategy.")] = "slow tool servo",
) -> None:
    """Write a job file with every key explained."""
    session: Session = context.obj
    from turnwright._io import write_atomic  # noqa: PLC0415
    from turnwright.job import job_template  # noqa: PLC0415 - costly

    require_unused(out)
    write_atomic(out, job_template(family, strategy))
    session.echo(f"job: {out}")


@app.command()
def check(context: typer.Context, job: JobFile) -> None:
    """Check tool access, cycle time and chip thickness."""
    session: Session = context.obj
    from turnwright.job import Job, not_evaluated, preview, steps_of_preview  # noqa: PLC0415

    recipe = Job.load(job)
    with show_progress(session.stop, steps_of_preview(recipe)) as progress:
        plan = preview(recipe, progress=progress)
    for sentence in (*plan.remarks, *plan.shape.sentences):
        session.echo(sentence)
    for finding in plan.findings:
        session.echo(f"{'ok' if finding.ok else 'NO'}: {finding.sentence}")
    for name, points in plan.points.items():
        session.echo(f"{name}: {points} points, at least {plan.shortest_s[name] / 60:.1f} min")
    for name, sentence in plan.chips.items():
        session.echo(f"{name}: {sentence}")
    for verdict in not_evaluated(recipe, "only a run predicts the surface"):
        session.echo(verdict.sentence)
    warn(plan.warnings)
    if plan.refused:
        raise JobError("\n".join(plan.refused))


@app.command()
def plan(
    context: typer.Context,
    job: JobFile,
    out: Annotated[Path, typer.Option(metavar="JOB.toml", help="The planned job file to write.", show_default=False)],
) -> None:
    """Choose feed and spindle speed to meet tolerances."""
    session: Session = context.obj
    from turnwright.job import Job, plan, steps_of_plan  # noqa: PLC0415

    require_unused(out)
    recipe = Job.load(job)
    with show_progress(session.stop, steps_of_plan(recipe)) as progress:
        chosen = plan(recipe, progress=progress)
    write_edited(out, job, recipe, chosen.job)
    for trial in chosen.tried if len(chosen.tried) > 1 else ():
        session.echo(f"{trial.interpolation}: {trial.refused or f'{trial.points} points, {trial.minutes:.1f} min'}")
    budget = chosen.breakdown
    session.echo(
        f"{chosen.limits.points} points, {chosen.limits.cycle_time_s / 60:.1f} min at "
        f"{chosen.limits.spindle_rpm:.4g} rpm, {chosen.limits.nearest} is nearest to its limit"
    )
    session.echo(f"form error PV {budget.pv_nm:.3g} nm: {budget.sentence}; Sq {budget.sq_nm:.3g} nm")
    for verdict in chosen.verdicts:
        session.echo(verdict.sentence)
    session.echo(f"job: {out}")
    exit_on_missed(session, chosen.verdicts)


@app.command()
def compare(
    context: typer.Context,
    job: JobFile,
    out: Folder,
    force: Force = False,
) -> None:
    """Compare cutting strategies for the finishing pass."""
    session: Session = context.obj
    with new_folder(out, session, force=force) as folder:
        from turnwright.job import Job, compare, steps_of_comparison  # noqa: PLC0415
        from turnwright.report import archive_comparison, draw_apart, draw_candidate, write_comparison  # noqa: PLC0415

        recipe = Job.load(job)
        with draw_apart(), show_progress(session.stop, steps_of_comparison(recipe)) as progress:
            comparison = compare(recipe, progress=progress, ready=partial(draw_candidate, recipe))
            progress("report", 0, 1)
            archive_comparison(comparison, folder)
            write_comparison(comparison, folder)
            progress("report", 1, 1)
    for candidate in comparison.candidates:
        limits = candidate.limits
        if candidate.refused or limits is None or candidate.breakdown is None:
            session.echo(f"{candidate.name}: {candidate.refused}")
            continue
        session.echo(
            f"{candidate.name}: {candidate.turns:.0f} revolutions, {limits.points} points, "
            f"{limits.cycle_time_s / 60:.1f} min at {limits.spindle_rpm:.4g} rpm, limited by {limits.binding}; "
            f"PV {candidate.breakdown.pv_nm:.3g} nm"
        )
    session.echo(f"report: {out / 'report.html'}")


@app.command()
def backplot(
    context: typer.Context,
    program: Annotated[
        Path, typer.Argument(metavar="FILE.nc", help="A program, or a CSV table of C, X, Z.", show_default=False)
    ],
    job: Annotated[Path, typer.Option(help="Job file with part, tool and machine.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder for the maps; created on completion.")] = None,
    cut: Annotated[str | None, typer.Option("--pass", help="Pass to read; by default the last one.")] = None,
    block_delete: Annotated[
        bool | None,
        typer.Option("--block-delete/--no-block-delete", help="Skip blocks that begin with a slash, or execute them."),
    ] = None,
    track: Annotated[
        bool, typer.Option("--track", help="Include the servo response of the axes and report its contribution.")
    ] = False,
    force: Force = False,
) -> None:
    """Simulate the surface produced by any NC program."""
    session: Session = context.obj
    from turnwright.job import Job, find_wrong_move, judge, predict, steps_of_prediction  # noqa: PLC0415
    from turnwright.motion import check_limits  # noqa: PLC0415
    from turnwright.progress import Step  # noqa: PLC0415

    with ExitStack() as stack:
        folder = None if out is None else stack.enter_context(new_folder(out, session, force=force))
        recipe = Job.load(job)
        read = Step(stage="read program", work=program.stat().st_size / READ_BYTES_PER_S if program.is_file() else 0.0)
        steps = (read, *steps_of_prediction(recipe, tracking=track or None))
        with show_progress(session.stop, steps) as progress:
            motion = _read(program, recipe, cut, progress, block_delete=block_delete)
            is_program = program.suffix.lower() != ".csv"
            wrong = find_wrong_move(recipe, program, block_delete=block_delete) if is_program else ""
            if wrong and "gouge" not in recipe.accept:
                raise GougeError(f'{program.name}: {wrong} (or accept it in the job: accept = ["gouge"])')
            limits = check_limits(motion, recipe.machine)
            predictions = predict(recipe, motion, tracking=track or None, progress=progress)
        if folder is not None:
            import json  # noqa: PLC0415

            from turnwright.report import write_backplot, write_maps  # noqa: PLC0415 - costly to import

            summary = write_maps(predictions, folder)
            (folder / "backplot.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
            write_backplot(program, recipe, motion, limits, predictions, folder)
    session.echo(
        f"{program.name}: {limits.points} points, {limits.cycle_time_s / 60:.1f} min at {limits.spindle_rpm:.4g} rpm, "
        f"{limits.nearest} is nearest to its limit"
    )
    _print_predictions(session, predictions)
    warn(
        [
            *limits.findings,
            *filter(None, [wrong]),
            *(remark for prediction in predictions for remark in prediction.remarks),
        ]
    )
    if out is not None:
        session.echo(f"maps: {out / 'maps'}")
        session.echo(f"report: {out / 'report.html'}")
    verdicts = judge(recipe, predictions)
    warn([verdict.sentence for verdict in verdicts if not verdict.is_kept])
    exit_on_missed(session, verdicts)


def _read(program: Path, recipe: Job, cut: str | None, progress: StageProgress, *, block_delete: bool | None) -> Motion:
    """Read an NC program in the machine's dialect, or a CSV table of axis positions."""
    from turnwright.post import read_fast_tool, read_nc, read_table  # noqa: PLC0415

    machine = recipe.machine
    if program.suffix.lower() == ".csv" and cut is not None:
        raise InputError(f"a table holds one unnamed pass, got --pass {cut!r}: omit --pass")
    if program.suffix.lower() != ".csv":

        def report_read(done: int, total: int) -> None:
            progress("read program", done, total)

        if cut is None and program.with_name(f"{program.stem}.fast.csv").is_file():
            return read_fast_tool(program, machine, progress=report_read)
        return read_nc(program, machine, name=cut, block_delete=block_delete, progress=report_read)
    speed = recipe.strategy.spindle_rpm
    if speed is not None:
        return read_table(program, machine, spindle_rpm=speed)
    return read_table(program, machine, block_rate_hz=machine.block_rate_hz)


def _print_predictions(session: Session, predictions: Sequence[Prediction]) -> None:
    for prediction in predictions:
        form = prediction.roughness.form
        session.echo(
            f"{prediction.name}: {'rms' if form == 'none' else 'Sq'} {prediction.roughness.sq_nm:.3g} nm, PV "
            f"{prediction.pv_nm:.4g} nm"
            + (" from the nominal surface" if form == "none" else f" after form removal ({form})")
            + (
                f"; servo contribution {servos[0]:.4g} nm PV, {servos[1]:.3g} nm rms"
                if (servos := prediction.tracking_nm)
                else ""
            )
        )
