"""Cleaning of force records against closed forms."""

import numpy as np
import pytest
from scipy.signal import lfilter

from turnwright.cutting.learning.signals import (
    ForceRecord,
    average_force,
    correlation_time,
    engagements,
    in_air,
    low_pass,
    remove_drift,
)

RATE = 10_000.0


def record(force, rate=RATE):
    force = np.asarray(force)
    return ForceRecord(force=force.reshape(force.shape[0], -1), rate_hz=rate, channels=tuple("abc"[: force[0].size]))


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("frequency", [50.0, 200.0, 500.0])
def test_the_low_pass_is_a_butterworth_filter_without_delay(order, frequency):
    time = np.arange(40_000) / RATE
    tone = np.cos(2 * np.pi * frequency * time)
    out = low_pass(record(tone), 200.0, order).force[:, 0]
    gain = 1 / (1 + (np.tan(np.pi * frequency / RATE) / np.tan(np.pi * 200 / RATE)) ** (2 * order))
    middle = slice(10_000, 30_000)
    assert np.abs(out[middle] - gain * tone[middle]).max() < 1e-7


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_correlation_time_of_an_autoregression_is_closed_form(memory):
    series = lfilter([1], [1, -memory], np.random.default_rng(0).normal(size=400_000))
    assert correlation_time(series) == pytest.approx((1 + memory) / (1 - memory), rel=0.05)


def test_the_uncertainty_of_an_average_counts_correlation():
    """The true standard deviation of the mean of an autoregression is sigma over sqrt(n) (1 - a), for long records."""
    random = np.random.default_rng(1)
    series = lfilter([1], [1, -0.9], random.normal(size=(1000, 4000)))
    found = [average_force(record(one), 500, 4000) for one in series]
    means = np.array([one.mean[0] for one in found])
    stated = np.array([one.uncertainty[0] for one in found])
    true = 1 / np.sqrt(3500) / 0.1
    assert np.sqrt((stated**2).mean()) == pytest.approx(true, rel=0.05)
    assert 0.93 <= (np.abs(means) < 1.96 * stated).mean() <= 0.97


def test_a_polynomial_drift_goes_and_the_cut_stays():
    time = np.linspace(0, 1, 5000)
    cut = (time > 0.3) & (time < 0.6)
    force = 0.7 * cut + 3 - 2 * time + 5 * time**2
    clean = remove_drift(record(force), ~cut, degree=2)
    assert np.abs(clean.force[:, 0] - 0.7 * cut).max() < 1e-12


def test_lines_between_the_stretches_in_air_take_a_crooked_drift():
    time = np.arange(6000) / RATE
    on = (np.arange(6000) // 500) % 2 == 1
    middles = np.array([250, 1250, 2250, 3250, 4250, 5250]) - 0.5
    drift = np.interp(np.arange(6000), middles, [0.0, 3.0, 1.0, 4.0, 1.0, 5.0])
    flat = np.where(on, drift, np.repeat([0.0, 0, 3, 3, 1, 1, 4, 4, 1, 1, 5, 5], 500))  # level in each stretch of air
    clean = remove_drift(record(0.5 * on + flat), ~on, degree=None)
    assert np.abs(clean.force[on, 0] - 0.5)[:5000].max() < 1e-9
    assert time.size == 6000


@pytest.mark.parametrize("seed", range(5))
def test_engagements_are_found_to_the_sample(seed):
    random = np.random.default_rng(seed)
    starts = np.array([1000, 3000, 5500, 8000])
    stops = starts + np.array([900, 1500, 700, 1200])
    force = np.zeros(12_000)
    for first, last in zip(starts, stops, strict=True):
        force[first:last] = random.uniform(0.5, 1.0)
    drift = np.linspace(-1, 2, 12_000) ** 2
    found = engagements(record(force + drift + 0.02 * random.normal(size=12_000)), "a", shortest=0.03, drift=2)
    assert found.tolist() == np.column_stack((starts, stops)).tolist()


def test_in_air_leaves_the_guard_out():
    assert np.flatnonzero(in_air(12, [[4, 6]], guard=2)).tolist() == [0, 1, 8, 9, 10, 11]
