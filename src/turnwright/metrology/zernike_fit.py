"""Zernike coefficients of a map with missing points, over a given or a fitted aperture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright._kernels import least_squares
from turnwright._validate import finite_tuple, positive
from turnwright.errors import InputError
from turnwright.metrology.grid import valid_points
from turnwright.metrology.least_squares import Cloud, Sums, solve, sums_over
from turnwright.surface import FIRST, Indexing, Surface, Zernike, disc_sum, zernike_order

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

NM = 1e6
MAX_STEPS = 10
MAX_TERMS = 1000

CONVERGENCE_TOL = 1e-13
"""Change of the coefficients, relative to the largest, that is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZernikeFit:
    """Zernike coefficients of a map. See `fit_zernike`.

    Parameters
    ----------
    indices
        The terms fitted. (k,)
    coefficients, uncertainty
        Of each term, and its standard uncertainty. (k,) [mm]
    covariance
        Of the coefficients. (k, k) [mm²]
    orthonormal, orthonormal_uncertainty
        Coefficients of the same terms made orthonormal over the valid points in their order: each is independent of the
        terms after it, and its square is its contribution to the mean square. (k,) [mm]
    indexing, normalised
        See `turnwright.Zernike`.
    radius, centre
        Of the aperture. [mm]
    noise_gain
        Standard uncertainty of each coefficient for independent noise of 1 of each height. (k,)
    residual
        Residual of the fit; nan outside the aperture.
    condition
        Condition number of the terms over the valid points, scaled to unit length: 1 for orthogonal terms.
    valid, left_out
        Number of heights inside the aperture, and of valid ones outside.
    """

    indices: tuple[int, ...]
    coefficients: Floats
    uncertainty: Floats
    covariance: Floats
    noise_gain: Floats
    orthonormal: Floats
    orthonormal_uncertainty: Floats
    indexing: Indexing
    normalised: bool
    radius: float
    centre: tuple[float, float]
    residual: HeightMap
    rms_nm: float
    condition: float
    valid: int
    left_out: int

    @property
    def terms(self) -> dict[int, float]:
        """The coefficients by index. [mm]."""
        return dict(zip(self.indices, self.coefficients.tolist(), strict=True))

    @property
    def surface(self) -> Surface:
        """The fitted surface; around the centre of the aperture, where that is not the origin."""
        zernike = Zernike(terms=self.terms, radius=self.radius, indexing=self.indexing, normalised=self.normalised)
        return zernike if self.centre == (0.0, 0.0) else zernike.placed(shift=(*self.centre, 0.0))


def fit_zernike(
    heights: HeightMap,
    *,
    terms: int | Sequence[int],
    indexing: Indexing,
    normalised: bool | None = None,
    radius: float | None = None,
    centre: tuple[float, float] | None = None,
) -> ZernikeFit:
    """Fit Zernike polynomials by least squares in z over the valid points inside an aperture.

    Missing points are left out. Points are weighted by area; scattered points equally. The uncertainties assume
    independent residuals; where waviness prevails they are too small.

    Parameters
    ----------
    heights
        On any grid, or scattered.
    terms
        Indices, or how many from the first on. The set of 37 of `zernike_order` is ``terms=37, indexing="fringe"``.
    indexing, normalised
        See `turnwright.Zernike`.
    radius
        Of the aperture. By default that of the smallest circle around all valid points, or around ``centre``. [mm]
    centre
        Of the aperture (x, y). By default that of the smallest circle; on a polar map (0, 0). [mm]

    Raises
    ------
    InputError
        If a term is unknown, there are fewer valid heights than terms, or these do not determine the terms.

    Sources
    -------
    [Mahajan2007]_ for polynomials orthonormal over any aperture. Oracles: SymPy, mpmath, NumPy's least squares.

    >>> from turnwright.heightmap import HeightMap
    >>> x = np.linspace(-1, 1, 101)
    >>> bowl = HeightMap(x=x, y=x, z=1e-3 * (x**2 + x[:, None] ** 2))
    >>> fit = fit_zernike(bowl, terms=9, indexing="fringe", radius=1.0, centre=(0.0, 0.0))
    >>> round(fit.terms[1], 12), round(fit.terms[4], 12)   # r² is half of 1 and of 2 r² - 1
    (0.0005, 0.0005)
    """
    first = FIRST.get(indexing, 0)
    if isinstance(terms, int) and terms > MAX_TERMS:
        raise InputError(f"{terms} Zernike terms are requested, the limit is {MAX_TERMS}: reduce their number")
    indices = tuple(range(first, first + terms)) if isinstance(terms, int) else tuple(terms)
    if not indices:
        raise InputError("0 Zernike terms are requested, at least 1 is needed: give indices or a number")
    # Refuses what it cannot hold: unknown terms, and those named twice.
    Zernike(terms=dict.fromkeys(indices, 1.0), radius=1.0, indexing=indexing)
    if len(set(indices)) < len(indices):
        raise InputError(
            f"of the {len(indices)} Zernike terms some are given twice, only once is allowed: correct them"
        )
    normal_terms = indexing != "fringe" if normalised is None else normalised
    valid = valid_points(heights, len(indices), f"a fit of {len(indices)} Zernike terms")
    cloud = Cloud.of(heights, valid)
    radius, centre = _aperture(cloud, radius, centre)
    x, y = heights.points()
    used = valid & (np.hypot(x - centre[0], y - centre[1]) <= radius * (1 + 1e-12))
    inside = int(np.count_nonzero(used))
    if inside < len(indices):
        raise InputError(
            f"the aperture of {radius:g} mm around ({centre[0]:g}, {centre[1]:g}) mm has {inside} valid heights, "
            f"{len(indices)} Zernike terms need at least that number: enlarge the aperture"
        )
    cloud = replace(cloud, used=used)
    residual = np.full(heights.z.shape, np.nan)
    solution, sums, condition = _fit(cloud, indices, indexing, (*centre, radius), residual)
    orders = [zernike_order(index, indexing) for index in indices]
    # The fit is of polynomials of rms 1; those of value 1 at the edge are smaller by the factor.
    factor = np.ones(len(orders)) if normal_terms else np.array([_factor(n, m) for n, m in orders])
    covariance = sums.covariance()
    lower = np.linalg.cholesky(sums.normal / sums.weight)
    return ZernikeFit(
        indices=indices,
        coefficients=frozen(solution * factor, "coefficients"),
        uncertainty=frozen(np.sqrt(np.diag(covariance)) * factor, "uncertainty", finite=False),
        noise_gain=frozen(np.sqrt(np.diag(sums.noise_gain())) * factor, "noise gain"),
        covariance=frozen(covariance * factor * factor[:, None], "covariance", ndim=2, finite=False),
        orthonormal=frozen(lower.T @ solution, "coefficients"),
        orthonormal_uncertainty=frozen(np.sqrt(np.diag(lower.T @ covariance @ lower)), "uncertainty", finite=False),
        indexing=indexing,
        normalised=normal_terms,
        radius=radius,
        centre=centre,
        residual=replace(heights, z=residual, name=f"{heights.name} beyond {len(indices)} Zernike terms".strip()),
        rms_nm=sums.rms * NM,
        condition=condition,
        valid=inside,
        left_out=int(np.count_nonzero(valid)) - inside,
    )


def _factor(n: int, m: int) -> float:
    """Value at the edge of a term of rms 1 over the disc."""
    return float(np.sqrt((n + 1) * (2 if m else 1)))


def _fit(
    cloud: Cloud, indices: tuple[int, ...], indexing: Indexing, circle: tuple[float, float, float], left: Floats
) -> tuple[Floats, Sums, float]:
    """Return the coefficients of terms of rms 1, their sums, and the condition; fill ``left`` with the residual."""
    x0, y0, radius = circle
    orders = [zernike_order(index, indexing) for index in indices]
    count = 1 + max((n - abs(m)) // 2 for n, m in orders)
    place = np.full((2, 1 + max(abs(m) for _, m in orders), count), -1)
    for row, (n, m) in enumerate(orders):
        place[int(m < 0), abs(m), (n - abs(m)) // 2] = row
    recurrence = disc_sum({m: np.ones(count) for m in range(place.shape[1])}).recurrence
    factor = np.array([_factor(n, m) for n, m in orders])
    padded = len(orders) + -len(orders) % 4  # as the sums take them, without a copy

    def model(x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        terms = np.empty((padded, x.size))
        terms[len(orders) :] = 0.0
        least_squares.zernike_terms(x - x0, y - y0, 1 / radius, recurrence, place, factor, terms)
        return terms, z

    names = [f"{indexing} {index}" for index in indices]
    sums = sums_over(cloud, model, np.zeros(len(orders)))
    solution, condition = solve(sums.normal, sums.right, names, "a Zernike fit")
    normal = sums
    for _ in range(MAX_STEPS):
        # The normal equations lose digits, which further iterations restore.
        sums = sums_over(cloud, model, solution, whole=False, left=left)
        step, _ = solve(normal.normal, sums.right, names, "a Zernike fit")
        solution = solution + step
        if np.abs(step).max() <= CONVERGENCE_TOL * np.abs(solution).max():
            break
    return solution, replace(sums, normal=normal.normal, spread=normal.spread), condition


def _aperture(
    cloud: Cloud, radius: float | None, centre: tuple[float, float] | None
) -> tuple[float, tuple[float, float]]:
    """Return the radius and the centre of the aperture, found where they are not stated."""
    if centre is None and cloud.heights.polar:
        centre = (0.0, 0.0)
    if centre is None:
        circle_radius, centre = _smallest_circle(*cloud.ends)
    else:
        at = finite_tuple(centre, "the centre of the aperture", 2)
        centre = at[0], at[1]
        x, y = cloud.ends
        circle_radius = float(np.hypot(x - centre[0], y - centre[1]).max())
    return positive(circle_radius if radius is None else radius, "the radius of the aperture", "mm"), centre


def _smallest_circle(x: Floats, y: Floats) -> tuple[float, tuple[float, float]]:
    """Return the radius and the centre of the smallest circle around points.

    The farthest point outside joins the two or three that hold the circle so far, until none is outside.
    """
    points = x + 1j * y
    held = points[:1]
    while True:
        radius, centre = _circle_around(held)
        away = np.abs(points - centre)
        far = int(away.argmax())
        if away[far] <= radius * (1 + 1e-12) or points[far] in held:
            return max(radius, float(away[far])), (float(centre.real), float(centre.imag))
        held = np.append(held, points[far])
        radius, centre = _circle_around(held)
        held = held[np.abs(np.abs(held - centre) - radius) <= 1e-9 * radius]


def _circle_around(points: np.ndarray[tuple[int], np.dtype[np.complex128]]) -> tuple[float, complex]:
    """Return the smallest circle around at most a handful of points: one through two or three of them."""
    best = (np.inf, 0j) if points.size > 1 else (0.0, complex(points[0]))
    for group in (*combinations(points, 2), *combinations(points, 3)):
        a, b = group[0], group[1]
        centre = (a + b) / 2
        if len(group) == 3:
            u, v = b - a, group[2] - a
            area = 2 * (u.real * v.imag - u.imag * v.real)
            if area == 0:
                continue
            centre = a - 1j * (v * abs(u) ** 2 - u * abs(v) ** 2) / area
        radius = abs(a - centre)
        if radius < best[0] and np.abs(points - centre).max() <= radius * (1 + 1e-9):
            best = float(radius), complex(centre)
    return best
