"""Error messages of learning from forces and of the finish terms."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.cutting import Cuts, Dynamometer, NoseCuts, TapTest, learn_material, measured_cuts
from turnwright.cutting.finish import MinimumChip, Vibration, add_vibration, cusp_height, predict_uncut_height
from turnwright.cutting.fracture import ri80
from turnwright.cutting.learning.signals import (
    ForceRecord,
    average_force,
    correlation_time,
    engagements,
    low_pass,
    remove_drift,
)
from turnwright.errors import InputError


def record(n=1000, channels=("a",)):
    return ForceRecord(force=np.ones((n, len(channels))), rate_hz=1000.0, channels=channels)


def tap(direction=(1, 0, 0), n=256, ends=0.0):
    hammer = np.zeros(n)
    hammer[20] = 10.0
    response = np.outer(hammer, direction) + ends * (-1.0) ** np.arange(n)[:, None]
    return TapTest(hammer=hammer, direction=direction, response=response, rate_hz=10_000.0)


def taps(turns=2):
    return [tap(direction) for direction in np.eye(3) for _ in range(turns)]


def sensor(n=64, gain=None, heard=None):
    gain = np.eye(3) if gain is None else gain
    response = np.tile((gain if heard is None else heard).astype(complex), (n, 1, 1))
    return Dynamometer(
        frequency_hz=10.0 * np.arange(n), response=response, static_gain=gain, gain_uncertainty=np.zeros((3, 3))
    )


def cuts(n=10, **more):
    chip = np.linspace(1e-4, 3e-4, n)
    return Cuts(**{"thickness": chip, "width": np.ones(n), "cutting": 1500 * chip, "thrust": 800 * chip, **more})


def motion(**more):
    angle = np.linspace(0, 60, 601)
    axes = {"C": angle, "X": 1 - angle / 1000, "Z": 0 * angle}
    return tw.Motion(time=angle, axes=axes, machine=tw.Machine.load("generic"), **more)


TOOL = {"nose_radius": 0.5, "clearance": np.deg2rad(10), "included": np.deg2rad(60)}
STILL = {letter: np.zeros(601) for letter in "CXZ"}
ON = {"chip": MinimumChip(thickness=1e-5), "radius": [0.9], "angle": [0.0]}

# ruff: noqa: E501 - a table
WRONG = {
    "names of columns": (lambda: ForceRecord(force=[[1, 2]], rate_hz=1, channels=("a",)), "got 2 columns and the channels a"),
    "one sample": (lambda: record(1), "must have at least 2 samples, got 1"),
    "no rate": (lambda: ForceRecord(force=[[1], [2]], rate_hz=0, channels=("a",)), "rate_hz is 0 Hz"),
    "another channel": (lambda: record().channel("b"), "has no channel 'b', it has a"),
    "cut-off": (lambda: low_pass(record(), 500.0, 2), "cutoff_hz must be between 0 and 500 Hz (half the sampling rate), got 500 Hz"),
    "order": (lambda: low_pass(record(), 100.0, 0), "the order of a low-pass is 0, it must be a whole number, 1 to 10"),
    "order that is no number": (lambda: low_pass(record(), 100.0, "4"), "the order of a low-pass is '4', it must be a whole number, 1 to 10"),
    "one value": (lambda: correlation_time([1.0]), "at least 2 values, got 1"),
    "short average": (lambda: average_force(record(), 5, 9), "at least 8 of the 1000 samples, got 5 to 9"),
    "nothing but cut": (
        lambda: engagements(record(), "a", shortest=0.015, lead=0.002),
        "the tool is never in air",
    ),
    "nothing cut": (lambda: engagements(record(), "a", shortest=0.05), "the tool is always in air"),
    "shortest": (lambda: engagements(record(), "a", shortest=0.001), "shortest must span 8 to 250 samples, got 0.001 s"),
    "air of another length": (lambda: remove_drift(record(), [True], degree=1), "air must have the shape (1000,) of the samples, got (1,)"),
    "no air": (lambda: remove_drift(record(), np.zeros(1000, bool), degree=None), "got 0 samples"),
    "little air": (lambda: remove_drift(record(), np.arange(1000) < 2, degree=1), "more than 2 samples in air, got 2"),
    "a tap of no direction": (lambda: tap((0, 0, 0)), "direction of a tap must be 3 numbers that are not all 0, got [0.0, 0.0, 0.0]"),
    "a tap that rings on": (lambda: tap(ends=2.0), "at the end of a tap record must be at most 5%"),
    "a short tap": (lambda: tap(n=40), "at least 64 samples"),
    "five taps": (lambda: Dynamometer.from_taps(taps()[:5]), "at least 6 taps are needed"),
    "taps in a plane": (lambda: Dynamometer.from_taps([*taps()[:4], tap(), tap()]), "3 independent directions"),
    "taps of two lengths": (lambda: Dynamometer.from_taps([*taps()[:5], tap((0, 0, 1), 512)]), "same sampling rate and length"),
    "a low spring": (lambda: Dynamometer.from_taps(taps(), flat_hz=100), "at least 9 frequencies are needed up to flat_hz, 100 Hz"),
    "odd frequencies": (
        lambda: Dynamometer(frequency_hz=np.arange(64) ** 2, response=np.zeros((64, 3, 3)), static_gain=np.eye(3),
                            gain_uncertainty=np.eye(3)),
        "frequency_hz of a dynamometer must be evenly spaced",
    ),
    "a gain of two axes": (lambda: sensor(gain=np.diag([1.0, 1.0, 0.0])), "must be above 1e-06 of the largest, got 0 to 1"),
    "a gain of nothing": (lambda: sensor(gain=np.zeros((3, 3))), "singular values of static_gain"),
    "a small gain": (
        lambda: Dynamometer(frequency_hz=np.arange(64), response=np.ones((64, 3, 3)), static_gain=np.eye(2),
                            gain_uncertainty=np.eye(3)),
        "static_gain must have the shape (3, 3), got (2, 2)",
    ),
    "a singular response": (
        lambda: sensor(heard=np.zeros((3, 3))).forces(record(channels=("a", "b", "c")), bandwidth_hz=100,
                                                      noise_to_signal=0),
        "noise_to_signal must be above 0",
    ),
    "one channel": (
        lambda: sensor().forces(record(), bandwidth_hz=100, noise_to_signal=0), "must have 3 channels, got 1"
    ),
    "a wide band": (
        lambda: sensor().forces(record(channels=("a", "b", "c")), bandwidth_hz=600, noise_to_signal=0),
        "bandwidth_hz must be at most 416.7 Hz",
    ),
    "much noise": (
        lambda: sensor().forces(record(channels=("a", "b", "c")), bandwidth_hz=100, noise_to_signal=2),
        "noise_to_signal is 2",
    ),
    "resolution beyond": (
        lambda: sensor().resolution([300.0], bandwidth_hz=100, noise_to_signal=0), "frequency_hz must be 0 to 120 Hz"
    ),
    "cuts of two lengths": (lambda: cuts(width=np.ones(3)), "width 3"),
    "thin cuts": (lambda: cuts(width=-np.ones(10)), "thickness and width of the cuts must be at least 0 mm, got -1 mm"),
    "uncertainty of one": (lambda: cuts(uncertainty=np.ones((10, 1))), "must be 2 positive numbers for each cut"),
    "few cuts": (lambda: learn_material(cuts(3)), "at least 4 rows must be cuts, got 3"),
    "drift without time": (lambda: learn_material(cuts(), drift=1), "a drift needs the times of the cuts"),
    "drift without air": (lambda: learn_material(cuts(time=np.arange(10)), drift=1), "more than 2 rows in air for each record, got 0"),
    "confidence": (lambda: learn_material(cuts(), confidence=95), "confidence is 95"),
    "edge and size effect": (
        lambda: learn_material(cuts(), edge_force=True, size_effect=True), "only one of edge_force and size_effect"
    ),
    "one thickness and an edge": (
        lambda: learn_material(cuts(thickness=np.full(10, 1e-4)), edge_force=True), "do not determine the 2 coefficients"
    ),
    "a long block": (
        lambda: measured_cuts(record(), [[0, 50]], cutting="a", thrust="a", thickness=np.ones_like, width=1,
                              block=0.1, guard=0),
        "no interval of 0.1 s fits in a cut",
    ),
    "no reference": (lambda: ri80([[1.0]], np.nan), "the reference holds no finite intensity"),
    "a dark reference": (lambda: ri80([[1.0]], 0.0), "the reference is 0 of intensity"),
    "nothing measured": (lambda: ri80([[np.nan]], 1.0), "at least 1 measured value, got none in 1"),
    "an endless intensity": (lambda: ri80([[np.inf, 1.0]], 1.0), "intensity must be finite, got 1 infinite"),
    "no amplitude": (lambda: Vibration(amplitude=0, frequency_hz=1), "amplitude of a vibration is 0 mm"),
    "no phase": (lambda: Vibration(amplitude=1, frequency_hz=1, phase=np.nan), "phase is nan"),
    "no chip": (lambda: MinimumChip(thickness=0), "the minimum chip thickness is 0 mm"),
    "recovery": (lambda: MinimumChip(thickness=1, recovery=2), "recovery is 2"),
    "friction": (lambda: MinimumChip.of_edge(1e-5, np.pi / 2), "friction_angle is 1.5708 rad (90 deg)"),
    "a thick minimum chip": (lambda: cusp_height(0.01, 0.5, 2e-4), "minimum_chip is 0.0002 mm, the limits are 0 to 0.0001"),
    "velocities": (
        lambda: add_vibration(motion(velocity=STILL), Vibration(amplitude=1e-5, frequency_hz=1)), "states velocities"
    ),
    "a fast vibration": (
        lambda: add_vibration(motion(), Vibration(amplitude=1e-5, frequency_hz=1e6)), "the limit is 5e+07"
    ),
    "a raked edge": (
        lambda: predict_uncut_height(motion(), tw.Tool(**TOOL, rake=-0.4), **ON), "rake, tool height error and Y must be 0"
    ),
    "a grid that falls": (
        lambda: predict_uncut_height(motion(), tw.Tool(**TOOL), **ON | {"radius": [1.0, 0.9]}), "radius must be strictly ascending"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_values_are_refused_in_one_sentence(case):
    attempt, sentence = WRONG[case]
    with pytest.raises(InputError) as caught:
        attempt()
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_force_along_an_axis_is_uncertain_beyond_measure():
    assert sensor().relative_uncertainty([1.0, 2.0, 0.0]).tolist() == [0.0, 0.0, np.inf]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"thickness": np.linspace(0.05, 1.2, 30)}, r"the thickest chip is 1\.2 mm, the limit is 0\.1 mm"),
        ({"cutting": np.zeros(30)}, "the cutting force of all cuts is 0 N"),
        ({"thrust": np.zeros(30)}, "the thrust of all cuts is 0 N"),
        ({"cutting": -np.linspace(0.01, 0.2, 30)}, r"the cutting coefficient is -.*above 0"),
        ({"thrust": -160 * np.linspace(50e-6, 600e-6, 30)}, r"the thrust coefficient is -800 .*above 0"),
        (
            {"thickness": np.linspace(50e-9, 600e-9, 30)},
            r"cutting coefficient .* 1\.5e\+06 .* 10 to 1e\+05 N/mm\^2: .* mm",
        ),
        ({"width": np.full(30, 200.0)}, r"cutting coefficient .* 1\.5 N/mm\^2, .* width .* mm"),
        ({"thrust": 160e3 * np.linspace(50e-6, 600e-6, 30)}, r"thrust coefficient .* 8e\+05 .* forces in N"),
        (
            dict.fromkeys(("thickness", "width", "cutting", "thrust"), np.zeros(0)),
            "at least 4 rows must be cuts, got 0",
        ),
    ],
)
def test_implausible_cuts_are_refused(change, message):
    chip = np.linspace(50e-6, 600e-6, 30)
    given = {"thickness": chip, "width": np.full(30, 0.2), "cutting": 300 * chip, "thrust": 160 * chip} | change
    with pytest.raises(InputError, match=message):
        learn_material(Cuts(**given))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"feed": np.linspace(0.1, 1.0, 30), "depth": np.full(30, 0.5)},
            r"the thickest chip is .* mm, the limit is 0\.1 mm",
        ),
        ({"axial": np.zeros(30)}, "the axial force of all cuts is 0 N"),
        ({"cutting": -0.02 * np.linspace(0.5, 5.0, 30)}, r"the cutting coefficient is -.*above 0"),
    ],
)
def test_implausible_nose_cuts_are_refused(change, message):
    feed = np.linspace(0.5e-3, 5e-3, 30)
    given = {"nose_radius": np.ones(30), "depth": np.full(30, 0.02), "feed": feed, "axial": 8 * feed}
    with pytest.raises(InputError, match=message):
        learn_material(NoseCuts(**{**given, "cutting": 15 * feed, **change}))
