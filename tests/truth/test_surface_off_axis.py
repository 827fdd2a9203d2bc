"""Off-axis parts against the root of the tilted parent, solved for and differentiated by mpmath at 40 digits."""

import mpmath
import numpy as np
import pytest

from surface_oracle import computed
from turnwright.errors import DomainError, InputError
from turnwright.part import Part
from turnwright.surface import Biconic, Conic, EvenAsphere, OffAxis, Sphere


def conic(c, k, terms=()):
    def height(x, y):
        s = x * x + y * y
        return c * s / (1 + mpmath.sqrt(1 - (1 + k) * c * c * s)) + sum(a * s ** (n // 2) for n, a in terms)

    return height


def biconic(cx, cy, kx, ky):
    def height(x, y):
        root = mpmath.sqrt(1 - (1 + kx) * cx**2 * x * x - (1 + ky) * cy**2 * y * y)
        return (cx * x * x + cy * y * y) / (1 + root)

    return height


def mpf(value):
    return mpmath.mpf(value)


PARENTS = {
    "parabola": (Conic(radius=200.0, conic=-1.0), lambda: conic(1 / mpf(200), mpf(-1)), 40.0, 0.0),
    "hyperbola": (Conic(radius=-150.0, conic=-2.5), lambda: conic(-1 / mpf(150), mpf(-2.5)), 55.0, 2.0),
    "ellipse": (Conic(radius=120.0, conic=-0.6), lambda: conic(1 / mpf(120), mpf(-0.6)), 30.0, -0.7),
    "asphere": (
        EvenAsphere(radius=80.0, conic=-1.2, terms={4: 2e-7, 6: -3e-11}),
        lambda: conic(1 / mpf(80), mpf(-1.2), ((4, mpf(2e-7)), (6, mpf(-3e-11)))),
        25.0,
        np.pi / 3,
    ),
    "biconic": (
        Biconic(radius_x=90.0, radius_y=140.0, conic_x=-1.0, conic_y=0.3),
        lambda: biconic(1 / mpf(90), 1 / mpf(140), mpf(-1), mpf(0.3)),
        20.0,
        0.9,
    ),
}


def oracle(parent, distance, azimuth, x, y):
    """Return z and its five derivatives at (x, y): the parent's own normal turned to z by the smallest rotation."""
    with mpmath.workdps(40):
        f = parent()
        px, py = mpf(distance) * mpmath.cos(mpf(azimuth)), mpf(distance) * mpmath.sin(mpf(azimuth))
        point = mpmath.matrix([px, py, f(px, py)])
        fx, fy = mpmath.diff(f, (px, py), (1, 0)), mpmath.diff(f, (px, py), (0, 1))
        steep = mpmath.sqrt(fx * fx + fy * fy)
        # Rodrigues' formula: about the level axis across the slope, by the slope's angle.
        ax, ay = fy / steep, -fx / steep
        angle = -mpmath.atan(steep)
        cross = mpmath.matrix([[0, 0, ay], [0, 0, -ax], [-ay, ax, 0]])
        turn = mpmath.eye(3) + mpmath.sin(angle) * cross + (1 - mpmath.cos(angle)) * cross * cross
        normal = turn * mpmath.matrix([-fx, -fy, 1])
        if abs(normal[0]) + abs(normal[1]) > mpf(10) ** -30:
            turn = turn.T
        back = turn.T

        def height(u, v):
            def gap(z):
                at = back * mpmath.matrix([u, v, z]) + point
                return at[2] - f(at[0], at[1])

            return mpmath.findroot(gap, (mpf(0), mpf("1e-3")), solver="secant", tol=1e-70)

        orders = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        return [float(mpmath.diff(height, (mpf(x), mpf(y)), n)) for n in orders]


@pytest.mark.parametrize("name", PARENTS)
def test_an_off_axis_part_is_the_root_of_the_tilted_parent(name):
    surface, parent, distance, azimuth = PARENTS[name]
    part = OffAxis(parent=surface, distance=distance, azimuth=azimuth)
    for x, y in ((0.3, -0.2), (9.0, 4.0), (-7.5, 8.0), (0.0, -10.0)):
        truth = oracle(parent, distance, azimuth, x, y)
        found = computed(part, x, y)
        np.testing.assert_allclose(found[:1], truth[:1], atol=5e-14)
        np.testing.assert_allclose(found[1:], truth[1:], atol=2e-15, rtol=1e-13)


@pytest.mark.parametrize("name", PARENTS)
def test_the_vertex_is_at_the_origin_and_level(name):
    surface, _, distance, azimuth = PARENTS[name]
    part = OffAxis(parent=surface, distance=distance, azimuth=azimuth)
    z, zx, zy = computed(part, 0.0, 0.0)[:3]
    assert abs(z) < 2e-14
    assert max(abs(zx), abs(zy)) < 1e-15


def test_textbook_curvatures_of_an_off_axis_paraboloid():
    """cos^3 / R along the meridian, cos / R across it, the meridian at the azimuth."""
    part = OffAxis(parent=Conic(radius=100.0, conic=-1.0), distance=60.0, azimuth=np.pi / 2)
    cosine = np.cos(np.arctan(0.6))
    zxx, zxy, zyy = part.hessian(0.0, 0.0)
    np.testing.assert_allclose([zxx, zxy, zyy], [cosine / 100, 0.0, cosine**3 / 100], atol=1e-16)


def test_a_sphere_looks_the_same_from_everywhere():
    x, y = np.random.default_rng(1).uniform(-10, 10, (2, 200))
    part = OffAxis(parent=Sphere(radius=150.0), distance=70.0, azimuth=4.0)
    np.testing.assert_allclose(part.sag(x, y), Sphere(radius=150.0).sag(x, y), atol=5e-14)
    # On the axis itself nothing is moved.
    there = OffAxis(parent=Conic(radius=90.0, conic=-3.0), distance=0.0)
    np.testing.assert_array_equal(there.sag(x, y), Conic(radius=90.0, conic=-3.0).sag(x, y))


def test_what_was_worked_out_is_stated():
    part = OffAxis(parent=Conic(radius=200.0, conic=-1.0), distance=40.0)
    assert part.vertex == (40.0, 0.0, 4.0)
    (sentence,) = (part + Sphere(radius=1e4)).remarks
    for words in ("x = 40 mm", "z = 4 mm", f"{np.rad2deg(np.arctan(0.2)):.6f} deg"):
        assert words in sentence
    # The stated tilt and shift are those of `Surface.placed`.
    x, y = np.random.default_rng(2).uniform(-5, 5, (2, 50))
    pose = part.pose
    moved = part.parent.placed(shift=pose.shift, rotation=pose.rotation, tilt=pose.tilt)
    np.testing.assert_array_equal(moved.sag(x, y), part.sag(x, y))


def test_impossible_off_axis_parts_are_refused():
    parent = Sphere(radius=50.0)
    with pytest.raises(DomainError, match=r"distance of the off-axis part is 60 mm.*Sphere"):
        OffAxis(parent=parent, distance=60.0)
    with pytest.raises(InputError, match="0 mm or more"):
        OffAxis(parent=parent, distance=-1.0)
    with pytest.raises(InputError, match=r"azimuth.*6.283 rad"):
        OffAxis(parent=parent, distance=1.0, azimuth=90.0)
    with pytest.raises(InputError, match="parent"):
        OffAxis(parent=3.0, distance=1.0)
    with pytest.raises(DomainError, match="OffAxis is not defined beyond"):
        Part(surface=OffAxis(parent=Conic(radius=50.0, conic=3.0), distance=20.0), radius=10.0)
