"""Zernike polynomials against their power series at 80 digits, published tables and prysm."""

from math import factorial, sqrt

import mpmath
import numpy as np
import pytest
from prysm.polynomials import ansi_j_to_nm, fringe_to_nm, noll_to_nm, zernike_nm

from surface_oracle import computed, disc
from turnwright.surface import Zernike
from turnwright.surface.zernike import zernike_order

# [Noll1976] Table I, and the first 36 of the fringe set with Z37 = (12, 0), by (n, m), m negative for a sine.
NOLL = [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0), (4, 2), (4, -2)]
FRINGE_COSINES = [
    *[(0, 0), (1, 1), (2, 0), (2, 2), (3, 1), (4, 0), (3, 3), (4, 2), (5, 1), (6, 0), (4, 4), (5, 3), (6, 2), (7, 1)],
    *[(8, 0), (5, 5), (6, 4), (7, 3), (8, 2), (9, 1), (10, 0), (12, 0)],
]
FRINGE = [pair for n, m in FRINGE_COSINES for pair in ([(n, m), (n, -m)] if m else [(n, m)])]  # each sine follows


def power_series(n, m):
    """Return the polynomial as a function of mpmath numbers (x, y), from the factorials of its definition."""
    half, order = (n - abs(m)) // 2, abs(m)
    f = factorial
    powers = [(-1) ** k * f(n - k) // (f(k) * f((n + order) // 2 - k) * f(half - k)) for k in range(half + 1)]

    def value(x, y):
        turned = mpmath.mpc(x, y) ** order
        return (turned.real if m >= 0 else turned.imag) * mpmath.polyval(powers, x * x + y * y)

    return value


def derivatives(function, x, y):
    """Return the six rows at the points; at 80 digits mpmath's differences hold more than 20."""
    with mpmath.workdps(80):
        rows = [[function(mpmath.mpf(a), mpmath.mpf(b)) for a, b in zip(x, y, strict=True)]]
        rows += [
            [mpmath.diff(function, (float(a), float(b)), by) for a, b in zip(x, y, strict=True)]
            for by in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        ]
        return np.array([[float(mpmath.re(v)) for v in row] for row in rows])


def ansi_index(n, m):
    return (n * (n + 2) + m) // 2


@pytest.mark.parametrize(
    ("n", "m"),
    [
        (0, 0),
        (1, -1),
        (2, 0),
        (4, 2),
        (8, 0),
        (9, -7),
        (20, 0),
        (20, -12),
        (39, 1),
        (40, 0),
        (40, 2),
        (40, -20),
        (40, 40),
    ],
)
def test_power_series(n, m):
    x, y = disc(1.0, count=14, seed=n)
    x[-1], y[-1] = 0.6, 0.8  # the edge, where the derivatives are largest
    truth = derivatives(power_series(n, m), x, y)
    found = computed(Zernike(terms={ansi_index(n, m): 1.0}, radius=1.0, indexing="ansi", normalised=False), x, y)
    assert np.abs(found[0] - truth[0]).max() < 5e-14
    assert np.abs(found[1:3] - truth[1:3]).max() <= 5e-14 * np.abs(truth[1:3]).max()
    assert np.abs(found[3:] - truth[3:]).max() <= 5e-14 * np.abs(truth[3:]).max()


def test_beyond_the_aperture():
    x, y = np.array([1.05, 0.8]), np.array([0.1, -0.8])
    truth = derivatives(power_series(12, 4), x, y)
    found = computed(Zernike(terms={ansi_index(12, 4): 1.0}, radius=1.0, indexing="ansi", normalised=False), x, y)
    assert found == pytest.approx(truth, rel=1e-12)


def test_many_terms_and_a_radius():
    rng = np.random.default_rng(2)
    terms = {j: float(rng.normal()) * 1e-3 for j in range(1, 61) if j != 49}
    x, y = disc(15.4, count=300)
    r, t = np.hypot(x, y) / 15.4, np.arctan2(y, x)
    orders = {j: (12, 0) if j == 37 else fringe_to_nm(j) for j in terms}
    truth = sum(c * zernike_nm(*(int(v) for v in orders[j]), r, t, norm=False) for j, c in terms.items())
    found = Zernike(terms=terms, radius=15.4, indexing="fringe").sag(x, y)
    assert np.abs(found - truth).max() < 1e-15


@pytest.mark.parametrize("indexing", ["noll", "ansi"])
def test_normalised_terms_are_those_of_prysm(indexing):
    to_nm = {"noll": noll_to_nm, "ansi": ansi_j_to_nm}[indexing]
    x, y = disc(1.0, count=50)
    for j in (1, 2, 5, 11, 20, 36):
        n, m = (int(v) for v in to_nm(j))
        truth = zernike_nm(n, m, np.hypot(x, y), np.arctan2(y, x), norm=True)
        assert Zernike(terms={j: 1.0}, radius=1.0, indexing=indexing).sag(x, y) == pytest.approx(truth, abs=1e-13)
        plain = Zernike(terms={j: 1.0}, radius=1.0, indexing=indexing, normalised=False).sag(x, y)
        assert plain * sqrt((n + 1) * (2 if m else 1)) == pytest.approx(truth, abs=1e-13)


def test_a_normalised_coefficient_is_a_root_mean_square():
    # Exact quadrature on the disc: Gauss in r^2, equidistant in angle. Terms: noll 12 and 22 of 3 and 4 nm.
    s, weight = np.polynomial.legendre.leggauss(12)
    r, angle = np.sqrt((s + 1) / 2)[:, None], np.arange(24) * 2 * np.pi / 24
    surface = Zernike(terms={12: 3e-6, 22: 4e-6}, radius=1.0, indexing="noll")
    mean = (weight / 2) @ (surface.sag(r * np.cos(angle), r * np.sin(angle)) ** 2).mean(axis=1)
    assert sqrt(mean) == pytest.approx(5e-6, rel=1e-13)


def test_published_orders():
    assert [zernike_order(j, "noll") for j in range(1, len(NOLL) + 1)] == NOLL
    assert [zernike_order(j, "fringe") for j in range(1, len(FRINGE) + 1)] == FRINGE


def test_orders_of_prysm():
    for indexing, theirs in (("noll", noll_to_nm), ("ansi", ansi_j_to_nm), ("fringe", fringe_to_nm)):
        for j in range(1, 300):
            if (indexing, j) != ("fringe", 37):  # (6, 6) there, against the standard set of 37
                assert zernike_order(j, indexing) == tuple(int(v) for v in theirs(j)), (indexing, j)
