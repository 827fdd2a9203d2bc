"""Outlines: exact distances, and a path that is that of the whole disc wherever it forms the part."""

import threading
from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from turnwright.placing import contact
from turnwright.progress import THREADS

MIRROR = tw.Outline(rectangle=(40.0, 20.0), centre=(40.0, 0.0))
TOOL = tw.Tool(nose_radius=0.5, included=np.deg2rad(90), clearance=np.deg2rad(10))
SHAPES = [
    MIRROR,
    tw.Outline(rectangle=(10.0, 6.0), centre=(3.0, 2.0), angle=0.4, holes=(tw.Outline(disc=1.0, centre=(3.0, 2.0)),)),
    tw.Outline(polygon=((-10, -8), (12, -5), (9, 9), (1, 2), (-7, 10))),
    tw.Outline(annulus=(10.0, 4.0), centre=(3.0, 1.0)),
]


@pytest.mark.parametrize("outline", SHAPES, ids=lambda one: one.words[:12])
def test_the_distance_is_that_of_the_nearest_point_of_the_border(outline):
    border = np.stack(outline.border(200_000))
    x, y = np.random.default_rng(1).uniform(-15, 65, (2, 80))
    brute = np.array([np.hypot(*(border - np.array([[a], [b]]))).min() for a, b in zip(x, y, strict=True)])
    np.testing.assert_allclose(np.abs(outline.distance(x, y)), brute, atol=1e-5)


def test_the_distance_in_closed_form():
    x, y = np.array([40.0, 62.0, 63.0, 40.0]), np.array([0.0, 0.0, 14.0, 9.0])
    np.testing.assert_allclose(MIRROR.distance(x, y), [-10.0, 2.0, 5.0, -1.0], atol=1e-12)
    assert MIRROR.reach == pytest.approx(np.hypot(60, 10), abs=1e-12)
    assert MIRROR.nearest == 20.0


@pytest.mark.parametrize(
    "shape",
    [
        {}, {"disc": 1.0, "rectangle": (1.0, 2.0)}, {"annulus": (1.0, 2.0)},
        {"polygon": ((0, 0), (1, 1), (1, 0), (0, 1))},
        {"disc": 3.0, "holes": (tw.Outline(disc=1.0, centre=(2.5, 0.0)),)},
    ],
)  # fmt: skip
def test_wrong_outlines_are_refused(shape):
    with pytest.raises(tw.InputError):
        tw.Outline(**shape)


def test_a_part_has_a_radius_or_an_outline_in_the_domain():
    with pytest.raises(tw.InputError, match="radius"):
        tw.Part(surface=tw.Plane(), radius=5.0, outline=MIRROR)
    with pytest.raises(tw.InputError, match="outline"):
        tw.Part(surface=tw.Sphere(radius=50.0), outline=MIRROR)


def cut(outline, surface, machine, **how):
    """Return the motions over an outline and over the whole disc, on the same spiral."""
    part = tw.Part(surface=surface, outline=outline, stock=0.01)
    servo = tw.SlowToolServo(**{"feed": 0.05, "spindle_rpm": 20, "points_per_rev": 360, **how})
    spiral = servo.spiral(part, TOOL)
    disc = tw.Part(surface=surface, radius=part.reach, stock=0.01)
    return (tw.drive(tw.place(spiral, one, TOOL), servo, machine) for one in (part, disc))


@pytest.mark.parametrize(("outline", "interpolation"), every_second(SHAPES[1:3], ["linear", "hermite", "cubic spline"]))
def test_the_surface_is_that_of_the_whole_disc_within_the_limits(outline, interpolation):
    machine = tw.Machine.load("nanotech-350fg")
    machine = replace(machine, controller=tw.Controller(interpolation=interpolation))
    surface = tw.Toroid(radius_x=300.0, radius_y=-500.0)
    motion, whole = cut(outline, surface, machine)
    assert tw.check_limits(motion, machine).ok
    x, y = np.random.default_rng(0).uniform(-13, 13, (2, 4000))
    on = outline.covers(x, y)
    made, disc = (tw.generate_points(one, TOOL, x=x[on], y=y[on]) for one in (motion, whole))
    np.testing.assert_allclose(made, disc, atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("surface", "slopes", "points_per_rev"),
    [
        (tw.Toroid(radius_x=300.0, radius_y=-500.0), True, 360),
        (tw.Sphere(radius=-400.0), False, 360),
        pytest.param(tw.Toroid(radius_x=300.0, radius_y=-500.0), True, 720, marks=pytest.mark.proof),
        pytest.param(tw.Sphere(radius=-400.0), False, 720, marks=pytest.mark.proof),
    ],
)
def test_far_from_the_axis_only_the_rounding_of_c_differs(surface, slopes, points_per_rev):
    """C of thousands of rad has steps of 2^-40 rad; an azimuth is off by up to two, times the slope around the axis."""
    motion, whole = cut(MIRROR, surface, tw.Machine.load("nanotech-350fg"), points_per_rev=points_per_rev)
    x, y = np.random.default_rng(0).uniform((20.0, -10.0), (60.0, 10.0), (3_000, 2)).T
    made, disc = (tw.generate_points(one, TOOL, x=x, y=y) for one in (motion, whole))
    zx, zy = surface.gradient(x, y)
    around = np.abs(x * zy - y * zx).max()  # dz/dC [mm/rad]
    assert (around > 1) == slopes
    largest = float(np.abs(motion.axes["C"]).max())
    assert 4096 < largest < 8192
    assert np.spacing(largest) == 2.0**-40
    assert np.abs(made - disc).max() <= 2 * np.spacing(largest) * around + 1e-14


def test_an_off_axis_mirror_takes_less_than_60_percent_of_the_time_of_its_disc():
    machine = tw.Machine.load("nanotech-350fg")
    motion, whole = cut(MIRROR, tw.Conic(radius=200.0, conic=-1.0), machine)
    assert np.ptp(motion.time) < 0.6 * np.ptp(whole.time)
    assert tw.check_limits(motion, machine).ok


@pytest.mark.parametrize(("name", "rpm"), every_second(["generic", "nanoform"], [20.0, 60.0, None]))
def test_a_convex_mirror_takes_less_than_60_percent_of_the_time_at_any_speed(name, rpm):
    machine, servo = tw.Machine.load(name), tw.SlowToolServo(feed=0.1, spindle_rpm=rpm, points_per_rev=360)
    surface = tw.Sphere(radius=-400.0)
    part = tw.Part(surface=surface, outline=MIRROR, stock=0.01)
    disc = tw.Part(surface=surface, radius=part.reach, stock=0.01)
    motion, whole = (tw.drive(tw.place(servo.spiral(one, TOOL), one, TOOL), servo, machine) for one in (part, disc))
    assert np.ptp(motion.time) < 0.6 * np.ptp(whole.time)
    assert tw.check_limits(motion, machine).ok


@pytest.mark.parametrize(
    ("outline", "rpm", "points"),
    [
        (tw.Outline(polygon=((0, 0), (12, 0), (12, 4), (4, 4), (4, 12), (0, 12)), centre=(0.0, 0.0)), 150.0, 200),
        (tw.Outline(polygon=tuple((r * np.cos(a) + 4, r * np.sin(a) - 5) for r, a in zip(
            np.tile([8.0, 3.0], 5), np.linspace(0, 2 * np.pi, 10, endpoint=False), strict=True))), 60.0, 200),
        (tw.Outline(rectangle=(8.0, 5.0), centre=(9.0, -12.0), angle=0.5), 150.0, 360),
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    ("surface", "along"),
    every_second([tw.Sphere(radius=100.0), tw.SineGrid(amplitude=(0.002, 0.002), period=(6.0, 6.0))], ["z", "normal"]),
)
def test_crossings_keep_the_limits_and_end_smoothly(outline, rpm, points, surface, along):
    machine = tw.Machine.load("nanoform")
    motion, _ = cut(outline, surface, machine, feed=0.1, spindle_rpm=rpm, points_per_rev=points, along=along)
    assert tw.check_limits(motion, machine).ok
    # An oracle of its own: second differences of Z, with the limit of the machine in mm/s².
    speed = np.diff(motion.axes["Z"]) / np.diff(motion.time)
    assert np.abs(np.diff(speed) / (motion.time[2:] - motion.time[:-2]) * 2).max() < 1.001 * 1000


def test_spindle_mode_needs_the_ring_around_an_outline():
    machine, outline = tw.Machine.load("nanoform"), tw.Outline(rectangle=(6.0, 3.0), centre=(8.0, 1.0), angle=0.3)
    surface = tw.Sphere(radius=100.0)
    part, servo = tw.Part(surface=surface, outline=outline), tw.Turning(feed=0.1, spindle_rpm=500, chord=1e-4)
    with pytest.raises(tw.InputError, match="target"):
        tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, machine)
    ring = servo.target(part)
    motion = tw.drive(tw.place(servo.spiral(ring, TOOL), ring, TOOL), servo, machine)
    x, y = np.random.default_rng(0).uniform(-11, 11, (2, 4000))
    on = outline.covers(x, y)
    assert (tw.generate_points(motion, TOOL, x=x[on], y=y[on]) - surface.sag(x[on], y[on])).min() > -1e-4


def test_a_chunk_without_a_unique_tangent_is_never_taken_for_one_that_has(monkeypatch):
    # The second chunk fails while the first is still at work; then the search must be used.
    monkeypatch.setenv(THREADS, "2")
    failed = threading.Event()

    def find(_contact, _limit, tips, out):
        if tips.radius[0] == 1.0:
            failed.wait(5)
            return True
        out.z[:] = np.nan
        failed.set()
        return False

    monkeypatch.setattr(contact, "find_tangents", find)
    radius = np.where(np.arange(2 * contact.CHUNK) < contact.CHUNK, 1.0, 2.0)
    angle = np.linspace(0, 6.0, radius.size)
    made = tw.placing.tip_height(tw.Plane(), TOOL, angle=angle, radius=radius, sense=1, rim=3.0)
    np.testing.assert_allclose(made, 0.0, atol=1e-12)
