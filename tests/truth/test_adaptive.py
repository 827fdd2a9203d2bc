"""Adaptive steps and points: dense simulation of the program itself, and circle geometry. No planner inside."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import cusp_oracle
from cases import every_second
from turnwright import (
    AdaptiveToolServo,
    Axis,
    Controller,
    FastToolServo,
    LensArray,
    Machine,
    Motion,
    Part,
    Plane,
    SineGrid,
    Sphere,
    Spiral,
    Tool,
    Toroid,
    drive,
    generate_polar,
    place,
    read_nc,
    write_nc,
)
from turnwright.strategy import adaptive
from turnwright.surface import Surface

TURN = 2 * np.pi
TOOL = Tool(nose_radius=0.1)
GRID = Part(surface=SineGrid(amplitude=(0.005, 0.005), period=(0.2, 0.2)), radius=0.3)
MACHINE = Machine.load("generic")
SCALLOP = 50e-6
WAYS = [
    {"interpolation": "hermite"},
    {"interpolation": "linear"},
    {"interpolation": "linear", "off_path": False},
    {"interpolation": "hermite", "x_motion": "steady"},
]


def followed(servo, part, tool=TOOL, each=16):
    """Return angle, radius and height that the controller makes of the points, and the exact height at that radius."""
    spiral = servo.spiral(part, tool)
    path = place(spiral, part, tool)
    angle = (path.angle[:-1, None] + np.diff(path.angle)[:, None] * np.arange(each) / each).ravel()
    if servo.interpolation == "hermite":
        order = slice(None, None, path.sense)
        ahead = [values[order] for values in (path.angle, path.z, path.z_rate, path.radius, path.radius_rate)]
        z, radius = CubicHermiteSpline(*ahead[:3])(angle), CubicHermiteSpline(ahead[0], *ahead[3:])(angle)
    else:
        axes = servo.axes(path)
        z, radius = (np.interp(path.sense * angle, path.sense * axes["C"], axes[k]) for k in "ZX")
    exact = place(Spiral(angle=angle, radius=radius), part, tool).z
    return path, angle, radius, z, exact


def left(angle, radius, z, part, *, low, high, tool=TOOL, azimuths=24, samples=12001):
    """Return the error of the surface that a motion leaves. (azimuths, samples)"""
    motion = Motion(time=np.abs(angle - angle[0]), axes={"C": angle, "X": radius, "Z": z}, machine=MACHINE)
    rings, rays = np.linspace(low, high, samples), np.linspace(0, TURN, azimuths, endpoint=False)
    return generate_polar(motion, tool, radius=rings, angle=rays).minus(part.surface).z


def crests(error):
    """Return the heights of the local maxima along the rays, the parabola through three samples at each."""
    inner, middle, outer = error[:, :-2], error[:, 1:-1], error[:, 2:]
    return middle[(middle > inner) & (middle >= outer)]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("chord", [10e-6, 1e-6])
def test_the_controller_keeps_within_the_chord_of_the_exact_path(way, chord):
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=chord, **way)
    _, _, _, z, exact = followed(servo, GRID)
    worst = np.abs(z - exact).max()
    assert 0.9 * chord < worst <= chord  # and it uses the chord, so the points are no closer than they need be


@pytest.mark.parametrize(("sense", "inside_out"), [pytest.param(1, False, marks=pytest.mark.proof), (-1, True)])
def test_either_way_round_is_within_the_chord(sense, inside_out):
    tool = Tool(nose_radius=0.1, rake=np.deg2rad(-15), waviness=(0.0, 2e-5), offset=(0.003, 0.002, 0.001))
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=5e-6, interpolation="hermite", inside_out=inside_out, sense=sense)
    path, _, _, z, exact = followed(servo, replace(GRID, radius=0.15), tool)
    assert path.sense == sense
    assert (path.radius[0] < path.radius[-1]) == inside_out
    assert path.radius.min() == pytest.approx(-0.003, abs=1e-12)
    assert np.abs(z - exact).max() <= 5e-6


SURFACES = {"grid": GRID.surface, "sphere": Sphere(radius=0.5), "plane": Plane()}


@pytest.mark.parametrize(("name", "way"), every_second(SURFACES, range(3)))
def test_every_cusp_is_as_high_as_the_scallop(name, way):
    part = Part(surface=SURFACES[name], radius=0.3)
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, **WAYS[way])
    # Straight lines between as many samples follow the cubics to less than a thousandth of the scallop.
    _, angle, radius, _, exact = followed(servo, part, each=100)
    # Where the tip is within its first two turns the edge touches up to 0.03 mm from the axis.
    high = crests(left(angle, radius, exact, part, low=0.05, high=0.299, azimuths=12, samples=40001)) / SCALLOP
    assert high.size > 12 * 30
    assert high.min() > 0.98
    assert high.max() < 1.005
    # Nothing is higher anywhere, the axis and the rim included.
    assert left(angle, radius, exact, part, low=0.0, high=0.3).max() < 1.005 * SCALLOP


def test_the_program_itself_leaves_scallop_and_chord():
    for way in WAYS:
        servo = AdaptiveToolServo(scallop=SCALLOP, chord=1e-6, **way)
        _, angle, radius, z, _ = followed(servo, GRID, each=100)
        error = left(angle, radius, z, GRID, low=0.0, high=0.3, samples=6001)
        assert error.max() < 1.005 * SCALLOP + 1.02e-6
        assert error.min() > -1.02e-6


def test_on_a_flat_the_turns_stand_as_circle_geometry_has_it():
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=1e-6, interpolation="hermite", inside_out=True)
    spiral = servo.spiral(Part(surface=Plane(), radius=0.3), TOOL)
    aim = 0.9925 * SCALLOP
    radius = CubicHermiteSpline(spiral.angle, spiral.radius, spiral.radius_rate)
    turn = np.arange(1, 40) * TURN + 1.0
    assert np.abs(np.diff(radius(turn)) - 2 * np.sqrt(2 * 0.1 * aim - aim**2)).max() < 1e-8
    # The tip rests on the axis, and takes up its advance within half a turn.
    assert spiral.radius[0] == spiral.radius_rate[0] == 0


def test_the_radius_is_smooth_over_the_seam():
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=1e-7, interpolation="hermite", inside_out=True)
    spiral = servo.spiral(GRID, TOOL)
    # Quotients of the rate over shorter and shorter steps about any point approach one value from either side.
    rate = CubicHermiteSpline(spiral.angle, spiral.radius, spiral.radius_rate).derivative()
    at = np.concatenate([TURN * np.arange(1, 45), TURN * (np.arange(1, 45) + 0.5)])
    jumps = [np.abs(rate(at + h) - 2 * rate(at) + rate(at - h)).max() / h for h in (0.04, 0.02)]
    assert jumps[1] < 0.6 * jumps[0]  # it goes with h, a discontinuity of the rate would stay


def test_a_steady_feed_is_the_largest_that_keeps_the_scallop():
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=1e-6, interpolation="hermite", x_motion="steady")
    _, angle, radius, _, exact = followed(servo, GRID, each=100)
    high = crests(left(angle, radius, exact, GRID, low=0.05, high=0.299, azimuths=720)) / SCALLOP
    assert 0.995 < high.max() < 1.002
    feed = np.diff(radius) / np.diff(angle) * TURN
    assert np.ptp(feed[radius[1:] > 0.02]) < 1e-8


@pytest.mark.parametrize("x_motion", [pytest.param("servo", marks=pytest.mark.proof), "steady"])
def test_a_march_from_the_axis_after_a_look_at_the_rim(monkeypatch, x_motion):
    """On every lenslet the largest feed is that of a sphere, sqrt(8 R h (1 - R / bend)); R large against its cusps."""
    monkeypatch.setattr(
        adaptive, "BLOCK_SAMPLES", 1 << 14
    )  # so that heights outside take the place of those at the axis
    part = Part(surface=LensArray.hexagonal(pitch=0.3, lenslet=Sphere(radius=8.0), rings=3), radius=0.4)
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, interpolation="linear", x_motion=x_motion)
    spiral = servo.spiral(part, TOOL)
    aim = SCALLOP * (1 if x_motion == "steady" else 0.9925)
    step = np.sqrt(8 * 0.1 * aim * (1 - 0.1 / 8.0))
    at = spiral.angle[-1] - np.arange(2.0, 55.0, 0.05) * TURN
    assert -np.diff(np.interp(at, spiral.angle, spiral.radius)[::-1][::20]) == pytest.approx(step, rel=5e-3)
    assert abs(spiral.radius.max() - part.radius) < 4 * step


def test_a_steady_feed_over_lenses_on_a_torus():
    surface = Toroid(radius_x=40, radius_y=60) + LensArray.square(
        lenslet=Sphere(radius=2.0), pitch=0.5, rows=7, columns=7
    )
    part, tool = Part(surface=surface, radius=0.9), Tool(nose_radius=0.2, included=np.deg2rad(120))
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=SCALLOP, interpolation="linear", x_motion="steady")
    # The largest feed on a slope s of curvature k is sqrt(8 R h (1 - R k) cos(s)^3): least at the rim of a lens.
    least = np.sqrt(8 * 0.2 * SCALLOP * (1 - 0.2 * (1 / 2.0 + 1 / 40)) * np.cos(0.18 + 0.9 / 40) ** 3)
    assert least < servo.spiral(part, tool).feed < np.sqrt(8 * 0.2 * SCALLOP * (1 - 0.2 / 2.0))


class Island(Surface):
    """Flat but for a smooth-edged square of bumps: the curvature jumps at its border, the slope does not."""

    def evaluate(self, x, y, order):
        a, k = 0.0003, 2 * np.pi / 0.05
        there = np.where((np.abs(x - 0.1625) < 0.1) & (np.abs(y - 0.1125) < 0.1), a / 2, 0.0)
        cx, sx, cy, sy = (
            np.cos(k * (x - 0.0625)),
            np.sin(k * (x - 0.0625)),
            np.cos(k * (y - 0.0125)),
            np.sin(k * (y - 0.0125)),
        )
        jet = [(1 - cx) * (1 - cy), k * sx * (1 - cy), k * (1 - cx) * sy]
        jet += [k * k * cx * (1 - cy), k * k * sx * sy, k * k * (1 - cx) * cy]
        return tuple(there * part for part in jet[: (1, 3, 6)[order]])

    @property
    def feature_size(self):
        return 0.05 / 8


@pytest.mark.parametrize("way", [WAYS[0], pytest.param(WAYS[1], marks=pytest.mark.proof)])
def test_where_the_density_changes_nothing_is_gouged(way):
    part = Part(surface=Island(), radius=0.3)
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=2e-6, **way)
    path, angle, radius, z, exact = followed(servo, part)
    x, y = path.radius * np.cos(path.angle), path.radius * np.sin(path.angle)
    flat = (np.hypot(x, y) > 0.1) & (np.maximum(np.abs(x - 0.1625), np.abs(y - 0.1125)) > 0.15) & (path.radius < 0.3)
    bumpy = np.maximum(np.abs(x - 0.1625), np.abs(y - 0.1125)) < 0.08
    step = np.append(np.abs(np.diff(path.angle)) * path.radius[1:], 1.0)
    assert np.median(step[flat]) > 4 * np.median(step[bumpy])  # the density does change
    assert np.abs(z - exact).max() <= 2e-6
    error = left(angle, radius, z, part, low=0.0, high=0.3, azimuths=48, samples=3001)
    assert error.min() > -2.1e-6
    assert left(angle, radius, exact, part, low=0.0, high=0.3, azimuths=48, samples=6001).max() < 1.01 * SCALLOP


def test_points_off_the_path_save_nearly_a_factor_of_root_two():
    counts = [
        AdaptiveToolServo(scallop=SCALLOP, chord=1e-6, interpolation="linear", off_path=off, x_motion="steady")
        .spiral(GRID, TOOL)
        .angle.size
        for off in (False, True)
    ]
    assert 1.36 < counts[0] / counts[1] < 1.46


def test_a_split_motion_recombines_and_x_is_steady():
    machine = MACHINE
    for interpolation in ("linear", "hermite"):
        whole = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, interpolation=interpolation)
        split = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, interpolation=interpolation, x_motion="split")
        path = place(split.spiral(GRID, TOOL), GRID, TOOL)
        one, two = whole.axes(path), split.axes(path)
        assert np.abs(two["X"] + two["U"] - one["X"]).max() < 1e-15
        slope = np.diff(two["X"]) / np.diff(path.angle)
        assert np.ptp(slope) < 1e-9
        assert two["U"].max() == pytest.approx(-two["U"].min(), rel=1e-9)
        fast = FastToolServo(plan=split).axes(path)
        assert np.abs(fast["Z"] + fast["W"] - one["Z"]).max() < 1e-15
        if interpolation == "hermite":
            rates, both = whole.rates(path), split.rates(path)
            assert np.abs(both["X"] + both["U"] - rates["X"]).max() < 1e-15
            assert np.abs(both["X"] - slope.mean()).max() < 1e-9
    assert drive(path, whole, machine).axes["X"].size == path.z.size


@pytest.mark.parametrize("bend", [pytest.param(-8.0, marks=pytest.mark.proof), 8.0])
def test_the_chord_is_kept_over_creases_of_a_lens_array(bend):
    part = Part(surface=LensArray.hexagonal(pitch=0.3, lenslet=Sphere(radius=bend), rings=3), radius=0.4)
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, interpolation="linear", inside_out=True)
    _, angle, radius, z, exact = followed(servo, part, each=8)
    assert np.abs(z - exact).max() <= 10e-6
    # Every lenslet takes the steps of a sphere, sqrt(8 R h (1 - R / bend)), so that the spiral is Archimedean inside.
    step = np.sqrt(8 * 0.1 * 0.9925 * SCALLOP * (1 - 0.1 / bend))
    at = np.arange(2.0, 55.0, 0.05) * TURN
    assert np.diff(np.interp(at, angle, radius)[::20]) == pytest.approx(step, rel=5e-3)


def test_turns_outside_the_rim_have_no_denser_points():
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, interpolation="linear", inside_out=True)
    spiral = servo.spiral(Part(surface=GRID.surface, radius=0.6), TOOL)
    rate = TURN / np.diff(spiral.angle)
    resting = spiral.angle[1:] > spiral.angle[-1] - 8 * TURN
    inside = (spiral.angle[1:] > spiral.angle[-1] - 16 * TURN) & ~resting
    assert (
        rate[resting].max() < 1.8 * rate[inside].max()
    )  # held as closely as inside it is 3.3 to 3.7 times on parts of 1 to 3 mm


def grid(x, y):
    return 0.005 * (np.sin(10 * np.pi * x) + np.sin(10 * np.pi * y))


def torus(x, y):
    return 12.0 - np.sqrt((12.0 - 8.0 + np.sqrt(64.0 - x * x)) ** 2 - y * y)


FORMULAS = {
    "grid": (grid, GRID),
    "torus": (torus, Part(surface=Toroid(radius_x=8, radius_y=12), radius=0.3)),
}
DIRECTIONS = [*WAYS[:3], {"interpolation": "linear", "inside_out": True, "sense": -1}]


@pytest.mark.parametrize(("name", "number"), every_second(FORMULAS, range(4)))
def test_every_cusp_of_the_program_itself(tmp_path, name, number):
    """Oracle: crossings of the edges of neighbouring turns by bisection, on formulas, over the program read back."""
    (sag, part), way = FORMULAS[name], DIRECTIONS[number]
    linear = way["interpolation"] == "linear"
    lathe = Machine(
        name="lathe", axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=30, block_rate_hz=1e6,
        dialect="generic" if linear else "pmac",
        controller=Controller(interpolation="linear" if linear else "hermite"),
    )  # fmt: skip
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, spindle_rpm=30, **way)
    write_nc(drive(place(servo.spiral(part, TOOL), part, TOOL), servo, lathe), lathe, tmp_path / "part.nc")
    motion = read_nc(tmp_path / "part.nc", lathe)
    c, x = motion.axes["C"], motion.axes["X"]
    axis = c[0] if x[0] < x[-1] else c[-1]
    turned = np.arange(np.ptp(c) / TURN * 211) / 211 * TURN
    angle = axis + (turned if axis < c.mean() else -turned)
    radius, z = cusp_oracle.followed(motion, angle)
    exact = cusp_oracle.tips(sag, TOOL.nose_radius, angle, radius)
    place_of, high = cusp_oracle.cusps(
        sag, TOOL.nose_radius, (radius[:-211], exact[:-211]), (radius[211:], exact[211:]), angle[:-211]
    )
    inside = place_of < part.radius
    kept = inside & (turned[:-211] >= TURN / 2)
    assert kept.sum() > 40 * 211
    assert high[kept].min() > 0.98 * SCALLOP
    assert high[inside].max() < 1.005 * SCALLOP
    # Numbers are written to 1 nm: half of that in Z, and in X by the slope.
    assert np.abs(z - exact).max() < 10e-6 + 0.65e-6


def test_outer_revolutions_need_little_more_jerk_of_x():
    """Oracle: third differences of the radius; with a rest within three steps it was sixty times as much."""
    servo = AdaptiveToolServo(scallop=SCALLOP, chord=1e-7, interpolation="hermite", inside_out=True)
    for radius in (0.6, 1.0):
        spiral = servo.spiral(Part(surface=GRID.surface, radius=radius), TOOL)
        angle = np.arange(2 * TURN, spiral.angle[-1], TURN / 1000)
        jerk = np.abs(np.diff(CubicHermiteSpline(spiral.angle, spiral.radius, spiral.radius_rate)(angle), 3))
        resting = angle[:-3] > spiral.angle[-1] - 10 * TURN
        assert jerk[resting].max() < 2 * jerk[~resting].max()


def test_the_last_turns_over_lenses_are_even():
    part = Part(surface=LensArray.hexagonal(pitch=0.3, lenslet=Sphere(radius=8.0), rings=3), radius=0.4)
    spiral = AdaptiveToolServo(scallop=SCALLOP, chord=10e-6, interpolation="linear", inside_out=True).spiral(part, TOOL)
    at = np.arange(2.0, spiral.angle[-1] / TURN - 0.4, 0.004) * TURN
    steps = np.interp(at[250:], spiral.angle, spiral.radius) - np.interp(at[:-250], spiral.angle, spiral.radius)
    assert np.ptp(steps) < 0.02 * steps.mean()
