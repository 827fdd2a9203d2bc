"""A fast tool on the slide: the split against an active-set solver and closed forms, the sum against one slide."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import nnls

import turnwright as tw
from turnwright.strategy import split as _split

TURN = 2 * np.pi


def test_split_is_the_optimum_of_an_active_set_method():
    """Least-distance programming by NNLS (Lawson and Hanson, ch. 23) over the same splines and all samples.

    The split keeps the whole stroke everywhere, and all but a thousandth of it where it looks: so its cost is between
    the least ones of the two.
    """
    turned = np.linspace(0, TURN, 257)
    height = 0.05 * np.cos(turned) + 0.03 * np.sin(2 * turned) + 0.002 * np.cos(9 * turned)
    stroke = 0.02
    slow, _ = _split.find_smoothest(turned, height, tw.Axis(low=-stroke / 2, high=stroke / 2), None)

    step = TURN / _split.CELLS_PER_REV[0]
    knots = step * np.arange(-3, _split.CELLS_PER_REV[0] + 4)
    splines = [BSpline(knots, row, 3) for row in np.eye(knots.size - 4)]
    at = np.array([spline(turned) for spline in splines]).T
    third = np.array([spline.derivative(3)((knots[3:-4] + knots[4:-3]) / 2) for spline in splines]).T
    weight = np.gradient(turned)
    lower = np.linalg.cholesky(step * third.T @ third + (at.T * weight) @ at)
    # In y = L'c - g the cost is the square of the length of y; the samples ask A y >= b.
    inverse = np.linalg.inv(lower)
    g = inverse @ (at.T @ (weight * height))
    rows = np.concatenate([at, -at]) @ inverse.T

    def best(half):
        bound = np.concatenate([height - half, -height - half]) - rows @ g
        corner = np.vstack([rows.T, bound[None]])
        found, _ = nnls(corner, np.eye(len(corner))[-1], maxiter=10_000)
        left = corner @ found - np.eye(len(corner))[-1]
        return -left[:-1] / left[-1]

    loose, tight = best(stroke / 2), best(stroke / 2 * (1 - _split.TRAVEL_MARGIN))
    ours = lower.T @ np.linalg.lstsq(at, slow, rcond=None)[0] - g
    assert loose @ loose * (1 - 1e-6) <= ours @ ours <= tight @ tight * (1 + 1e-6)
    assert tight @ tight < 1.01 * (loose @ loose)
    assert np.abs(slow - at @ inverse.T @ (loose + g)).max() < 2 * _split.TRAVEL_MARGIN * stroke
    assert np.abs(height - slow).max() <= stroke / 2


@pytest.mark.parametrize(("harmonic", "share"), [(1, 1 / 2), (2, 1 / 65), (3, 1 / 730)])
def test_slide_takes_what_is_slower_than_a_revolution(harmonic, share):
    turned = np.linspace(0, 12 * TURN, 12 * 512 + 1)
    drift = 0.3 * np.cos(turned / 40)
    height = drift + 0.004 * np.cos(harmonic * turned)
    slow, _ = _split.find_smoothest(turned, height, tw.Axis(low=-0.1, high=0.1), None)
    middle = slice(4 * 512, 8 * 512)
    assert slow[middle] == pytest.approx(
        (drift + 0.004 * share * np.cos(harmonic * turned))[middle], abs=0.004 * share / 200 + 1e-7
    )


@pytest.mark.parametrize("limit", ["travel", "speed", "acceleration"])
def test_every_limit_of_the_fast_tool_is_kept_and_used(limit):
    """Alone it would have to do 0.03 cos 2t at 100 rev/min: 0.63 mm/s and 13 mm/s^2."""
    machine = tw.Machine.load("nanoform-fts-70")
    fast = tw.Axis(
        low=-0.02 if limit == "travel" else -0.035,
        high=0.02 if limit == "travel" else 0.035,
        speed=0.3 if limit == "speed" else None,
        acceleration=5.0 if limit == "acceleration" else None,
    )
    turned = np.linspace(0, 6 * TURN, 6 * 720 + 1)
    height = 0.03 * np.cos(2 * turned) + 0.001 * np.cos(3 * turned)
    omega = 100 * TURN / 60
    slow, _ = _split.find_smoothest(turned, height, fast, omega)
    axes = {"C": turned, "X": 5 - 0.001 * turned, "Z": slow, "W": height - slow}
    limits = tw.check_limits(tw.Motion(time=turned / omega, axes=axes, machine=machine), machine)
    low, high = limits.travel["W"]
    used = {
        "travel": max(-low, high) / 0.02,
        "speed": limits.peak_speed["W"] / 0.3,
        "acceleration": limits.peak_acceleration["W"] / 5.0,
    }[limit]
    assert 0.98 < used <= 1.0
    assert max(-low, high) <= 0.035


def test_a_corner_that_no_slide_can_help_is_refused():
    turned = np.linspace(0, 2 * TURN, 20 * 720 + 1)
    height = 0.01 * np.abs(np.sin(3 * turned))
    fast = tw.Axis(low=-0.035, high=0.035, acceleration=1e3)
    with pytest.raises(tw.LimitError, match=r"1000 mm/s\^2 \(the path has 6875\)"):
        _split.find_smoothest(turned, height, fast, 10.0)
    slow, _ = _split.find_smoothest(turned, height, fast, None)
    assert np.isfinite(slow).all()


@pytest.fixture(scope="module")
def compound():
    """A toric base with one lens off the axis, at half a millimetre."""
    base = tw.Toroid(radius_x=20.0, radius_y=10.0)
    lens = tw.Expression("0.002*exp(-((x-0.25)**2 + y**2)/0.005)")
    part = tw.Part(surface=base + lens, radius=0.5)
    tool = tw.Tool(nose_radius=0.05, included=np.deg2rad(100), clearance=np.deg2rad(20))
    plan = tw.SlowToolServo(feed=0.02, spindle_rpm=60, points_per_rev=360)
    return part, tool, plan, base, tw.place(plan.spiral(part, tool), part, tool)


def servos(part, tool, plan, base):
    yield tw.FastToolServo(plan=plan)
    yield tw.HybridToolServo(plan=plan, base=base, tool=tool)
    yield tw.HybridToolServo(plan=plan, base=base, tool=tool, blocks_per_rev=40)
    yield tw.HybridToolServo(plan=plan, fast=tw.Axis(low=-0.0025, high=0.0025))


def test_both_axes_together_leave_the_same_surface(compound):
    part, tool, plan, base, path = compound
    slow = tw.drive(path, plan, tw.Machine.load("nanoform"))
    grid = {"x": np.linspace(0.15, 0.35, 41), "y": np.linspace(-0.1, 0.1, 41)}
    alone = tw.generate(slow, tool, **grid).z
    machine = tw.Machine.load("nanoform-fts-500")
    for servo in servos(part, tool, plan, base):
        motion = tw.drive(path, servo, machine)
        assert np.abs(motion.axes["Z"] + motion.axes["W"] - path.z).max() < 1e-15
        assert np.abs(tw.generate(motion, tool, **grid).z - alone).max() < 1e-14
        assert tw.check_limits(motion, machine).ok


def test_a_second_tool_axis_has_no_errors_of_the_slide(compound):
    _, tool, _, _, path = compound
    crooked = replace(tw.Machine.load("nanoform-fts-500"), squareness=1e-3)
    moved = 0.003 * np.sin(3 * path.angle)
    axes = {"C": path.angle, "X": path.radius, "Z": path.z}
    time = path.angle - path.angle[0]
    both = tw.Motion(time=time, axes={**axes, "X": axes["X"] - moved, "U": moved}, machine=crooked)
    one = tw.Motion(time=time, axes={**axes, "Z": axes["Z"] - 1e-3 * moved}, machine=crooked)
    grid = {"x": np.linspace(0.15, 0.35, 21), "y": np.linspace(-0.1, 0.1, 21)}
    assert np.abs(tw.generate(both, tool, **grid).z - tw.generate(one, tool, **grid).z).max() < 1e-14
    assert set(both.lathe().axes) == {"C", "X", "Z"}


def test_a_split_by_design_leaves_the_lens_to_the_tool(compound):
    _, tool, plan, base, path = compound
    motion = tw.drive(path, tw.HybridToolServo(plan=plan, base=base, tool=tool), tw.Machine.load("nanoform-fts-500"))
    far = np.hypot(path.contact_x - 0.25, path.contact_y) > 0.3
    alone = tw.place(tw.Spiral(angle=path.angle, radius=path.radius), tw.Part(surface=base, radius=0.6), tool).z
    assert np.ptp(motion.axes["Z"] - alone) < 1e-12
    assert np.ptp(motion.axes["W"][far]) < 1e-9
    assert sum(tw.check_limits(motion, motion.machine).travel["W"]) == pytest.approx(0, abs=1e-15)


def test_the_rates_of_both_axes_are_derivatives_and_add_up(compound):
    part, tool, plan, base, _ = compound
    pvt = tw.Machine.load("nanoform-fts-500")
    path = tw.place(plan.spiral(part, tool), part, tool)
    for servo in servos(part, tool, plan, base):
        rates = servo.rates(path)
        if getattr(servo, "blocks_per_rev", None) is not None:
            assert rates is None
            continue
        axes = servo.axes(path)
        assert rates.keys() == axes.keys()
        assert rates["Z"] + rates["W"] == pytest.approx(plan.rates(path)["Z"], abs=1e-15)
        for letter in "ZW":
            by_differences = (axes[letter][2:] - axes[letter][:-2]) / (path.angle[2:] - path.angle[:-2])
            inner = slice(2, -2)
            scale = max(np.abs(by_differences).max(), 1e-6)
            assert rates[letter][1:-1][inner] == pytest.approx(by_differences[inner], abs=0.01 * scale)
    assert pvt.axes["W"].bandwidth_hz == 1000


def test_blocks_with_a_fast_tool_are_as_few_as_needed(compound):
    part, tool, plan, base, path = compound
    machine = tw.Machine.load("nanoform-fts-500")
    for servo, most in zip(servos(part, tool, plan, base), (17, 361, 46, 361), strict=True):
        motion = tw.drive(path, servo, machine)
        lathe = motion.lathe()
        assert lathe.time.size <= most * 360 * (path.angle[-1] - path.angle[0]) / TURN / 360 + 2
        assert set(lathe.axes) == {"C", "X", "Z"}
        for letter in "CXZ":
            again = np.interp(motion.time, lathe.time, lathe.axes[letter])
            assert np.abs(again - motion.axes[letter]).max() <= 1e-7
        block = np.diff(lathe.time).min()
        assert tw.check_limits(motion, machine).block_rate_hz == pytest.approx(1 / block, rel=1e-12)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("turns", [0, 1e3, 1e4, 1e5])
def test_the_lathe_has_the_requested_blocks(turns, sense):
    """Oracle: 1600 points over 200 blocks, 8 points to each, however far the spindle has turned."""
    turned = np.arange(4001) * (TURN / 1600)
    spiral = tw.Spiral(angle=sense * (TURN * turns + turned), radius=1 - 1e-3 * turned)
    part, tool = tw.Part(surface=tw.Plane(slope=(0.01, 0.0)), radius=2.0), tw.Tool(nose_radius=0.05)
    servo = tw.HybridToolServo(
        plan=tw.SlowToolServo(feed=0.02, points_per_rev=1600), base=part.surface, tool=tool, blocks_per_rev=200
    )
    motion = tw.drive(tw.place(spiral, part, tool), servo, tw.Machine.load("nanoform-fts-500"))
    assert np.abs(np.diff(motion.lathe().axes["C"])).max() == pytest.approx(TURN / 200)


def test_the_highest_speed_keeps_the_bandwidth():
    """40 waves a turn within 100 Hz, and the width of the window: 2.5 rev/s but for a half to two waves more."""
    machine = tw.Machine.load("nanoform-fts-70")
    slow = tw.Axis(low=-0.035, high=0.035, bandwidth_hz=100)
    machine = tw.Machine(
        name="lathe", axes={**machine.axes, "W": slow}, spindle_rpm=1e4, block_rate_hz=1e5, dialect="generic"
    )
    part = tw.Part(surface=tw.Expression("1e-4*cos(40*phi)*(1-exp(-(rho/0.05)**8))"), radius=0.4)
    tool = tw.Tool(nose_radius=0.05, included=np.deg2rad(100), clearance=np.deg2rad(20))
    servo = tw.FastToolServo(plan=tw.SlowToolServo(feed=0.02, points_per_rev=1440))
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
    limits = tw.check_limits(motion, machine)
    assert limits.binding == "W bandwidth"
    assert limits.frequency_hz["W"] == pytest.approx(100)
    assert 40.5 - 1e-9 <= 60 * 100 / limits.spindle_rpm <= 42


def test_the_lathe_and_the_tool_answer_each_on_its_own():
    """A first-order lag delays a ramp by its time constant; W at 640 rows/s is no block of a 100 blocks/s lathe."""
    lag = tw.machine.TransferFunction(numerator=[100.0], denominator=[1.0, 100.0])
    base = tw.Machine.load("nanoform-fts-70")
    axes = {"C": tw.Axis(), "X": tw.Axis(response=lag), "Z": tw.Axis(), "W": tw.Axis(dead_time=0.01)}
    machine = tw.Machine(
        name="lathe",
        axes=axes,
        spindle_rpm=base.spindle_rpm,
        block_rate_hz=100,
        controller=tw.Controller(interpolation="cubic spline", look_ahead=5),
    )
    time = np.arange(2561) / 640
    w = 1e-3 * np.sin(40 * time)
    motion = tw.Motion(
        time=time, axes={"C": 3 * time, "X": 9 - 0.1 * time, "Z": np.zeros(time.size), "W": w}, machine=machine
    )
    real = tw.track(motion, chord=1e-7)
    assert real.time[-1] == pytest.approx(4.0, rel=1e-12)
    settled = real.time > 1
    assert real.axes["X"][settled] == pytest.approx((9 - 0.1 * (real.time - 0.01))[settled], abs=1e-9)
    late = np.interp(real.time - 0.01, time, w)
    assert real.axes["W"][settled] == pytest.approx(late[settled], abs=1e-12)
