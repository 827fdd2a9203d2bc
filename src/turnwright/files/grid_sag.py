"""Zemax OpticStudio's grid sag ``.dat``: a line ``nx ny delx dely unit xdec ydec``, then a line for each point.

A point is ``z dz/dx dz/dy d2z/dxdy nodata``, where nodata is optional and 1 for a missing point. The first point is at
-x and +y; x runs fastest, and rows descend in y. The grid is centred on (xdec, ydec). The unit is 0 mm, 1 cm, 2 in,
3 m. Lines that begin with ``!`` are comments. Slopes are ignored, and written as 0, so that Zemax computes them.

Sources
-------
[Zemax]_ gives the layout.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from turnwright.errors import MapError
from turnwright.files.base import damaged, even_axes, grid_map, require_bytes, require_points, to_mm
from turnwright.files.numbers import table
from turnwright.heightmap import HeightMap

__all__ = ["is_grid_sag", "pack", "read"]

UNITS = {0: "mm", 1: "cm", 2: "in", 3: "m"}
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
HEAD = re.compile(
    rf"(?:[ \t]*(?:![^\n]*)?\r?\n)*[ \t]*(\d+)[ \t]+(\d+)[ \t]+({NUMBER})[ \t]+({NUMBER})[ \t]+([0-3])"
    rf"(?:[ \t]+({NUMBER})[ \t]+({NUMBER}))?[ \t]*\r?(?:\n|$)"
)
MIN_ROWS = 5
"""Rows and columns of the smallest grid that Zemax accepts."""


def is_grid_sag(text: str) -> bool:
    """Whether a text begins like a grid sag file."""
    return HEAD.match(text) is not None


def read(path: Path, text: str) -> HeightMap:
    """Read a grid sag file."""
    head = HEAD.match(text)
    if head is None:
        raise MapError(f"{path} has no line of nx ny delx dely unit xdec ydec: write it again")
    columns, rows, unit = int(head[1]), int(head[2]), int(head[5])
    require_points(path, columns, rows)
    require_bytes(path, 8 * columns * rows, len(text) - head.end())
    body = text[head.end() :].replace("!", "#")
    first = next((line for line in body.splitlines() if line.split("#")[0].strip()), "")
    flagged = len(first.split("#")[0].split()) > 4
    points = table(path, body, None, (0, 4) if flagged else (0,), text.count("\n", 0, head.end()) + 1)
    if len(points) != columns * rows:
        raise damaged(path, f"has {len(points)} points for {columns} x {rows}")
    scale = to_mm(UNITS[unit], f"{path} has the unit")
    heights = points[:, 0] * scale
    if flagged:
        heights[points[:, 1] != 0] = np.nan
    pixel = tuple(abs(float(step)) * scale for step in head.group(3, 4))
    centre = tuple(float(place or 0) * scale for place in head.group(6, 7))
    start = (centre[0] - (columns - 1) / 2 * pixel[0], centre[1] - (rows - 1) / 2 * pixel[1])
    return grid_map(
        path,
        heights.reshape(rows, columns)[::-1],
        (pixel[0], pixel[1]),
        start=start,
        metadata={"format": "Zemax grid sag"},
    )


def pack(heights: HeightMap) -> bytes:
    """Return the bytes of a grid sag file in mm."""
    start, pixel = even_axes(heights, "grid sag")
    rows, columns = heights.z.shape
    if min(rows, columns) < MIN_ROWS:
        raise MapError(
            f"the map {heights.name!r} has {rows} rows and {columns} columns, Zemax needs at least {MIN_ROWS} of each: "
            "write it as .npz"
        )
    centre = (start[0] + (columns - 1) / 2 * pixel[0], start[1] + (rows - 1) / 2 * pixel[1])
    lines = [f"{columns} {rows} {pixel[0]!r} {pixel[1]!r} 0 {centre[0]!r} {centre[1]!r}"]
    for row in heights.z[::-1].tolist():
        lines.extend("0 0 0 0 1" if math.isnan(z) else f"{z!r} 0 0 0 0" for z in row)
    return ("\n".join(lines) + "\n").encode("ascii")
