"""Lens arrays against brute force over all centres, SymPy, and counting by hand."""

import numpy as np
import pytest
import sympy as sp

from surface_oracle import X, Y, error
from turnwright.errors import DomainError
from turnwright.surface import Expression, LensArray, Plane, SineGrid, Sphere

BOWL = Expression("rho**2/20")
RNG = np.random.default_rng(11)
ARRAYS = {
    "square": LensArray.square(pitch=0.9, rows=4, columns=7, lenslet=BOWL, offset=(0.2, -0.1)),
    "hexagonal": LensArray.hexagonal(pitch=1.1, rings=3, lenslet=BOWL),
    "whole": LensArray.hexagonal(pitch=0.4, within=3.0, lenslet=BOWL),
    "one": LensArray(centres=[[0.5, 0.25]], lenslet=BOWL),
    "row": LensArray(centres=np.stack([np.linspace(-3, 3, 9), np.full(9, 0.3)], axis=1), lenslet=BOWL),
    "scattered": LensArray(centres=RNG.normal(size=(60, 2)), lenslet=BOWL),
    "clustered": LensArray(
        centres=np.concatenate([RNG.normal(size=(40, 2)) * 0.01, RNG.uniform(-4, 4, (10, 2))]), lenslet=BOWL
    ),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_the_nearest_centre_decides_by_brute_force(name):
    array = ARRAYS[name]
    # Some points close to the centres, some over the array, some far away; and a walk, close to the one before.
    scale = RNG.choice([0.02, 4.0, 100.0], 3000)
    x, y = np.hstack([RNG.uniform(-1, 1, (2, 3000)) * scale, RNG.normal(size=(2, 3000)).cumsum(axis=1) * 0.07])
    distance = np.hypot(x[:, None] - array.centres[:, 0], y[:, None] - array.centres[:, 1])
    piece = array.piece(x, y)
    chosen = distance[np.arange(x.size), piece]
    assert (chosen <= distance.min(axis=1) * (1 + 4e-16) + 1e-15).all()
    np.testing.assert_allclose(array.sag(x, y), chosen**2 / 20, rtol=1e-14)


@pytest.mark.parametrize("far", [np.inf, -np.inf, 1e200])
def test_a_point_that_no_distance_reaches_is_over_some_lens(far):
    x, y = np.array([far]), np.array([0.0])
    assert ARRAYS["row"].piece(x, y)[0] in range(9)
    with pytest.raises(DomainError, match="not defined at x = "):
        ARRAYS["row"].sag(x, y)


@pytest.mark.parametrize("name", ["square", "hexagonal"])
def test_on_a_border_the_first_of_the_nearest_has_the_point(name):
    array = ARRAYS[name]
    pairs = [(i, j) for i in range(len(array.centres)) for j in range(i)]
    a, b = (array.centres[[pair[k] for pair in pairs]] for k in (0, 1))
    close = np.hypot(*(a - b).T) < 1.2
    middle = ((a + b) / 2)[close]
    piece = array.piece(*np.ascontiguousarray(middle.T))
    distance = np.hypot(*(middle[:, None, :] - array.centres).T).T
    np.testing.assert_allclose(distance[np.arange(len(middle)), piece], distance.min(axis=1), rtol=1e-14)


def test_piece_and_height_agree_to_the_last_bit_across_a_border():
    """A search bisects on the piece down to neighbouring numbers; the height must change sides with it."""
    array = LensArray.square(pitch=1.0, rows=1, columns=2, lenslet=Expression("x"))
    low, high = np.array(-0.3), np.array(0.3)
    for _ in range(80):
        middle = np.asarray((low + high) / 2)
        low, high = (middle, high) if array.piece(middle, np.array(0.17)) == 0 else (low, middle)
    assert high - low <= 1e-16
    assert array.sag(low, 0.17) == pytest.approx(0.5)
    assert array.sag(high, 0.17) == pytest.approx(-0.5)


@pytest.mark.parametrize(
    "surface",
    [
        ARRAYS["hexagonal"],
        ARRAYS["hexagonal"].placed(rotation=0.3) + ARRAYS["square"] + Sphere(radius=20.0),
    ],
    ids=["array", "sum"],
)
def test_convex_pieces_meet_a_line_in_one_interval(surface):
    assert surface.convex_pieces
    along, random = np.linspace(-4, 4, 2001), np.random.default_rng(5)
    for angle, across in zip(random.uniform(0, np.pi, 50), random.uniform(-2, 2, 50), strict=True):
        c, s = np.cos(angle), np.sin(angle)
        numbers = surface.piece(along * c - across * s, along * s + across * c)
        assert np.unique(numbers).size == 1 + np.count_nonzero(np.diff(numbers))


@pytest.mark.parametrize(
    "surface",
    [
        Sphere(radius=5.0),
        LensArray.square(pitch=1.0, rows=3, columns=3, lenslet=Sphere(radius=5.0), aperture=0.4, surround=0.0),
        LensArray.square(pitch=1.0, rows=3, columns=3, lenslet=Sphere(radius=5.0)).placed(tilt=(0.1, 0.0)),
    ],
    ids=["smooth", "surround", "tilted"],
)
def test_pieces_that_may_not_be_convex_are_not_called_so(surface):
    assert not surface.convex_pieces
    assert not (surface + Sphere(radius=20.0)).convex_pieces


def test_one_lens_by_sympy():
    array = LensArray(centres=[[0.5, 0.25]], lenslet=Sphere(radius=8.0))
    s = (X - sp.Rational(1, 2)) ** 2 + (Y - sp.Rational(1, 4)) ** 2
    x, y = RNG.uniform(-3, 3, (2, 30))
    assert (error(array, 8 - sp.sqrt(64 - s), x, y) < 2e-14).all()


def test_lattices_stand_where_geometry_says():
    square = LensArray.square(pitch=2.0, rows=2, columns=3, lenslet=BOWL).centres
    np.testing.assert_allclose(square, [(x, y) for y in (-1, 1) for x in (-2, 0, 2)])
    ring = LensArray.hexagonal(pitch=2.0, rings=1, lenslet=BOWL).centres
    corners = 2 * np.exp(1j * np.arange(6) * np.pi / 3)
    np.testing.assert_allclose(
        np.sort_complex(np.round(ring @ [1, 1j], 9)), np.sort_complex(np.round([0, *corners], 9)), atol=1e-9
    )
    for rings in range(5):
        assert len(LensArray.hexagonal(pitch=1.0, rings=rings, lenslet=BOWL).centres) == 3 * rings * (rings + 1) + 1


def test_only_whole_lenses_stand_within_a_circle():
    """Kong's 7 x 7 lenses at 2 mm on 15 mm: counted by hand, rows of 3, 5, 7, 7, 7, 5, 3 are whole."""
    kong = LensArray.square(pitch=2.0, within=7.5, lenslet=BOWL).centres
    _, rows = np.unique(kong[:, 1], return_counts=True)
    np.testing.assert_array_equal(rows, [3, 5, 7, 7, 7, 5, 3])
    assert len(LensArray.square(pitch=2.0, within=1.0, lenslet=BOWL).centres) == 1
    assert len(LensArray.square(pitch=2.0, within=1.0 + np.sqrt(2), offset=(1, 1), lenslet=BOWL).centres) == 4
    assert len(LensArray.hexagonal(pitch=2.0, within=3.0, lenslet=BOWL).centres) == 7
    assert len(LensArray.hexagonal(pitch=2.0, within=2.9, lenslet=BOWL, aperture=0.9, surround=0.0).centres) == 7


@pytest.mark.parametrize("offset", [(0.0, 0.0), (3.7, -8.1)])
def test_no_whole_lens_of_an_offset_lattice_is_missed(offset):
    """Counted over a lattice far larger than the circle."""
    i, j = np.meshgrid(np.arange(-60, 61), np.arange(-60, 61))
    slanted = np.hypot(offset[0] + i + j / 2, offset[1] + j * np.sqrt(3) / 2)
    assert (
        len(LensArray.hexagonal(pitch=1.0, within=9.7, offset=offset, lenslet=BOWL).centres) == (slanted <= 9.2).sum()
    )
    upright = np.hypot(offset[0] + i, offset[1] + j)
    assert len(LensArray.square(pitch=1.0, within=9.7, offset=offset, lenslet=BOWL).centres) == (upright <= 9.2).sum()


def test_round_lenses_stand_in_their_surround():
    dome = Sphere(radius=-5.0)
    array = LensArray.square(pitch=2.0, rows=2, columns=2, lenslet=dome, aperture=0.8, surround=Plane(slope=(0.1, 0.0)))
    x, y = RNG.uniform(-3, 3, (2, 500))
    u, v = np.abs(np.abs(x) - 1), np.abs(np.abs(y) - 1)
    lens = np.hypot(u, v) <= 0.8
    np.testing.assert_allclose(
        array.sag(x, y), np.where(lens, np.sqrt(25 - np.where(lens, u**2 + v**2, 0)) - 5, 0.1 * x), atol=1e-15
    )
    np.testing.assert_array_equal(array.piece(x, y) == 4, ~lens)
    flat = LensArray(centres=array.centres, lenslet=dome, aperture=0.8, surround=0.25)
    for found, around in zip(flat.evaluate(x, y, 2), (0.25, 0, 0, 0, 0, 0), strict=True):
        np.testing.assert_array_equal(found[~lens], around)
    assert float(flat.sag(0.0, 0.0)) == 0.25


def test_the_lenslet_limits_the_domain():
    array = LensArray.square(pitch=2.0, rows=2, columns=2, lenslet=Sphere(radius=1.2))
    np.testing.assert_array_equal(array.inside(np.array([0.0, 1.0]), np.array([0.0, 1.0])), [False, True])
    with pytest.raises(DomainError, match="about the nearest lens centre"):
        array.sag(0.0, 0.0)
    filled = LensArray(centres=array.centres, lenslet=Sphere(radius=1.2), aperture=1.0, surround=0.0)
    assert filled.inside(np.zeros(1), np.zeros(1)).all()
    walled = LensArray(centres=array.centres, lenslet=BOWL, aperture=1.0, surround=Sphere(radius=1.5))
    np.testing.assert_array_equal(walled.inside(np.array([0.0, 1.0, 3.0]), np.array([0.0, 1.0, 0.0])), [1, 1, 0])


def test_the_finest_structure_counts():
    fine = SineGrid(amplitude=(1e-4, 0.0), period=(0.1, 1.0))
    assert LensArray.square(pitch=2.0, rows=2, columns=2, lenslet=BOWL).feature_size == 0.25
    assert LensArray.square(pitch=2.0, rows=2, columns=2, lenslet=fine).feature_size == pytest.approx(0.0125)
    assert LensArray(centres=[[0, 0]], lenslet=BOWL).feature_size == np.inf


def test_many_points_are_evaluated_as_few_are():
    """In chunks on all cores: the same bits, and one message for all points outside."""
    array = LensArray.square(pitch=1.0, rows=9, columns=9, lenslet=Sphere(radius=0.8))
    x, y = np.random.default_rng(5).uniform(-4.5, 4.5, (2, 3, 40_000))
    few = [np.stack(array.hessian(x[:, part], y[:, part])) for part in np.array_split(np.arange(40_000), 7)]
    np.testing.assert_array_equal(np.stack(array.hessian(x, y)), np.concatenate(few, axis=2))
    x[1, 39_000:39_010], x[0, 7] = 9.0, -8.5
    with pytest.raises(DomainError, match=r"at x = -8.5 mm, .* \(11 of 120000 points\)"):
        array.sag(x, y)


@pytest.mark.parametrize(
    "surface",
    [
        LensArray.square(pitch=0.7, rows=5, columns=4, lenslet=Sphere(radius=3.0)),
        LensArray.hexagonal(pitch=0.5, rings=3, lenslet=Sphere(radius=3.0), aperture=0.2, surround=0.0),
        LensArray.hexagonal(pitch=0.5, rings=3, lenslet=Sphere(radius=3.0)).placed(shift=(0.1, -0.2, 0.3), rotation=0.4)
        + Plane(slope=(0.1, 0.0)),
    ],
    ids=["square", "round", "placed and sloping"],
)
def test_a_border_is_where_the_piece_changes(surface):
    """Oracle: bisection between points of two pieces, whose border has no third piece on the line at its root."""
    rng = np.random.default_rng(3)
    a, b = rng.uniform(-1.2, 1.2, (2, 2, 500))
    first, second = surface.piece(*a), surface.piece(*b)
    apart = first != second
    a, b, first, second = a[:, apart], b[:, apart], first[apart], second[apart]
    assert (surface.border(first, second, *a) > 0).all()
    assert (surface.border(first, second, *b) < 0).all()
    low, high = a.copy(), b.copy()
    for _ in range(60):
        middle = (low + high) / 2
        mine = surface.piece(*middle) == first
        low, high = np.where(mine, middle, low), np.where(mine, high, middle)
    met = surface.piece(*high) == second
    assert met.sum() > 50
    value = [surface.border(first, second, *side)[met] for side in (low, high)]
    assert np.abs(value).max() < 1e-14
