"""Turning in spindle mode against closed forms: cusps of two circles, the path over a sphere, the time of a cut."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from cases import every_second
from turnwright.errors import InputError, JobError, LimitError, ProgramError
from turnwright.machine import Axis, Controller, SecondOrder
from turnwright.path import SpindleMode
from turnwright.post import ProgramWarning, reader
from turnwright.strategy import find_asymmetry, turning

TOOL = tw.Tool(nose_radius=0.5, included=np.deg2rad(120))
MACHINE = tw.Machine.load("nanoform")
TURN = 2 * np.pi


def turned(surface, radius, **options):
    part = tw.Part(surface=surface, radius=radius)
    servo = tw.Turning(**{"feed": 0.05, "spindle_rpm": 1000.0, "chord": 1e-10, **options})
    path = tw.place(servo.spiral(part, TOOL), part, TOOL)
    return tw.drive(path, servo, MACHINE)


def passes(motion, angle=0.0):
    """X and Z where the azimuth passes under the tool, by linear interpolation."""
    c = motion.sense * motion.axes["C"]
    at = np.arange(np.ceil((c[0] - angle) / TURN), np.floor((c[-1] - angle) / TURN)) * TURN + angle
    return np.interp(at, c, motion.axes["X"]), np.interp(at, c, motion.axes["Z"])


@pytest.mark.parametrize("inside_out", [False, True])
def test_cusps_of_a_flat_are_those_of_two_circles(inside_out):
    motion = turned(tw.Plane(), 4.0, inside_out=inside_out)
    x, _ = passes(motion)
    middle = np.sort((x[1:] + x[:-1]) / 2)
    middle = middle[middle > 0.2]
    cut = tw.generate_polar(motion, TOOL, radius=middle, angle=np.zeros(1)).z[0]
    expected = 0.5 - np.sqrt(0.5**2 - 0.05**2 / 4)
    assert np.abs(cut / expected - 1).max() < 1e-6
    assert motion.blocks.size == 2  # one straight line


@pytest.mark.parametrize("ball", [60.0, -60.0])
def test_cusps_of_spheres_are_those_of_two_circles(ball):
    """Centres of the nose lie on a circle about the centre of the sphere; the angle between them is known."""
    motion = turned(tw.Sphere(radius=ball), 4.0)
    x, z = passes(motion)
    inner = abs(ball - 0.5)  # distance of the centres of the nose from that of the sphere
    polar = np.arcsin(x / inner)
    apart = -np.diff(polar)
    middle = (polar[1:] + polar[:-1]) / 2
    # Along a chord of the path, the step is a little longer than the arc.
    assert inner * apart == pytest.approx(np.full(apart.size, 0.05), rel=1e-6)
    height = np.sign(ball)
    apex = inner * np.cos(apart / 2) + height * np.sqrt(0.5**2 - (inner * np.sin(apart / 2)) ** 2)
    radius = apex * np.sin(middle)
    order = np.argsort(radius)[4:]
    cut = tw.generate_polar(motion, TOOL, radius=radius[order], angle=np.zeros(1)).z[0]
    # The cusp along the normal, from the cut height at the place of its apex.
    cusp = height * (abs(ball) - np.hypot(radius[order], cut - ball))
    expected = height * (abs(ball) - apex[order])
    assert np.abs(cusp / expected - 1).max() < 1e-6
    assert z.min() > -1e-9 or ball < 0


def test_cusps_of_an_asphere_follow_the_leading_term():
    """f² / 8R(1 - kR) along the normal, with the feed along the path of the tip."""
    surface = tw.EvenAsphere(radius=80.0, conic=-0.6, terms={4: 2e-6, 6: -1e-9})
    motion = turned(surface, 10.0, feed=0.01, chord=1e-9)
    x, _ = passes(motion)
    radius = np.linspace(2.0, 9.0, 40)
    fine = radius[:, None] + np.linspace(-0.011, 0.011, 4001)
    cut = tw.generate_polar(motion, TOOL, radius=fine.ravel(), angle=np.zeros(1)).z[0].reshape(fine.shape)
    slope = surface.gradient(fine, np.zeros(fine.shape))[0]
    off = (cut - surface.sag(fine, np.zeros(fine.shape))) / np.hypot(1, slope)
    bend = surface.hessian(radius, np.zeros(radius.size))[0] / (1 + slope[:, 2000] ** 2) ** 1.5
    expected = 0.01**2 / (8 * 0.5 * (1 - bend * 0.5))
    assert np.abs((off.max(axis=1) - off.min(axis=1)) / expected - 1).max() < 1e-3
    assert x.size > 990


@pytest.mark.parametrize(("dialect", "sense"), every_second(["generic", "nanotech"], [1, -1]))
def test_a_program_follows_the_path_over_a_sphere(tmp_path, dialect, sense):
    """Oracle: the tip of a round nose runs along a circle; half a last decimal of X acts by the slope."""
    machine = replace(MACHINE, dialect=dialect)
    part = tw.Part(surface=tw.Sphere(radius=50.0), radius=12.5)
    servo = tw.Turning(feed=0.002, spindle_rpm=2000.0, chord=1e-6, sense=sense)
    motion = tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc")
    again = tw.read_nc(tmp_path / "part.nc", machine)
    x, z = again.axes["X"], again.axes["Z"]
    exact = 49.5 - np.sqrt(49.5**2 - x**2)
    slope = np.abs(x).max() / np.sqrt(49.5**2 - x.max() ** 2)
    assert np.abs(z - exact).max() <= 1.0001e-6 + 0.5e-6 + 0.5e-6 * slope
    assert again.sense == sense
    assert again.blocks.size == motion.blocks.size
    turns = np.abs(again.axes["C"][-1] - again.axes["C"][0]) / TURN
    length = 49.5 * np.arcsin(motion.axes["X"][0] / 49.5)
    assert turns == pytest.approx(length / 0.002, rel=1e-6)
    assert again.time[-1] == pytest.approx(turns / 2000 * 60, rel=1e-9)


def test_an_asphere_of_50_mm_takes_six_minutes(tmp_path):
    surface = tw.EvenAsphere(radius=80.0, conic=-0.6, terms={4: 2e-7, 6: -1e-10})
    motion = turned(surface, 25.0, feed=0.002, spindle_rpm=2000.0, chord=1e-6)
    done = tw.write_nc(motion, MACHINE, tmp_path / "part.nc")
    assert done.minutes < 6.5
    assert done.lines < 5000
    assert tw.check_limits(motion, MACHINE).ok


def test_constant_surface_speed_takes_the_time_of_its_integral():
    options = {"spindle_rpm": 2000.0, "surface_speed": 1000.0, "feed_mode": "mm/rev", "lead_in": 0.0, "overrun": 0.0}
    motion = turned(tw.Plane(), 10.0, feed=0.01, **options)
    border = 1000.0 / (TURN * 2000 / 60)  # where the highest speed is reached
    expected = np.pi * (10.0**2 - border**2) / (1000.0 * 0.01) + border / 0.01 / 2000 * 60
    assert motion.time[-1] == pytest.approx(expected, rel=1e-6)
    assert motion.axes["C"][-1] == pytest.approx(TURN * 1000, rel=1e-12)


def test_a_program_at_constant_surface_speed_comes_back(tmp_path):
    options = {"surface_speed": 1000.0, "feed_mode": "mm/rev"}
    motion = turned(tw.Sphere(radius=50.0), 10.0, feed=0.01, chord=1e-6, spindle_rpm=2000.0, **options)
    tw.write_nc(motion, MACHINE, tmp_path / "part.nc")
    again = tw.read_nc(tmp_path / "part.nc", MACHINE)
    assert again.time[-1] == pytest.approx(motion.time[-1], rel=1e-6)
    assert "G96 D2000 S60 M04" in (tmp_path / "part.nc").read_text()


def test_passes_in_spindle_mode_and_with_c_share_a_program(tmp_path):
    part = tw.Part(surface=tw.Sphere(radius=50.0), radius=2.0)
    rough = turned(part.surface, 2.0, chord=1e-6)
    servo = tw.SlowToolServo(feed=0.02, spindle_rpm=100.0, points_per_rev=90)
    finish = tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, MACHINE)
    for dialect in ("generic", "nanotech"):
        machine = replace(MACHINE, dialect=dialect)
        tw.write_nc({"rough": rough, "finish": finish}, machine, tmp_path / "part.nc")
        again = tw.read_nc(tmp_path / "part.nc", machine, name="rough")
        assert again.spindle_mode == rough.spindle_mode
        last = tw.read_nc(tmp_path / "part.nc", machine)
        assert last.spindle_mode is None
        assert np.abs(last.axes["C"] - finish.axes["C"]).max() < 1e-6


def test_a_program_by_hand_is_read_as_it_turns(tmp_path):
    file = tmp_path / "hand.nc"
    file.write_text(
        "G21 G90 G18\nG97 S1200 M3\nG0 X12 Z2\nG95\nG1 Z0 F0.05\nX6 F0.01\nX2 Z0.5 F0.005\nX0\nG0 Z5\nM5\nM30\n"
    )
    motion = tw.read_nc(file, MACHINE)
    assert motion.axes["X"][motion.blocks].tolist() == [12, 6, 2, 0]
    turns = np.abs(np.diff(motion.axes["C"][motion.blocks])) / TURN
    assert turns == pytest.approx([600, np.hypot(4, 0.5) / 0.005, 400])
    assert motion.sense == -1
    assert motion.time[-1] == pytest.approx(turns.sum() / 1200 * 60)


def test_the_servos_of_c_do_not_act_in_spindle_mode():
    slow = replace(
        MACHINE, axes={**MACHINE.axes, "C": Axis(response=SecondOrder(frequency_hz=0.1, damping=0.7), speed=1.0)}
    )
    motion = replace(turned(tw.Sphere(radius=50.0), 2.0, chord=1e-6), machine=slow)
    real = tw.track(motion, slow)
    assert real.axes["C"] == pytest.approx(np.interp(real.time, motion.time, motion.axes["C"]), abs=1e-9)
    assert tw.check_limits(motion, slow).ok
    with pytest.raises(InputError, match="precorrect"):
        tw.precorrect(motion)


def test_an_offset_tool_leaves_the_ogive_of_any_spiral():
    """The mean error over the azimuth is that of a slow tool servo with the same feed, within the cusps."""
    part = tw.Part(surface=tw.Sphere(radius=50.0), radius=5.0)
    actual = replace(TOOL, offset=(0.003, 0.002, 0.0))
    radius, angle = np.linspace(0.5, 4.5, 400), np.linspace(0, TURN, 24, endpoint=False)
    errors = []
    for servo in (
        tw.Turning(feed=0.004, spindle_rpm=1000.0, chord=1e-8),
        tw.SlowToolServo(feed=0.004, spindle_rpm=10.0, points_per_rev=24),
    ):
        motion = tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, MACHINE)
        errors.append(tw.generate_polar(motion, actual, radius=radius, angle=angle).minus(part.surface).z.mean(axis=0))
    assert np.abs(errors[0] - errors[1]).max() < 0.004**2 / (8 * 0.5)
    assert np.abs(errors[0]).max() > 1e-4


@pytest.mark.parametrize("rim", [1e-5, 3e-4])
def test_asymmetry_is_the_departure_from_the_mean_over_the_azimuth(rim):
    surface = tw.Sphere(radius=50.0) + tw.XYPolynomial(terms={(2, 0): rim / 25, (0, 2): -rim / 25})
    assert find_asymmetry(surface, 5.0) == pytest.approx(rim, rel=1e-6)
    with pytest.raises(InputError, match=f"by {rim * 1e6:.4g} nm"):
        turned(surface, 5.0, chord=1e-6)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"feed": 2.0}, "feed"),
        ({"chord": 0.0}, "chord"),
        ({"spindle_rpm": 9000.0}, "spindle mode is 7000"),
        ({"surface_speed": 500.0}, "surface_speed"),
        ({"overrun": 1.0}, "overrun"),
        ({"chord": 1.0}, "chord"),
        ({"surface_speed": 1e-6, "feed_mode": "mm/rev"}, "units of feed and speed"),
    ],
)
def test_bad_input_is_refused(options, field):
    with pytest.raises((InputError, LimitError), match=field):
        turned(tw.Plane(), 4.0, **options)


def test_a_machine_or_dialect_without_spindle_mode_is_refused(tmp_path):
    motion = turned(tw.Plane(), 4.0)
    with pytest.raises(LimitError, match="spindle_mode_rpm"):
        tw.check_limits(motion, replace(MACHINE, spindle_mode_rpm=None))
    machine = replace(MACHINE, dialect="pmac", controller=Controller(interpolation="hermite"))
    with pytest.raises(ProgramError, match="spindle_start"):
        tw.write_nc(motion, machine, tmp_path / "part.nc")
    with pytest.raises(InputError, match="feed per revolution"):
        SpindleMode(feed=0.01, spindle_rpm=100.0, surface_speed=10.0)


def test_the_chord_holds_with_the_errors_of_the_machine():
    """Oracle: straightness of a cosine; X and Z are linear between the points of the program."""
    knots = np.linspace(-12, 12, 481)
    machine = replace(MACHINE, straightness=(knots, 2e-4 * np.cos(np.pi * knots / 12)))
    part = tw.Part(surface=tw.Plane(), radius=10.0)
    servo = tw.Turning(feed=0.01, spindle_rpm=1000.0, chord=1e-6)
    motion = tw.drive(tw.place(servo.spiral(part, TOOL), part, TOOL), servo, machine)
    assert np.ptp(motion.axes["Z"] + machine.z_error(motion.axes["X"])) < 2.01e-6


@pytest.mark.parametrize(
    ("formula", "radius"),
    [
        ("0.001*cos(40*rho)+0.0002*x", 0.8),
        ("0.005*sin(12*x)*sin(12*y)", 1.5),
        pytest.param("x*y/100", 1.5, marks=pytest.mark.proof),
    ],
)
def test_a_roughing_pass_stays_above_any_freeform(formula, radius, monkeypatch):
    """Oracle: heights at random points, on and between the rings that the target was made of."""
    monkeypatch.setattr(turning, "MERIDIAN_SAMPLES", 2000)  # by which points are spread, not their heights
    surface = tw.Expression(formula)
    part = tw.Part(surface=surface, radius=radius)
    servo = tw.Turning(feed=0.02, spindle_rpm=1000.0, chord=1e-5, symmetric_part=True)
    target = servo.target(part)
    random = np.random.default_rng(5)
    r, angle = radius * np.sqrt(random.random(30_000)), TURN * random.random(30_000)
    x, y = r * np.cos(angle), r * np.sin(angle)
    assert (target.surface.sag(x, y) - surface.sag(x, y)).min() > -1e-9
    motion = tw.drive(tw.place(servo.spiral(target, TOOL), target, TOOL), servo, MACHINE)
    near = slice(0, 8_000)
    cut = tw.generate_points(motion, TOOL, x=0.98 * x[near], y=0.98 * y[near])
    assert (cut - surface.sag(0.98 * x[near], 0.98 * y[near])).min() > -1e-9


def test_small_features_are_found_or_refused():
    def bump(size):
        return tw.Expression(f"1e-3*exp(-((x-5)**2+(y-3)**2)/{size}**2)")

    assert find_asymmetry(bump(0.3), 12.5) == pytest.approx(1e-3, rel=0.05)
    with pytest.raises(InputError, match="too fine"):
        find_asymmetry(bump(0.004), 12.5)
    assert find_asymmetry(tw.Expression("1e-4*cos(300*rho)"), 12.5) == 0


def test_a_steep_axis_does_not_set_the_points_of_the_whole_path():
    part = tw.Part(surface=tw.Expression("-sqrt(16-(rho-4)**2)"), radius=7.0)
    servo = tw.Turning(feed=0.01, spindle_rpm=1000.0, chord=1e-6)
    assert servo.spiral(part, TOOL).angle.size < 40_000


def test_foreign_cuts_in_spindle_mode_are_counted_and_bounded(tmp_path):
    file = tmp_path / "hand.nc"
    file.write_text("G21 G90\nG97 S1200 M3\nG94\nG0 X12 Z0\nG1 X6 F10\nG1 Z-0.5\nG1 X0\nG0 Z5\nM30\n")
    with pytest.warns(ProgramWarning, match="only cut 2 is read") as warned:
        tw.read_nc(file, MACHINE)
    assert "does not turn C" not in str(warned[0].message)
    assert tw.read_nc(file, MACHINE, name="cut 1").axes["X"][0] == 12
    file.write_text("G21 G90\nG97 S1200 M3\nG95\nG0 X1000 Z0\nG1 X0 F0.000001\nM30\n")
    with pytest.raises(ProgramError, match="feed"):
        tw.read_nc(file, MACHINE)
    file.write_text("G21 G90\nG50 S2000\nG96 S60 M3\nG95\nG0 X9 Z0\nG1 X5 F0.01\nG97\nG1 X0\nM30\n")
    with pytest.raises(ProgramError, match="G96 and G97"):
        tw.read_nc(file, MACHINE)


def test_only_a_list_of_moves_has_a_limit_of_moves(tmp_path, monkeypatch):
    monkeypatch.setattr(reader, "MAX_MOVES", 1000)
    file = tmp_path / "long.nc"
    file.write_text("G21 G90\nG97 S1200 M3\nG95\n" + "G0 X9 Z5\nG0 X12 Z5\n" * 501 + "G1 X5 F0.01\nM30\n")
    assert tw.read_nc(file, MACHINE).axes["X"][-1] == 5
    with pytest.raises(ProgramError, match="1,000th move"):
        tw.post.read_moves(file, MACHINE)


def test_a_pass_may_have_its_own_spindle_speed():
    job = tw.Job.read({
        "part": {"surface": {"family": "sphere", "radius": "50 mm"}, "radius": "5 mm", "stock": "20 um"},
        "tool": {"nose_radius": "0.5 mm", "included": "120 deg", "clearance": "12 deg"},
        "machine": {"name": "nanoform"},
        "strategy": {"kind": "turning", "feed": "10 um/rev", "spindle_speed": "1000 rpm", "chord": "1 nm"},
        "passes": [{"name": "semi", "allowance": "3 um", "spindle_speed": "1500 rpm"}, {"name": "finish"}],
    })  # fmt: skip
    assert [job.servo(cut).spindle_mode.spindle_rpm for cut in job.passes] == [1500, 1000]
    with pytest.raises(JobError, match="allowance"):
        job.replace("passes.semi.chord", "5 um")
