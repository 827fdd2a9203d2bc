"""Zernike polynomials in fringe, Noll and ANSI order."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isqrt, sqrt
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from turnwright._arrays import Floats
from turnwright._kernels import polynomials
from turnwright._validate import check_numbers, positive, whole_number
from turnwright.errors import InputError
from turnwright.surface.analytic import MAX_DEGREE, Terms, index_of, read_terms, summed
from turnwright.surface.base import Series, Surface
from turnwright.surface.disc import DiscSum, disc_sum
from turnwright.units import Flag, Size

__all__ = ["Indexing", "Zernike", "zernike_order"]

Indexing: TypeAlias = Literal["fringe", "noll", "ansi"]
FIRST = {"fringe": 1, "noll": 1, "ansi": 0}


def zernike_order(index: int, indexing: Indexing) -> tuple[int, int]:
    """Return degree n and azimuthal order m, negative for a sine, of a Zernike term.

    Fringe terms up to 36 are ordered by n + |m|, then by falling |m|, the cosine first. Number 37 is (12, 0), the last
    of the standard set; from 38 on the rule continues, so that (6, 6), number 37 by the rule, has no number and number
    49 is (12, 0) again.

    Raises
    ------
    InputError
        If the index is not an integer, is below the first of its indexing, or the degree is above 100.

    Sources
    -------
    [Noll1976]_ Table I; ANSI Z80.28; the fringe set as in [Wyant1992]_.

    >>> zernike_order(8, "fringe"), zernike_order(8, "noll"), zernike_order(8, "ansi"), zernike_order(37, "fringe")
    ((3, -1), (3, 1), (3, 1), (12, 0))
    """
    if indexing not in FIRST:
        raise InputError(f"the indexing is {indexing!r}, known are fringe, noll and ansi: choose one of them")
    j = whole_number(index, f"the {indexing} index of a Zernike term", FIRST[indexing])
    if indexing == "fringe":
        root = isqrt(j - 1) + 1
        below = root * root - j
        m = (below + 1) // 2
        n = 2 * (root - 1) - m
        n, m = (12, 0) if j == 37 else (n, -m if below % 2 else m)
    elif indexing == "noll":
        n = (isqrt(8 * j - 7) - 1) // 2
        place = j - n * (n + 1) // 2 - 1
        m = 2 * (place // 2) + 1 if n % 2 else 2 * ((place + 1) // 2)
        m = -m if j % 2 else m
    else:
        n = (isqrt(8 * j + 1) - 1) // 2
        m = 2 * j - n * (n + 2)
    if n > MAX_DEGREE:
        raise InputError(
            f"the {indexing} index {j} of a Zernike term means degree {n}, the limit is {MAX_DEGREE}: check the index"
        )
    return n, m


@dataclass(frozen=True, slots=True, kw_only=True)
class Zernike(Surface):
    r"""A sum of Zernike polynomials; add it to a conic for a mirror with a departure.

    .. math:: z = \sum_j c_j N R_n^{|m|}(\rho) \cos m\theta \ \text{or} \ \sin |m|\theta, \qquad \rho = r / r_0

    The angle runs from +x toward +y. The polynomials are also used beyond the normalisation radius, as the tool touches
    the surface outside the aperture.

    Parameters
    ----------
    terms
        Coefficients by index. [mm]
    radius
        Normalisation radius. [mm]
    indexing
        "fringe" (from 1), "noll" (from 1) or "ansi" (from 0), see `zernike_order`.
    normalised
        Whether a coefficient is the root mean square of its term over the disc (N = sqrt(n + 1), times sqrt(2) unless
        m = 0) or its value at the edge (N = 1). The default follows the indexing: fringe False, Noll and ANSI True.

    Raises
    ------
    InputError
        If an index is invalid, two indices mean the same polynomial, a coefficient is not finite, or the radius is not
        positive.

    Examples
    --------
    >>> astigmatism = Zernike(terms={5: 1e-3}, radius=10.0, indexing="fringe")
    >>> float(astigmatism.sag(10.0, 0.0)), float(astigmatism.sag(0.0, 10.0))
    (0.001, -0.001)
    """

    family = "zernike"
    example = MappingProxyType({"radius": "5 mm", "indexing": "fringe", "units": "mm", "terms": {"5": 1e-4, "8": 5e-5}})
    series = MappingProxyType({"terms": Series(power=lambda _: 1, key=index_of)})
    terms: Terms[int]
    radius: Size
    indexing: Indexing
    normalised: Flag | None = None
    _sum: DiscSum = field(init=False, repr=False, compare=False)
    _degree: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.radius, "the radius of a Zernike surface", "mm")
        terms = read_terms(
            self.terms, "a Zernike surface", lambda key: whole_number(key, "the index of a Zernike term", 0)
        )
        object.__setattr__(self, "terms", terms)
        normalised = self.indexing != "fringe" if self.normalised is None else self.normalised
        series: dict[int, Floats] = {}
        indices: dict[tuple[int, int], int] = {}
        for index, value in terms:
            n, m = zernike_order(index, self.indexing)
            if (n, m) in indices:
                raise InputError(
                    f"the {self.indexing} terms {indices[n, m]} and {index} are both the polynomial ({n}, {m}), only "
                    "one is allowed: add their coefficients"
                )
            indices[n, m] = index
            k = (n - abs(m)) // 2
            row = np.zeros(max(k + 1, len(series.get(m, ()))))
            row[: len(series.get(m, ()))] = series.get(m, ())
            row[k] = value * (sqrt((n + 1) * (2 if m else 1)) if normalised else 1.0)
            series[m] = row
        object.__setattr__(self, "_sum", disc_sum(series))
        object.__setattr__(self, "_degree", max((n for n, _ in indices), default=0))

    @property
    def feature_size(self) -> float:
        """The radius over the degree; below degree 3 the curvature is constant. [mm]."""
        return self.radius / self._degree if self._degree > 2 else float("inf")

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        return summed(x, y, order, (polynomials.disc, 1 / self.radius, *self._sum))
