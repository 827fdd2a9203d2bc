"""The door of the command line: it hears a wish to stop from the first moment, and says how the work ended.

Exit codes: 0 done and every stated tolerance kept, 1 a defect of Turnwright (the traceback is kept in a file), 2 bad
input, a limit that cannot be kept or an output that cannot be written, 3 a correction that is not written because it
would not certainly help, 4 done and written but a stated tolerance is missed, 128 and the number of the signal that
stopped it (130 for Ctrl-C, 143 for SIGTERM). A reader of the output that goes away (as ``head`` does) changes nothing.
"""

from __future__ import annotations

import errno
import os
import sys
from typing import TYPE_CHECKING, Any

from turnwright._signals import Stop

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.cli.commands import Door

__all__ = ["main"]

INTERRUPTED = 130
NOT_CERTAIN = 3
DONE = (0, 4)
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


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
    with Stop(deaf=True) as stop:  # what it raises must be caught below
        try:
            stop.hear()
            _open_closed()
            # Its matrices are small: on a busy machine, threads of BLAS wait for each other many times as long.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
            # Costly, so an interrupt may well come meanwhile.
            from turnwright.cli.commands import Door  # noqa: PLC0415

            door = Door(stop)
            code = _carry_out(arguments, door)
        except BaseException:
            if not stop.wanted:
                raise
            door, code = None, INTERRUPTED
        stop.deaf = True
        if stop.wanted or code == INTERRUPTED:
            code = stop.code
            if door is not None and door.kept is not None:
                _say(f"interrupted when all was done: the results are complete in {door.kept}")
            elif door is not None and door.partly:
                _say(f"interrupted, {door.partly}")
            else:
                _say("interrupted, nothing was kept: start it again")
        if code in DONE and door is not None and door.unsaid is not None and door.unsaid.errno != errno.EPIPE:
            _say(f"the standard output cannot be written ({door.unsaid.strerror}): send it elsewhere")
            code = 2
    return code


def _open_closed() -> None:
    """Give a process without standard streams some, so that no file it opens is taken for one."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123 - until the process ends


def _say(text: str) -> None:
    from contextlib import suppress  # noqa: PLC0415 - all imports wait until a wish to stop is heard

    from turnwright.errors import shortened  # noqa: PLC0415

    with suppress(OSError):
        for line in shortened(text).splitlines():
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
    import tempfile  # noqa: PLC0415
    import traceback  # noqa: PLC0415
    from contextlib import suppress  # noqa: PLC0415

    kept = "no file could be written for the traceback"
    with suppress(OSError), tempfile.NamedTemporaryFile("w", prefix="turnwright-", suffix=".log", delete=False) as log:
        traceback.print_exc(file=log)
        kept = f"the traceback is in {log.name}"
    reason = f"{type(sys.exception()).__name__}: {sys.exception()}".splitlines()[0]
    return f"this is a defect of Turnwright, not of the job ({reason}), {kept}: please report it"


def _with_options(text: str, command: Any, arguments: Sequence[str]) -> str:
    """Return a message with the options of a command in place of the arguments in Python that they stand for."""
    import re  # noqa: PLC0415

    called = next((command.commands[one] for one in arguments if one in command.commands), None)
    for name in [] if called is None else [one.name for one in called.params]:
        option = f"--{name.replace('_', '-')}"
        text = re.sub(rf"\b{name}=('[^']*'|[\w.]+)", lambda found, option=option: f"{option} {found[1]}", text)  # type: ignore[misc]
    return text


def _carry_out(arguments: Sequence[str] | None, door: Door) -> int:
    """Run a command and turn what ends it into a sentence and an exit code."""
    import warnings  # noqa: PLC0415

    import typer  # noqa: PLC0415

    from turnwright.cli.commands import app, tell  # noqa: PLC0415
    from turnwright.errors import CorrectionError, InputError, Stopped  # noqa: PLC0415

    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_args, **_more: tell(f"warning: {message}")
            command = typer.main.get_command(app)
            return command.main(arguments, prog_name="turnwright", standalone_mode=False, obj=door) or 0
    except (KeyboardInterrupt, typer.Abort, Stopped):
        return INTERRUPTED  # some versions of typer end so by themselves, with the same code
    except CorrectionError as error:
        _say(str(error))
        return NOT_CERTAIN
    except InputError as error:
        _say(_with_options(str(error), typer.main.get_command(app), sys.argv[1:] if arguments is None else arguments))
    except MemoryError as error:
        _say(f"the memory is not enough ({error}): take fewer points or a coarser map")
    except OSError as error:
        _say(_disk_error(error))
    except Exception as error:  # noqa: BLE001 - the door is where everything ends
        if door.stop.wanted:  # an interrupted import fails in many ways
            return INTERRUPTED
        # A wrong command line; typer carries its parser inside or beside it, depending on the version.
        if not hasattr(error, "format_message"):
            _say(_defect())
            return 1
        _say(f"{error.format_message().rstrip('.')}: see turnwright --help")
    return 2
