"""Files: reading TOML, writing files atomically, and reading HDF5 in a separate process."""

from __future__ import annotations

import atexit
import errno
import json
import math
import os
import pickle  # noqa: TID251 - of what one process orders from another, never of a file
import re
import signal
import struct
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from threading import Timer
from time import monotonic
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
READER = "from turnwright._io import answer_parent; answer_parent()"
"""Code of the process that reads HDF5."""

ANSWER = struct.Struct("<BQ")
"""Before the result of a work: its status, and its size in bytes."""

DONE, REFUSED, DAMAGED, DIED = range(4)


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


MOST_IDLE = 2
"""Most processes kept for the next file; each holds 44 MB."""

_idle_readers: dict[int, list[subprocess.Popen[bytes]]] = {}
"""Processes that wait for the next file, by the process that started them: a fork has none."""


def read_isolated(work: Callable[..., bytes], path: Path, *arguments: Any, refusal: type[InputError]) -> bytes:
    """Return ``work(path, *arguments)``, which reads HDF5, from a separate process, as a damaged file may crash it.

    The process is kept for the next file, since starting it takes most of the time, unless the work fails.

    Raises
    ------
    InputError
        As ``refusal``, with the message of the work, or that the file is damaged.
    """
    order, deadline = (work, path, *arguments), monotonic() + READ_TIMEOUT_S
    status, result, code = DIED, b"", 0
    if (reader := _take_idle_reader()) is not None:
        status, result, code = _run(reader, order)
    if status == DIED and monotonic() < deadline:  # none was kept, or it has been killed
        status, result, code = _run(_start_reader(), order)
    if status == DONE:
        return result
    if status == REFUSED:
        raise refusal(result.decode())
    if monotonic() >= deadline:
        raise refusal(f"{path} is not read within {READ_TIMEOUT_S} s, the limit: it is damaged, so copy it again")
    code = 1 if status == DAMAGED else code
    raise refusal(f"{path} is HDF5 that cannot be read (code {code}): it is damaged, so copy it again")


def _take_idle_reader() -> subprocess.Popen[bytes] | None:
    idle = _idle_readers.get(os.getpid(), [])
    with suppress(IndexError):
        while True:
            reader = idle.pop()
            if reader.poll() is None:
                return reader
            _end(reader)  # another program has killed it
    return None


def _start_reader() -> subprocess.Popen[bytes]:
    return subprocess.Popen(  # noqa: S603 - our own code
        [sys.executable, "-P", "-c", READER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )


def _run(reader: subprocess.Popen[bytes], order: tuple[Any, ...]) -> tuple[int, bytes, int]:
    """Return the status and the result of some work, and the exit code of the process where it has ended."""
    timer = Timer(READ_TIMEOUT_S, reader.kill)
    timer.start()
    status, result, code = DIED, b"", 0
    try:
        with suppress(OSError, struct.error):  # of a process that has died
            status, result = _ask(reader, order)
    finally:
        timer.cancel()
        idle = _idle_readers.setdefault(os.getpid(), [])
        if status == DONE and len(idle) < MOST_IDLE:
            idle.append(reader)
        else:
            code = _end(reader)
    return status, result, code


def _ask(reader: subprocess.Popen[bytes], order: tuple[Any, ...]) -> tuple[int, bytes]:
    """Return the status and the result of some work; raise if the process dies before it has answered."""
    assert reader.stdin is not None  # noqa: S101 - both are pipes
    assert reader.stdout is not None  # noqa: S101
    pickle.dump(order, reader.stdin)
    reader.stdin.flush()
    status, size = ANSWER.unpack(reader.stdout.read(ANSWER.size))
    result = reader.stdout.read(size)
    return (status if len(result) == size else DIED), result


def _end(reader: subprocess.Popen[bytes]) -> int:
    """End a process, and return its exit code."""
    with suppress(OSError), reader:  # its pipes may be broken
        reader.kill()
    return reader.wait()


@atexit.register
def _end_idle_readers() -> None:
    for reader in _idle_readers.pop(os.getpid(), []):
        _end(reader)


def answer_parent() -> None:
    """Do the work that the parent process orders, until that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent process too, which ends this one
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print
    with suppress(EOFError):
        while True:
            _answer(answers)


def _answer(answers: IO[bytes]) -> None:
    work, *arguments = pickle.load(sys.stdin.buffer)  # noqa: S301 - of the parent process
    try:
        status, result = DONE, work(*arguments)
    except InputError as error:
        status, result = REFUSED, str(error).encode()
    except Exception:  # noqa: BLE001 - whatever h5py raises at a damaged file
        status, result = DAMAGED, b""
    # Bytes only: nothing that a file could make of this process is executed by its parent.
    answers.write(ANSWER.pack(status, len(result)))
    answers.write(result)
    answers.flush()
