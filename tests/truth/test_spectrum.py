"""Spectra against Parseval's theorem, sums over the definition, SciPy's periodogram and closed forms."""

import numpy as np
import pytest
from scipy import signal

from turnwright._kernels.rectangle import largest_rectangle
from turnwright.heightmap import HeightMap
from turnwright.metrology import area_psd, line_profile, line_psd


def noise(shape, seed=1):
    return np.random.default_rng(seed).standard_normal(shape) * 1e-6


def plain(z, dx=0.1, dy=0.2):
    return HeightMap(x=np.arange(z.shape[1]) * dx, y=np.arange(z.shape[0]) * dy, z=z)


@pytest.mark.parametrize("shape", [(40, 51), (41, 50), (16, 16), (15, 17)])
@pytest.mark.parametrize("window", ["none", "hann", "blackman"])
def test_an_area_keeps_the_mean_square_under_its_window(shape, window):
    z = noise(shape)
    found = area_psd(plain(z), form="none", window=window)
    w = np.ones(shape)
    for axis, size in enumerate(shape):
        turn = 2 * np.pi * (np.arange(size) + 0.5) / size
        taper = {
            "none": 1 + 0 * turn,
            "hann": 0.5 - 0.5 * np.cos(turn),
            "blackman": 0.42 - 0.5 * np.cos(turn) + 0.08 * np.cos(2 * turn),
        }[window]
        w = w * (taper[:, None] if axis == 0 else taper)
    left = z - (w * z).sum() / w.sum()
    assert found.rms_nm == pytest.approx(1e6 * np.sqrt((w**2 * left**2).sum() / (w**2).sum()), rel=1e-12)
    assert found.band_rms_nm(0, np.inf) == pytest.approx(found.rms_nm, rel=1e-12)
    # By the sum that defines it, at a few places.
    y, x = np.arange(shape[0])[:, None] * 0.2, np.arange(shape[1]) * 0.1
    for i, j in ((0, 0), (3, 5), (shape[0] - 1, 1), (shape[0] // 2, shape[1] // 2)):
        wave = np.exp(-2j * np.pi * (found.frequency_x[j] * x + found.frequency_y[i] * y))
        truth = np.abs((w * left * wave).sum() * 1e6) ** 2 * 0.02 / (w**2).sum()
        assert found.density[i, j] == pytest.approx(truth, rel=1e-9, abs=1e-18)


@pytest.mark.parametrize("size", [50, 51])
def test_lines_are_scipys_periodogram(size):
    z = noise((20, size))
    found = line_psd(plain(z), along="x", form="none", window="none")
    frequency, density = signal.periodogram(z * 1e6, 10.0, detrend="constant")
    assert found.frequency == pytest.approx(frequency)
    inside = slice(1, -1 if size % 2 == 0 else None)
    assert found.density[inside] == pytest.approx(density.mean(axis=0)[inside], rel=1e-12)
    if size % 2 == 0:
        # The bin of the highest frequency is half as wide, which SciPy leaves to who integrates.
        assert found.density[-1] == pytest.approx(2 * density.mean(axis=0)[-1], rel=1e-12)
    assert found.rms_nm == pytest.approx(1e6 * np.sqrt(z.var(axis=1).mean()), rel=1e-12)
    turned = line_psd(
        HeightMap(x=np.arange(20) * 0.2, y=np.arange(size) * 0.1, z=z.T), along="y", form="none", window="none"
    )
    assert turned.density == pytest.approx(found.density, rel=1e-12)


def test_white_noise_has_its_spectral_density():
    found = area_psd(plain(noise((400, 500))), form="mean", window="hann")
    radial = found.radial()
    mean = np.average(radial.density[2:], weights=np.diff(radial.edges**2)[2:])
    assert mean == pytest.approx(1.0 * 0.1 * 0.2, rel=0.03)  # some 10 000 independent bins under a Hann window
    lines = line_psd(plain(noise((400, 500))), along="x", form="none", window="hann")
    assert lines.density[2:-1].mean() == pytest.approx(2 * 0.1, rel=0.02)
    # A band holds its share of a white spectrum's square, of lines and of the area.
    assert lines.band_rms_nm(1, 3) ** 2 == pytest.approx(2 / 5, rel=0.03)
    assert found.band_rms_nm(0.5, 2.0) ** 2 == pytest.approx(np.pi * (2**2 - 0.5**2) * 0.02, rel=0.03)
    assert found.radial().band_rms_nm(0.5, 2.0) == pytest.approx(found.band_rms_nm(0.5, 2.0), rel=0.02)


@pytest.mark.parametrize("window", ["none", "hann", "blackman"])
def test_a_ripple_has_its_rms_in_its_band_and_nothing_elsewhere(window):
    x = np.arange(600) * 0.01
    z = 20e-6 * np.sin(2 * np.pi * 5 * x) * np.ones((300, 1)) + 5e-6 * np.sin(2 * np.pi * 15 * x[:300])[:, None]
    found = area_psd(HeightMap(x=x, y=x[:300], z=z), form="mean", window=window)
    assert found.band_rms_nm(4, 6) == pytest.approx(20 / np.sqrt(2), rel=1e-3)
    assert found.band_rms_nm(14, 16) == pytest.approx(5 / np.sqrt(2), rel=1e-3)
    assert found.band_rms_nm(7, 13) < 1e-2
    lines = line_psd(HeightMap(x=x, y=x[:300], z=z), along="x", form="none", window=window)
    assert lines.band_rms_nm(4, 6) == pytest.approx(20 / np.sqrt(2), rel=1e-3)


def test_radial_lines_of_a_turned_part_show_its_feed():
    feed = 0.010
    radius, angle = 0.5 + np.arange(2000) * 0.0005, np.linspace(0, 2 * np.pi, 13)[:-1]
    t = (radius / feed - angle[:, None] / (2 * np.pi)) % 1 - 0.5
    ring = HeightMap(radius=radius, angle=angle, z=24e-6 * (2 * t) ** 2)
    found = line_psd(ring, along="radius", form="none")
    # The harmonics of a parabola between passes: z = PV (1/3 + 4/pi² sum (-1)^n cos(2 pi n t) / n²).
    for harmonic in (1, 2, 3):
        rms = found.band_rms_nm((harmonic - 0.2) / feed, (harmonic + 0.2) / feed)
        assert rms == pytest.approx(24 * 4 / np.pi**2 / harmonic**2 / np.sqrt(2), rel=0.01 * harmonic**2)
    profile = line_profile(ring, (0.5, 0.0), (1.4995, 0.0))
    one = line_psd(profile, form="none")
    assert one.density == pytest.approx(
        line_psd(HeightMap(radius=radius, angle=[0.0], z=ring.z[:1]), along="radius", form="none").density,
        rel=1e-6,
        abs=1e-9,
    )


def test_the_largest_rectangle_is_that_of_trying_all():
    rng = np.random.default_rng(3)
    for share in (0.05, 0.3, 0.6, 0.95):
        for _ in range(8):
            valid = rng.random((9, 11)) > share
            sums = np.pad(valid, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
            best = max(
                [
                    (k - i) * (m - j) * 0.5
                    for i in range(9)
                    for k in range(i + 1, 10)
                    for j in range(11)
                    for m in range(j + 1, 12)
                    if sums[k, m] - sums[i, m] - sums[k, j] + sums[i, j] == (k - i) * (m - j)
                ],
                default=0,
            )
            row, rows, column, columns = largest_rectangle(valid, 0.25, 2.0)
            assert rows * columns * 0.5 == best
            assert valid[row : row + rows, column : column + columns].all()


def test_missing_points_leave_a_rectangle_or_a_mask():
    rng = np.random.default_rng(4)
    x = np.arange(300) * 0.02
    z = noise((300, 300)) + 30e-6 * np.sin(2 * np.pi * 6 * x)
    z[np.hypot(x - 3, x[:, None] - 3) > 2.9] = np.nan
    z[rng.random(z.shape) < 1e-4] = np.nan
    holed = HeightMap(x=x, y=x, z=z)
    for missing, message in (("rectangle", "largest rectangle without gaps"), ("mask", "smears")):
        found = area_psd(holed, missing=missing)
        assert found.band_rms_nm(5, 7) == pytest.approx(30 / np.sqrt(2), rel=0.02)
        assert found.radial().density[-20:].mean() == pytest.approx(
            1.0 * 0.02**2, rel=0.1 if missing == "mask" else 0.2
        )
        assert message in found.notes[0]
        lines = line_psd(holed, along="y", missing=missing)
        assert lines.band_rms_nm(10, 20) ** 2 == pytest.approx(10 / 25, rel=0.1)
    # Parseval with a mask: the mean square of what is valid, its weighted mean taken off.
    found = area_psd(holed, form="none", window="none", missing="mask")
    assert found.rms_nm == pytest.approx(1e6 * np.nanstd(z), rel=1e-12)


def test_an_isotropic_map_has_the_density_of_its_filter():
    # White noise through a Gaussian of width w has the density s² dx dy exp(-4 pi² w² f²) before s is set to 1 nm rms.
    from scipy import ndimage

    width, step = 3.0, 0.01
    z = ndimage.gaussian_filter(noise((1000, 1000)), width, mode="wrap")
    radial = area_psd(HeightMap(x=np.arange(1000) * step, y=np.arange(1000) * step, z=z), form="none").radial()
    ring = np.arange(5, 100)
    truth = step**2 * np.exp(-4 * np.pi**2 * (width * step) ** 2 * radial.frequency[ring] ** 2)
    off = radial.density[ring] / truth - 1
    # A ring of number k has 2 pi k bins, of which the mirrored half says nothing new, under a window 1.9 wide each way.
    spread = 1.9 / np.sqrt(np.pi * ring)
    assert np.abs(off / spread).max() < 4
    assert np.average(off, weights=ring) == pytest.approx(0, abs=0.02)
