"""Read a file in a process of its own, so that a library that dies of a damaged file takes nobody with it.

libhdf5 does: one changed byte in an attribute of varying length, and it reads where there is nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from turnwright.errors import MapError
from turnwright.files import arrays, datx
from turnwright.files._base import DAMAGE

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["read_datx"]

LONGEST = 300
"""Seconds until a file is given up."""

PROGRAM = f"import sys, {__name__} as apart; sys.exit(apart.main())"
"""What the other process runs."""

REFUSED = 3
"""How the process ends that has a sentence to say."""


def read_datx(path: Path, data: bytes) -> HeightMap:
    """Read a datx file; its bytes go to the other process, its map comes back."""
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            [sys.executable, "-P", "-c", PROGRAM, str(path)],
            input=data,
            capture_output=True,
            timeout=LONGEST,
            check=False,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
    except subprocess.TimeoutExpired as error:
        raise MapError(f"{path} is not read after {LONGEST} s, the limit: it is damaged, so copy it again") from error
    if done.returncode == REFUSED:
        raise MapError(done.stderr.decode("utf-8", "replace"))
    if done.returncode != 0:
        raise MapError(f"{path} is HDF5 that cannot be read (code {done.returncode}): it is damaged, so copy it again")
    return arrays.read_named(path, done.stdout)


def main() -> int:
    """Read the bytes that come in as the file that is named, and send its map out."""
    path = Path(sys.argv[1])
    try:
        found = arrays.packed(datx.read(path, sys.stdin.buffer.read()))
    except MapError as error:
        sys.stderr.buffer.write(str(error).encode())
        return REFUSED
    except DAMAGE:
        return 1
    sys.stdout.buffer.write(found)
    return 0
