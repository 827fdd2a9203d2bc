"""Every slow tool servo that cannot work is refused in one sentence."""

import numpy as np
import pytest

from turnwright.errors import GougeError, InputError, LimitError
from turnwright.part import Part
from turnwright.path import Path
from turnwright.strategy import SlowToolServo, Strategy
from turnwright.strategy.slow import _refine_samples
from turnwright.surface import Surface
from turnwright.tool import Tool


class Flat(Surface):
    __slots__ = ()

    def evaluate(self, x, y, order):
        return tuple(0 * (x + y) for _ in range((1, 3, 6)[order]))


PART = Part(surface=Flat(), radius=5.0)
TOOL = Tool(nose_radius=0.5, included=np.deg2rad(60))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"feed": 0, "points_per_rev": 360}, "feed is 0 mm/rev"),
        ({"feed": -0.01, "points_per_rev": 360}, "feed is -0.01 mm/rev"),
        ({"feed": np.nan, "points_per_rev": 360}, "feed is nan"),
        ({"feed": 0.01}, "set by nothing: give exactly one of"),
        ({"feed": 0.01, "points_per_rev": 360, "chord": 1e-5}, "set by points_per_rev and chord"),
        ({"feed": 0.01, "arc_length": 0.1, "chord": 1e-5}, "set by arc_length and chord"),
        ({"feed": 0.01, "points_per_rev": 360.0}, "points_per_rev is 360.0, it must be a whole number"),
        ({"feed": 0.01, "points_per_rev": 7}, "points_per_rev is 7"),
        ({"feed": 0.01, "points_per_rev": 360, "max_step": 0.1}, "remove one"),
        ({"feed": 0.01, "arc_length": 0.1, "max_step": 1}, "max_step is 57.2958 deg, the limit is 45 deg"),
        ({"feed": 0.01, "arc_length": -0.1}, "arc_length is -0.1 mm"),
        ({"feed": 0.01, "chord": 0}, "chord is 0 mm"),
        ({"feed": 0.01, "points_per_rev": 360, "spindle_rpm": 0}, "spindle_rpm is 0 rev/min"),
        ({"feed": 0.01, "points_per_rev": 360, "sense": 0}, "sense is 0"),
        ({"feed": 0.01, "points_per_rev": 360, "lead_in": -1}, "lead_in is -1 mm"),
        ({"feed": 0.01, "points_per_rev": 360, "lead_in": np.inf}, "lead_in is inf"),
        ({"feed": 0.01, "points_per_rev": 360, "overrun": -0.001}, "overrun is -0.001 mm, it must be at least 0 mm"),
        ({"feed": 0.01, "points_per_rev": 360, "overrun": 0.02}, "one feed, 0.01 mm: a quarter of a feed, 0.0025 mm"),
        ({"feed": 0.01, "points_per_rev": 360, "overrun": np.nan}, "overrun is nan"),
    ],
)
def test_a_wrong_servo_cannot_exist(fields, words):
    with pytest.raises(InputError) as caught:
        SlowToolServo(**fields)
    assert words in str(caught.value)


def test_a_feed_beyond_the_edge_is_refused():
    with pytest.raises(GougeError, match=r"feed 0\.6 mm per rev is at least the width of the edge 0\.5 mm"):
        SlowToolServo(feed=0.6, points_per_rev=360).spiral(PART, TOOL)


@pytest.mark.parametrize(
    "points", [{"points_per_rev": 3600}, {"arc_length": 1e-9}, {"arc_length": 1e-9, "max_step": 1e-9}]
)
def test_a_slip_of_the_unit_is_refused_before_memory_runs_out(points):
    with pytest.raises(LimitError, match=r"the spiral has .* points, the limit is 3e\+08"):
        SlowToolServo(feed=1e-6, **points).spiral(PART, TOOL)


def test_a_path_that_jumps_has_no_chord():
    turned = np.linspace(0, 8, 100)

    def height(t):
        return np.where(t < 2.5 * np.pi, 0.0, 1.0)

    with pytest.raises(InputError, match=r"the path jumps 1\.250 revolutions from the inner end"):
        _refine_samples(turned, height(turned), 0.0, height, lambda t: np.full(t.size, 1e-5))


def test_the_axes_of_a_slow_tool_servo():
    one = np.arange(3.0)
    path = Path(
        angle=one, radius=one[::-1], z=one * 2, sweep=one, contact_x=one, contact_y=one, contact_z=one, clearance=one
    )
    servo = SlowToolServo(feed=0.01, points_per_rev=360)
    assert isinstance(servo, Strategy)
    assert {letter: values.tolist() for letter, values in servo.axes(path).items()} == {
        "C": [0, 1, 2], "X": [2, 1, 0], "Z": [0, 2, 4],
    }  # fmt: skip
