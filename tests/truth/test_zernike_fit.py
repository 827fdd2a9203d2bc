"""Zernike coefficients against exact arithmetic, NumPy's least squares on prysm's polynomials, and random trials."""

from fractions import Fraction
from itertools import combinations
from math import factorial

import mpmath
import numpy as np
import pytest

from area_oracle import ring_weights
from turnwright._kernels import least_squares
from turnwright.heightmap import HeightMap
from turnwright.metrology import fit_zernike
from turnwright.metrology.zernike_fit import _smallest_circle
from turnwright.surface import Zernike
from turnwright.surface.disc import disc_sum
from turnwright.surface.zernike import zernike_order


def exactly(n, m, x, y):
    """The polynomial at rational numbers, from the factorials of its definition, in integers."""
    f, half, order = factorial, (n - abs(m)) // 2, abs(m)
    square = x * x + y * y
    radial = sum(
        Fraction((-1) ** k * f(n - k), f(k) * f((n + order) // 2 - k) * f(half - k)) * square ** (half - k)
        for k in range(half + 1)
    )
    real, imaginary = Fraction(1), Fraction(0)
    for _ in range(order):
        real, imaginary = real * x - imaginary * y, real * y + imaginary * x
    return radial * (real if m >= 0 else imaginary)


@pytest.mark.parametrize("indexing", ["fringe", "noll", "ansi"])
def test_term_100_equals_exact_arithmetic(indexing):
    n, m = zernike_order(100, indexing)
    places = [(Fraction(a, 16), Fraction(b, 16)) for a in range(-16, 17, 3) for b in range(-16, 17, 3)]
    places = [(a, b) for a, b in places if a * a + b * b <= 1]
    x, y = (np.array([float(one[i]) for one in places]) for i in range(2))
    truth = np.array([float(exactly(n, m, a, b)) for a, b in places])
    surface = Zernike(terms={100: 1.0}, radius=1.0, indexing=indexing, normalised=False)
    assert np.abs(surface.sag(x, y) - truth).max() < 1e-12
    # The polynomials of the fit, which are written for many terms at a time.
    place = np.full((2, abs(m) + 1, (n - abs(m)) // 2 + 1), -1)
    place[int(m < 0), abs(m), (n - abs(m)) // 2] = 0
    out = np.empty((1, x.size))
    recurrence = disc_sum({order: np.ones(place.shape[2]) for order in range(abs(m) + 1)}).recurrence
    least_squares.zernike_terms(x, y, 1.0, recurrence, place, np.ones(1), out)
    assert np.abs(out[0] - truth).max() < 1e-12
    # Its coefficient of rms 1 is that at the edge by sqrt(n + 1), times sqrt(2) unless m = 0.
    with mpmath.workdps(30):
        norm = float(mpmath.sqrt((n + 1) * (2 if m else 1)))
    rms = Zernike(terms={100: 1.0}, radius=1.0, indexing=indexing, normalised=True)
    assert np.abs(rms.sag(x, y) - norm * truth).max() < 1e-12 * norm


def holed(size, rng, *, share=0.2, circle=5.0, centre=(0.3, -0.1)):
    """A grid whose aperture lacks a slice and random points: a third of it in all."""
    x, y = np.linspace(-5, 5, size) + centre[0], np.linspace(-5.2, 5.2, size) + centre[1]
    columns, rows = np.meshgrid(x, y)
    away = np.hypot(columns - centre[0], rows - centre[1])
    inside = away <= circle
    valid = inside & (rng.random(columns.shape) > share) & (columns + rows < 3.6)
    return x, y, columns, rows, valid, 1 - valid.sum() / inside.sum()


@pytest.mark.parametrize(("indexing", "count"), [("fringe", 37), ("noll", 66), ("ansi", 45)])
def test_coefficients_return_with_a_third_of_points_missing(indexing, count):
    rng = np.random.default_rng(4)
    first = 0 if indexing == "ansi" else 1
    given = rng.normal(size=count) * 1e-3
    surface = Zernike(terms=dict(enumerate(given, first)), radius=5.0, indexing=indexing)
    x, y, columns, rows, valid, missing = holed(150, rng)
    assert missing > 0.33
    z = np.where(valid, surface.placed(shift=(0.3, -0.1, 0)).evaluate(columns, rows, 0)[0], np.nan)
    found = fit_zernike(HeightMap(x=x, y=y, z=z), terms=count, indexing=indexing, radius=5.0, centre=(0.3, -0.1))
    # The heights are rounded to 2.2e-16 of themselves; the condition is how much of that the worst direction shows.
    rounding = (1e-14 + 2.2e-16 * found.condition) * np.abs(given).max()
    assert np.abs(found.coefficients - given).max() < rounding
    assert found.rms_nm < 1e-9
    assert found.condition > 3  # it would be 1 over the whole disc, where a projection would do
    assert np.isnan(found.residual.z[~valid]).all()
    assert np.abs(found.surface.sag(columns[valid], rows[valid]) - z[valid]).max() < 1e-15
    again = fit_zernike(
        HeightMap(x=columns[valid], y=rows[valid], z=z[valid]),
        terms=count,
        indexing=indexing,
        radius=5.0,
        centre=(0.3, -0.1),
    )
    assert np.abs(again.coefficients - given).max() < rounding


def prysm_terms(pairs, columns, rows, radius, *, norm):
    from prysm.polynomials import zernike_nm

    r, t = np.hypot(columns, rows) / radius, np.arctan2(rows, columns)
    return np.stack([zernike_nm(n, m, r, t, norm=norm) for n, m in pairs], axis=1)


@pytest.mark.parametrize("polar", [False, True])
def test_noisy_coefficients_agree_with_dense_matrices(polar):
    rng = np.random.default_rng(5)
    if polar:
        radius, angle = np.linspace(0.1, 4.9, 40), np.linspace(0, 2 * np.pi, 61)[:-1]
        columns, rows = np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius
        valid = rng.random(columns.shape) > 0.3
        weight = np.broadcast_to(ring_weights(radius), columns.shape)[valid]
        axes = {"radius": radius, "angle": angle}
    else:
        x, y, columns, rows, valid, _ = holed(50, rng, centre=(0.0, 0.0))
        weight = np.ones(np.count_nonzero(valid))
        axes = {"x": x, "y": y}
    z = np.where(valid, 1e-4 * columns * rows + rng.normal(0, 1e-5, columns.shape), np.nan)
    found = fit_zernike(HeightMap(z=z, **axes), terms=21, indexing="noll", radius=5.0, centre=(0.0, 0.0))
    terms = prysm_terms([zernike_order(j, "noll") for j in range(1, 22)], columns[valid], rows[valid], 5.0, norm=True)
    root = np.sqrt(weight)
    truth = np.linalg.lstsq(terms * root[:, None], z[valid] * root)[0]
    assert np.abs(found.coefficients - truth).max() < 1e-13 * np.abs(truth).max()
    # The estimate is linear in the heights, so its covariance for independent noise follows from the matrix itself.
    linear = np.linalg.pinv(terms * root[:, None]) * root
    left = z[valid] - terms @ truth
    noise = weight @ left**2 / (weight.sum() - np.einsum("ij,ji->", terms * weight[:, None], linear))
    assert found.covariance == pytest.approx(noise * linear @ linear.T, rel=1e-7, abs=1e-25)
    assert found.uncertainty == pytest.approx(np.sqrt(np.diag(found.covariance)))
    # Orthonormal over the points: Gram-Schmidt in order is the QR factorisation.
    q, r = np.linalg.qr(terms * np.sqrt(weight / weight.sum())[:, None])
    q, r = q * np.sign(np.diag(r)), r * np.sign(np.diag(r))[:, None]
    assert found.orthonormal == pytest.approx(q.T @ (z[valid] * np.sqrt(weight / weight.sum())), rel=1e-9, abs=1e-16)
    assert found.orthonormal_uncertainty == pytest.approx(
        np.sqrt(np.diag(noise * r @ linear @ linear.T @ r.T)), rel=1e-7
    )
    # Their squares add up to the mean square of the fit, as Parseval has it.
    assert (found.orthonormal**2).sum() == pytest.approx(weight @ (terms @ truth) ** 2 / weight.sum(), rel=1e-9)


@pytest.mark.parametrize("polar", [False, True])
def test_the_stated_uncertainty_is_the_scatter_of_random_trials(polar):
    rng = np.random.default_rng(6)
    if polar:
        axes = {"radius": np.linspace(0, 1, 15), "angle": np.linspace(0, 2 * np.pi, 25)[:-1]}
        shape = (24, 15)
    else:
        axes = {"x": np.linspace(-1, 1, 20), "y": np.linspace(-1, 1, 20)}
        shape = (20, 20)
    trials = []
    for _ in range(150):
        z = rng.normal(0, 1e-5, shape)
        fit = fit_zernike(HeightMap(z=z, **axes), terms=10, indexing="fringe", radius=1.0, centre=(0, 0))
        trials.append(fit.coefficients / fit.uncertainty)
    # 1500 numbers of variance 1 (those of one trial are correlated a little).
    assert np.square(trials).mean() == pytest.approx(1, abs=0.12)


def test_the_aperture_found_is_the_smallest_circle():
    rng = np.random.default_rng(7)
    for count in (2, 3, 5, 12):
        for _ in range(20):
            x, y = rng.normal(size=(2, count))
            best = np.inf
            for i, j in combinations(range(count), 2):
                best = min(best, reach(x, y, (x[i] + x[j]) / 2, (y[i] + y[j]) / 2))
            for three in combinations(range(count), 3):
                # Equal distances from three points are two linear equations.
                i, j, k = three
                a = 2 * np.array([[x[j] - x[i], y[j] - y[i]], [x[k] - x[i], y[k] - y[i]]])
                b = [x[j] ** 2 - x[i] ** 2 + y[j] ** 2 - y[i] ** 2, x[k] ** 2 - x[i] ** 2 + y[k] ** 2 - y[i] ** 2]
                best = min(best, reach(x, y, *np.linalg.solve(a, b)))
            radius, centre = _smallest_circle(x, y)
            assert radius == pytest.approx(best, rel=1e-9)
            assert reach(x, y, *centre) <= radius * (1 + 1e-12)


def reach(x, y, x0, y0):
    return np.hypot(x - x0, y - y0).max()


def test_missing_aperture_is_found_from_the_valid_points():
    rng = np.random.default_rng(8)
    x, y, columns, rows, valid, _ = holed(301, rng, share=0.0)
    z = np.where(valid, 1e-3 * columns, np.nan)
    found = fit_zernike(HeightMap(x=x, y=y, z=z), terms=3, indexing="fringe")
    assert found.radius == pytest.approx(5.0, abs=0.03)
    assert found.centre == pytest.approx((0.3, -0.1), abs=0.03)
    assert found.left_out == 0
    part = fit_zernike(HeightMap(x=x, y=y, z=z), terms=3, indexing="fringe", radius=2.0, centre=(0.3, -0.1))
    assert part.terms[2] == pytest.approx(2e-3, rel=1e-12)
    assert part.left_out == np.count_nonzero(valid & (np.hypot(columns - 0.3, rows + 0.1) > 2.0))
    assert np.isnan(part.residual.z[np.hypot(columns - 0.3, rows + 0.1) > 2.0]).all()
