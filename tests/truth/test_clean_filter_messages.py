"""What cleaning and filters refuse, in one sentence, and what they make of odd maps."""

import numpy as np
import pytest

from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import (
    Nesting,
    crop_to_aperture,
    fill_holes,
    filter_map,
    remove_outliers,
    separate_bands,
    trim_edge,
)

Z = np.random.default_rng(1).normal(size=(40, 50))


def flat(z=Z, **axes):
    z = np.asarray(z, dtype=float)
    return HeightMap(z=z, **({"x": 0.01 * np.arange(z.shape[1]), "y": 0.01 * np.arange(z.shape[0])} | axes))


POLAR = HeightMap(z=Z, radius=0.01 * np.arange(50), angle=0.1 * np.arange(40))
CLOUD = HeightMap(z=Z[0], x=np.arange(50.0), y=np.arange(50.0))
PIXELS = HeightMap(z=Z, x=np.arange(50.0), y=np.arange(40.0), calibrated=False)


@pytest.mark.parametrize(
    ("heights", "arguments", "sentence"),
    [
        (flat(), {"kind": "median"}, 'the kind of filter is \'median\', it must be "gaussian", "robust" or "spline"'),
        (flat(), {"order": 3}, "the order of the filter is 3, it must be 0, 1 or 2"),
        (flat(), {"kind": "spline"}, "a spline filter works along lines and has no order: give along"),
        (flat(), {"kind": "spline", "along": "x", "order": 1}, "has no order"),
        (flat(), {"along": "z"}, "the direction of the lines is 'z'"),
        (flat(), {"along": "radius"}, "the rectangular map cannot be filtered over lines along radius: use along="),
        (POLAR, {}, "the polar map cannot be filtered over areas: use its lines .* or bring it to a rectangular grid"),
        (POLAR, {"along": "x"}, "the polar map cannot be filtered over lines along x"),
        (CLOUD, {}, "the 50 heights are scattered points"),
        (PIXELS, {}, "no pixel size"),
        (flat(np.full((4, 4), np.nan)), {}, "has 0 valid heights, a filter needs 1"),
        (flat(Z[:1, :1]), {}, "the map along x has 1 points, a filter needs at least 2"),
        (flat(Z[:1]), {"along": "y"}, "the map along y has 1 points, a filter needs at least 2"),
        (flat(x=np.arange(50.0) ** 2), {}, "the map along x has 50 points in uneven steps, a filter"),
    ],
)
def test_filters_say_what_they_cannot_do(heights, arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        filter_map(heights, 0.1, **arguments)


@pytest.mark.parametrize(
    ("cutoff", "sentence"),
    [
        (0.049, r"the cutoff must be at least 0.05 mm \(5 steps of the grid\), got 0.049 mm"),
        (0.51, r"the cutoff must be at most 0.5 mm \(the extent of the map\), got 0.51 mm"),
        (0.0, "the cutoff is 0 mm, it must be finite and above 0 mm"),
        (np.nan, "the cutoff is nan mm, it must be finite"),
    ],
)
def test_a_cutoff_must_fit_the_grid(cutoff, sentence):
    with pytest.raises(InputError, match=sentence):
        filter_map(flat(), cutoff)


def test_an_uneven_axis_does_not_matter_along_the_other():
    uneven = flat(y=np.arange(40.0) ** 2)
    np.testing.assert_array_equal(filter_map(uneven, 0.1, along="x").z, filter_map(flat(), 0.1, along="x").z)


@pytest.mark.parametrize(
    ("s_filter", "l_filter", "sentence"),
    [
        (
            0.8,
            0.08,
            "the nesting index of the S-filter must be below that of the L-filter, 0.08 mm, got 0.8 mm",
        ),
        (0.1, 0.1, "S-filter must be below .* 0.1 mm"),
        (-1.0, 0.1, "the nesting index of the S-filter is -1 mm, it must be finite and above 0"),
        (None, np.inf, "l_filter is inf"),
    ],
)
def test_nesting_indices_stand_in_order(s_filter, l_filter, sentence):
    with pytest.raises(InputError, match=sentence):
        Nesting(s_filter=s_filter, form="plane", l_filter=l_filter)


def test_nesting_indices_must_fit_the_grid():
    with pytest.raises(
        InputError, match=r"the nesting index of the S-filter must be at least .* \(5 steps.*, got 0.01 mm"
    ):
        separate_bands(flat(), Nesting(s_filter=0.01, form="plane", l_filter=0.2))
    with pytest.raises(
        InputError, match=r"the nesting index of the L-filter must be at most .* \(the extent.*, got 2 mm"
    ):
        separate_bands(flat(), Nesting(s_filter=0.05, form="plane", l_filter=2.0))
    with pytest.raises(InputError, match="a spline filter works along lines"):
        Nesting(s_filter=None, form="plane", l_filter=0.2, kind="spline")


def test_without_filters_only_the_form_is_taken_off():
    bands = separate_bands(flat(), Nesting(s_filter=None, form="mean", l_filter=None))
    assert np.abs(bands.noise.z).max() == np.abs(bands.waviness.z).max() == 0
    np.testing.assert_allclose(bands.roughness.z, Z - Z.mean(), atol=1e-12)


def test_a_map_of_one_line_is_a_profile():
    line = flat(Z[:1])
    for order in (0, 1, 2):
        np.testing.assert_allclose(
            filter_map(line, 0.1, order=order).z, filter_map(line, 0.1, order=order, along="x").z, atol=1e-13
        )
        column = flat(Z[:1].T)
        np.testing.assert_allclose(
            filter_map(column, 0.1, order=order).z.T, filter_map(line, 0.1, order=order).z, atol=1e-13
        )


def test_single_points_and_empty_lines_are_filtered():
    z = np.full((40, 50), np.nan)
    z[5, 7] = 3.0
    for order in (0, 1, 2):
        assert filter_map(flat(z), 0.06, order=order).z[5, 7] == pytest.approx(3.0)
        found = filter_map(flat(z), 0.06, order=order, along="x").z
        assert found[5, 7] == pytest.approx(3.0)
        assert np.isnan(found).sum() == 1999
    assert np.isnan(filter_map(flat(z), 0.06, kind="spline", along="x").z).all()
    z[5, 9] = 4.0
    np.testing.assert_allclose(filter_map(flat(z), 0.06, kind="robust", along="x").z[5, [7, 9]], [3, 4], atol=0.5)


@pytest.mark.parametrize(
    ("heights", "arguments", "sentence"),
    [
        (flat(), {"rule": "median"}, 'the rule is \'median\', it must be "robust" or "kong"'),
        (flat(), {"threshold": 0.0}, "the threshold is 0 deviations, it must be finite and above 0"),
        (CLOUD, {}, "the 50 heights are scattered points"),
        (PIXELS, {}, "no pixel size"),
        (flat(np.full((4, 4), np.nan)), {}, "has 0 valid heights, outlier removal needs 3"),
    ],
)
def test_outlier_removal_refuses_what_it_cannot_do(heights, arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        remove_outliers(heights, **arguments)


def test_trimming_and_cropping_say_when_nothing_is_left():
    with pytest.raises(InputError, match="trimming 1 mm leaves no point of the map"):
        trim_edge(flat(), 1.0)
    with pytest.raises(InputError, match="the width to trim is 0 mm"):
        trim_edge(flat(), 0.0)
    with pytest.raises(InputError, match="scattered"):
        trim_edge(CLOUD, 1.0)
    with pytest.raises(InputError, match=r"no valid height lies within 0.1 mm of the origin"):
        crop_to_aperture(flat(x=5 + 0.01 * np.arange(50)), 0.1)
    with pytest.raises(InputError, match="the radius of the aperture is -1 mm"):
        crop_to_aperture(flat(), -1.0)


@pytest.mark.parametrize("heights", [POLAR, flat(x=np.arange(50.0) ** 2), flat(Z[:2])])
def test_holes_are_filled_on_even_grids_only(heights):
    with pytest.raises(InputError, match=r"filling holes needs (a rectangular one|at least 3 in even steps)"):
        fill_holes(heights, 0.1)


def test_a_line_has_spikes_too_and_a_lone_point_is_not_judged():
    z = np.random.default_rng(2).normal(0, 1e-5, (1, 200))
    z[0, 77] = 1e-2
    found = remove_outliers(flat(z))
    assert np.flatnonzero(found.outliers).tolist() == [77]
    z = np.random.default_rng(2).normal(0, 1e-5, (40, 50))
    z[10:20, 10:20] = np.nan
    z[15, 15] = 1.0
    assert remove_outliers(flat(z)).unjudged == 1
