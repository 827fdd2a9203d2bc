"""The edge. Oracles: circle geometry, mpmath, direct evaluation of the defining formula."""

import mpmath
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

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


def test_certificate_passes_through_its_points_and_extends():
    sweep = np.linspace(-0.4, 0.4, 17)
    deviation = 5e-5 * np.sin(9 * sweep)
    tool = Tool(nose_radius=0.2, included=70 * DEG, waviness=WavinessTable(sweep=sweep, deviation=deviation))
    u, _, e = tool.edge(sweep)
    np.testing.assert_allclose(np.hypot(u, 0.2 - e), 0.2 + deviation, atol=1e-16)
    u, _, e = tool.edge([0.5])
    assert np.hypot(u, 0.2 - e)[0] == pytest.approx(0.2 + deviation[-1], abs=1e-16)


def test_a_radius_error_leaves_the_tip_in_place():
    nominal, larger = Tool(nose_radius=0.5), Tool(nose_radius=0.5, radius_error=0.01)
    assert larger.edge([0.0])[2][0] == 0
    at = 0.1
    u, _, e = larger.edge([np.arcsin(at / 0.51)])
    assert u[0] == pytest.approx(at)
    assert e[0] < nominal.edge([np.arcsin(at / 0.5)])[2][0]


@pytest.mark.parametrize("sense", [1, -1])
def test_rake_tilts_the_edge_about_the_tip(sense):
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
    edge = tool.cutting_edge()
    s = np.random.default_rng(2).uniform(*tool.arc, 500)
    u, _, e = tool.edge(s)
    height = np.array([kernel.height(edge, at) for at in u])
    assert np.abs(height - e).max() < 1e-12
    step = 1e-6
    slope = np.array([kernel.slope(edge, at) for at in u])
    near = [np.array([kernel.height(edge, at + sign * step) for at in u]) for sign in (1, -1)]
    inside = np.abs(s) < tool.arc[1] - 1e-4
    assert np.abs(slope - (near[0] - near[1]) / (2 * step))[inside].max() < 1e-8


def certificate(low, high, points=41):
    sweep = np.linspace(low, high, points) * DEG
    return WavinessTable(sweep=sweep, deviation=1e-4 * np.sin(9 * sweep + 0.3))


def table_and_formula(tool, sweep, deviation, rate):
    """Height and slope as tabulated, and by the definition of the deviation."""
    radius = tool.nose_radius + deviation
    u, w = radius * np.sin(sweep), tool.nose_radius - radius * np.cos(sweep)
    angle = sweep - np.arctan(rate / radius)
    edge = tool.cutting_edge()
    height, slope = (np.array([lookup(edge, at) for at in u]) for lookup in (kernel.height, kernel.slope))
    return np.abs(height - w), np.abs(np.arctan(slope) - angle), angle


@pytest.mark.parametrize(
    ("ends", "included"),
    [((-20, 25), 100), ((-60, 30), 100), ((-10, 60), 100), ((-0.1, 0.1), 100), ((-50, 50), 100), ((-20, 25), None)],
    ids=["inside", "one end", "other end", "narrow", "with the arc", "half a circle"],
)
def test_profile_is_exact_where_a_certificate_ends_on_the_arc(ends, included):
    table = certificate(*ends)
    tool = Tool(nose_radius=0.5, included=included and included * DEG, waviness=table)
    near = np.linspace(-3e-4, 3e-4, 2000)
    sweep = np.concatenate([np.linspace(-0.85, 0.85, 2000), *(end * DEG + near for end in ends)])
    sweep = sweep[(sweep > -50 * DEG) & (sweep < 50 * DEG)]
    held = np.clip(sweep, *table.sweep[[0, -1]])
    spline = CubicSpline(table.sweep, table.deviation)
    height, angle, _ = table_and_formula(tool, sweep, spline(held), np.where(held == sweep, spline(held, 1), 0))
    assert height.max() < 1e-13
    assert angle.max() < 1e-9


@pytest.mark.parametrize(("included", "limit"), [(100 * DEG, 6e-14), (None, 6e-13)])
def test_profile_of_a_ragged_certificate_errs_as_stated(included, limit):
    sweep = np.linspace(-60, 60, 121) * DEG
    table = WavinessTable(sweep=sweep, deviation=2e-5 * np.random.default_rng(3).standard_normal(121))
    tool = Tool(nose_radius=0.5, included=included, waviness=table)
    spline = CubicSpline(table.sweep, table.deviation)
    sweep = np.linspace(-0.85, 0.85, 20001)
    height, _, _ = table_and_formula(tool, sweep, spline(sweep), spline(sweep, 1))
    assert height.max() < limit * np.abs(np.diff(spline(table.sweep[:-1], 3))).max()


@pytest.mark.parametrize(
    ("waviness", "limit"),
    [
        ((0.0, 1e-4, -1e-4), 1e-10),
        ((1e-5, 0.0, 3e-5), 1e-10),
        ((1e-3,), 1e-8),
        ((0.0, 5e-3, 0.0, 0.0, -1e-3), 1e-8),
        ((0.0, 0.0, 0.0, -1e-3), 1e-8),
    ],
)
def test_profile_of_a_wavy_half_circle_is_exact_up_to_its_walls(waviness, limit):
    tool = Tool(nose_radius=0.5, waviness=waviness)
    low, high = tool.arc
    sweep = np.concatenate([np.linspace(low, high, 2000)[1:-1], low + 1e-2 * np.geomspace(1e-6, 1, 2000)])
    sweep = np.concatenate([sweep, high - 1e-2 * np.geomspace(1e-6, 1, 2000)])
    wave = np.polynomial.Polynomial((0, *waviness))
    height, _, angle = table_and_formula(tool, sweep, wave(sweep), wave.deriv()(sweep))
    assert height[np.abs(angle) < 89.5 * DEG].max() < 5e-13
    assert height.max() < limit
    # The arc goes as far as the edge does not stand up straight, and no further than half a circle.
    assert np.abs(angle).max() <= np.pi / 2 - 1e-3
    assert max(abs(low), high) <= np.pi / 2 - 1e-3
    for end, side in ((low, -1), (high, 1)):
        if abs(end) < np.pi / 2 - 1e-3:
            beyond = end + side * 2e-4
            assert side * (beyond - np.arctan(wave.deriv()(beyond) / (0.5 + wave(beyond)))) > np.pi / 2 - 1e-3


@pytest.mark.parametrize(("rate", "convex"), [(1e-6, False), (-1e-6, True), (0.0, True)])
def test_the_least_dent_where_a_certificate_begins_is_seen(rate, convex):
    # The slope falls by rate / nose_radius where the deviation begins to rise, and by less at its quiet end.
    sweep = np.linspace(-0.3, 0.9, 25)
    table = WavinessTable(sweep=sweep, deviation=rate * np.clip(sweep + 0.3, 0, None))
    assert Tool(nose_radius=0.5, included=60 * DEG, waviness=table).cutting_edge().convex is convex


def test_convexity_is_seen():
    assert Tool(nose_radius=0.2, included=60 * DEG).cutting_edge().convex
    waves = np.linspace(-0.6, 0.6, 400)
    table = WavinessTable(sweep=waves, deviation=2e-4 * np.sin(60 * waves))
    assert not Tool(nose_radius=0.2, included=60 * DEG, waviness=table).cutting_edge().convex


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"nose_radius": 0.0}, "nose_radius is 0 mm"),
        ({"nose_radius": float("nan")}, "nose_radius is nan"),
        ({"nose_radius": 0.5, "included": 4.0}, "included is 4 rad .229.183 deg.*180 deg"),
        ({"nose_radius": 0.5, "rake": 2.0}, "rake is 2 rad .114.592 deg.*80 deg"),
        ({"nose_radius": 0.5, "clearance": -0.1}, "clearance is -0.1 rad .-5.72958 deg"),
        ({"nose_radius": 0.5, "radius_error": -0.6}, "no nose remains"),
        ({"nose_radius": 0.5, "offset": (0.0, 1.0)}, "3 finite numbers"),
        ({"nose_radius": 0.5, "waviness": (float("inf"),)}, "waviness holds inf, it must be finite"),
        ({"nose_radius": 0.5, "waviness": (1.0,)}, "check its unit"),
        (
            {"nose_radius": 0.5, "included": 2.6, "waviness": (0.0, 0.0, -0.04)},
            "turns the edge to 100.7 deg at sweep 74.48",
        ),
    ],
)
def test_a_wrong_tool_cannot_exist(wrong, words):
    with pytest.raises(InputError, match=words):
        Tool(**wrong)


@pytest.mark.parametrize(
    ("sweep", "deviation", "words"),
    [
        ([0, 1, 2], [0, 0, 0], "at least 4"),
        ([0, 1, 2, 3], [0, 0, 0], "equal numbers of both"),
        ([0, 2, 1, 3], [0, 0, 0, 0], "do not ascend"),
        ([0, 1, 2, 3], [0, 0, 0, np.nan], "deviation holds nan, it must be finite"),
        ([0, 1e-4, 2e-4, 3e-4], [0, 0, 0, 0], "covers 0.0003 rad, the limit is 0.001 rad"),
    ],
)
def test_a_wrong_certificate_cannot_exist(sweep, deviation, words):
    with pytest.raises(InputError, match=words):
        WavinessTable(sweep=sweep, deviation=deviation)
