"""Kong et al. 2019 (Science Progress): spheres on a toric base by a fast tool on a slow slide.

Toric base R 500/250 mm, spheres R 10 mm of 1 mm aperture at 2 mm, nose 0.025 mm, 100 rev/min, 10 um/rev, part of 15 mm.
The aperture is taken as a diameter, spheres as concave; the path is examined in a band of 0.3 mm.
"""

import numpy as np
import pytest

import turnwright as tw
from turnwright.placing import tip_height

R, LENS, APERTURE, PITCH, RIM = 0.025, 10.0, 0.5, 2.0, 7.5
DEPTH = LENS - np.sqrt(LENS**2 - APERTURE**2)
OMEGA = 2 * np.pi * 100 / 60
BASE = tw.Toroid(radius_x=500.0, radius_y=250.0)
ARRAY = tw.LensArray.square(
    pitch=PITCH,
    within=RIM,
    aperture=APERTURE,
    lenslet=tw.Sphere(radius=LENS).placed(shift=(0, 0, -DEPTH)),
    surround=0.0,
)
PART = tw.Part(surface=BASE + ARRAY, radius=RIM)
TOOL = tw.Tool(nose_radius=R, included=np.deg2rad(120), clearance=np.deg2rad(12))
PLAN = tw.SlowToolServo(feed=0.010, spindle_rpm=100, points_per_rev=1440)
MACHINE = tw.Machine.load("nanoform-fts-70")


@pytest.fixture(scope="module")
def path():
    """Return 30 turns of the spiral, across the lenses at 6 mm."""
    whole = PLAN.spiral(PART, TOOL)
    first = np.searchsorted(-whole.radius, -6.2)
    band = slice(first, first + 30 * 1440 + 1)
    return tw.place(tw.Spiral(angle=whole.angle[band], radius=whole.radius[band]), PART, TOOL)


def test_37_of_the_49_lenses_are_whole():
    assert ARRAY.centres.shape == (37, 2)
    x, y = np.meshgrid(PITCH * np.arange(-3, 4), PITCH * np.arange(-3, 4))
    assert np.count_nonzero(np.hypot(x, y) + APERTURE <= RIM) == 37
    # Even the lens at a corner's middle is outside the part.
    assert np.hypot(6, 6) > RIM


def test_compensating_base_and_lenses_apart_errs(path):
    """Where the edge touches within one lens it is R s1 s2 / (1 - R k) to second order in the slopes."""
    at = {"angle": path.angle, "radius": path.radius, "sense": 1}
    apart = tip_height(BASE, TOOL, **at) + tip_height(ARRAY, TOOL, **at)
    off = apart - path.z
    assert 20e-6 < np.abs(off).max() < 30e-6  # mm: tens of nanometres
    cosine, sine = np.cos(path.angle), np.sin(path.angle)
    slopes = []
    for surface in (BASE, ARRAY):
        zx, zy = surface.gradient(path.radius * cosine, path.radius * sine)
        slopes.append(zx * cosine + zy * sine)
    middle = np.hypot(path.radius * cosine - 6, path.radius * sine) < 0.4
    law = -R * slopes[0] * slopes[1] / (1 - R / LENS)
    assert off[middle] == pytest.approx(law[middle], abs=0.02 * np.abs(law[middle]).max())


def test_a_split_by_design_gives_the_slide_the_torus(path):
    servo = tw.HybridToolServo(plan=PLAN, base=BASE, tool=TOOL)
    motion = tw.drive(path, servo, MACHINE)
    assert np.abs(motion.axes["Z"] + motion.axes["W"] - path.z).max() < 1e-9
    limits = tw.check_limits(motion, MACHINE)
    # The torus is r^2/4 (1/250 + 1/500 +- (1/250 - 1/500) cos 2 theta) to 4th order, the sphere is a cap.
    wave = 6.2**2 / 4 * (1 / 250 - 1 / 500)
    assert limits.peak_acceleration["Z"] == pytest.approx(wave * (2 * OMEGA) ** 2, rel=5e-3)
    assert limits.peak_speed["Z"] == pytest.approx(wave * 2 * OMEGA, rel=5e-3)
    assert np.ptp(limits.travel["W"]) == pytest.approx(DEPTH, abs=0.2e-3)
    steepest = APERTURE / np.sqrt(LENS**2 - APERTURE**2)
    assert limits.peak_speed["W"] == pytest.approx(steepest * OMEGA * 6.0, rel=0.04)


def test_the_slide_is_found_that_shakes_least(path):
    """Within 70 um the slide alone moves what takes longer than a revolution; within 40 um the tool helps more."""
    by_design = tw.check_limits(tw.drive(path, tw.HybridToolServo(plan=PLAN, base=BASE, tool=TOOL), MACHINE), MACHINE)
    for stroke, most in ((0.070, 0.15), (0.040, 0.5)):
        servo = tw.HybridToolServo(plan=PLAN, fast=tw.Axis(low=-stroke / 2, high=stroke / 2))
        motion = tw.drive(path, servo, MACHINE)
        assert np.abs(motion.axes["Z"] + motion.axes["W"] - path.z).max() < 1e-9
        limits = tw.check_limits(motion, MACHINE)
        assert max(np.abs(limits.travel["W"])) <= stroke / 2
        assert limits.peak_acceleration["Z"] < most * by_design.peak_acceleration["Z"]


def test_few_blocks_of_the_lathe_are_enough(path):
    servo = tw.HybridToolServo(plan=PLAN, base=BASE, tool=TOOL, blocks_per_rev=180)
    motion = tw.drive(path, servo, MACHINE)
    limits = tw.check_limits(motion, MACHINE)
    assert np.abs(motion.axes["Z"] + motion.axes["W"] - path.z).max() < 1e-9
    assert limits.block_rate_hz == pytest.approx(180 * 100 / 60)
    # The rims of the lenses are slope discontinuities, of which more than 10 nm is faster than the tool.
    assert all(one.startswith("W bandwidth") for one in limits.findings), limits.findings


@pytest.mark.parametrize("by", ["position", "time"])
def test_both_ways_to_synchronise_bring_the_compound_path_back(path, by, tmp_path):
    """To half a nanometre of the program and 0.05 nm of the table; by time also what 50 kHz leaves out at a rim."""
    motion = tw.drive(path, tw.HybridToolServo(plan=PLAN, base=BASE, tool=TOOL, blocks_per_rev=180), MACHINE)
    file = tmp_path / "kong.nc"
    done = tw.post.write_fast_tool(motion, MACHINE, file, by=by, rate_hz=50_000.0 if by == "time" else None)
    again = tw.post.read_fast_tool(file, MACHINE)
    tip = np.interp(motion.time - motion.time[0], again.time, again.axes["Z"] + again.axes["W"])
    # Angle and time are rounded too: 5e-7 deg and 1e-9 of a block, on slopes of 0.3 mm/rad.
    assert np.abs(tip - path.z).max() < 0.5e-6 + max(done.off, 0.05e-6) + 0.02e-6
    assert done.off < (0.1e-6 if by == "position" else 20e-6)
