"""Profiles and slopes against polynomials and sines in closed form; the bearing curve against these and surfalize."""

import numpy as np
import pytest

from turnwright.heightmap import HeightMap
from turnwright.metrology import bearing, line_profile, roughness, slope_error


def uneven(rng, size, low, high):
    return np.sort(np.concatenate([[low, high], rng.uniform(low, high, size - 2)]))


@pytest.mark.parametrize(("method", "degree"), [("linear", 1), ("cubic", 3)])
def test_a_profile_of_a_polynomial_is_the_polynomial(method, degree):
    rng = np.random.default_rng(1)
    x, y = uneven(rng, 40, -2, 3), uneven(rng, 30, 1, 4)

    def surface(a, b):
        return sum((i + 2 * j + 1) * a**i * b**j for i in range(degree + 1) for j in range(degree + 1 - i)) * 1e-3

    heights = HeightMap(x=x, y=y, z=surface(x, y[:, None]))
    for start, end in (((-2, 1), (3, 4)), ((0, 4), (1.234, 1)), ((2.5, 2), (-1, 2))):
        found = line_profile(heights, start, end, step=0.013, method=method)
        assert found.z == pytest.approx(surface(found.x, found.y), abs=1e-12)
        assert found.distance[-1] == pytest.approx(np.hypot(end[0] - start[0], end[1] - start[1]))
        assert (found.x[-1], found.y[-1]) == pytest.approx(end)


def test_axis_parallel_profiles_meet_the_grid_points():
    z = np.random.default_rng(2).standard_normal((31, 41))
    heights = HeightMap(x=np.linspace(-2, 2, 41), y=np.linspace(-1.5, 1.5, 31), z=z)
    for method in ("linear", "cubic"):
        flat = line_profile(heights, (0.0, 0.3), angle=0.0, method=method)
        assert flat.z == pytest.approx(z[18], abs=1e-12)
        assert flat.distance == pytest.approx(heights.x)
        upright = line_profile(heights, (-0.5, 0.0), angle=np.pi / 2, method=method)
        assert upright.z == pytest.approx(z[:, 15], abs=1e-12)


@pytest.mark.parametrize("turns", [1.0, 0.7])
def test_a_diameter_of_a_polar_map_crosses_its_axis(turns):
    angle = np.linspace(0, 2 * np.pi * turns, 361)[: -1 if turns == 1 else None]
    radius = np.linspace(0, 2, 201)
    x, y = np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius
    heights = HeightMap(radius=radius, angle=angle, z=1e-3 * (x - 0.5 * y + x * y))
    found = line_profile(heights, (0.0, 0.0), angle=0.9, method="cubic")
    truth = 1e-3 * (found.x - 0.5 * found.y + found.x * found.y)
    valid = ~np.isnan(found.z)
    assert found.z[valid] == pytest.approx(truth[valid], abs=1e-9)
    if turns == 1:
        assert valid.all()
        assert found.distance[[0, -1]] == pytest.approx([-2, 2])
        seam = line_profile(heights, (1.5, -0.5), (1.5, 0.5), method="cubic")
        assert seam.z == pytest.approx(1e-3 * (seam.x - 0.5 * seam.y + seam.x * seam.y), abs=1e-9)
    else:
        # The far half lies between 0.7 turns and the first angle, where nothing was measured, but for its axis.
        far = np.arctan2(found.y, found.x) % (2 * np.pi) > 2 * np.pi * 0.7
        assert not valid[far & (found.distance < 0)].any()


def test_hole_affects_only_the_heights_that_use_it():
    z = np.zeros((20, 20))
    z[10, 10] = np.nan
    heights = HeightMap(x=np.arange(20.0), y=np.arange(20.0), z=z)
    on_row = line_profile(heights, (0.0, 10.0), (19.0, 10.0), step=0.25)
    assert np.array_equal(np.isnan(on_row.z), np.abs(on_row.x - 10) < 1 - 1e-9)
    beside = line_profile(heights, (0.0, 9.0), (19.0, 9.0), step=0.25)
    assert not np.isnan(beside.z).any()
    between = line_profile(heights, (0.0, 9.5), (19.0, 9.5), step=0.25)
    assert np.array_equal(np.isnan(between.z), np.abs(between.x - 10) < 1 - 1e-9)
    outside = line_profile(heights, (-2.0, 5.0), (5.0, 5.0), step=0.5)
    assert np.array_equal(np.isnan(outside.z), outside.x < 0)


def test_a_profile_without_its_line_has_the_parameters_of_a_sine():
    x = np.arange(10_000) / 10_000
    heights = HeightMap(x=x, y=[0.0, 1.0], z=np.tile(1e-4 * np.sin(2 * np.pi * 50 * x) + 0.3 + 0.7 * x, (2, 1)))
    found = line_profile(heights, (0.0, 0.5), angle=0.0).without(1)
    # The line of best fit takes a share of the order of one over the number of periods.
    assert found.pa_nm == pytest.approx(1e2 * 2 / np.pi, rel=5e-3)
    assert found.pq_nm == pytest.approx(1e2 / np.sqrt(2), rel=5e-3)
    assert found.pt_nm == pytest.approx(2e2, rel=2e-2)


@pytest.mark.parametrize("length", [0.01, 0.05, 0.17])
def test_a_sine_keeps_the_sinc_of_its_slope(length):
    period, height = 0.4, 5e-5
    x, y = np.arange(2000) * 0.01, np.arange(60) * 0.01
    error = HeightMap(x=x, y=y, z=height * np.sin(2 * np.pi * x / period) + 3e-5 * y[:, None])
    found = slope_error(error, integration_length=length)
    used = found.length_across
    assert abs(used - length) < 0.005 + 1e-12
    steep = 2 * np.pi * height / period * np.sinc(used / period)
    # What is left of the fifty periods by the length is not a whole number of them.
    assert found.rms_across == pytest.approx(steep / np.sqrt(2), rel=5e-3)
    # A crest may lie half a step off the grid, (pi/40)²/2 of it.
    assert found.pv_across == pytest.approx(2 * steep, rel=3.2e-3)
    assert found.rms_along == pytest.approx(3e-5, rel=1e-9)
    assert found.rms == pytest.approx(np.hypot(found.rms_across, found.rms_along))
    assert found.peak == pytest.approx(np.hypot(steep, 3e-5), rel=3.2e-3)


def test_slopes_by_hand_with_holes():
    rng = np.random.default_rng(3)
    z = rng.standard_normal((12, 15))
    z[rng.random(z.shape) < 0.2] = np.nan
    found = slope_error(HeightMap(x=np.arange(15) * 0.1, y=np.arange(12) * 0.2, z=z), integration_length=0.4)
    across = [(z[i, j + 4] - z[i, j]) / 0.4 for i in range(12) for j in range(11)]
    along = [(z[i + 2, j] - z[i, j]) / 0.4 for i in range(10) for j in range(15)]
    assert found.rms_across == pytest.approx(np.sqrt(np.nanmean(np.square(across))))
    assert found.rms_along == pytest.approx(np.sqrt(np.nanmean(np.square(along))))
    assert found.pv_along == pytest.approx(np.nanmax(along) - np.nanmin(along))


def test_slopes_of_a_polar_map_are_those_of_the_plane_it_shows():
    radius, angle = np.linspace(0, 5, 501), np.linspace(0, 2 * np.pi, 721)[:-1]
    tilt = HeightMap(radius=radius, angle=angle, z=4e-5 * np.cos(angle)[:, None] * radius)
    found = slope_error(tilt, integration_length=0.1)
    # Half of a tilt's square is along the radius and half along the circle, where the chord is a little shorter.
    assert found.rms_across == pytest.approx(4e-5 / np.sqrt(2), rel=1e-9)
    assert found.rms_along == pytest.approx(4e-5 / np.sqrt(2), rel=5e-3)
    assert found.rms == pytest.approx(4e-5, rel=3e-3)
    assert np.isnan(found.along[:, :2]).all()  # circles shorter than the length


def test_the_bearing_curve_of_a_sine_is_its_arc_cosine():
    x = (np.arange(200_000) + 0.5) / 200_000
    sine = HeightMap(x=x, y=[0.0, 1.0], z=np.tile(1e-4 * np.sin(2 * np.pi * x), (2, 1)))
    found = bearing(sine, form="none")
    for ratio in (0.02, 0.3, 0.5, 0.9):
        assert found.height_at_nm(ratio) == pytest.approx(100 * np.cos(np.pi * ratio), abs=1e-3)
        assert found.ratio_at(100 * np.cos(np.pi * ratio)) == pytest.approx(ratio, abs=1e-5)
    # The curve cos(pi p) is flattest at its ends, over p = 0 to 0.4 or from 0.6 on; the line of best fit there.
    t = 0.4 * np.pi
    mean = np.sin(t) / t
    slope = 12 / 0.4**3 * (0.4 * np.sin(t) / np.pi + (np.cos(t) - 1) / np.pi**2 - 0.2 * 0.4 * mean) * 100
    assert found.sk_nm == pytest.approx(-slope, rel=1e-4)
    foot = 100 * mean + 0.8 * slope
    ratio = np.arccos(foot / 100) / np.pi
    beyond = 2 * (foot + 100 * np.sin(np.pi * ratio) / np.pi / (1 - ratio))
    assert sorted((found.spk_nm, found.svk_nm)) == pytest.approx([0, beyond], rel=1e-3)
    assert max(found.smr1, 1 - found.smr2) == pytest.approx(1 - ratio, rel=1e-3)
    vmp = 100 * (np.sin(0.1 * np.pi) / np.pi - 0.1 * np.cos(0.1 * np.pi))
    assert found.vmp_nm == pytest.approx(vmp, rel=1e-4)
    vmc = 100 * (np.sin(0.8 * np.pi) / np.pi - 0.8 * np.cos(0.8 * np.pi)) - vmp
    assert found.vmc_nm == pytest.approx(vmc, rel=1e-4)
    vvv = 100 * (0.2 * np.cos(0.8 * np.pi) + np.sin(0.8 * np.pi) / np.pi)
    assert found.vvv_nm == pytest.approx(vvv, rel=1e-4)


@pytest.mark.filterwarnings("ignore")
def test_a_map_without_holes_has_the_core_that_surfalize_finds():
    from scipy import ndimage
    from surfalize import Surface
    from surfalize.abbottfirestone import AbbottFirestoneCurve

    z = ndimage.gaussian_filter(np.random.default_rng(4).standard_normal((300, 350)), 2) * 1e-4
    z = z - 0.3 * np.maximum(z, 0) ** 2 / 1e-4  # not even about zero, so that peaks and valleys differ
    heights = HeightMap(x=np.arange(350) * 1e-3, y=np.arange(300) * 1e-3, z=z)
    found = bearing(heights, form="mean")
    surface = Surface(z * 1e3, 1.0, 1.0).center()  # um
    other = AbbottFirestoneCurve(surface, nbins=20_000)
    # It leaves out the class at the border of what it adds up, 0.05 % of 10 %; with a million classes, which take a
    # minute, all agree to 1e-4.
    for mine, theirs, tolerance in [
        (found.sk_nm, other.k(), 1e-4),
        (found.spk_nm, other.pk(), 4e-3),
        (found.svk_nm, other.vk(), 4e-3),
        (found.vmp_nm, other.vmp(), 4e-3),
        (found.vmc_nm, other.vmc(), 1e-3),
        (found.vvc_nm, other.vvc(), 1e-3),
        (found.vvv_nm, other.vvv(), 1e-3),
    ]:
        assert mine == pytest.approx(theirs * 1e3, rel=tolerance)
    assert (found.smr1, found.smr2) == pytest.approx((other.mr1() / 100, other.mr2() / 100), abs=1e-4)
    rough = roughness(heights, form="mean")
    assert rough.sp_nm == pytest.approx(surface.Sp() * 1e3, rel=1e-11)
    assert rough.sv_nm == pytest.approx(surface.Sv() * 1e3, rel=1e-11)


def test_the_bearing_curve_of_a_polar_map_counts_areas():
    # z = r over a disc: the share above r is 1 - r².
    radius = (np.arange(3000) + 0.5) / 3000
    cone = HeightMap(radius=radius, angle=np.linspace(0, 2 * np.pi, 13)[:-1], z=np.tile(1e-4 * radius, (12, 1)))
    found = bearing(cone, form="none")
    assert found.height_at_nm(0.75) == pytest.approx(50, rel=1e-3)
    assert found.ratio_at(80) == pytest.approx(1 - 0.64, rel=1e-3)
