"""The swinging tool. Oracles: circles in closed form for spheres, brute force over them, and SciPy's optimiser."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

import turnwright as tw

DEG = np.pi / 180
CURVE, PITCH, NOSE = 0.626, 0.1, 0.103
ARRAY = tw.LensArray.hexagonal(pitch=PITCH, lenslet=tw.Sphere(radius=-CURVE), within=0.5)
TOOL = tw.Tool(nose_radius=NOSE, included=60 * DEG)
PART = tw.Part(surface=ARRAY, radius=0.22)
COMMON = {"feed": 0.02, "points_per_rev": 900, "spindle_rpm": 15}
MERGE = tw.QuasiEllipticalToolServo(**COMMON, short="merge", shortest=0.005)
SKIP = tw.QuasiEllipticalToolServo(**COMMON, short="skip", shortest=0.005)
SLOW = tw.QuasiEllipticalToolServo(**COMMON, short="slow", y_acceleration=200.0)
SERVOS = {"merge": MERGE, "skip": SKIP, "slow": SLOW}
FALLING = {
    "falling angle": replace(MERGE, sense=-1),
    "from the centre": replace(SKIP, inside_out=True),
}


def each_lens(angle, radius, y):
    """Height of the tip over every whole lens by itself: its plane cuts the sphere in a circle, the nose touches it."""
    cx, cy = ARRAY.centres.T
    along, across = cx * np.cos(angle) + cy * np.sin(angle), cy * np.cos(angle) - cx * np.sin(angle) - y
    reach = np.sqrt(CURVE**2 - across**2) + NOSE
    # A convex lens is the highest of all inside its own cell and the lowest outside: the greatest is the surface's.
    with np.errstate(invalid="ignore"):
        height = np.sqrt(reach**2 - (along - radius) ** 2) - CURVE - NOSE
    return np.nan_to_num(height, nan=-1.0)


@cache
def course_of(name):
    """The spiral of the steady tool, and the swing that a servo makes of it; many tests ask for it."""
    servo = SERVOS.get(name) or FALLING[name]
    plain = servo._make_slow_servo().spiral(PART, TOOL)
    return plain, servo._plan(plain, PART, TOOL, None)[0]


@pytest.fixture(scope="module")
def found():
    return {
        name: (servo.valleys(PART, TOOL), lambda angle, name=name: course_of(name)[1].spiral(np.asarray(angle)))
        for name, servo in SERVOS.items()
    }


def apart(swing, angles, one, other):
    """How much higher one lens asks the tip to be than another, at some angles of the swing."""
    there = swing(angles)
    poses = zip(there.angle, there.radius, there.y, strict=True)
    return np.array([(heights := each_lens(*pose))[other] - heights[one] for pose in poses])


@pytest.mark.parametrize("name", ["merge", pytest.param("skip", marks=pytest.mark.proof), "slow"])
def test_placed_heights_are_those_of_the_closed_form(found, name):
    """Must show: the relative trajectory is the exact placement at the true pose."""
    path = tw.place(found[name][1](course_of(name)[0].angle), PART, TOOL)
    inside = np.flatnonzero(np.hypot(path.radius, path.y) < 0.2)
    for k in np.random.default_rng(3).choice(inside, 100):
        expected = each_lens(path.angle[k], path.radius[k], path.y[k]).max()
        assert path.z[k] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    "name", [*(pytest.param(one, marks=pytest.mark.proof) for one in ("merge", "skip")), "slow", *FALLING]
)
def test_the_tip_stays_on_its_radius_and_does_not_drift(name):
    servo = SERVOS.get(name) or FALLING[name]
    swung = servo.spiral(PART, TOOL)
    plain, course = course_of(name)
    np.testing.assert_allclose(np.hypot(swung.radius, swung.y), np.abs(plain.radius), rtol=0, atol=1e-15)
    swing = np.arctan2(swung.y, swung.radius)
    assert np.abs(swing).max() < 0.5
    # It crosses the rake plane all the time, and comes back to it at the end.
    assert np.count_nonzero(np.diff(np.sign(swing[np.abs(swing) > 1e-9]))) > swung.turns * 5
    assert abs(swing[-1]) < 1e-12
    # The stated rates are derivatives.
    some = slice(100, -100, 97)
    before, after = (course.spiral(swung.angle[some] + way * 1e-5) for way in (-1, 1))
    np.testing.assert_allclose((after.radius - before.radius) / 2e-5, swung.radius_rate[some], atol=1e-7)
    np.testing.assert_allclose((after.y - before.y) / 2e-5, swung.y_rate[some], atol=1e-7)


@pytest.mark.parametrize("name", SERVOS)
def test_no_slope_discontinuity_where_the_tool_stands_still(found, name):
    """Must show: no jump of dZ/dangle above 1e-6 mm/rad, by heights that know nothing of how valleys are found."""
    valleys, swing = found[name]
    inside = np.flatnonzero(valleys.is_at_rest & (valleys.radius < 0.2) & (valleys.slope_jump > 0.01))
    assert inside.size > 30
    if name == "slow":
        # All of them, but for the outermost tips, whose edge hangs over the rim, and one that is grazed.
        assert valleys.is_at_rest[(valleys.radius < 0.2) & (valleys.slope_jump > 0.003)].all()
    for k in inside:
        at, step = valleys.angle[k], 1e-5
        there = swing([at, at + step])
        one, other = np.argsort(each_lens(at, there.radius[0], there.y[0]))[-2:]
        # Two lenses ask for the same height there, and the tool goes from one of them to the other, as steep after as
        # before.
        before, near, here, beyond, behind = apart(swing, at + step * np.array([-500, -1, 0, 1, 500]), one, other)
        assert abs(here) < 1e-10  # as exact as the heights of `place`
        assert before * behind < 0
        assert abs(beyond - near) / (2 * step) < 1e-6


def test_slope_discontinuity_of_a_steady_tool_in_closed_form():
    """And every valley that a steady tool passes is among them."""
    valleys = replace(SKIP, shortest=1e-6).valleys(PART, TOOL)
    plain = SKIP._make_slow_servo().spiral(PART, TOOL)
    slope = (plain.radius[-1] - plain.radius[0]) / (plain.angle[-1] - plain.angle[0])

    def heights(at):
        return each_lens(at, plain.radius[0] + slope * at, 0.0)

    angle = np.linspace(3 * np.pi, 19 * np.pi, 20_001)
    highest = np.array([heights(at).argmax() for at in angle])
    kinks = []
    for i in np.flatnonzero(np.diff(highest)):
        one, other = highest[i : i + 2]
        at = brentq(lambda q, a=one, b=other: heights(q)[b] - heights(q)[a], angle[i], angle[i + 1], xtol=1e-14)
        if heights(at).argmax() in (one, other):
            kinks.append((at, ((heights(at + 1e-6) - heights(at - 1e-6)) / 2e-6)[[one, other]]))
    assert len(kinks) > 60
    for at, (before, after) in kinks:
        nearest = np.argmin(np.abs(valleys.azimuth - at))
        if valleys.is_at_rest[nearest]:
            # A valley goes on a little until the tool stands there.
            assert abs(valleys.azimuth[nearest] - at) < 1e-3
            assert valleys.slope_jump[nearest] == pytest.approx(after - before, rel=1e-2, abs=1e-7)


def test_slow_keeps_the_y_axis_limit_at_least_displacement(found):
    axes = {letter: tw.Axis() for letter in "CXYZ"}
    lathe = tw.Machine(name="lathe", axes=axes, spindle_rpm=600.0, block_rate_hz=1e5)
    peak = {}
    for name, policy in {"slow": SLOW, "skip": replace(SKIP, shortest=1e-5)}.items():
        servo = replace(policy, points_per_rev=3600)
        motion = tw.drive(tw.place(servo.spiral(PART, TOOL), PART, TOOL), servo, lathe)
        peak[name] = tw.check_limits(motion, lathe).peak_acceleration["Y"]
    assert peak["slow"] < 200.0 < 0.5 * peak["skip"]
    # The tool is early at some valleys and late at others.
    off = found["slow"][0].angle - found["slow"][0].azimuth
    assert off[found["slow"][0].is_at_rest].min() < -1e-3 < 1e-3 < off[found["slow"][0].is_at_rest].max()
    course = course_of("slow")[1]
    line = np.sort(np.random.default_rng(2).uniform(30.0, 32.0, 7))
    moment = SLOW._schedule_moments(course, line, np.zeros(7))
    edges = np.concatenate([course.moment[:1], line, course.moment[-1:]])
    radius = np.abs(course.radius(edges))
    least = 15 * np.pi / 30 * np.sqrt(2 * np.pi * np.maximum(radius[1:], radius[:-1]) * np.diff(edges) / (0.95 * 200))
    best = minimize(
        lambda q: ((q - line) ** 2).sum(),
        line,
        constraints={"type": "ineq", "fun": lambda q: np.diff(q) - least[1:-1]},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert (np.diff(moment) >= least[1:-1] * (1 - 1e-9)).all()
    np.testing.assert_allclose(moment, best.x, atol=1e-6)


def test_policies_differ_at_short_intervals_only(found):
    merged, skipped, slow = (found[name][0] for name in SERVOS)
    assert slow.is_at_rest.mean() > skipped.is_at_rest.mean() > merged.is_at_rest.mean() > 0.7
    gap = np.diff(skipped.azimuth[skipped.is_at_rest]) * skipped.radius[skipped.is_at_rest][1:]
    assert gap.min() > 0.005 * (1 - 1e-6)
    passed = skipped.residual_jump[~skipped.is_at_rest]
    assert passed.max() > 1e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"short": "hop"}, 'must be "merge", "skip" or "slow"'),
        ({"shortest": None}, "needs shortest"),
        ({"y_acceleration": 10.0}, "must not have y_acceleration"),
        ({"short": "slow", "shortest": None, "y_acceleration": 10.0, "spindle_rpm": None}, "needs spindle_rpm"),
        ({"shortest": -1.0}, "shortest is -1 mm"),
    ],
)
def test_a_policy_says_what_it_needs(change, words):
    with pytest.raises(tw.InputError, match=words):
        replace(MERGE, **change)


def test_a_path_without_a_valley_is_that_of_a_steady_tool():
    alone = tw.LensArray.square(pitch=1.0, rows=1, columns=1, lenslet=tw.Sphere(radius=-CURVE))
    part = tw.Part(surface=alone, radius=0.1)
    for servo in SERVOS.values():
        swung = servo.spiral(part, TOOL)
        np.testing.assert_array_equal(swung.y, 0)
        np.testing.assert_allclose(swung.radius, servo._make_slow_servo().spiral(part, TOOL).radius, atol=1e-15)
        assert servo.valleys(part, TOOL).angle.size == 0


def test_a_smooth_surface_and_a_y_too_slow_are_refused():
    with pytest.raises(tw.InputError, match="has no valleys"):
        MERGE.spiral(tw.Part(surface=tw.Plane(), radius=0.3), TOOL)
    with pytest.raises(tw.LimitError, match="lower spindle speed"):
        replace(SLOW, y_acceleration=1.0).spiral(PART, TOOL)
    with pytest.raises(tw.InputError, match="has no Y"):
        MERGE.axes(tw.place(MERGE._make_slow_servo().spiral(PART, TOOL), PART, TOOL))
