"""Forbes' polynomials against his published lists, prysm, their definition, and the formula at 100 digits."""

from math import sqrt
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.special
import sympy as sp
from prysm.polynomials import qpoly

from cases import every_second
from surface_oracle import X, Y, disc, error, even_conic
from turnwright.surface import Forbes

U2 = X**2 + Y**2
# [Forbes2007]: Q-bfs and Q-con of u^2.
QBFS = [
    lambda x: 1 + 0 * x,
    lambda x: (13 - 16 * x) / sp.sqrt(19),
    lambda x: sp.sqrt(sp.Rational(2, 95)) * (29 - 4 * x * (25 - 19 * x)),
    lambda x: sp.sqrt(sp.Rational(2, 2545)) * (207 - 4 * x * (315 - x * (577 - 320 * x))),
    lambda x: (7737 - 16 * x * (4653 - 2 * x * (7381 - 8 * x * (1168 - 509 * x)))) / (3 * sp.sqrt(131831)),
    lambda x: (
        (66657 - 32 * x * (28338 - x * (135325 - 8 * x * (35884 - x * (34661 - 12432 * x))))) / (3 * sp.sqrt(6632213))
    ),
]
QCON = [
    lambda x: 1 + 0 * x,
    lambda x: -(5 - 6 * x),
    lambda x: 15 - 14 * x * (3 - 2 * x),
    lambda x: -(35 - 12 * x * (14 - x * (21 - 10 * x))),
    lambda x: 70 - 3 * x * (168 - 5 * x * (84 - 11 * x * (8 - 3 * x))),
    lambda x: -(126 - x * (1260 - 11 * x * (420 - x * (720 - 13 * x * (45 - 14 * x))))),
]


def flat(kind, terms):
    return Forbes(radius=np.inf, conic=0.0, norm_radius=1.0, kind=kind, terms=terms)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, pytest.param(5, marks=pytest.mark.proof)])
def test_published_lists(n):
    x, y = disc(1.1, count=16)
    assert (error(flat("qbfs", {n: 1.0}), U2 * (1 - U2) * QBFS[n](U2), x, y) < 2e-14).all()
    assert (error(flat("qcon", {n: 1.0}), U2**2 * QCON[n](U2), x, y) < 2e-14).all()
    assert (error(flat("q2d", {(n, 0): 1.0}), U2 * (1 - U2) * QBFS[n](U2), x, y) < 2e-14).all()


@pytest.fixture
def prysm(monkeypatch):
    """Return prysm's functions with (-1)!! = 1, as they mean it; SciPy has begun to say 0."""
    twice = SimpleNamespace(
        factorial=scipy.special.factorial, factorial2=lambda k: 1.0 if k == -1 else scipy.special.factorial2(k)
    )
    monkeypatch.setattr(qpoly, "special", twice)
    caches = (qpoly.F_q2d, qpoly.G_q2d, qpoly.f_q2d, qpoly.g_q2d)
    for cache in caches:
        cache.cache_clear()
    yield qpoly
    for cache in caches:
        cache.cache_clear()


@pytest.mark.parametrize("m", [0, 1, -1, 2, -3, 7, 20])
@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 12, 25])
def test_q2d_of_prysm(prysm, n, m):
    x, y = disc(1.0, count=100)
    truth = prysm.Q2d(n, m, np.hypot(x, y), np.arctan2(y, x))
    assert np.abs(flat("q2d", {(n, m): 1.0}).sag(x, y) - truth).max() < 5e-15


@pytest.mark.parametrize("n", [8, 20, 40])
def test_high_orders_of_prysm(prysm, n):
    x, y = disc(1.0, count=100)
    r = np.hypot(x, y)
    assert np.abs(flat("qbfs", {n: 1.0}).sag(x, y) - prysm.Qbfs(n, r)).max() < 5e-15
    assert np.abs(flat("qcon", {n: 1.0}).sag(x, y) - r**4 * prysm.jacobi(n, 0, 4, 2 * r**2 - 1)).max() < 2e-13


def test_the_mean_square_slope_is_the_sum_of_the_squares():
    # The definition: weight 1 / (u sqrt(1 - u^2)) on the disc, which is even in t for u = sin t.
    terms = {(0, 0): 2.0, (3, 0): 1.0, (0, 1): -2.0, (2, -1): 4.0, (5, 3): 1.0, (5, -3): 3.0, (1, 3): -1.0}
    t, angle = (np.arange(64) + 0.5)[:, None] * np.pi / 128, np.arange(16) * 2 * np.pi / 16
    zx, zy = flat("q2d", terms).gradient(np.sin(t) * np.cos(angle), np.sin(t) * np.sin(angle))
    assert (zx**2 + zy**2).mean() == pytest.approx(sum(a * a for a in terms.values()), rel=1e-13)


@pytest.mark.parametrize(
    ("kind", "conic"), every_second(["qbfs", "qcon", "q2d"], [(61.5, -1.5), (-40.0, 0.0), (50.0, 0.8)])
)
def test_departure_from_a_conic(kind, conic):
    radius, conic = conic
    c, k, norm = 1 / sp.Rational(radius), sp.Rational(conic), sp.Rational(15.5)
    u2, r2 = U2 / norm**2, U2
    secant = sp.sqrt(1 - k * c**2 * r2) / sp.sqrt(1 - (1 + k) * c**2 * r2)
    a, b = 2e-2, -1.3e-2
    first, second = sp.Rational(a), sp.Rational(b)
    if kind == "qcon":
        terms = {0: a, 2: b}
        departure = u2**2 * (first * QCON[0](u2) + second * QCON[2](u2))
    elif kind == "qbfs":
        terms = {1: a, 3: b}
        departure = secant * u2 * (1 - u2) * (first * QBFS[1](u2) + second * QBFS[3](u2))
    else:
        # Q_0^2 = 1/sqrt(2 <slope^2>) of u^2 cos(2 theta): the mean of (2u)^2 is 2, so Q_0^2 = 1/sqrt(2).
        terms = {(2, 0): a, (0, -2): b}
        departure = secant * (u2 * (1 - u2) * first * QBFS[2](u2) + second * 2 * X * Y / norm**2 / sp.sqrt(2))
    surface = Forbes(radius=radius, conic=conic, norm_radius=15.5, kind=kind, terms=terms)
    x, y = disc(17.0, count=16)
    assert (error(surface, even_conic(radius, conic) + departure, x, y) < [1e-14, 2e-14, 5e-14]).all()


def test_the_departure_is_measured_along_the_normal():
    # Small departures: moving along the unit normal of the conic by D moves z by D times the secant of its slope.
    base = Forbes(radius=30.0, conic=0.4, norm_radius=15.0, kind="qbfs", terms={})
    bent = Forbes(radius=30.0, conic=0.4, norm_radius=15.0, kind="qbfs", terms={0: 1e-3})
    x = np.linspace(1, 14, 7)
    slope = base.gradient(x, 0)[0]
    u2 = (x / 15) ** 2
    expected = 1e-3 * u2 * (1 - u2) * np.sqrt(1 + slope**2)
    assert bent.sag(x, 0) - base.sag(x, 0) == pytest.approx(expected, rel=1e-11)


def test_q_con_first_value_at_the_edge():
    assert float(flat("qcon", {3: 1.0}).sag(1.0, 0.0)) == pytest.approx(1.0, rel=1e-14)
    assert float(flat("q2d", {(0, 1): 1.0}).sag(0.6, 0.8)) == pytest.approx(0.6, rel=1e-14)
    assert float(flat("q2d", {(0, -2): sqrt(2)}).sag(0.6, 0.8)) == pytest.approx(0.96, rel=1e-14)
