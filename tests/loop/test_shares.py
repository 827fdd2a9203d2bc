"""Each share of the error is found where it was put."""

import math
from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from turnwright.heightmap import HeightMap
from turnwright.job import Job, break_down_error, plan, run
from turnwright.job.contributions import exact_motion
from turnwright.job.prediction import Prediction
from turnwright.machine import Axis, Machine, SecondOrder
from turnwright.motion import drive
from turnwright.part import Part
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.strategy import SlowToolServo
from turnwright.surface import Plane, SineGrid
from turnwright.tool import Tool

FEED, NOSE = 0.01, 0.5
SERVO = SecondOrder(frequency_hz=100, damping=0.7, velocity_feedforward=1.0)


def planned(surface, servo, response=None):
    part, tool = Part(surface=surface, radius=1.0), Tool(nose_radius=NOSE)
    axes = {letter: Axis(response=response if letter == "Z" else None) for letter in "CXZ"}
    machine = Machine(name="lathe", axes=axes, spindle_rpm=1500, block_rate_hz=1e6)
    spiral = servo.spiral(part, tool)
    return part, tool, spiral, drive(place(spiral, part, tool), servo, machine)


@pytest.mark.parametrize("turns", [0, 1e4, 1e5])
def test_the_ends_of_a_spiral_stand_once(turns):
    """At every one of 720 azimuths in a turn, and once more at its end."""
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    turned = turns * 2 * np.pi + np.linspace(0, 2 * np.pi, 145)
    spiral = Spiral(angle=turned, radius=np.linspace(1, 0.99, 145))
    machine = Machine(name="lathe", axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=1500, block_rate_hz=1e6)
    found = exact_motion(spiral, Part(surface=Plane(), radius=2.0), Tool(nose_radius=NOSE), machine, angle)
    assert found.time.size == 721


def test_an_exact_path_is_exact_at_uneven_azimuths_too():
    """Oracle: the height of a tip on a tilted plane, tan(t) X cos(C) + R (sec(t') - 1), at the very azimuths."""
    angle = np.sort(np.random.default_rng(5).uniform(0, 2 * np.pi, 37))
    turned = np.linspace(-1.0, 40.0, 3000)
    tilted, slope = Plane(slope=(0.1, 0.0)), 0.1
    machine = Machine(name="lathe", axes=dict.fromkeys("CXZ", Axis()), spindle_rpm=1500, block_rate_hz=1e6)
    for sense in (1, -1):
        spiral = Spiral(angle=sense * turned, radius=np.linspace(1.0, 0.5, 3000))
        found = exact_motion(spiral, Part(surface=tilted, radius=2.0), Tool(nose_radius=NOSE), machine, angle)
        c, x = found.axes["C"], found.axes["X"]
        wanted = slope * x * np.cos(c) + NOSE * (np.sqrt(1 + (slope * np.cos(c)) ** 2) - 1)
        assert np.abs(found.axes["Z"] - wanted).max() < 1e-12
        passed = np.sort((angle + 2 * np.pi * np.arange(-9, 9)[:, None]).ravel())
        inside = passed[(passed > c.min()) & (passed < c.max())]
        assert np.sort(c)[1:-1] == pytest.approx(inside, abs=1e-12)


def test_a_flat_has_cusps_alone():
    """Oracle: R - sqrt(R² - f²/4), with a quarter of a feed past the axis."""
    found = break_down_error(
        *planned(Plane(), SlowToolServo(feed=FEED, points_per_rev=36, spindle_rpm=60, overrun=FEED / 4))
    )
    height = (NOSE - math.sqrt(NOSE**2 - FEED**2 / 4)) * 1e6
    assert found.cusp_nm == pytest.approx(height, rel=0.01)  # 12 samples a feed may miss the top by that
    assert found.pv_nm == pytest.approx(found.cusp_nm, rel=1e-9)
    assert found.sq_nm == pytest.approx(height * math.sqrt(4 / 45), rel=0.03)
    assert found.chord_nm < 1e-6
    assert found.rounding_nm == found.tracking_nm == 0


def test_the_cusp_at_the_axis_counts_in_full():
    """Oracle: R - sqrt(R² - (3f/4)²), where the last half turn of a spiral to the axis meets the turn before it."""
    found = break_down_error(*planned(Plane(), SlowToolServo(feed=FEED, points_per_rev=36, spindle_rpm=60)))
    height = (NOSE - math.sqrt(NOSE**2 - (3 * FEED / 4) ** 2)) * 1e6
    assert found.cusp_nm == pytest.approx(height, rel=1e-6)
    assert found.pv_nm == pytest.approx(height, rel=1e-6)


def test_contributions_add_up_to_the_form_error():
    """Oracle: a sum of extremes is no less than the extreme of a sum; a steep part whose tip is off its cut."""
    servo = SlowToolServo(feed=FEED, chord=2e-6, spindle_rpm=60)
    found = break_down_error(
        *planned(Plane(slope=(0.3, 0.2)) + SineGrid(amplitude=(0.002, 0.002), period=(0.5, 0.5)), servo)
    )
    parts = found.cusp_nm + 2 * (found.chord_nm + found.rounding_nm + found.tracking_nm)
    assert max(found.cusp_nm, found.cusp_away_nm) <= found.pv_nm * 1.05
    assert found.pv_nm <= parts * 1.001


def test_points_err_by_their_chord():
    """Oracle: the tolerance that the strategy keeps is reached, and not passed, somewhere on the part."""
    grid = SineGrid(amplitude=(0.002, 0.002), period=(0.5, 0.5))
    found = break_down_error(*planned(grid, SlowToolServo(feed=FEED, chord=5e-6, spindle_rpm=60)))
    assert 4.5 < found.chord_nm <= 5.0 * 1.02  # 2 % for slopes: the tip is off by 5 nm, the surface is hit elsewhere


def test_servos_err_by_their_response():
    """Oracle: on a tilted flat Z is a sine once a turn, and errs by |H - 1| of its amplitude at the rim."""
    slope, rpm = 0.001, 600.0
    servo = SlowToolServo(feed=FEED, points_per_rev=360, spindle_rpm=rpm)
    found = break_down_error(*planned(Plane(slope=(slope, 0.0)), servo, SERVO))
    expected = abs(SERVO.at(rpm / 60) - 1) * slope * 1.0 * 1e6
    assert found.tracking_nm == pytest.approx(expected, rel=0.02)  # the outermost pass stands within a feed of the rim
    # Over the area, the mean of (r cos)² on a disc of radius 1 is 1/4; the cusps add to it.
    cusps = break_down_error(*planned(Plane(slope=(slope, 0.0)), servo)).rms_nm
    assert math.sqrt(found.rms_nm**2 - cusps**2) == pytest.approx(expected / 2, rel=0.02)


def test_rms_of_a_polar_map_is_over_its_area():
    """Oracle: the mean of r⁴ on a disc of radius 1 is 1/3, of all samples alike 1/5."""
    radius, angle = np.linspace(0, 1, 2001), np.linspace(0, 2 * np.pi, 60, endpoint=False)
    bowl = HeightMap(z=np.tile(1e-6 * radius**2, (60, 1)), radius=radius, angle=angle)
    found = Prediction(name="whole part", error=bowl, roughness=None, tracking=bowl)
    assert found.tracking_nm == pytest.approx((1.0, math.sqrt(1 / 3)), rel=2e-3)


def test_decimals_err_by_what_was_moved():
    """Oracle: Z moved by a known constant."""
    part, tool, spiral, motion = planned(Plane(), SlowToolServo(feed=FEED, points_per_rev=36, spindle_rpm=60))
    moved = replace(motion, axes={**motion.axes, "Z": motion.axes["Z"] + 3e-6})
    assert break_down_error(part, tool, spiral, motion, program_motion=moved).rounding_nm == pytest.approx(
        3.0, rel=1e-6
    )


@pytest.mark.parametrize(
    "response",
    [
        pytest.param(None, marks=pytest.mark.proof),
        {"frequency": "100 Hz", "damping": 0.7, "velocity_feedforward": 1.0},
    ],
)
def test_a_plan_keeps_its_tolerances(response, tmp_path):
    """Oracle: the whole pipeline, run on the planned job with its own grids, and the machine's limits."""
    lathe = tmp_path / "lathe.toml"
    answer = (
        "response = {frequency = '100 Hz', damping = 0.7, velocity_feedforward = 1.0}\n" if response is not None else ""
    )
    lathe.write_text(
        "name = 'lathe'\nspindle_rpm = 1500\nblock_rate_hz = 1000\ndialect = 'nanotech'\n"
        f"[axes.C]\n{answer}[axes.X]\n{answer}[axes.Z]\nacceleration = '1000 mm/s^2'\n{answer}"
    )
    job = Job.read(
        {
            "part": {
                "surface": {"family": "sine grid", "amplitude": ["1 um", "1 um"], "period": ["1 mm", "1 mm"]},
                "radius": "0.5 mm",
            },
            "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
            "machine": {"name": str(lathe)},
            "strategy": {"kind": "slow tool servo", "feed": "1 um/rev", "points_per_rev": 360, "overrun": "1 um"},
            "tolerances": {"form_pv": "100 nm", "sq": "8 nm"},
            "simulation": {
                "whole_part": {"radii": 500, "angles": 60},
                "patches": [
                    {"name": "place", "centre": ["0.35 mm", "0 mm"], "size": ["60 um", "60 um"], "pixel": "1 um"}
                ],
            },
        }
    )
    chosen = plan(job)
    assert chosen.limits.ok
    assert chosen.breakdown.pv_nm <= 100
    assert chosen.breakdown.sq_nm <= 8
    assert chosen.breakdown.sq_nm > 5, "the finish tolerance is used up"
    if response is not None:
        assert chosen.breakdown.tracking_nm > 5, "the speed is used up"
    result = run(chosen.job)
    assert result.limits.points == chosen.limits.points
    assert result.limits.cycle_time_s == pytest.approx(chosen.limits.cycle_time_s, rel=1e-3)
    whole, place_ = (one.roughness for one in result.predictions)
    assert whole.pv_nm <= 100
    assert place_.sq_nm <= 8
    assert np.isfinite(result.rounding_nm)


@pytest.mark.parametrize(
    ("sense", "inside_out", "clocking"),
    [(1, False, 1.1), (-1, True, 1.1), pytest.param(1, True, 0.3, marks=pytest.mark.proof)],
)
def test_decimals_take_no_pass_away_at_an_azimuth(tmp_path, sense, inside_out, clocking):
    """Half a decimal of X, Z and C moves a surface by their slopes; a pass that ended on a line gave 270 to 318 nm."""
    design = tw.Toroid(radius_x=50, radius_y=25) + tw.SineGrid(amplitude=(2e-3, 1e-3), period=(0.8, 0.8))
    part = tw.Part(surface=design, radius=1.0)
    tool = tw.Tool(nose_radius=0.3, included=np.deg2rad(120), clearance=np.deg2rad(12))
    machine = replace(tw.Machine.load("generic"), convention=tw.machine.Convention(clocking=clocking))
    servo = tw.SlowToolServo(feed=0.02, points_per_rev=120, spindle_rpm=50, sense=sense, inside_out=inside_out)
    spiral = servo.spiral(part, tool)
    motion = tw.drive(tw.place(spiral, part, tool), servo, machine)
    tw.write_nc(motion, machine, tmp_path / "part.nc", depth=None)
    found = break_down_error(part, tool, spiral, motion, program_motion=tw.read_nc(tmp_path / "part.nc", machine))
    assert found.rounding_nm < 0.6
