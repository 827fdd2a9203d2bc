"""What a grid of heights weighs: steps, areas and means, rectangular or polar, missing points left out."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["Grid", "area_rms", "edges", "mean", "measure", "valid_points"]


class Grid(NamedTuple):
    """A rectangular or polar grid: how long its steps are, and how much area its points and cells stand for."""

    columns: Floats
    rows: Floats
    stretch: Floats  # length of one unit of the row axis, at each column: 1, or the radius
    closed: bool  # the row after the last one is the first
    column_area: Floats  # area for each point per unit of row: its width, or that of its ring
    row_width: Floats
    column_step_area: Floats  # the same between neighbouring columns
    row_step: Floats


def measure(heights: HeightMap) -> Grid:
    """Measure the grid of a map."""
    heights.require_calibrated()
    if heights.scattered:
        raise InputError(
            f"the {heights.z.size} heights are scattered points, what is asked needs a grid: bring them to one first"
        )
    polar = heights.radius is not None
    columns, rows = (heights.radius, heights.angle) if polar else (heights.x, heights.y)
    if columns is None or rows is None:
        raise InputError("a height map lacks an axis: give x and y, or radius and angle")
    if polar and columns[0] < 0:
        raise InputError(f"the height map has radius {columns[0]:g} mm, the limit is 0 mm: give radii, not diameters")
    # A full turn is one whose gap at the end is no wider than the widest step.
    gap = 2 * np.pi - (rows[-1] - rows[0])
    closed = polar and rows.size > 2 and 1e-9 < gap <= np.diff(rows).max() * (1 + 1e-6)
    row_edges = edges(np.concatenate([[rows[-1] - 2 * np.pi], rows, [rows[0] + 2 * np.pi]]) if closed else rows)
    if closed:
        row_edges = row_edges[1:-1]
    column_edges = edges(columns)
    column_area = np.diff(np.maximum(column_edges, 0) ** 2) / 2 if polar else np.diff(column_edges)
    return Grid(
        columns=columns,
        rows=rows,
        stretch=columns if polar else np.ones_like(columns),
        closed=closed,
        column_area=column_area,
        row_width=np.diff(row_edges),
        column_step_area=np.diff(columns**2) / 2 if polar else np.diff(columns),
        row_step=np.diff(rows, append=rows[0] + 2 * np.pi) if closed else np.diff(rows),
    )


def edges(axis: Floats) -> Floats:
    """Return the borders of the pixels around the values of an axis; the first and last pixel are whole."""
    if axis.size == 1:
        return np.array([axis[0] - 0.5, axis[0] + 0.5])
    middle = (axis[1:] + axis[:-1]) / 2
    return np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]])


def mean(values: Floats, rows: Floats, columns: Floats) -> float:
    """Average over what is not nan, each value weighted by its row and its column; nan if there is nothing."""
    missing = np.isnan(values)
    if missing.any():
        weight = rows @ (~missing).astype(np.float64) @ columns
        values = np.where(missing, 0.0, values)
    else:
        weight = rows.sum() * columns.sum()
    return float(rows @ values @ columns / weight) if weight > 0 else float("nan")


def area_rms(heights: HeightMap) -> float:
    """Return the root mean square of a map, every height weighted by its area; scattered points weigh alike. [mm]."""
    if heights.scattered:
        return float(np.sqrt(np.nanmean(heights.z**2)))
    grid = measure(heights)
    return float(np.sqrt(mean(heights.z**2, grid.row_width, grid.column_area)))


def valid_points(heights: HeightMap, needed: int, what: str) -> Bools:
    """Return where the map has heights, and raise unless there are ``needed`` of them."""
    valid = ~np.isnan(heights.z)
    count = int(np.count_nonzero(valid))
    if count < needed:
        raise InputError(f"the height map has {count} valid heights, {what} needs {needed}: measure more of the part")
    return valid
