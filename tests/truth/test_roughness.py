"""Surface parameters against closed forms, mpmath, brute force and surfalize."""

import dataclasses

import mpmath
import numpy as np
import pytest
from scipy.fft import next_fast_len
from scipy.interpolate import RectBivariateSpline

from turnwright.heightmap import HeightMap
from turnwright.metrology import remove_form, roughness
from turnwright.metrology.autocorrelation import _fast_length, _spline, _spline_at, autocorrelation

A, WAVE = 1e-4, 0.1  # amplitude and period of the sine [mm]


def sine_map(per_period=200, periods=5):
    x = np.arange(per_period * periods) * WAVE / per_period
    y = np.arange(12) * 0.01
    return HeightMap(x=x, y=y, z=A * np.sin(2 * np.pi * x / WAVE) * np.ones((12, 1)))


def cusps(x, feed, nose):
    return nose - np.sqrt(nose**2 - ((x + feed / 2) % feed - feed / 2) ** 2)


def filtered_noise(shape, widths, seed=1):
    from scipy import ndimage

    return ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), widths) * 1e-4


def test_sine_has_its_closed_form_heights():
    found = roughness(sine_map(), form="mean")
    assert found.sa_nm == pytest.approx(A * 1e6 * 2 / np.pi, rel=1e-4)
    assert found.sq_nm == pytest.approx(A * 1e6 / np.sqrt(2), rel=1e-12)
    assert found.pv_nm == found.sz_nm == pytest.approx(2 * A * 1e6, rel=1e-12)
    assert found.ssk == pytest.approx(0, abs=1e-12)
    assert found.sku == pytest.approx(1.5, rel=1e-12)


def test_sine_has_its_closed_form_gradient_and_area():
    # 1000 whole steps; a difference over a step h sees the slope of a sine times sinc(pi h / wave), which is all the
    # discretisation does.
    x = np.arange(1001) * WAVE / 200
    whole = HeightMap(x=x, y=[0.0, 0.05], z=A * np.sin(2 * np.pi * x / WAVE) * np.ones((2, 1)))
    found = roughness(whole, form="none")
    steep = 2 * np.pi * A / WAVE
    seen = np.sinc(1 / 200)
    assert found.sdq == pytest.approx(steep / np.sqrt(2) * seen, rel=1e-12)
    # Arc length of a sine over its period is (2/pi) E(-s²) for slope amplitude s.
    area = 2 / mpmath.pi * mpmath.ellipe(-(mpmath.mpf(steep * seen) ** 2)) - 1
    assert found.sdr == pytest.approx(float(100 * area), rel=1e-6)


def test_steep_sine_has_the_area_of_the_elliptic_integral():
    x = np.arange(20_000) * WAVE / 20_000
    steep = HeightMap(
        x=np.append(x, WAVE), y=[0.0, 0.05], z=0.05 * np.sin(2 * np.pi * np.append(x, WAVE) / WAVE) * np.ones((2, 1))
    )
    area = 2 / mpmath.pi * mpmath.ellipe(-((mpmath.pi) ** 2)) - 1
    assert roughness(steep, form="none").sdr == pytest.approx(float(100 * area), rel=1e-6)


def test_sine_falls_to_a_fifth_at_its_arc_cosine():
    # The ends of the map leave an error of the order of one over the number of periods.
    found = roughness(sine_map(per_period=50, periods=400), form="mean")
    assert found.sal == pytest.approx(np.arccos(0.2) / (2 * np.pi) * WAVE, rel=5e-4)
    assert "upper bound" in found.notes[0]  # along the grooves it never falls


@pytest.mark.parametrize(
    ("feed", "nose"),
    [(0.010, 0.514), *(pytest.param(*one, marks=pytest.mark.proof) for one in ((0.010, 0.1), (0.002, 1.5)))],
)
def test_cusps_have_their_closed_form(feed, nose):
    x = (np.arange(4000) + 0.5) * feed / 1000
    found = roughness(HeightMap(x=x, y=np.arange(4) * 0.01, z=cusps(x, feed, nose) * np.ones((4, 1))), form="mean")
    pv = (nose - np.sqrt(nose**2 - feed**2 / 4)) * 1e6
    assert found.pv_nm == pytest.approx(pv, rel=3e-3)  # the crest itself is half a step off the grid
    assert found.sq_nm == pytest.approx(pv * np.sqrt(4 / 45), rel=2e-3)
    assert found.sa_nm == pytest.approx(pv * 4 / (9 * np.sqrt(3)), rel=2e-3)
    assert found.sdq == pytest.approx(feed / (2 * np.sqrt(3) * nose), rel=2e-3)


def test_cusps_decorrelate_as_a_bernoulli_polynomial():
    # The autocorrelation of a parabolic sawtooth is 1 - 30 t²(1 - t)² at the share t of its period.
    feed = 0.020
    expected = feed * (1 - np.sqrt(1 - 4 * np.sqrt(0.8 / 30))) / 2
    x = np.arange(600) * 0.0005
    for lay in (0.0, 0.3, 1.1):
        along = x * np.cos(lay) + x[:, None] * np.sin(lay)
        found = roughness(HeightMap(x=x, y=x, z=cusps(along, feed, 0.5)), form="mean")
        assert found.sal == pytest.approx(expected, rel=0.01)
        assert found.str < 0.05


def test_noise_has_the_lengths_of_its_filter():
    # White noise through a Gaussian of width w has the autocorrelation exp(-t²/4w²), which is 0.2 at 2 w sqrt(ln 5).
    step, width = (0.001, 0.002), (4, 3)  # columns and rows: a lay twice as long as wide
    z = filtered_noise((1200, 1200), width[::-1])
    z_wide = HeightMap(x=np.arange(1200) * step[0], y=np.arange(1200) * step[1], z=filtered_noise((1200, 1200), (3, 3)))
    found = roughness(z_wide, form="mean")
    assert found.sal == pytest.approx(2 * 3 * step[0] * np.sqrt(np.log(5)), rel=0.02)
    assert found.str == pytest.approx(0.5, rel=0.04)
    found = roughness(HeightMap(x=np.arange(1200) * 0.001, y=np.arange(1200) * 0.001, z=z), form="mean")
    assert found.str == pytest.approx(0.75, rel=0.04)
    assert found.notes == ()


@pytest.mark.parametrize("dy", [0.001, 0.0025])
@pytest.mark.filterwarnings("ignore:The surface has different pixel size")
def test_a_map_without_holes_has_the_parameters_surfalize_finds(dy):
    from surfalize import Surface

    z = filtered_noise((150, 200), (4, 2))
    found = roughness(HeightMap(x=np.arange(200) * 0.001, y=np.arange(150) * dy, z=z), form="mean")
    other = Surface(z * 1e3, 1.0, dy * 1e3).center()  # um
    for mine, theirs in [
        (found.sa_nm, other.Sa() * 1e3),
        (found.sq_nm, other.Sq() * 1e3),
        (found.sz_nm, other.Sz() * 1e3),
        (found.ssk, other.Ssk()),
        (found.sku, other.Sku()),
        (found.sdq, other.Sdq()),
    ]:
        assert mine == pytest.approx(theirs, rel=1e-11, abs=1e-11)
    assert found.sdr == pytest.approx(other.Sdr(), rel=1e-9)
    # surfalize takes the nearest of 1000 samples along rays to the pixels around the central peak.
    assert found.sal == pytest.approx(other.Sal() * 1e-3, rel=5e-3)
    assert found.str == pytest.approx(other.Str(), rel=1e-2)


def by_hand(z, dx, dy):
    """The definitions in loops: heights, gradients of valid neighbours, triangles of valid cells."""
    valid = ~np.isnan(z)
    heights = z[valid]
    across = [(z[i, j + 1] - z[i, j]) / dx for i in range(z.shape[0]) for j in range(z.shape[1] - 1)]
    along = [(z[i + 1, j] - z[i, j]) / dy for i in range(z.shape[0] - 1) for j in range(z.shape[1])]
    cells = []
    for i in range(z.shape[0] - 1):
        for j in range(z.shape[1] - 1):
            corner = [np.array([dx * q, dy * p, z[i + p, j + q]]) for p, q in ((0, 0), (0, 1), (1, 1), (1, 0))]
            area = [
                np.linalg.norm(np.cross(corner[k - 1] - corner[k], corner[(k + 1) % 4] - corner[k])) / 2
                for k in range(4)
            ]
            cells.append(sum(area) / 2 / (dx * dy) - 1)
    return {
        "sa_nm": np.abs(heights).mean() * 1e6,
        "sq_nm": np.sqrt((heights**2).mean()) * 1e6,
        "sdq": np.sqrt(np.nanmean(np.square(across)) + np.nanmean(np.square(along))),
        "sdr": 100 * np.nanmean(cells),
    }


def holed(shape, seed=3):
    z = filtered_noise(shape, (2, 2), seed) * 1e3
    z[np.random.default_rng(seed).random(shape) < 0.15] = np.nan
    return z


def test_missing_points_count_as_in_the_definitions():
    z = holed((30, 25))
    found = roughness(HeightMap(x=np.arange(25) * 0.01, y=np.arange(30) * 0.02, z=z), form="none")
    for name, value in by_hand(z, 0.01, 0.02).items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-10), name
    assert found.missing == np.isnan(z).sum()
    assert found.valid == z.size - found.missing


def test_autocorrelation_is_the_mean_product_over_valid_pairs():
    z = holed((14, 11))
    correlation, known = autocorrelation(z)
    centred = z - np.nanmean(z)
    for dy in range(-7, 8):
        for dx in range(-5, 6):
            pairs = [
                centred[i, j] * centred[i + dy, j + dx]
                for i in range(max(0, -dy), min(14, 14 - dy))
                for j in range(max(0, -dx), min(11, 11 - dx))
            ]
            pairs = np.array(pairs)[~np.isnan(pairs)]
            assert known[dy + 7, dx + 5] == (pairs.size >= 0.1 * np.count_nonzero(~np.isnan(z)))
            if known[dy + 7, dx + 5]:
                assert correlation[dy + 7, dx + 5] == pytest.approx(pairs.mean() / np.nanmean(centred**2), rel=1e-9)


@pytest.mark.parametrize("shape", [(4, 5), (15, 40), (90, 61)])
def test_the_autocorrelation_is_interpolated_by_a_cubic_spline(shape):
    """Oracle: a banded solver for the spline of the values, mirrored twice at each border as no border counts there."""
    values = np.random.default_rng(8).normal(size=shape)
    row, column = np.random.default_rng(9).random((2, 200)) * (np.array(shape)[:, None] - 1)
    row[:2], column[:2] = (0, shape[0] - 1), (0, shape[1] - 1)
    far = 40
    wide = np.pad(values, far, mode="symmetric")
    spline = RectBivariateSpline(*(np.arange(-far, size + far) for size in shape), wide)
    found = _spline_at(_spline(values), row, column)
    assert found == pytest.approx(spline(row, column, grid=False), abs=1e-13)


@pytest.mark.parametrize("least", [1, 2, 7, 97, 361, 1009, 5000])
def test_lengths_of_transforms_are_scipys(least):
    assert _fast_length(least) == next_fast_len(least, real=True)


def test_a_scratched_and_masked_map_keeps_its_texture():
    # A tenth of the points gone, and everything beyond a circle: the lengths of the filter stay, as well as some 2000
    # independent places state them (the least over all directions of a noisy length is a little short).
    z = filtered_noise((700, 700), (4, 4))
    x = np.arange(700) * 0.001
    z[np.random.default_rng(5).random(z.shape) < 0.1] = np.nan
    z[np.hypot(x - 0.35, x[:, None] - 0.35) > 0.34] = np.nan
    found = roughness(HeightMap(x=x, y=x, z=z), form="plane")
    assert found.sal == pytest.approx(2 * 0.004 * np.sqrt(np.log(5)), rel=0.08)
    assert found.str == pytest.approx(1, rel=0.12)
    assert found.notes == ()


def test_a_polar_map_weighs_each_point_with_its_area():
    # z = a r^2 over a ring: the averages are integrals of r^k r dr.
    radius = np.linspace(0.5, 2.5, 4001)
    angle = np.linspace(0, 2 * np.pi, 91)[:-1]
    z = 1e-4 * radius**2 * np.ones((90, 1))
    found = roughness(HeightMap(radius=radius, angle=angle, z=z), form="none")
    ring = (2.5**2 - 0.5**2) / 2
    assert found.sa_nm == pytest.approx(100 * (2.5**4 - 0.5**4) / 4 / ring, rel=1e-3)
    assert found.sq_nm == pytest.approx(100 * np.sqrt((2.5**6 - 0.5**6) / 6 / ring), rel=1e-3)
    assert found.sdq == pytest.approx(2e-4 * np.sqrt((2.5**4 - 0.5**4) / 4 / ring), rel=1e-3)
    assert found.sdr == pytest.approx(100 * 2e-4**2 / 2 * (2.5**4 - 0.5**4) / 4 / ring, rel=1e-3)
    assert np.isnan(found.sal)
    assert "polar" in " ".join(found.notes)


def test_a_polar_map_and_a_rectangular_one_agree_on_a_bump():
    def bump(x, y):
        return 1e-3 * np.exp(-4 * ((x - 0.3) ** 2 + (y + 0.1) ** 2))

    radius, angle = (np.arange(800) + 0.5) * 1e-3 * 1.25, np.linspace(0, 2 * np.pi, 721)[:-1]
    polar = HeightMap(
        radius=radius, angle=angle, z=bump(np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius)
    )
    x = np.linspace(-1, 1, 1001)
    z = bump(x, x[:, None])
    z[np.hypot(x, x[:, None]) > 1] = np.nan
    whole = roughness(polar, form="plane")
    flat = roughness(HeightMap(x=x, y=x, z=z), form="plane")
    for name in ("sa_nm", "sq_nm", "ssk", "sku", "sdq", "sdr"):
        assert getattr(whole, name) == pytest.approx(getattr(flat, name), rel=3e-3), name


def test_polynomial_forms_are_those_of_numpys_least_squares():
    z = holed((40, 50))
    x, y = np.linspace(3, 4, 50), np.linspace(-7, -6.5, 40)
    columns, rows = np.meshgrid(x, y)
    valid = ~np.isnan(z)
    for degree in (0, 1, 2, 5):
        terms = [(columns - 3.5) ** i * (rows + 6.75) ** j for i in range(degree + 1) for j in range(degree + 1 - i)]
        matrix = np.stack([term[valid] for term in terms], axis=1)
        fitted = matrix @ np.linalg.lstsq(matrix, z[valid])[0]
        left = remove_form(HeightMap(x=x, y=y, z=z), degree).z
        assert np.abs(left[valid] - (z[valid] - fitted)).max() < 1e-12
        assert np.isnan(left[~valid]).all()


@pytest.mark.parametrize("radius", [50.0, 2.0, -1.2, 1e6])
def test_a_sphere_anywhere_is_removed_to_the_noise(radius):
    x = np.linspace(-0.5, 0.5, 201)
    z = np.sign(radius) * (abs(radius) - np.sqrt(radius**2 - (x - 0.1) ** 2 - (x[:, None] + 0.2) ** 2)) + 3.0
    assert np.abs(remove_form(HeightMap(x=x, y=x, z=z), "sphere").z).max() < 1e-11 + 2e-16 * abs(radius)


def test_best_fit_sphere_is_that_of_a_general_optimiser():
    from scipy import optimize

    z = holed((40, 50))
    x, y = np.linspace(-0.5, 0.5, 50), np.linspace(-0.4, 0.4, 40)
    z = z * 0.1 + 1.5 - np.sqrt(1.5**2 - x**2 - y[:, None] ** 2)
    valid = ~np.isnan(z)
    columns, rows = np.meshgrid(x, y)

    def left(p):
        return (z - p[2] - p[3] + np.sqrt(p[3] ** 2 - (columns - p[0]) ** 2 - (rows - p[1]) ** 2))[valid]

    best = optimize.least_squares(left, [0, 0, 0, 1.5], xtol=1e-15, ftol=1e-15, gtol=1e-15).fun
    assert np.abs(remove_form(HeightMap(x=x, y=y, z=z), "sphere").z[valid] - best).max() < 1e-7


def test_form_removal_leaves_only_the_cusps():
    x = (np.arange(4000) + 0.5) * 1e-4
    y = np.arange(50) * 1e-3
    plain = cusps(x, 0.010, 0.5) * np.ones((50, 1))
    tilted = HeightMap(x=x, y=y, z=plain + 0.3 + 0.02 * x - 0.5 * y[:, None])
    bent = HeightMap(x=x, y=y, z=plain + 0.5 * x**2 + 0.1 * x * y[:, None])
    level = roughness(HeightMap(x=x, y=y, z=plain), form="plane")
    assert roughness(tilted, form="plane").sq_nm == pytest.approx(level.sq_nm, rel=1e-9)
    # A parabola also fits a little of forty cusps.
    assert roughness(bent, form=2).sq_nm == pytest.approx(level.sq_nm, rel=1e-3)


def test_heights_scale_and_lengths_do_not():
    z = holed((40, 45))
    x, y = np.arange(45) * 0.01, np.arange(40) * 0.01
    one, two = (roughness(HeightMap(x=x, y=y, z=k * z), form="plane") for k in (1, -2))
    assert two.sq_nm == pytest.approx(2 * one.sq_nm)
    assert two.ssk == pytest.approx(-one.ssk)
    assert two.sdq == pytest.approx(2 * one.sdq)
    assert (two.sal, two.str) == pytest.approx((one.sal, one.str))


def test_the_answer_is_a_value():
    with pytest.raises(dataclasses.FrozenInstanceError):
        roughness(sine_map(), form="mean").sa_nm = 0
