"""Forces of cuts whose truth is known, through a dynamometer whose response is a closed form."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from turnwright.cutting import Dynamometer, TapTest, learn_material, measured_cuts
from turnwright.cutting.learning.signals import ForceRecord, engagements, in_air, remove_drift

RATE = 25_600.0
RESONANCE, DAMPING, ACROSS = 3000.0, 0.01, 0.05
FIRST, LAST = 50e-6, 1200e-6
WIDTH = 0.2
CHANNELS = ("Fx", "Fy", "Fz")


def true_response(frequency):
    """A damped spring in every channel, and 5 % of it in the other two. (m, 3, 3)."""
    spring = 1 / (1 - (frequency / RESONANCE) ** 2 + 2j * DAMPING * frequency / RESONANCE)
    return spring[:, None, None] * (np.full((3, 3), ACROSS) + (1 - ACROSS) * np.eye(3))


def through(force, rate=RATE):
    """What the dynamometer makes of a force that begins after the record does. (n, 3)."""
    count = 2 * force.shape[0]
    frequency = np.fft.rfftfreq(count, 1 / rate)
    spectrum = np.fft.rfft(np.concatenate([force, np.zeros_like(force)]), axis=0)
    measured = np.fft.irfft((true_response(frequency) @ spectrum[:, :, None])[:, :, 0], count, axis=0)
    return measured[: force.shape[0]]


def tap_tests(random, *, each=5, count=2560, rate=RATE, noise=1e-3, hammer_noise=0.01):
    """Taps of about 10 N along each axis."""
    time = np.arange(count) / rate
    taps = []
    for axis in range(3):
        for _ in range(each):
            middle = 0.01 + random.uniform(0, 1e-4)
            width = 1.2e-4
            stroke = np.where(np.abs(time - middle) < width / 2, np.cos(np.pi * (time - middle) / width) ** 2, 0.0)
            stroke *= 10 * random.uniform(0.7, 1.3)
            direction = np.eye(3)[axis]
            measured = through(stroke[:, None] * direction, rate)
            taps.append(
                TapTest(
                    hammer=stroke + hammer_noise * random.normal(size=count),
                    direction=direction,
                    response=measured + noise * random.normal(size=measured.shape),
                    rate_hz=rate,
                )
            )
    return taps


@dataclass(frozen=True)
class Truth:
    cutting: float
    thrust: float
    critical: float


def ramp_record(random, *, seconds=1.4, noise=5e-3, period=0.05, engaged=0.035):
    """An interrupted cut whose chip grows, ductile first and then brittle; noise that hangs together, and drift."""
    truth = Truth(
        cutting=1489 * random.uniform(0.8, 1.2),
        thrust=816 * random.uniform(0.8, 1.2),
        critical=600e-6 * random.uniform(0.7, 1.3),
    )
    count = int(RATE * seconds)
    time = np.arange(count) / RATE
    begin = 0.1 + random.uniform(0, 0.01)
    end = begin + 1.185
    on = (time >= begin) & (time < end) & ((time - begin) % period < engaged)
    chip = FIRST + (LAST - FIRST) * (time - begin) / (end - begin)
    brittle = on & (chip > truth.critical)
    cutting = np.where(brittle, truth.cutting * truth.critical * 0.6, truth.cutting * chip) * WIDTH * on
    thrust = np.where(brittle, truth.thrust * truth.critical * 0.7, truth.thrust * chip) * WIDTH * on
    # Fracture comes and goes: the force of brittle cutting fluctuates.
    cutting = cutting * (1 + 0.05 * brittle * lfilter([0.3], [1, -0.954], random.normal(size=count)))
    measured = through(np.column_stack((0.1 * cutting, cutting, thrust)))
    together = np.sqrt(0.75) * lfilter([1], [1, -0.5], random.normal(size=measured.shape), axis=0)
    share = (time / seconds)[:, None]
    drift = (
        np.array([0.02, -0.05, 0.03]) * share + np.array([0.01, 0.01, -0.02]) * share**2 + 0.1 * random.normal(size=3)
    )
    return ForceRecord(force=measured + noise * together + drift, rate_hz=RATE, channels=CHANNELS), truth


def learned(record, taps, **more):
    """The whole way from record and taps to a material; ``more`` goes to the search of the cuts."""
    sensor = Dynamometer.from_taps(taps)
    true = sensor.forces(record, bandwidth_hz=5000.0, noise_to_signal=0.01)
    cuts = engagements(true, "Fy", shortest=0.01, drift=2, **more)
    first, last = cuts[0, 0] / RATE, cuts[-1, 1] / RATE
    rows = measured_cuts(
        true,
        cuts,
        cutting="Fy",
        thrust="Fz",
        thickness=lambda at: FIRST + (LAST - FIRST) * (at - first) / (last - first),
        width=WIDTH,
        block=1e-3,
        guard=1e-3,
    )
    air = in_air(true.samples, cuts)
    share = sensor.relative_uncertainty(remove_drift(true, air, degree=2).force[~air].mean(axis=0))
    return learn_material(rows, drift=2, calibration=(float(share[1]), float(share[2])), thickness_uncertainty=0.2e-6)
