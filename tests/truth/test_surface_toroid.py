"""Torus and biconic against their formula at 100 digits, and the torus against its definition."""

import numpy as np
import pytest
import sympy as sp

from surface_oracle import X, Y, computed, error, even_conic, exact
from turnwright.surface import Biconic, Toroid


def points(reach_x, reach_y, count=40):
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-reach_x, reach_x, count), rng.uniform(-reach_y, reach_y, count)
    x[:3], y[:3] = (0.0, 1e-7, 0.0), (0.0, 0.0, 1e-5)
    return x, y


def torus(radius_x, radius_y):
    """Turn the arc about the line: the plain formula, with its cancellation left to 100 digits."""
    rx, ry = sp.Rational(radius_x), sp.Rational(radius_y)
    arc = rx - sp.sign(rx) * sp.sqrt(rx**2 - X**2)
    return ry - sp.sign(ry) * sp.sqrt((ry - arc) ** 2 - Y**2)


@pytest.mark.parametrize(
    ("radius_x", "radius_y", "reach_x", "reach_y"),
    [(30.0, 12.0, 10.0, 9.0), (12.0, 30.0, 10.0, 10.0), (-30.0, 12.0, 10.0, 11.0), (30.0, -12.0, 20.0, 11.0)],
)
def test_toroid(radius_x, radius_y, reach_x, reach_y):
    surface = Toroid(radius_x=radius_x, radius_y=radius_y)
    x, y = points(reach_x, reach_y)
    assert (error(surface, torus(radius_x, radius_y), x, y) < [1e-14, 2e-14, 1e-13]).all()


def aspheric_torus(radius_x, radius_y, conic, terms):
    """Turn a conic with even powers about the line."""
    arc = even_conic(radius_x, conic, terms).subs(Y, 0)
    if np.isinf(radius_y):
        return arc
    turn = sp.Rational(radius_y)
    return turn - sp.sign(turn) * sp.sqrt((turn - arc) ** 2 - Y**2)


@pytest.mark.parametrize(
    ("radius_x", "radius_y", "conic", "terms"),
    [
        (30.0, -55.0, -0.7, {2: 1e-4, 4: -2e-6, 6: 3e-8}),
        (-25.0, 40.0, 0.4, {8: 1e-10}),
        (np.inf, 20.0, 0.0, {4: 1e-5, 14: 1e-17}),
        (18.0, np.inf, -2.0, {4: -1e-5}),
    ],
)
def test_toroid_with_an_aspheric_arc(radius_x, radius_y, conic, terms):
    surface = Toroid(radius_x=radius_x, radius_y=radius_y, conic=conic, terms=terms)
    x, y = points(9.0, 9.0)
    assert (error(surface, aspheric_torus(radius_x, radius_y, conic, terms), x, y) < [1e-14, 2e-14, 1e-13]).all()


def test_domain_of_an_aspheric_torus_is_that_of_its_formula():
    x, y = np.meshgrid(np.linspace(-35, 35, 141) + 1e-3, np.linspace(-35, 35, 141) + 2e-3)
    for radius_x, radius_y, conic, a in ((30.0, 12.0, 0.5, 1e-4), (-20.0, 15.0, -3.0, -1e-5)):
        with np.errstate(invalid="ignore"):
            root = np.sqrt(1 - (1 + conic) * x**2 / radius_x**2)
            arc = x**2 / radius_x / (1 + root) + a * x**4
            defined = np.isfinite(np.sqrt((radius_y - arc) ** 2 - y**2)) & ((radius_y - arc) * radius_y > 0)
        surface = Toroid(radius_x=radius_x, radius_y=radius_y, conic=conic, terms={4: a})
        assert np.array_equal(surface.inside(x, y), defined)
        assert np.isfinite(surface.evaluate(x[defined], y[defined], 2)).all()


def test_toroid_keeps_its_digits_near_the_vertex():
    surface = Toroid(radius_x=1e6, radius_y=-12.0)
    x, y = np.array([1e-3, 1e-6, 0.3]), np.array([0.0, 1e-7, 1e-6])
    assert surface.sag(x, y) == pytest.approx(exact(torus(1e6, -12.0), x, y)[0], rel=1e-15, abs=0)


def test_points_are_one_arc_radius_from_the_circle_of_centres():
    surface = Toroid(radius_x=5.0, radius_y=12.0)
    x, y = points(4.0, 7.0)
    from_line = np.hypot(y, surface.sag(x, y) - 12.0)
    assert np.hypot(from_line - 7.0, x) == pytest.approx(5.0, rel=1e-14)


def test_equal_radii_make_a_sphere():
    x, y = points(6.0, 6.0)
    assert (error(Toroid(radius_x=10.0, radius_y=10.0), even_conic(10.0, 0.0), x, y) < 1e-13).all()


@pytest.mark.parametrize("family", [Toroid, Biconic])
def test_one_infinite_radius_makes_a_cylinder(family):
    more = {"conic_x": 0.0, "conic_y": 0.0} if family is Biconic else {}
    x, y = points(6.0, 6.0)
    arc = even_conic(10.0, 0.0)
    along_y = family(radius_x=10.0, radius_y=np.inf, **more)
    along_x = family(radius_x=np.inf, radius_y=10.0, **more)
    assert (error(along_y, arc.subs(Y, 0), x, y) < 1e-13).all()
    assert (error(along_x, arc.subs(X, 0), x, y) < 1e-13).all()


@pytest.mark.parametrize(
    ("radii", "conics", "reach"),
    [((30.0, -12.0), (-0.4, 0.3), 8.0), ((-61.5, 40.0), (-1.5, -1.0), 30.0), ((25.0, 20.0), (1.0, 0.0), 10.0)],
)
def test_biconic(radii, conics, reach):
    (cx, cy), (kx, ky) = (1 / sp.Rational(r) for r in radii), (sp.Rational(k) for k in conics)
    root = sp.sqrt(1 - (1 + kx) * cx**2 * X**2 - (1 + ky) * cy**2 * Y**2)
    formula = (cx * X**2 + cy * Y**2) / (1 + root)
    surface = Biconic(radius_x=radii[0], radius_y=radii[1], conic_x=conics[0], conic_y=conics[1])
    x, y = points(reach, reach)
    assert (error(surface, formula, x, y) < [1e-14, 1e-14, 5e-14]).all()


def test_domains_end_where_the_formula_turns_complex():
    x, y = np.meshgrid(np.linspace(-35, 35, 141) + 1e-3, np.linspace(-35, 35, 141) + 2e-3)
    for radius_x, radius_y in ((30.0, 12.0), (30.0, -12.0), (-12.0, 30.0)):
        with np.errstate(invalid="ignore"):
            arc = radius_x - np.sign(radius_x) * np.sqrt(radius_x**2 - x**2)
            defined = np.isfinite(np.sqrt((radius_y - arc) ** 2 - y**2)) & ((radius_y - arc) * radius_y > 0)
        assert np.array_equal(Toroid(radius_x=radius_x, radius_y=radius_y).inside(x, y), defined)
    with np.errstate(invalid="ignore"):
        defined = np.isfinite(np.sqrt(1 - 1.5 * x**2 / 900 - 0.5 * y**2 / 400))
    biconic = Biconic(radius_x=30.0, radius_y=20.0, conic_x=0.5, conic_y=-0.5)
    assert np.array_equal(biconic.inside(x, y), defined)
    flat = Biconic(radius_x=30.0, radius_y=20.0, conic_x=-1.0, conic_y=-2.0)
    assert flat.inside(x, y) is None
    assert np.isfinite(computed(flat, x, y)).all()
