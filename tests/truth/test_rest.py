"""From rest to rest along the planned path. Oracle: SciPy's cubics through the program read back, and exact placing."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from cases import every_second
from turnwright import (
    AdaptiveToolServo,
    Axis,
    Conic,
    Controller,
    Machine,
    Part,
    SineGrid,
    SlowToolServo,
    SpeedProfile,
    Spiral,
    Tool,
    Toroid,
    check_limits,
    drive,
    place,
    read_nc,
    write_nc,
)
from turnwright.errors import LimitError

TURN = 2 * np.pi
HERMITE = Controller(interpolation="hermite")
FREE = Machine(
    name="free", axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=3000, block_rate_hz=1e5, dialect="pmac",
    controller=HERMITE,
)  # fmt: skip
LATHE = replace(Machine.load("nanotech-350fg"), dialect="pmac", controller=HERMITE)
PARTS = {
    "grid": Part(surface=SineGrid(amplitude=(0.005, 0.005), period=(0.2, 0.2)), radius=0.3),
    "asphere": Part(surface=Conic(radius=20.0, conic=-1.0).placed(shift=(-6.0, 0.0, 0.0)), radius=0.6),
    "toroid": Part(surface=Toroid(radius_x=8, radius_y=12), radius=0.6),
}
ROUNDED = 0.5e-6
"""Half of the last decimal. [mm]"""


def cut(servo, part, machine, folder):
    """Return the motion, and the same read back from its program."""
    tool = Tool(nose_radius=0.1)
    path = place(servo.spiral(part, tool), part, tool)
    motion = drive(path, servo, machine)
    write_nc(motion, machine, folder / "part.nc")
    return path, motion, read_nc(folder / "part.nc", machine)


def off(motion, part, tool, each=16):
    """Return how far the controller's height is from the exact one where its X and C then are. (n,) [mm]."""
    time = (motion.time[:-1, None] + np.diff(motion.time)[:, None] * np.arange(each) / each).ravel()
    c, x, z = (CubicHermiteSpline(motion.time, motion.axes[k], motion.velocity[k])(time) for k in "CXZ")
    on = np.append(True, np.diff(c) * motion.sense > 0)  # one who creeps from rest may stand where rounding has him
    return np.abs(z[on] - place(Spiral(angle=c[on], radius=x[on]), part, tool).z)


SERVOS = (
    AdaptiveToolServo(scallop=50e-6, chord=10e-6, interpolation="hermite", spindle_rpm=30),
    AdaptiveToolServo(scallop=50e-6, chord=2e-6, interpolation="hermite", spindle_rpm=120),
    SlowToolServo(feed=0.006, points_per_rev=90, spindle_rpm=120),
    SlowToolServo(feed=0.006, chord=50e-6, spindle_rpm=60),
)


@pytest.mark.parametrize(("servo", "name", "inside_out"), every_second(SERVOS, PARTS, [False, True]))
def test_the_program_keeps_to_the_path_from_end_to_end(servo, name, inside_out, tmp_path):
    part, tool, servo = PARTS[name], Tool(nose_radius=0.1), replace(servo, inside_out=inside_out)
    path, motion, again = cut(servo, part, LATHE, tmp_path)
    x = np.linspace(-part.radius, part.radius, 61)
    slope = np.abs(part.surface.gradient(*np.meshgrid(x, x))).max()
    # Z is rounded, X too, which counts by the slope, and the ends may stray by a tenth of a nanometre.
    allowed = ROUNDED * (1 + slope) + 1e-7
    if isinstance(servo, AdaptiveToolServo):
        allowed += servo.chord
    else:  # whose points are not those of cubics: what SciPy's cubics at a steady speed miss between them
        order = slice(None, None, path.sense)
        at = (path.angle[:-1, None] + np.diff(path.angle)[:, None] * np.arange(16) / 16).ravel()
        z = CubicHermiteSpline(path.angle[order], path.z[order], path.z_rate[order])(at)
        radius = CubicHermiteSpline(path.angle[order], path.radius[order], path.radius_rate[order])(at)
        allowed += np.abs(z - place(Spiral(angle=at, radius=radius), part, tool).z).max()
    assert off(again, part, tool).max() < allowed
    # From rest to rest, in as little time and within the limits.
    assert all(speed[0] == speed[-1] == 0 for speed in motion.velocity.values())
    plain = drive(replace(path, z_rate=None), servo, LATHE)
    assert plain.time[-1] < motion.time[-1] < plain.time[-1] + 1.0
    limits = check_limits(motion, LATHE)
    assert limits.ok, limits.findings
    # Every point of the plan is in the program, as it was placed.
    assert np.isin(path.angle, motion.axes["C"]).all()
    assert np.isin(path.z, motion.axes["Z"]).all()


@pytest.mark.parametrize("sense", [1, -1])
def test_all_axes_together_come_to_speed_and_to_rest(sense, tmp_path):
    """Oracle: SciPy's splines of the placed path over its angle; what C does is a cubic between any two points."""
    servo = SlowToolServo(feed=0.01, points_per_rev=720, spindle_rpm=60, sense=sense)
    path, motion, _ = cut(servo, PARTS["toroid"], FREE, tmp_path)
    c, speed = motion.axes["C"], motion.velocity["C"]
    for letter, values in (("X", path.radius), ("Z", path.z)):
        slope = CubicSpline(path.angle[::sense], values[::sense])(c, 1)
        assert np.abs(motion.velocity[letter] - slope * speed).max() < 1e-8
    # It accelerates to its speed, keeps it, and decelerates to rest.
    share = np.abs(speed) / TURN
    steady = np.flatnonzero(share > 1 - 1e-12)
    assert np.ptp(motion.time[steady]) > 0.95 * motion.time[-1]
    assert (np.diff(share[: steady[0] + 1]) > 0).all()
    assert (np.diff(share[steady[-1] :]) < 0).all()
    # Its acceleration begins at nothing and has no jumps: as far as points can show it, and much finer than its range.
    bend = CubicHermiteSpline(motion.time, c, speed).derivative(2)
    jumps = np.abs(bend(motion.time[1:-1]) - bend(np.nextafter(motion.time[1:-1], 0)))
    peak = np.abs(bend(motion.time)).max()
    assert peak == pytest.approx(TURN / 0.1, rel=0.1)  # a hundredth of a tenth of a second to half of the speed
    assert jumps.max() < 0.1 * peak
    assert abs(bend(0.0)) < 0.1 * peak


@pytest.mark.parametrize("limit", [{"acceleration": 2.0}, {"jerk": 3.0}, {"acceleration": 2.0, "jerk": 3.0}])
def test_the_limits_of_c_set_how_long_it_takes(limit, tmp_path):
    """Oracle: the bounds. From rest to w at acceleration a and jerk j takes no less than w / a and 2 sqrt(w / j)."""
    machine = replace(FREE, axes={**FREE.axes, "C": Axis(**limit)})
    servo = SlowToolServo(feed=0.01, points_per_rev=360, spindle_rpm=60)
    _, motion, _ = cut(servo, PARTS["toroid"], machine, tmp_path)
    limits = check_limits(motion, machine)
    assert limits.ok, limits.findings
    least = max(TURN / limit.get("acceleration", np.inf), 2 * np.sqrt(TURN / limit.get("jerk", np.inf)))
    took = motion.time[np.argmax(motion.velocity["C"] > TURN * (1 - 1e-12))]
    assert least < took < 3 * least


@pytest.mark.parametrize("rate", [500.0, 1e5])
def test_blocks_are_no_shorter_than_the_machine_may_have_them(rate, tmp_path):
    machine = replace(FREE, block_rate_hz=rate)
    servo = AdaptiveToolServo(scallop=50e-6, chord=10e-6, interpolation="hermite")
    _, motion, again = cut(servo, PARTS["grid"], machine, tmp_path)
    assert np.diff(motion.time).min() > (1 - 1e-3) / rate
    assert off(again, PARTS["grid"], Tool(nose_radius=0.1)).max() < 10e-6 + 2 * ROUNDED + 1e-7


def test_a_speed_that_only_the_ends_would_keep_down_is_higher(tmp_path):
    """Oracle: the limit itself. The last block is a tenth of the others, so it takes a tenth of their speed alone."""
    machine = replace(FREE, block_rate_hz=200.0)
    servo = SlowToolServo(feed=0.01, points_per_rev=36)
    part, tool = PARTS["toroid"], Tool(nose_radius=0.1)
    spiral = servo.spiral(part, tool)
    angle = np.append(spiral.angle, spiral.angle[-1] + np.diff(spiral.angle)[0] / 10)
    radius = np.append(spiral.radius, spiral.radius[-1] + spiral.radius_rate[0] * (angle[-1] - angle[-2]))
    spiral = Spiral(angle=angle, radius=radius, radius_rate=np.append(spiral.radius_rate, spiral.radius_rate[-1]))
    limits = check_limits(drive(place(spiral, part, tool), servo, machine), machine)
    assert limits.ok
    assert limits.binding == "block rate"
    assert limits.peak_speed["C"] == pytest.approx(200.0 * TURN / 36, rel=0.01)


def test_a_short_path_is_gone_along_as_fast_as_c_may_be_sped_up():
    """Oracle: an acceleration from nothing to its peak and back comes to w along w^2 / a, here half of the path."""
    part, tool = PARTS["toroid"], Tool(nose_radius=0.1)
    slow = SlowToolServo(feed=0.006, points_per_rev=90, spindle_rpm=60)
    machine = replace(FREE, axes={**FREE.axes, "C": Axis(acceleration=2.0)})
    spiral = slow.spiral(part, tool)

    def some(count, rpm):
        of = {name: getattr(spiral, name)[:count] for name in ("angle", "radius", "radius_rate")}
        return drive(place(Spiral(**of), part, tool), replace(slow, spindle_rpm=rpm), machine)

    sought = some(91, None)  # one turn
    top = np.abs(sought.velocity["C"]).max()
    assert top == pytest.approx(np.sqrt(2.0 * np.pi), rel=0.01)
    limits = check_limits(sought, machine)
    assert limits.ok
    assert limits.binding == "C acceleration"
    # What is stated is kept to, or refused for what limits it.
    for share in (0.3, 0.8, 0.99):
        stated = some(91, share * top * 60 / TURN)
        assert np.abs(stated.velocity["C"]).max() == pytest.approx(share * top, rel=1e-12)
        assert check_limits(stated, machine).ok
    for share in (1.001, 1.3, 3.0):
        with pytest.raises(LimitError, match=r"spindle_rpm is .* C acceleration"):
            some(91, share * top * 60 / TURN)
    with pytest.raises(LimitError, match=r"2 points in 0\.0698 rad"):
        some(2, 60)


@pytest.mark.parametrize(
    "rpm", [*(pytest.param(one, marks=pytest.mark.proof) for one in (300, 500, 900, 1100)), 580, 620]
)
def test_a_stated_speed_is_reached_or_refused(rpm):
    part, tool = Part(surface=Toroid(radius_x=20, radius_y=30), radius=0.5), Tool(nose_radius=0.5)
    machine = replace(Machine.load("nanoform"), dialect="pmac", controller=HERMITE, spindle_rpm=2000, block_rate_hz=5e3)
    servo = SlowToolServo(feed=0.02, points_per_rev=8, spindle_rpm=rpm)
    path = place(servo.spiral(part, tool), part, tool)
    # Half of 25.5 turns, from rest at a peak of 52.36 rad/s^2 that rises and falls evenly.
    highest = np.sqrt(machine.axes["C"].acceleration * np.ptp(path.angle) / 2) * 60 / TURN
    if rpm < highest:
        motion = drive(path, servo, machine)
        assert np.abs(motion.velocity["C"]).max() * 60 / TURN == pytest.approx(rpm, rel=1e-12)
        limits = check_limits(motion, machine)
        assert limits.spindle_rpm == pytest.approx(rpm, rel=1e-12)  # not the mean
        assert limits.binding == "spindle speed as stated"
    else:
        with pytest.raises(LimitError, match="C acceleration") as refused:
            drive(path, servo, machine)
        named = float(re.search(r"is ([\d.]+) rev/min \(by", str(refused.value))[1])
        assert named == pytest.approx(highest, rel=0.01)
        limits = check_limits(drive(path, replace(servo, spindle_rpm=named), machine), machine)
        assert limits.ok
        assert limits.spindle_rpm == pytest.approx(named, rel=1e-12)
        assert limits.binding == "C acceleration"


def test_a_speed_profile_is_reached_or_refused():
    """Oracle: C needs w^2 / a to come to w, here more than the path."""
    part, tool, servo = PARTS["toroid"], Tool(nose_radius=0.1), SlowToolServo(feed=0.02, points_per_rev=90)
    machine = replace(FREE, axes={**FREE.axes, "C": Axis(acceleration=5.0)})
    machine = replace(machine, controller=replace(HERMITE, variable_speed=True))
    path = place(servo.spiral(part, tool), part, tool)

    def at(rpm):
        profile = SpeedProfile(radius=[0.2, 0.4], spindle_rpm=[rpm, rpm / 2])
        return drive(path, servo, machine, profile=profile)

    slow = at(60.0)
    inner = np.abs(slow.axes["X"]) < 0.15
    assert np.abs(slow.velocity["C"][inner]).max() * 60 / TURN == pytest.approx(60, rel=1e-9)
    with pytest.raises(LimitError, match=r"speed profile .* 600 rev/min.*C acceleration"):
        at(600.0)


def test_no_higher_speed_than_the_one_sought_keeps_every_limit():
    """Blocks that cannot be divided bound how soon a wavy path comes to speed: the steps of 0.8 missed half of it."""
    part, tool = Part(surface=SineGrid(amplitude=(0.003, 0.002), period=(0.8, 1.1)), radius=0.6), Tool(nose_radius=0.2)
    machine = replace(Machine.load("nanoform"), dialect="pmac", controller=HERMITE, block_rate_hz=100)
    servo = SlowToolServo(feed=0.03, points_per_rev=36)
    path = place(servo.spiral(part, tool), part, tool)
    top = np.abs(drive(path, servo, machine).velocity["C"]).max() * 60 / TURN
    for share in (1.001, 1.1, 1.25):
        with pytest.raises(LimitError, match=r"spindle_rpm is .* block rate"):
            drive(path, replace(servo, spindle_rpm=share * top), machine)
    assert check_limits(drive(path, replace(servo, spindle_rpm=0.99 * top), machine), machine).ok
