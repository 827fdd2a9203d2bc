"""Straight pieces that stand for a controller's curves. Oracle: SciPy's cubics through positions and velocities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import turnwright as tw
from turnwright.job import interpolation as _interpolated
from turnwright.job.interpolation import chord_error, interpolate_motion

MACHINE = tw.Machine(
    name="test",
    axes={letter: tw.Axis() for letter in "CXZ"},
    spindle_rpm=3000.0,
    block_rate_hz=1000.0,
    controller=tw.Controller(interpolation="hermite"),
)


def pvt_motion(points):
    """Two waves a turn of 20 um, at so few points a turn that the cubics bulge."""
    time = np.arange(5 * points + 1) / points
    axes = {"C": 2 * np.pi * time, "X": 3.0 - 0.01 * time, "Z": 0.02 * np.sin(4 * np.pi * time)}
    velocity = {
        "C": np.full(time.size, 2 * np.pi),
        "X": np.full(time.size, -0.01),
        "Z": 0.08 * np.pi * np.cos(4 * np.pi * time),
    }
    return tw.Motion(time=time, axes=axes, velocity=velocity, machine=MACHINE)


def off_the_cubics(made, motion):
    time = np.linspace(0, motion.time[-1], 800_001)
    exact = CubicHermiteSpline(motion.time, motion.axes["Z"], motion.velocity["Z"])(time)
    return np.abs(np.interp(time, made.time, made.axes["Z"]) - exact).max()


@pytest.mark.parametrize("points", [24, 120])
def test_pieces_of_a_pvt_motion_agree_to_a_hundredth_of_a_nm(points):
    motion = pvt_motion(points)
    made = interpolate_motion(motion, MACHINE)
    assert off_the_cubics(tw.track(motion, MACHINE), motion) > 2e-7
    assert off_the_cubics(made, motion) < 1.02e-8
    assert chord_error(made) == pytest.approx(off_the_cubics(made, motion), rel=0.05)


def test_pieces_are_as_short_as_memory_allows(monkeypatch):
    monkeypatch.setattr(_interpolated, "MAX_SEGMENTS", 10_000)
    motion = pvt_motion(24)
    made = interpolate_motion(motion, MACHINE)
    assert 7_000 < made.time.size <= 10_500
    assert 1e-8 < off_the_cubics(made, motion) < 1e-6
    assert chord_error(made) == pytest.approx(off_the_cubics(made, motion), rel=0.05)


def test_straight_lines_get_no_more_pieces_than_track_takes():
    motion = replace(pvt_motion(24), velocity=None)
    machine = replace(MACHINE, controller=tw.Controller(interpolation="linear"))
    np.testing.assert_array_equal(interpolate_motion(motion, machine).time, tw.track(motion, machine).time)
