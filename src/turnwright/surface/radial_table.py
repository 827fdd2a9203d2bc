"""A surface of revolution defined by a table of heights over the radius."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from turnwright._arrays import Bools, Floats, frozen
from turnwright._validate import check_numbers
from turnwright.errors import InputError
from turnwright.surface.base import Surface
from turnwright.units import Length, Thickness, say_length

__all__ = ["RadialTable"]

MIN_POINTS = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RadialTable(Surface):
    """Heights over the radius, interpolated by a cubic spline through them and their mirror images about the axis.

    The spline is even in the radius, so that the surface is twice continuously differentiable on the axis too.

    Parameters
    ----------
    points
        Radius and height of each point; the radii ascend from 0. [mm]

    Attributes
    ----------
    fit_error
        Estimated interpolation error: the largest difference from the quintic spline through the same points, at the
        middles between them. [mm]

    Raises
    ------
    InputError
        If there are fewer than 4 points, or the radii do not ascend from 0.

    Sources
    -------
    [deBoor2001]_ ch. IV.

    >>> radius = np.linspace(0, 5, 101)
    >>> dish = RadialTable(points=tuple(zip(radius, 0.01 * radius**2)))
    >>> round(float(dish.sag(3.0, 4.0)), 12), round(float(dish.hessian(0.0, 0.0)[0]), 12)
    (0.25, 0.02)
    """

    family = "radial table"
    example = MappingProxyType({"points": [["0 mm", "0 um"], ["2 mm", "20 um"], ["4 mm", "80 um"], ["6 mm", "180 um"]]})
    points: tuple[tuple[Thickness, Length], ...]
    fit_error: float = field(init=False)
    _knots: Floats = field(init=False, repr=False)
    _coefficients: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import CubicSpline, make_interp_spline  # noqa: PLC0415 - scipy is costly to import

        table = np.array([*self.points], dtype=np.float64).reshape(-1, 2)
        radius, height = table.T
        object.__setattr__(self, "points", tuple(zip(radius.tolist(), height.tolist(), strict=True)))
        check_numbers(self)
        if radius.size < MIN_POINTS:
            raise InputError(f"points of a radial table are {radius.size}, it needs {MIN_POINTS} or more: add some")
        if radius[0] != 0:
            raise InputError(
                f"points of a radial table begin at the radius {radius[0]:g} mm, they must begin at 0 mm: add the "
                "height on the axis"
            )
        if not (ascending := np.diff(radius) > 0).all():
            raise InputError(
                f"points of a radial table have the radius {radius[int(ascending.argmin()) + 1]:g} mm after "
                f"{radius[int(ascending.argmin())]:g} mm, the radii must ascend: sort them, and remove repeated ones"
            )
        both, heights = np.concatenate((-radius[:0:-1], radius)), np.concatenate((height[:0:-1], height))
        spline = CubicSpline(both, heights)
        object.__setattr__(self, "_knots", frozen(radius, "points"))
        object.__setattr__(self, "_coefficients", frozen(spline.c[:, radius.size - 1 :], "points", ndim=2))
        middles = radius[:-1] + np.diff(radius) / 2
        quintic = make_interp_spline(both, heights, k=5)(middles)
        object.__setattr__(self, "fit_error", float(np.abs(spline(middles) - quintic).max()))

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives; the last cubic extends beyond the table. See `Surface.evaluate`."""
        radius = np.hypot(x, y)
        number = np.clip(np.searchsorted(self._knots, radius, side="right") - 1, 0, self._knots.size - 2)
        a, b, c, d = self._coefficients[:, number]
        t = radius - self._knots[number]
        z = ((a * t + b) * t + c) * t + d
        if order == 0:
            return (z,)
        slope, bend = (3 * a * t + 2 * b) * t + c, 6 * a * t + 2 * b
        # Slope over radius; in the first interval, which begins on the axis with slope 0, without a division.
        with np.errstate(all="ignore"):
            ratio = np.where(number == 0, 3 * a * t + 2 * b, slope / radius)
            cosine, sine = (np.where(radius > 0, one / radius, 0.0) for one in (x, y))
        if order == 1:
            return z, ratio * x, ratio * y
        excess = bend - ratio
        return (
            z, ratio * x, ratio * y, ratio + excess * cosine**2, excess * cosine * sine, ratio + excess * sine**2,
        )  # fmt: skip

    @property
    def of_revolution(self) -> bool:
        """Whether the surface is known to be one of revolution about the axis."""
        return True

    def inside(self, x: Floats, y: Floats) -> Bools:
        """Return the mask of points within the table."""
        return np.asarray(np.hypot(x, y) <= self._knots[-1] * (1 + 1e-12))

    @property
    def domain(self) -> str:
        """Extent of the table in words."""
        return f"its table, out to a radius of {self._knots[-1]:.6g} mm"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Interpolation error of the spline. See `Surface.remarks`."""
        steps = np.diff(self._knots)
        sentence = (
            f"table of {self._knots.size} heights in steps of up to {steps.max():.4g} mm: the estimated interpolation "
            f"error of the cubic spline is {say_length(self.fit_error)}; finer structure is not included"
        )
        return (sentence,)

    @property
    def feature_size(self) -> float:
        """The smallest step of the table. [mm]."""
        return float(np.diff(self._knots).min())
