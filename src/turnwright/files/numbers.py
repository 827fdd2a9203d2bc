"""Reading numbers from text in bulk."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import MapError
from turnwright.files.base import damaged

__all__ = ["numbers", "table", "text_of"]

PRINTABLE = bytes({7, 8, 9, 10, 11, 12, 13, 26, 27} | set(range(0x20, 0x100)))


def text_of(data: bytes) -> str | None:
    """Return the text of a file; ``None`` if it is not text."""
    for mark, name in ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if data.startswith(mark):
            try:
                return data.decode(name)
            except UnicodeDecodeError:
                return None
    if data.translate(None, PRINTABLE):
        return None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def numbers(path: Path, text: str) -> Floats:
    """Return the numbers of a text that holds only numbers. (n,)."""
    if not text.strip():
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise damaged(path, "holds a value that is not a number") from error


def table(path: Path, text: str, separator: str | None, columns: Sequence[int] | None, first_line: int = 1) -> Floats:
    """Return chosen columns of a table, or all, (rows, columns).

    ``text`` has lines with equal numbers of cells, separated by white space without a ``separator``; ``first_line`` is
    the number of its first line in the file.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.loadtxt(
                io.StringIO(text), delimiter=separator, comments="#", usecols=columns, ndmin=2, quotechar='"'
            )
        except UserWarning as error:
            raise MapError(f"{path} holds no numbers where its table should be: it is truncated") from error
        except (ValueError, IndexError) as error:
            reason = str(error).split(";")[0].rstrip(".")
            reason = re.sub(r"at row (\d+)", lambda match: f"in line {int(match[1]) + first_line}", reason)
            raise MapError(
                f"{path} has a table that cannot be read ({reason}): every line must have the same columns, all numbers"
            ) from error
