"""Inverse filtering against a dynamometer whose response is a closed form: 3 kHz, 1 % damping, 5 % cross-talk."""

import numpy as np
import pytest

from force_oracle import ACROSS, CHANNELS, RATE, tap_tests, through, true_response
from turnwright.cutting import Dynamometer
from turnwright.cutting.learning.signals import ForceRecord

BAND = {"bandwidth_hz": 5000.0, "noise_to_signal": 0.01}


@pytest.fixture(scope="module")
def quiet():
    """A dynamometer from taps without noise."""
    return Dynamometer.from_taps(tap_tests(np.random.default_rng(0), noise=0.0, hammer_noise=0.0))


def square():
    force = np.zeros((25_600, 3))
    force[5000:20_000] = [0.2, -0.1, 0.05]
    return force


def test_taps_give_the_closed_form_back(quiet):
    at = quiet.frequency_hz
    off = np.abs(quiet.response - true_response(at))[at < 7000].max()
    assert off < 1e-6 * 50  # of the peak, 1 / (2 damping)


def test_responses_are_carried_to_any_frequency_across_the_peak(quiet):
    at = np.linspace(0, 5000, 4001)
    assert np.abs(quiet._interpolate_response(at, 5000.0) - true_response(at)).max() < 1e-5 * 50


def test_a_force_comes_back_through_ringing_and_cross_talk(quiet):
    force = square()
    message = through(force)
    ringing = np.abs(message[5005:5100] - message[15_000]).max()
    found = quiet.forces(ForceRecord(force=message, rate_hz=RATE, channels=CHANNELS), **BAND).force
    left = np.abs(found - force)[5200:19_800].max()
    assert ringing > 0.01
    assert np.abs(message - force)[15_000:16_000].max() > ACROSS * 0.1
    assert left < 5e-4 * 0.2


def test_a_smooth_force_comes_back_within_the_bandwidth(quiet):
    time = np.arange(25_600) / RATE
    bump = np.exp(-(((time - 0.5) / 2e-4) ** 2))  # its spectrum ends at about 4 kHz
    force = bump[:, None] * [1.0, -0.5, 0.25]
    found = quiet.forces(ForceRecord(force=through(force), rate_hz=RATE, channels=CHANNELS), **BAND).force
    assert np.abs(found - force).max() < 5e-4


def test_the_resolution_says_what_a_force_becomes(quiet):
    """Tikhonov on one mode with cross-talk: singular values s of H become s²/(s² + λ²)."""
    at = np.array([10.0, 1000.0, 2950.0, 4500.0])
    found = np.linalg.svd(quiet.resolution(at, bandwidth_hz=5000.0, noise_to_signal=0.2), compute_uv=False)
    true = np.linalg.svd(true_response(at), compute_uv=False)
    gain = np.sort(true**2 / (true**2 + 0.2**2), axis=1)[:, ::-1]
    assert np.abs(found - gain).max() < 1e-5


def test_the_stated_uncertainty_of_the_gain_covers_the_truth():
    inside = []
    for seed in range(40):
        sensor = Dynamometer.from_taps(tap_tests(np.random.default_rng(900 + seed)))
        off = np.abs(sensor.static_gain - true_response(np.zeros(1))[0].real)
        inside.append(off < 1.96 * sensor.gain_uncertainty)
    share = np.mean(inside)
    assert 0.90 <= share <= 0.99  # 360 entries; those of one column hang together


def test_coherence_is_high_where_the_hammer_excites():
    sensor = Dynamometer.from_taps(tap_tests(np.random.default_rng(1)))
    heard = (sensor.frequency_hz > 50) & (sensor.frequency_hz < 7000)
    assert sensor.coherence[heard].min() > 0.95
    assert sensor.coherence.max() <= 1


def test_slanted_taps_serve_as_well_as_those_along_the_axes():
    from turnwright.cutting import TapTest

    random = np.random.default_rng(5)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    slanted = []
    for tap in tap_tests(random, noise=0.0, hammer_noise=0.0):
        direction = turn @ tap.direction
        slanted.append(
            TapTest(
                hammer=tap.hammer,
                direction=direction,
                response=through(tap.hammer[:, None] * direction),
                rate_hz=RATE,
            )
        )
    sensor = Dynamometer.from_taps(slanted)
    at = sensor.frequency_hz
    assert np.abs(sensor.response - true_response(at))[at < 7000].max() < 1e-6 * 50
