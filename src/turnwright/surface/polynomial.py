"""Polynomials in x and y, and in powers of the distance from the axis."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated

import numpy as np

from turnwright._arrays import Floats, Ints, frozen
from turnwright._kernels import polynomials
from turnwright._validate import check_numbers
from turnwright.errors import InputError
from turnwright.surface.analytic import (
    MAX_DEGREE,
    Coefficients,
    Terms,
    changing_length,
    indices_of,
    read_terms,
    summed,
    whole_pair,
)
from turnwright.surface.base import Series, Surface
from turnwright.units import Number

__all__ = ["RadialPolynomial", "XYPolynomial"]


def _powers(key: object) -> tuple[int, int]:
    i, j = whole_pair(key, "the pair of powers of a polynomial's term")
    if j < 0 or i + j > MAX_DEGREE:
        raise InputError(
            f"the pair of powers of a polynomial's term is ({i}, {j}), neither may be below 0 nor their sum above "
            f"{MAX_DEGREE}: name each term by its powers of x and y"
        )
    return i, j


@dataclass(frozen=True, slots=True, kw_only=True)
class XYPolynomial(Surface):
    r"""A polynomial, :math:`z = \sum a_{ij} x^i y^j`.

    Parameters
    ----------
    terms
        Coefficients by the powers (i, j) of x and y. [mm^(1-i-j)]

    Raises
    ------
    InputError
        If a power is not an integer of 0 or more, or a coefficient is not finite.

    Examples
    --------
    >>> saddle = XYPolynomial(terms={(2, 0): 0.01, (0, 2): -0.01})
    >>> [float(value) for value in saddle.hessian(1.0, 2.0)]
    [0.02, 0.0, -0.02]
    """

    family = "xy polynomial"
    example = MappingProxyType({"units": "mm", "terms": {"2,0": 1e-3, "0,2": 2e-3}})
    series = MappingProxyType({"terms": Series(power=lambda powers: 1 - sum(powers), key=indices_of)})
    terms: Terms[tuple[int, int]]
    _table: Floats = field(init=False, repr=False, compare=False)
    _sizes: Ints = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        terms = read_terms(self.terms, "a polynomial", _powers)
        object.__setattr__(self, "terms", terms)
        sizes = np.zeros(1 + max((i for (i, _), _ in terms), default=0), dtype=np.int64)
        for (i, j), _ in terms:
            sizes[i] = max(sizes[i], 2 * (j // 2 + 1))  # the kernel takes powers of y in pairs
        table = np.zeros((sizes.size, max(2, int(sizes.max()))))
        for (i, j), value in terms:
            table[i, j] = value
        object.__setattr__(self, "_table", frozen(table, "coefficients", ndim=2))
        sizes.flags.writeable = False
        object.__setattr__(self, "_sizes", sizes)

    @property
    def feature_size(self) -> float:
        """Estimate of the length over which the curvature changes, from the sizes of the coefficients. [mm]."""
        degree = np.add.outer(*(np.arange(size) for size in self._table.shape))
        return changing_length(dict(enumerate(np.bincount(degree.ravel(), np.abs(self._table).ravel()))))

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        return summed(x, y, order, (polynomials.xy, self._table, self._sizes))


@dataclass(frozen=True, slots=True, kw_only=True)
class RadialPolynomial(Surface):
    r"""Even powers of the distance r from the axis, plus the integral over x of such a polynomial.

    .. math::

        z = \sum_{k \ge 1} \frac{a_k}{2} r^{2k} + \int_0^x \Bigl(t + \sum_{k \ge 1} b_k r^{2k}\Bigr) dx,
        \qquad r^2 = x^2 + y^2

    The first sum is rotationally symmetric; the integral adds the asymmetry along x: a freeform that is even in y.

    Parameters
    ----------
    radial
        Coefficients (a_1, a_2, ...). [mm^(1-2k)]
    slope
        Coefficients (b_1, b_2, ...) of the slope along x. [mm^-2k]
    tilt
        Slope t along x at the origin. [1]

    Raises
    ------
    InputError
        If a coefficient is not finite.

    Sources
    -------
    [Troutman2016]_ Appendix A.1 gives its infrared lens in this form. Oracle: SymPy's integral.

    Examples
    --------
    >>> lens = RadialPolynomial(radial=(-3.62e-3,), slope=(-1.01e-3,), tilt=0.0262)
    >>> [round(float(value), 9) for value in lens.gradient(2.0, 0.0)]
    [0.01492, 0.0]
    """

    family = "radial polynomial"
    example = MappingProxyType({"units": "mm", "radial": [1e-3]})
    series = MappingProxyType(
        {"radial": Series(power=lambda place: -1 - 2 * place), "slope": Series(power=lambda place: -2 - 2 * place)}
    )
    radial: Annotated[tuple[float, ...], Coefficients] = ()
    slope: Annotated[tuple[float, ...], Coefficients] = ()
    tilt: Number = 0.0
    _even: Floats = field(init=False, repr=False, compare=False)
    _slopes: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("radial", "slope"):
            values = getattr(self, name)
            if np.ndim(values) != 1 or 2 * len(values) + 1 > MAX_DEGREE:
                raise InputError(
                    f"{name} of a radial polynomial is {values!r}, it must be a list of at most {MAX_DEGREE // 2 - 1} "
                    "coefficients, that of r^2 first: correct it"
                )
            object.__setattr__(self, name, tuple(float(value) for value in values))
        even = np.array([0.0, *(value / 2 for value in self.radial)])
        # Each row holds 2 (k + 1) times the next coefficient of the row above, see the kernel.
        slopes = np.zeros((3, len(self.slope) + 1))
        slopes[0] = self.tilt, *self.slope
        twice = 2.0 * np.arange(1, len(self.slope) + 1)
        slopes[1, :-1] = twice * slopes[0, 1:]
        slopes[2, :-1] = twice * slopes[1, 1:]
        object.__setattr__(self, "_even", frozen(even, "radial"))
        object.__setattr__(self, "_slopes", frozen(slopes, "slope", ndim=2))

    @property
    def feature_size(self) -> float:
        """Estimate of the length over which the curvature changes, from the sizes of the coefficients. [mm]."""
        sizes = {2 * k: value / 2 for k, value in enumerate(self.radial, start=1)}
        sizes |= {2 * k + 1: value / (2 * k + 1) for k, value in enumerate(self.slope, start=1)}
        return changing_length(sizes)

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        return summed(x, y, order, (polynomials.even, self._even), (polynomials.slope_integral, self._slopes))
