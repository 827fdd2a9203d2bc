"""Axes in time against motions whose derivatives have a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from turnwright._arrays import only_read
from turnwright._kernels import spline
from turnwright.machine import Axis, Controller, Machine
from turnwright.motion import check_limits, drive
from turnwright.motion.limits import Course
from turnwright.motion.pvt import slow_to_limits
from turnwright.part import Part
from turnwright.path import Motion, Path
from turnwright.placing import place
from turnwright.strategy import SlowToolServo
from turnwright.surface import Plane
from turnwright.tool import Tool

TURN = 2 * np.pi
FREE = {"C": Axis(), "X": Axis(), "Z": Axis()}
FREE_MACHINE = Machine(name="free", axes=FREE, spindle_rpm=1e9, block_rate_hz=1e12)


def path(angle, radius, z):
    zero = np.zeros_like(angle)
    return Path(
        angle=angle, radius=radius, z=z, sweep=zero, contact_x=zero, contact_y=zero, contact_z=zero, clearance=zero
    )


def wave(*, amplitude=0.2, harmonic=2, turns=10, points=3600, feed=0.01, sense=1):
    """Z = amplitude cos(harmonic * angle): speed, acceleration and jerk are amplitude * (harmonic * omega)^k."""
    angle = sense * np.arange(turns * points + 1) * (TURN / points)
    return path(angle, 5 - feed * np.abs(angle) / TURN, amplitude * np.cos(harmonic * angle))


def servo(rpm=None):
    return SlowToolServo(feed=0.01, points_per_rev=3600, spindle_rpm=rpm)


def test_differences_are_exact_for_cubics_at_any_step():
    # Oracle: derivatives of t^3 - 2 t^2 + 5 t over steps that vary threefold.
    rng = np.random.default_rng(7)
    time = np.cumsum(rng.uniform(0.01, 0.03, 400))
    for position, expected in ((5 * time, (5, 0, 0)), (3 * time**2, (None, 6, 0)), (time**3, (None, None, 6))):
        found = check_limits(
            Motion(time=time, axes={"C": time, "X": time, "Z": position}, machine=FREE_MACHINE), FREE_MACHINE
        )
        values = found.peak_speed["Z"], found.peak_acceleration["Z"], found.peak_jerk["Z"]
        for value, exact in zip(values, expected, strict=True):
            if exact is not None:
                assert value == pytest.approx(exact, rel=1e-6, abs=2e-6)


@pytest.mark.parametrize("sense", [1, -1])
def test_a_wave_has_its_own_peaks(sense):
    motion = drive(wave(sense=sense), servo(50), FREE_MACHINE)
    limits = check_limits(motion, FREE_MACHINE)
    omega = 50 * TURN / 60
    assert limits.cycle_time_s == pytest.approx(12)  # ten turns at 50 rev/min
    assert limits.spindle_rpm == pytest.approx(50)
    assert limits.block_rate_hz == pytest.approx(3000)
    assert limits.peak_speed["C"] == pytest.approx(omega, rel=1e-8)
    assert limits.peak_speed["X"] == pytest.approx(0.01 * 50 / 60, rel=1e-8)
    for peak, power in ((limits.peak_speed, 1), (limits.peak_acceleration, 2), (limits.peak_jerk, 3)):
        assert peak["Z"] == pytest.approx(0.2 * (2 * omega) ** power, rel=5e-6)
    assert limits.travel["Z"] == pytest.approx((-0.2, 0.2))
    assert limits.travel["X"] == pytest.approx((4.9, 5))


@pytest.mark.parametrize(
    ("axis", "binding", "omega"),
    [
        (Axis(speed=1.0), "Z speed", 1.0 / 0.4),
        (Axis(acceleration=2.0), "Z acceleration", np.sqrt(2.0 / 0.8)),
        (Axis(jerk=3.0), "Z jerk", np.cbrt(3.0 / 1.6)),
    ],
)
def test_no_speed_given_means_the_highest_that_keeps_every_limit(axis, binding, omega):
    machine = Machine(name="slow", axes={**FREE, "Z": axis}, spindle_rpm=1e4, block_rate_hz=1e6)
    motion = drive(wave(), servo(), machine)
    limits = check_limits(motion, machine)
    assert limits.spindle_rpm == pytest.approx(omega * 60 / TURN, rel=5e-6)
    assert limits.binding == binding
    assert limits.utilisation[binding] == pytest.approx(1, rel=1e-6)
    assert limits.ok
    assert not limits.findings
    # A percent faster breaks it: the same limit says so.
    faster = check_limits(drive(wave(), servo(1.01 * limits.spindle_rpm), machine), machine)
    assert not faster.ok
    assert faster.findings[0].startswith(f"{binding} reaches")


def test_block_rate_and_spindle_bind_in_turn():
    for rate, rpm, binding, expected in ((1000, 500, "block rate", 1000 / 60), (1e5, 500, "spindle speed", 500)):
        machine = Machine(name="m", axes=FREE, spindle_rpm=rpm, block_rate_hz=rate)
        limits = check_limits(drive(wave(), servo(), machine), machine)
        assert limits.binding == binding
        assert limits.spindle_rpm == pytest.approx(expected, rel=1e-9)
        assert limits.ok


def test_uneven_blocks_count_where_they_are_shortest():
    angle = np.array([0, 0.1, 0.2, 0.21, 0.3])
    machine = Machine(name="m", axes=FREE, spindle_rpm=500, block_rate_hz=100)
    limits = check_limits(drive(path(angle, 5 - angle, 0 * angle), servo(), machine), machine)
    assert limits.block_rate_hz == pytest.approx(100)
    assert limits.cycle_time_s == pytest.approx(0.3)  # at 0.01 rad per 10 ms


def test_known_errors_of_the_machine_are_taken_out_of_z():
    machine = replace(FREE_MACHINE, squareness=-3.5e-5, straightness=([0, 4, 6], [0, 1e-4, -2e-4]))
    plan = wave()
    motion = drive(plan, servo(50), machine)
    x = motion.axes["X"]
    # What the tip does is the command plus the error of the machine: exactly the path.
    error = -3.5e-5 * x + np.where(x < 4, 1e-4 * x / 4, 1e-4 - 3e-4 * (x - 4) / 2)
    assert np.abs(motion.axes["Z"] + error - plan.z).max() < 1e-15
    assert np.abs(motion.axes["X"] - plan.radius).max() == 0


def test_the_travel_is_looked_at():
    machine = replace(FREE_MACHINE, axes={**FREE, "X": Axis(low=-1, high=4.95), "Z": Axis(low=-0.1, high=1)})
    limits = check_limits(drive(wave(), servo(50), machine), machine)
    assert not limits.ok
    assert [finding[:11] for finding in limits.findings] == ["X goes to 5", "Z goes to -"]


@pytest.mark.parametrize("sense", [1, -1])
def test_velocities_are_the_derivatives_of_what_is_commanded(sense):
    """Of every axis, with the machine's errors along X; SciPy's spline through dense points is the oracle."""
    bent = (np.array([-1.0, 0.3, 0.7, 5.0]), np.array([0.0, 2e-4, -1e-4, 3e-3]))
    lathe = Machine(
        name="PVT", axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=1000, block_rate_hz=1e5, squareness=1e-3,
        straightness=bent, controller=Controller(interpolation="hermite"),
    )  # fmt: skip
    part = Part(surface=Plane(slope=(0.05, 0.02)), radius=1.0)
    servo = SlowToolServo(feed=0.1, points_per_rev=720, spindle_rpm=60, sense=sense)
    tool = Tool(nose_radius=0.5, included=np.deg2rad(60))
    path = place(servo.spiral(part, tool), part, tool)
    made = drive(path, servo, lathe)
    assert made.velocity is not None
    smooth = np.ones(made.time.size, dtype=bool)
    for corner in bent[0]:
        smooth &= np.abs(made.axes["X"] - corner) > 0.01
    # A spline in time is as good as its blocks are even: where C comes to speed see test_rest.py.
    steady = np.isclose(np.abs(made.velocity["C"]), TURN, rtol=1e-12)
    smooth &= np.convolve(steady, np.ones(101), "same") == 101
    assert smooth.sum() > 0.85 * path.angle.size
    for letter, velocity in made.velocity.items():
        oracle = CubicSpline(made.time, made.axes[letter])(made.time, 1)
        assert np.abs(velocity - oracle)[smooth].max() < 1e-8
    linear = replace(lathe, controller=Controller())
    assert drive(path, servo, linear).velocity is None
    assert drive(replace(path, z_rate=None), servo, lathe).velocity is None


@pytest.mark.parametrize("points", [2, 3, 4, 50])
def test_the_spline_of_a_motion_is_that_of_scipy(points):
    """Oracle: SciPy's cubic spline with the slopes at its ends that parabolas through three points have."""
    rng = np.random.default_rng(points)
    time = 1e4 + np.cumsum(10 ** rng.uniform(-3, 0, points))
    value = rng.normal(size=points)
    slope = np.empty(points)
    spline.fill_slopes(only_read(time), only_read(value), slope)
    begin, end = time[0], time[-1]
    size = 400
    out = np.empty(size)
    spline.sample(only_read(time), only_read(value), only_read(slope), 0, begin, end, out)
    ends = [np.polyder(np.polyfit(time[part] - time[at], value[part], min(points, 3) - 1))[-1]
            for part, at in ((slice(3), 0), (slice(-3, None), -1))]  # fmt: skip
    theirs = CubicSpline(time - begin, value, bc_type=((1, ends[0]), (1, ends[1])))
    np.testing.assert_allclose(out, theirs((end - begin) * np.arange(size) / size), atol=1e-7)


def test_blocks_of_a_motion_are_found_once_and_cannot_be_changed():
    c = np.linspace(0, 60, 4001)
    axes = {"C": c, "X": 10 - c / 60, "Z": 0 * c, "W": np.sin(c)}
    motion = Motion(time=c, axes=axes, machine=Machine.load("nanoform-fts-70"))
    assert motion.blocks.size < 1000
    with pytest.raises(ValueError, match="read-only"):
        motion.blocks[1] = 0


@pytest.mark.parametrize(("start", "short"), [(13_500.0, 1e-3), (1e5, 1e-3), (1e5, 1e-11)])
def test_a_motion_is_not_slowed_for_the_rounding_of_its_times_but_for_its_blocks(start, short):
    """The block rate is 1000 blocks/s; times near 1e5 s are rounded to 1.5e-11 s."""
    machine = replace(FREE_MACHINE, block_rate_hz=1e3)
    time = start + 1e-3 * np.arange(50)
    if short < 1e-3:
        time = np.insert(time, 20, time[20] - short)
    axes = {"C": time - start, "X": 10 + 0 * time, "Z": 0 * time}
    slowed = slow_to_limits(Course(time, axes, {}), machine)
    if short == 1e-3:
        assert slowed.time is time
    else:
        assert np.diff(slowed.time).min() >= 0.95e-3  # times are now rounded to 2 % of a block


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("begin", [0.0, 1.2, -7.3])
def test_revolutions_end_at_the_points_that_have_turned_so_far(sense, begin):
    """Brute force over all points; every 120th is exactly at a full turn, where sums of angles round."""
    turned = 2 * np.pi / 120 * np.arange(397)
    c = begin + sense * turned
    machine = Machine(name="any", axes={letter: Axis() for letter in "CXZ"}, spindle_rpm=1000.0, block_rate_hz=1000.0)
    axes = {"C": c, "X": 5 - 1e-3 * turned, "Z": np.sin(turned)}
    motion = Motion(time=turned, axes=axes, machine=machine)
    away = np.abs(c - c[0])
    for angle in [0.0, 0.01, *away[[1, 119, 120, 121, 240, 396]], 30.0]:
        assert motion.reached(angle) == np.count_nonzero(away < angle)
    last = away[-1] - 2 * np.pi
    for start, one in zip((0.0, last / 2, last), motion.sample_revolutions(), strict=True):
        ends = [np.count_nonzero(away < angle) for angle in (start, start + 2 * np.pi * (1 + 1e-9))]
        np.testing.assert_array_equal(one.axes["C"], c[max(ends[0] - 1, 0) : ends[1] + 1])
