"""Laws of filters and cleaning: linear, blind to order and place, nothing lost between bands."""

from dataclasses import replace

import numpy as np
from hypothesis import assume, given, strategies as st

from laws import examples
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import Nesting, filter_map, remove_outliers, separate_bands, trim_edge

STEP = 0.02


@st.composite
def maps(draw):
    """Noise of 1 with missing points on a small even grid."""
    shape = draw(st.integers(8, 24)), draw(st.integers(8, 24))
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    z = rng.normal(size=shape)
    z[rng.random(shape) < draw(st.sampled_from([0.0, 0.1, 0.4]))] = np.nan
    z[4, 4] = 0.3
    return HeightMap(x=STEP * np.arange(shape[1]), y=STEP * np.arange(shape[0]), z=z)


orders = st.sampled_from([0, 1, 2])
kinds = st.sampled_from(["gaussian", "robust"])
cutoffs = st.floats(5 * STEP, 8 * STEP)


@examples(25)
@given(maps(), orders, cutoffs, st.floats(-50, 50), st.floats(0.1, 10))
def test_gaussian_filters_are_linear_and_keep_constants(heights, order, cutoff, up, scale):
    other = replace(heights, z=np.cos(np.arange(heights.z.size)).reshape(heights.z.shape) + 0 * heights.z)
    both = replace(heights, z=up + scale * heights.z + other.z)
    expected = up + scale * filter_map(heights, cutoff, order=order).z + filter_map(other, cutoff, order=order).z
    np.testing.assert_allclose(filter_map(both, cutoff, order=order).z, expected, atol=1e-10 * (abs(up) + scale + 1))


@examples(15)
@given(maps(), kinds, orders, cutoffs, st.floats(0.01, 100))
def test_heights_and_lengths_scale_apart(heights, kind, order, cutoff, k):
    found = filter_map(heights, cutoff, kind=kind, order=order).z
    larger = HeightMap(x=k * heights.x, y=k * heights.y, z=2 * heights.z)
    np.testing.assert_allclose(filter_map(larger, k * cutoff, kind=kind, order=order).z, 2 * found, atol=1e-8)


@examples(15)
@given(maps(), kinds, orders, cutoffs)
def test_a_turned_map_gives_a_turned_result(heights, kind, order, cutoff):
    found = filter_map(heights, cutoff, kind=kind, order=order).z
    turned = HeightMap(x=heights.y, y=heights.x, z=heights.z.T[:, ::-1])
    np.testing.assert_allclose(filter_map(turned, cutoff, kind=kind, order=order).z, found.T[:, ::-1], atol=1e-8)


@examples(15)
@given(maps(), kinds, st.sampled_from(["none", "mean", "plane", 2]))
def test_bands_add_up_to_what_was_measured(heights, kind, form):
    try:
        bands = separate_bands(heights, Nesting(s_filter=5 * STEP, form=form, l_filter=7 * STEP, kind=kind))
    except InputError as error:  # the robust filter of few heights
        assume("has not converged" not in str(error))
        raise
    total = bands.noise.z + bands.form.z + bands.waviness.z + bands.roughness.z
    np.testing.assert_allclose(total, heights.z, atol=1e-12)
    np.testing.assert_array_equal(np.isnan(bands.roughness.z), np.isnan(heights.z))


@examples(15)
@given(st.integers(0, 2**16), st.floats(-3, 3), st.floats(-3, 3), st.sampled_from(["robust", "kong"]))
def test_spikes_are_the_same_upside_down_on_a_slope_and_turned(seed, slope, height, rule):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(25, 31))
    z[rng.random(z.shape) < 0.02] += 40
    z[rng.random(z.shape) < 0.1] = np.nan
    plain = HeightMap(x=np.arange(31.0), y=np.arange(25.0), z=z)
    spikes = remove_outliers(plain, rule=rule).outliers
    tilted = replace(plain, z=height - z + slope * np.arange(31))
    np.testing.assert_array_equal(remove_outliers(tilted, rule=rule).outliers, spikes)
    turned = HeightMap(x=plain.y, y=plain.x, z=z.T)
    np.testing.assert_array_equal(remove_outliers(turned, rule=rule).outliers, spikes.T)


@examples(20)
@given(st.integers(0, 2**16), st.floats(0.5, 2.5), st.floats(0.5, 2.5))
def test_a_wider_trim_leaves_less(seed, one, other):
    z = np.ones((30, 40))
    z[np.random.default_rng(seed).random(z.shape) < 0.01] = np.nan
    z[12:20, 12:20] = 1.0  # whatever goes, the middle of this stays
    whole = HeightMap(x=np.arange(40.0), y=np.arange(30.0), z=z)
    narrow, wide = sorted((one, other))
    kept = np.isfinite(trim_edge(whole, wide).z)
    assert kept[15, 15]
    assert not (kept & ~np.isfinite(trim_edge(whole, narrow).z)).any()
