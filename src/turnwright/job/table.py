"""Base class of the tables of a job file, and a reader of CSV columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from turnwright._arrays import Floats, Value
from turnwright._tables import Stated
from turnwright.errors import JobError, UnitError
from turnwright.units import parse

__all__ = ["Table", "read_columns"]


class Table(Stated, Value):
    """Base class of the tables of a job file that only hold values."""

    __slots__ = ()
    like: ClassVar[Any] = None
    """Class or function whose docstring explains the fields of the same names."""


def read_columns(file: Path, columns: Mapping[str, str]) -> Iterator[Floats]:
    """Read a CSV table whose first row names the columns with their units, such as ``sweep [deg],deviation [um]``.

    Lines starting with # are comments. Yields each of the named columns in the stated unit. (n,)

    Raises
    ------
    JobError
        If the file is not a CSV table, a column is missing or a value is not a number.
    UnitError
        If a column has the wrong unit.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as lines:
            rows = [row for row in csv.reader(lines) if row and not row[0].lstrip().startswith("#")]
    except (UnicodeDecodeError, csv.Error) as error:
        raise JobError(f"{file.name} is not a CSV table in UTF-8 ({error}): save it as plain text") from error
    heads = [re.fullmatch(r"\s*(.*?)\s*\[(.*)\]\s*", cell) for cell in (rows[0] if rows else [])]
    units = {head.group(1): (place, head.group(2)) for place, head in enumerate(heads) if head}
    for name, wanted in columns.items():
        if name not in units:
            raise JobError(
                f"{file.name} has no column {name!r} in its first row: name its columns like "
                f"{','.join(f'{key} [{value}]' for key, value in columns.items())!r}"
            )
        place, have = units[name]
        values = np.empty(len(rows) - 1)
        for number, row in enumerate(rows[1:]):
            text = f"{row[place] if place < len(row) else ''} {have}"
            try:
                values[number] = parse(text, wanted)
            except UnitError as error:
                raise UnitError(f"{file.name}, row {number + 1} below the header, column {name}: {error}") from error
        yield values
