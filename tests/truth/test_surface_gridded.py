"""Gridded surfaces against SymPy, scipy's own bicubic spline, and the surface that was tabulated."""

import numpy as np
import pytest
import sympy as sp
from scipy.interpolate import RectBivariateSpline

from surface_oracle import X, Y, computed, disc, error
from turnwright.errors import DomainError
from turnwright.surface import Gridded

RNG = np.random.default_rng(7)
UNEVEN_X = np.sort(RNG.uniform(-6, 6, 23))
UNEVEN_Y = np.concatenate([np.linspace(-5, 0, 9), np.linspace(0.1, 5.5, 31)])


def test_a_bicubic_polynomial_is_reproduced():
    formula = (1 + X / 2 - X**3 / 40) * (2 - Y + Y**2 / 8 + Y**3 / 50)
    z = sp.lambdify((X, Y), formula)(*np.meshgrid(UNEVEN_X, UNEVEN_Y))
    table = Gridded(x=UNEVEN_X, y=UNEVEN_Y, z=z)
    assert (error(table, formula, *disc(4.5)) < [1e-14, 1e-13, 1e-11]).all()
    assert table.fit_error < 1e-12


def test_scipy_draws_the_same_spline():
    z = RNG.normal(size=(UNEVEN_Y.size, UNEVEN_X.size))
    table = Gridded(x=UNEVEN_X, y=UNEVEN_Y, z=z)
    spline = RectBivariateSpline(UNEVEN_X, UNEVEN_Y, z.T, s=0)
    x, y = RNG.uniform(-5, 5, (2, 500))
    for found, (dx, dy) in zip(computed(table, x, y), [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)], strict=True):
        truth = spline.ev(x, y, dx=dx, dy=dy)
        np.testing.assert_allclose(found, truth, atol=1e-11 * np.abs(truth).max())


def test_every_tabulated_height_is_kept():
    z = RNG.normal(size=(UNEVEN_Y.size, UNEVEN_X.size))
    table = Gridded(x=UNEVEN_X, y=UNEVEN_Y, z=z)
    np.testing.assert_allclose(table.sag(UNEVEN_X, UNEVEN_Y[:, None]), z, atol=1e-14)


def test_second_derivatives_do_not_jump_between_cells():
    x = np.linspace(-2, 2, 21)
    table = Gridded(x=x, y=x, z=np.cos(x) * np.sin(2 * x)[:, None])
    at = x[3:-3]
    for before, after in zip(
        table.hessian(np.nextafter(at, -9), 0.123), table.hessian(np.nextafter(at, 9), 0.123), strict=True
    ):
        np.testing.assert_allclose(before, after, atol=1e-12)


@pytest.mark.parametrize("points", [31, 61, 121])
def test_the_stated_fit_error_is_the_true_one(points):
    """The function that was tabulated is known here, so the largest error between the points is too."""
    axis = np.linspace(-3, 3, points)
    table = Gridded(x=axis, y=axis, z=np.exp(-(axis**2) / 2) * np.cos(axis)[:, None])
    fine = np.linspace(-3, 3, 7 * points)
    true = np.abs(table.sag(fine, fine[:, None]) - np.exp(-(fine**2) / 2) * np.cos(fine)[:, None]).max()
    assert 0.7 * true < table.fit_error < 1.4 * true


def test_the_domain_is_the_grid():
    axis = np.linspace(-2, 2, 9)
    table = Gridded(x=axis, y=2 * axis, z=np.zeros((9, 9)))
    np.testing.assert_array_equal(table.sag([-2.0, 2.0, 0.0], [-4.0, 4.0, 4.0]), 0)
    with pytest.raises(DomainError, match="x from -2 to 2 mm and y from -4 to 4 mm"):
        table.sag(2.0000001, 0.0)
    with pytest.raises(DomainError, match="clear aperture is 3 mm"):
        table.require_disc(3.0, "the radius of the clear aperture")
    table.require_disc(2.0, "the radius of the clear aperture")
    assert table.feature_size == 0.5


def test_border_next_to_crowded_rows_is_extended():
    """The 32 nearest heights of a point beyond the border are on one line: more of them are taken."""
    y = np.concatenate([np.arange(30.0), 30 + 1e-3 * np.arange(80), np.arange(31.0, 100)])
    x = np.arange(12.0)
    table = Gridded(x=x, y=y, z=np.where(x < 6, 1e-3 * y[:, None] ** 2 + x, np.nan))
    assert abs(float(table.sag(0.5, 50.0)) - 3.0) < table.fit_error
