"""What must hold for any surface that is moved or added to another."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from laws import examples
from turnwright.surface import Expression, LensArray, Plane, SineGrid

X, Y = np.random.default_rng(4).uniform(-2, 2, (2, 60))
GRID = SineGrid(amplitude=(0.02, 0.03), period=(2.5, 1.7), phase=(0.3, -0.8))
SURFACES = {
    "grid": GRID,
    "formula": Expression("rho**2/30 + 0.01*rho**3*cos(3*phi)"),
    "array": LensArray.hexagonal(pitch=1.0, rings=3, lenslet=Expression("rho**2/20"), offset=(0.01, 0.02)),
    "sum": GRID + Plane(slope=(0.1, -0.2)),
}
angles = st.floats(-2 * np.pi, 2 * np.pi)
lengths = st.floats(-3, 3)
leans = st.floats(-0.4, 0.4)
surfaces = st.sampled_from(sorted(SURFACES)).map(SURFACES.get)
law = examples(40)


def turned(x, y, angle):
    return np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y


@law
@given(surfaces, angles)
def test_rotate_the_part_and_the_surface_rotates(surface, angle):
    rotated = surface.placed(rotation=angle)
    x, y = turned(X, Y, angle)
    np.testing.assert_allclose(rotated.sag(x, y), surface.sag(X, Y), atol=1e-14)
    np.testing.assert_allclose(rotated.gradient(x, y), turned(*surface.gradient(X, Y), angle), atol=1e-13)
    (a, b, c), (p, q, r) = surface.hessian(X, Y), rotated.hessian(x, y)
    found = np.moveaxis(np.array([[p, q], [q, r]]), -1, 0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    truth = turn @ np.moveaxis(np.array([[a, b], [b, c]]), -1, 0) @ turn.T
    np.testing.assert_allclose(found, truth, atol=1e-12)


@law
@given(surfaces, angles, lengths, lengths, lengths)
def test_rotate_a_shifted_surface_and_its_place_rotates(surface, angle, dx, dy, dz):
    once = surface.placed(shift=(*turned(dx, dy, angle), dz), rotation=angle)
    twice = surface.placed(shift=(dx, dy, dz)).placed(rotation=angle)
    np.testing.assert_allclose(once.sag(X, Y), twice.sag(X, Y), atol=1e-13)


@law
@given(surfaces, angles, lengths, lengths, lengths)
def test_moved_there_and_back_is_the_same(surface, angle, dx, dy, dz):
    there = surface.placed(shift=(dx, dy, dz), rotation=angle)
    back = there.placed(shift=(-dx, -dy, -dz)).placed(rotation=-angle)
    for found, truth in zip(back.evaluate(X, Y, 2), surface.evaluate(X, Y, 2), strict=True):
        np.testing.assert_allclose(found, truth, atol=1e-12)


@examples(15)
@given(surfaces, angles, lengths, leans, leans)
def test_tilted_there_and_back_is_the_same(surface, angle, dz, first, second):
    there = surface.placed(shift=(0.5, -0.25, dz), rotation=angle, tilt=(first, second))
    back = there.placed(shift=(-0.5, 0.25, -dz)).placed(rotation=-angle).placed(tilt=(-first, 0.0))
    back = back.placed(tilt=(0.0, -second))
    for order, (found, truth) in enumerate(zip(back.evaluate(X, Y, 2), surface.evaluate(X, Y, 2), strict=True)):
        np.testing.assert_allclose(found, truth, atol=1e-13 if order == 0 else 1e-11)


@examples(15)
@given(surfaces, angles, leans, leans)
def test_slope_and_curvature_are_what_differences_tend_to(surface, angle, first, second):
    """Central differences err by the square of the step; in the valleys of an array they say nothing."""
    placed = surface.placed(shift=(0.1, 0.2, 0.3), rotation=angle, tilt=(first, second))
    step = 1e-4
    ways = [(X + a * step, Y + b * step) for a, b in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
    pieces = [placed.piece(x, y) for x, y in ways]
    ok = np.ones(X.size, bool) if pieces[0] is None else np.ptp(pieces, axis=0) == 0
    jets = [np.array(placed.evaluate(x, y, 2))[:, ok] for x, y in ways]
    by_x, by_y = (jets[1] - jets[2]) / (2 * step), (jets[3] - jets[4]) / (2 * step)
    np.testing.assert_allclose([by_x[0], by_y[0]], jets[0][1:3], atol=1e-6)
    np.testing.assert_allclose([by_x[1], by_x[2], by_y[1], by_y[2]], jets[0][[3, 4, 4, 5]], atol=1e-5)


@law
@given(surfaces, surfaces, surfaces)
def test_sums_commute_and_associate(a, b, c):
    for one, other in (((a + b) + c, a + (b + c)), (a + b + c, c + a + b)):
        for found, truth in zip(one.evaluate(X, Y, 2), other.evaluate(X, Y, 2), strict=True):
            np.testing.assert_allclose(found, truth, atol=1e-14)


@law
@given(surfaces, surfaces, angles, lengths, lengths)
def test_a_moved_sum_is_the_sum_of_the_moved(a, b, angle, dx, dy):
    move = {"shift": (dx, dy, 0.0), "rotation": angle}
    one, other = (a + b).placed(**move), a.placed(**move) + b.placed(**move)
    for found, truth in zip(one.evaluate(X, Y, 2), other.evaluate(X, Y, 2), strict=True):
        np.testing.assert_allclose(found, truth, atol=1e-13)


@law
@given(st.floats(0.1, 10))
def test_scale_all_lengths_and_heights_scale(k):
    """An array k times as large, of lenses k times as large, is k times as high."""
    small = LensArray.square(
        pitch=1.0, rows=3, columns=3, lenslet=Expression("R - sqrt(R**2 - rho**2)", constants={"R": 5})
    )
    large = LensArray.square(
        pitch=k, rows=3, columns=3, lenslet=Expression("R - sqrt(R**2 - rho**2)", constants={"R": 5 * k})
    )
    np.testing.assert_allclose(large.sag(k * X, k * Y), k * small.sag(X, Y), atol=1e-14 * k)
    assert large.feature_size == pytest.approx(k * small.feature_size, rel=0.2)
