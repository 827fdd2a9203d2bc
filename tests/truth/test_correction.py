"""The surface to aim at after a measurement: a smoothing plate against its transfer in closed form, and its limits."""

import numpy as np
import pytest

from turnwright import HeightMap, InputError, Part, Plane
from turnwright.metrology.smoothing import _bin_points, _fit_table, form_compensation, smooth_table

FLAT = Part(surface=Plane(slope=(0.0, 0.0)), radius=5.0)


def scattered(form, noise=0.0, count=40_000):
    rng = np.random.default_rng(3)
    radius, angle = 5 * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return HeightMap(x=x, y=y, z=form(x, y) + noise * rng.normal(size=count))


def level(x, y):
    return 0.0 * x * y


def tilted(x, y):
    return 1e-4 * x - 2e-4 * y


@pytest.mark.parametrize("wavelength", [1.0, 1.5, 2.0, 4.0])
def test_a_wave_keeps_the_share_of_a_thin_plate(wavelength):
    """Oracle: 1 / (1 + (cutoff / wavelength)^4), the Euler equation of the plate (Green & Silverman, ch. 7)."""
    side = np.linspace(-6, 6, 241)
    x, y = (at.ravel() for at in np.meshgrid(side, side))
    wave = np.cos(2 * np.pi * (0.8 * x + 0.6 * y) / wavelength)
    table = _fit_table(_bin_points(x, y, wave, 0.1, 7.0), 1.0, 7.0)
    inner = np.hypot(x, y) < 3.5
    kept = (table.sag(x, y)[inner] @ wave[inner]) / (wave[inner] @ wave[inner])
    # Means over cells and the splines' own reach cost a percent at five steps to the cutoff.
    assert kept == pytest.approx(1 / (1 + wavelength**-4), abs=0.012)


def test_what_repeats_is_taken_off_and_noise_is_not_added():
    """Oracle: the injected form; noise of n points spread over the plate's effective area."""

    def form(x, y):
        return 1e-4 * np.cos(2 * np.pi * x / 4) + 2e-6 * x * y

    error = scattered(form, noise=2e-5)
    aim = form_compensation(FLAT, error, cutoff=0.5, beyond=1.0).table
    left = form(error.x, error.y) + aim.sag(error.x, error.y)
    assert np.sqrt(np.mean(left**2)) < 4e-6  # 100 nm of form under 20 nm of noise
    rim = np.hypot(error.x, error.y) > 4.8
    assert np.sqrt(np.mean(left[rim] ** 2)) < 8e-6


def test_noise_alone_leaves_the_part_as_it_is():
    error = scattered(level, noise=2e-5)
    assert form_compensation(FLAT, error, cutoff=0.5, beyond=1.0).cutoff is None


def test_a_plane_runs_on_as_a_plane_over_missing_places():
    """Oracle: a plane bends nowhere."""
    error = scattered(tilted)
    gone = (np.hypot(error.x - 2, error.y) < 1.5) | (error.y < -3)
    error = HeightMap(x=error.x, y=error.y, z=np.where(gone, np.nan, error.z))
    aim = form_compensation(FLAT, error, cutoff=0.5, beyond=1.0).table
    assert np.abs(aim.sag(error.x, error.y) + 1e-4 * error.x - 2e-4 * error.y).max() < 1e-9


@pytest.mark.parametrize(
    ("error", "cutoff", "beyond", "words"),
    [
        (scattered(tilted, count=50), 0.5, 1.0, "50 heights"),
        (scattered(tilted), 0.01, 1.0, "0.05 to 5 mm"),
        (scattered(tilted), 6.0, 1.0, "0.05 to 5 mm"),
        (scattered(tilted), 0.5, 0.0, "beyond"),
        (HeightMap(x=np.arange(3.0), y=np.arange(3.0), z=np.zeros((3, 3)), calibrated=False), 0.5, 1.0, "pixel size"),
    ],
)
def test_what_cannot_be_corrected_is_reported(error, cutoff, beyond, words):
    with pytest.raises(InputError, match=words):
        form_compensation(FLAT, error, cutoff=cutoff, beyond=beyond)


def test_a_map_as_coarse_as_two_cells_is_corrected_too():
    """Every pixel fell into a cell of one colour. The plate takes 1.5 % of such a wave, noise is 1.4 %."""
    side = np.arange(-20, 21) * 0.2
    x, y = (at.ravel() for at in np.meshgrid(side, side))
    wave = 1e-4 * np.cos(2 * np.pi * x / 4.0) + 1e-6 * np.random.default_rng(1).normal(size=x.size)
    found = smooth_table(x, y, wave, cutoff=1.0, reach=4.15)
    assert found.cutoff is not None
    assert np.std(found.table.sag(x, y) - wave) < 0.04 * np.std(wave)
