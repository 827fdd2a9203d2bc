"""Steps, areas and area-weighted means of rectangular and polar grids with missing points."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.polynomial.legendre import legvander

from turnwright._arrays import STEP_TOL, Bools, Floats, is_even, row_blocks
from turnwright.errors import InputError
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

T = TypeVar("T")


class Grid(NamedTuple):
    """Steps of a rectangular or polar grid, and areas of its points and cells.

    A point of a rectangular grid is the centre of a pixel. For polar maps see `_ring_areas` and `_azimuth_widths`.
    """

    columns: Floats
    rows: Floats
    stretch: Floats  # length of one unit of the row axis, at each column: 1, or the radius
    closed: bool  # the row after the last one is the first
    column_area: Floats  # area of each point per unit of row: width, or ring area
    row_width: Floats
    column_step_area: Floats  # the same between neighbouring columns
    row_step: Floats


def by_row_blocks(work: Callable[[slice], T], shape: tuple[int, ...]) -> list[T]:
    """Return the results of ``work`` for blocks of the rows of an array, in order, computed on all cores."""
    blocks, results = tuple(row_blocks(shape)), dict[int, T]()

    def carry_out(start: int, stop: int) -> None:
        for k in range(start, stop):
            results[k] = work(blocks[k])

    run_chunks(carry_out, len(blocks), 1)
    return [results[k] for k in range(len(blocks))]


def measure(heights: HeightMap) -> Grid:
    """Measure the grid of a map."""
    heights.require_calibrated()
    if heights.scattered:
        raise InputError(
            f"the {heights.z.size} heights are scattered points, this evaluation needs a grid: resample them first"
        )
    polar = heights.radius is not None
    columns, rows = (heights.radius, heights.angle) if polar else (heights.x, heights.y)
    if columns is None or rows is None:
        raise InputError("a height map lacks an axis: give x and y, or radius and angle")
    if polar and columns[0] < 0:
        raise InputError(f"the height map has radius {columns[0]:g} mm, the limit is 0 mm: give radii, not diameters")
    # A full circle closes with a gap no wider than the widest step.
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
    """Return the borders of the pixels around the values of an axis; the first and the last pixel are symmetric."""
    if axis.size == 1:
        return np.array([axis[0] - 0.5, axis[0] + 0.5])
    middle = (axis[1:] + axis[:-1]) / 2
    return np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]])


def _ring_areas(radii: Floats) -> Floats:
    """Return the area per radian of each radius, exact for values that are linear between radii.

    The rings extend from the first radius to the last. Evenly spaced radii that start half a step from the axis are
    instead the middles of rings from the axis to half a step beyond the last.
    """
    if radii.size == 1:
        return np.ones(1)
    steps = np.diff(radii)
    if is_even(radii) and abs(2 * radii[0] - steps[0]) <= STEP_TOL * steps[0]:
        return np.asarray(radii * steps[0])
    areas = np.zeros_like(radii)
    areas[:-1] += steps * (2 * radii[:-1] + radii[1:]) / 6
    areas[1:] += steps * (radii[:-1] + 2 * radii[1:]) / 6
    return areas


def _azimuth_widths(angles: Floats, *, closed: bool) -> Floats:
    """Return half the gaps from each azimuth to its neighbours, across the seam if the circle is closed.

    If the first azimuth is repeated at the end of a full circle, both have half the width of the others.
    """
    if angles.size == 1:
        return np.ones(1)
    gaps = np.diff(angles)
    if closed:
        gaps = np.append(gaps, angles[0] + 2 * np.pi - angles[-1])
        return np.asarray((gaps + np.roll(gaps, 1)) / 2)
    return np.asarray((np.append(gaps, 0.0) + np.append(0.0, gaps)) / 2)


def mean(values: Floats, rows: Floats, columns: Floats) -> float:
    """Average the valid values, weighted by row and column; nan without valid values."""
    missing = np.isnan(values)
    if missing.any():
        weight = rows @ (~missing).astype(np.float64) @ columns
        values = np.where(missing, 0.0, values)
    else:
        weight = rows.sum() * columns.sum()
    return float(rows @ values @ columns / weight) if weight > 0 else float("nan")


def area_rms(heights: HeightMap, *, like: HeightMap | None = None) -> float:
    """Return the root mean square of a map over its area. [mm].

    A point of a rectangular map counts with its pixel. A polar map extends from its first to its last radius; evenly
    spaced radii that start half a step from the axis are the middles of rings.

    Parameters
    ----------
    heights
        Missing heights are left out. Scattered points have equal weights unless ``like`` is given.
    like
        The gridded map that the scattered points were taken from: one point for each valid height, in order.

    Raises
    ------
    InputError
        If the numbers of scattered points and of valid heights of ``like`` differ.

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
            f"like must have as many valid heights as there are scattered points, {measured.size}, got {areas.size}: "
            "give the map from which the points were selected"
        )
    return float(np.sqrt(np.average(heights.z[measured] ** 2, weights=areas[measured])))


def point_areas(heights: HeightMap) -> Floats:
    """Return the area of each height, 1 for scattered points. The shape of the map [mm²]."""
    if heights.scattered:
        return np.ones(heights.z.shape)
    grid = measure(heights)
    return np.asarray(grid.row_width[:, None] * grid.column_area)


def even_step(axis: Floats, name: str, what: str, least: int = 2) -> float:
    """Return the step of an axis, and raise unless it has ``least`` points or more in even steps. [mm]."""
    if axis.size < least or not is_even(axis):
        raise InputError(
            f"{name} has {axis.size} points{'' if axis.size < least else ' in uneven steps'}, {what} needs at least "
            f"{least} in even steps: bring the map to an even grid first"
        )
    return float(np.diff(axis).mean())


def even_rectangle(heights: HeightMap, what: str, least: int) -> tuple[float, float]:
    """Return the steps along x and y of a rectangular grid, and raise unless it is even. [mm]."""
    grid = measure(heights)
    if heights.polar:
        raise InputError(f"the map has a polar grid, {what} needs a rectangular one: resample a rectangular patch")
    return even_step(grid.columns, "the map along x", what, least), even_step(grid.rows, "the map along y", what, least)


def disc_points(radius: float, count: int = 41) -> tuple[Floats, Floats]:
    """Return the points of a square grid within a radius of the origin. Each (n,) [mm]."""
    x, y = np.meshgrid(*2 * [np.linspace(-radius, radius, count)])
    disc = x * x + y * y <= radius * radius
    return x[disc], y[disc]


def polynomial_terms(x: Floats, y: Floats, degree: int) -> Floats:
    """Return the products of Legendre polynomials up to a total degree. (..., k)."""
    along_x, along_y = legvander(x, degree), legvander(y, degree)
    pairs = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([along_x[..., i] * along_y[..., j] for i, j in pairs], axis=-1)


def valid_points(heights: HeightMap, needed: int, what: str) -> Bools:
    """Return the mask of valid heights, and raise if there are fewer than ``needed``."""
    valid = ~np.isnan(heights.z)
    count = int(np.count_nonzero(valid))
    if count < needed:
        raise InputError(f"the height map has {count} valid heights, {what} needs {needed}: measure more of the part")
    return valid
