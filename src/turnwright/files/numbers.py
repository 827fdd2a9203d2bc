"""Numbers out of text, in bulk."""

from __future__ import annotations

import io
import re
import warnings
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import MapError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["numbers", "table", "text_of"]

PRINTABLE = bytes({7, 8, 9, 10, 11, 12, 13, 26, 27} | set(range(0x20, 0x100)))


def text_of(data: bytes) -> str | None:
    """Return the text of a file, or nothing if it is none."""
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
    """Return all numbers of a text that has nothing else in it, (n,)."""
    if not text.strip():
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise MapError(
                f"{path} holds something that is not a number among its numbers: it is damaged, so export it again"
            ) from error


def table(path: Path, text: str, separator: str | None, columns: Sequence[int] | None, first_line: int = 1) -> Floats:
    """Return chosen columns of a table, (rows, columns).

    Parameters
    ----------
    path
        Of the file, for the sentence if something is wrong.
    text
        Lines, each with as many cells.
    separator
        Between the cells; any white space if none is given.
    columns
        Those that are wanted, in this order, or all.
    first_line
        The line of the file in which the text begins.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.loadtxt(
                io.StringIO(text), delimiter=separator, comments="#", usecols=columns, ndmin=2, quotechar='"'
            )
        except UserWarning as error:
            raise MapError(f"{path} holds no numbers where its table should be: it is cut short") from error
        except (ValueError, IndexError) as error:
            said = str(error).split(";")[0].rstrip(".")
            said = re.sub(r"at row (\d+)", lambda found: f"in line {int(found[1]) + first_line}", said)
            raise MapError(
                f"{path} has a table that cannot be read ({said}): every line must have the same columns, all of them "
                "numbers"
            ) from error
