"""What the adaptive tool servo refuses, and in which words."""

import pytest

from turnwright import AdaptiveToolServo, Part, Plane, Tool
from turnwright.errors import GougeError, InputError, LimitError

GIVEN = {"scallop": 50e-6, "chord": 10e-6, "interpolation": "linear"}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"scallop": 0.0}, "scallop is 0 mm, it must be finite and above 0"),
        ({"chord": -1.0}, "chord is -1 mm"),
        ({"chord": 1e-18}, "chord is 1e-18 mm, the limit is 1e-10 mm"),
        ({"spindle_rpm": 0.0}, "spindle_rpm is 0 rev/min"),
        ({"interpolation": "spline"}, 'interpolation is \'spline\', it must be "linear" or "hermite"'),
        ({"x_motion": "none"}, 'x_motion is \'none\', it must be "servo", "split" or "steady"'),
        ({"sense": 0}, "sense is 0, it must be 1 or -1"),
    ],
)
def test_a_wrong_choice_is_named(wrong, words):
    with pytest.raises(InputError, match=words):
        AdaptiveToolServo(**{**GIVEN, **wrong})


def test_a_scallop_as_high_as_the_edge_is_refused():
    servo = AdaptiveToolServo(**{**GIVEN, "scallop": 0.2})
    with pytest.raises(GougeError, match=r"the arc of the tool is only 0\.09.* mm high"):
        servo.spiral(Part(surface=Plane(), radius=1.0), Tool(nose_radius=0.1))


def test_a_slip_of_the_unit_is_refused():
    servo = AdaptiveToolServo(**{**GIVEN, "scallop": 50e-18})
    with pytest.raises(LimitError, match=r"points, the limit is 3e\+08"):
        servo.spiral(Part(surface=Plane(), radius=10.0), Tool(nose_radius=0.1))
