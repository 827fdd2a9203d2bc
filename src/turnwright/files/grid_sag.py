"""Zemax OpticStudio's grid sag ``.dat``: a line ``nx ny delx dely unit xdec ydec``, then a line for each point.

A point is ``z dz/dx dz/dy d2z/dxdy nodata``, where nodata is optional and 1 for a missing point. The first point is at
-x and +y; x runs fastest, and rows descend in y. The grid is centred on (xdec, ydec). The unit is 0 mm, 1 cm, 2 in,
3 m. Lines that begin with ``!`` are comments. Slopes are ignored when read. Grid phase files are the same with radians
of phase in place of z; the unit is then that of the steps and slopes. They are written with a remark, by which they are
not read as heights.

Sources
-------
[Zemax]_ gives the layout of both.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import MapError
from turnwright.files.base import damaged, even_axes, grid_map, require_bytes, require_points, to_mm
from turnwright.files.numbers import table
from turnwright.heightmap import HeightMap
from turnwright.surface import Gridded

__all__ = ["is_grid_sag", "pack", "pack_slopes", "read"]

UNITS = {0: "mm", 1: "cm", 2: "in", 3: "m"}
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
HEAD = re.compile(
    rf"(?:[ \t]*(?:![^\n]*)?\r?\n)*[ \t]*(\d+)[ \t]+(\d+)[ \t]+({NUMBER})[ \t]+({NUMBER})[ \t]+([0-3])"
    rf"(?:[ \t]+({NUMBER})[ \t]+({NUMBER}))?[ \t]*\r?(?:\n|$)"
)
PHASE_REMARK = "! phase in radians"
MIN_ROWS = 6
"""Rows and columns of the smallest grid: Zemax accepts 5, the spline that gives the slopes needs 6."""


def is_grid_sag(text: str) -> bool:
    """Whether a text begins like a grid sag file."""
    return HEAD.match(text) is not None


def read(path: Path, text: str) -> HeightMap:
    """Read a grid sag file."""
    if text.startswith(PHASE_REMARK):
        raise MapError(f"{path} holds a phase in radians, not heights: read the map that it was written from")
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


def pack(heights: HeightMap, phase_per_height: float | None = None) -> bytes:
    """Return the bytes of a grid sag file of a map, with the slopes of the bicubic spline through it.

    With a phase per height it is a grid phase file. [rad/mm]
    """
    head = _head(heights, "grid sag" if phase_per_height is None else "grid phase")
    spline = Gridded(x=heights.x, y=heights.y, z=heights.z)  # type: ignore[arg-type] # _head requires a grid
    _, zx, zy, _, zxy, _ = spline.evaluate(*heights.points(), 2)
    return _pack_nodes(head, (heights.z, zx, zy, zxy), phase_per_height)


def pack_slopes(heights: HeightMap, slopes: tuple[Floats, Floats, Floats]) -> bytes:
    """Return the bytes of the file of a map whose dz/dx, dz/dy and d2z/dxdy are known. Each (ny, nx)."""
    return _pack_nodes(_head(heights, "grid sag"), (heights.z, *slopes), None)


def _pack_nodes(head: str, nodes: tuple[Floats, ...], phase_per_height: float | None) -> bytes:
    lines, points = [head], np.stack(nodes, axis=-1)[::-1]
    if phase_per_height is not None:
        lines, points = [PHASE_REMARK, *lines], phase_per_height * points
    lines += [
        "0 0 0 0 1" if math.isnan(z) else f"{z!r} {zx!r} {zy!r} {zxy!r} 0"
        for z, zx, zy, zxy in points.reshape(-1, 4).tolist()
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _head(heights: HeightMap, kind: str) -> str:
    """Return the first line of the file of a map, in mm; raise if the format cannot hold the map."""
    start, pixel = even_axes(heights, kind)
    rows, columns = heights.z.shape
    if min(rows, columns) < MIN_ROWS:
        raise MapError(
            f"the map {heights.name!r} has {rows} rows and {columns} columns, a grid with slopes needs at least "
            f"{MIN_ROWS} of each: write it as .npz"
        )
    centre = (start[0] + (columns - 1) / 2 * pixel[0], start[1] + (rows - 1) / 2 * pixel[1])
    return f"{columns} {rows} {pixel[0]!r} {pixel[1]!r} 0 {centre[0]!r} {centre[1]!r}"
