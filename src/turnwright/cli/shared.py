"""Parts shared by all commands: the session, common options, progress display and atomic result folders."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import socket
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright import __version__
from turnwright._io import write_atomic
from turnwright._signals import Stop
from turnwright.errors import InputError, shorten_message
from turnwright.progress import OverallProgress

try:
    import fcntl
except ImportError:  # Windows: the folder of a killed process stays
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from turnwright.job import Job, Verdict
    from turnwright.progress import Overall, StageProgress, Step

__all__ = [
    "MISSED_CODE",
    "Folder",
    "Force",
    "JobFile",
    "Session",
    "Unit",
    "app",
    "exit_on_missed",
    "new_folder",
    "parse_option",
    "print_status",
    "require_picture",
    "require_unused",
    "show_progress",
    "warn",
    "write_edited",
]

PICTURE_FORMATS = (".png", ".svg", ".pdf")

MISSED_CODE = 4
"""Exit code when results are written but a stated tolerance is missed."""

app = typer.Typer(
    name="turnwright",
    help="Generate and verify programs for diamond-turning lathes.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

JobFile = Annotated[Path, typer.Argument(metavar="JOB.toml", help="The job file.", show_default=False)]
Folder = Annotated[Path, typer.Option(help="Folder for the results; created on completion.", show_default=False)]
Unit = Annotated[str | None, typer.Option(help='Height unit of a text file that states none, such as "um".')]
Force = Annotated[bool, typer.Option("--force", help="Rename an existing result folder instead of stopping.")]


class Session:
    """State of one invocation, shared by the command and the entry point.

    Parameters
    ----------
    stop
        Requests to stop.

    Attributes
    ----------
    finished
        Result folder, once it is complete.
    partial
        Message on interruption: where finished parts are and how to continue.
    output_error
        First error on standard output; later output is discarded.
    """

    def __init__(self, stop: Stop) -> None:
        self.stop = stop
        self.finished: Path | None = None
        self.partial = ""
        self.output_error: OSError | None = None

    def echo(self, text: str) -> None:
        """Print a result to standard output."""
        if self.output_error is None:
            try:
                typer.echo(text)
            except OSError as error:
                self.output_error = error
                with suppress(OSError, ValueError):  # flushing the buffer at exit must not fail again
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_status(text: str) -> None:
    """Print a status line to standard error; errors are ignored."""
    with suppress(OSError):
        typer.echo(shorten_message(text), err=True)


def exit_on_missed(session: Session, verdicts: Iterable[Verdict]) -> None:
    """Exit with `MISSED_CODE` if a tolerance is missed."""
    from turnwright.job import any_missed  # noqa: PLC0415

    verdicts = tuple(verdicts)
    if any_missed(verdicts):
        count = sum(verdict.is_kept is False for verdict in verdicts)
        session.echo(f"results are written, but {count} of {len(verdicts)} evaluated tolerances are missed")
        raise typer.Exit(MISSED_CODE)


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"turnwright {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


def warn(sentences: Sequence[str]) -> None:
    """Print each sentence as a warning."""
    for sentence in sentences:
        print_status(f"warning: {sentence}")


def require_unused(file: Path) -> None:
    """Raise unless a file does not exist and its folder does."""
    if file.exists():
        raise InputError(f"{str(file)!r} already exists: choose another file")
    if not file.absolute().parent.is_dir():
        raise InputError(f"the folder of {str(file)!r} does not exist")


def require_picture(file: Path) -> None:
    """Raise unless a picture can be written to a file."""
    if file.suffix.lower() not in PICTURE_FORMATS:
        raise InputError(f"the picture is {file.name!r}, it must end in {', '.join(PICTURE_FORMATS)}")
    require_unused(file)


def parse_option(option: str, text: str, kind: str, example: str) -> tuple[str, str]:
    """Return both sides of an option such as ``KEY=VALUE``, which ``kind`` names."""
    name, _, value = (part.strip() for part in text.partition("="))
    if not (name and value):
        raise InputError(f'{option} must be {kind}, such as "{example}", got {text!r}')
    return name, value


def write_edited(out: Path, file: Path, job: Job, changed: Job) -> None:
    """Write a changed job as the text of its file with the changes, so that comments and layout are kept."""
    from turnwright.job import edit_text  # noqa: PLC0415

    text = file.read_bytes().decode("utf-8")
    write_atomic(out, edit_text(text, job, changed, folder=file.absolute().parent, into=out.absolute().parent))


@contextmanager
def show_progress(stop: Stop, steps: Sequence[Step]) -> Iterator[StageProgress]:
    """Yield a progress callback: one bar for the whole run on a terminal, otherwise one line per finished stage."""
    if not sys.stderr.isatty():
        printed: set[str] = set()

        def print_stage(stage: str, done: int, total: int) -> None:
            stop.check()
            if done >= total and stage not in printed:
                printed.add(stage)
                print_status(stage)

        yield print_stage
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[time]}"))
    start = time.monotonic()
    with Progress(*columns, console=Console(stderr=True)) as bars:
        task = bars.add_task("starting", total=1.0, time="")

        def draw(at: Overall) -> None:
            bars.update(
                task,
                completed=at.fraction,
                description=f"step {at.step} of {at.steps}, {at.stage}",
                time=f"{timedelta(seconds=round(at.left_s))} left",
            )

        overall = OverallProgress(steps, draw)

        def update(stage: str, done: int, total: int) -> None:
            stop.check()
            overall(stage, done, total)

        with _show_compiler(lambda text: bars.update(task, time=text)):
            yield update
        overall.finish()
        bars.update(task, description="done", time=f"in {timedelta(seconds=round(time.monotonic() - start))}")


@contextmanager
def _show_compiler(show: Callable[[str], object]) -> Iterator[None]:
    """Report what is compiled, which takes seconds for each kernel in the first run on a machine."""
    log, handler = logging.getLogger("turnwright._kernels"), logging.Handler()
    handler.emit = lambda record: show(record.getMessage())  # type: ignore[method-assign,assignment]
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(logging.NOTSET)


@contextmanager
def new_folder(out: Path, session: Session, *, force: bool) -> Iterator[Path]:
    """Yield a hidden folder next to ``out``; it is renamed to ``out`` on success and removed on failure."""
    out = Path(os.path.realpath(out))  # a link is kept, its target is created
    if out.is_symlink():
        raise InputError(f"{str(out)!r} is a link that points to itself")
    if out.is_mount():
        raise InputError(f"{str(out)!r} is a mount point and cannot be replaced: choose a folder in it")
    session.stop.records_only = True  # until the clean-up below is armed
    new_parents = [folder for folder in out.parents if not folder.exists()]  # deepest first
    out.parent.mkdir(parents=True, exist_ok=True)
    taken = out.exists() and not (out.is_dir() and not any(out.iterdir()))
    if taken and not force:
        raise InputError(
            f"{str(out)!r} already exists and is not empty: choose another folder, or rename it with --force"
        )
    folder, lock = _create_locked(out)
    try:
        session.stop.records_only = False
        session.stop.check()
        yield folder
        mask = os.umask(0)
        os.umask(mask)
        folder.chmod(0o777 & ~mask)
        session.stop.check()
        session.stop.records_only = True  # the results are complete
        if taken:
            _rename_existing(out)
        elif out.exists():
            out.rmdir()
        folder.rename(out)
        session.finished = out
    except BaseException as error:
        # Name the requested folder in the message, not the temporary one.
        temporary, requested = str(folder), str(out)
        error.args = tuple(part.replace(temporary, requested) if isinstance(part, str) else part for part in error.args)
        if isinstance(error, OSError) and isinstance(error.filename, str | os.PathLike):
            error.filename = os.fspath(error.filename).replace(temporary, requested)
        session.stop.records_only = True  # a second interrupt must not stop the clean-up
        shutil.rmtree(folder, ignore_errors=True)
        for parent in new_parents:
            with suppress(OSError):  # another process may have put a file in it
                parent.rmdir()
        raise
    finally:
        if lock is not None:
            os.close(lock)


def _rename_existing(out: Path) -> None:
    number = 1
    while (target := out.with_name(f"{out.name}.old-{number}")).exists():
        number += 1
    out.rename(target)


def _create_locked(out: Path) -> tuple[Path, int | None]:
    """Create a hidden folder next to ``out`` and lock it, after removing the stale folders of ended processes.

    The operating system releases a lock when its process ends. Locks may be local to one machine, so the name of the
    hidden folder contains a hash of the host name.

    Raises
    ------
    InputError
        If another process is writing the same folder.
    """
    host = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:6]
    prefix = f".{out.name}-{host}-"
    while True:
        _remove_stale(out, host)
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=out.parent))
        with suppress(BlockingIOError):  # another process is removing it as stale
            lock = _lock(folder)
            if folder.is_dir():
                break
            if lock is not None:
                os.close(lock)
    try:
        _remove_stale(out, host, folder.name)
    except InputError:
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)
        raise
    return folder, lock


def _remove_stale(out: Path, host: str, mine: str = "") -> None:
    """Remove the hidden folders of ended processes; raise if another process is writing ``out``.

    If two processes start together, the one whose hidden folder sorts first continues.
    """
    pattern = re.compile(rf"\.(.+)-{host}-[a-z0-9_]{{8}}")  # the names that mkdtemp gives
    others: list[Path] = []
    with suppress(OSError):  # the parent folder may be writable but not readable
        others = [path for path in out.parent.iterdir() if path.name != mine and pattern.fullmatch(path.name)]
    for other in others:
        try:
            lock = _lock(other)
        except BlockingIOError:
            match = pattern.fullmatch(other.name)
            if match is not None and match[1] == out.name and (not mine or other.name < mine):
                raise InputError(
                    f"another run is writing {str(out)!r}: choose another folder, or wait until it ends"
                ) from None
            continue
        if lock is not None:
            shutil.rmtree(other, ignore_errors=True)
            os.close(lock)


def _lock(folder: Path) -> int | None:
    """Lock a folder and return the descriptor of the lock; ``None`` where locks are not supported.

    Raises
    ------
    BlockingIOError
        If another process holds the lock.
    """
    if fcntl is None:
        return None
    try:
        number = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(number)
        if isinstance(error, BlockingIOError):
            raise
        return None
    return number
