"""Read a file in a process of its own, so that a library that dies of a damaged file takes nobody with it.

libhdf5 does: one changed byte in an attribute of varying length, and it reads where there is nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from turnwright.errors import InputError

__all__ = ["answer", "ask"]

LONGEST = 300
"""Seconds until a file is given up."""

PROGRAM = "import sys, {module} as apart; sys.exit(apart.main())"
"""What the other process runs: the ``main`` of a module, which calls `answer`."""

REFUSED = 3
"""How the process ends that has a sentence to say."""


def ask(
    module: str, path: Path, *, refusal: type[InputError], arguments: Sequence[str] = (), data: bytes | None = None
) -> bytes:
    """Return what the other process makes of an HDF5 file.

    Parameters
    ----------
    module
        Whose ``main`` reads it; the path is its first argument.
    path
        Of the file.
    refusal
        What is raised where the file cannot be read.
    arguments
        Further ones.
    data
        Bytes that it finds on its standard input.

    Raises
    ------
    InputError
        The refusal, with the other process's sentence or with one about damage.
    """
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            [sys.executable, "-P", "-c", PROGRAM.format(module=module), str(path), *arguments],
            input=data,
            capture_output=True,
            timeout=LONGEST,
            check=False,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
    except subprocess.TimeoutExpired as error:
        raise refusal(f"{path} is not read after {LONGEST} s, the limit: it is damaged, so copy it again") from error
    if done.returncode == REFUSED:
        raise refusal(done.stderr.decode("utf-8", "replace"))
    if done.returncode != 0:
        raise refusal(f"{path} is HDF5 that cannot be read (code {done.returncode}): it is damaged, so copy it again")
    return done.stdout


def answer(work: Callable[[], bytes], *, refusal: type[InputError], damage: tuple[type[BaseException], ...]) -> int:
    """Send out what some work returns, or its refusal, and return how the process is to end."""
    try:
        found = work()
    except refusal as error:
        sys.stderr.buffer.write(str(error).encode())
        return REFUSED
    except damage:
        return 1
    sys.stdout.buffer.write(found)
    return 0
