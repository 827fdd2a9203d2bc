"""The surface left. Oracles: closed form for cusps, and brute force over every pass written out here."""

from dataclasses import replace
from functools import lru_cache

import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq

import turnwright as tw
from cases import every_second, every_third
from turnwright.generation import Prepared

DEG = np.pi / 180
MACHINE = tw.Machine(
    name="test", axes={letter: tw.Axis() for letter in "CXZ"}, spindle_rpm=3000.0, block_rate_hz=1000.0
)


def spiral_motion(radius, feed, points, height, sense=1, beyond=0.0, wobble=0.0, inside_out=False):
    """A motion from ``radius`` to ``beyond`` the centre; ``height(x, y)`` of the tip."""
    k = np.arange(round((radius + beyond) / feed * points) + 1)
    turns = k / points
    x = radius - feed * turns + wobble * np.sin(5 * 2 * np.pi * turns)
    if inside_out:
        x = x[::-1]
    c = sense * 2 * np.pi * turns
    z = height(x * np.cos(c), x * np.sin(c))
    return tw.Motion(time=0.001 * k, axes={"C": c, "X": x, "Z": z}, machine=MACHINE)


@lru_cache(maxsize=2)
def dense_edge(tool, sense):
    s = np.linspace(-3.0, 3.0, 1_500_001)
    return tool.edge(s[(s > -1.55) & (s < 1.55)] if tool.included is None else s, sense)


class BruteForce:
    """Every crossing of every azimuth, the edge by dense interpolation of its definition."""

    def __init__(self, motion, tool, squareness=0.0):
        self.c = motion.sense * motion.axes["C"]
        self.sense = motion.sense
        self.x = motion.axes["X"]
        self.z = motion.axes["Z"] + squareness * self.x
        self.u, self.v, self.e = dense_edge(tool, motion.sense)
        self.upright = not self.v.any()

    def at(self, x, y):
        r, azimuth = np.hypot(x, y), self.sense * np.arctan2(y, x)
        lowest = np.inf
        first, last = np.floor(self.c[0] / (2 * np.pi)) - 2, np.ceil(self.c[-1] / (2 * np.pi)) + 2
        for side in (0, 1):
            for turn in np.arange(first, last):
                lowest = min(lowest, self.crossing(r, azimuth + np.pi * side + 2 * np.pi * turn, side))
        return lowest

    def crossing(self, r, t, side):
        sign = 1 - 2 * side

        def aside(at):
            """Lateral distance of the point from the edge when the tool is at ``at``, and the height of the edge."""
            tip = np.interp(at, self.c, self.x)
            u = sign * r * np.cos(at - t) - tip
            v = np.interp(u, self.u, self.v)
            return -self.sense * sign * r * np.sin(at - t) - v, u

        if self.upright:
            at = t
        else:
            a, b = t - 1.2, t + 1.2
            if (aside(a)[0] > 0) == (aside(b)[0] > 0):
                return np.inf
            at = brentq(lambda q: aside(q)[0], a, b, xtol=1e-15, rtol=1e-15)
        if not self.c[0] - 1e-12 <= at <= self.c[-1] + 1e-12:
            return np.inf
        return np.interp(at, self.c, self.z) + np.interp(aside(at)[1], self.u, self.e)

    def swept(self, x, y, fine=100):
        """Of every moment of the motion, those at which the edge passes over the point, however many a turn."""
        r, azimuth = np.hypot(x, y), self.sense * np.arctan2(y, x)
        steps = self.c.size - 1

        def over(at):
            u = r * np.cos(at - azimuth) - np.interp(at, self.c, self.x)
            aside = -self.sense * r * np.sin(at - azimuth) - np.interp(u, self.u, self.v)
            return aside, np.interp(at, self.c, self.z) + np.interp(u, self.u, self.e)

        at = np.interp(np.linspace(0, steps, steps * fine + 1), np.arange(steps + 1), self.c)
        aside, _ = over(at)
        passes = np.flatnonzero(aside[1:] * aside[:-1] < 0)
        roots = [brentq(lambda q: over(q)[0], at[i], at[i + 1], xtol=1e-15, rtol=1e-15) for i in passes]
        return min((over(root)[1] for root in roots), default=np.inf)


def bowl(x, y):
    return 0.03 * (x**2 + y**2) + 0.004 * np.sin(3 * x) * np.cos(2 * y) + 0.02 * x


ROUND = tw.Tool(nose_radius=0.5, included=100 * DEG)
RIPPLE = np.linspace(-0.9, 0.9, 361)
TOOLS = {
    "round": ROUND,
    "narrow": tw.Tool(nose_radius=0.5, included=10 * DEG, offset=(0.013, 0.0, 0.002)),
    "half circle": tw.Tool(nose_radius=0.3),
    "wavy": tw.Tool(nose_radius=0.5, included=100 * DEG, waviness=(1e-3, 0.01, -0.02), radius_error=0.01),
    "not convex": tw.Tool(
        nose_radius=0.5,
        included=100 * DEG,
        waviness=tw.WavinessTable(sweep=RIPPLE, deviation=1e-4 * np.sin(80 * RIPPLE)),
    ),
    "off centre": tw.Tool(nose_radius=0.5, included=100 * DEG, offset=(0.0, 0.004, 0.0)),
    "leaning": tw.Tool(nose_radius=0.5, included=100 * DEG, rake=-25 * DEG, offset=(-0.01, -0.003, 0.001)),
}
MOTIONS = {
    "in": {"sense": 1},
    "out, falling angle": {"sense": -1, "inside_out": True},
    "beyond the centre": {"sense": -1, "beyond": 0.1},
    "wobbling": {"sense": 1, "wobble": 0.03},
}


@pytest.mark.parametrize(("name", "how"), every_third(TOOLS, MOTIONS))
def test_generated_surface_equals_brute_force_over_every_pass(name, how):
    tool = TOOLS[name]
    motion = spiral_motion(1.0, 0.02, 37, bowl, **MOTIONS[how])
    brute = BruteForce(motion, tool)
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-0.6, 0.6, (2, 10))
    x[:4] *= 0.02  # close to the axis, where passes come from both sides
    y[:4] *= 0.02
    # Nearer the axis than the tip is off centre, a wobbling tool passes over a point several times a turn: see below.
    far = np.hypot(x, y) > 0.005
    x, y = x[far], y[far]
    expected = np.array([brute.at(*point) for point in zip(x, y, strict=True)])
    got = tw.generate_points(motion, tool, x=x, y=y)
    reached = np.isfinite(expected)
    assert (np.isfinite(got) == reached).all()
    np.testing.assert_allclose(got[reached], expected[reached], atol=2e-11)


@pytest.mark.parametrize(("name", "how"), every_second(["off centre", "leaning"], MOTIONS))
def test_every_pass_of_a_turn_counts_close_to_the_axis(name, how):
    motion = spiral_motion(1.0, 0.02, 37, bowl, **MOTIONS[how])
    brute = BruteForce(motion, TOOLS[name])
    rng = np.random.default_rng(11)
    r, azimuth = np.sqrt(rng.uniform(0, 0.008**2, 16)), rng.uniform(-np.pi, np.pi, 16)
    x, y = np.append(r * np.cos(azimuth), 0.0), np.append(r * np.sin(azimuth), 0.0)
    expected = np.array([brute.swept(*point) for point in zip(x, y, strict=True)])
    got = tw.generate_points(motion, TOOLS[name], x=x, y=y)
    reached = np.isfinite(expected)
    assert (np.isfinite(got) == reached).all()
    np.testing.assert_allclose(got[reached], expected[reached], atol=4e-11)


HEIGHTS = {
    "steep and round": lambda x, y: 0.4 * (x * x + y * y),
    "far from round": lambda x, y: 0.2 * x * x - 0.1 * y * y + 0.1 * x,
}


@pytest.mark.parametrize(("name", "height"), every_second(["off centre", "leaning", "not convex"], HEIGHTS))
def test_no_turn_that_matters_is_left_out(name, height):
    """Steep and round, where few turns may matter, and far from round, where every turn reaches low somewhere."""
    motion = spiral_motion(1.0, 0.004, 37, HEIGHTS[height])
    brute = BruteForce(motion, TOOLS[name])
    x, y = np.random.default_rng(3).uniform(-0.6, 0.6, (2, 600))
    got = tw.generate_points(motion, TOOLS[name], x=x, y=y)  # many points at once, so that the rings are narrow
    expected = [brute.at(x[i], y[i]) for i in range(6)]
    np.testing.assert_allclose(got[:6], expected, atol=2e-11)


@pytest.mark.parametrize(("name", "how"), every_third(TOOLS, MOTIONS))
def test_maps_equal_single_points(name, how):
    """Tiles and envelopes share work between points; each point alone is the reference, checked above."""
    tool = TOOLS[name]
    motion = spiral_motion(1.0, 0.02, 61, bowl, **MOTIONS[how])
    maps = [
        tw.generate(motion, tool, x=np.linspace(0.3, 0.34, 41), y=np.linspace(-0.01, 0.01, 21)),
        tw.generate(motion, tool, x=np.linspace(-0.03, 0.03, 31), y=np.linspace(-0.03, 0.03, 31)),
        tw.generate(motion, tool, x=np.linspace(-0.8, 0.8, 17), y=np.linspace(-0.8, 0.8, 17)),
        tw.generate_polar(motion, tool, radius=np.linspace(0, 0.9, 181), angle=np.linspace(-1, 5, 15)),
        tw.generate_polar(motion, tool, radius=np.geomspace(0.01, 0.9, 40), angle=[0.0, 2 * np.pi / 61]),
        *(tw.generate_polar(motion, tool, radius=[r], angle=np.linspace(-1, 5, 15)) for r in (0.003, 0.02, 0.5)),
        tw.generate(motion, tool, x=[0.31], y=[-0.02]),
    ]
    for each in maps:
        x, y = each.points()
        alone = tw.generate_points(motion, tool, x=x.ravel(), y=y.ravel()).reshape(x.shape)
        both = np.isfinite(each.z) & np.isfinite(alone)
        np.testing.assert_allclose(each.z[both], alone[both], atol=1e-13)
        # Where a point stands on the very rim of what an off-centre tool covers, rounding decides.
        assert np.count_nonzero(np.isfinite(each.z) != np.isfinite(alone)) <= 2


@pytest.mark.parametrize("name", TOOLS)
@pytest.mark.parametrize("sides", [(1, 1), (2, 5), (16, 16)])
def test_heights_do_not_depend_on_the_tiles(name, sides):
    """Tiles narrower than a chord and across several of them, in groups that share a list and alone."""
    motion = spiral_motion(1.0, 0.02, 61, bowl)
    x, y = np.linspace(0.3, 0.5, 67), np.linspace(-0.1, 0.06, 65)
    inside = np.add.outer(np.arange(y.size), np.arange(x.size)) % 7 != 3
    inside[:20, :30] = False
    ready = Prepared.of(motion, TOOLS[name], None, distances=(0.0, 0.6), most_rings=1000)
    z = ready.fill_grid(x, y, sides=sides, inside=inside)
    across, down = np.meshgrid(x, y)
    alone = tw.generate_points(motion, TOOLS[name], x=across[inside], y=down[inside])
    np.testing.assert_allclose(z[inside], alone, atol=1e-13)
    assert np.isnan(z[~inside]).all()


def flat_motion(feed, points=8, turns=60):
    k = np.arange(points * turns + 1)
    return tw.Motion(
        time=0.01 * (k + 1),
        axes={"C": 2 * np.pi * k / points, "X": feed * (turns - k / points), "Z": np.zeros(k.size)},
        machine=MACHINE,
    )


@pytest.mark.parametrize(("nose", "feed"), [(0.514, 0.010), (1.5, 0.002), (0.1, 0.02)])
def test_cusps_on_a_flat_in_closed_form(nose, feed):
    motion = flat_motion(feed)
    # On the azimuth of the first point the tips stand at whole feeds: samples hit every tip and every cusp.
    radius = np.linspace(20 * feed, 40 * feed, 20 * 2 * 500 + 1)
    z = tw.generate_polar(motion, tw.Tool(nose_radius=nose), radius=radius, angle=[0.0]).z
    mpmath.mp.dps = 30
    pv = float(mpmath.mpf(nose) - mpmath.sqrt(mpmath.mpf(nose) ** 2 - mpmath.mpf(feed) ** 2 / 4))
    assert np.ptp(z) == pytest.approx(pv, rel=1e-7)
    error = z[:, :-1] - z[:, :-1].mean(axis=1, keepdims=True)
    # Sq and Sa of a parabolic cusp; a circular one differs by the order of (feed/R)^2, and 1000 samples a cusp by 1e-6.
    tolerance = (feed / nose) ** 2 + 1e-5
    assert np.sqrt((error**2).mean()) == pytest.approx(pv * np.sqrt(4 / 45), rel=tolerance)
    assert np.abs(error).mean() == pytest.approx(pv * 4 / (9 * np.sqrt(3)), rel=tolerance)


@pytest.mark.parametrize("curvature", [0.5, -0.5, 1.5])
@pytest.mark.parametrize("along", ["z", "normal"])
def test_cusps_on_a_curved_profile(curvature, along):
    """PV f²/(8R(1-κR)) for a path placed along z, where the feed is constant along x at small slope."""
    nose, feed = 0.4, 0.004
    surface = tw.Sphere(radius=1 / curvature)
    k = np.arange(24 * 40 + 1)
    angle = 2 * np.pi * k / 24
    where = tw.Spiral(angle=angle, radius=feed * (40 - angle / (2 * np.pi)))
    path = tw.place(where, tw.Part(surface=surface, radius=0.2), tw.Tool(nose_radius=nose, included=2.5), along=along)
    motion = tw.Motion(time=1.0 + k, axes={"C": path.angle, "X": path.radius, "Z": path.z}, machine=MACHINE)
    # Close to the axis the surface is level: slopes up to 0.048, whose square the formulas neglect (1.5 * 0.048² =
    # 0.0035). On an azimuth of a program point no chord error comes in.
    ring = tw.generate_polar(
        motion, tw.Tool(nose_radius=nose, included=2.5), radius=np.linspace(3 * feed, 8 * feed, 50_001), angle=[0.0]
    )
    error = ring.minus(surface).z[0]
    assert error.min() > -1e-13
    expected = feed**2 / (8 * nose * (1 - curvature * nose)) if along == "z" else feed**2 / 8 * (1 / nose - curvature)
    assert error.max() == pytest.approx(expected, rel=4e-3)


def test_linear_between_points_is_the_chord():
    """Between points the tool runs straight in the machine's axes."""
    motion = spiral_motion(1.0, 0.5, 12, lambda x, _: 0.1 * x)
    at = 0.5 * (motion.axes["C"][3] + motion.axes["C"][4])
    r = 0.5 * (motion.axes["X"][3] + motion.axes["X"][4])
    z = tw.generate_points(motion, tw.Tool(nose_radius=0.01), x=[r * np.cos(at)], y=[r * np.sin(at)])
    assert z[0] == pytest.approx(0.5 * (motion.axes["Z"][3] + motion.axes["Z"][4]), abs=1e-15)


def test_squareness_and_straightness_of_the_actual_machine():
    motion = spiral_motion(1.0, 0.01, 31, bowl)
    wrong = replace(MACHINE, squareness=2e-4, straightness=(np.array([0.0, 1.0]), np.array([0.0, 1e-4])))
    points = {"x": np.array([0.3, -0.4, 0.05]), "y": np.array([0.2, 0.5, -0.6])}
    got = tw.generate_points(motion, ROUND, **points, machine=wrong)
    brute = BruteForce(motion, ROUND, squareness=3e-4)
    expected = [brute.at(x, y) for x, y in zip(points["x"], points["y"], strict=True)]
    np.testing.assert_allclose(got, expected, atol=2e-11)
    assert np.abs(got - tw.generate_points(motion, ROUND, **points)).min() > 1e-5


def test_a_second_axis_across_moves_the_tip_laterally():
    """A constant Y is a tool off centre by as much."""
    motion = spiral_motion(1.0, 0.02, 47, bowl)
    moved = replace(motion, axes={**motion.axes, "Y": np.full(motion.time.size, 0.004)})
    x, y = np.array([0.3, -0.2, 0.02]), np.array([0.1, 0.4, -0.03])
    np.testing.assert_allclose(
        tw.generate_points(moved, ROUND, x=x, y=y),
        tw.generate_points(motion, TOOLS["off centre"], x=x, y=y),
        atol=1e-15,
    )


def test_tool_off_centre_leaves_a_core():
    motion = spiral_motion(1.0, 0.02, 60, bowl)
    made = tw.generate(motion, TOOLS["off centre"], x=np.linspace(-0.01, 0.01, 41), y=np.linspace(-0.01, 0.01, 41))
    x, y = made.points()
    missing = np.isnan(made.z)
    assert missing[np.hypot(x, y) < 0.0039].all()
    assert not missing[np.hypot(x, y) > 0.0045].any()


def test_output_array_is_used_and_checked():
    motion = spiral_motion(1.0, 0.02, 60, bowl)
    radius, angle = np.linspace(0.1, 0.5, 50), np.linspace(0, 1, 7)
    out = np.empty((7, 50))
    made = tw.generate_polar(motion, ROUND, radius=radius, angle=angle, out=out)
    assert np.shares_memory(made.z, out)
    np.testing.assert_array_equal(made.z, tw.generate_polar(motion, ROUND, radius=radius, angle=angle).z)
    with pytest.raises(tw.InputError, match="out is"):
        tw.generate_polar(motion, ROUND, radius=radius, angle=angle, out=np.empty((50, 7)))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda m: tw.generate(m, ROUND, x=[1.0, 0.0], y=[0.0]), "x must ascend"),
        (lambda m: tw.generate_polar(m, ROUND, radius=[-0.1, 0.0], angle=[0.0]), "radius begins at -0.1"),
        (lambda m: tw.generate_points(m, ROUND, x=[0.0, 1.0], y=[0.0]), "lengths of arrays differ"),
        (lambda m: tw.generate(m, ROUND, x=[np.nan], y=[0.0]), "not finite"),
    ],
)
def test_wrong_grids_are_refused(call, words):
    with pytest.raises(tw.InputError, match=words):
        call(spiral_motion(1.0, 0.1, 20, bowl))


@pytest.mark.parametrize("tool", ["round", "off centre", "leaning"])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_tool_that_swings_in_y_equals_brute_force(tool, sense):
    """Where the tool stands still over the part it passes over a point at a turning point of its own azimuth."""
    motion = spiral_motion(0.4, 0.05, 120, bowl, sense=sense)
    c, x = motion.axes["C"], motion.axes["X"]
    swing = 0.1 * np.sin(9 * c)  # so that its azimuth turns back for a while in each swing
    moved = replace(motion, axes={**motion.axes, "X": x * np.cos(swing), "Y": x * np.sin(swing)})
    edge = TOOLS[tool]
    px, py = np.array([0.31, -0.2, 0.11, -0.05, 0.02]), np.array([0.05, 0.21, -0.3, -0.04, 0.01])
    got = tw.generate_points(moved, edge, x=px, y=py)
    s = np.linspace(-0.87, 0.87, 200_001)
    u, v, e = edge.edge(s, sense)
    number = np.linspace(0, c.size - 1, 60 * (c.size - 1) + 1)
    at, out, up, z = (np.interp(number, np.arange(c.size), moved.axes[letter]) for letter in "CXYZ")
    for k in range(px.size):
        along = px[k] * np.cos(at) + py[k] * np.sin(at)
        across = py[k] * np.cos(at) - px[k] * np.sin(at)
        place = along - out
        aside = across - up - np.interp(place, u, v)
        height = np.where((place > u[0]) & (place < u[-1]), z + np.interp(place, u, e), 1.0)
        i = np.flatnonzero((aside[1:] > 0) != (aside[:-1] > 0))
        share = aside[i] / (aside[i] - aside[i + 1])
        # Between two samples everything is straight but for the square of a step of 0.02 degrees.
        expected = (height[i] + share * (height[i + 1] - height[i])).min()
        assert got[k] == pytest.approx(expected, abs=2e-8)


def passes_of_a_swinging_tool(motion, x, y, above):
    """Every moment at which an upright tool, ``above`` centre, passes over a point: at most one between two extremes.

    On one line of the motion the point is r sin(c - azimuth) off, which is as far as the tip is where Y is straight:
    an extreme of the difference is where r cos(c - azimuth) equals the rate of Y, in closed form.
    """
    r, azimuth = np.hypot(x, y), np.arctan2(y, x)
    index = np.arange(motion.time.size)
    c, up = motion.axes["C"], motion.axes["Y"] + above
    rate = np.diff(up) / np.diff(c)
    inside = np.abs(rate) < r
    turn = 2 * np.pi
    moments = [index.astype(float)]
    for sign in (1, -1):
        # F = -r sin(c - azimuth) - Y, so F' = 0 at cos(c - azimuth) = -Y' / r.
        still = azimuth + sign * np.arccos(np.where(inside, -rate / r, 1.0))
        low, high = np.minimum(c[:-1], c[1:]), np.maximum(c[:-1], c[1:])
        still += turn * np.ceil((low - still) / turn)
        on = inside & (still <= high)
        moments.append((index[:-1] + (still - c[:-1]) / np.diff(c))[on])
    moments = np.sort(np.concatenate(moments))

    def aside(at):
        return -r * np.sin(np.interp(at, index, c) - azimuth) - np.interp(at, index, up)

    f = aside(moments)
    changes = np.flatnonzero((f[1:] > 0) != (f[:-1] > 0))
    return np.array([brentq(aside, moments[i], moments[i + 1], xtol=1e-13, rtol=1e-15) for i in changes])


@pytest.mark.parametrize(("share", "sense", "above"), every_second([0.11, 0.2], [1, -1], [0.0, 0.004]))
def test_a_tool_at_rest_equals_the_closed_form(sense, above, share):
    """A swing of a ninth of a radian just stops over the part nine times a turn; a larger one turns back and forth."""
    edge = tw.Tool(nose_radius=0.1, offset=(0.0, above, 0.0))
    motion = spiral_motion(0.4, 0.02, 180, lambda x, y: 0.02 * np.cos(9 * np.arctan2(y, x)), sense=sense)
    c, x = motion.axes["C"], motion.axes["X"]
    swing = share * np.sin(9 * c)
    motion = replace(motion, axes={**motion.axes, "X": x * np.cos(swing), "Y": x * np.sin(swing)})
    rng = np.random.default_rng(2)
    r, azimuth = rng.uniform(0.002, 0.39, 40), rng.uniform(-np.pi, np.pi, 40)
    azimuth[:20] = np.round(azimuth[:20] * 9 / np.pi) * np.pi / 9 + 1e-4  # where it stands or turns back
    px, py = r * np.cos(azimuth), r * np.sin(azimuth)
    got = tw.generate_points(motion, edge, x=px, y=py)
    index, most = np.arange(c.size), 0
    for k in range(px.size):
        at = passes_of_a_swinging_tool(motion, px[k], py[k], above)
        angle, out, z = (np.interp(at, index, motion.axes[letter]) for letter in "CXZ")
        u = px[k] * np.cos(angle) + py[k] * np.sin(angle) - out
        most = max(most, np.count_nonzero(np.abs(angle - angle[:, None]) < 0.5, axis=0).max())
        reach = np.abs(u) < 0.0999  # what stands on the end of the half circle is never the lowest here
        expected = (z + 0.1 - np.sqrt(0.01 - u**2, where=reach, out=np.full(u.size, -1.0)))[reach].min()
        assert got[k] == pytest.approx(expected, abs=2e-11)
    assert most >= 3 or share < 1 / 9  # passes over one point within half a radian


def test_axis_under_a_wavy_edge_is_the_least_of_all_passes():
    """Oracle: every block in 100 steps under a dense edge, whose waves make it sink back on the way out."""
    rng, worst = np.random.default_rng(3), 0.0
    sweep = np.linspace(-0.7, 0.7, 57)
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(80), clearance=np.deg2rad(10))
    part = tw.Part(surface=tw.Plane(slope=(0.0, 0.0)), radius=0.3)
    servo = tw.SlowToolServo(feed=0.02, spindle_rpm=60, points_per_rev=36)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, tw.Machine.load("generic"))
    x, z = (
        (a[:-1, None] + np.linspace(0, 1, 101) * np.diff(a)[:, None]).ravel()
        for a in (motion.axes["X"], motion.axes["Z"])
    )
    for _ in range(12):
        waves = 3e-4 * np.cumsum(rng.normal(size=57)) / 8
        waves -= np.interp(0, sweep, waves)
        off = float(rng.uniform(-0.05, 0.05))
        real = replace(tool, waviness=tw.WavinessTable(sweep=sweep, deviation=waves), offset=(off, 0.0, 0.0))
        at = np.linspace(-0.69, 0.69, 100_001)
        out = 0.5 + real.deviation(at)
        u, w = out * np.sin(at), 0.5 - out * np.cos(at)
        order = np.argsort(u)
        near = np.abs(x + off) < 0.3
        oracle = (z[near] + np.interp(-(x[near] + off), u[order], w[order])).min()
        made = [
            tw.generate_points(motion, real, x=np.zeros(1), y=np.zeros(1))[0],
            tw.generate_polar(motion, real, radius=np.array([0.0, 0.1]), angle=np.linspace(0, 6, 20)).z[0, 0],
        ]
        worst = max(worst, *(abs(one - oracle) for one in made))
    assert worst < 1e-9


def test_axis_under_a_ragged_edge_may_have_several_least_heights_between_two_points():
    """Oracle: one straight line of the motion in 400,000 steps. Between two points the height rises and falls."""
    sweep = np.linspace(-0.87, 0.87, 241)
    waves = tw.WavinessTable(sweep=sweep, deviation=1e-3 * np.sin(75 * sweep))
    tool = tw.Tool(nose_radius=0.5, included=1.74, waviness=waves)
    share = np.linspace(0, 1, 400_001)
    for climb in (-0.05, 0.0, 0.02, 0.06):
        axes = {"C": np.array([0.0, 2.0]), "X": np.array([0.3, -0.5]), "Z": np.array([0.0, climb])}
        motion = tw.Motion(time=np.array([0.0, 1.0]), axes=axes, machine=MACHINE)
        oracle = (share * climb + tool.cutting_edge().profile(0.8 * share - 0.3)[0]).min()
        made = tw.generate(motion, tool, x=[0.0], y=[0.0]).z[0, 0]
        assert made == pytest.approx(oracle, abs=1e-9)
        assert tw.generate_polar(motion, tool, radius=[0.0, 0.1], angle=[0.5]).z[0, 0] == made


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("start", [0.0, 0.3, -2.0, 1000.0])
@pytest.mark.parametrize("edge", [tw.Tool(nose_radius=0.5), tw.Tool(nose_radius=0.5, rake=0.2)])
def test_a_deep_turn_counts_on_both_sides_of_the_azimuth_where_turns_begin(sense, start, edge):
    """Turns count from where the motion begins: one that is deeper than all others ends where the next begins.

    Oracle: single points.
    """
    k = np.arange(20 * 360 + 1)
    for deep, radius, pixel in ((4, 0.9, 2e-3), (10, 0.82, 2e-3), (15, 0.9, 2e-4)):
        z = np.where((k > 360 * deep) & (k <= 360 * (deep + 1)), -1e-3, 0.0)
        axes = {"C": start + sense * np.deg2rad(k), "X": 1.0 - 0.01 * k / 360, "Z": z}
        motion = tw.Motion(time=1.0 * k, axes=axes, machine=MACHINE)
        x, y = (one + pixel * (np.arange(40) - 17.3) for one in (radius * np.cos(start), radius * np.sin(start)))
        across, down = (one.ravel() for one in np.meshgrid(x, y))
        single = tw.generate_points(motion, edge, x=across, y=down)
        np.testing.assert_allclose(tw.generate(motion, edge, x=x, y=y).z.ravel(), single, rtol=0, atol=1e-12)


@pytest.mark.parametrize("middle", [(0.5, 0.3), (-0.5, 0.01), (0.0, 0.0)])
@pytest.mark.parametrize("start", [0.0, -9e4])
def test_heights_do_not_depend_on_how_many_groups_share_a_list(monkeypatch, middle, start):
    """Oracle: the same grid on a computer of so many cores that no groups share a list, to the last bit."""
    motion = spiral_motion(0.9, 0.02, 50, lambda x, y: 0.05 * x * x + 0.01 * y)
    motion = replace(motion, axes={**motion.axes, "C": start + motion.axes["C"]})
    edge = tw.Tool(nose_radius=0.3)
    x, y = (one + 2e-4 * np.arange(-400, 400) for one in middle)
    shared = []
    for groups in (0.001, 1e9):
        monkeypatch.setattr("turnwright.generation.GROUPS_PER_CORE", groups)
        shared.append(tw.generate(motion, edge, x=x, y=y).z)
    np.testing.assert_array_equal(*shared)


def test_points_beyond_the_prepared_distances_do_not_disturb_those_within():
    """A tile holds points outside of a disc, beyond all rings. Oracle: the whole grid."""
    motion = spiral_motion(0.3, 0.02, 7, lambda x, y: x - 0.5 * y)
    axes = {**motion.axes, "Y": 0.05 * np.sin(3 * motion.axes["X"])}
    motion = replace(motion, axes=axes)
    edge = tw.Tool(nose_radius=0.05, included=np.deg2rad(48))
    x = np.linspace(-0.1, 0.1, 201)
    inside = np.hypot(*np.meshgrid(x, x)) < 0.03
    ready = Prepared.of(motion, edge, None, distances=(0.0, 0.03), most_rings=10_000)
    made = ready.fill_grid(x, x, inside=inside)
    whole = tw.generate(motion, edge, x=x, y=x).z
    np.testing.assert_allclose(made[inside], whole[inside], rtol=0, atol=1e-12)
    assert np.isnan(made[~inside]).all()
