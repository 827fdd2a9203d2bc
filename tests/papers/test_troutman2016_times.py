"""Troutman 2016, Table 7.1: cycle times at 0.1 deg and 1000 blocks/s from a radius of 7.5 mm."""

import numpy as np
import pytest

from turnwright.machine import Machine
from turnwright.motion import check_limits, drive
from turnwright.part import Part
from turnwright.path import Path
from turnwright.strategy import SlowToolServo
from turnwright.surface import Surface
from turnwright.tool import Tool


class Flat(Surface):
    __slots__ = ()

    def evaluate(self, x, y, order):
        return tuple(0 * (x + y) for _ in range((1, 3, 6)[order]))


@pytest.mark.parametrize(
    ("feed", "minutes", "points"),
    [
        (0.025, 18.0, 1_080_001),
        pytest.param(0.002, 225.0, 13_500_001, marks=pytest.mark.proof),
    ],
)
def test_table_7_1(feed, minutes, points):
    machine = Machine.load("nanotech-350fg")
    servo = SlowToolServo(feed=feed, points_per_rev=3600, lead_in=0.0)  # the table counts from the radius itself
    spiral = servo.spiral(Part(surface=Flat(), radius=7.5), Tool(nose_radius=1.5))
    assert spiral.angle.size == points
    zero = np.broadcast_to(0.0, points)
    path = Path(
        angle=spiral.angle,
        radius=spiral.radius,
        z=zero,
        sweep=zero,
        contact_x=zero,
        contact_y=zero,
        contact_z=zero,
        clearance=zero,
    )
    limits = check_limits(drive(path, servo, machine), machine)
    assert limits.cycle_time_s / 60 == pytest.approx(minutes, abs=1e-4)
    assert limits.block_rate_hz == pytest.approx(1000)
    assert limits.binding == "block rate"
    assert limits.ok
