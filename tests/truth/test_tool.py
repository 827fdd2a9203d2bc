"""The edge. Oracles: circle geometry, mpmath, direct evaluation of the defining formula."""

import mpmath
import numpy as np
import pytest

from turnwright._kernels import edge as kernel
from turnwright._kernels.trig import sincos
from turnwright.errors import InputError
from turnwright.tool import Tool, WavinessTable

DEG = np.pi / 180


def test_sine_and_cosine_of_a_long_spindle_angle_against_mpmath():
    angle = np.concatenate(
        [[0.0, np.pi / 4, 1e-300, 23561.944901923448], np.random.default_rng(1).uniform(-1e5, 1e5, 400)]
    )
    mpmath.mp.dps = 40
    for a in angle:
        s, c = sincos(a)
        assert abs(s - mpmath.sin(mpmath.mpf(float(a)))) < 2.3e-16
        assert abs(c - mpmath.cos(mpmath.mpf(float(a)))) < 2.3e-16


def test_perfect_nose_is_a_circle_with_tangent_flanks():
    tool = Tool(nose_radius=0.514, included=60 * DEG)
    s = np.linspace(-30, 30, 61) * DEG
    u, v, e = tool.edge(s)
    np.testing.assert_allclose(u**2 + (0.514 - e) ** 2, 0.514**2, rtol=1e-15)
    assert (v == 0).all()
    # Beyond the arc the flank leaves at the slope of the arc's end.
    (u0, u1), _, (e0, e1) = tool.edge([30 * DEG, 45 * DEG])
    assert (e1 - e0) / (u1 - u0) == pytest.approx(np.tan(30 * DEG), rel=1e-14)


def test_waviness_deviates_along_the_radius_and_outward():
    tool = Tool(nose_radius=1.5, included=80 * DEG, waviness=(1e-3, -2e-3, 5e-4))
    s = np.linspace(-0.6, 0.6, 25)
    u, _, e = tool.edge(s)
    deviation = 1e-3 * s - 2e-3 * s**2 + 5e-4 * s**3
    np.testing.assert_allclose(np.hypot(u, 1.5 - e), 1.5 + deviation, rtol=1e-15)
    np.testing.assert_allclose(np.arctan2(u, 1.5 - e), s, atol=1e-15)


def test_certificate_passes_through_its_points_and_holds_beyond_them():
    sweep = np.linspace(-0.4, 0.4, 17)
    deviation = 5e-5 * np.sin(9 * sweep)
    tool = Tool(nose_radius=0.2, included=70 * DEG, waviness=WavinessTable(sweep=sweep, deviation=deviation))
    u, _, e = tool.edge(sweep)
    np.testing.assert_allclose(np.hypot(u, 0.2 - e), 0.2 + deviation, atol=1e-16)
    u, _, e = tool.edge([0.5])
    assert np.hypot(u, 0.2 - e)[0] == pytest.approx(0.2 + deviation[-1], abs=1e-16)


def test_radius_error_leaves_the_tip_and_a_larger_nose_cuts_deeper_beside_it():
    nominal, larger = Tool(nose_radius=0.5), Tool(nose_radius=0.5, radius_error=0.01)
    assert larger.edge([0.0])[2][0] == 0
    at = 0.1
    u, _, e = larger.edge([np.arcsin(at / 0.51)])
    assert u[0] == pytest.approx(at)
    assert e[0] < nominal.edge([np.arcsin(at / 0.5)])[2][0]


@pytest.mark.parametrize("sense", [1, -1])
def test_rake_tilts_the_edge_about_the_tip_against_the_cutting_direction(sense):
    rake = -25 * DEG
    tool = Tool(nose_radius=0.5, included=60 * DEG, rake=rake, offset=(0.01, -0.02, 0.003))
    s = np.linspace(-0.5, 0.5, 11)
    u, v, e = tool.edge(s, sense)
    w = 0.5 * (1 - np.cos(s))
    np.testing.assert_allclose(u, 0.01 + 0.5 * np.sin(s), atol=1e-16)
    np.testing.assert_allclose(e, 0.003 + w * np.cos(rake), atol=1e-16)
    # Negative rake leans forward, toward where the tool is going.
    np.testing.assert_allclose(v, -0.02 + sense * w * np.sin(25 * DEG), atol=1e-16)


@pytest.mark.parametrize(
    "tool",
    [
        Tool(nose_radius=1.5, included=60 * DEG, waviness=(1e-3, 0.03, -0.05)),
        Tool(nose_radius=0.2, included=100 * DEG, waviness=(0.0, 1e-4, 0.0, -3e-4), radius_error=1e-3),
    ],
    ids=["strong", "wide"],
)
def test_profile_over_the_distance_equals_the_edge(tool):
    profile = tool.profile()
    s = np.random.default_rng(2).uniform(*tool.arc, 500)
    u, _, e = tool.edge(s)
    height = np.array([kernel.height(profile.row, profile.table, at) for at in u])
    assert np.abs(height - e).max() < 1e-12
    step = 1e-6
    slope = np.array([kernel.slope(profile.row, profile.table, at) for at in u])
    near = [np.array([kernel.height(profile.row, profile.table, at + sign * step) for at in u]) for sign in (1, -1)]
    inside = np.abs(s) < tool.arc[1] - 1e-4
    assert np.abs(slope - (near[0] - near[1]) / (2 * step))[inside].max() < 1e-8


def test_convexity_is_seen():
    assert Tool(nose_radius=0.2, included=60 * DEG).profile().convex
    waves = np.linspace(-0.6, 0.6, 400)
    table = WavinessTable(sweep=waves, deviation=2e-4 * np.sin(60 * waves))
    assert not Tool(nose_radius=0.2, included=60 * DEG, waviness=table).profile().convex


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"nose_radius": 0.0}, "nose_radius is 0 mm"),
        ({"nose_radius": float("nan")}, "nose_radius is nan mm"),
        ({"nose_radius": 0.5, "included": 4.0}, "included is 229.183 deg"),
        ({"nose_radius": 0.5, "rake": 2.0}, "rake is 114.592 deg"),
        ({"nose_radius": 0.5, "clearance": -0.1}, "clearance is -5.72958 deg"),
        ({"nose_radius": 0.5, "radius_error": -0.6}, "nothing is left of the nose"),
        ({"nose_radius": 0.5, "offset": (0.0, 1.0)}, "three finite lengths"),
        ({"nose_radius": 0.5, "waviness": (float("inf"),)}, "every coefficient must be finite"),
        ({"nose_radius": 0.5, "waviness": (1.0,)}, "check its unit"),
    ],
)
def test_a_wrong_tool_cannot_exist(wrong, words):
    with pytest.raises(InputError, match=words):
        Tool(**wrong)


@pytest.mark.parametrize(
    ("sweep", "deviation", "words"),
    [
        ([0, 1, 2], [0, 0, 0], "at least 4"),
        ([0, 1, 2, 3], [0, 0, 0], "as many"),
        ([0, 2, 1, 3], [0, 0, 0, 0], "do not ascend"),
        ([0, 1, 2, 3], [0, 0, 0, np.nan], "not finite"),
    ],
)
def test_a_wrong_certificate_cannot_exist(sweep, deviation, words):
    with pytest.raises(InputError, match=words):
        WavinessTable(sweep=sweep, deviation=deviation)
