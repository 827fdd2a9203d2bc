"""What metrology refuses, and what it says of parameters it cannot state."""

import numpy as np
import pytest

from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import remove_form, roughness


def plain(z, **axes):
    z = np.asarray(z, dtype=float)
    return HeightMap(z=z, **({"x": np.arange(z.shape[1]), "y": np.arange(z.shape[0])} | axes))


@pytest.mark.parametrize("form", ["cone", 11, -1, 2.5, True, None])
def test_an_unknown_form_is_named_with_those_there_are(form):
    with pytest.raises(InputError, match=r'form is .*"plane", "sphere" or the degree of a polynomial from 0 to 10'):
        remove_form(plain(np.zeros((5, 5))), form)


def test_a_map_with_fewer_points_than_terms_is_refused():
    z = np.full((5, 5), np.nan)
    z[0, :2] = 0
    with pytest.raises(InputError, match="has 2 valid heights, a form of degree 1 needs 3"):
        roughness(plain(z))
    with pytest.raises(InputError, match="has 2 valid heights, a sphere needs 4"):
        remove_form(plain(z), "sphere")
    with pytest.raises(InputError, match="has 0 valid heights, roughness needs 1"):
        roughness(plain(np.full((3, 3), np.nan)), form="none")


def test_infinite_heights_are_refused():
    with pytest.raises(InputError, match="z holds 1 infinite values"):
        plain([[0, 1], [np.inf, 2]])


def test_axes_that_do_not_ascend_are_refused():
    with pytest.raises(InputError, match="the x of the height map does not ascend"):
        roughness(plain(np.zeros((2, 3)), x=[0, 2, 1]))
    with pytest.raises(InputError, match="radius -1 mm, the limit is 0 mm"):
        roughness(HeightMap(radius=[-1, 1], angle=[0, 1], z=np.zeros((2, 2))))


def test_a_sphere_that_would_end_inside_the_map_is_refused():
    x = np.linspace(-1, 1, 41)
    with pytest.raises(InputError, match=r"the best sphere has a radius of .* remove a polynomial instead"):
        remove_form(plain(5 * np.abs(x) ** 3 + 5 * np.abs(x[:, None]) ** 3, x=x, y=x), "sphere")


def test_a_flat_map_has_no_shape():
    found = roughness(plain(np.zeros((6, 6))), form="none")
    assert found.sq_nm == found.sdr == found.sdq == 0
    assert np.isnan([found.ssk, found.sku, found.sal, found.str]).all()
    assert sum("perfectly flat" in note for note in found.notes) == 2


def test_one_azimuth_has_heights_but_no_area():
    radius = np.linspace(1, 2, 101)
    found = roughness(HeightMap(radius=radius, angle=[0.3], z=np.sin(40 * radius)[None]), form="mean")
    assert found.sq_nm > 0
    assert np.isnan([found.sdq, found.sdr, found.sal, found.str]).all()
    assert any("sdq and sdr" in note for note in found.notes)


def test_an_uneven_or_tiny_grid_has_no_texture():
    z = np.random.default_rng(1).standard_normal((6, 6))
    uneven = roughness(plain(z, x=[0, 1, 2, 3, 4, 6]))
    tiny = roughness(plain(z[:3]))
    for found in (uneven, tiny):
        assert np.isnan([found.sal, found.str]).all()
        assert any("even grid of at least 4 x 4" in note for note in found.notes)


def test_islands_too_far_apart_to_compare_give_no_length():
    # Single pixels eight apart: lags in between have no pairs, so nothing is known of a fall.
    z = np.full((33, 33), np.nan)
    z[::8, ::8] = np.random.default_rng(2).standard_normal((5, 5))
    found = roughness(plain(z), form="mean")
    assert np.isnan([found.sdq, found.sdr, found.sal, found.str]).all()
    assert any("map a larger area" in note for note in found.notes)


def test_only_a_full_revolution_closes_on_its_neighbour():
    angle = np.arange(8) * np.pi / 4
    z = np.zeros((8, 3))
    z[0] = 1.0
    radius = np.array([1.0, 2.0, 3.0])
    whole = roughness(HeightMap(radius=radius, angle=angle, z=z), form="none")
    half = roughness(HeightMap(radius=radius, angle=angle / 2, z=z), form="none")
    # Two steps out of eight on the full turn, one out of seven on the part; each weighs 1/r² with the
    # integral of r times the straight hat over its radius: 4/6, 12/6 and 8/6.
    mean = (4 / 1 + 12 / 4 + 8 / 9) / (4 + 12 + 8)
    assert whole.sdq == pytest.approx(np.sqrt(2 / 8 * mean) / (np.pi / 4))
    assert half.sdq == pytest.approx(np.sqrt(1 / 7 * mean) / (np.pi / 8))
