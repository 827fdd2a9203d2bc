"""What a grid of heights weighs: steps, areas and means, rectangular or polar, missing points left out."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["Grid", "area_rms", "mean", "measure", "valid_points"]

EVEN = 1e-6
"""Share of a step by which steps may differ and still be even: files state six digits or more."""


class Grid(NamedTuple):
    """A rectangular or polar grid: how long its steps are, and how much area its points and cells stand for.

    A point of a rectangular grid is the middle of a whole pixel. A polar map reaches from its first to its last radius,
    and a sector of one from its first to its last azimuth: see `_ring_areas` and `_azimuth_widths`.
    """

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
    return Grid(
        columns=columns,
        rows=rows,
        stretch=columns if polar else np.ones_like(columns),
        closed=closed,
        column_area=_ring_areas(columns) if polar else np.diff(_edges(columns)),
        row_width=_azimuth_widths(rows, closed=closed) if polar else np.diff(_edges(rows)),
        column_step_area=np.diff(columns**2) / 2 if polar else np.diff(columns),
        row_step=np.diff(rows, append=rows[0] + 2 * np.pi) if closed else np.diff(rows),
    )


def _edges(axis: Floats) -> Floats:
    """Return the borders of the pixels around the values of an axis; the first and last pixel are whole."""
    if axis.size == 1:
        return np.array([axis[0] - 0.5, axis[0] + 0.5])
    middle = (axis[1:] + axis[:-1]) / 2
    return np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]])


def _ring_areas(radii: Floats) -> Floats:
    """Return the area per radian that each radius stands for, exact for values that are straight between radii.

    The rings reach from the first radius to the last, unless even radii start half a step from the axis: they are then
    the middles of rings that reach from the axis to half a step beyond the last. Both are of second order in the step.
    """
    if radii.size == 1:
        return np.ones(1)
    steps = np.diff(radii)
    if np.ptp(steps) <= EVEN * steps[0] and abs(2 * radii[0] - steps[0]) <= EVEN * steps[0]:
        return np.asarray(radii * steps[0])
    areas = np.zeros_like(radii)
    areas[:-1] += steps * (2 * radii[:-1] + radii[1:]) / 6
    areas[1:] += steps * (radii[:-1] + 2 * radii[1:]) / 6
    return areas


def _azimuth_widths(angles: Floats, *, closed: bool) -> Floats:
    """Return half the gaps from each azimuth to its neighbours: around the turn if it is closed, else within the map.

    The first azimuth once more at the end of a full turn so has half the width of the others, as the first itself.
    """
    if angles.size == 1:
        return np.ones(1)
    gaps = np.diff(angles)
    if closed:
        gaps = np.append(gaps, angles[0] + 2 * np.pi - angles[-1])
        return np.asarray((gaps + np.roll(gaps, 1)) / 2)
    return np.asarray((np.append(gaps, 0.0) + np.append(0.0, gaps)) / 2)


def mean(values: Floats, rows: Floats, columns: Floats) -> float:
    """Average over what is not nan, each value weighted by its row and its column; nan if there is nothing."""
    missing = np.isnan(values)
    if missing.any():
        weight = rows @ (~missing).astype(np.float64) @ columns
        values = np.where(missing, 0.0, values)
    else:
        weight = rows.sum() * columns.sum()
    return float(rows @ values @ columns / weight) if weight > 0 else float("nan")


def area_rms(heights: HeightMap, *, like: HeightMap | None = None) -> float:
    """Return the root mean square of a map over its area. [mm].

    A point of a rectangular map stands for its pixel. A polar map reaches from its first to its last radius; even radii
    that start half a step from the axis are the middles of rings. The values between two radii are straight, so the
    error falls with the square of the step.

    Parameters
    ----------
    heights
        Missing ones are left out. Those of scattered points count alike unless ``like`` is given.
    like
        The grid that scattered points were taken from: one for each of its valid heights, in their order.

    Raises
    ------
    InputError
        If the scattered points are not as many as the valid heights of ``like``.

    >>> from turnwright.heightmap import HeightMap
    >>> radius, angle = np.linspace(0, 1, 51), np.linspace(0, 2 * np.pi, 24, endpoint=False)
    >>> tilt = HeightMap(radius=radius, angle=angle, z=radius * np.cos(angle)[:, None])
    >>> round(area_rms(tilt), 4)   # 1/2 over a disc
    0.5
    """
    if not heights.scattered:
        grid = measure(heights)
        return float(np.sqrt(mean(heights.z**2, grid.row_width, grid.column_area)))
    if like is None:
        return float(np.sqrt(np.nanmean(heights.z**2)))
    measured, areas = ~np.isnan(heights.z), point_areas(like)[~np.isnan(like.z)]
    if areas.size != measured.size:
        raise InputError(
            f"{measured.size} scattered heights are like a map of {areas.size} valid ones: give the map that they were "
            "taken from"
        )
    return float(np.sqrt(np.average(heights.z[measured] ** 2, weights=areas[measured])))


def point_areas(heights: HeightMap) -> Floats:
    """Return the area that each height stands for, 1 for scattered ones. The shape of the map [mm²]."""
    if heights.scattered:
        return np.ones(heights.z.shape)
    grid = measure(heights)
    return np.asarray(grid.row_width[:, None] * grid.column_area)


def valid_points(heights: HeightMap, needed: int, what: str) -> Bools:
    """Return where the map has heights, and raise unless there are ``needed`` of them."""
    valid = ~np.isnan(heights.z)
    count = int(np.count_nonzero(valid))
    if count < needed:
        raise InputError(f"the height map has {count} valid heights, {what} needs {needed}: measure more of the part")
    return valid
