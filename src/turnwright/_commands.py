"""The commands, thin: each reads what was asked for, calls the job, and says what came out."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright import __version__
from turnwright._stop import Stop
from turnwright.errors import InputError, JobError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from turnwright.job import Job, Prediction, StageProgress
    from turnwright.path import Motion

__all__ = ["Door", "app"]

app = typer.Typer(
    name="turnwright",
    help="From an optical prescription to a proven program for a diamond-turning lathe.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

JobFile = Annotated[Path, typer.Argument(metavar="JOB.toml", help="The job file.", show_default=False)]
Folder = Annotated[Path, typer.Option(help="Folder for the results; it is made when all is done.", show_default=False)]
Force = Annotated[
    bool, typer.Option("--force", help="If the folder is there already, keep it under another name and go on.")
]


class Door:
    """What a command and the one who called it tell each other.

    Parameters
    ----------
    stop
        Whether somebody wants an end.
    kept
        The folder that is complete and in its place.
    unsaid
        Why the standard output did not take what was said; the work goes on without.
    """

    def __init__(self, stop: Stop) -> None:
        self.stop = stop
        self.kept: Path | None = None
        self.unsaid: OSError | None = None

    def say(self, text: str) -> None:
        """Say a sentence where results are said."""
        if self.unsaid is None:
            try:
                typer.echo(text)
            except OSError as error:
                self.unsaid = error
                with suppress(OSError, ValueError):  # what is left in the buffer must not fail again at the end
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def tell(text: str) -> None:
    """Say beside the results; nobody needs to listen."""
    with suppress(OSError):
        typer.echo(text, err=True)


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Say which version this is, and stop.")] = False,
) -> None:
    if version:
        typer.echo(f"turnwright {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


@app.command()
def run(
    context: typer.Context,
    job: JobFile,
    out: Folder,
    force: Force = False,
) -> None:
    """Check, plan, place, drive, write the program, read it back, predict the surface it leaves, and report."""
    door: Door = context.obj
    with _new_folder(out, door, force=force) as folder:
        from turnwright import job as recipe  # noqa: PLC0415 - costly

        with _progress(door.stop) as progress:
            result = recipe.run(recipe.Job.load(job), progress=progress, out=folder)
            progress("report", 0, 1)
            from turnwright import archive, report  # noqa: PLC0415 - matplotlib, only for a run that came so far

            archive.write_archive(result, folder)
            report.write_report(result, folder)
            progress("report", 1, 1)
    for cut in result.passes:
        door.say(
            f"{cut.name}: {cut.points} points, {cut.limits.cycle_time_s / 60:.1f} min at {cut.spindle_rpm:.4g} rpm, "
            f"{cut.limits.binding} binds"
        )
    _say_predictions(door, result.predictions)
    door.say(
        f"program: {out / result.program.files[0].name}, its surface within {result.rounding_nm:.2f} nm of the planned "
        f"one (its decimals allow {result.rounding_limit_nm:.2f} nm)"
    )
    door.say(f"time and memory: {sum(result.timings.values()):.1f} s, {result.peak_memory_gb:.2f} GB")
    _warn(result.warnings)
    door.say(f"report: {out / 'report.html'}")


@app.command()
def check(context: typer.Context, job: JobFile) -> None:
    """Read a job and say whether the tool reaches the part, and how long the program will be."""
    door: Door = context.obj
    from turnwright.job import Job, preview  # noqa: PLC0415

    with _progress(door.stop) as progress:
        plan = preview(Job.load(job), progress=progress)
    for finding in plan.access.findings:
        door.say(f"{'ok' if finding.ok else 'NO'}: {finding.sentence}")
    for name, points in plan.points.items():
        door.say(f"{name}: {points} points, at least {plan.shortest_s[name] / 60:.1f} min")
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
    from turnwright.job import Job, plan  # noqa: PLC0415

    if out.exists():
        raise InputError(f"{str(out)!r} is there already: name another file")
    if not out.absolute().parent.is_dir():
        raise InputError(f"the folder of {str(out)!r} does not exist: make it, or name another file")
    with _progress(door.stop) as progress:
        chosen = plan(Job.load(job), progress=progress)
    chosen.job.dump(out)
    for one in chosen.tried if len(chosen.tried) > 1 else ():
        door.say(f"{one.interpolation}: {one.refused or f'{one.points} points, {one.minutes:.1f} min'}")
    found = chosen.shares
    door.say(
        f"{chosen.limits.points} points, {chosen.limits.cycle_time_s / 60:.1f} min at "
        f"{chosen.limits.spindle_rpm:.4g} rpm, {chosen.limits.nearest} is nearest to its limit"
    )
    door.say(
        f"form error PV {found.pv_nm:.3g} nm: cusps {found.cusp_nm:.3g} nm, points {found.chord_nm:.3g} nm, decimals "
        f"{found.rounding_nm:.3g} nm, servos {found.tracking_nm:.3g} nm; Sq {found.sq_nm:.3g} nm"
    )
    door.say(f"job: {out}")


@app.command()
def compare(
    context: typer.Context,
    job: JobFile,
    out: Folder,
    force: Force = False,
) -> None:
    """Plan the finishing pass by every strategy that the machine can do, and put what each leaves side by side."""
    door: Door = context.obj
    with _new_folder(out, door, force=force) as folder:
        from turnwright.job import Job, compare  # noqa: PLC0415

        with _progress(door.stop) as progress:
            found = compare(Job.load(job), progress=progress)
            progress("report", 0, 1)
            from turnwright.archive import write_comparison as write_table  # noqa: PLC0415
            from turnwright.report import write_comparison  # noqa: PLC0415

            write_table(found, folder)
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
    track: Annotated[
        bool, typer.Option("--track", help="Let the axes move as the machine's servos do, and say what that adds.")
    ] = False,
    force: Force = False,
) -> None:
    """Predict the surface that a program leaves, anybody's."""
    door: Door = context.obj
    from turnwright.job import Job, predict  # noqa: PLC0415
    from turnwright.motion import check_limits  # noqa: PLC0415

    with ExitStack() as stack:
        folder = None if out is None else stack.enter_context(_new_folder(out, door, force=force))
        recipe = Job.load(job)
        with _progress(door.stop) as progress:
            motion = _read(program, recipe, cut, progress)
            limits = check_limits(motion, recipe.machine.machine)
            predictions = predict(recipe, motion, tracking=track or None, progress=progress)
        if folder is not None:
            import json  # noqa: PLC0415

            from turnwright.archive import write_maps  # noqa: PLC0415
            from turnwright.report import write_backplot  # noqa: PLC0415

            told = write_maps(predictions, folder)
            (folder / "backplot.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
            write_backplot(program, recipe, motion, limits, predictions, folder)
    door.say(
        f"{program.name}: {limits.points} points, {limits.cycle_time_s / 60:.1f} min at {limits.spindle_rpm:.4g} rpm, "
        f"{limits.nearest} is nearest to its limit"
    )
    _say_predictions(door, predictions)
    _warn(limits.findings)
    if out is not None:
        door.say(f"maps: {out / 'maps'}")
        door.say(f"report: {out / 'report.html'}")


def _read(program: Path, recipe: Job, cut: str | None, progress: StageProgress) -> Motion:
    """Read a program by its dialect, or a table of axis positions."""
    from turnwright.post import read_fast_tool, read_nc, read_table  # noqa: PLC0415

    machine = recipe.machine.machine
    if program.suffix.lower() == ".csv" and cut is not None:
        raise InputError(f"a table holds one pass without a name, --pass is {cut!r}: leave it out")
    if program.suffix.lower() != ".csv":

        def told(done: int, total: int) -> None:
            progress("read program", done, total)

        if cut is None and program.with_name(f"{program.stem}.fast.csv").is_file():
            return read_fast_tool(program, machine, progress=told)
        return read_nc(program, machine, name=cut, progress=told)
    speed = recipe.strategy.spindle_speed
    if speed is not None:
        return read_table(program, machine, spindle_rpm=speed)
    return read_table(program, machine, block_rate_hz=machine.block_rate_hz)


def _say_predictions(door: Door, predictions: Sequence[Prediction]) -> None:
    for one in predictions:
        door.say(
            f"{one.name}: Sq {one.roughness.sq_nm:.3g} nm, PV {one.roughness.pv_nm:.4g} nm"
            + (" from the design" if one.roughness.form == "none" else f" after form removal ({one.roughness.form})")
            + (
                f"; of it the servos {servos[0]:.4g} nm PV, {servos[1]:.3g} nm rms"
                if (servos := one.tracking_nm)
                else ""
            )
        )


def _warn(sentences: Sequence[str]) -> None:
    for sentence in sentences:
        tell(f"warning: {sentence}")


@contextmanager
def _progress(stop: Stop) -> Iterator[StageProgress]:
    """Yield what is told of each stage: bars with the time left on a terminal, a quiet line per stage elsewhere."""
    if not sys.stderr.isatty():
        told: set[str] = set()

        def line(stage: str, done: int, total: int) -> None:
            stop.check()
            if done >= total and stage not in told:
                told.add(stage)
                tell(stage)

        yield line
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description:24}"), BarColumn(), TimeRemainingColumn(elapsed_when_finished=True))
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks = {}

        def bar(stage: str, done: int, total: int) -> None:
            stop.check()
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield bar


@contextmanager
def _new_folder(out: Path, door: Door, *, force: bool) -> Iterator[Path]:
    """Yield a folder beside ``out`` that becomes ``out`` when all is well, and vanishes otherwise."""
    out = Path(os.path.realpath(out))  # a link stays, what it points to is made
    if out.is_symlink():
        raise InputError(f"{str(out)!r} is a link that points to itself: name another folder")
    if out.is_mount():
        raise InputError(f"{str(out)!r} is where a disk is mounted, which cannot be replaced: name a folder in it")
    door.stop.deaf = True  # until what is made here is sure to be cleaned up
    made = [folder for folder in out.parents if not folder.exists()]  # deepest first
    out.parent.mkdir(parents=True, exist_ok=True)
    taken = out.exists() and not (out.is_dir() and not any(out.iterdir()))
    if taken and not force:
        raise InputError(
            f"{str(out)!r} is there already and not empty: name another folder, or add --force to keep it too"
        )
    folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        door.stop.deaf = False
        door.stop.check()
        yield folder
        mask = os.umask(0)
        os.umask(mask)
        folder.chmod(0o777 & ~mask)
        door.stop.check()
        door.stop.deaf = True  # from here on it is done
        if taken:
            number = 1
            while (kept := out.with_name(f"{out.name}.old-{number}")).exists():
                number += 1
            out.rename(kept)
        elif out.exists():
            out.rmdir()
        folder.rename(out)
        door.kept = out
    except BaseException as error:
        # Whoever reads the message knows the folder that was asked for.
        here, asked = str(folder), str(out)
        error.args = tuple(one.replace(here, asked) if isinstance(one, str) else one for one in error.args)
        if isinstance(error, OSError) and isinstance(error.filename, str | os.PathLike):
            error.filename = os.fspath(error.filename).replace(here, asked)
        door.stop.deaf = True  # a second interrupt must not stop the cleaning
        shutil.rmtree(folder, ignore_errors=True)
        for parent in made:
            with suppress(OSError):  # somebody else put something in it meanwhile
                parent.rmdir()
        raise
