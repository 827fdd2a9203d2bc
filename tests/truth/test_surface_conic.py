"""Surfaces of revolution against their formula at 100 digits."""

import numpy as np
import pytest

from surface_oracle import computed, disc, error, even_conic, exact
from turnwright.errors import DomainError
from turnwright.surface import Conic, EvenAsphere, Plane, Sphere, Toroid

ASPHERE = {2: 1e-4, 4: -3e-6, 6: 4e-9, 10: 1e-14}


@pytest.mark.parametrize(
    ("surface", "formula", "reach"),
    [
        (Sphere(radius=10.0), even_conic(10.0, 0.0), 9.9),
        (Sphere(radius=-61.5), even_conic(-61.5, 0.0), 60.0),
        (Sphere(radius=np.inf), even_conic(np.inf, 0.0), 10.0),
        (Conic(radius=61.5, conic=-1.5), even_conic(61.5, -1.5), 100.0),
        (Conic(radius=-20.0, conic=-1.0), even_conic(-20.0, -1.0), 50.0),
        (Conic(radius=20.0, conic=0.7), even_conic(20.0, 0.7), 15.0),
        (EvenAsphere(radius=-61.5, conic=-1.5, terms=ASPHERE), even_conic(-61.5, -1.5, ASPHERE), 20.0),
        (EvenAsphere(radius=np.inf, conic=0.0, terms=ASPHERE), even_conic(np.inf, 0.0, ASPHERE), 20.0),
    ],
    ids=lambda value: type(value).__name__,
)
def test_formula(surface, formula, reach):
    x, y = disc(reach)
    # The loss is the conditioning of the root: near its end 1 - (1 + k) c^2 r^2 is small.
    assert (error(surface, formula, x, y) < [1e-14, 5e-14, 3e-13]).all()


@pytest.mark.parametrize("radius", [10.0, -1e7])
def test_sag_keeps_its_digits_near_the_vertex(radius):
    x, y = np.array([1e-12, 1e-6, 1e-3, 0.5]), np.array([0.0, 2e-6, -1e-3, 0.2])
    truth = exact(even_conic(radius, -0.3), x, y)
    found = computed(Conic(radius=radius, conic=-0.3), x, y)
    assert found[0] == pytest.approx(truth[0], rel=5e-16, abs=0)
    assert found[4] == pytest.approx(truth[4], rel=2e-15, abs=0)


def test_limits_of_conic_and_asphere_are_sphere_and_conic():
    x, y = disc(9.0)
    sphere = computed(Sphere(radius=10.0), x, y)
    assert np.array_equal(computed(Conic(radius=10.0, conic=0.0), x, y), sphere)
    assert np.array_equal(computed(EvenAsphere(radius=10.0, conic=0.0), x, y), sphere)


def test_a_plane_is_its_slopes():
    x, y = disc(5.0)
    z, zx, zy, zxx, zxy, zyy = computed(Plane(slope=(0.25, -0.5)), x, y)
    assert np.array_equal(z, x / 4 - y / 2)
    assert (zx == 0.25).all()
    assert (zy == -0.5).all()
    assert not np.any([zxx, zxy, zyy])


def test_domain_ends_where_the_surface_is_vertical():
    edge = 20 / np.sqrt(1.7)
    surface = Conic(radius=-20.0, conic=0.7)
    inside = surface.inside(np.array([edge * (1 - 1e-12), edge * (1 + 1e-12)]), np.zeros(2))
    assert inside.tolist() == [True, False]
    assert f"{edge:.6g}" in surface.domain
    assert Conic(radius=20.0, conic=-1.0).inside(np.zeros(2), np.zeros(2)) is None


def test_feature_size_of_an_asphere_is_where_its_terms_meet():
    # The 4th order bends as much as the sphere where 12 a r^2 = c, at r0. The ratio of second to third derivative is
    # r (1 + t) / (2 t) with t = (r / r0)^2, and least at t = 1: r0.
    r0 = np.sqrt(0.1 / (12 * 1e-4))
    assert EvenAsphere(radius=10.0, conic=-1.0, terms={4: 1e-4}).feature_size == pytest.approx(r0, rel=1e-12)
    assert EvenAsphere(radius=10.0, conic=-1.0).feature_size == np.inf
    assert Sphere(radius=-3.0).feature_size == 3.0


@pytest.mark.parametrize("far", [1e150, 1e200, 1e308])
def test_coordinates_whose_squares_overflow_are_outside(far):
    with pytest.raises(DomainError, match="not defined at x = "):
        Sphere(radius=10.0).sag(far, 0.0)
    with pytest.raises(DomainError, match="not defined at x = "):
        Toroid(radius_x=60.0, radius_y=40.0).sag(0.0, -far)
