"""The command line, thin: it reads what was asked for, calls the job, and says what came out.

Exit codes: 0 done, 1 a defect of Turnwright (the traceback is kept in a file), 2 bad input, 130 interrupted.
"""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright import __version__
from turnwright.errors import InputError, JobError, Stopped

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from turnwright.job import Job, Prediction, StageProgress
    from turnwright.path import Motion

__all__ = ["app", "main"]

app = typer.Typer(
    name="turnwright",
    help="From an optical prescription to a proven program for a diamond-turning lathe.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

JobFile = Annotated[Path, typer.Argument(metavar="JOB.toml", help="The job file.", show_default=False)]
INTERRUPTED = 130
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


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
    job: JobFile,
    out: Annotated[Path, typer.Option(help="Folder for the results; it is made when all is done.", show_default=False)],
    force: Annotated[
        bool, typer.Option("--force", help="If the folder is there already, keep it under another name and go on.")
    ] = False,
) -> None:
    """Check, plan, place, drive, write the program, read it back, predict the surface it leaves, and report."""
    with _new_folder(out, force=force) as folder:
        from turnwright import job as recipe  # noqa: PLC0415 - costly

        with _progress() as progress:
            result = recipe.run(recipe.Job.load(job), progress=progress, out=folder)
            progress("report", 0, 1)
            from turnwright import archive, report  # noqa: PLC0415 - matplotlib, only for a run that came so far

            archive.write_archive(result, folder)
            report.write_report(result, folder)
            progress("report", 1, 1)
    for cut in result.passes:
        typer.echo(
            f"{cut.name}: {cut.points} points, {cut.limits.cycle_time_s / 60:.1f} min at {cut.spindle_rpm:.4g} rpm, "
            f"{cut.limits.binding} binds"
        )
    _say_predictions(result.predictions)
    typer.echo(
        f"program: {out / result.program.files[0].name}, its surface within {result.rounding_nm:.2f} nm of the planned "
        f"one (its decimals allow {result.rounding_limit_nm:.2f} nm)"
    )
    typer.echo(f"time and memory: {sum(result.timings.values()):.1f} s, {result.peak_memory_gb:.2f} GB")
    _warn(result.warnings)
    typer.echo(f"report: {out / 'report.html'}")


@app.command()
def check(job: JobFile) -> None:
    """Read a job and say whether the tool reaches the part, and how long the program will be."""
    from turnwright.job import Job, preview  # noqa: PLC0415

    with _progress() as progress:
        plan = preview(Job.load(job), progress=progress)
    for finding in plan.access.findings:
        typer.echo(f"{'ok' if finding.ok else 'NO'}: {finding.sentence}")
    for name, points in plan.points.items():
        typer.echo(f"{name}: {points} points, at least {plan.shortest_s[name] / 60:.1f} min")
    if plan.refused:
        raise JobError("\n".join(plan.refused))


@app.command()
def backplot(
    program: Annotated[
        Path, typer.Argument(metavar="FILE.nc", help="A program, or a CSV table of C, X, Z.", show_default=False)
    ],
    job: Annotated[Path, typer.Option(help="The job that says part, tool and machine.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder for the maps; it is made when all is done.")] = None,
    cut: Annotated[str | None, typer.Option("--pass", help="The pass to read; the last one if not given.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="If the folder is there already, keep it under another name and go on.")
    ] = False,
) -> None:
    """Predict the surface that a program leaves, anybody's."""
    from turnwright.job import Job, predict  # noqa: PLC0415
    from turnwright.motion import check_limits  # noqa: PLC0415

    recipe = Job.load(job)
    with _progress() as progress:
        motion = _read(program, recipe, cut, progress)
        limits = check_limits(motion, recipe.machine.machine)
        predictions = predict(recipe, motion, progress=progress)
    typer.echo(
        f"{program.name}: {limits.points} points, {limits.cycle_time_s / 60:.1f} min at {limits.spindle_rpm:.4g} rpm, "
        f"{limits.nearest} is nearest to its limit"
    )
    _say_predictions(predictions)
    _warn(limits.findings)
    if out is not None:
        import json  # noqa: PLC0415

        from turnwright.archive import write_maps  # noqa: PLC0415
        from turnwright.report import write_backplot  # noqa: PLC0415

        with _new_folder(out, force=force) as folder:
            told = write_maps(predictions, folder)
            (folder / "backplot.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
            write_backplot(program, recipe, motion, limits, predictions, folder)
        typer.echo(f"maps: {out / 'maps'}")
        typer.echo(f"report: {out / 'report.html'}")


def _read(program: Path, recipe: Job, cut: str | None, progress: StageProgress) -> Motion:
    """Read a program by its dialect, or a table of axis positions."""
    from turnwright.post import read_nc, read_table  # noqa: PLC0415

    machine = recipe.machine.machine
    if program.suffix.lower() == ".csv" and cut is not None:
        raise InputError(f"a table holds one pass without a name, --pass is {cut!r}: leave it out")
    if program.suffix.lower() != ".csv":
        return read_nc(program, machine, name=cut, progress=lambda done, total: progress("read program", done, total))
    speed = recipe.strategy.spindle_speed
    if speed is not None:
        return read_table(program, machine, spindle_rpm=speed)
    return read_table(program, machine, block_rate_hz=machine.block_rate_hz)


def _say_predictions(predictions: Sequence[Prediction]) -> None:
    for one in predictions:
        typer.echo(
            f"{one.name}: Sq {one.roughness.sq_nm:.3g} nm, PV {one.roughness.pv_nm:.4g} nm"
            + (" from the design" if one.roughness.form == "none" else f" after form removal ({one.roughness.form})")
        )


def _warn(sentences: Sequence[str]) -> None:
    for sentence in sentences:
        typer.echo(f"warning: {sentence}", err=True)


@contextmanager
def _progress() -> Iterator[StageProgress]:
    """Yield what is told of each stage: bars with the time left on a terminal, a quiet line per stage elsewhere."""
    if not sys.stderr.isatty():
        told: set[str] = set()

        def line(stage: str, done: int, total: int) -> None:
            if done >= total and stage not in told:
                told.add(stage)
                typer.echo(stage, err=True)

        yield line
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description:24}"), BarColumn(), TimeRemainingColumn(elapsed_when_finished=True))
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks = {}

        def bar(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield bar


@contextmanager
def _new_folder(out: Path, *, force: bool) -> Iterator[Path]:
    """Yield a folder beside ``out`` that becomes ``out`` when all is well, and vanishes otherwise."""
    out = out.absolute()
    made = [folder for folder in out.parents if not folder.exists()]  # deepest first
    out.parent.mkdir(parents=True, exist_ok=True)
    taken = out.exists() and not (out.is_dir() and not any(out.iterdir()))
    if taken and not force:
        raise InputError(
            f"{str(out)!r} is there already and not empty: name another folder, or add --force to keep it too"
        )
    folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        yield folder
        mask = os.umask(0)
        os.umask(mask)
        folder.chmod(0o777 & ~mask)
        if taken:
            number = 1
            while (kept := out.with_name(f"{out.name}.old-{number}")).exists():
                number += 1
            out.rename(kept)
        elif out.exists():
            out.rmdir()
        folder.rename(out)
    except BaseException:
        # A second interrupt must not stop the cleaning.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN), signal.signal(signal.SIGTERM, signal.SIG_IGN)
        shutil.rmtree(folder, ignore_errors=True)
        for parent in made:
            with suppress(OSError):  # somebody else put something in it meanwhile
                parent.rmdir()
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGTERM, before[1])
        raise


def _interrupt(_number: int, _frame: object) -> None:
    raise KeyboardInterrupt


def _say(text: str) -> None:
    for line in text.splitlines():
        print(f"turnwright: {line}", file=sys.stderr)  # noqa: T201 - the one place errors go


def _disk_error(error: OSError) -> str:
    where = f" at {error.filename}" if error.filename else ""
    text = str(error)
    # HDF5 and NumPy say it in their own words: "errno = 28," and "1000 requested and 12 written".
    if error.errno in FULL or "requested and" in text or any(f"errno = {number}," in text for number in FULL):
        return f"the disk is full{where}, nothing was kept: free some space, or choose another folder"
    return (
        f"the system refuses ({error.strerror or text.splitlines()[0]}){where}, nothing was kept: check name and rights"
    )


def _defect() -> str:
    """Keep the traceback of a defect, and say where."""
    kept = "no file could be written for the traceback"
    with suppress(OSError), tempfile.NamedTemporaryFile("w", prefix="turnwright-", suffix=".log", delete=False) as log:
        traceback.print_exc(file=log)
        kept = f"the traceback is in {log.name}"
    reason = f"{type(sys.exception()).__name__}: {sys.exception()}".splitlines()[0]
    return f"this is a defect of Turnwright, not of the job ({reason}), {kept}: please report it"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments
        In place of those of the process.

    Returns
    -------
    int
        The exit code.
    """
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_args, **_more: _warn([str(message)])
            code = _carry_out(arguments)
    finally:
        signal.signal(signal.SIGTERM, before)
    if code == INTERRUPTED:
        _say("interrupted, nothing was kept: start it again")
    return code


def _carry_out(arguments: Sequence[str] | None) -> int:
    """Run a command and turn what ends it into a sentence and an exit code."""
    try:
        return typer.main.get_command(app).main(arguments, prog_name="turnwright", standalone_mode=False) or 0
    except (KeyboardInterrupt, typer.Abort, Stopped):
        return INTERRUPTED  # some versions of typer end so by themselves, with the same code
    except InputError as error:
        _say(str(error))
    except MemoryError as error:
        _say(f"the memory is not enough ({error}): take fewer points or a coarser map")
    except OSError as error:
        _say(_disk_error(error))
    except Exception as error:  # noqa: BLE001 - the door is where everything ends
        # A wrong command line; typer carries its parser inside or beside it, depending on the version.
        if not hasattr(error, "format_message"):
            _say(_defect())
            return 1
        _say(f"{error.format_message().rstrip('.')}: see turnwright --help")
    return 2
