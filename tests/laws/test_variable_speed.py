"""A spindle that may vary its speed. Oracles: the machine's own limits; bounds that no motion can beat."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from scipy.interpolate import CubicSpline

from laws import examples
from turnwright.machine import Axis, Controller, Machine
from turnwright.motion import check_limits, drive
from turnwright.part import Part
from turnwright.placing import place
from turnwright.strategy import SlowToolServo
from turnwright.surface import Plane, SineGrid
from turnwright.tool import Tool

TOOL = Tool(nose_radius=0.5)


def lathe(*, acceleration=None, c_acceleration=None, jerk=None, varied=True, rate=1000.0):
    sliding = Axis(acceleration=acceleration, jerk=jerk)
    return Machine(
        name="lathe",
        axes={"C": Axis(acceleration=c_acceleration), "X": sliding, "Z": sliding},
        spindle_rpm=3000,
        block_rate_hz=rate,
        controller=Controller(variable_speed=varied),
    )


@examples(40)
@given(
    acceleration=st.sampled_from([None, 5.0, 50.0, 1000.0]),
    c_acceleration=st.sampled_from([None, 1.0, 50.0]),
    jerk=st.sampled_from([None, 1e3, 1e5]),
    way=st.sampled_from([{"points_per_rev": 90}, {"chord": 1e-5}, {"arc_length": 0.02, "max_step": 0.2}]),
    sense=st.sampled_from([-1, 1]),
    inside_out=st.booleans(),
    high=st.floats(0.0, 0.01),
)
@example(
    acceleration=5.0, c_acceleration=None, jerk=None, way={"chord": 1e-5}, sense=-1, inside_out=False, high=1e-6
)  # fmt: skip
def test_every_limit_is_kept_and_no_time_is_lost(acceleration, c_acceleration, jerk, way, sense, inside_out, high):
    part = Part(surface=SineGrid(amplitude=(high, high), period=(0.7, 0.9)), radius=1.0)
    servo = SlowToolServo(feed=0.02, sense=sense, inside_out=inside_out, **way)
    path = place(servo.spiral(part, TOOL), part, TOOL)
    machine = lathe(acceleration=acceleration, c_acceleration=c_acceleration, jerk=jerk)
    motion = drive(path, servo, machine)
    limits = check_limits(motion, machine)
    assert limits.ok, limits.findings
    assert max(limits.utilisation.values()) > 0.999, "some limit is used up"
    if jerk is None:
        steady = drive(path, servo, replace(machine, controller=Controller()))
        assert motion.time[-1] <= steady.time[-1] * (1 + 1e-9)
    for letter in "CXZ":
        assert np.array_equal(motion.axes[letter], drive(path, servo, lathe(varied=False)).axes[letter])


def test_blocks_as_short_as_they_may_be():
    """Oracle: n blocks at the block rate; on a flat at constant arc nothing else binds, and each turn has one speed."""
    servo = SlowToolServo(feed=0.02, arc_length=0.02, max_step=0.2)
    part = Part(surface=Plane(), radius=5.0)
    path = place(servo.spiral(part, TOOL), part, TOOL)
    motion = drive(path, servo, lathe())
    floor = (motion.time.size - 1) / 1000
    assert floor <= motion.time[-1] < 1.02 * floor
    assert drive(path, servo, lathe(varied=False)).time[-1] > 1.5 * floor


def test_the_spindle_speeds_up_steadily():
    """Oracle: speed squared over angle, whose slope is twice the acceleration of the spindle."""
    servo = SlowToolServo(feed=0.02, arc_length=0.02, max_step=0.2)
    part = Part(surface=Plane(), radius=5.0)
    motion = drive(place(servo.spiral(part, TOOL), part, TOOL), servo, lathe(c_acceleration=2.0))
    speed = np.diff(motion.axes["C"]) / np.diff(motion.time)
    middle = (motion.time[1:] + motion.time[:-1]) / 2
    assert np.abs(np.diff(speed) / np.diff(middle)).max() <= 2.0 * 1.001


def test_velocities_are_those_of_the_varied_spindle():
    """Oracle: SciPy's spline through the angles."""
    part = Part(surface=SineGrid(amplitude=(0.001, 0.001), period=(0.7, 0.9)), radius=1.0)
    servo = SlowToolServo(feed=0.02, points_per_rev=720)
    machine = replace(lathe(c_acceleration=5.0), controller=Controller(interpolation="hermite", variable_speed=True))
    motion = drive(place(servo.spiral(part, TOOL), part, TOOL), servo, machine)
    assert motion.velocity is not None
    inner = slice(20, -20)
    for letter in "CXZ":
        slope = CubicSpline(motion.time, motion.axes[letter])(motion.time, 1)
        assert motion.velocity[letter][inner] == pytest.approx(slope[inner], abs=1e-4 * np.abs(slope).max())
