"""Forms fitted by least squares: what is taken off before a texture is judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.polynomial.legendre import legvander

from turnwright._arrays import Floats
from turnwright.errors import InputError
from turnwright.metrology._grid import measure, valid_points

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

__all__ = ["Form", "remove_form"]

Form: TypeAlias = str | int

MAX_DEGREE = 10
MAX_STEPS = 50
BLOCK = 1 << 14
"""Points of a map that the form fit takes at a time."""

EQUATOR = 1e-6
"""Squared cosine of the slope at which a fitted sphere is taken to end."""

Fit: TypeAlias = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""From parameters (k,), x and y (n,) to the form there (n,) and its derivatives by each parameter (n, k)."""


def remove_form(heights: HeightMap, form: Form) -> HeightMap:
    r"""Return the map without its form, fitted by least squares over the valid points.

    On a polar map every point counts with the area it stands for, :math:`r\,dr\,d\theta`.

    Parameters
    ----------
    heights
        Missing points stay missing.
    form
        ``"none"``; ``"mean"``, a constant; ``"plane"``; a whole number, the total degree of a polynomial in x and y;
        or ``"sphere"``, the sphere of best fit in z, of any position, radius and sense (a plane is one of them).

    Raises
    ------
    InputError
        If the form is unknown, the map has fewer points than the form has parameters, or no sphere fits.

    Sources
    -------
    ISO 25178-3 (association of the form by total least squares is replaced by that in z: optics is specified in sag).

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.linspace(-1, 1, 5)
    >>> bowl = HeightMap(x=x, y=x, z=100 - np.sqrt(100**2 - x**2 - x[:, None] ** 2))
    >>> bool(np.abs(remove_form(bowl, "sphere").z).max() < 1e-12)
    True
    """
    degree = {"mean": 0, "plane": 1}.get(form, form) if isinstance(form, str) else form
    if form == "none":
        return heights
    if degree == "sphere":
        return _remove_sphere(heights)
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise InputError(
            f'form is {form!r}, it can be "none", "mean", "plane", "sphere" or the degree of a polynomial from 0 to '
            f"{MAX_DEGREE}: choose one of them"
        )
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    valid_points(heights, len(powers), f"a form of degree {degree}")

    def polynomial(parameters: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        along_x, along_y = legvander(x, degree), legvander(y, degree)
        terms = np.stack([along_x[:, i] * along_y[:, j] for i, j in powers], axis=1)
        return terms @ parameters, terms

    return _subtract(heights, polynomial, _fit(heights, polynomial, len(powers)))


def _scale(heights: HeightMap) -> tuple[float, float, float]:
    """Return the middle of the map (x, y) and the half-width that brings it into [-1, 1]. [mm]."""
    if heights.radius is not None:
        return 0.0, 0.0, float(heights.radius[-1]) or 1.0
    x, y = heights.x, heights.y
    ends = np.array([[x[0], x[-1]], [y[0], y[-1]]])  # type: ignore[index]
    middle = ends.mean(axis=1)
    return float(middle[0]), float(middle[1]), float(np.diff(ends, axis=1).max() / 2) or 1.0


def _blocks(heights: HeightMap) -> Iterator[tuple[slice, Floats, Floats, Floats]]:
    """Walk over a map in groups of rows: the rows, scaled x and y (n,), and the area of each point (n,)."""
    grid = measure(heights)
    x0, y0, scale = _scale(heights)
    count = max(BLOCK // grid.columns.size, 1)
    for start in range(0, grid.rows.size, count):
        rows = slice(start, start + count)
        if heights.polar:
            angle = grid.rows[rows, None]
            x, y = np.cos(angle) * grid.columns, np.sin(angle) * grid.columns
        else:
            x, y = np.broadcast_arrays(grid.columns, grid.rows[rows, None])
        area = grid.row_width[rows, None] * grid.column_area
        yield rows, ((x - x0) / scale).ravel(), ((y - y0) / scale).ravel(), area.ravel()


def _fit(heights: HeightMap, form: Fit, count: int) -> Floats:
    """Return the ``count`` parameters of least squares in z, by Gauss-Newton from zero.

    The normal equations lose half of the digits, and each further step, also of a linear form, wins them back.
    """
    parameters, last = np.zeros(count), np.inf
    for _ in range(MAX_STEPS):
        normal, right = np.zeros((count, count)), np.zeros(count)
        for rows, x, y, area in _blocks(heights):
            z = heights.z[rows].ravel()
            valid = ~np.isnan(z)
            values, derivatives = form(parameters, x[valid], y[valid])
            weighted = derivatives.T * area[valid]
            normal += weighted @ derivatives
            right += weighted @ (z[valid] - values)
        # Points on one line cannot carry every term; the solution of least norm is as good as any there.
        step = np.linalg.lstsq(normal, right, rcond=1e-13)[0]
        parameters = parameters + step
        size = np.abs(step).max()
        if size <= 1e-11 * np.abs(parameters).max() or size >= last:
            break
        last = size
    return parameters


def _subtract(heights: HeightMap, form: Fit, parameters: Floats) -> HeightMap:
    """Return the map minus the fitted form."""
    z = np.array(heights.z)
    for rows, x, y, _ in _blocks(heights):
        z[rows] -= form(parameters, x, y)[0].reshape(z[rows].shape)
    return replace(heights, z=z)


def _remove_sphere(heights: HeightMap) -> HeightMap:
    """Subtract the sphere of best fit in z.

    The sphere through (0, 0, c) with slopes p, q there is k/2 (x² + y² + t²) + p x + q y - t = 0 with t = z - c: smooth
    in k where the sphere is flat, unlike its centre and radius.
    """
    valid_points(heights, 4, "a sphere")
    *_, scale = _scale(heights)

    def sphere(parameters: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        c, p, q, k = parameters / scale
        squares = k / 2 * (x * x + y * y) + p * x + q * y
        root = np.sqrt(np.maximum(1 - 2 * k * squares, EQUATOR))
        t = 2 * squares / (1 + root)
        derivatives = np.stack([np.ones_like(x), x / root, y / root, (x * x + y * y + t * t) / (2 * root)], axis=1)
        return scale * (c + t), derivatives

    parameters = _fit(heights, sphere, 4)
    _, p, q, k = parameters / scale
    # Where the sphere ends, its root is zero; there it was only continued so that the next step could come back.
    reach = max(
        float(
            (2 * k * (k / 2 * (x * x + y * y) + p * x + q * y)).max(where=~np.isnan(heights.z[rows]).ravel(), initial=0)
        )
        for rows, x, y, _ in _blocks(heights)
    )
    if reach >= 1 - EQUATOR:
        raise InputError(
            f"the best sphere has a radius of {scale / abs(k) * np.sqrt(1 + p * p + q * q):g} mm and does not reach "
            f"over the map, whose half-width is {scale:g} mm: remove a polynomial instead"
        )
    return _subtract(heights, sphere, parameters)
