"""What check_access says, and what it refuses."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from turnwright.access import check_access
from turnwright.errors import DomainError, InputError
from turnwright.part import Part
from turnwright.surface import Expression, Surface
from turnwright.tool import Tool


class Bowl(Surface):
    """z = r^2 / 20 + tilt x."""

    __slots__ = ("tilt",)

    def __init__(self, tilt):
        self.tilt = tilt

    def evaluate(self, x, y, order):
        one = np.ones_like(x)
        parts = ((x**2 + y**2) / 20 + self.tilt * x, x / 10 + self.tilt, y / 10, one / 10, 0 * one, one / 10)
        return parts[: (1, 3, 6)[order]]


PART = Part(surface=Bowl(0.2), radius=2.0)
TOOL = Tool(nose_radius=0.5, included=np.deg2rad(60), clearance=np.deg2rad(12))


def message(tool, name, part=PART):
    access = check_access(part, tool)
    item = next(item for item in access.findings if item.name == name)
    assert access.ok == all(other.ok for other in access.findings)
    return item


@pytest.mark.parametrize(
    ("tool", "name", "words"),
    [
        (replace(TOOL, nose_radius=11), "nose radius", "nose_radius is 11 mm, the limit is 10 mm at x ="),
        (replace(TOOL, included=np.deg2rad(30)), "included angle", "needs to be 43.6 deg at x = 2 mm"),
        (replace(TOOL, included=None), "included angle", "give included"),
        (replace(TOOL, clearance=np.deg2rad(10)), "clearance", "needs to be 11.3 deg at x ="),
        (replace(TOOL, clearance=None), "clearance", "give clearance"),
    ],
)
def test_a_tool_that_does_not_pass(tool, name, words):
    item = message(tool, name)
    assert not item.ok
    assert words in item.sentence
    assert item.margin is None or item.margin < 0
    assert message(TOOL, name).ok


def test_margins_are_what_is_left():
    included, clearance = message(TOOL, "included angle"), message(TOOL, "clearance")
    assert included.margin == pytest.approx(np.deg2rad(60) - 2 * np.arctan(0.4))
    assert clearance.margin == pytest.approx(np.deg2rad(12) - np.arctan(0.2))
    assert np.hypot(*included.where) == pytest.approx(2)


def test_what_is_not_needed_need_not_be_stated():
    tool = Tool(nose_radius=0.5, included=1.0)
    assert message(tool, "clearance", Part(surface=Bowl(0.0), radius=2.0)).ok


def test_the_sense_is_a_sign():
    with pytest.raises(InputError, match="sense is 0, it must be 1 or -1"):
        check_access(PART, TOOL, sense=0)


def test_a_pole_that_is_met_is_a_sentence_and_no_warning():
    class Wall(Surface):
        def evaluate(self, x, y, order):
            return tuple(np.where(x > 1, np.inf, 0.0 * y) for _ in range((1, 3, 6)[order]))

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(DomainError, match=r"no finite slope and curvature at x = 1\.\d+ mm.*: keep the part clear"):
            check_access(Part(surface=Wall(), radius=2.0), Tool(nose_radius=0.5))


@pytest.mark.parametrize("formula", ["hypot(x, hypot(x, y))", "atan2(x, atan2(x, atan2(x, 2 + 0*y)))"])
def test_a_formula_without_a_slope_on_the_axis_says_no_nan(formula):
    """Oracle: of the first the cone, whose slope along the radius is sqrt(1 + cos(azimuth)^2), at most sqrt(2)."""
    part = Part(surface=Expression(f"0.1*{formula}"), radius=1.0)
    access = check_access(part, Tool(nose_radius=0.1, included=np.deg2rad(60), clearance=np.deg2rad(10)))
    assert "nan" not in "".join(finding.sentence for finding in access.findings)
    if formula.startswith("hypot"):
        assert access.included_needed == pytest.approx(2 * np.arctan(0.1 * np.sqrt(2)), rel=1e-9)


@pytest.mark.parametrize("height", [1.1e6, -1e302])
def test_a_surface_beyond_all_parts_is_refused(height):
    part = Part(surface=Expression(f"{height!r} + 0*x"), radius=1.0)
    with pytest.raises(DomainError, match=r"height of .*, the limit is 1e\+06 mm"):
        check_access(part, Tool(nose_radius=0.1, included=1.0, clearance=0.2))
