r"""A smooth surface through scattered, noisy heights.

Among tensor products of cubic B-splines, the one that minimises

.. math:: \sum_i (s(x_i, y_i) - z_i)^2 + \mu \iint s_{xx}^2 + 2 s_{xy}^2 + s_{yy}^2

With n points per area a wave of angular frequency k keeps :math:`1/(1 + k^4 \mu / n)` of its height: half at the
cutoff. Farther from the points the surface fades to zero.

Sources
-------
[Green1994]_ ch. 7, thin plates over a finite basis; the choice of the cutoff is by cross-validation, ch. 3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Floats, robust_scatter
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.surface import Gridded

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from turnwright.heightmap import HeightMap
    from turnwright.part import Part

MIN_HEIGHTS = 100
"""Number of heights below which a form error cannot be distinguished from noise."""

MAX_CUTOFFS_PER_DIAMETER = 200
"""A finer correction would follow the cusps and the noise of any instrument."""

STEPS_PER_CUTOFF = 5

TRIAL_STEPS_PER_CUTOFF = 4
"""Grid steps in the cutoff wavelength while cutoffs are compared."""

LONGER_CUTOFFS = 9
"""Number of longer cutoffs that are tried, each longer than the next by the square root of 2."""

CORRELATION_TEST_RATIO = 2.5
"""Cutoffs below this many times the requested one are only tried if the residuals are spatially correlated."""

MIN_GAIN_SIGMA = 2.0
"""Standard errors by which a shorter cutoff must predict the held-out half of the points better."""

FADE_START, FADE_END = 0.75, 1.5
"""Distance from the nearest point at which the table begins to fade, and at which it is zero. [cutoffs]"""


class Smooth(NamedTuple):
    """A smoothed error as a table."""

    table: Gridded
    cutoff: float | None  # chosen [mm]; None if the points show nothing but noise, and the table is zero


def form_compensation(part: Part, error: HeightMap, *, cutoff: float, beyond: float) -> Smooth:
    r"""Return the correction of a surface that compensates a repeatable form error, and the selected cutoff.

    The measured error at wavelengths above the cutoff is subtracted from the surface. No wavelength is corrected by
    more than its measured height, so noise is never amplified. The cutoff, this one or a longer one, is selected by
    cross-validation: each half of the heights is predicted from the other. If no cutoff predicts more than noise, the
    correction is zero. Holes and the rim are bridged by a bending plate.

    Parameters
    ----------
    part
        The measured part, whose surface is corrected.
    error
        Measured minus design in the frame of the part, without errors that other corrections remove; gridded or
        scattered.
    cutoff
        Shortest wavelength to correct, at which half of the height is corrected. It must be well above the feed, or
        cusps are treated as form. [mm]
    beyond
        Margin outside the clear aperture that the tool reaches: lead-in and nose width. [mm]

    Raises
    ------
    InputError
        If the map has fewer than 100 heights within the clear aperture, or the cutoff does not fit the part.

    >>> from turnwright.heightmap import HeightMap
    >>> from turnwright.part import Part
    >>> from turnwright.surface import Plane
    >>> x = np.linspace(-5, 5, 201)
    >>> bowl = HeightMap(x=x, y=x, z=1e-5 * (x**2 + x[:, None] ** 2))
    >>> part = Part(surface=Plane(slope=(0.0, 0.0)), radius=5.0)
    >>> smooth = form_compensation(part, bowl, cutoff=0.5, beyond=1.0)
    >>> bool(abs(smooth.table.sag(2.0, 0.0) + 4e-5) < 1e-8)
    True
    """
    error.require_calibrated()
    if not 2 * part.reach / MAX_CUTOFFS_PER_DIAMETER <= cutoff <= part.reach:
        raise InputError(
            f"cutoff is {cutoff:g} mm, the limits on this part are {2 * part.reach / MAX_CUTOFFS_PER_DIAMETER:g} to "
            f"{part.reach:g} mm: give a wavelength well above the feed"
        )
    x, y = error.points()
    used = ~np.isnan(error.z) & part.covers(x, y)
    if np.count_nonzero(used) < MIN_HEIGHTS:
        raise InputError(
            f"the measured error has {np.count_nonzero(used)} heights on the clear aperture, up to "
            f"{part.reach:g} mm from the axis, a correction needs {MIN_HEIGHTS}: register the map to the part first, "
            "or measure more of it"
        )
    reach = part.reach + positive(beyond, "beyond", "mm") + cutoff
    return smooth_table(x[used], y[used], -error.z[used], cutoff=cutoff, reach=reach)


class _Points(NamedTuple):
    """Cell means of the points."""

    x: Floats
    y: Floats
    z: Floats
    weight: Floats


def smooth_table(x: Floats, y: Floats, z: Floats, *, cutoff: float, reach: float) -> Smooth:
    """Return the smoothed heights above a cutoff, on a square grid about the origin.

    From the longest cutoff to the requested one, the next is accepted if one half of the points predicts the other
    better than the last, and the first if it predicts it better than zero; if none does, the heights are noise.

    Parameters
    ----------
    x, y, z
        Points. Each (n,) [mm]
    cutoff
        Shortest wavelength that keeps half of its height. [mm]
    reach
        Half-width of the grid. [mm]
    """
    # Cells, not points, are split: neighbours share the cell's noise only.
    cell = cutoff / STEPS_PER_CUTOFF / 2
    column, row = (np.floor((at + reach) / cell).astype(np.int64) for at in (x, y))
    # With a coarse grid only some columns of cells hold points, so occupied columns are counted.
    odd = sum(np.unique(one, return_inverse=True)[1] for one in (column, row)) % 2 == 1
    halves = [_bin_points(x[chosen], y[chosen], z[chosen], cell, reach) for chosen in (odd, ~odd)]
    best: float | None = None
    scale = robust_scatter(z - np.median(z))
    inner = min(reach, float(max(np.abs(x).max(), np.abs(y).max())) + cutoff)
    residual = [half.z for half in halves]
    last = _losses(halves, residual, scale)
    for length in cutoff * math.sqrt(2) ** np.arange(LONGER_CUTOFFS, -1, -1):
        if length > 2 * reach:
            continue
        if length < CORRELATION_TEST_RATIO * cutoff and not any(
            _is_correlated(half, off, cell) for half, off in zip(halves, residual, strict=True)
        ):
            break
        tables = [_fit_table(half, length, inner, TRIAL_STEPS_PER_CUTOFF) for half in halves]
        off = [half.z - table.evaluate(half.x, half.y, 0)[0] for half, table in zip(halves, tables[::-1], strict=True)]
        losses = _losses(halves, off, scale)
        better = last - losses
        if better.sum() > MIN_GAIN_SIGMA * better.std() * math.sqrt(better.size):
            best, last, residual = float(length), losses, off
    if best is None:
        flat = np.linspace(-reach, reach, 6)
        return Smooth(Gridded(x=flat, y=flat, z=np.zeros((6, 6))), None)
    means = _bin_points(x, y, z, cell, reach)
    return Smooth(_fade_table(_fit_table(means, best, reach), means.x, means.y, best), best)


def sum_tables(table: Gridded, before: Gridded) -> Gridded:
    """Return the sum of two tables over the extent of the first, with the finer step of the two."""
    step = min(float(np.diff(one.x).min()) for one in (table, before))
    low, high = float(table.x[0]), float(table.x[-1])
    axis = np.linspace(low, high, math.ceil((high - low) / step - 1e-9) + 1)
    x, y = np.meshgrid(axis, axis)
    heights = before.evaluate(np.clip(x, before.x[0], before.x[-1]), np.clip(y, before.y[0], before.y[-1]), 0)[0]
    return Gridded(x=axis, y=axis, z=table.evaluate(x, y, 0)[0] + heights)


def _fade_table(table: Gridded, x: Floats, y: Floats, cutoff: float) -> Gridded:
    """Return a table that fades to zero away from the points, so that unmeasured areas are not corrected."""
    from scipy.spatial import KDTree  # noqa: PLC0415 - scipy is costly to import

    at = np.stack([one.ravel() for one in np.meshgrid(table.x, table.y)], axis=1)
    away = np.asarray(KDTree(np.stack([x, y], axis=1)).query(at)[0]).reshape(table.z.shape) / cutoff
    share = np.clip((away - FADE_START) / (FADE_END - FADE_START), 0.0, 1.0)
    return Gridded(x=table.x, y=table.y, z=table.z * np.cos(np.pi / 2 * share) ** 2)


def _losses(halves: Sequence[_Points], off: Sequence[Floats], scale: float) -> Floats:
    """Return the loss of each cell of both halves.

    It grows linearly beyond two scales, so that a defect at the axis does not dominate.
    """
    size = np.abs(np.concatenate(off))
    loss = np.where(size < 2 * scale, size**2, 4 * scale * (size - scale))
    return np.concatenate([half.weight for half in halves]) * loss


def _is_correlated(half: _Points, off: Floats, cell: float) -> bool:
    """Return whether the residuals of neighbouring cells of a half are positively correlated beyond chance."""
    column, row = (np.floor((at - at.min()) / cell).astype(np.int64) for at in (half.x, half.y))
    grid = np.zeros((int(row.max()) + 1, int(column.max()) + 1))
    scaled = off * np.sqrt(half.weight)
    grid[row, column] = np.clip(scaled, *(np.array([-4, 4]) * robust_scatter(scaled)))
    pairs = np.concatenate([(grid[1:, 1:] * grid[:-1, :-1]).ravel(), (grid[1:, :-1] * grid[:-1, 1:]).ravel()])
    return bool(pairs.sum() > MIN_GAIN_SIGMA * np.sqrt(pairs @ pairs))


def _bin_points(x: Floats, y: Floats, z: Floats, cell: float, reach: float) -> _Points:
    """Return the means of points and heights over square cells."""
    side = math.ceil(2 * reach / cell) + 1
    column, row = (np.floor((at + reach) / cell).astype(np.int64) for at in (x, y))
    number = row * side + column
    count = np.bincount(number)
    filled = count > 0
    weight = count[filled].astype(np.float64)
    at_x, at_y, height = (np.bincount(number, weights=values)[filled] / weight for values in (x, y, z))
    return _Points(at_x, at_y, height, weight)


def _fit_table(points: _Points, cutoff: float, reach: float, fine: int = STEPS_PER_CUTOFF) -> Gridded:
    """Return the spline of least squares and bending, as a table of its heights at its knots."""
    from scipy.interpolate import BSpline  # noqa: PLC0415 - scipy is costly to import
    from scipy.linalg import solveh_banded  # noqa: PLC0415
    from scipy.sparse import kron  # noqa: PLC0415

    steps = max(math.ceil(2 * reach * fine / cutoff), 6)
    knots = reach * np.linspace(-1, 1, steps + 1)
    step = knots[1] - knots[0]
    padded = np.concatenate([knots[0] + step * np.arange(-3, 0), knots, knots[-1] + step * np.arange(1, 4)])
    size = padded.size - 4
    across, along = (BSpline.design_matrix(at, padded, 3) for at in (points.x, points.y))
    basis = _row_products(along, across)
    weighted = basis.multiply(points.weight[:, None]).tocsr()
    density = points.weight.sum() / _area(points, cutoff)
    bend = density * (cutoff / (2 * math.pi)) ** 4
    height, slope, curve = (_gram(padded, order) for order in range(3))
    plate = kron(curve, height) + 2 * kron(slope, slope) + kron(height, curve)
    normal = (basis.T @ weighted + bend * plate).tocoo()
    # Regularisation far below the rounding of the heights, for cells without points on two sides.
    band = np.zeros((int(np.abs(normal.row - normal.col).max()) + 1, size * size))
    lower = normal.row >= normal.col
    np.add.at(band, (normal.row[lower] - normal.col[lower], normal.col[lower]), normal.data[lower])
    band[0] += 1e-13 * band[0].max()
    solution = solveh_banded(band, weighted.T @ points.z, lower=True, overwrite_ab=True).reshape(size, size)
    at_knots = BSpline.design_matrix(knots, padded, 3)
    return Gridded(x=knots, y=knots, z=np.asarray(at_knots @ solution @ at_knots.T))


def _area(points: _Points, cutoff: float) -> float:
    """Return the area that the points cover, in squares of a third of the cutoff. [mm²]."""
    side = cutoff / 3
    squares = np.unique(np.floor(np.stack([points.x, points.y]) / side), axis=1)
    return float(squares.shape[1]) * side**2


def _row_products(one: csr_array, other: csr_array) -> csr_array:
    """Return the products of all values of a row of one with all of the same row of the other."""
    from scipy.sparse import csr_array as rows  # noqa: PLC0415

    count, width = one.shape[0], other.shape[1]
    values = one.data.reshape(count, 4, 1) * other.data.reshape(count, 1, 4)
    columns = one.indices.reshape(count, 4, 1).astype(np.int64) * width + other.indices.reshape(count, 1, 4)
    return rows(
        (values.ravel(), columns.ravel(), np.arange(0, 16 * count + 1, 16)), shape=(count, one.shape[1] * width)
    )


def _gram(knots: Floats, order: int) -> csr_array:
    """Return the integrals of the products of all cubic B-splines' derivatives, exact by Gauss' rule."""
    from scipy.interpolate import BSpline  # noqa: PLC0415
    from scipy.sparse import csr_array as rows  # noqa: PLC0415

    size = knots.size - 4
    nodes, weights = np.polynomial.legendre.leggauss(4)
    inner = knots[3:-3]
    half = np.diff(inner)[:, None] / 2
    at = (inner[:-1, None] + half + half * nodes).ravel()
    values = BSpline(knots, np.eye(size), 3)(at, nu=order)
    return rows(values.T @ (values * (half * weights).reshape(-1, 1)))
