"""Sums and moved surfaces, against SymPy, mpmath, scipy's rotations and what a moved plane, sphere and parabola are."""

import mpmath
import numpy as np
import pytest
import sympy as sp
from scipy.spatial.transform import Rotation

from surface_oracle import X, Y, computed, disc, error
from turnwright.errors import DomainError
from turnwright.surface import Expression, LensArray, Placed, Plane, SineGrid, Sphere, Sum

GRID = SineGrid(amplitude=(0.02, 0.03), period=(2.5, 1.7), phase=(0.3, -0.8))
MOVE = {"shift": (0.7, -0.4, 0.25), "rotation": 0.9, "tilt": (0.2, -0.35)}


def to_part(points, *, shift=(0, 0, 0), rotation=0.0, tilt=(0, 0)):
    """Move points of a surface, (n, 3), by scipy's intrinsic rotation about x, then y, and one about the part's z."""
    turn = Rotation.from_euler("z", rotation) * Rotation.from_euler("XY", tilt)
    return turn.apply(points) + shift


def grid_formula(x, y):
    parts = zip((x, y), GRID.amplitude, GRID.period, GRID.phase, strict=True)
    return sum(sp.Rational(a) * sp.sin(2 * sp.pi * q / sp.Rational(p) + sp.Rational(f)) for q, a, p, f in parts)


def test_a_sum_is_the_sum_by_sympy():
    total = GRID + Expression("x**3*y/100") + Plane(slope=(0.5, 0.0))
    formula = grid_formula(X, Y) + X**3 * Y / 100 + X / 2
    assert (error(total, formula, *disc(5.0)) < 1e-14).all()


def test_sums_are_taken_apart():
    a, b, c = Plane(slope=(1, 0)), Plane(slope=(0, 1)), GRID
    assert ((a + b) + c).terms == (a, b, c) == (a + (b + c)).terms


def test_a_sum_is_defined_where_all_terms_are():
    total = Sphere(radius=2.0) + Sphere(radius=5.0) + GRID
    np.testing.assert_array_equal(total.inside(np.array([0.0, 1.9, 2.1]), np.zeros(3)), [True, True, False])
    with pytest.raises(DomainError, match="Sum"):
        total.sag(3.0, 0.0)


def test_pieces_of_a_sum_tell_every_combination_apart():
    arrays = [LensArray.square(pitch=1.0, rows=5, columns=5, lenslet=GRID, offset=(0.3 * k, 0.1 * k)) for k in range(3)]
    x, y = np.random.default_rng(2).uniform(-3, 3, (2, 5000))
    each = np.stack([array.piece(x, y) for array in arrays])
    _, by_hand = np.unique(each, axis=1, return_inverse=True)
    _, by_sum = np.unique(Sum(terms=tuple(arrays)).piece(x, y), return_inverse=True)
    assert len(set(zip(by_hand.ravel(), by_sum.ravel(), strict=True))) == by_hand.max() + 1 == by_sum.max() + 1


def test_rotated_and_shifted_by_sympy():
    move = {"shift": (0.7, -0.4, 0.25), "rotation": 0.9}
    c, s = sp.cos(sp.Rational(0.9)), sp.sin(sp.Rational(0.9))
    dx, dy = X - sp.Rational(0.7), Y + sp.Rational(0.4)
    formula = grid_formula(c * dx + s * dy, -s * dx + c * dy) + sp.Rational(0.25)
    assert (error(GRID.placed(**move), formula, *disc(5.0)) < 2e-14).all()


@pytest.mark.parametrize("radius", [20.0, -20.0])
def test_a_tilted_sphere_is_a_sphere(radius):
    surface = Sphere(radius=radius).placed(**MOVE)
    cx, cy, cz = (sp.Rational(float(part)) for part in to_part([[0, 0, radius]], **MOVE)[0])
    bow = sp.sqrt(sp.Integer(400) - (X - cx) ** 2 - (Y - cy) ** 2)
    assert (error(surface, cz - int(np.sign(radius)) * bow, *disc(8.0)) < 1e-14).all()


def test_a_tilted_plane_is_a_plane():
    normal = to_part([[-0.3, 0.2, 1.0]], rotation=MOVE["rotation"], tilt=MOVE["tilt"])[0]
    x, y = disc(50.0)
    truth = 0.25 - (normal[0] * (x - 0.7) + normal[1] * (y + 0.4)) / normal[2]
    surface = Plane(slope=(0.3, -0.2)).placed(**MOVE)
    np.testing.assert_allclose(surface.sag(x, y), truth, atol=2e-14)
    np.testing.assert_allclose(computed(surface, x, y)[3:], 0, atol=1e-16)


@pytest.mark.parametrize(
    "surface", [GRID, Expression("rho**2/40 + 0.01*rho**3*cos(3*phi)"), Sphere(radius=12.0) + GRID]
)
def test_points_moved_by_scipy_lie_on_the_moved_surface(surface):
    u, v = disc(3.0, count=400)
    x, y, z = to_part(np.stack([u, v, surface.sag(u, v)], axis=1), **MOVE).T
    np.testing.assert_allclose(surface.placed(**MOVE).sag(x, y), z, atol=5e-15)


def test_derivatives_of_a_tilted_surface_by_mpmath():
    """The height is solved for at 40 digits and differentiated numerically there."""
    turn = (Rotation.from_euler("z", 0.9) * Rotation.from_euler("XY", MOVE["tilt"])).as_matrix()
    surface = GRID.placed(**MOVE)

    def height(x, y):
        def gap(z):
            d = [x - mpmath.mpf(0.7), y + mpmath.mpf(0.4), z - mpmath.mpf(0.25)]
            u, v, w = (sum(mpmath.mpf(turn[k, i]) * d[k] for k in range(3)) for i in range(3))
            parts = zip((u, v), GRID.amplitude, GRID.period, GRID.phase, strict=True)
            return w - sum(a * mpmath.sin(2 * mpmath.pi * q / p + f) for q, a, p, f in parts)

        return mpmath.findroot(gap, mpmath.mpf(float(surface.sag(float(x), float(y)))))

    for x, y in ((0.0, 0.0), (1.3, -0.4), (-2.1, 3.3)):
        with mpmath.workdps(40):
            truth = [float(mpmath.diff(height, (x, y), n)) for n in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))]
        np.testing.assert_allclose(computed(surface, x, y), truth, atol=2e-14)


def test_an_off_axis_parabola_brought_to_the_axis():
    """Textbook curvatures of a paraboloid at its off-axis point: cos^3 / R along the meridian, cos / R across it."""
    vertex_radius, distance = 100.0, 60.0
    lean = np.arctan(distance / vertex_radius)
    # Turn the point's normal upright, and take the point to the origin.
    at = to_part([[distance, 0.0, distance**2 / (2 * vertex_radius)]], tilt=(0.0, lean))[0]
    surface = Expression("rho**2/200").placed(tilt=(0.0, lean), shift=tuple(-at))
    z, zx, zy, zxx, zxy, zyy = computed(surface, 0.0, 0.0)
    np.testing.assert_allclose([z, zx, zy, zxy], 0, atol=2e-14)
    assert zxx == pytest.approx(np.cos(lean) ** 3 / 100, rel=1e-13)
    assert zyy == pytest.approx(np.cos(lean) / 100, rel=1e-13)
    assert surface.inside(*(np.array(part) for part in disc(20.0))).all()


def test_a_sphere_far_from_its_vertex_brought_to_the_axis():
    """No start on the surface's own vertex plane helps here: the line leaves the sphere's disc there."""
    lean = np.arcsin(50 / 60)
    at = to_part([[50.0, 0.0, 60 - np.sqrt(60**2 - 50**2)]], tilt=(0.0, lean))[0]
    surface = Placed(surface=Sphere(radius=60.0), tilt=(0.0, lean), shift=tuple(-at))
    x, y = disc(4.0)
    np.testing.assert_allclose(surface.sag(x, y), 60 - np.sqrt(60**2 - x**2 - y**2), atol=1e-13)


def test_tilted_lenses_meet_in_valleys():
    array = LensArray.hexagonal(pitch=1.0, rings=2, lenslet=Expression("-rho**2/10"))
    u, v = np.random.default_rng(5).uniform(-2, 2, (2, 2000))
    x, y, z = to_part(np.stack([u, v, array.sag(u, v)], axis=1), **MOVE).T
    placed = array.placed(**MOVE)
    np.testing.assert_allclose(placed.sag(x, y), z, atol=5e-15)
    np.testing.assert_array_equal(placed.piece(x, y), array.piece(u, v))


def test_what_overhangs_is_refused():
    # The walls of this wave rise at up to 0.94 in 1; leaning by more than 46 deg makes them overhang.
    wave = SineGrid(amplitude=(0.3, 0.0), period=(2.0, 2.0))
    upright, folded = wave.placed(tilt=(0.0, 0.7)), Placed(surface=wave, tilt=(0.0, 0.9))
    x, y = disc(5.0, count=200)
    assert upright.inside(x, y).all()
    assert not folded.inside(x, y).all()
    with pytest.raises(DomainError, match="overhang"):
        folded.sag(x, y)
    with pytest.raises(DomainError, match="overhang"):
        Sphere(radius=1.0).placed(tilt=(0.5, 0.0)).sag(0.0, -1.4)  # 96 deg up the bowl


def test_a_wall_that_a_tilt_shows_is_refused():
    """A step between a lens and its surround has a height on either side of its wall, none on it."""
    pit = LensArray(centres=[[0.0, 0.0]], lenslet=Plane(), aperture=1.0, surround=0.5)
    x = np.cos(0.3) + 0.5 * np.sin(0.3) * np.array([-0.01, 0.01, 0.5, 0.99, 1.01])
    np.testing.assert_array_equal(pit.placed(tilt=(0.0, 0.3)).inside(x, np.zeros(5)), [True, False, False, False, True])


def test_tilt_leaves_the_feature_size_foreshortened():
    assert Placed(surface=GRID, tilt=(0.0, 1.0)).feature_size == pytest.approx(np.cos(1.0) * 1.7 / 8)
    assert GRID.placed(rotation=1.0).feature_size == pytest.approx(1.7 / 8)
