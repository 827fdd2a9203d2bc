"""The spiral against its own definition, its arc length by quadrature, and the chord by a dense independent check."""

import mpmath
import numpy as np
import pytest

from turnwright.errors import GougeError
from turnwright.generation import generate_polar
from turnwright.machine import Machine
from turnwright.motion import drive
from turnwright.part import Part
from turnwright.placing import Touch, place
from turnwright.post import read_nc, write_nc
from turnwright.strategy import FastToolServo, SlowToolServo
from turnwright.surface import LensArray, Plane, Sphere, Surface
from turnwright.tool import Tool

TURN = 2 * np.pi


class Tilted(Surface):
    """A cone of one slope plus a tilt and a saddle: enough to steer every case by hand."""

    __slots__ = ("cone", "saddle", "tilt")

    def __init__(self, tilt=0.0, saddle=0.0, cone=0.0):
        self.tilt, self.saddle, self.cone = tilt, saddle, cone

    def evaluate(self, x, y, order):
        r = np.hypot(x, y) + 1e-99
        z = self.tilt * x + self.saddle * (x**2 - y**2) + self.cone * r
        if order == 0:
            return (z,)
        zx, zy = self.tilt + 2 * self.saddle * x + self.cone * x / r, -2 * self.saddle * y + self.cone * y / r
        zxx, zyy = 2 * self.saddle + self.cone * y**2 / r**3, -2 * self.saddle + self.cone * x**2 / r**3
        return (z, zx, zy, zxx, -self.cone * x * y / r**3, zyy)[: (1, 3, 6)[order]]


TOOL = Tool(nose_radius=0.5, included=np.deg2rad(120))


def part(radius=5.0, **surface):
    return Part(surface=Tilted(**surface), radius=radius)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("dx", [0.0, 0.0123, -0.02])
@pytest.mark.parametrize(
    "points",
    [{"points_per_rev": 360}, {"arc_length": 0.05}, {"arc_length": 0.05, "max_step": np.deg2rad(2)}],
)
def test_the_spiral_is_archimedes_own(sense, inside_out, dx, points):
    servo = SlowToolServo(feed=0.0301, sense=sense, inside_out=inside_out, lead_in=0.1, **points)
    tool = Tool(nose_radius=0.5, included=np.deg2rad(120), offset=(dx, 0, 0))
    spiral = servo.spiral(part(), tool)
    angle, radius = spiral.angle, spiral.radius
    assert spiral.sense == sense
    assert angle[0] == 0
    # Radius falls or grows by the feed in each turn, exactly.
    assert np.abs(np.diff(radius) - (1 if inside_out else -1) * 0.0301 * np.abs(np.diff(angle)) / TURN).max() < 2e-14
    centre, rim = (radius[0], radius[-1]) if inside_out else (radius[-1], radius[0])
    assert centre == pytest.approx(-dx, abs=1e-14)
    # The rim is reached, and exceeded by less than one step.
    outer = np.abs(np.diff(radius))[-1 if inside_out else 0]
    assert 5.1 - 1e-9 <= rim < 5.1 + outer


def test_constant_angle_repeats_its_azimuths_in_every_turn():
    spiral = SlowToolServo(feed=0.01, points_per_rev=1200, lead_in=0.0).spiral(part(), TOOL)
    k = np.arange(spiral.angle.size)
    assert spiral.angle.size == 500 * 1200 + 1
    exact = [float(mpmath.mpf(int(i)) * 2 * mpmath.pi / 1200) for i in k[::9973]]
    assert np.abs(spiral.angle[::9973] - exact).max() <= np.spacing(spiral.angle[-1])
    azimuth = np.exp(1j * spiral.angle[:-1].reshape(500, 1200))
    assert np.abs(azimuth - azimuth[0]).max() < 2e-12
    assert spiral.radius[0] == pytest.approx(5, abs=1e-12)


@pytest.mark.parametrize("dx", [0.0, 0.0123, -0.02])
@pytest.mark.parametrize("max_step", [None, np.deg2rad(1.0)])
def test_arcs_are_equal_by_quadrature(dx, max_step):
    servo = SlowToolServo(feed=0.04, arc_length=0.03, max_step=max_step)
    tool = Tool(nose_radius=0.5, included=np.deg2rad(120), offset=(dx, 0, 0))
    spiral = servo.spiral(part(radius=3.0), tool)
    pitch = 0.04 / TURN
    psi = spiral.radius / pitch
    step = np.diff(spiral.angle)
    # Oracle: the length of r = pitch * psi by 20-point Gauss quadrature over each piece.
    node, weight = np.polynomial.legendre.leggauss(20)
    middle, half = (psi[1:] + psi[:-1]) / 2, (psi[:-1] - psi[1:]) / 2
    part_half = half / 8
    starts = middle - half + part_half * (2 * np.arange(8)[:, None] + 1)
    at = starts + part_half * node[:, None, None]
    length = part_half * np.einsum("q,qpn->n", weight, np.hypot(pitch, pitch * at))
    if max_step is None:
        assert np.abs(length / 0.03 - 1).max() < 1e-9
    else:
        inside = np.abs(step - max_step) < 1e-10
        assert inside[-1]
        assert not inside[0]
        assert np.abs(length[~inside] / 0.03 - 1).max() < 1e-9
        assert length[inside].max() < 0.03 * (1 + 1e-4)  # the last one may straddle the border
        assert step.max() < max_step * (1 + 1e-9)
        border = 0.03 / max_step
        assert spiral.radius[1:][inside].max() == pytest.approx(border, abs=0.04 / 180)


@pytest.mark.parametrize(
    ("surface", "dx", "needed"),
    [
        ({"cone": -0.3}, 0.0, 0.5 * np.sin(np.arctan(0.3))),  # the rim falls all around: touched inside the tip
        ({"cone": 0.3}, 0.0, 0.0),  # it rises: touched outside
        ({"tilt": 0.2}, 0.0, 0.5 * np.sin(np.arctan(0.2))),
        ({"cone": -0.3}, 0.01, 0.5 * np.sin(np.arctan(0.3)) - 0.01),  # a tip set too far out starts nearer
        ({"cone": -5.0}, 0.0, 0.5 * np.sin(np.deg2rad(60))),  # no further than the end of the arc
    ],
)
def test_the_lead_in_reaches_the_rim(surface, dx, needed):
    tool = Tool(nose_radius=0.5, included=np.deg2rad(120), offset=(dx, 0, 0))
    servo = SlowToolServo(feed=0.01, points_per_rev=100)
    start = servo.spiral(part(**surface), tool).radius[0]
    assert start == pytest.approx(5 + needed + 0.005, abs=1.1e-4)  # and half a feed for the rim's last cusp
    if needed > 0.02:
        with pytest.raises(GougeError, match="a band would stay uncut"):
            SlowToolServo(feed=0.01, points_per_rev=100, lead_in=needed - 0.011).spiral(part(**surface), tool)


@pytest.mark.parametrize("radius", [-30.0, 30.0])
def test_last_cusp_inside_the_rim_is_no_higher_than_the_others(radius):
    shape, nose, feed = Part(surface=Sphere(radius=radius), radius=1.0), 0.5, 0.02
    tool, machine = Tool(nose_radius=nose, included=np.deg2rad(120)), Machine.load("generic")
    servo = SlowToolServo(feed=feed, points_per_rev=360, spindle_rpm=1.0)
    motion = drive(place(servo.spiral(shape, tool), shape, tool), servo, machine)
    rim = generate_polar(motion, tool, radius=np.linspace(0.95, 1.0, 2001), angle=np.linspace(0, 2 * np.pi, 90))
    # Scallop on a curved profile in closed form; half of a degree of chord and slope add a little.
    assert rim.minus(shape.surface).z.max() < 1.01 * feed**2 / (8 * nose * (1 - nose / radius))


@pytest.mark.parametrize(("along", "curve"), [("z", 1), ("normal", 1), ("z", -1)])
@pytest.mark.parametrize("points", [{"points_per_rev": 360}, {"points_per_rev": 360, "inside_out": True, "sense": -1}])
def test_a_quarter_feed_of_overrun_levels_the_cusp_on_the_axis(tmp_path, points, along, curve):
    shape, nose, feed = Part(surface=Sphere(radius=curve * 30.0), radius=0.2), 0.5, 0.02
    tool, machine = Tool(nose_radius=nose, included=np.deg2rad(120)), Machine.load("generic")
    # Oracle: a gap g leaves g² / 8R(1 - R/r) placed along z and g²/8 (1/R - 1/r) along the normal, and the innermost
    # passes stand up to 1.5 feeds apart.
    straight = 1 - curve * nose / 30.0
    usual = feed**2 / (8 * nose) * (straight if along == "normal" else 1 / straight)
    for overrun, least, most in ((0.0, 2.2, 2.26), (0.25, 0.99, 1.01), (0.5, 0.99, 1.01)):
        servo = SlowToolServo(feed=feed, overrun=overrun * feed, spindle_rpm=1.0, **points)
        spiral = servo.spiral(shape, tool)
        assert spiral.radius.min() == pytest.approx(-overrun * feed, abs=1e-14)
        motion = drive(place(spiral, shape, tool, along=along), servo, machine)
        # The commanded, not the nominal path: a program with negative X.
        write_nc(motion, machine, tmp_path / "part.nc")
        motion = read_nc(tmp_path / "part.nc", machine)
        near = generate_polar(motion, tool, radius=np.linspace(0, 0.1, 2001), angle=np.linspace(0, TURN, 181)[:-1])
        assert least * usual < near.minus(shape.surface).z.max() < most * usual


def sharp(monkeypatch):
    """Let the tip follow the surface itself, so that the path has a closed form; return the azimuths asked for."""
    asked = []

    def touch_down(surface, edge, tips, rim):
        asked.append(tips.angle)
        z = surface.sag(tips.radius * np.cos(tips.angle), tips.radius * np.sin(tips.angle))
        return Touch(z, *np.zeros((4, z.size)))

    monkeypatch.setattr("turnwright.strategy.slow.touch_down", touch_down)
    return asked


def worst(spiral, surface):
    """Return the largest error of straight lines between the points, looked at 60 times in each. [mm]"""
    share = np.linspace(0, 1, 61)[:, None]
    angle = spiral.angle[:-1] + share * np.diff(spiral.angle)
    radius = spiral.radius[:-1] + share * np.diff(spiral.radius)
    exact = surface.sag(radius * np.cos(angle), radius * np.sin(angle))
    return np.abs(exact - (exact[0] + share * (exact[-1] - exact[0]))).max(axis=0)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("chord", [1e-4, 3e-6])
def test_chord_is_kept_with_about_the_fewest_points(monkeypatch, sense, inside_out, chord):
    sharp(monkeypatch)
    surface = Tilted(tilt=0.05, saddle=0.004)
    servo = SlowToolServo(feed=0.05, chord=chord, sense=sense, inside_out=inside_out, lead_in=0.05)
    spiral = servo.spiral(Part(surface=surface, radius=2.0), TOOL)
    error = worst(spiral, surface)
    assert error.max() <= chord * (1 + 1e-9)
    assert np.abs(np.diff(spiral.angle)).max() <= np.deg2rad(30) * (1 + 1e-6)
    # Oracle: the fewest points of small segments with ends on the curve is the integral of sqrt(|z''| / 8 e).
    tau = np.linspace(0, spiral.turns * TURN, 400_001)
    rho = 0.05 / TURN * tau
    z2 = np.gradient(np.gradient(0.05 * rho * np.cos(tau) + 0.004 * rho**2 * np.cos(2 * tau), tau), tau)
    floor = np.trapezoid(np.sqrt(np.abs(z2) / (8 * chord)), tau)
    capped = np.trapezoid(np.maximum(np.sqrt(np.abs(z2) / (8 * chord)), 1 / np.deg2rad(30)), tau)
    points = spiral.angle.size - 1
    assert 0.99 * floor < points < 1.06 * capped


def test_no_short_step_is_left_at_the_end(monkeypatch):
    sharp(monkeypatch)
    surface = Tilted(tilt=0.05, saddle=0.004)
    for chord in (1e-4, 7e-6, 1.3e-6):
        spiral = SlowToolServo(feed=0.05, chord=chord, lead_in=0.05).spiral(Part(surface=surface, radius=2.0), TOOL)
        steps = np.abs(np.diff(spiral.angle))
        assert steps[0] > 0.3 * steps[1:9].mean()
        assert steps[-1] > 0.3 * steps[-9:-1].mean()


def test_chord_on_a_plane_needs_only_the_largest_step(monkeypatch):
    sharp(monkeypatch)
    for step, expected in ((None, 12), (np.deg2rad(10), 36)):
        servo = SlowToolServo(feed=0.1, chord=1e-5, max_step=step, lead_in=0.0)
        assert servo.spiral(part(radius=1.0), TOOL).angle.size == 10 * expected + 1


class Roof(Tilted):
    """A sharp valley along y = 0.3 mm."""

    def evaluate(self, x, y, order):
        z = 0.3 * np.abs(y - 0.3)
        zero = np.zeros_like(x)
        return (z, zero, 0.3 * np.sign(y - 0.3))[: order * 2 + 1] if order else (z,)


def test_chord_is_kept_across_creases(monkeypatch):
    sharp(monkeypatch)
    surface = Roof()
    servo = SlowToolServo(feed=0.1, chord=1e-5)
    spiral = servo.spiral(Part(surface=surface, radius=1.0), TOOL)
    assert worst(spiral, surface).max() <= 1e-5 * (1 + 1e-9)
    # Two creases a revolution at most cost a few points each above the smooth count.
    tau = np.linspace(0, spiral.turns * TURN, 400_001)
    smooth = np.trapezoid(np.sqrt(0.3 * 0.1 / TURN * tau * np.abs(np.sin(tau)) / 8e-5), tau)
    assert spiral.angle.size < 1.1 * smooth + 12 * 2 * spiral.turns


def test_chord_counts_with_the_tip_of_the_real_edge():
    # Oracle: on a plane of slope t a round nose stands R (sqrt(1 + t² cos²) - 1) above the plane at the tip.
    t, chord = 0.3, 2e-6
    surface = Tilted(tilt=t)
    spiral = SlowToolServo(feed=0.05, chord=chord).spiral(Part(surface=surface, radius=1.0), TOOL)
    share = np.linspace(0, 1, 41)[:, None]
    angle = spiral.angle[:-1] + share * np.diff(spiral.angle)
    radius = spiral.radius[:-1] + share * np.diff(spiral.radius)
    tip = t * radius * np.cos(angle) + 0.5 * (np.hypot(1, t * np.cos(angle)) - 1)
    error = np.abs(tip - (tip[0] + share * (tip[-1] - tip[0]))).max(axis=0)
    assert error.max() <= chord * (1 + 1e-6)
    assert np.median(error) > 0.9 * chord


def test_azimuths_repeat_each_turn_but_near_creases(monkeypatch):
    asked = sharp(monkeypatch)
    surface = Roof()
    spiral = SlowToolServo(feed=0.05, chord=1e-6).spiral(Part(surface=surface, radius=2.0), TOOL)
    scattered = sum(angle.size for angle in asked if np.ptp(np.diff(angle)) > 1e-9)
    # Straight lines would need 12 samples a point to be as certain; a scattered one costs as much as ten others.
    assert scattered < 3 * spiral.angle.size
    assert worst(spiral, surface).max() <= 1e-6 * (1 + 1e-9)


def lens_tip(angle, rho, pitch, radius, nose, rim):
    """Return where a nose stands over a 5 by 5 array of spheres: circle against circle, circle on ridge or rim."""
    cosine, sine, size = np.cos(angle), np.sin(angle), abs(radius)
    side = 1 if radius > 0 else -1
    middles = pitch * np.arange(-2, 3)

    def nearest(x):
        return pitch * np.clip(np.rint(x / pitch), -2, 2)

    def reach(x, y, s):
        height = radius - side * np.sqrt(size**2 - (x - nearest(x)) ** 2 - (y - nearest(y)) ** 2)
        return np.where(np.abs(s) <= rim, height - (nose - np.sqrt(nose**2 - (s - rho) ** 2)), np.nan)

    best = np.full(angle.size, -np.inf)
    with np.errstate(invalid="ignore", divide="ignore"):
        for cx, cy in np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2):
            along, across = cx * cosine + cy * sine, cy * cosine - cx * sine
            section = np.sqrt(size**2 - across**2)
            z = radius - side * np.sqrt((section - side * nose) ** 2 - (rho - along) ** 2) - nose
            s = along + (rho - along) * section / (section - side * nose)
            mine = (nearest(s * cosine) == cx) & (nearest(s * sine) == cy)
            best = np.fmax(best, np.where(mine & (np.abs(s) <= rim), z, np.nan))
        for border in middles[1:] - pitch / 2:
            s = border / cosine
            best = np.fmax(best, reach(border, s * sine, s))
            s = border / sine
            best = np.fmax(best, reach(s * cosine, border, s))
        for s in (rim, -rim):
            best = np.fmax(best, reach(s * cosine, s * sine, s))
    return best


@pytest.mark.parametrize(("radius", "chord"), [(-1.5, 1e-5), (-1.5, 1e-6), (1.5, 1e-5)])
def test_chord_is_kept_over_the_valleys_and_ridges_of_lenses(radius, chord):
    pitch, nose = 0.5, 0.5
    surface = LensArray.square(pitch=pitch, rows=5, columns=5, lenslet=Sphere(radius=radius))
    servo = SlowToolServo(feed=0.1, chord=chord, lead_in=0.05)
    spiral = servo.spiral(Part(surface=surface, radius=0.6), Tool(nose_radius=nose, included=np.deg2rad(120)))
    share = np.linspace(0, 1, 31)[:, None]
    angle = spiral.angle[:-1] + share * np.diff(spiral.angle)
    rho = spiral.radius[:-1] + share * np.diff(spiral.radius)
    tip = lens_tip(angle.ravel(), rho.ravel(), pitch, radius, nose, spiral.radius.max()).reshape(angle.shape)
    error = np.abs(tip - (tip[0] + share * (tip[-1] - tip[0]))).max(axis=0)
    assert 0.9 * chord < error.max() <= chord
    assert np.median(error) > 0.7 * chord


def test_chord_ignores_a_wall_outside_the_rim():
    """A flat of 2 mm with a wall of 1 mm under the overhang of the nose: the path itself is flat."""
    walled = LensArray(centres=[[0, 0]], lenslet=Plane(), aperture=2.05, surround=1.0)
    tool = Tool(nose_radius=0.5, included=np.deg2rad(60))
    servo = SlowToolServo(feed=0.1, chord=1e-6, lead_in=0.0)
    one, other = (servo.spiral(Part(surface=surface, radius=2.0), tool) for surface in (walled, Plane()))
    np.testing.assert_allclose(one.angle, other.angle, atol=1e-12)


@pytest.mark.parametrize(
    "servo",
    [
        SlowToolServo(feed=0.021, points_per_rev=360),
        SlowToolServo(feed=0.021, points_per_rev=77, sense=-1, lead_in=0.1, overrun=0.005),
        SlowToolServo(feed=0.021, points_per_rev=90, inside_out=True),
        SlowToolServo(feed=0.021, arc_length=0.05, max_step=0.3),
        FastToolServo(plan=SlowToolServo(feed=0.021, points_per_rev=90)),
    ],
)
def test_the_extent_is_that_of_the_whole_spiral(servo):
    """Oracle: the spiral with all its points, by brute force."""
    part = Part(surface=Sphere(radius=40.0), radius=1.0)
    tool = Tool(nose_radius=0.5, included=1.0, offset=(0.003, 0.0, 0.0))
    whole = servo.spiral(part, tool)
    size, some = servo.extent(part, tool)
    assert size == whole.angle.size
    assert (some.turns, some.feed, some.sense) == (whole.turns, whole.feed, whole.sense)
    outer = 0 if whole.radius[0] > whole.radius[-1] else -1
    turn = np.flatnonzero(np.abs(whole.angle - whole.angle[outer]) < 2 * np.pi * (1 + 1e-12))
    for one, all_of_it in ((some.angle, whole.angle), (some.radius, whole.radius)):
        np.testing.assert_array_equal(one[1:] if outer else one[:-1], all_of_it[turn])
        assert one[-1 - outer] == all_of_it[-1 - outer]
