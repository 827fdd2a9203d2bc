"""Pre-correction on the parts of the examples: the error that the servos leave on the part falls as it must.

The servo is the one of the literature's marks: 100 Hz, damping 0.7, velocity feed-forward. Oracle of what is left by a
wrong model: with full velocity feed-forward an axis misses 1 - H = (f/f0)² to first order, so that of the error a model
of f0 leaves |1.2² - 1| where the axis has 20 % less bandwidth, and |0.8² - 1| where it is faster.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turnwright as tw

EXAMPLES = Path(__file__).parents[2] / "examples"
SERVO = tw.machine.SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1)
AZIMUTHS = 89


def with_servos(machine, response):
    axes = {
        letter: axis if letter == "C" else replace(axis, response=response) for letter, axis in machine.axes.items()
    }
    return replace(machine, axes=axes, block_rate_hz=5000)


class Cut:
    """A part, and its surface by a command, and by the exact path."""

    def __init__(self, example, strategy, *, radius=None):
        job = tw.Job.load(EXAMPLES / f"{example}.toml")
        self.part, self.tool = job.part, job.tool
        if radius is not None:
            self.part = replace(self.part, radius=radius)
        self.machine = with_servos(job.machine, SERVO)
        self.grid = {
            "radius": np.linspace(0.05, 0.97 * self.part.radius, 400),
            "angle": np.linspace(0, 2 * np.pi, AZIMUTHS, endpoint=False),
        }
        self.motion = self.driven(strategy)
        # With points on all azimuths that are looked at, straight lines miss nothing there.
        exact = tw.SlowToolServo(
            feed=strategy.feed, points_per_rev=16 * AZIMUTHS, spindle_rpm=strategy.spindle_rpm, lead_in=strategy.lead_in
        )
        self.exact = tw.generate_polar(self.driven(exact), self.tool, **self.grid).z

    def driven(self, strategy):
        path = tw.place(strategy.spiral(self.part, self.tool), self.part, self.tool)
        return tw.drive(path, strategy, self.machine)

    def error(self, command, factor=1.0):
        """Return the surface of axes slower than their model by a factor, minus that of the exact path. [nm]."""
        real = tw.track(command, with_servos(self.machine, SERVO.slower(factor)))
        return 1e6 * (tw.generate_polar(real, self.tool, **self.grid).z - self.exact)


def rms(z):
    return np.sqrt(np.mean(z**2))


@pytest.fixture(scope="module")
def lens():
    return Cut("infrared_lens", tw.SlowToolServo(feed=0.1, points_per_rev=3600, spindle_rpm=60, lead_in=0.25))


def test_precorrection_leaves_a_twentieth_of_the_lens_error(lens):
    before, after = lens.error(lens.motion), lens.error(tw.precorrect(lens.motion))
    assert np.ptp(before) > 100
    assert np.ptp(after) < 0.05 * np.ptp(before)
    assert rms(after) < 0.04 * rms(before)


@pytest.mark.parametrize("factor", [1.2, pytest.param(0.8, marks=pytest.mark.proof)])
def test_a_wrong_model_leaves_its_own_square(lens, factor):
    command = tw.precorrect(lens.motion)
    before = rms(lens.error(lens.motion))
    share = abs(factor**2 - 1)
    assert rms(lens.error(command, factor)) == pytest.approx(share * before, rel=0.03)
    really = with_servos(lens.machine, SERVO.slower(factor))
    log = {letter: lens.motion.axes[letter] - _at(tw.track(command, really), command, letter) for letter in "XZ"}
    again = tw.precorrect(command, missed=log)
    # |1 - H_real/H| is of second order itself, so a log leaves less than a hundredth: what is left are the chords.
    assert rms(lens.error(again, factor)) < 0.04 * before


def _at(real, command, letter):
    return np.interp(command.time, real.time, real.axes[letter])


def test_the_lens_array_is_corrected_everywhere():
    strategy = tw.SlowToolServo(feed=0.02, arc_length=0.004, max_step=np.deg2rad(0.5), spindle_rpm=30)
    cut = Cut("hexagonal_array", strategy, radius=1.0)
    radius, angle = cut.grid["radius"], cut.grid["angle"][:, None]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    centres = [(i + j / 2, j * np.sqrt(3) / 2) for i in range(-3, 4) for j in range(-2, 3)]
    optical = np.min([np.hypot(x - at_x, y - at_y) for at_x, at_y in centres], axis=0) < 0.35
    command = tw.precorrect(cut.motion)
    before, after = cut.error(cut.motion), cut.error(command)
    assert np.ptp(after[optical]) < 0.3 * np.ptp(before[optical])
    assert rms(after[optical]) < 0.1 * rms(before[optical])
    # In the valleys the path has slope discontinuities, which no axis follows.
    assert rms(after) < 0.3 * rms(before)
    for factor in (0.8, 1.2):
        wrong = cut.error(command, factor)
        assert rms(wrong[optical]) < 0.55 * rms(before[optical])
