"""Feature parameters and texture direction, against bumps in closed form, a brute-force flooding and surfalize."""

import numpy as np
import pytest
from scipy import ndimage

from cases import every_second
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.metrology import features

STEP = 0.001
EIGHT = np.ones((3, 3))


def noise(shape=(60, 80), width=2.0, seed=3):
    return ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), width) * 1e-4


def as_map(z, dx=STEP, dy=STEP):
    return HeightMap(x=dx * np.arange(z.shape[1]), y=dy * np.arange(z.shape[0]), z=z)


def persistent_peaks(z, least):
    """Peaks that stand ``least`` above the level at which they join a higher one: by flooding every level."""
    levels = np.unique(z)[::-1]
    found = {}
    peaks = [tuple(at) for at in np.argwhere(z == ndimage.maximum_filter(z, footprint=EIGHT))]
    for peak in peaks:
        saddle = levels[-1]
        for level in levels:
            piece, _ = ndimage.label(z >= level, EIGHT)
            if piece[peak] and z[piece == piece[peak]].max() > z[peak]:
                saddle = level
                break
        if z[peak] - saddle >= least:
            found[peak] = z[peak]
    return found


def test_a_grid_of_bumps_has_its_closed_form():
    """A (cos kx + cos ky): peaks of 2A and pits of -2A on a lattice, curvature A k² at each."""
    size, period, n = 1e-4, 0.020, 241
    k = 2 * np.pi / period
    x = STEP * np.arange(n)
    found = features(as_map(size * (np.cos(k * x) + np.cos(k * x[:, None]))), form="none")
    seen = (np.sin(k * STEP / 2) / (k * STEP / 2)) ** 2  # what a second difference sees of a wave
    assert found.peaks == 11 * 11  # 13 x 13 less those at the border
    assert found.pits == 10 * 10  # of 12 x 12, the outer ring of dales reaches the border
    assert found.s5p_nm == pytest.approx(2e6 * size, rel=0.02)
    assert found.s10z_nm == pytest.approx(4e6 * size, rel=0.01)
    assert found.spc == pytest.approx(size * k**2 * seen, rel=1e-3)
    assert found.svc == pytest.approx(-size * k**2 * seen, rel=1e-3)
    assert found.spd == pytest.approx(found.peaks / (n * STEP) ** 2, rel=1e-12)
    assert features(as_map(size * (np.cos(k * x) + np.cos(k * x[:, None]))), form="none", border=True).peaks == 13 * 13


@pytest.mark.parametrize(("pruning", "seed"), every_second([0.0, 0.05, 0.2], range(3)))
def test_significant_peaks_are_those_of_a_flooding(seed, pruning):
    z = noise((18, 22), 1.2, seed)
    found = features(as_map(z), form="none", pruning=pruning, border=True)
    expected = persistent_peaks(z, pruning * np.ptp(z))
    assert found.peaks == len(expected)
    highest = sorted(expected.values(), reverse=True)[:5]
    assert found.s5p_nm == pytest.approx(1e6 * (np.mean(highest) - z.mean()), rel=1e-9)
    assert found.pits == len(persistent_peaks(-z, pruning * np.ptp(z)))


@pytest.mark.parametrize("seed", [3, 4, 5, 6])
def test_surfalize_finds_the_same_parameters(seed):
    from surfalize import Surface

    z = noise((90, 120), 2.5, seed)
    found = features(as_map(z), form="mean")
    other = Surface(z * 1e3, 1.0, 1.0)
    pixels = 90 * 120 / (89 * 119)  # a point is a whole pixel here, a corner of the area there
    assert found.spd * pixels == pytest.approx(other.Spd() * 1e6, rel=1e-9)
    assert found.svd * pixels == pytest.approx(other.Svd() * 1e6, rel=1e-9)
    assert found.s5p_nm == pytest.approx(other.S5p() * 1e3, rel=1e-9)
    assert found.s10z_nm == pytest.approx(other.S10z() * 1e3, rel=1e-9)
    assert found.spc == pytest.approx(other.Spc() * 1e3, rel=1e-9)
    assert found.svc == pytest.approx(other.Svc() * 1e3, rel=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 12.5, 45.0, 90.0, 133.0, 179.0])
@pytest.mark.parametrize("dy", [1.0, 1.7])
def test_a_texture_of_known_direction_has_it(degrees, dy):
    x, y = STEP * np.arange(200), dy * STEP * np.arange(150)
    way = np.deg2rad(degrees)
    along = x * np.cos(way) + y[:, None] * np.sin(way)
    z = 1e-4 * (along / 0.013 % 1 - 0.5) ** 2 + 0.1 * noise((150, 200), 0.7)
    found = features(HeightMap(x=x, y=y, z=z))
    off = (np.rad2deg(found.std) - degrees + 90) % 180 - 90
    assert abs(off) < 0.5


def egg_box(n):
    k = 2 * np.pi / 0.020
    x = STEP * np.arange(n)
    return 1e-4 * (np.cos(k * x) + np.cos(k * x[:, None]))


def random_hills():
    return noise((301, 301), 3.0)


@pytest.mark.parametrize(
    ("share", "surface"), every_second([0.001, 0.005, 0.02, 0.05], [lambda: egg_box(301), random_hills])
)
def test_few_missing_points_change_no_parameter(surface, share):
    z = surface()
    whole = features(as_map(z), form="none")
    z[np.random.default_rng(0).random(z.shape) < share] = np.nan
    found = features(as_map(z), form="none")
    for name in ("spd", "svd", "spc", "svc", "s10z_nm", "s5p_nm", "s5v_nm"):
        assert getattr(found, name) == pytest.approx(getattr(whole, name), rel=0.03), name
    assert any("filled" in one for one in found.notes)


@pytest.mark.parametrize("side", [7, 12])
def test_a_large_hole_takes_its_hills_with_their_area(side):
    z = egg_box(241)
    whole = features(as_map(z), form="none")
    for row, column in ((60, 80), (100, 180), (180, 120)):  # each about a peak
        z[row - side // 2 : row + side // 2 + 1, column - side // 2 : column + side // 2 + 1] = np.nan
    holed = features(as_map(z), form="none")
    assert whole.peaks - holed.peaks == 3
    assert holed.spd == pytest.approx(whole.spd, rel=0.01)
    assert holed.s10z_nm == pytest.approx(whole.s10z_nm, rel=1e-9)
    assert any("left out" in one and "peaks" in one for one in holed.notes)
    assert features(as_map(z), form="none", border=True).peaks >= holed.peaks + 3


def test_a_map_of_holes_states_nothing_and_says_so():
    z = egg_box(121)
    z[np.random.default_rng(1).random(z.shape) < 0.3] = np.nan
    found = features(as_map(z), form="none")
    assert all(np.isnan(value) for value in (found.spd, found.svd, found.s10z_nm, found.spc))
    assert sum("no significant" in one and "hole" in one for one in found.notes) == 2


def test_the_outside_of_a_round_map_is_a_border_and_no_hole():
    z = egg_box(241)
    x, y = np.meshgrid(np.arange(241) - 120, np.arange(241) - 120)
    z[np.hypot(x, y) > 120] = np.nan
    found = features(as_map(z), form="none")
    assert found.spd == pytest.approx(found.peaks / (np.count_nonzero(~np.isnan(z)) * STEP**2))
    assert found.notes == ()


def test_grooves_reach_the_border_and_say_so():
    z = np.tile(1e-4 * np.cos(2 * np.pi * np.arange(100) / 20), (40, 1)) + 0.01 * noise((40, 100))
    found = features(as_map(z))
    assert np.isnan(found.s5p_nm)
    assert np.isnan(found.spd)
    assert "border" in found.notes[0]
    assert features(as_map(z), border=True).peaks in (4, 5, 6)


def test_features_scale_with_lengths():
    z = noise()
    one, other = features(as_map(z)), features(as_map(10 * z, 10 * STEP, 10 * STEP))
    assert other.s10z_nm == pytest.approx(10 * one.s10z_nm, rel=1e-9)
    assert other.spd == pytest.approx(one.spd / 100, rel=1e-9)
    assert other.spc == pytest.approx(one.spc / 10, rel=1e-9)
    assert other.std == pytest.approx(one.std, rel=1e-9)


def test_grids_without_features_are_refused():
    with pytest.raises(InputError, match="polar"):
        features(HeightMap(z=np.zeros((4, 4)), radius=np.arange(4.0), angle=np.arange(4.0)))
    with pytest.raises(InputError, match="even steps"):
        features(HeightMap(z=np.zeros((4, 4)), x=np.arange(4.0) ** 2, y=np.arange(4.0)))
    with pytest.raises(InputError, match="pruning"):
        features(as_map(noise()), pruning=2.0)
