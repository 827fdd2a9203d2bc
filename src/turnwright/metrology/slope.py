"""Slope errors of a map over an integration length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.metrology.grid import Grid, even_step, mean, measure, valid_points

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slopes:
    """Slopes over an integration length. See `slope_error`.

    Parameters
    ----------
    across, along
        Slope along x and along y (of a polar map along the radius and along the circle), over steps that start at each
        point; nan where an end is missing or outside. The shape of the map. [rad]
    rms_across, rms_along, rms
        Root mean square of each, and of the gradient: the two together. [rad]
    pv_across, pv_along
        Greatest minus least. [rad]
    peak
        Steepest gradient, of the two slopes of one point together. [rad]
    length_across, length_along
        Length used: the whole number of steps closest to the requested one. On a polar map ``length_along`` is the mean
        over the radii. [mm]
    """

    across: Floats
    along: Floats
    rms_across: float
    rms_along: float
    rms: float
    pv_across: float
    pv_along: float
    peak: float
    length_across: float
    length_along: float


def slope_error(heights: HeightMap, *, integration_length: float) -> Slopes:
    r"""Return the slope errors of a map, averaged over an integration length.

    .. math:: s_x(x, y) = \frac{z(x + L, y) - z(x, y)}{L}

    A sine of period p retains a share sinc(L/p) of its slope, and height noise adds :math:`\sqrt{2}/L` times its
    standard deviation, so a slope error is only defined together with its integration length.

    Parameters
    ----------
    heights
        Measured minus design, on a grid of even steps; see `HeightMap.minus`. Missing points are left out.
    integration_length
        L, at least one step of the grid. [mm]

    Raises
    ------
    InputError
        If the grid is uneven, the length is below one step or beyond the map, or no two points are that far apart.

    Sources
    -------
    ISO 10110-5:2015, slope deviation with its integration length.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.linspace(0, 1, 11)
    >>> wedge = HeightMap(x=x, y=x, z=np.tile(2e-6 * x, (11, 1)))
    >>> round(slope_error(wedge, integration_length=0.2).rms * 1e6, 9)   # urad
    2.0
    """
    valid_points(heights, 2, "a slope")
    positive(integration_length, "the integration length", "mm")
    grid = measure(heights)
    names = ("radius", "angle") if heights.polar else ("x", "y")
    steps = [
        even_step(axis, f"the map along {name}", "a slope over a length")
        for name, axis in zip(names, (grid.columns, grid.rows), strict=True)
    ]
    across_count = _count(integration_length, steps[0], grid.columns.size, names[0])
    across = np.full(heights.z.shape, np.nan)
    length = across_count * steps[0]
    across[:, :-across_count] = (heights.z[:, across_count:] - heights.z[:, :-across_count]) / length
    along = np.full(heights.z.shape, np.nan)
    if heights.polar:
        length_along = _set_circle_slopes(heights, grid, steps[1], integration_length, along)
    else:
        count = _count(integration_length, steps[1], grid.rows.size, "y")
        length_along = count * steps[1]
        along[:-count] = (heights.z[count:] - heights.z[:-count]) / length_along
    squares = across * across, along * along
    if any(np.isnan(one).all() for one in squares):
        raise InputError(
            f"no two valid points of the map are {integration_length:g} mm apart in one of its directions, the least "
            "is one pair: shorten the integration length"
        )
    weights = grid.row_width, grid.column_area
    means = [mean(one, *weights) for one in squares]
    both = squares[0] + squares[1]
    return Slopes(
        across=frozen(across, "slopes", ndim=2, finite=False),
        along=frozen(along, "slopes", ndim=2, finite=False),
        rms_across=float(np.sqrt(means[0])),
        rms_along=float(np.sqrt(means[1])),
        rms=float(np.sqrt(sum(means))),
        pv_across=float(np.nanmax(across) - np.nanmin(across)),
        pv_along=float(np.nanmax(along) - np.nanmin(along)),
        peak=float(np.sqrt(np.nanmax(both))) if not np.isnan(both).all() else float("nan"),
        length_across=length,
        length_along=length_along,
    )


def _count(length: float, step: float, size: int, name: str) -> int:
    count = round(length / step)
    if length < step * (1 - 1e-6) or count > size - 1:
        raise InputError(
            f"the integration length is {length:g} mm, the limits along {name} are {step:g} to {step * (size - 1):g} "
            "mm, one step and the whole map: give a value between"
        )
    return max(count, 1)


def _set_circle_slopes(heights: HeightMap, grid: Grid, step: float, length: float, along: Floats) -> float:
    """Set the slopes along the circles of a polar map, and return the mean length used. [mm].

    Close to the axis one step is as good as the length; where the circle is shorter than it there is no slope.
    """
    used = []
    for column, radius in enumerate(grid.columns):
        if radius * step == 0:
            continue
        count = max(round(length / (radius * step)), 1)
        if count >= grid.rows.size or radius * step > 2 * length:
            continue
        z = heights.z[:, column]
        ahead = np.roll(z, -count)
        if not grid.closed:
            ahead[-count:] = np.nan
        # Along the circle, as the length of the part that is walked; its chord is shorter by a share (count step)²/24.
        along[:, column] = (ahead - z) / (count * radius * step)
        used.append(count * radius * step)
    return float(np.mean(used)) if used else float("nan")
