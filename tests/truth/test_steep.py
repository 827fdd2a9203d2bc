"""Placing where the surface is steeper than the flanks. Oracle: brute force over the whole edge, see steep_oracle.

The acceptance run of 1,000 tips is ``tests/proof/proof_placing.py``.
"""

import numpy as np
import pytest

import turnwright as tw
from steep_oracle import CASES, RADIUS, errors, tool_of
from turnwright.placing import Touch, contact

SLOW = ("wall across", "sharp wall", "slanting wall", "ring wall")


@pytest.mark.parametrize("name", CASES)
def test_placing_finds_steps_and_walls_over_the_whole_edge(name):
    number = list(CASES).index(name)
    tools = CASES[name].tools
    tool = "narrow" if name in SLOW else tools[number % len(tools)]
    found, clearance = errors(name, tool, np.random.default_rng(number), 5, scattered=number % 2 == 0)
    assert np.abs(found).max() < 1e-9
    assert clearance > -1e-9


def test_scattered_azimuths_meet_the_other_side_of_the_axis():
    """On the far side of the axis the formula stands higher; the flank rests on the edge of that half."""
    part, tool = tw.Part(surface=tw.Expression("0.2*sin(phi)"), radius=2.0), tool_of("narrow")
    servo = tw.SlowToolServo(feed=0.09, spindle_rpm=50, arc_length=0.03, max_step=0.5)
    path = tw.place(servo.spiral(part, tool), part, tool)
    near = np.flatnonzero(np.abs(path.radius) < 0.3)
    end, half = 0.1 * np.sin(np.pi / 6), np.pi / 6
    u = path.radius[near]
    e = np.where(
        u < end, 0.1 - np.sqrt(0.01 - np.minimum(u, end) ** 2), 0.1 * (1 - np.cos(half)) + (u - end) * np.tan(half)
    )
    height = 0.2 * np.sin(path.angle[near])
    np.testing.assert_allclose(path.z[near], np.maximum(height, np.abs(height) - e), rtol=0, atol=1e-12)
    assert path.clearance.min() > -1e-12


@pytest.mark.parametrize("name", ["sin phi", pytest.param("pedestals", marks=pytest.mark.proof), "spike"])
def test_clearance_shows_a_gouge_despite_the_search(name, monkeypatch):
    """A path 20 um too low is 20 um too low somewhere, found without the places of contact."""
    part, tool = tw.Part(surface=CASES[name].surface, radius=RADIUS), tool_of("narrow")
    servo = tw.SlowToolServo(feed=0.04, spindle_rpm=50, points_per_rev=120)
    spiral = servo.spiral(part, tool)
    assert tw.place(spiral, part, tool).clearance.min() > -1e-12

    def lower(*args, **kwargs):
        at = touch(*args, **kwargs)
        return Touch(at.z - 0.02, *at[1:])

    touch = contact.touch_down
    monkeypatch.setattr(contact, "touch_down", lower)
    assert -0.02 - 1e-12 < tw.place(spiral, part, tool).clearance.min() < -0.0195


def test_a_wall_that_the_rim_cuts_is_touched_by_a_flank():
    """The wall of 0.2 mm at y = 0.3 leaves the part somewhere; a tip far from there may still rest on it."""
    surface, tool = CASES["wall across"].surface, tool_of("narrow")
    part = tw.Part(surface=surface, radius=RADIUS)
    angle = np.arcsin(0.3 / RADIUS) + np.linspace(-2e-3, 2e-3, 9)
    path = tw.place(tw.Spiral(angle=angle, radius=np.full(9, 1.2)), part, tool)
    assert path.clearance.min() > -1e-9
    assert (path.sweep > tool.arc[1]).any()


@pytest.mark.parametrize("formula", ["0.2*sin(phi)", "0.2358*cos(3*phi)"])
def test_access_judges_a_formula_in_the_azimuth_near_its_axis(formula):
    """Around the axis it falls ever more steeply: no heel clears that, which is a finding and no refusal."""
    access = tw.check_access(tw.Part(surface=tw.Expression(formula), radius=2.0), tool_of("narrow"))
    assert access.clearance_needed > np.deg2rad(89)
    assert "clearance" in [one.name for one in access.findings if not one.ok]
