"""What must hold of any map: heights and lengths scale, turned maps turn, parts add up."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from laws import examples
from turnwright.heightmap import HeightMap
from turnwright.metrology import area_psd, bearing, best_fit, fit_zernike, line_psd, remove_form, slope_error
from turnwright.surface import Sphere

SEEDS = st.integers(0, 2**31)
SETTINGS = examples(15)


def holed(seed, *, missing=0.2, shape=(24, 27)):
    rng = np.random.default_rng(seed)
    z = rng.standard_normal(shape) * 1e-4
    z[rng.random(shape) < missing] = np.nan
    return HeightMap(x=np.arange(shape[1]) * 0.1 - 1.3, y=np.arange(shape[0]) * 0.1 - 1.15, z=z)


def scaled(heights, lengths, factor):
    return HeightMap(x=heights.x * lengths, y=heights.y * lengths, z=heights.z * factor)


@SETTINGS
@given(SEEDS, st.floats(0.01, 100), st.floats(0.01, 100))
def test_heights_and_lengths_scale(seed, lengths, factor):
    one, other = holed(seed), scaled(holed(seed), lengths, factor)
    first, second = (fit_zernike(heights, terms=10, indexing="noll") for heights in (one, other))
    assert second.coefficients == pytest.approx(first.coefficients * factor, rel=1e-9, abs=1e-15 * factor)
    assert second.radius == pytest.approx(first.radius * lengths)
    first, second = (
        slope_error(heights, integration_length=0.3 * size) for heights, size in ((one, 1), (other, lengths))
    )
    assert second.rms == pytest.approx(first.rms * factor / lengths)
    first, second = (line_psd(heights, along="x", missing="mask") for heights in (one, other))
    assert second.density == pytest.approx(
        first.density * factor**2 * lengths, rel=1e-6, abs=1e-9 * factor**2 * lengths
    )
    first, second = (area_psd(heights, missing="mask") for heights in (one, other))
    assert second.rms_nm == pytest.approx(first.rms_nm * factor)
    first, second = (bearing(heights) for heights in (one, other))
    assert second.sk_nm == pytest.approx(first.sk_nm * factor)
    assert second.smr1 == pytest.approx(first.smr1, abs=1e-9)


@SETTINGS
@given(SEEDS, st.integers(0, 10))
def test_a_form_is_removed_once_and_for_all(seed, degree):
    left = remove_form(holed(seed), degree)
    again = remove_form(left, degree)
    assert np.nanmax(np.abs(again.z - left.z)) < 1e-15
    # What is left is at right angles to the form: nothing of a lower degree is in it.
    assert np.nanmax(np.abs(remove_form(left, degree // 2).z - left.z)) < 1e-15


@SETTINGS
@given(SEEDS)
def test_a_map_turned_by_a_right_angle_has_its_terms_turned(seed):
    one = holed(seed, shape=(27, 27))
    one = HeightMap(x=one.x, y=one.x, z=one.z)
    turned = HeightMap(x=one.x, y=one.x, z=np.rot90(one.z, -1))  # a row of x becomes one of y: counter-clockwise seen
    first, second = (
        fit_zernike(heights, terms=9, indexing="fringe", radius=1.9, centre=(0, 0)).terms for heights in (one, turned)
    )
    # (x, y) goes to (-y, x): tilt x is found as tilt y, y as minus x; astigmatism changes sign; power stays.
    assert second[4] == pytest.approx(first[4], abs=1e-15)
    assert second[9] == pytest.approx(first[9], abs=1e-15)
    assert (second[5], second[6]) == pytest.approx((-first[5], -first[6]), abs=1e-15)
    assert (second[3], second[2]) == pytest.approx((first[2], -first[3]), abs=1e-15)
    assert (second[8], second[7]) == pytest.approx((first[7], -first[8]), abs=1e-15)


@SETTINGS
@given(SEEDS, st.floats(2.2, 1e4), st.sampled_from([-1, 1]), st.sampled_from(["vertical", "normal"]))
def test_any_sphere_is_found_and_a_shift_moves_it(seed, radius, sign, distance):
    rng = np.random.default_rng(seed)
    x0, y0, z0 = rng.uniform(-0.3, 0.3, 3)
    heights = holed(seed)
    sphere = Sphere(radius=sign * radius).placed(shift=(x0, y0, z0))
    z = np.where(np.isnan(heights.z), np.nan, sphere.evaluate(*heights.points(), 0)[0])
    found = best_fit(HeightMap(x=heights.x + 7, y=heights.y - 3, z=z - 2), "sphere", distance=distance)
    assert found.parameters["radius"] == pytest.approx(sign * radius, rel=1e-9 * radius)
    assert found.parameters["x"] == pytest.approx(x0 + 7, abs=1e-11 * radius**2)
    assert found.parameters["z"] == pytest.approx(z0 - 2, abs=1e-11 * radius**2)
    assert found.rms_nm < 1e-7


@SETTINGS
@given(SEEDS, st.floats(0.1, 3.0))
def test_bands_add_up_in_squares(seed, border):
    for spectrum in (area_psd(holed(seed), missing="mask"), line_psd(holed(seed), along="y", missing="mask")):
        low, high = spectrum.band_rms_nm(0, border), spectrum.band_rms_nm(border, np.inf)
        assert low**2 + high**2 == pytest.approx(spectrum.rms_nm**2)
