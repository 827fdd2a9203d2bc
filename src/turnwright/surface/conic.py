"""Planes, spheres, conics and even aspheres: surfaces of revolution about z (a plane may be tilted)."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from turnwright._arrays import Floats
from turnwright._kernels import polynomials, quadrics
from turnwright._validate import check_numbers, finite_tuple
from turnwright.surface.analytic import (
    OnConic,
    Radius,
    Terms,
    changing_length,
    check_radius,
    even_coefficients,
    even_power,
    index_of,
    read_terms,
    summed,
)
from turnwright.surface.base import Series, Surface
from turnwright.units import Number

__all__ = ["Conic", "EvenAsphere", "Plane", "Sphere", "prescription"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane(Surface):
    r"""A plane through the origin, :math:`z = s_x x + s_y y`.

    Parameters
    ----------
    slope
        Slopes along x and along y. [1]

    Raises
    ------
    InputError
        If the slope is not two finite numbers.
    """

    family = "plane"
    slope: tuple[Number, Number] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "slope", finite_tuple(self.slope, "the slope of a plane", 2))

    @property
    def of_revolution(self) -> bool:
        """Whether the surface is known to be one of revolution about the axis."""
        return not any(self.slope)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        constants = (*self.slope, 0.0, 0.0, 0.0)[: (0, 2, 5)[order]]
        return self.slope[0] * x + self.slope[1] * y, *(np.full(x.shape, value) for value in constants)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(OnConic):
    r"""A sphere, :math:`z = c r^2 / (1 + \sqrt{1 - c^2 r^2})` with :math:`c = 1/R`.

    Parameters
    ----------
    radius
        Radius R: positive concave, negative convex, inf ("flat" in a file) a plane. [mm]

    Raises
    ------
    InputError
        If the radius is 0 or nan.

    Examples
    --------
    >>> round(float(Sphere(radius=10.0).sag(6.0, 0.0)), 12)
    2.0
    """

    family = "sphere"
    example = MappingProxyType({"radius": "50 mm"})
    radius: Radius

    @property
    def base(self) -> tuple[float, float]:
        """Vertex curvature and conic constant. [1/mm, 1]."""
        return 1 / self.radius, 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Conic(OnConic):
    r"""A conic of revolution, :math:`z = c r^2 / (1 + \sqrt{1 - (1 + k) c^2 r^2})` with :math:`c = 1/R`.

    Parameters
    ----------
    radius
        Vertex radius R: positive concave, negative convex, inf ("flat" in a file) a plane. [mm]
    conic
        Conic constant k: 0 a sphere, -1 a paraboloid, below -1 a hyperboloid, else an ellipsoid.

    Raises
    ------
    InputError
        If the radius is 0 or nan, or the conic constant is not finite.
    """

    family = "conic"
    example = MappingProxyType({"radius": "50 mm", "conic": -1.0})
    radius: Radius
    conic: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class EvenAsphere(OnConic):
    r"""A conic with even powers of the distance from the axis.

    .. math:: z = \frac{c r^2}{1 + \sqrt{1 - (1 + k) c^2 r^2}} + \sum_n a_n r^n

    Parameters
    ----------
    radius
        Vertex radius R = 1/c of the conic: positive concave, negative convex, inf ("flat" in a file) a plane. [mm]
    conic
        Conic constant k.
    terms
        Coefficients a_n by the power n of r, n even and at least 2. [mm^(1-n)]

    Raises
    ------
    InputError
        If the radius is 0 or nan, a power is odd, or a coefficient is not finite.

    Examples
    --------
    >>> lens = EvenAsphere(radius=float("inf"), conic=0, terms={4: 1e-4})
    >>> float(lens.sag(0.0, 10.0))
    1.0
    """

    family = "even asphere"
    example = MappingProxyType({"radius": "50 mm", "conic": -1.0, "units": "mm", "terms": {"4": 1e-6, "6": 1e-9}})
    series = MappingProxyType({"terms": Series(power=lambda power: 1 - power, key=index_of)})
    radius: Radius
    conic: Number
    terms: Terms[int] = ()
    _coefficients: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self, inf=("radius",))
        check_radius(self.radius, "the radius of an even asphere")
        object.__setattr__(self, "terms", read_terms(self.terms, "an even asphere", even_power("an even asphere")))
        object.__setattr__(self, "_coefficients", even_coefficients(self.terms))

    @property
    def feature_size(self) -> float:
        """Length over which the curvature changes, of the conic or of the polynomial with its vertex sphere. [mm]."""
        sizes = {2 * half: value for half, value in enumerate(self._coefficients)}
        sizes[2] = sizes.get(2, 0.0) + self.base[0] / 2
        return min(self.conic_length, changing_length(sizes))

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        return summed(x, y, order, (quadrics.conic, self.base), (polynomials.even, self._coefficients))


def prescription(surface: Surface) -> tuple[float, float, Floats] | None:
    """Return vertex curvature, conic constant and the coefficients of the even powers 0, 2, ... of such a surface.

    ``None`` for a surface that is no conic with such powers or without.
    """
    match surface:
        case EvenAsphere():
            return *surface.base, surface._coefficients  # noqa: SLF001
        case Sphere() | Conic():
            return *surface.base, even_coefficients(())
    return None
