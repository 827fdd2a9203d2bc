"""Surfaces with two radii: a torus, and a biconic."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright._kernels import quadrics
from turnwright._validate import check_numbers
from turnwright.surface.analytic import (
    Radius,
    Terms,
    changing_length,
    check_radius,
    even_coefficients,
    even_power,
    farthest,
    index_of,
    read_terms,
    summed,
)
from turnwright.surface.base import Series, Surface
from turnwright.units import Number

__all__ = ["Biconic", "Toroid"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Toroid(Surface):
    r"""A torus: an arc in the xz plane, rotated about a line parallel to x.

    The arc is a circle of radius :math:`R_x` through the vertex, or a conic with even powers of x; the line is y = 0,
    :math:`z = R_y`. An infinite ``radius_y`` gives a cylinder with its generators along y, an infinite ``radius_x`` one
    with them along x. For the other torus, an arc in the yz plane rotated about a line parallel to y, exchange the
    radii and place it with a rotation of pi/2.

    .. math::

        z = R_y - \sqrt{(R_y - g)^2 - y^2}, \quad
        g = \frac{x^2 / R_x}{1 + \sqrt{1 - (1 + k) x^2 / R_x^2}} + \sum_n a_n x^n \qquad (R_y > 0)

    Parameters
    ----------
    radius_x
        Vertex radius of the arc along x: positive concave, negative convex, inf ("flat" in a file) straight. [mm]
    radius_y
        Distance from the vertex to the line, the vertex radius along y unless there is a term of x^2. [mm]
    conic
        Conic constant k of the arc.
    terms
        Coefficients a_n of the arc by the power n of x, n even and at least 2. [mm^(1-n)]

    Raises
    ------
    InputError
        If a radius is 0 or nan, a power is odd, or a number is not finite.

    Sources
    -------
    [Zemax]_ gives the toroidal surface with an aspheric arc.

    Examples
    --------
    >>> trough = Toroid(radius_x=float("inf"), radius_y=10.0)
    >>> round(float(trough.sag(3.0, 6.0)), 12)
    2.0
    """

    family = "toroid"
    example = MappingProxyType({"radius_x": "60 mm", "radius_y": "40 mm"})
    series = MappingProxyType({"terms": Series(power=lambda power: 1 - power, key=index_of)})
    radius_x: Radius
    radius_y: Radius
    conic: Number = 0.0
    terms: Terms[int] = ()
    _coefficients: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self, inf=("radius_x", "radius_y"))
        check_radius(self.radius_x, "radius_x of a toroid")
        check_radius(self.radius_y, "radius_y of a toroid")
        object.__setattr__(self, "terms", read_terms(self.terms, "a toroid", even_power("a toroid")))
        object.__setattr__(self, "_coefficients", even_coefficients(self.terms))

    def _arc(self, x: Floats) -> tuple[Floats, Floats]:
        """Return what the root of the arc is taken of, and the height of the arc; nan where it is vertical."""
        with np.errstate(over="ignore", invalid="ignore"):
            squared = 1 - (1 + self.conic) * x * x / self.radius_x**2
            height = x * x / self.radius_x / (1 + np.sqrt(squared))
        if self.terms:
            height = height + np.polynomial.polynomial.polyval(x * x, self._coefficients)
        return squared, height

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return the mask of points where neither the arc nor the circle around the line is vertical."""
        if not self.terms:
            # The height of the arc grows with |x|: where all corners of a rectangle are inside, all of it is.
            corners = self._within(np.array([0.0, farthest(x)]), np.full(2, farthest(y)))
            if corners.all():
                return np.ones(x.shape, dtype=np.bool_)
        return self._within(x, y)

    def _within(self, x: Floats, y: Floats) -> Bools:
        squared, height = self._arc(x)
        return np.asarray((squared > 0) & (1 - height / self.radius_y > np.abs(y / self.radius_y)))

    @property
    def domain(self) -> str:
        """The domain of the surface in words."""
        reach = abs(self.radius_x) / np.sqrt(1 + self.conic) if self.conic > -1 else np.inf
        return (
            f"|x| below {reach:g} mm and |y| below {abs(self.radius_y):g} mm, the latter "
            "less the sag of the arc in x where both bend to one side"
        )

    @property
    def feature_size(self) -> float:
        """The smaller radius, or the length over which the curvature of the arc changes. [mm]."""
        sizes = {2 * half: value for half, value in enumerate(self._coefficients)}
        sizes[2] = sizes.get(2, 0.0) + 1 / self.radius_x / 2
        return min(abs(self.radius_x), abs(self.radius_y), changing_length(sizes))

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        radii = 1 / self.radius_x, 1 / self.radius_y
        if not (self.conic or self.terms):  # ten times as fast
            return summed(x, y, order, (quadrics.toroid, radii))
        parameters = (*radii, float(self.conic), self._coefficients)
        return summed(x, y, order, (quadrics.aspheric_toroid, parameters))


@dataclass(frozen=True, slots=True, kw_only=True)
class Biconic(Surface):
    r"""A conic section in each of two planes.

    .. math:: z = \frac{c_x x^2 + c_y y^2}{1 + \sqrt{1 - (1 + k_x) c_x^2 x^2 - (1 + k_y) c_y^2 y^2}}

    Parameters
    ----------
    radius_x, radius_y
        Vertex radii 1/c: positive concave, negative convex, inf ("flat" in a file) straight. [mm]
    conic_x, conic_y
        Conic constants k.

    Raises
    ------
    InputError
        If a radius is 0 or nan, or a conic constant is not finite.
    """

    family = "biconic"
    example = MappingProxyType({"radius_x": "60 mm", "radius_y": "40 mm", "conic_x": -1.0, "conic_y": -0.5})
    radius_x: Radius
    radius_y: Radius
    conic_x: Number
    conic_y: Number

    def __post_init__(self) -> None:
        check_numbers(self, inf=("radius_x", "radius_y"))
        check_radius(self.radius_x, "radius_x of a biconic")
        check_radius(self.radius_y, "radius_y of a biconic")

    @property
    def _squared(self) -> tuple[float, float]:
        return (1 + self.conic_x) / self.radius_x**2, (1 + self.conic_y) / self.radius_y**2

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return the mask of points where the surface is defined."""
        a, b = self._squared
        return None if a <= 0 and b <= 0 else 1 - a * x * x - b * y * y > 0

    @property
    def domain(self) -> str:
        """The domain of the surface in words."""
        a, b = self._squared
        return "the whole plane" if a <= 0 and b <= 0 else f"{a:.6g} x² + {b:.6g} y² < 1 (mm)"

    @property
    def feature_size(self) -> float:
        """Length over which the curvature changes. [mm]."""
        largest = max(abs(value) for value in self._squared)
        return float(1 / np.sqrt(largest)) if largest > 0 else float("inf")

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        parameters = (1 / self.radius_x, 1 / self.radius_y, float(self.conic_x), float(self.conic_y))
        return summed(x, y, order, (quadrics.biconic, parameters))
