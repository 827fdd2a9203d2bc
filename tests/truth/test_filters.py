"""Filters against dense sums, the transmission of waves in closed form, SciPy's convolution, surfalize and mpmath."""

import mpmath
import numpy as np
import pytest
from scipy import ndimage

from cases import every_second
from turnwright.heightmap import HeightMap
from turnwright.metrology import Nesting, filter_map, separate_bands

STEP = 0.01
LOWER = -1 - mpmath.lambertw(-1 / (2 * mpmath.e), -1)
WIDTHS = [float(mpmath.sqrt(mpmath.log(2) / mpmath.pi))] * 2 + [float(mpmath.sqrt(LOWER.real / mpmath.pi))]
"""Of the Gaussian over the cutoff: exp(-pi a²) = 1/2, and for order 2 (1 + b) exp(-b) = 1/2 at b = pi a²."""


def rough_map(shape, *, missing=0.1, seed=1):
    rng = np.random.default_rng(seed)
    z = 1e-3 + rng.normal(0, 1e-4, shape)
    z[rng.random(shape) < missing] = np.nan
    z[3:9, 12:20] = np.nan
    z[:7, :5] = np.nan
    return HeightMap(x=STEP * np.arange(shape[1]), y=2 + 0.7 * STEP * np.arange(shape[0]), z=z)


def dense(x, y, z, weight, width, order):
    """At every point the weighted least squares of a polynomial, by lstsq over all points. z nan weighs nothing."""
    x, y = np.meshgrid(x, y)
    known = ~np.isnan(z)
    out = np.full(z.shape, np.nan)
    for i, j in np.argwhere(known):
        u, v = (x[known] - x[i, j]) / width, (y[known] - y[i, j]) / width
        root = np.sqrt(weight[known] * np.exp(-np.pi * (u * u + v * v)))
        terms = np.stack([u**a * v**b for a in range(order + 1) for b in range(order + 1 - a)], axis=1)
        out[i, j] = np.linalg.lstsq(terms * root[:, None], z[known] * root, rcond=None)[0][0]
    return out


@pytest.mark.parametrize(("cutoff", "order"), every_second([0.05, 0.13, 0.4], range(3)))
def test_filter_is_the_dense_regression_with_missing_data_too(order, cutoff):
    rough = rough_map((34, 43))
    found = filter_map(rough, cutoff, order=order)
    expected = dense(rough.x, rough.y, rough.z, np.ones(rough.z.shape), WIDTHS[order] * cutoff, order)
    np.testing.assert_array_equal(np.isnan(found.z), np.isnan(rough.z))
    # Heights vary by 1e-4 mm: 1e-12 of that.
    np.testing.assert_allclose(found.z, expected, rtol=0, atol=1e-16)


@pytest.mark.parametrize("along", ["x", "y", "radius"])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_lines_are_dense_regressions_each_for_itself(along, order):
    rough = rough_map((20, 43))
    if along == "radius":
        rough = HeightMap(radius=rough.x, angle=0.1 * np.arange(20), z=rough.z)
    found = filter_map(rough, 0.1, order=order, along=along)
    lines, axis = (rough.z.T, rough.y) if along == "y" else (rough.z, STEP * np.arange(43))
    width = WIDTHS[order] * 0.1
    for line, got in zip(lines, found.z.T if along == "y" else found.z, strict=True):
        expected = np.full(line.size, np.nan)
        known = ~np.isnan(line)
        for k in np.flatnonzero(known):
            u = (axis[known] - axis[k]) / width
            root = np.exp(-np.pi * u * u / 2)
            terms = np.vander(u, order + 1) * root[:, None]
            expected[k] = np.linalg.lstsq(terms, line[known] * root, rcond=None)[0][-1]
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-15)


def kept(wavelength, cutoff, order, *, slant=0.0, n=401, kind="gaussian", along=None):
    """Share of a wave that passes in the middle of a large map, by least squares against the wave."""
    x = STEP * (np.arange(n) - n // 2)
    phase = 2 * np.pi * (np.cos(slant) * x + np.sin(slant) * x[:, None]) / wavelength
    wave = HeightMap(x=x, y=x, z=np.cos(phase))
    found = filter_map(wave, cutoff, kind=kind, order=order, along=along)
    middle = n // 2
    return found.z[middle, middle]


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("slant", [0.0, 0.4, np.pi / 4])
@pytest.mark.parametrize("cutoff", [0.05, 0.1, 0.73])
def test_half_of_a_wave_passes_at_the_cutoff_in_every_direction(order, slant, cutoff):
    assert kept(cutoff, cutoff, order, slant=slant) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize("ratio", [0.5, 0.8, 1.5, 3.0])
def test_waves_pass_as_in_closed_form(ratio):
    a = np.log(2) / ratio**2
    b = float(LOWER.real) / ratio**2
    assert kept(0.4 * ratio, 0.4, 0) == pytest.approx(np.exp(-a), abs=1e-6)
    assert kept(0.4 * ratio, 0.4, 1) == pytest.approx(np.exp(-a), abs=1e-6)
    assert kept(0.4 * ratio, 0.4, 2) == pytest.approx((1 + b) * np.exp(-b), abs=1e-6)


def test_cusps_keep_their_fourier_series():
    """A parabola repeated: z = 1/12 + sum of (-1)^k / (pi k)² cos(2 pi k x), each term less by its transmission."""
    period, n = 0.5, 1000
    x = STEP / 4 * np.arange(n)
    t = (x / period + 0.5) % 1 - 0.5
    cusps = HeightMap(x=x, y=x[:4], z=np.tile(t**2, (4, 1)))
    found = filter_map(cusps, 0.25, order=0)
    k = np.arange(1, 40)[:, None]
    series = (-1.0) ** k / (np.pi * k) ** 2 * np.exp(-np.log(2) * (0.25 * k / period) ** 2)
    expected = 1 / 12 + (series * np.cos(2 * np.pi * k * x / period)).sum(axis=0)
    inner = slice(300, 700)
    # The series is that of the continuous parabola; 200 samples alias by 1 / (6 200²) in the mean and twice that in
    # each of the few waves that pass, 1.8e-5 at the peak.
    np.testing.assert_allclose(found.z[1, inner], expected[inner], rtol=0, atol=1.9e-5)


def test_a_whole_map_agrees_with_scipy_and_surfalize():
    from surfalize import Surface as Peer

    z = ndimage.gaussian_filter(np.random.default_rng(4).normal(size=(240, 260)), 4) * 1e-3
    x, y = STEP * np.arange(260), STEP * np.arange(240)
    cutoff = 0.3
    ours = filter_map(HeightMap(x=x, y=y, z=z), cutoff, order=0).z
    sigma = cutoff / STEP * np.sqrt(np.log(2) / 2) / np.pi
    near = ndimage.gaussian_filter(z, sigma, truncate=8)
    inner = (slice(90, -90), slice(90, -90))
    np.testing.assert_allclose(ours[inner], near[inner], rtol=0, atol=1e-9 * z.std())
    peer = Peer(z * 1e3, STEP * 1e3, STEP * 1e3).filter("lowpass", cutoff * 1e3).data * 1e-3
    # surfalize cuts its kernel at four deviations, 6e-5 of it.
    assert np.abs(ours - peer)[inner].max() < 1e-3 * z.std()


@pytest.mark.parametrize("order", [1, 2])
def test_planes_and_forms_pass_unchanged_to_borders_and_holes(order):
    rough = rough_map((34, 43))
    x, y = rough.points()
    form = 3 * x - 2 * y + (5 * x * x - x * y + y * y if order == 2 else 0)
    holed = HeightMap(x=rough.x, y=rough.y, z=np.where(np.isnan(rough.z), np.nan, form))
    found = filter_map(holed, 0.2, order=order)
    np.testing.assert_allclose(found.z, holed.z, rtol=0, atol=1e-13)


def biweight_by_hand(rough, cutoff, order, settled):
    """The iteration of ISO 16610-71 over dense regressions, until its bound and its mean surface have settled."""
    known = ~np.isnan(rough.z)

    def smooth(weight):
        wave = dense(rough.x, rough.y, rough.z, weight, WIDTHS[order] * cutoff, order)
        return wave, 4.4478 * np.median(np.abs(rough.z - wave)[known])

    wave, bound = smooth(np.ones(rough.z.shape))
    while True:
        away = rough.z - wave
        new, after = smooth(np.where(np.abs(away) < bound, (1 - (away / bound) ** 2) ** 2, 0))
        moved = np.sqrt(np.nanmean((new - wave) ** 2)) / bound
        change = abs(after - bound) / after
        wave, bound = new, after
        if moved <= settled and change <= settled:
            return wave, bound


@pytest.mark.parametrize("order", [0, 2])
def test_the_robust_filter_is_the_dense_iteration(order):
    rough = rough_map((24, 23))
    z = np.array(rough.z)
    z[14:16, 10:12] += 0.01
    spiked = HeightMap(x=rough.x, y=rough.y, z=z)
    expected, bound = biweight_by_hand(spiked, 0.1, order, 3e-3)
    found = filter_map(spiked, 0.1, kind="robust", order=order)
    np.testing.assert_allclose(found.z, expected, rtol=0, atol=1e-14)
    plain = filter_map(spiked, 0.1, order=order)
    assert np.nanmax(np.abs(plain.z - expected)) > bound


def test_the_robust_filter_stops_near_where_it_would_end():
    rough = rough_map((24, 23))
    expected, bound = biweight_by_hand(rough, 0.1, 1, 1e-4)
    found = filter_map(rough, 0.1, kind="robust", order=1)
    assert np.sqrt(np.nanmean((found.z - expected) ** 2)) < 0.01 * bound


def test_the_robust_filter_bridges_deep_scratches():
    x = STEP * np.arange(200)
    form = 1e-3 * x**2 + 2e-3 * x[:, None]
    noise = np.random.default_rng(2).normal(0, 1e-6, form.shape)
    scratched = form + noise
    scratched[:, 95:99] -= 1e-3
    found = filter_map(HeightMap(x=x, y=x, z=scratched), 0.5, kind="robust")
    assert np.abs(found.z - form).max() < 2e-6  # of 1000 nm deep scratches
    lines = filter_map(HeightMap(x=x, y=x, z=scratched), 0.5, kind="robust", along="x")
    assert np.abs(lines.z - form).max() < 3e-6


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.5])
def test_a_spline_passes_waves_as_in_closed_form(ratio):
    cutoff = 0.2
    share = (np.sin(np.pi * STEP / (cutoff * ratio)) / np.sin(np.pi * STEP / cutoff)) ** 4
    expected = 1 / (1 + share)
    assert kept(cutoff * ratio, cutoff, None, kind="spline", along="x") == pytest.approx(expected, abs=1e-8)
    if ratio == 1:
        assert expected == 0.5


@pytest.mark.parametrize("along", ["x", "y", "radius"])
def test_a_spline_is_the_dense_minimum_also_with_missing_data(along):
    rough = rough_map((20, 43))
    if along == "radius":
        rough = HeightMap(radius=rough.x, angle=0.1 * np.arange(20), z=rough.z)
    found = filter_map(rough, 0.12, kind="spline", along=along)
    lines, step = (rough.z.T, 0.7 * STEP) if along == "y" else (rough.z, STEP)
    bend = np.diff(np.eye(lines.shape[1]), 2, axis=0)
    stiff = (2 * np.sin(np.pi * step / 0.12)) ** -4
    for line, got in zip(lines, found.z.T if along == "y" else found.z, strict=True):
        known = np.diag((~np.isnan(line)).astype(float))
        expected = np.linalg.solve(known + stiff * bend.T @ bend, np.nan_to_num(line))
        np.testing.assert_allclose(got, np.where(np.isnan(line), np.nan, expected), rtol=0, atol=1e-12)


def test_a_stiff_spline_keeps_its_digits():
    """Oracle: the heights whose spline is a given one, w + stiffness D'D w, with 40 digits.

    A cutoff of 1200 steps asks for a stiffness of 1e9.
    """
    n, cutoff = 1500, 1200
    with mpmath.workdps(40):
        stiff = (2 * mpmath.sin(mpmath.pi / cutoff)) ** -4
        wave = np.array([mpmath.cos(i / mpmath.mpf(70)) + mpmath.mpf(i) / 500 for i in range(n)])
        bent = stiff * np.diff(wave, 2)
        z = wave + np.convolve(bent, [1, -2, 1])
    found = filter_map(HeightMap(x=np.arange(n), y=[0.0], z=z.astype(float)[None]), cutoff, kind="spline", along="x")
    assert stiff > 1e9
    np.testing.assert_allclose(found.z[0], wave.astype(float), rtol=0, atol=1e-9)


def test_bands_hold_the_waves_that_belong_to_them():
    """Form, a long wave and a short one far from both nesting indices, and noise of one pixel."""
    n = 400
    x = STEP * np.arange(n)
    form = 0.01 * x + 0.02 * x[:, None]
    long, short = (np.tile(a * np.sin(2 * np.pi * x / period), (n, 1)) for a, period in ((1e-3, 2.0), (1e-4, 0.2)))
    z = form + long + short
    bands = separate_bands(HeightMap(x=x, y=x, z=z), Nesting(s_filter=0.05, form="none", l_filter=0.6))
    inner = (slice(150, -150),) * 2
    tall = 2 ** -((0.05 / 0.2) ** 2), 2 ** -((0.05 / 2.0) ** 2)
    low = 2 ** -((0.6 / 0.2) ** 2), 2 ** -((0.6 / 2.0) ** 2)
    np.testing.assert_allclose(
        bands.roughness.z[inner], (tall[0] * (1 - low[0]) * short + tall[1] * (1 - low[1]) * long)[inner], atol=1e-9
    )
    np.testing.assert_allclose(
        bands.waviness.z[inner], (form + tall[0] * low[0] * short + tall[1] * low[1] * long)[inner], atol=1e-9
    )
    np.testing.assert_allclose(bands.sf_surface.z, bands.waviness.z + bands.roughness.z)
