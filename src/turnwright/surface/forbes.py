"""Forbes polynomials: departures from a conic with terms orthogonal in slope (Q-bfs, Q-2D) or height (Q-con)."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.polynomial import legendre

from turnwright._arrays import Floats
from turnwright._kernels import polynomials, quadrics
from turnwright._validate import check_numbers, positive, whole_number
from turnwright.errors import InputError
from turnwright.surface.analytic import (
    MAX_DEGREE,
    OnConic,
    Radius,
    Terms,
    check_radius,
    index_of,
    indices_of,
    read_terms,
    summed,
    whole_pair,
)
from turnwright.surface.base import Series
from turnwright.surface.disc import DiscSum, disc_sum
from turnwright.units import Number, Size

__all__ = ["Forbes", "ForbesKind"]

ForbesKind: TypeAlias = Literal["qbfs", "qcon", "q2d"]


def _checked(degree: int, term: object) -> None:
    if degree > MAX_DEGREE:
        raise InputError(
            f"the term {term!r} of a Forbes surface has degree {degree}, the limit is {MAX_DEGREE}: check its index"
        )


def _single(key: object) -> tuple[int, int]:
    n = whole_number(key, "the index of a Forbes term", 0)
    _checked(2 * n + 4, key)
    return n, 0


def _double(key: object) -> tuple[int, int]:
    n, m = whole_pair(key, "the pair (n, m) of a Q-2D term")
    _checked(2 * n + (abs(m) if m else 4), key)
    return n, m


def _q_to_jacobi(m: int, a: Floats) -> Floats:
    r"""Jacobi coefficients of :math:`\sum a_n Q_n^m`, for m = 0 before the factor :math:`u^2 (1 - u^2)`.

    The :math:`Q_n^m` are defined by Gram-Schmidt orthogonalisation of the polynomials in :math:`u^2`, so that the
    slopes of the departures are orthonormal over the disc with the weight :math:`1 / (u \sqrt{1 - u^2})`. With
    u = sin t the weighted mean is a mean over t, which equidistant points give exactly, and Gram-Schmidt is a QR
    decomposition.
    """
    from scipy.special import eval_jacobi  # noqa: PLC0415 - only these families need it

    k = np.arange(len(a))
    nodes = m + 2 * len(a) + 8
    u = np.sin((np.arange(nodes) + 0.5) * np.pi / (2 * nodes))[:, None]
    s = u * u
    jacobi = eval_jacobi(k, 0, m, 2 * s - 1)
    slope = (k + m + 1) * eval_jacobi(k - 1, 1, m + 1, 2 * s - 1) * (k > 0)
    if m == 0:
        gradient = 2 * u * (s * (1 - s) * slope + (1 - 2 * s) * jacobi) / np.sqrt(nodes)
    else:
        along = m * u ** (m - 1) * jacobi + 2 * u ** (m + 1) * slope
        around = m * u ** (m - 1) * jacobi
        gradient = np.concatenate([along, around]) / np.sqrt(2 * nodes)
    triangle = np.linalg.qr(gradient, mode="r")
    # Forbes' sign: positive at the centre, so the leading coefficients alternate; those of Jacobi are positive.
    triangle *= (np.sign(np.diag(triangle)) * (-1.0) ** k)[:, None]
    return np.asarray(np.linalg.solve(triangle, a))


def _qcon_to_legendre(a: Floats) -> Floats:
    r"""Legendre coefficients in :math:`2 u^2 - 1` of :math:`u^4 \sum a_n Q^{con}_n`, by Gauss's exact quadrature."""
    from scipy.special import eval_jacobi  # noqa: PLC0415

    degree = len(a) + 1
    t, weight = legendre.leggauss(degree + 1)
    value = ((t + 1) / 2) ** 2 * (eval_jacobi(np.arange(len(a)), 0, 4, t[:, None]) @ a)
    return np.asarray((np.arange(degree + 1) + 0.5) * (legendre.legvander(t, degree).T @ (weight * value)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Forbes(OnConic):
    r"""A conic with a departure in Forbes' polynomials, u = r / norm_radius.

    .. math::

        z = \frac{c r^2}{1 + \sqrt{1 - (1 + k) c^2 r^2}} + D, \qquad
        \sigma = \frac{\sqrt{1 - (1 + k) c^2 r^2}}{\sqrt{1 - k c^2 r^2}}

    - ``"qbfs"``: :math:`D = u^2 (1 - u^2) \sum a_n Q^{bfs}_n(u^2) / \sigma`, where the numerator is the departure along
      the normal of the conic (a sphere for k = 0);
    - ``"qcon"``: :math:`D = u^4 \sum a_n Q^{con}_n(u^2)`, along z;
    - ``"q2d"``: :math:`D = [u^2 (1 - u^2) \sum a_n^0 Q_n^0(u^2) + \sum_{m > 0} u^m \sum_n (a_n^m \cos m\theta +
      b_n^m \sin m\theta) Q_n^m(u^2)] / \sigma`.

    The surface is also used beyond the normalisation radius, as far as its conic is defined, as the tool touches it
    outside the aperture.

    Parameters
    ----------
    radius
        Vertex radius 1/c of the conic: positive concave, negative convex, inf ("flat" in a file) a plane. [mm]
    conic
        Conic constant k.
    norm_radius
        Normalisation radius. [mm]
    kind
        "qbfs", "qcon" or "q2d".
    terms
        Coefficients by n, and for "q2d" by (n, m) with m negative for the sine. [mm]

    Raises
    ------
    InputError
        If an index does not fit the kind, a coefficient is not finite, a radius is 0, or the normalisation radius is
        not positive or beyond the conic.

    Sources
    -------
    [Forbes2007]_ (Q-bfs, Q-con), [Forbes2012]_ (Q-2D); the factor for a departure from a conic is the secant of the
    conic's slope, which [Forbes2007]_ gives for the sphere. Oracle: the published lists, prysm, mpmath.

    Examples
    --------
    >>> dish = Forbes(radius=100.0, conic=0.0, norm_radius=10.0, kind="qbfs", terms={0: 1e-3, 2: -2e-4})
    >>> flat = Forbes(radius=float("inf"), conic=0.0, norm_radius=10.0, kind="qcon", terms={0: 1e-3})
    >>> round(float(flat.sag(5.0, 0.0)), 9)    # u^4
    6.25e-05
    """

    family = "forbes"
    example = MappingProxyType(
        {
            "radius": "50 mm",
            "conic": 0.0,
            "norm_radius": "5 mm",
            "kind": "qbfs",
            "units": "mm",
            "terms": {"0": 1e-4, "1": 2e-5},
        }
    )
    series = MappingProxyType(
        {"terms": Series(power=lambda _: 1, key=lambda key: indices_of(key) if "," in key else index_of(key))}
    )
    radius: Radius
    conic: Number
    norm_radius: Size
    kind: ForbesKind
    terms: Terms[int] | Terms[tuple[int, int]]
    _sum: DiscSum = field(init=False, repr=False, compare=False)
    _degree: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self, inf=("radius",))
        check_radius(self.radius, "the radius of a Forbes surface")
        positive(self.norm_radius, "the norm_radius of a Forbes surface", "mm")
        if self.kind not in {"qbfs", "qcon", "q2d"}:
            raise InputError(f"the kind of a Forbes surface is {self.kind!r}, known are qbfs, qcon and q2d: choose one")
        if self.norm_radius >= self.reach:
            raise InputError(
                f"the norm_radius of a Forbes surface is {self.norm_radius:g} mm, its conic ends at {self.reach:.6g} "
                "mm: use a smaller one or correct the radius"
            )
        pairs = read_terms(self.terms, "a Forbes surface", _double if self.kind == "q2d" else _single)
        terms = pairs if self.kind == "q2d" else tuple((n, value) for (n, _), value in pairs)
        object.__setattr__(self, "terms", terms)
        series: dict[int, Floats] = {}
        for m in {m for (_, m), _ in pairs}:
            row = np.zeros(1 + max(n for (n, order), _ in pairs if order == m))
            for (n, order), value in pairs:
                if order == m:
                    row[n] = value
            series[m] = _qcon_to_legendre(row) if self.kind == "qcon" else _q_to_jacobi(abs(m), row)
            if m == 0 and self.kind != "qcon":
                # u^2 (1 - u^2) = (P_0 - P_2) / 6 in Legendre polynomials of 2 u^2 - 1.
                series[m] = np.asarray(legendre.legmul(series[m], [1 / 6, 0, -1 / 6]))
        object.__setattr__(self, "_sum", disc_sum(series))
        object.__setattr__(self, "_degree", max((2 * len(c) - 2 + abs(m) for m, c in series.items()), default=0))

    @property
    def feature_size(self) -> float:
        """The normalisation radius over the degree, or the length of the conic if that is smaller. [mm]."""
        return min(self.conic_length, self.norm_radius / max(self._degree, 1))

    @property
    def of_revolution(self) -> bool:
        """Whether the surface is known to be one of revolution about the axis."""
        return self.kind != "q2d"

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives, see `Surface.evaluate`."""
        departure: list[tuple[Any, ...]] = [(polynomials.disc, 1 / self.norm_radius, *self._sum)]
        if self.kind != "qcon":
            departure.append((quadrics.secant, *self.base))
        return summed(x, y, order, *departure, (quadrics.conic, self.base))
