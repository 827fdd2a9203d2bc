"""What an instrument sees, against closed forms of sines, wedges, balls and pupils, and a brute-force overlap."""

from dataclasses import replace

import numpy as np
import pytest

from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.instrument import Instrument
from turnwright.profile import Profile

STEP = 1e-4  # mm


def profile(z, step=STEP):
    at = step * np.arange(len(z))
    return Profile(distance=at, z=z, x=at, y=np.zeros(len(z)))


def disc(x, y, radius):
    return x * x + y * y <= radius * radius


@pytest.mark.parametrize("filling", [1.0, 0.6, 0.25])
def test_the_transfer_is_the_overlap_of_two_pupils(filling):
    """Oracle: counting points of a fine grid inside both discs."""
    at = np.linspace(-1, 1, 2001)
    x, y = np.meshgrid(at * filling, at * filling)
    optics = Instrument(numerical_aperture=0.3, wavelength=570e-6, filling=filling)
    small = disc(x, y, filling)
    for distance in (0.0, 0.2, 0.7, 1.1, 1.5, 1.9):
        shared = (small & disc(x - distance, y, 1.0)).sum() / small.sum()
        frequency = distance * 0.3 / 570e-6
        assert optics.transfer(frequency) == pytest.approx(shared, abs=5e-4)
    assert optics.cutoff == pytest.approx((1 + filling) * 0.3 / 570e-6, rel=1e-12)


def test_coherent_light_passes_all_up_to_its_cutoff():
    optics = Instrument(resolution=0.001, filling=0.0)
    assert optics.transfer([0.0, 499.0, 501.0]).tolist() == [1.0, 1.0, 0.0]


@pytest.mark.parametrize("period", [0.002, 0.005, 0.0125])
def test_a_sine_passes_by_the_transfer_of_optics_and_pixel(period):
    """In the middle of many periods: the closed-form incoherent transfer function times a sinc."""
    seen = Instrument(pixel=0.871e-3, numerical_aperture=0.3, wavelength=570e-6).see(
        profile(1e-5 * np.cos(2 * np.pi * STEP * np.arange(10_001) / period))
    )
    q = 570e-6 / period / 0.6
    passed = 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q * q)) * np.sinc(0.871e-3 / period)
    middle = seen.z[4000:6001]
    at = 2 * np.pi * STEP * np.arange(4000, 6001) / period
    assert 2 * np.mean(middle * np.cos(at)) / 1e-5 == pytest.approx(passed, abs=2e-3)


def test_a_pixel_takes_a_quarter_of_its_slope_off_a_ridge():
    """A wedge of slope ±m averaged over p has its top lower by m p / 4, and stays as it is p / 2 away."""
    slope, pixel = 0.02, 20 * STEP
    x = STEP * (np.arange(4001) - 2000)
    seen = Instrument(pixel=pixel).see(profile(-slope * np.abs(x)))
    assert seen.z[2000] == pytest.approx(-slope * pixel / 4, rel=0.01)
    assert seen.z[2030] == pytest.approx(-slope * 30 * STEP, rel=1e-4)


def test_a_tilted_plane_is_seen_as_it_is():
    x, y = STEP * np.arange(200), STEP * np.arange(150)
    z = 0.03 * x - 0.01 * y[:, None]
    seen = Instrument.load("zygo-nexview-10x").see(HeightMap(x=x, y=y, z=z))
    assert np.abs(seen.z - z).max() < 1e-9  # mm
    one = Instrument.load("zygo-nexview-10x").see(profile(0.03 * x))
    assert np.abs(one.z - 0.03 * x).max() < 1e-12


def test_a_map_of_grooves_is_seen_as_the_profile_across_them():
    x = STEP * np.arange(1500)
    z = 1e-5 * np.abs((x / 0.01) % 1 - 0.5)
    instrument = Instrument.load("zygo-nexview-10x")
    across = instrument.see(profile(z))
    grooves = instrument.see(HeightMap(x=x, y=STEP * np.arange(60), z=np.tile(z, (60, 1))))
    assert np.abs(grooves.z - across.z).max() < 1e-12


def test_a_ball_rolls_over_a_ridge_and_bridges_a_groove():
    """Over a ridge the lowest point of the ball draws its radius; in a groove it stands r (1 / cos a - 1) above it."""
    radius, slope = 0.002, 0.5
    instrument = Instrument(stylus_radius=radius)
    x = STEP * (np.arange(401) - 200)
    groove = instrument.see(profile(slope * np.abs(x)))
    assert groove.z[200] == pytest.approx(radius * (np.sqrt(1 + slope**2) - 1), rel=2e-3)
    step = np.where(x < -1e-12, -0.01, 0.0)  # a cliff: the ball comes down its edge as a quarter of a circle
    traced = instrument.see(profile(step))
    away = np.arange(1, 19) * STEP
    falls = np.sqrt(radius**2 - away**2) - radius
    assert traced.z[200 - np.arange(1, 19)] == pytest.approx(falls, abs=1e-12)


def test_a_ball_over_a_sphere_draws_the_sum_of_both():
    """The lowest point of a ball r on a ball R lies on a sphere R + r about the same centre, r lower."""
    radius, ball = 0.005, 0.002
    x = STEP * (np.arange(81) - 40)
    r = np.hypot(x, x[:, None])
    bump = HeightMap(x=x, y=x, z=np.sqrt(radius**2 - np.minimum(r, 0.0045) ** 2))
    traced = Instrument(stylus_radius=ball).see(bump)
    near = r < 0.0035
    expected = np.sqrt((radius + ball) ** 2 - r**2) - ball
    assert np.abs(traced.z - expected)[near].max() < 2.5e-6  # half a diagonal of 1e-4 mm off the point of contact
    assert (traced.z - expected)[near].max() < 1e-12


def test_missing_heights_stay_missing_and_touch_nothing():
    z = np.zeros(300)
    z[100] = np.nan
    seen = Instrument(pixel=1e-3, stylus_radius=0.002).see(profile(z))
    assert np.flatnonzero(np.isnan(seen.z)).tolist() == [100]
    assert np.nanmax(np.abs(seen.z)) < 1e-15


def test_what_is_seen_is_taken_at_the_places_of_a_measurement():
    x = STEP * np.arange(2001)
    fine = profile(1e-5 * np.sin(2 * np.pi * x / 0.05))
    places = np.arange(10, 150) * 0.871e-3
    measured = Profile(distance=places, z=np.zeros(places.size), x=places, y=np.zeros(places.size))
    seen = Instrument(pixel=0.871e-3).see(fine, like=measured)
    expected = 1e-5 * np.sinc(0.871e-3 / 0.05) * np.sin(2 * np.pi * places / 0.05)
    assert np.abs(seen.z - expected).max() < 2e-9


def test_noise_is_added_on_request_and_repeats():
    flat = profile(np.zeros(20_000))
    instrument = Instrument(pixel=1e-3, noise=2e-6)
    assert np.abs(instrument.see(flat).z).max() == 0
    noisy = instrument.see(flat, seed=3)
    assert noisy.z.std() == pytest.approx(2e-6, rel=0.03)
    assert np.array_equal(noisy.z, instrument.see(flat, seed=3).z)


def test_every_preset_loads_and_names_its_source(tmp_path):
    for name in Instrument.known():
        one = Instrument.load(name)
        assert one.name == name
        assert one.source
        assert one.transfer(0.0) == 1
    # Zygo's optical resolution is Sparrow's 0.5 wavelength / NA: the period at which the transfer ends.
    for name, resolution in (("2.75x", 3.563), ("10x", 0.950), ("20x", 0.713), ("50x", 0.518)):
        assert 1e3 / Instrument.load(f"zygo-nexview-{name}").cutoff == pytest.approx(resolution, abs=6e-4)
    (tmp_path / "mine.toml").write_text('pixel = "2 um"\nresolution = "3 um"\n')
    assert Instrument.load(tmp_path / "mine.toml") == Instrument(pixel=0.002, resolution=0.003, name="mine")


def test_wrong_instruments_are_refused_by_name(tmp_path):
    for fields, named in (
        ({"pixel": 0.0}, "pixel is 0"),
        ({"wavelength": 5e-4}, "numerical_aperture and wavelength"),
        ({"numerical_aperture": 2.0, "wavelength": 5e-4}, "limits are 0 and 1.5"),
        ({"numerical_aperture": 0.3, "wavelength": 5e-4, "resolution": 1e-3}, "resolution is given next to"),
        ({"filling": 1.2}, "filling is 1.2"),
    ):
        with pytest.raises(InputError, match=named):
            Instrument(**fields)
    with pytest.raises(InputError, match="no instrument 'zygo'"):
        Instrument.load("zygo")
    (tmp_path / "wrong.toml").write_text("pixel = 2\n")
    with pytest.raises(InputError, match=r"'wrong': pixel: .*no unit"):
        Instrument.load(tmp_path / "wrong.toml")
    with pytest.raises(InputError, match=r"steps of 1 um, the limit for this instrument is 0\.475 um"):
        Instrument.load("zygo-nexview-10x").see(profile(np.zeros(100), step=1e-3))
    flat = profile(np.zeros(100))
    with pytest.raises(InputError, match=r"the measured points reach from .*, the surface from"):
        Instrument(pixel=1e-3).see(flat, like=profile(np.zeros(500)))
    with pytest.raises(InputError, match="polar grid"):
        Instrument(pixel=1e-3).see(HeightMap(z=np.zeros((4, 4)), radius=np.arange(4.0), angle=np.arange(4.0)))
    with pytest.raises(InputError, match="uneven"):
        Instrument(pixel=1e-3).see(replace(flat, distance=np.cumsum(1 + np.arange(100)) * 1e-6))
