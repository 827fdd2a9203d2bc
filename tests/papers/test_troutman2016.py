"""Troutman 2016 (UNC Charlotte): a wavy tool on a machine out of square, and printed formulas that need correction."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from turnwright.generation import generate, generate_points
from turnwright.machine import Machine
from turnwright.metrology import roughness
from turnwright.motion import drive
from turnwright.part import Part
from turnwright.placing import place, tip_height
from turnwright.strategy import SlowToolServo
from turnwright.surface import Plane, Sphere, XYPolynomial
from turnwright.tool import Tool

DEGREE = np.rad2deg(1.0)  # degrees in a radian
BOWL, NOSE = 10.0, 1.5
PART = Part(surface=Sphere(radius=BOWL), radius=5.0)
NOMINAL = Tool(nose_radius=NOSE, included=np.deg2rad(100))
WAVY = replace(NOMINAL, waviness=(2e-5 * DEGREE, 1e-5 * DEGREE**2, -3e-7 * DEGREE**3))
SQUARE = Machine.load("nanotech-350fg")
OUT_OF_SQUARE = replace(SQUARE, squareness=-3.5e-5)
SERVO = SlowToolServo(feed=0.020, points_per_rev=72, spindle_rpm=20)


def planned_with(tool, machine):
    path = place(SERVO.spiral(PART, tool), PART, tool)
    return path, drive(path, SERVO, machine)


def error_at_contacts(path, motion, machine):
    """Cut minus design, with the tool and machine that really are, at points inside the clear aperture."""
    here = np.flatnonzero(np.hypot(path.contact_x, path.contact_y) <= PART.radius)
    here = here[:: here.size // 4000]
    x, y = path.contact_x[here], path.contact_y[here]
    return generate_points(motion, WAVY, x=x, y=y, machine=machine) - path.contact_z[here]


def test_a_plan_with_the_real_tool_leaves_the_design():
    path, motion = planned_with(WAVY, OUT_OF_SQUARE)
    assert np.abs(path.contact_z - PART.surface.sag(path.contact_x, path.contact_y)).max() < 1e-12
    assert np.abs(error_at_contacts(path, motion, OUT_OF_SQUARE)).max() * 1e6 < 1e-3


def wavy_envelope(slope):
    """The point that a wavy nose leaves while its nominal centre turns about the centre of the bowl, in closed form.

    The centre moves along (cos a, sin a) where the nominal contact is at the slope angle a. The edge
    (R + d(s)) (sin s, -cos s) leaves an envelope where its tangent has that direction: s - atan(d'/(R + d)) = a.
    """
    c1, c2, c3 = WAVY.waviness

    def radius(s):
        return NOSE + s * (c1 + s * (c2 + s * c3))

    def excess(s):
        return s - np.arctan((c1 + s * (2 * c2 + 3 * s * c3)) / radius(s)) - slope

    s = brentq(excess, slope - 0.2, slope + 0.2, xtol=1e-15)
    away = (BOWL - NOSE) * np.sin(slope) + radius(s) * np.sin(s)
    z = BOWL - (BOWL - NOSE) * np.cos(slope) - radius(s) * np.cos(s)
    return away, z


def test_a_nominal_plan_leaves_the_envelope_of_the_wavy_edge():
    path, motion = planned_with(NOMINAL, SQUARE)
    start = np.flatnonzero(path.angle % (2 * np.pi) < 1e-6)
    tips = path.radius[start][::5]
    tips = tips[(tips > 0.1) & (tips < 4.2)]
    away, z = np.array([wavy_envelope(np.arcsin(tip / (BOWL - NOSE))) for tip in tips]).T
    # An axis error acts at the X of the tool, not at the contact. It falls by 0.7 nm from pass to pass, and a pass
    # stands a hundred nanometres above the contact of its neighbour, so each contact is still its own.
    expected = z + OUT_OF_SQUARE.squareness * tips
    made = generate_points(motion, WAVY, x=away, y=np.zeros_like(away), machine=OUT_OF_SQUARE)
    assert np.abs(made - expected).max() * 1e6 < 1e-5
    # Most of it can be seen: the form error is 2 um deep.
    assert np.ptp(made - PART.surface.sag(away, 0)) > 0.002


def test_waviness_at_the_nominal_contact_gouges():
    # The thesis lifts the tip by d / cos(s) where the nominal nose touches. (Its Eq. 6.18 prints cos, and the other
    # sign.) The wavy edge touches elsewhere: where its support function, r + d'²/2r to second order, is the greater.
    s = np.linspace(0.05, 0.35, 7)
    tips, angle = (BOWL - NOSE) * np.sin(s), np.linspace(0, 0.1, 7)
    nominal, real = (tip_height(PART.surface, tool, angle=angle, radius=tips, sense=1) for tool in (NOMINAL, WAVY))
    c1, c2, c3 = WAVY.waviness
    tilt = c1 + s * (2 * c2 + 3 * s * c3)
    gouge = real - (nominal + WAVY.deviation(s) / np.cos(s))
    assert gouge == pytest.approx(tilt**2 / (2 * NOSE * (1 - NOSE / BOWL) * np.cos(s)), rel=0.05)
    assert 20 < gouge.max() * 1e6 < 25


def test_the_mean_deviation_of_cusps_is_a_quarter_of_pv():
    servo = SlowToolServo(feed=0.010, points_per_rev=360, spindle_rpm=50)
    tool = Tool(nose_radius=0.5, included=np.deg2rad(60))
    part = Part(surface=Plane(), radius=1.0)
    motion = drive(place(servo.spiral(part, tool), part, tool), servo, SQUARE)
    # Ten whole cusps, at azimuth 0, every valley and ridge among the samples.
    x = 0.5 + 0.1 * np.arange(4000) / 4000
    rough = roughness(generate(motion, tool, x=x, y=[0, 1e-9]), form="mean")
    assert rough.sa_nm / rough.pv_nm == pytest.approx(4 / (9 * np.sqrt(3)), rel=1e-4)
    assert rough.sq_nm / rough.pv_nm == pytest.approx(np.sqrt(4 / 45), rel=1e-4)


def test_the_step_for_a_chord_does_not_shrink_at_the_centre():
    # Eq. 6.5 divides by a curvature that diverges at the centre. On a saddle c/2 (x² - y²) the height along a turn
    # bends by 2 c r², so the step is sqrt(8 chord / 2 c r²): it grows towards the centre up to the largest step.
    c, chord = 0.01, 1e-6
    part = Part(surface=XYPolynomial(terms={(2, 0): c / 2, (0, 2): -c / 2}), radius=2.0)
    servo = SlowToolServo(feed=0.05, chord=chord, max_step=np.deg2rad(30), spindle_rpm=10)
    spiral = servo.spiral(part, Tool(nose_radius=0.05))
    step = np.diff(spiral.angle)
    for radius in (0.2, 0.4, 0.8, 1.5):
        least = step[np.abs(spiral.radius[:-1] - radius) < 0.025].min()
        # The path keeps a share of the tolerance for what lies between its samples.
        assert 0.85 < least / np.sqrt(8 * chord / (2 * c * radius**2)) < 1.05
    assert step[-8:] == pytest.approx(np.deg2rad(30), rel=1e-3)
