"""Surfaces with two radii: a torus, and a biconic."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from turnwright._kernels import quadrics
from turnwright._validate import check_numbers
from turnwright.surface.analytic import Radius, check_radius, summed
from turnwright.surface.base import Surface
from turnwright.units import Number

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats

__all__ = ["Biconic", "Toroid"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Toroid(Surface):
    r"""A circular torus: an arc in the xz plane, rotated about a line parallel to x.

    The arc has the radius :math:`R_x` and passes through the vertex; the line is y = 0, :math:`z = R_y`. An infinite
    ``radius_y`` gives a cylinder with its generators along y, an infinite ``radius_x`` one with them along x. For the
    other torus, an arc in the yz plane rotated about a line parallel to y, exchange the radii and place it with a
    rotation of pi/2.

    .. math:: z = R_y - \sqrt{(R_y - g)^2 - y^2}, \quad g = R_x - \sqrt{R_x^2 - x^2} \qquad (R_x, R_y > 0)

    Parameters
    ----------
    radius_x
        Radius of the arc along x: positive concave, negative convex, inf ("flat" in a file) straight. [mm]
    radius_y
        Distance from the vertex to the line, the vertex radius along y. [mm]

    Raises
    ------
    InputError
        If a radius is 0 or nan.

    Examples
    --------
    >>> trough = Toroid(radius_x=float("inf"), radius_y=10.0)
    >>> round(float(trough.sag(3.0, 6.0)), 12)
    2.0
    """

    family = "toroid"
    example = MappingProxyType({"radius_x": "60 mm", "radius_y": "40 mm"})
    radius_x: Radius
    radius_y: Radius

    def __post_init__(self) -> None:
        check_numbers(self, inf=("radius_x", "radius_y"))
        check_radius(self.radius_x, "radius_x of a toroid")
        check_radius(self.radius_y, "radius_y of a toroid")

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return the mask of points where neither the arc nor the circle around the line is vertical."""
        cx, cy = 1 / self.radius_x, 1 / self.radius_y
        squared = 1 - cx * cx * x * x
        with np.errstate(invalid="ignore"):
            lean = 1 - cy * cx * x * x / (1 + np.sqrt(squared))
        return np.asarray((squared > 0) & (lean > np.abs(cy * y)))

    @property
    def domain(self) -> str:
        """The domain of the surface in words."""
        return (
            f"|x| below {abs(self.radius_x):g} mm and |y| below {abs(self.radius_y):g} mm, the latter "
            "less the sag of the arc in x where both bend to one side"
        )

    @property
    def feature_size(self) -> float:
        """The smaller radius. [mm]."""
        return min(abs(self.radius_x), abs(self.radius_y))

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        return summed(x, y, order, (quadrics.toroid, (1 / self.radius_x, 1 / self.radius_y)))


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
