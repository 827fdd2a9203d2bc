"""Limits of PVT motions are those of the cubics that the controller makes. Oracle: SciPy's cubic Hermite splines."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pvt_oracle
import turnwright as tw
from cases import every_second

EXAMPLES = Path(__file__).parents[2] / "examples"
TURN = 2 * np.pi
HERMITE = tw.Controller(interpolation="hermite")


@pytest.mark.parametrize("number", [*range(4), *(pytest.param(one, marks=pytest.mark.proof) for one in range(4, 12))])
def test_peaks_are_those_of_the_cubics_and_limits_are_kept(number):
    _, motion, machine, sought = pvt_oracle.case(np.random.default_rng((7, number)))
    off, used = pvt_oracle.judge(motion, machine)
    assert off <= 1e-9
    assert used <= 1 + 1e-9 or not sought


@pytest.mark.parametrize("number", [2, *(pytest.param(one, marks=pytest.mark.proof) for one in (29, 48))])
def test_the_speed_that_is_sought_is_the_highest(number):
    """Oracle: any stated speed, by SciPy's cubics. A higher one breaks a limit or is refused, a lower one does not."""
    _, path, servo, machine, _ = pvt_oracle.setting(np.random.default_rng((8, number)))
    top = pvt_oracle.top_rpm(tw.drive(path, servo, machine))
    for share in (1.01, 1.3):
        assert not pvt_oracle.stated(path, servo, machine, share * top)[0]
    for share in (0.999999, 0.9):
        assert pvt_oracle.stated(path, servo, machine, share * top) == (True, pytest.approx(share * top, rel=1e-9))


def test_a_cubic_has_its_closed_form():
    """(t - 1)(t - 2)(t - 4) from 0 to 5 in one block: extremes at (7 ± sqrt 7) / 3, speed -7/3 at 7/3."""
    machine = tw.Machine(
        name="free", axes=dict.fromkeys("CXZ", tw.Axis()), spindle_rpm=1e9, block_rate_hz=1e9, controller=HERMITE
    )
    curve = np.polynomial.Polynomial.fromroots([1, 2, 4])
    time = np.array([0.0, 5.0])
    axes = {"C": time, "X": curve(time), "Z": curve(time / 2)}
    velocity = {"C": np.ones(2), "X": curve.deriv()(time), "Z": curve.deriv()(time / 2) / 2}
    limits = tw.check_limits(tw.Motion(time=time, axes=axes, velocity=velocity, machine=machine), machine)
    assert limits.travel["X"] == pytest.approx((-8, 12), rel=1e-14)
    assert limits.peak_speed["X"] == pytest.approx(curve.deriv()(5.0), rel=1e-14)
    assert limits.travel["Z"] == pytest.approx((-8, curve((7 - np.sqrt(7)) / 3)), rel=1e-14)
    assert limits.peak_speed["Z"] == pytest.approx(7.0, rel=1e-14)
    assert limits.peak_acceleration["Z"] == pytest.approx(14 / 4, rel=1e-14)
    assert limits.peak_jerk["Z"] == pytest.approx(6 / 8, rel=1e-13)
    time = np.array([1.0, 3.0])
    axes = {"C": time / 2, "X": curve(time), "Z": np.zeros(2)}
    velocity = {"C": np.full(2, 0.5), "X": curve.deriv()(time), "Z": np.zeros(2)}
    middle = tw.check_limits(tw.Motion(time=time, axes=axes, velocity=velocity, machine=machine), machine)
    # Speeds 3, -7/3 in between, and -1.
    assert middle.peak_speed["X"] == pytest.approx(3.0, rel=1e-14)
    assert middle.travel["X"] == pytest.approx((curve(3.0), curve((7 - np.sqrt(7)) / 3)), rel=1e-14)


@pytest.mark.parametrize("points", [24, 120])
def test_few_points_a_revolution_need_more_than_differences_show(points):
    """Acceleration of the cubics through a sine exceeds its own by (omega h)^2 / 12 and more, its differences less."""
    part = tw.Part(surface=tw.Expression("0.002*rho**2*cos(4*phi)"), radius=0.5)
    tool, servo = tw.Tool(nose_radius=0.05), tw.SlowToolServo(feed=0.02, points_per_rev=points)
    axes = {"C": tw.Axis(), "X": tw.Axis(), "Z": tw.Axis(acceleration=5.0)}
    machine = tw.Machine(
        name="lathe", axes=axes, spindle_rpm=1e4, block_rate_hz=1e5, dialect="pmac", controller=HERMITE
    )
    path = tw.place(servo.spiral(part, tool), part, tool)
    motion = tw.drive(path, servo, machine)
    _, used = pvt_oracle.judge(motion, machine)
    assert 0.99 < used <= 1 + 1e-9
    straight = replace(machine, controller=tw.Controller())
    _, rough = pvt_oracle.judge(replace(tw.drive(path, servo, straight), velocity=None), machine)
    assert rough > 1 + 1 / points


@pytest.mark.parametrize(("per_turn", "rpm"), every_second([24, 60], [50.0, 200.0, None]))
def test_a_plunge_keeps_the_limits_too(per_turn, rpm, tmp_path):
    """Where C needs more than a turn to come to speed it fell back at every turn of the plunge, in one block.

    Oracle: dense samples of the cubics of positions and velocities. On a sine grid, where coming to speed divides
    blocks, the plunge took over the tiny ones of the pass.
    """
    machine = tw.Machine.load(EXAMPLES / "machines" / "pmac_lathe.toml")
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(90), clearance=np.deg2rad(15))
    for surface, radius in ((tw.Plane(), 1.0), (tw.SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5)), 1.5)):
        part = tw.Part(surface=surface, radius=radius)
        servo = tw.SlowToolServo(feed=0.02, points_per_rev=per_turn, spindle_rpm=rpm)
        motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
        written = tw.write_nc(motion, machine, tmp_path / "part.pmc", depth=0.02)
        plunge = written.approaches["finish"].plunge
        assert np.diff(plunge.time).min() >= (1 - 2e-3) / machine.block_rate_hz
        for letter, axis in machine.axes.items():
            if letter not in plunge.axes:
                continue
            _, peaks = pvt_oracle.peaks(plunge.time, plunge.axes[letter], plunge.velocity[letter])
            for kind, peak in zip(("speed", "acceleration", "jerk"), peaks, strict=True):
                limit = getattr(axis, kind)
                assert limit is None or peak <= limit * (1 + 1e-3), (letter, kind)
        # From rest to rest, down to the first point of the pass.
        for letter, values in plunge.axes.items():
            assert values[-1] == motion.axes[letter][0]
            assert plunge.velocity[letter][[0, -1]] == pytest.approx(0, abs=1e-12)
        fall = -np.diff(plunge.axes["Z"]) / np.diff(plunge.time)
        if isinstance(surface, tw.Plane):
            assert fall.max() <= 0.03 * (1 + 1e-9)


def test_with_a_fast_tool_c_comes_to_speed_in_its_first_block():
    """Oracle: the cubic over an angle d from rest to the speed w, in the time d / w, begins with 4 w^2 / d."""
    fast = tw.Machine.load("nanoform-fts-70")
    machine = replace(fast, dialect="pmac", controller=tw.Controller(interpolation="hermite"))
    turned = np.deg2rad(np.arange(0, 1081.0))
    axes = {"C": turned, "X": 1 - 0.02 / TURN * turned, "Z": 0 * turned, "W": 0.001 * np.cos(3 * turned)}
    motion = tw.Motion(time=turned / 2.0, axes=axes, machine=machine)
    steps = np.diff(motion.axes["C"][motion.blocks])
    step = min(steps[0], steps[-1])
    limits = tw.check_limits(motion, machine)
    assert limits.peak_acceleration["C"] == pytest.approx(4 * 2.0**2 / step, rel=1e-9)
    spindle = replace(fast.axes["C"], acceleration=1.0)
    slow = replace(machine, axes={**machine.axes, "C": spindle})
    assert any("C acceleration" in one for one in tw.check_limits(motion, slow).findings)
