"""Zygo's text files: ``Zygo ASCII Data File - Format 2`` (phase) and ``Zygo XYZ Data File - Format 1`` (heights).

Both begin with lines of description up to a line ``#``. Format 2 has the intensities, ``#``, the phases, ``#``; phases
are scaled as in `turnwright.files.metropro`. Format 1 has a row ``column row height`` in micrometres, or ``column row
No Data``, for every pixel. The first row is the top of the camera's picture.

Sources
-------
The layout is that of public files. Oracle: files written by hand from it.
"""

from __future__ import annotations

import shlex
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats
from turnwright.files.base import damaged, grid_map, require_bytes, require_points
from turnwright.files.metropro import MISSING, Fringes, fringe_scale
from turnwright.files.numbers import numbers, table
from turnwright.heightmap import HeightMap

__all__ = ["PHASES", "POINTS", "read"]

PHASES = "Zygo ASCII Data File - Format 2"
POINTS = "Zygo XYZ Data File - Format 1"
MIN_DESCRIPTION_LINES, MAX_DESCRIPTION_LINES = 11, 30


def read(path: Path, text: str) -> HeightMap:
    """Read a text file of a Zygo instrument."""
    head, body = _split(path, text)
    phases = head[0].startswith(PHASES)
    first_column, first_row, columns, rows = (_integer(path, head, 4, index) for index in range(4))
    require_points(path, columns, rows)
    fringes = Fringes(
        scale=_number(path, head, 8, 1),
        wavelength=_number(path, head, 8, 2),
        obliquity=_number(path, head, 8, 4),
        resolution=_integer(path, head, 11, 0) if phases else 0,
    )
    if phases:
        require_bytes(path, 2 * columns * rows, len(text))
        blocks = [_integer(path, head, 3, index) for index in range(2, 5)]
        heights = _phases(path, body, blocks, (rows, columns)) * fringe_scale(path, fringes)
    else:
        heights = _points(path, body, (first_column, first_row), (rows, columns))
    size = 1e3 * _number(path, head, 8, 6)
    stamp = _integer(path, head, 8, 7)
    return grid_map(
        path,
        heights[::-1],
        (size, size) if size != 0 else None,
        metadata={
            "format": PHASES if phases else POINTS,
            **fringes.metadata,
            "timestamp": datetime.fromtimestamp(stamp, UTC).isoformat() if 0 < stamp < 1 << 32 else "",
            "comment": head[4].strip('" '),
            "part": head[5].strip('" '),
            "part serial number": head[6].strip('" '),
        },
    )


def _split(path: Path, text: str) -> tuple[list[str], str]:
    head = [line.strip() for line in text.split("\n", MAX_DESCRIPTION_LINES)[:-1]]
    if "#" in head:
        head = head[: head.index("#")]
        if len(head) >= MIN_DESCRIPTION_LINES:
            return head, text.split("\n", len(head) + 1)[-1]
    raise damaged(
        path,
        f"has {len(head)} lines of description above its first '#', the limits are "
        f"{MIN_DESCRIPTION_LINES} to {MAX_DESCRIPTION_LINES}",
    )


def _number(path: Path, head: list[str], line: int, index: int) -> float:
    try:
        return float(shlex.split(head[line - 1])[index])
    except (ValueError, IndexError) as error:
        raise damaged(path, f"has no number {index + 1} in its line {line}, {head[line - 1][:60]!r}") from error


def _integer(path: Path, head: list[str], line: int, index: int) -> int:
    value = _number(path, head, line, index)
    if not (abs(value) < 1 << 53 and value == int(value)):
        raise damaged(path, f"has {value:g} in its line {line}, it must be an integer")
    return int(value)


def _phases(path: Path, body: str, intensity: list[int], shape: tuple[int, int]) -> Floats:
    blocks = body.split("#")
    # A file without intensities may omit their block.
    pictures = min(intensity) > 0 or (len(blocks) > 1 and not blocks[0].strip())
    counts = numbers(path, "".join(blocks[1:2] if pictures else blocks[:1]))
    if counts.size != shape[0] * shape[1]:
        raise damaged(path, f"has {counts.size} phases for {shape[0]} rows of {shape[1]}")
    counts[counts >= MISSING] = np.nan
    return counts.reshape(shape)


def _points(path: Path, body: str, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Return the heights of rows ``column row height``, (rows, columns) [mm]."""
    points = table(path, body.split("#", 1)[0].replace("No Data", "nan"), None, (0, 1, 2), 3)
    column, row = points[:, 0] - corner[0], points[:, 1] - corner[1]
    inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
    inside &= (column == np.rint(column)) & (row == np.rint(row))
    if not inside.all():
        bad = int(np.argmin(inside))
        raise damaged(
            path,
            f"has a height at column {points[bad, 0]:g}, row {points[bad, 1]:g}, outside its {shape[1]} x "
            f"{shape[0]} pixels from {corner}",
        )
    place = (row * shape[1] + column).astype(np.int64)
    if np.bincount(place, minlength=1).max() > 1:
        raise damaged(path, "has two heights at one pixel")
    heights: Floats = np.full(shape, np.nan)
    heights.reshape(-1)[place] = points[:, 2] * 1e-3
    return heights
