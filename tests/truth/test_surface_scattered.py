"""Surfaces through scattered points and tables with holes, against the surface that was sampled."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.errors import DomainError, InputError
from turnwright.surface import EvenAsphere, Gridded, Scattered, Zernike

ASPHERE = EvenAsphere(radius=60.0, conic=-1.2, terms={4: 2e-6, 6: -1e-8}) + Zernike(
    terms={5: 1e-3, 8: 5e-4, 11: 2e-4}, radius=11.0, indexing="fringe"
)


def sampled(surface, count, seed=1):
    rng = np.random.default_rng(seed)
    radius, angle = 11 * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return Scattered(x=x, y=y, z=surface.sag(x, y))


def within(surface, radius, count=5000):
    x, y = np.random.default_rng(3).uniform(-radius, radius, (2, count))
    chosen = (np.hypot(x, y) < radius) & surface.inside(x, y)
    return x[chosen], y[chosen]


def test_points_are_met_and_interpolation_is_as_good_as_stated():
    found = sampled(ASPHERE, 800)
    assert np.abs(found.evaluate(found.x, found.y, 0)[0] - found.z).max() < 1e-8
    x, y = within(found, 10.0)
    off = np.abs(found.sag(x, y) - ASPHERE.sag(x, y)).max()
    assert off < found.fit_error
    assert off < 5e-6
    for one, other in zip(found.gradient(x, y), ASPHERE.gradient(x, y), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5)
    assert "800 scattered points" in found.remarks[0]


def test_a_polynomial_of_degree_five_is_reproduced():
    quintic = tw.XYPolynomial(terms={(2, 0): 0.01, (1, 1): 2e-3, (3, 2): 1e-6, (0, 5): -2e-6})
    found = sampled(quintic, 300)
    x, y = within(found, 10.9)
    np.testing.assert_allclose(found.sag(x, y), quintic.sag(x, y), atol=2e-6)


def test_nothing_is_made_up_beyond_the_points():
    found = sampled(ASPHERE, 300)
    tw.Part(surface=found, radius=9.5)
    with pytest.raises(DomainError, match="Scattered is not defined beyond"):
        tw.Part(surface=found, radius=11.0)
    with pytest.raises(DomainError, match="convex hull of its 300 points"):
        found.sag(10.9, 10.9)


@pytest.mark.parametrize(
    ("x", "y", "match"),
    [
        (np.arange(10.0), np.arange(10.0) ** 2, "10 points, the limits are 30 and 2000"),
        (np.arange(40.0), 2 * np.arange(40.0), "are on a line"),
        (np.r_[0.0, np.arange(40.0)], np.r_[0.0, np.arange(40.0) ** 2], "two scattered points are at x = 0 mm"),
        (np.arange(3000.0), np.arange(3000.0) ** 2, "thin the list"),
    ],
)
def test_lists_that_are_no_surface_are_refused(x, y, match):
    with pytest.raises(InputError, match=match):
        Scattered(x=x, y=y, z=np.zeros_like(x))


@pytest.mark.parametrize(("count", "limit"), [(41, 1e-6), (101, 1e-8)])
def test_a_round_table_is_as_good_as_a_whole_one(count, limit):
    """Heights are missing beyond a circle, as of a round part on a square grid."""
    axis = np.linspace(-11, 11, count)
    x, y = np.meshgrid(axis, axis)
    z = ASPHERE.sag(x, y)
    z[np.hypot(x, y) > 10.7] = np.nan
    found = Gridded(x=axis, y=axis, z=z)
    at = within(found, 10.9)
    assert np.abs(found.sag(*at) - ASPHERE.sag(*at)).max() < limit
    tw.Part(surface=found, radius=10.0)
    with pytest.raises(DomainError, match="no height at"):
        tw.Part(surface=found, radius=10.7)


def test_a_single_hole_is_seen_however_small():
    axis = np.linspace(-11, 11, 801)
    z = ASPHERE.sag(*np.meshgrid(axis, axis))
    z[300, 437] = np.nan
    with pytest.raises(DomainError, match=r"1 points.*x = 1.0175 mm, y = -2.75 mm"):
        tw.Part(surface=Gridded(x=axis, y=axis, z=z), radius=10.0)
