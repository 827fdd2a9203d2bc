"""What all commands share: the door, its options, progress, and folders that appear when all is done."""

from __future__ import annotations

import hashlib
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
from turnwright._signals import Stop
from turnwright.errors import InputError, shortened
from turnwright.progress import OverallProgress

try:
    import fcntl
except ImportError:  # Windows: there what a killed process left stays
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from turnwright.job import Verdict
    from turnwright.progress import Overall, StageProgress, Step

__all__ = [
    "MISSED",
    "Door",
    "Folder",
    "Force",
    "JobFile",
    "app",
    "end_by",
    "new_folder",
    "progress_of",
    "require_new",
    "tell",
    "warn",
]

MISSED = 4
"""Exit code of work that is done and written, of which a stated tolerance is missed."""

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
    partly
        What stays of a work in parts that is interrupted, and how to go on; a sentence.
    unsaid
        Why the standard output did not take what was said; the work goes on without.
    """

    def __init__(self, stop: Stop) -> None:
        self.stop = stop
        self.kept: Path | None = None
        self.partly = ""
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
        typer.echo(shortened(text), err=True)


def end_by(door: Door, verdicts: Iterable[Verdict]) -> None:
    """End a command that has done its work: with the code of a missed tolerance if one is.

    Raises
    ------
    typer.Exit
        With that code.
    """
    from turnwright.job import missed  # noqa: PLC0415

    verdicts = tuple(verdicts)
    if missed(verdicts):
        many = sum(one.kept is False for one in verdicts)
        door.say(f"done and written, but a stated tolerance is missed ({many} of {len(verdicts)} judged)")
        raise typer.Exit(MISSED)


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


def warn(sentences: Sequence[str]) -> None:
    """Print each sentence as a warning."""
    for sentence in sentences:
        tell(f"warning: {sentence}")


def require_new(file: Path) -> None:
    """Raise unless a file can be written under a name that is not taken."""
    if file.exists():
        raise InputError(f"{str(file)!r} is there already: name another file")
    if not file.absolute().parent.is_dir():
        raise InputError(f"the folder of {str(file)!r} does not exist: make it, or name another file")


@contextmanager
def progress_of(stop: Stop, steps: Sequence[Step]) -> Iterator[StageProgress]:
    """Yield the progress callback: one bar for the whole run on a terminal, a quiet line per stage elsewhere."""
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
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[time]}"))
    start = time.monotonic()
    with Progress(*columns, console=Console(stderr=True)) as bars:
        task = bars.add_task("begins", total=1.0, time="")

        def draw(at: Overall) -> None:
            bars.update(
                task,
                completed=at.fraction,
                description=f"step {at.step} of {at.steps}, {at.stage}",
                time=f"{timedelta(seconds=round(at.left_s))} left",
            )

        whole = OverallProgress(steps, draw)

        def bar(stage: str, done: int, total: int) -> None:
            stop.check()
            whole(stage, done, total)

        yield bar
        whole.finish()
        bars.update(task, description="done", time=f"in {timedelta(seconds=round(time.monotonic() - start))}")


@contextmanager
def new_folder(out: Path, door: Door, *, force: bool) -> Iterator[Path]:
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
    folder, held = _begun(out)
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
            _keep_under_another_name(out)
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
    finally:
        if held is not None:
            os.close(held)


def _keep_under_another_name(out: Path) -> None:
    number = 1
    while (kept := out.with_name(f"{out.name}.old-{number}")).exists():
        number += 1
    out.rename(kept)


def _begun(out: Path) -> tuple[Path, int | None]:
    """Return a new hidden folder beside another, and what holds its lock, after removing those of dead processes.

    The system gives a lock up when the process that holds it is gone, however it went. A lock may hold on one machine
    only, so the name of the folder says on which.

    Raises
    ------
    InputError
        If another process is at work for the same folder.
    """
    here = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:6]
    head = f".{out.name}-{here}-"
    while True:
        _require_alone(out, here)
        folder = Path(tempfile.mkdtemp(prefix=head, dir=out.parent))
        with suppress(BlockingIOError):  # another process takes it for one that was left, and removes it
            held = _lock(folder)
            if folder.is_dir():
                break
            if held is not None:
                os.close(held)
    try:
        _require_alone(out, here, folder.name)
    except InputError:
        shutil.rmtree(folder, ignore_errors=True)
        if held is not None:
            os.close(held)
        raise
    return folder, held


def _require_alone(out: Path, here: str, own: str = "") -> None:
    """Remove what dead processes have left beside a folder, whatever it was for; refuse one that is being made.

    Of two that begin at a time that one goes on whose hidden name comes first.
    """
    left = re.compile(rf"\.(.+)-{here}-[a-z0-9_]{{8}}")  # as mkdtemp names them
    others: list[Path] = []
    with suppress(OSError):  # one may be allowed to write where one may not look
        others = [one for one in out.parent.iterdir() if one.name != own and left.fullmatch(one.name)]
    for other in others:
        try:
            held = _lock(other)
        except BlockingIOError:
            found = left.fullmatch(other.name)
            if found is not None and found[1] == out.name and (not own or other.name < own):
                raise InputError(
                    f"another run is writing {str(out)!r}: name another folder, or wait for its end"
                ) from None
            continue
        if held is not None:
            shutil.rmtree(other, ignore_errors=True)
            os.close(held)


def _lock(folder: Path) -> int | None:
    """Return a descriptor that holds the lock of a folder; ``None`` where there are no locks.

    Raises
    ------
    BlockingIOError
        If another process holds it.
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
