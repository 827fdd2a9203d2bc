"""Polynomials against exact rational arithmetic; the infrared lens of [Troutman2016] from its own integral."""

from fractions import Fraction
from math import perm

import numpy as np
import pytest
import sympy as sp

from surface_oracle import X, Y, computed, disc, error
from turnwright.surface import RadialPolynomial, XYPolynomial

RADIAL = (-3.62e-03, 8.50e-08, -4.00e-12, 2.88e-16, -1.61e-18, 2.31e-20, -1.31e-22)
SLOPE = (-1.01e-03, 9.45e-08, -1.78e-11, 4.39e-15, -7.61e-18, 9.49e-20, -5.34e-22)


def worst(surface, terms, x, y):
    """Return the error of `surface_oracle.error` against exact rational arithmetic, which is faster here. (3,)."""
    fractions = [(i, j, Fraction(a)) for (i, j), a in terms.items()]
    truth = np.empty((6, x.size))
    for row, (p, q) in enumerate([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]):
        kept = [(i - p, j - q, a * perm(i, p) * perm(j, q)) for i, j, a in fractions if i >= p and j >= q]
        for n, (u, v) in enumerate(zip(map(Fraction, x), map(Fraction, y), strict=True)):
            truth[row, n] = float(sum(a * u**i * v**j for i, j, a in kept))
    found = computed(surface, x, y)
    groups = (slice(0, 1), slice(1, 3), slice(3, 6))
    return np.array([np.abs(found[g] - truth[g]).max() / max(np.abs(truth[g]).max(), 1e-300) for g in groups])


def lens_formula(radial, slope, tilt):
    s = X**2 + Y**2
    inner = sum((sp.Rational(b) * sp.expand(s**k) for k, b in enumerate(slope, start=1)), sp.Integer(0))
    t = sp.Symbol("t")
    leaning = sp.integrate((inner + sp.Rational(tilt)).subs(X, t), (t, 0, X))
    return sum((sp.Rational(a) / 2 * s**k for k, a in enumerate(radial, start=1)), sp.Integer(0)) + leaning


@pytest.mark.parametrize("degree", [1, 2, 5, 15, 24])
def test_full_polynomial(degree):
    rng = np.random.default_rng(degree)
    terms = {(i, j): float(rng.normal()) for i in range(degree + 1) for j in range(degree + 1 - i)}
    x, y = disc(1.2, count=12)
    assert (worst(XYPolynomial(terms=terms), terms, x, y) < 5e-15).all()


@pytest.mark.parametrize(
    "terms", [{}, {(0, 0): 2.0}, {(7, 0): 1.0}, {(0, 7): 1.0}, {(3, 4): -1.0, (0, 1): 0.5}, {(4, 1): 1.0, (1, 6): 2.0}]
)
def test_sparse_polynomial(terms):
    x, y = disc(1.2, count=12)
    assert (worst(XYPolynomial(terms=terms), terms, x, y) < 2e-15).all()


def test_the_lens():
    x, y = disc(8.0, count=60)
    lens = RadialPolynomial(radial=RADIAL, slope=SLOPE, tilt=0.0262)
    assert (error(lens, lens_formula(RADIAL, SLOPE, 0.0262), x, y) < [2e-15, 2e-15, 2e-15]).all()


@pytest.mark.parametrize(
    ("radial", "slope", "tilt"),
    [((), (), 0.0), ((1e-2,), (), 0.1), ((), (1e-3, -2e-5), 0.0), ((0.0, 1e-5), (1e-3,), -1.0)],
)
def test_parts_of_a_lens(radial, slope, tilt):
    x, y = disc(3.0)
    lens = RadialPolynomial(radial=radial, slope=slope, tilt=tilt)
    assert (error(lens, lens_formula(radial, slope, tilt), x, y) < 2e-15).all()


def test_the_lens_multiplied_out_is_the_same_polynomial():
    x, y = disc(8.0, count=500)
    terms = sp.Poly(sp.expand(lens_formula(RADIAL, SLOPE, 0.0262)), X, Y).terms()
    expanded = XYPolynomial(terms={powers: float(value) for powers, value in terms})
    lens = RadialPolynomial(radial=RADIAL, slope=SLOPE, tilt=0.0262)
    assert np.abs(expanded.sag(x, y) - lens.sag(x, y)).max() < 1e-15


def test_feature_size_comes_from_the_sizes_of_the_terms():
    # f = x^2/2 + x^3/6: f''/f''' = (1 + x) / 1 is least at the origin side of the first crossing, q2/q3 at x = 1: 2.
    assert XYPolynomial(terms={(2, 0): 1 / 2, (3, 0): 1 / 6}).feature_size == pytest.approx(2.0)
    assert XYPolynomial(terms={(2, 0): 1 / 2, (1, 0): 5.0}).feature_size == np.inf
    lens = RadialPolynomial(radial=RADIAL, slope=SLOPE, tilt=0.0262)
    larger = RadialPolynomial(
        radial=[a / 10 ** (2 * k - 1) for k, a in enumerate(RADIAL, start=1)],
        slope=[b / 100**k for k, b in enumerate(SLOPE, start=1)],
        tilt=0.0262,
    )
    assert larger.feature_size == pytest.approx(10 * lens.feature_size)
