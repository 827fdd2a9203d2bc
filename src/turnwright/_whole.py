"""Files that appear when they are whole."""

from __future__ import annotations

import errno
import os
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["part_of", "whole_file", "write_whole"]


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
