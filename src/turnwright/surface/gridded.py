"""A surface defined by a table of heights on a grid."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from turnwright._arrays import Bools, Floats, frozen, only_read
from turnwright._kernels.bicubic import bicubic
from turnwright._validate import check_numbers
from turnwright.errors import DomainError, InputError
from turnwright.surface.base import Surface
from turnwright.units import say_length

__all__ = ["Gridded"]

EXTRAPOLATED_CELLS = 3
"""Cells beyond the border of the valid heights that are extrapolated smoothly; farther ones hardly matter."""

FORM_DEGREE = 8
"""Degree of the polynomial that extrapolates the form."""

FORM_TERMS = (FORM_DEGREE + 1) * (FORM_DEGREE + 2) // 2

MAX_FORM_HEIGHTS = 20_000
"""Heights to which this polynomial is fitted."""

NEIGHBOURS = 32
"""Valid heights from which the residual at a point is extrapolated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gridded(Surface):
    """Heights on a rectangular grid, interpolated by a bicubic spline.

    The spline is twice continuously differentiable, with the not-a-knot condition at the border, so that it
    reproduces any bicubic polynomial. It interpolates noise as well as form: smooth a measured table first.

    Where a height is missing (nan), the cells that touch it are outside the domain. For the spline, a few heights
    beyond the border are extrapolated; their effect on the error falls to a quarter with each cell inwards.

    Parameters
    ----------
    x, y
        Ascending columns (nx,) and rows (ny,); their steps need not be equal. [mm]
    z
        Heights, nan where there is none. (ny, nx) [mm]
    source
        Description of the heights in a job file, where they were read from a file.

    Attributes
    ----------
    fit_error
        Estimated interpolation error: the largest difference at the middles of the cells between this spline and the
        quintic spline through the same heights. On a smooth surface with step h the cubic errs by h^4 and the quintic
        by h^6, so the difference is the error of the cubic; for a noisy table it is about the noise. [mm]

    Raises
    ------
    InputError
        If an axis has fewer than 6 points or does not ascend, an axis is not finite or a height infinite, no cell has
        heights at all corners, or the shapes differ.

    Sources
    -------
    [deBoor2001]_ ch. IV and XVII: not-a-knot splines and their tensor products.

    >>> step = np.linspace(-2, 2, 41)
    >>> table = Gridded(x=step, y=step, z=np.cos(step) + np.sin(step)[:, None])
    >>> bool(table.fit_error < 1e-5)   # steps of 0.1 mm [mm]
    True
    """

    hidden = ("source",)
    x: Floats
    y: Floats
    z: Floats
    source: Any = field(default=None, compare=False, repr=False)
    fit_error: float = field(init=False)
    _nodes: Floats = field(init=False, repr=False)
    _complete: Bools | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_numbers(self, nan=("z",))
        from scipy.interpolate import CubicSpline, make_interp_spline  # noqa: PLC0415 - scipy is costly to import

        for name in ("x", "y"):
            nodes = frozen(getattr(self, name), f"{name} of a gridded surface")
            if nodes.size < 6:
                raise InputError(f"{name} of a gridded surface has {nodes.size} points, it needs 6 or more: add some")
            if not (np.diff(nodes) > 0).all():
                raise InputError(
                    f"{name} of a gridded surface does not ascend at its point {np.argmin(np.diff(nodes) > 0) + 1}: "
                    "sort the table and remove repeated points"
                )
            object.__setattr__(self, name, nodes)
        z = frozen(self.z, "z of a gridded surface", ndim=2, finite=False)
        if np.isinf(z).any():
            raise InputError(f"z of a gridded surface has {np.count_nonzero(np.isinf(z))} infinite values: write nan")
        if z.shape != (self.y.size, self.x.size):
            raise InputError(
                f"z of a gridded surface has the shape {z.shape}, its axes need {(self.y.size, self.x.size)}: "
                "rows are y, columns are x"
            )
        object.__setattr__(self, "z", z)
        valid = ~np.isnan(z)
        complete = valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]
        if not complete.any():
            raise InputError(
                f"z of a gridded surface has {np.count_nonzero(valid)} of {z.size} heights and no cell with heights at "
                "all four corners: complete it"
            )
        object.__setattr__(self, "_complete", None if valid.all() else complete)
        if self._complete is not None:
            z = _extrapolate(self.x, self.y, z)
        zx = CubicSpline(self.x, z, axis=1)(self.x, 1)
        zy, zxy = (CubicSpline(self.y, values, axis=0)(self.y, 1) for values in (z, zx))
        object.__setattr__(self, "_nodes", frozen(np.stack([z, zx, zy, zxy], axis=-1), "nodes", ndim=3, finite=False))
        middles = [nodes[:-1] + np.diff(nodes) / 2 for nodes in (self.x, self.y)]
        quintic = make_interp_spline(self.x, z, k=5, axis=1)(middles[0])
        quintic = make_interp_spline(self.y, quintic, k=5, axis=0)(middles[1])
        x, y = np.meshgrid(*middles)
        (cubic,) = self.evaluate(x, y, 0)
        object.__setattr__(self, "fit_error", float(np.abs(cubic - quintic)[complete].max()))

    @property
    def file(self) -> str:
        """File from which the heights were read, by which a job names them; empty if none."""
        return "" if self.source is None else str(self.source.file)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives; border cells extend beyond the grid. See `Surface.evaluate`."""
        out = np.empty(((1, 3, 6)[order], x.size))
        bicubic(only_read(x.ravel()), only_read(y.ravel()), self.x, self.y, self._nodes, order, out)
        return tuple(part.reshape(x.shape) for part in out)

    def inside(self, x: Floats, y: Floats) -> Bools:
        """Return the mask of points on the grid, in cells with heights at all corners."""
        on_grid: Bools = (x >= self.x[0]) & (x <= self.x[-1]) & (y >= self.y[0]) & (y <= self.y[-1])
        if self._complete is None:
            return on_grid
        column, row = (
            np.clip(np.searchsorted(axis, at, side="right") - 1, 0, axis.size - 2)
            for axis, at in ((self.x, x), (self.y, y))
        )
        return on_grid & self._complete[row, column]

    def require_disc(self, radius: float, what: str) -> None:
        """Raise unless the surface is defined everywhere in the disc, including holes of any size."""
        if self._complete is not None:
            reach = radius + np.hypot(np.diff(self.x).max(), np.diff(self.y).max())
            row, column = np.nonzero(np.isnan(self.z) & (np.hypot(self.x, self.y[:, None]) <= reach))
            holes = [(x, y) for x, y in zip(self.x[column], self.y[row], strict=True) if self._touches(x, y, radius)]
            if holes:
                raise DomainError(
                    f"{what} is {radius:g} mm but {type(self).__name__} has no height at {len(holes)} points on or "
                    f"next to it, the first at x = {holes[0][0]:.6g} mm, y = {holes[0][1]:.6g} mm: reduce the radius, "
                    "or complete the table"
                )
        Surface.require_disc(self, radius, what)

    def _touches(self, x: float, y: float, radius: float) -> bool:
        """Whether a cell at a node of the grid reaches into a disc."""
        near = []
        for axis, at in ((self.x, x), (self.y, y)):
            index = int(np.searchsorted(axis, at))
            low, high = axis[max(index - 1, 0)], axis[min(index + 1, axis.size - 1)]
            near.append(min(max(0.0, low), high))
        return float(np.hypot(*near)) <= radius

    @property
    def domain(self) -> str:
        """Extent of the grid in words."""
        holes = "" if self._complete is None else ", where all four corners of a cell have heights"
        return (
            f"its grid, x from {self.x[0]:.6g} to {self.x[-1]:.6g} mm and y from {self.y[0]:.6g} to {self.y[-1]:.6g} mm"
            f"{holes}"
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Interpolation error of the spline. See `Surface.remarks`."""
        steps = f"{np.diff(self.x).max():.4g} and {np.diff(self.y).max():.4g} mm"
        sentence = (
            f"table of {self.x.size} x {self.y.size} heights in steps of {steps}: the estimated interpolation error of "
            f"the bicubic spline is {say_length(self.fit_error)}; finer structure is not included"
        )
        return (sentence,)

    @property
    def feature_size(self) -> float:
        """The smallest step of the grid. [mm]."""
        return float(min(np.diff(self.x).min(), np.diff(self.y).min()))


def _extrapolate(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the heights with missing ones extrapolated from the valid ones."""
    from scipy.interpolate import RBFInterpolator  # noqa: PLC0415 - scipy is costly to import
    from scipy.ndimage import binary_dilation, distance_transform_edt  # noqa: PLC0415

    valid = ~np.isnan(z)
    near = binary_dilation(valid, structure=np.ones((3, 3), dtype=bool), iterations=EXTRAPOLATED_CELLS) & ~valid
    # Only valid heights near the border are used.
    source = binary_dilation(~valid, structure=np.ones((3, 3), dtype=bool), iterations=2 * EXTRAPOLATED_CELLS) & valid
    steps = float(np.median(np.diff(x))), float(np.median(np.diff(y)))

    def places(chosen: Bools) -> Floats:
        row, column = np.nonzero(chosen)
        return np.stack([x[column] / steps[0], y[row] / steps[1]], axis=1)

    # A polynomial extrapolates the form; radial functions of the neighbours extrapolate the residual.
    u, v = (2 * (at - at[0]) / (at[-1] - at[0]) - 1 for at in (x, y))
    form = np.zeros(z.shape)
    if np.count_nonzero(valid) > 4 * FORM_TERMS:
        powers = [(i, j) for i in range(FORM_DEGREE + 1) for j in range(FORM_DEGREE + 1 - i)]
        along, across = (np.polynomial.chebyshev.chebvander(at, FORM_DEGREE) for at in (u, v))
        row, column = (at[:: -(-at.size // MAX_FORM_HEIGHTS)] for at in np.nonzero(valid))
        terms = np.stack([along[column, i] * across[row, j] for i, j in powers], axis=1)
        weights = np.linalg.lstsq(terms, z[row, column])[0]
        for (i, j), weight in zip(powers, weights, strict=True):
            form += weight * along[:, i] * across[:, j, None]
    residual = z - form
    data, total = (places(source), residual[source]), int(np.count_nonzero(source))
    for count in (NEIGHBOURS, 8 * NEIGHBOURS, total):
        try:
            extend = RBFInterpolator(*data, neighbors=min(count, total), kernel="cubic", degree=1)
            residual[near] = extend(places(near))
            break
        except np.linalg.LinAlgError:  # the neighbours of a point are on one line
            if count >= total:
                raise InputError(
                    f"z of a gridded surface has {np.count_nonzero(valid)} heights nearly on a line: complete it"
                ) from None
    missing = np.isnan(residual)
    if missing.any():
        row, column = distance_transform_edt(missing, return_distances=False, return_indices=True)
        residual = residual[row, column]
    return np.where(valid, z, residual + form)
