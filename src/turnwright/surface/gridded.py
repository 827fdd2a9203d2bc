"""A surface given by a table of heights."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from turnwright._arrays import Bools, Floats, frozen, only_read
from turnwright.errors import InputError
from turnwright.surface._surface import Surface

__all__ = ["Gridded"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gridded(Surface):
    """Heights on a rectangular grid, joined by a bicubic spline through every one of them.

    The spline is twice continuously differentiable, with the not-a-knot condition at the border, so that it
    reproduces any bicubic polynomial. It follows noise as faithfully as form: smooth a measured table first.

    Parameters
    ----------
    x, y
        Ascending columns (nx,) and rows (ny,); their steps need not be equal. [mm]
    z
        Heights. (ny, nx) [mm]

    Attributes
    ----------
    fit_error
        What the spline may be wrong by between the grid's points: its largest difference, at the middles of the
        cells, to the spline of degree five through the same heights. For a smooth surface on a step h the first
        errs by h^4, the second by h^6, so the difference is the first one's error; for a noisy table it is about the
        noise. [mm]

    Raises
    ------
    InputError
        If an axis has fewer than 6 points or does not ascend, if anything is not finite, or if the shapes differ.

    Sources
    -------
    [deBoor2001]_ ch. IV and XVII: not-a-knot splines and their tensor products.

    >>> step = np.linspace(-2, 2, 41)
    >>> table = Gridded(x=step, y=step, z=np.cos(step) + np.sin(step)[:, None])
    >>> bool(table.fit_error < 1e-5)   # steps of 0.1 mm [mm]
    True
    """

    x: Floats
    y: Floats
    z: Floats
    fit_error: float = field(init=False)
    _nodes: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import CubicSpline, make_interp_spline  # noqa: PLC0415 - scipy is costly to import

        for name in ("x", "y"):
            nodes = frozen(getattr(self, name), f"{name} of a gridded surface")
            if nodes.size < 6:
                raise InputError(f"{name} of a gridded surface has {nodes.size} points, it needs 6 or more: add some")
            if not (np.diff(nodes) > 0).all():
                raise InputError(
                    f"{name} of a gridded surface does not ascend at its point {np.argmin(np.diff(nodes) > 0) + 1}: "
                    "sort the table and drop repeated points"
                )
            object.__setattr__(self, name, nodes)
        z = frozen(self.z, "z of a gridded surface", ndim=2)
        if z.shape != (self.y.size, self.x.size):
            raise InputError(
                f"z of a gridded surface has the shape {z.shape} and its axes {(self.y.size, self.x.size)}: "
                "rows are y, columns are x"
            )
        zx = CubicSpline(self.x, z, axis=1)(self.x, 1)
        zy, zxy = (CubicSpline(self.y, values, axis=0)(self.y, 1) for values in (z, zx))
        object.__setattr__(self, "z", z)
        object.__setattr__(self, "_nodes", frozen(np.stack([z, zx, zy, zxy], axis=-1), "nodes", ndim=3, finite=False))
        middles = [nodes[:-1] + np.diff(nodes) / 2 for nodes in (self.x, self.y)]
        finer = make_interp_spline(self.x, z, k=5, axis=1)(middles[0])
        finer = make_interp_spline(self.y, finer, k=5, axis=0)(middles[1])
        x, y = np.meshgrid(*middles)
        (here,) = self.evaluate(x, y, 0)
        object.__setattr__(self, "fit_error", float(np.abs(here - finer).max()))

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives; beyond the grid the border cells run on. See `Surface.evaluate`."""
        from turnwright._kernels.bicubic import bicubic  # noqa: PLC0415 - numba is costly to import

        out = np.empty(((1, 3, 6)[order], x.size))
        bicubic(only_read(x.ravel()), only_read(y.ravel()), self.x, self.y, self._nodes, order, out)
        return tuple(part.reshape(x.shape) for part in out)

    def inside(self, x: Floats, y: Floats) -> Bools:
        """Return where the grid is."""
        on_grid: Bools = (x >= self.x[0]) & (x <= self.x[-1]) & (y >= self.y[0]) & (y <= self.y[-1])
        return on_grid

    @property
    def domain(self) -> str:
        """Say where the grid is."""
        return (
            f"its grid, x from {self.x[0]:.6g} to {self.x[-1]:.6g} mm and y from {self.y[0]:.6g} to {self.y[-1]:.6g} mm"
        )

    @property
    def feature_size(self) -> float:
        """The least step of the grid. [mm]."""
        return float(min(np.diff(self.x).min(), np.diff(self.y).min()))
