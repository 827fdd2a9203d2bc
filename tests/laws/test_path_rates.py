"""What a spiral, a path and a motion may state beyond where they are."""

import numpy as np
import pytest

from turnwright.errors import InputError
from turnwright.machine import Axis, Machine
from turnwright.path import Motion, Spiral

ANGLE = np.linspace(0, 1, 5)
MACHINE = Machine(name="lathe", axes={letter: Axis() for letter in "CXZ"}, spindle_rpm=100, block_rate_hz=1000)


def test_a_rate_of_another_length_is_refused():
    with pytest.raises(InputError, match="radius_rate"):
        Spiral(angle=ANGLE, radius=ANGLE, radius_rate=ANGLE[1:])


def test_what_is_stated_is_read_only():
    spiral = Spiral(angle=ANGLE, radius=ANGLE, y=ANGLE.copy())
    assert spiral.y is not None
    with pytest.raises(ValueError, match="read-only"):
        spiral.y[0] = 1


def test_a_velocity_belongs_to_every_axis():
    axes = dict.fromkeys("CXZ", ANGLE)
    with pytest.raises(InputError, match="velocities of C"):
        Motion(time=ANGLE, axes=axes, machine=MACHINE, velocity={"C": ANGLE})
    assert Motion(time=ANGLE, axes=axes, machine=MACHINE, velocity=axes).velocity is not None
