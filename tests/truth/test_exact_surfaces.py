"""Surface parameters of Fourier and polynomial surfaces that are known exactly, at 1000 points a side.

Oracles: algebra of Fourier series, closed integrals, Newton's method, SymPy, Gauss-Legendre quadrature. The tolerances
are the figures of the page on roughness.
"""

import functools

import numpy as np
import pytest
import sympy
from numpy.polynomial.legendre import leggauss
from scipy import integrate, optimize

from fourier_surface import Fourier
from turnwright.heightmap import HeightMap
from turnwright.metrology import bearing, features, profile_roughness, roughness
from turnwright.profile import Profile

N = 1000
MIDDLES, CORNERS = (np.arange(N) + 0.5) / N, np.arange(N + 1) / N
NM = 1e6
ISOTROPIC = Fourier(
    [
        ((5, 0), 1.0e-4, 0.05),
        ((1, 6), 0.8e-4, 0.17),
        ((4, 4), 0.7e-4, 0.32),
        ((3, -4), 0.9e-4, 0.11),
        ((4, 2), 0.5e-4, 0.46),
        ((-3, 7), 0.6e-4, 0.03),
    ]
)
ABSCISSAS, WEIGHTS = leggauss(60)
NODES, WEIGHTS = (ABSCISSAS + 1) / 2, WEIGHTS / 2
"""Gauss-Legendre quadrature over [0, 1]."""


def sampled(surface, axis):
    return HeightMap(x=axis, y=axis, z=surface(axis, axis[:, None]))


# --------------------------------------------------------------------- Fourier series
@functools.cache
def isotropic():
    return roughness(sampled(ISOTROPIC, MIDDLES), form="none")


def test_moments_of_a_fourier_surface_are_exact():
    found, sq = isotropic(), np.sqrt(ISOTROPIC.moment(2))
    assert found.sq_nm == pytest.approx(sq * NM, rel=1e-13)
    assert found.ssk == pytest.approx(ISOTROPIC.moment(3) / sq**3, rel=1e-12)
    assert found.sku == pytest.approx(ISOTROPIC.moment(4) / sq**4, rel=1e-13)


def test_lags_of_a_fourier_surface_have_six_figures():
    found = isotropic()
    shortest, longest = ISOTROPIC.decay_range()
    assert found.sal == pytest.approx(shortest, rel=6e-7)
    assert found.str == pytest.approx(shortest / longest, rel=3e-7)
    assert found.notes == ()


def test_extremes_of_a_fourier_surface_lie_within_half_a_step():
    """The highest point is at most half a step off along x and y: (h²/8)(|zxx| + |zyy|) too low, plus |zxy|."""
    z = ISOTROPIC(MIDDLES, MIDDLES[:, None])
    for value, index in ((isotropic().sp_nm, z.argmax()), (-isotropic().sv_nm, z.argmin())):
        row, column = np.unravel_index(index, z.shape)
        at, height = ISOTROPIC.summit(MIDDLES[column], MIDDLES[row])
        bends = [abs(ISOTROPIC(*at, *order)) for order in ((2, 0), (0, 2), (1, 1))]
        bound = (bends[0] + bends[1] + 2 * bends[2]) / 8 / N**2 * NM
        assert 0 <= np.sign(height) * (height * NM - value) <= bound
        assert value == pytest.approx(height * NM, rel=2e-4)


def test_gradient_and_area_lose_what_a_difference_loses():
    """A difference over a step h sees the slope of a wave times sinc(h p): 1 - (π h p)²/6."""
    # Waves that differ in |p| and |q|, so that the half pixels at the border change no average.
    waves = ((2, 1), (1, -3), (4, 2), (0, 5), (3, -4))
    steep = Fourier([(wave, 0.03 / (k + 2), 0.23 * k) for k, wave in enumerate(waves)])
    found = roughness(sampled(steep, CORNERS), form="none")
    squares = [(size * 2 * np.pi) ** 2 / 2 * np.square(wave) for wave, size, _ in steep.terms]
    seen = [
        square * np.sinc(np.array(wave) / N) ** 2 for square, (wave, _, _) in zip(squares, steep.terms, strict=True)
    ]
    assert found.sdq == pytest.approx(np.sqrt(np.sum(seen)), rel=1e-13)
    assert found.sdq == pytest.approx(np.sqrt(np.sum(squares)), rel=6e-5)
    # The trapezoidal rule of a periodic analytic function converges exponentially.
    x, y = np.meshgrid(np.arange(400) / 400, np.arange(400) / 400)
    area = 100 * np.mean(np.sqrt(1 + steep(x, y, 1, 0) ** 2 + steep(x, y, 0, 1) ** 2) - 1)
    assert area > 4
    assert found.sdr == pytest.approx(area, rel=1e-4)


# --------------------------------------------------------------------- one zero for each y
def rising(x, y):
    """Heights that rise along x, so that each row meets each level once; integrals over y are of smooth functions."""
    return 1e-4 * (
        x + 0.25 * np.cos(2 * np.pi * y + 0.3) + 0.05 * np.sin(4 * np.pi * y) + 0.06 * np.sin(4 * np.pi * x + 1)
    )


ROWS = (np.arange(1500) + 0.5) / 1500
RISING_MEAN = rising(MIDDLES[:, None], ROWS).mean()


def crossing(level):
    """Where each row meets a level. (1500,)"""
    low, high = np.zeros(ROWS.size), np.ones(ROWS.size)
    for _ in range(55):
        middle = (low + high) / 2
        below = rising(middle, ROWS) < level
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return middle


def material(level):
    """Share of the area above a level, and per area the volume of material above it and of void below it."""
    edge = crossing(level)[:, None]
    above = (rising(edge + (1 - edge) * NODES, ROWS[:, None]) - level) @ WEIGHTS * (1 - edge[:, 0])
    below = (level - rising(edge * NODES, ROWS[:, None])) @ WEIGHTS * edge[:, 0]
    return 1 - edge.mean(), above.mean(), below.mean()


def test_mean_height_of_a_rising_surface_has_six_figures():
    _, above, below = material(RISING_MEAN)
    assert roughness(sampled(rising, MIDDLES), form="mean").sa_nm == pytest.approx((above + below) * NM, rel=8e-7)


def test_volumes_of_a_rising_surface_have_four_figures():
    """A million pixels count an area to about the square root of the number along its border."""
    found = bearing(sampled(rising, MIDDLES), form="none")

    def at(ratio):
        level = optimize.brentq(lambda one: material(one)[0] - ratio, -5e-5, 2e-4, xtol=1e-13)
        return level, *material(level)[1:]

    (high, vmp, shallow), (low, deep, vvv) = at(0.1), at(0.8)
    assert (found.vmp_nm, found.vvv_nm) == pytest.approx((vmp * NM, vvv * NM), rel=1e-4)
    assert (found.vmc_nm, found.vvc_nm) == pytest.approx(((deep - vmp) * NM, (shallow - vvv) * NM), rel=3e-5)
    assert (found.height_at_nm(0.1), found.height_at_nm(0.8)) == pytest.approx((high * NM, low * NM), rel=5e-5)


# --------------------------------------------------------------------- polynomials
def test_a_polynomial_surface_has_its_integrals():
    """Over [-1, 1]²: the midpoint rule errs by h²/24 times the difference of the slopes at the ends."""
    x, y = sympy.symbols("x y")
    z = sympy.Rational(1, 10) * (x**3 * y - x**2 / 2 + y**2 / 3 + x * y / 4 + 2 * x / 3 - sympy.Rational(1, 5))

    def mean(what):
        return float(sympy.integrate(sympy.expand(what), (x, -1, 1), (y, -1, 1)) / 4)

    sq = np.sqrt(mean(z**2))
    height = sympy.lambdify((x, y), z)
    found = roughness(sampled(height, 2 * MIDDLES - 1), form="none")
    assert found.sq_nm == pytest.approx(sq * NM, rel=2e-6)
    assert found.ssk == pytest.approx(mean(z**3) / sq**3, rel=5e-6)
    assert found.sku == pytest.approx(mean(z**4) / sq**4, rel=5e-6)
    squares = sympy.diff(z, x) ** 2 + sympy.diff(z, y) ** 2
    corners = roughness(sampled(height, 2 * CORNERS - 1), form="none")
    # Differences along x count in every row with its pixel, half of it beyond the corners; those along y likewise.
    assert corners.sdq == pytest.approx(np.sqrt(mean(squares)), rel=1 / N)
    steep = sympy.lambdify((x, y), squares)
    nodes = steep(2 * NODES - 1, 2 * NODES[:, None] - 1)
    area = WEIGHTS @ (nodes / (1 + np.sqrt(1 + nodes))) @ WEIGHTS
    assert corners.sdr == pytest.approx(100 * area, rel=2e-6)


# --------------------------------------------------------------------- bearing curve
def curve(ratio):
    u = 1 - 2 * ratio
    return 1e-4 * (0.5 * u + 0.3 * u**5 + 0.12 * u**4 + 0.05 * u**2 + 0.2 * u**3)


def bearing_of_curve():
    """The parameters of a material curve H(p) by quadrature and root finding."""

    def area(start, end):
        return integrate.quad(curve, start, end, epsabs=1e-22, epsrel=1e-13)[0]

    start = optimize.minimize_scalar(
        lambda p: 1e4 * (curve(p) - curve(p + 0.4)), bounds=(0.2, 0.5), method="bounded", options={"xatol": 1e-12}
    ).x
    at, weight = start + 0.4 * NODES, np.sqrt(WEIGHTS)
    top, slope = np.linalg.lstsq(np.stack([weight, weight * at], axis=1), weight * curve(at))[0]
    first, last = (
        optimize.brentq(lambda p, level=level: 1e4 * (curve(p) - level), *ends, xtol=1e-15)
        for level, ends in ((top, (0, 0.5)), (top + slope, (0.5, 1)))
    )
    above, below = area(0, 0.1) - 0.1 * curve(0.1), 0.2 * curve(0.8) - area(0.8, 1)
    return {
        "vmp_nm": above,
        "vmc_nm": area(0, 0.8) - 0.8 * curve(0.8) - above,
        "vvv_nm": below,
        "vvc_nm": 0.9 * curve(0.1) - area(0.1, 1) - below,
        "sk_nm": -slope,
        "spk_nm": 2 * (area(0, first) - first * top) / first,
        "svk_nm": 2 * ((1 - last) * (top + slope) - area(last, 1)) / (1 - last),
    }, (first, last)


@pytest.mark.parametrize(("points", "volumes", "sk", "reduced"), [(1000, 2e-5, 2e-6, 3e-5), (10_000, 2e-7, 3e-7, 3e-6)])
def test_a_bearing_curve_has_its_integrals(points, volumes, sk, reduced):
    """The volumes err by the square of the spacing; the flattest 40 % are found to 0.01 %."""
    found = bearing(
        HeightMap(x=np.arange(points) / points, y=[0.0], z=curve((np.arange(points) + 0.5) / points)[None]), form="none"
    )
    exact, ratios = bearing_of_curve()
    for name, value in exact.items():
        accuracy = volumes if name[0] == "v" else sk if name == "sk_nm" else reduced
        assert getattr(found, name) == pytest.approx(value * NM, rel=accuracy), name
    assert (found.smr1, found.smr2) == pytest.approx(ratios, abs=5e-7)


# --------------------------------------------------------------------- features
def test_summits_of_a_fourier_surface_have_five_figures():
    """Peaks and pits by Newton's method; those of the outer rings, whose hills reach the border, do not count."""
    lattice = Fourier([((6, 0), 1e-4, 0.25), ((0, 6), 1e-4, 0.25), ((1, 2), 1e-5, 0.2), ((3, -1), 5e-6, 0.7)])
    found = features(sampled(lattice, MIDDLES), form="none")
    tops = {1: [], -1: []}
    for sign, phase in ((1, 0.0), (-1, 0.5)):
        for i in range(-1, 8):
            for j in range(-1, 8):
                at, height = lattice.summit((i - 0.25 + phase) / 6, (j - 0.25 + phase) / 6)
                bend = -(lattice(*at, 2, 0) + lattice(*at, 0, 2)) / 2
                # Its hill is a square of half the diagonal 1/6 around it.
                if (np.abs(at - 0.5) < 0.5 - 0.09).all():
                    tops[sign].append((sign * height, bend))
    assert (found.peaks, found.pits) == (len(tops[1]), len(tops[-1]))
    five = [np.mean(sorted((height for height, _ in tops[sign]), reverse=True)[:5]) for sign in (1, -1)]
    assert (found.s5p_nm, found.s5v_nm) == pytest.approx([NM * one for one in five], rel=1e-4)
    assert found.s10z_nm == pytest.approx(NM * sum(five), rel=1e-4)
    assert found.spc == pytest.approx(np.mean([bend for _, bend in tops[1]]), rel=2e-4)
    assert found.svc == pytest.approx(np.mean([bend for _, bend in tops[-1]]), rel=2e-4)
    assert found.spd == pytest.approx(found.peaks, rel=1e-12)
    assert found.svd == pytest.approx(found.pits, rel=1e-12)


# --------------------------------------------------------------------- profiles
def test_a_fourier_profile_has_its_closed_form_after_the_filter():
    """Waves of whole numbers in the evaluation length; the Gaussian leaves 1 - 2^-(cutoff/wave)² of each."""
    cutoff, waves = 0.08, np.array([0.02, 0.01, 0.0025])
    sizes, phases = 1e-4 * np.array([1, 0.6, 0.3]), (0.3, 1.2, 2.2)

    def series(x, sizes):
        return sum(a * np.cos(2 * np.pi * x / wave + p) for a, wave, p in zip(sizes, waves, phases, strict=True))

    x = (np.arange(15_000) + 0.5) * 0.4 / 5000
    found = profile_roughness(Profile(distance=x, z=series(x, sizes), x=x, y=0 * x), cutoff=cutoff, form=0)
    seen = sizes * (1 - 2.0 ** -((cutoff / waves) ** 2))
    exact = series((np.arange(200_000) + 0.5) * 0.02 / 200_000, seen)
    rq = np.sqrt(np.sum(seen**2) / 2)
    assert found.rq_nm == pytest.approx(NM * rq, rel=1e-12)
    assert found.rsk == pytest.approx(np.mean(exact**3) / rq**3, rel=1e-10)
    assert found.rku == pytest.approx(np.mean(exact**4) / rq**4, rel=1e-12)
    assert found.ra_nm == pytest.approx(NM * np.abs(exact).mean(), rel=5e-6)
    assert found.rz_nm == pytest.approx(found.rt_nm, rel=1e-9)
    assert found.rt_nm == pytest.approx(NM * np.ptp(exact), rel=1e-4)
    assert found.rsm == pytest.approx(0.02, rel=1e-10)
