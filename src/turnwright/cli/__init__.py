"""Entry point of the command line: it handles signals from the start and turns the outcome into an exit code.

Exit codes:

- 0: done, every stated tolerance met
- 1: a defect of Turnwright; its traceback is written to a file
- 2: bad input, a limit exceeded, or output that cannot be written
- 3: a correction that is not written, because it would not certainly reduce the error
- 4: done and written, but a stated tolerance is missed
- 128 + n: stopped by signal n (130 for Ctrl-C, 143 for SIGTERM)

A closed output pipe (as with ``head``) does not change the exit code.
"""

from __future__ import annotations

import atexit
import errno
import gc
import os
import sys
from typing import TYPE_CHECKING, Any

from turnwright._signals import Stop

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright.cli.commands import Session

__all__ = ["main"]

INTERRUPTED_CODE = 130
NOT_CORRECTED_CODE = 3
SUCCESS_CODES = (0, 4)
DISK_FULL_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}

FEWEST_OBJECTS = 20_000
"""Objects made between two collections: imports make many, and at every 700 they take a tenth of a second longer."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, by default with the arguments of the process; return the exit code."""
    with Stop(records_only=True) as stop:  # what it raises must be caught below
        try:
            stop.arm()
            _open_closed()
            gc.set_threshold(FEWEST_OBJECTS)
            atexit.register(gc.freeze)  # or the last collection would examine every object
            # The matrices are small: on a busy machine, BLAS threads would mostly wait for each other.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
            # Slow import: an interrupt may arrive during it.
            from turnwright.cli.commands import Session  # noqa: PLC0415

            session = Session(stop)
            code = _carry_out(arguments, session)
        except BaseException:
            if not stop.wanted:
                raise
            session, code = None, INTERRUPTED_CODE
        stop.records_only = True
        if stop.wanted or code == INTERRUPTED_CODE:
            code = stop.code
            if session is not None and session.finished is not None:
                _print_error(f"interrupted after completion: the results in {session.finished} are complete")
            elif session is not None and session.partial:
                _print_error(f"interrupted, {session.partial}")
            else:
                _print_error("interrupted, no results were written: start the command again")
        if (
            code in SUCCESS_CODES
            and session is not None
            and session.output_error is not None
            and session.output_error.errno != errno.EPIPE
        ):
            _print_error(f"cannot write to standard output ({session.output_error.strerror}): redirect it")
            code = 2
    return code


def _open_closed() -> None:
    """Open missing standard streams on the null device, so that no other file takes their descriptors."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123 - until the process ends


def _print_error(text: str) -> None:
    from contextlib import suppress  # noqa: PLC0415 - no import before signals are handled

    from turnwright.errors import shorten_message  # noqa: PLC0415

    with suppress(OSError):
        for line in shorten_message(text).splitlines():
            print(f"turnwright: {line}", file=sys.stderr)  # noqa: T201 - the one place errors go


def _disk_error(error: OSError) -> str:
    where = f" at {error.filename}" if error.filename else ""
    text = str(error)
    # HDF5 and NumPy report a full disk in their own words: "errno = 28," and "1000 requested and 12 written".
    codes = DISK_FULL_ERRORS
    if error.errno in codes or "requested and" in text or any(f"errno = {number}," in text for number in codes):
        return f"the disk is full{where}, no results were written: free some space, or choose another folder"
    reason = error.strerror or text.splitlines()[0]
    return f"operating system error{where} ({reason}), no results were written: check the name and its permissions"


def _log_defect() -> str:
    """Write the traceback of a defect to a file and return a message that names it."""
    import tempfile  # noqa: PLC0415
    import traceback  # noqa: PLC0415
    from contextlib import suppress  # noqa: PLC0415

    trace = "its traceback could not be written"
    with suppress(OSError), tempfile.NamedTemporaryFile("w", prefix="turnwright-", suffix=".log", delete=False) as log:
        traceback.print_exc(file=log)
        trace = f"the traceback is in {log.name}"
    reason = f"{type(sys.exception()).__name__}: {sys.exception()}".splitlines()[0]
    return f"this is a defect of Turnwright, not of the job ({reason}), {trace}: please report it"


def _with_options(text: str, command: Any, arguments: Sequence[str]) -> str:
    """Replace Python argument names in a message by the options of the command."""
    import re  # noqa: PLC0415

    called = next((command.commands[word] for word in arguments if word in command.commands), None)
    for name in [] if called is None else [parameter.name for parameter in called.params]:
        option = f"--{name.replace('_', '-')}"
        text = re.sub(rf"\b{name}=('[^']*'|[\w.]+)", lambda match, option=option: f"{option} {match[1]}", text)  # type: ignore[misc]
    return text


def _carry_out(arguments: Sequence[str] | None, session: Session) -> int:
    """Run a command; report an error in one sentence and return the exit code."""
    import warnings  # noqa: PLC0415

    import typer  # noqa: PLC0415

    from turnwright.cli.commands import command, print_status  # noqa: PLC0415
    from turnwright.errors import CorrectionError, InputError, Stopped  # noqa: PLC0415

    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_args, **_more: print_status(f"warning: {message}")
            return command.main(arguments, prog_name="turnwright", standalone_mode=False, obj=session) or 0
    except (KeyboardInterrupt, typer.Abort, Stopped):
        return INTERRUPTED_CODE  # the code that some versions of typer return by themselves
    except CorrectionError as error:
        _print_error(str(error))
        return NOT_CORRECTED_CODE
    except InputError as error:
        _print_error(_with_options(str(error), command, sys.argv[1:] if arguments is None else arguments))
    except MemoryError as error:
        _print_error(f"out of memory ({error}): use fewer points or a coarser map")
    except OSError as error:
        _print_error(_disk_error(error))
    except Exception as error:  # noqa: BLE001 - the outermost handler
        if session.stop.wanted:  # an interrupted import fails in many ways
            return INTERRUPTED_CODE
        # A usage error; its class depends on the version of typer.
        if not hasattr(error, "format_message"):
            _print_error(_log_defect())
            return 1
        _print_error(f"{error.format_message().rstrip('.')}: see turnwright --help")
    return 2
