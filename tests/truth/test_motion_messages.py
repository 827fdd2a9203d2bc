"""Messages of `drive` and findings of `check_limits`."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from turnwright.errors import LimitError
from turnwright.machine import Machine
from turnwright.motion import check_limits, drive
from turnwright.path import Motion, Path
from turnwright.strategy import SlowToolServo

ANGLE = np.linspace(0, 2 * np.pi, 101)
ZERO = 0 * ANGLE
PATH = Path(
    angle=ANGLE, radius=5 - ANGLE, z=ZERO, sweep=ZERO, contact_x=ZERO, contact_y=ZERO, contact_z=ZERO, clearance=ZERO
)
MACHINE = Machine.load("generic")


def servo(rpm):
    return SlowToolServo(feed=0.01, points_per_rev=100, spindle_rpm=rpm)


def test_a_speed_beyond_the_spindle_is_refused():
    with pytest.raises(LimitError, match=r"spindle_rpm is 501 rev/min, the limit of generic lathe .* is 500 rev/min"):
        drive(PATH, servo(501), MACHINE)
    assert drive(PATH, servo(500), MACHINE).time[-1] == pytest.approx(0.12)


def test_an_axis_the_machine_lacks_is_refused_or_found():
    fast = SimpleNamespace(
        spindle_rpm=10, axes=lambda path: {"C": path.angle, "X": path.radius, "Z": path.z, "W": path.z}
    )
    with pytest.raises(LimitError, match=r"moves axis W, generic lathe .* has C, X, Z"):
        drive(PATH, fast, MACHINE)
    motion = drive(PATH, servo(1), MACHINE)
    foreign = Motion(time=motion.time, axes={**motion.axes, "Y": ZERO}, machine=MACHINE)
    assert "needs axis Y" in check_limits(foreign, MACHINE).findings[0]


def test_limit_finding_names_value_place_limit_and_remedy():
    limits = check_limits(drive(PATH, servo(500), MACHINE), MACHINE)
    assert not limits.ok
    # 833 blocks a second where 500 are allowed, X at 2 pi mm per turn at 500 rev/min where 10 mm/s are.
    rate, speed = limits.findings
    assert rate.startswith("block rate reaches 833.33 blocks/s at 0.00 min")
    assert "the limit of generic lathe with a C axis is 500 blocks/s" in rate
    assert "300 rev/min" in rate
    assert speed.startswith("X speed reaches 52.36 mm/s")
    assert limits.binding == "X speed"


def test_stated_speed_binds_where_every_limit_has_room():
    slow = check_limits(drive(PATH, servo(3), MACHINE), MACHINE)
    assert slow.ok
    assert (slow.binding, slow.nearest) == ("spindle speed as stated", "X speed")
    assert slow.utilisation[slow.nearest] < 0.1
    fastest = check_limits(drive(PATH, servo(None), MACHINE), MACHINE)
    assert fastest.binding == fastest.nearest == "X speed"


def test_rounding_of_a_program_stays_below_its_stated_bound():
    # Positions rounded to q show at most 2 q / t^2 of acceleration and 4 q / t^3 of jerk that is not there.
    machine = replace(MACHINE, spindle_rpm=500, block_rate_hz=1000)
    motion = drive(PATH, servo(300), machine)
    straight = np.round(0.0371 * ANGLE, 6)
    flat = Motion(time=motion.time, axes={**motion.axes, "Z": straight}, machine=machine)
    limits = check_limits(flat, machine)
    q, t = 1e-6, motion.time[1]
    assert 0 < limits.peak_acceleration["Z"] <= 2 * q / t**2 * (1 + 1e-6)
    assert 0 < limits.peak_jerk["Z"] <= 4 * q / t**3 * (1 + 1e-6)
