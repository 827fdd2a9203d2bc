"""Polynomial forms fitted through sums over rows and columns, against NumPy's least squares over all points."""

import numpy as np
import pytest

from area_oracle import ring_weights
from turnwright.heightmap import HeightMap
from turnwright.metrology import remove_form


def dense(x, y, z, weight, degree):
    """What is left at the valid points by orthogonal triangles of the whole matrix, which loses no digits."""
    from numpy.polynomial.legendre import legvander2d

    valid = ~np.isnan(z)

    def unit(a):
        return (2 * a - a.max() - a.min()) / np.ptp(a)

    table = legvander2d(unit(x[valid]), unit(y[valid]), [degree, degree])
    keep = [i * (degree + 1) + j for i in range(degree + 1) for j in range(degree + 1 - i)]
    root = np.sqrt(weight[valid])[:, None]
    fit = np.linalg.lstsq(table[:, keep] * root, z[valid] * root[:, 0])[0]
    return z[valid] - table[:, keep] @ fit, valid


def rough(shape, rng):
    z = rng.standard_normal(shape) * 1e-4
    z[rng.random(shape) < 0.3] = np.nan
    return z


@pytest.mark.parametrize("degree", [0, 1, 4, 10])
def test_a_form_on_an_uneven_grid_with_a_third_missing(degree):
    rng = np.random.default_rng(1)
    x, y = np.sort(rng.uniform(3, 4, 60)), np.sort(rng.uniform(-9, -7, 50))
    columns, rows = np.meshgrid(x, y)
    z = rough((50, 60), rng) + 5.0 + (columns - 3.2) ** 4 * (rows + 8) ** 3
    z[np.hypot(columns - 3.5, rows + 8) > 0.8] = np.nan

    def widths(axis):
        middle = (axis[1:] + axis[:-1]) / 2
        return np.diff(np.concatenate([[2 * axis[0] - middle[0]], middle, [2 * axis[-1] - middle[-1]]]))

    truth, valid = dense(columns, rows, z, np.outer(widths(y), widths(x)), degree)
    left = remove_form(HeightMap(x=x, y=y, z=z), degree).z
    assert np.abs(left[valid] - truth).max() < 1e-12
    assert np.isnan(left[~valid]).all()


@pytest.mark.parametrize(("degree", "turns"), [(1, 1.0), (5, 1.0), (10, 1.0), (1, 0.4), (5, 0.4), (10, 0.75)])
def test_a_form_on_a_polar_grid_is_the_polynomial_of_x_and_y(degree, turns):
    rng = np.random.default_rng(2)
    radius, angle = np.linspace(0, 2, 60), np.linspace(0, 2 * np.pi * turns, 80, endpoint=False) + 0.3
    x, y = np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius
    z = rough((80, 60), rng) + 3.0 + x**3 * y
    around = np.ones(80)
    if turns < 1:
        around[[0, -1]] = 0.5
    truth, valid = dense(x, y, z, np.outer(around, ring_weights(radius)), degree)
    left = remove_form(HeightMap(radius=radius, angle=angle, z=z), degree).z
    assert np.abs(left[valid] - truth).max() < 1e-12


def test_a_polynomial_of_degree_ten_is_removed_to_rounding():
    rng = np.random.default_rng(3)
    x, y = np.linspace(-7, 11, 200), np.linspace(100, 109, 150)
    u, v = (x - 2) / 9, (y - 104.5) / 4.5
    z = sum(rng.normal() * u**i * v[:, None] ** j for i in range(11) for j in range(11 - i))
    z[np.hypot(u, v[:, None]) > 0.95] = np.nan
    z[rng.random(z.shape) < 0.3] = np.nan
    assert np.nanmax(np.abs(remove_form(HeightMap(x=x, y=y, z=z), 10).z)) < 1e-14 * np.nanmax(np.abs(z))


def test_a_map_far_larger_than_what_is_valid_loses_nothing():
    # The polynomial is spanned over the valid points, not over the whole map.
    x = np.linspace(-50, 50, 401)
    z = np.full((401, 401), np.nan)
    small = np.abs(x) < 5
    z[np.ix_(small, small)] = ((x + x[:, None] / 3) ** 10 * 1e-7)[np.ix_(small, small)]
    left = remove_form(HeightMap(x=x, y=x, z=z), 10).z
    assert np.nanmax(np.abs(left)) < 1e-14 * np.nanmax(np.abs(z)) * 5


def test_points_on_one_line_carry_what_terms_they_can():
    z = np.full((20, 30), np.nan)
    x = np.linspace(0, 1, 30)
    z[7] = 1 + x + x**2
    left = remove_form(HeightMap(x=x, y=np.arange(20.0), z=z), 3).z
    assert np.nanmax(np.abs(left)) < 1e-14
