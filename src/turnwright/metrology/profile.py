"""Profiles along any line through a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import check_angle, finite_tuple, one_of, positive
from turnwright.errors import InputError
from turnwright.metrology.grid import Grid, measure
from turnwright.profile import Profile

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.metrology.form import Form

Method: TypeAlias = Literal["linear", "cubic"]

NODES = {"linear": 2, "cubic": 4}
MAX_POINTS = 10_000_000


def without_form(profile: Profile, form: Form) -> Profile:
    """Remove a form from a profile: none, the mean, a line or a polynomial, as `remove_form` for maps."""
    if form == "none":
        return profile
    degree = {"mean": 0, "plane": 1}.get(form) if isinstance(form, str) else form
    if degree is None:
        raise InputError(f'the form of a profile is {form!r}, it must be "none", "mean", "plane" or a degree: choose')
    return profile.without(degree)


def line_profile(
    heights: HeightMap,
    start: tuple[float, float],
    end: tuple[float, float] | None = None,
    *,
    angle: float | None = None,
    step: float | None = None,
    method: Method = "linear",
) -> Profile:
    """Return the heights along a line, interpolated on the map's own grid.

    A height is missing outside the map and where any point used for its interpolation is missing.

    Parameters
    ----------
    heights
        On a rectangular or polar grid.
    start
        Where the line starts (x, y); or, with ``angle``, a point on it. [mm]
    end
        Where it ends (x, y). [mm]
    angle
        Instead of ``end``: the line's direction from +x toward +y, from border to border of the map. [rad]
    step
        Distance of the points; with ``end`` slightly reduced to fit. By default the finer mean step of the grid. [mm]
    method
        ``"linear"``, between 2 x 2 points: exact for planes. ``"cubic"``, through 4 x 4 points: exact for cubics, but
        widens holes more.

    Raises
    ------
    InputError
        If neither or both of ``end`` and ``angle`` are given, the line misses the map, or has no length.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.linspace(-1, 1, 5)
    >>> wedge = HeightMap(x=x, y=x, z=np.tile(x, (5, 1)))
    >>> line_profile(wedge, (0.0, 0.0), angle=0.0).z.tolist()
    [-1.0, -0.5, 0.0, 0.5, 1.0]
    """
    one_of(method, "the method", NODES)
    if (end is None) == (angle is None):
        raise InputError(
            f"a line needs either end or angle, got {'neither' if end is None else 'both'}: give the end, or the "
            "angle of a line from border to border"
        )
    for name, point in (("start", start), ("end", (0.0, 0.0) if end is None else end)):
        finite_tuple(point, f"the {name} of a line", 2)
    if angle is not None:
        check_angle(angle, "the angle of a line")
    grid = measure(heights)
    nodes = NODES[method]
    if min(heights.z.shape) < nodes:
        raise InputError(
            f"the map has {heights.z.shape[0]} x {heights.z.shape[1]} points, a {method} profile needs {nodes} each "
            "way: map more of the part"
        )
    if step is None:
        along_rows = () if heights.polar else (np.diff(grid.rows).mean(),)
        step = float(min(np.diff(grid.columns).mean(), *along_rows, np.inf))
    positive(step, "the step of a profile", "mm")
    distance, way = _distances(heights, start, end, angle, step)
    x, y = start[0] + distance * way[0], start[1] + distance * way[1]
    z = _interpolate_map(heights, grid, x, y, nodes)
    return Profile(distance=distance, z=z, x=x, y=y, name=f"{heights.name} profile".strip())


def _distances(
    heights: HeightMap, start: tuple[float, float], end: tuple[float, float] | None, angle: float | None, step: float
) -> tuple[Floats, Floats]:
    """Return the distances of the points of a line from its start (n,), and its direction (2,)."""
    origin = np.array(start, dtype=np.float64)
    if end is not None:
        way = np.array(end, dtype=np.float64) - origin
        first, last = 0.0, float(np.hypot(*way))
        way = way / (last or 1.0)
    else:
        way = np.array([np.cos(angle or 0.0), np.sin(angle or 0.0)])
        # The cosine of pi/2 is not exactly 0.
        way[np.abs(way) < 1e-15] = 0.0
        first, last = _borders(heights, origin, way)
    if not last > first:
        raise InputError(
            f"the line at {start} has a length of 0 mm over the map, it must be above 0 mm: move it onto the map"
        )
    if (last - first) / step > MAX_POINTS:
        raise InputError(
            f"a profile of {last - first:g} mm in steps of {step:g} mm has more than {MAX_POINTS} points, the limit: "
            "widen the step"
        )
    if end is not None:
        return np.linspace(0, last, max(int(np.ceil(last / step * (1 - 1e-9))), 1) + 1), way
    # Between borders, steps count from the start, so that they meet the points of the grid.
    return np.arange(np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9) + 1) * step, way


def _borders(heights: HeightMap, origin: Floats, way: Floats) -> tuple[float, float]:
    """Return the distances at which a line enters and leaves the map. [mm]."""
    if heights.radius is not None:
        middle = -float(origin @ way)
        square = float(heights.radius[-1]) ** 2 - float(origin @ origin) + middle**2
        half = np.sqrt(square) if square > 0 else -np.inf
        return middle - half, middle + half
    first, last = -np.inf, np.inf
    for axis, at, toward in zip((heights.x, heights.y), origin, way, strict=True):
        assert axis is not None  # noqa: S101 - a map that is not polar has x and y
        if toward == 0:
            if not axis[0] <= at <= axis[-1]:
                return 0.0, 0.0
            continue
        low, high = sorted(((axis[0] - at) / toward, (axis[-1] - at) / toward))
        first, last = max(first, float(low)), min(last, float(high))
    return first, last


def _interpolate_map(heights: HeightMap, grid: Grid, x: Floats, y: Floats, nodes: int) -> Floats:
    """Return heights at points by the polynomial through the nearest nodes each way; nan outside the map."""
    z, columns, rows, across, along = heights.z, grid.columns, grid.rows, x, y
    if heights.polar:
        across = np.hypot(x, y)
        along = rows[0] + (np.arctan2(y, x) - rows[0]) % (2 * np.pi)
        if grid.closed:
            rows = np.concatenate([rows[-nodes:] - 2 * np.pi, rows, rows[:nodes] + 2 * np.pi])
            z = np.concatenate([z[-nodes:], z, z[:nodes]])
        else:
            # An angle below the first one by rounding only is the first one, not a full turn later.
            along = np.where(along > rows[0] + 2 * np.pi - 1e-9, rows[0], along)
    column, column_share, column_in = _shares(columns, across, nodes)
    row, row_share, row_in = _shares(rows, along, nodes)
    total = np.zeros(x.size)
    for i in range(nodes):
        for j in range(nodes):
            share = row_share[i] * column_share[j]
            # A node of zero weight may be missing.
            total += np.where(share == 0, 0.0, share * z[row + i, column + j])
    return np.where(column_in & row_in, total, np.nan)


def _shares(axis: Floats, at: Floats, nodes: int) -> tuple[np.ndarray, Floats, np.ndarray]:
    """Return the first node of each point, the weights of the nodes (nodes, n), and whether it is inside the axis."""
    slack = 1e-9 * float(np.diff(axis).min())
    inside = (at >= axis[0] - slack) & (at <= axis[-1] + slack)
    at = np.clip(at, axis[0], axis[-1])
    first = np.clip(np.searchsorted(axis, at, side="right") - nodes // 2, 0, axis.size - nodes)
    near = axis[np.clip(np.searchsorted((axis[1:] + axis[:-1]) / 2, at), 0, axis.size - 1)]
    at = np.where(np.abs(near - at) <= slack, near, at)
    samples = axis[first + np.arange(nodes)[:, None]]
    share = np.ones((nodes, at.size))
    for i in range(nodes):
        for j in range(nodes):
            if i != j:
                share[i] *= (at - samples[j]) / (samples[i] - samples[j])
    return first, share, inside
