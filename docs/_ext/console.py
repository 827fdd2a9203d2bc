"""Carry out commands of Turnwright on a page and print what a terminal would show, without the progress."""

import contextlib
import io
import shlex
import tempfile
from pathlib import Path
from textwrap import fill

from turnwright.cli import main

folder = Path(tempfile.mkdtemp())
"""Where the commands of a page are carried out."""


def turnwright(line: str) -> None:
    """Carry out one command in the folder of the page; warnings are shown."""
    printed, messages = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed), contextlib.redirect_stderr(messages):
        main(shlex.split(line))
    lines = printed.getvalue().replace(f"{folder}/", "").splitlines()
    lines += [one for one in messages.getvalue().splitlines() if one.startswith("turnwright:")]
    print("\n".join(fill(one, 96, subsequent_indent="    ") for one in lines))
