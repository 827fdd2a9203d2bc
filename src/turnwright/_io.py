"""Files: TOML read, output that appears only when it is complete, and readers in a process of their own."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from turnwright.errors import InputError

__all__ = ["answer_parent", "bytes_of", "part_of", "read_isolated", "read_toml", "whole_file", "write_whole"]

LARGEST = 1 << 20
"""Bytes of a file: Python reads about a megabyte of TOML a second, and large tables have files of their own."""

MOST_BITS = 14_000
"""Of a whole number; Python writes out none of more than 4300 digits."""


TWICE = (
    (re.compile(r"Cannot overwrite a value (\(.*\))"), "a key is given twice"),
    (re.compile(r"Cannot declare .* twice (\(.*\))"), "a table is given twice"),
)
"""What Python says of keys that are repeated, and what it means."""


def read_toml(data: bytes, what: str) -> dict[str, Any]:
    """Return the tables of a TOML file, a byte order mark before them or not.

    Parameters
    ----------
    data
        The bytes of the file.
    what
        The file as a message names it.

    Raises
    ------
    InputError
        If the bytes are too many or not UTF-8, or the text is not TOML or holds a number of thousands of digits.
    """
    if len(data) > LARGEST:
        raise InputError(
            f"{what} has {len(data):,} bytes, the limit is {LARGEST:,}: keep long tables of numbers in files of their "
            "own, which it names"
        )
    try:
        table = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{what} is not UTF-8 text: save it as a plain text file") from error
    except tomllib.TOMLDecodeError as error:
        reason = next((f"{said} {place[1]}" for sign, said in TWICE if (place := sign.search(str(error)))), str(error))
        raise InputError(f"{what} is not TOML, {reason}: correct that place") from error
    except ValueError as error:
        raise _too_many_digits(what) from error
    except RecursionError as error:
        raise InputError(f"{what} holds lists or tables within each other too deep to read: make them flat") from error
    waiting: list[Any] = [table]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list):
            waiting.extend(one.values() if isinstance(one, dict) else one)
        elif isinstance(one, int) and one.bit_length() > MOST_BITS:
            raise _too_many_digits(what)
    return table


def _too_many_digits(what: str) -> InputError:
    return InputError(f"{what} holds a whole number of thousands of digits: shorten it")


def bytes_of(path: Path, what: str, remedy: str = "check its name and place") -> bytes:
    """Return what a file holds, or say that it cannot be read, and the remedy."""
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is no name of a file"
        raise InputError(f"{what} {str(path)!r} cannot be read ({why}): {remedy}") from error


def part_of(path: Path) -> Path:
    """Return where a file is until all of it is there; what a killed process leaves of it."""
    return path.with_name(f".{path.name}.part")


@contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """Yield a file to fill, which takes its name only when the block ends well; what stood there before is replaced."""
    if not path.name:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    part = part_of(path)
    try:
        with part.open("wb") as stream:
            yield stream
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_whole(path: Path, text: str | bytes | memoryview) -> None:
    """Write a file, which takes its name only when all of it is there; what stood there before is replaced."""
    with whole_file(path) as stream:
        stream.write(text.encode() if isinstance(text, str) else text)


LONGEST_READ_S = 300
"""Seconds until a file is given up."""

READER = "import sys, {module} as reader; sys.exit(reader.main())"
"""What the other process runs: the ``main`` of a module, which calls `answer_parent`."""

REFUSED = 3
"""How the process ends that has a sentence to say."""


def read_isolated(
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
            [sys.executable, "-P", "-c", READER.format(module=module), str(path), *arguments],
            input=data,
            capture_output=True,
            timeout=LONGEST_READ_S,
            check=False,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
    except subprocess.TimeoutExpired as error:
        raise refusal(
            f"{path} is not read after {LONGEST_READ_S} s, the limit: it is damaged, so copy it again"
        ) from error
    if done.returncode == REFUSED:
        raise refusal(done.stderr.decode("utf-8", "replace"))
    if done.returncode != 0:
        raise refusal(f"{path} is HDF5 that cannot be read (code {done.returncode}): it is damaged, so copy it again")
    return done.stdout


def answer_parent(
    work: Callable[[], bytes], *, refusal: type[InputError], damage: tuple[type[BaseException], ...]
) -> int:
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
