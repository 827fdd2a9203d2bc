"""Files: reading TOML, writing files atomically, and reading HDF5 in a separate process."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import IO, Any

from turnwright.errors import InputError

__all__ = [
    "answer_parent",
    "atomic_file",
    "bytes_of",
    "json_data",
    "part_of",
    "read_isolated",
    "read_toml",
    "write_atomic",
    "write_json",
]  # fmt: skip

MAX_TOML_BYTES = 1 << 20
"""Bytes of a TOML file; Python reads about a megabyte of TOML per second."""

MAX_INTEGER_BITS = 14_000


DUPLICATE_ERRORS = (
    (re.compile(r"Cannot overwrite a value (\(.*\))"), "a key is given twice"),
    (re.compile(r"Cannot declare .* twice (\(.*\))"), "a table is given twice"),
)
"""Python's messages about repeated keys, and their plain form."""


def read_toml(data: bytes, what: str) -> dict[str, Any]:
    """Return the tables of a TOML file, with or without a byte order mark; ``what`` is the file as a message names it.

    Raises
    ------
    InputError
        If the file is too large, not UTF-8 or not TOML, or holds a number of thousands of digits.
    """
    if len(data) > MAX_TOML_BYTES:
        raise InputError(
            f"{what} has {len(data):,} bytes, the limit is {MAX_TOML_BYTES:,}: move long tables of numbers to separate "
            "files and name these"
        )
    try:
        table = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{what} is not UTF-8 text: save it as a plain text file") from error
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        reason = next(
            (f"{text} {match[1]}" for pattern, text in DUPLICATE_ERRORS if (match := pattern.search(message))), message
        )
        raise InputError(f"{what} is not TOML, {reason}: correct that line") from error
    except ValueError as error:
        raise _too_many_digits(what) from error
    except RecursionError as error:
        raise InputError(f"{what} nests lists or tables too deeply to be read: flatten them") from error
    pending: list[Any] = [table]
    while pending:
        value = pending.pop()
        if isinstance(value, dict | list):
            pending.extend(value.values() if isinstance(value, dict) else value)
        elif isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
            raise _too_many_digits(what)
    return table


def _too_many_digits(what: str) -> InputError:
    return InputError(f"{what} holds a whole number of thousands of digits: shorten it")


def bytes_of(path: Path, what: str, remedy: str = "check its name and folder") -> bytes:
    """Return the contents of a file; a message of failure ends with the remedy."""
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "invalid file name"
        raise InputError(f"{what} {str(path)!r} cannot be read ({reason}): {remedy}") from error


def part_of(path: Path) -> Path:
    """Return the temporary path of a file that is being written; a killed process leaves it behind."""
    return path.with_name(f".{path.name}.part")


@contextmanager
def atomic_file(path: Path) -> Iterator[IO[bytes]]:
    """Yield a stream whose file replaces ``path`` only when the block ends without an exception."""
    if not path.name:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    part = part_of(path)
    try:
        with part.open("wb") as stream:
            yield stream
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_atomic(path: Path, text: str | bytes | memoryview) -> None:
    """Write a file that replaces ``path`` only when it is complete."""
    with atomic_file(path) as stream:
        stream.write(text.encode() if isinstance(text, str) else text)


READ_TIMEOUT_S = 300
READER = "import sys, {module} as reader; sys.exit(reader.main())"
"""Code of the separate process: the ``main`` of a module, which calls `answer_parent`."""

REFUSAL_EXIT_CODE = 3
"""Exit code of a process that wrote a message of refusal to its standard error."""


def json_data(value: Any) -> Any:
    """Convert dataclasses, arrays and mappings to JSON data; numbers that are not finite become ``None``."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    elif hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): json_data(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [json_data(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, bool | str | int) or value is None else str(value)


def write_json(path: Path, value: Any) -> None:
    """Write `json_data` of a value."""
    write_atomic(path, json.dumps(json_data(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def read_isolated(
    module: str, path: Path, *, refusal: type[InputError], arguments: Sequence[str] = (), data: bytes | None = None
) -> bytes:
    """Read an HDF5 file in a separate process, as a damaged one may crash it, and return the output.

    The ``main`` of the module reads the file, with the path and the further arguments, and ``data`` as standard input.

    Raises
    ------
    InputError
        As ``refusal``, with the message of the process, or that the file is damaged.
    """
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            [sys.executable, "-P", "-c", READER.format(module=module), str(path), *arguments],
            input=data,
            capture_output=True,
            timeout=READ_TIMEOUT_S,
            check=False,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
    except subprocess.TimeoutExpired as error:
        raise refusal(
            f"{path} is not read within {READ_TIMEOUT_S} s, the limit: it is damaged, so copy it again"
        ) from error
    if done.returncode == REFUSAL_EXIT_CODE:
        raise refusal(done.stderr.decode("utf-8", "replace"))
    if done.returncode != 0:
        raise refusal(f"{path} is HDF5 that cannot be read (code {done.returncode}): it is damaged, so copy it again")
    return done.stdout


def answer_parent(
    work: Callable[[], bytes], *, refusal: type[InputError], damage: tuple[type[BaseException], ...]
) -> int:
    """Write the result of some work to standard output, or its refusal to standard error; return the exit code."""
    try:
        result = work()
    except refusal as error:
        sys.stderr.buffer.write(str(error).encode())
        return REFUSAL_EXIT_CODE
    except damage:
        return 1
    sys.stdout.buffer.write(result)
    return 0
