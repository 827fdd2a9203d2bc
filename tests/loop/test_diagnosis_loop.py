"""Errors put into the tool and the machine are found in the surface that the simulator makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import model_trials
import turnwright as tw
from model_trials import FLAT, MACHINE, SPHERE, TOOL, model_maps
from turnwright.diagnosis.model import Deviations
from turnwright.metrology.smoothing import form_compensation

FEED = 0.005
TRIALS = 6
"""Of those of which a proof makes a hundred and more."""


def cut(part, tool=TOOL, machine=MACHINE, planned=TOOL, per_turn=24, size=45, feed=FEED):
    """Measured map of a part that was planned with one tool and cut with another."""
    servo = tw.SlowToolServo(feed=feed, points_per_rev=per_turn, spindle_rpm=60)
    motion = tw.drive(tw.place(servo.spiral(part, planned), part, planned), servo, MACHINE)
    x = np.linspace(-4.96, 4.96, size)
    made = tw.generate(motion, tool, x=x, y=x, machine=machine)
    return replace(made, z=np.where(np.hypot(*made.points()) < 4.96, made.z, np.nan))


def noisy(heights, seed, noise=2e-5):
    return replace(heights, z=heights.z + np.random.default_rng(seed).normal(0, noise, heights.z.shape))


def along_normal(heights):
    """What an interferometer shows: distance from the sphere of best fit, along its normal, at its own points."""
    x, y = heights.points()
    there = np.isfinite(heights.z)
    points = np.stack([x[there], y[there], heights.z[there]], axis=1)

    def off(sphere):
        return np.linalg.norm(points - sphere[:3], axis=1) - sphere[3]

    sphere = least_squares(off, [0.01, 0.01, 10.0, 10.0], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    radius = np.linalg.norm(points - sphere[:3], axis=1)
    foot = sphere[:3] + (points - sphere[:3]) * (sphere[3] / radius)[:, None]
    return tw.HeightMap(x=foot[:, 0], y=foot[:, 1], z=sphere[3] - radius)


@pytest.fixture(scope="module")
def ogive():
    return cut(SPHERE, replace(TOOL, offset=(0.005, 0.0, 0.0)))


@pytest.mark.parametrize("reference", ["true form", "best-fit sphere", "best-fit sphere, along its normal"])
def test_an_offset_is_found_on_a_sphere(ogive, reference):
    """5 um within 4 % where the map is clean, 0.5 um with 20 nm noise: drift of Z and squareness look much alike."""
    views = {"true form": ogive, "best-fit sphere": tw.remove_form(ogive, "sphere")}
    seen = views.get(reference) or along_normal(ogive)
    for heights, within in ((seen, 2e-4), *((noisy(seen, seed), 5e-4) for seed in range(1))):
        found = tw.diagnose(heights, SPHERE, TOOL, MACHINE, reference=reference, feed=FEED)
        first = found[0]
        assert first.name == "offset x"
        assert sum(finding.verdict == "correct" for finding in found) <= 2  # one in twenty by chance
        assert first.value == pytest.approx(0.005, abs=within)
        assert first.interval[0] < 0.005 < first.interval[1]
        assert first.verdict == "correct"
        assert found.tool.offset == pytest.approx((0.005, 0, 0), abs=within)
        (move,) = tw.diagnosis.moves(found)
        assert move.axis == "X"
        assert move.by == pytest.approx(-0.005, abs=within)
        # A sphere has no azimuth, and a departure from one no radius.
        assert not found["offset y"].determined
        assert not found["servo lag"].determined
        if reference != "true form":
            assert not found["radius error"].determined


def test_a_stated_noise_is_the_least_that_the_intervals_know(ogive):
    """Oracle: in a least squares the standard deviations are as the noise. Less than the map shows changes nothing."""
    steady = replace(MACHINE, plausible={"drift of X": 1e-7, "drift of Z": 1e-7})

    def found(noise_nm):
        one = tw.diagnose(
            noisy(ogive, 1), SPHERE, TOOL, steady, feed=FEED, error_sources=["offset x"], noise_nm=noise_nm
        )
        return one.noise_nm[0], one["offset x"].standard_uncertainty

    shown, plain = found(0.0)
    assert shown == pytest.approx(20, rel=0.05)
    assert found(5.0) == (shown, plain)
    (noise, wide), (larger, wider) = found(50.0), found([100.0])
    assert (noise, larger) == pytest.approx((50, 100))
    assert wide == pytest.approx(plain * noise / shown, rel=0.15)
    assert wider == pytest.approx(2 * wide, rel=0.05)
    with pytest.raises(tw.InputError, match="noise_nm has 2 values for 1 maps"):
        found([1.0, 2.0])


def test_the_rule_of_the_handbook_is_for_small_angles(ogive):
    """Right for a fit of least PV on a flat sphere; a third too much for least squares at 30 degrees."""
    # The ogive |r| d / R less the parabola of least PV, by a fine search over parabolas through both ends.
    r = np.linspace(0, 1, 20001)
    bows = np.linspace(0.5, 1.5, 401)
    pv = min(np.ptp(r - bow * r * r) for bow in bows) * 0.005 / 100.0
    assert tw.diagnosis.handbook_offset(pv, 100.0, 2.0) == pytest.approx(0.005, rel=1e-4)
    seen = np.ptp(tw.remove_form(ogive, "sphere").z[np.isfinite(ogive.z)])
    assert tw.diagnosis.handbook_offset(seen, 10.0, 10.0) == pytest.approx(0.0067, abs=2e-4)


@pytest.mark.parametrize("powers", [(3, 4, 5), pytest.param((1, 2, 3), marks=pytest.mark.proof)])
def test_intervals_hold_what_they_say(powers):
    """Offset, radius error, squareness and waviness together: in 90 % of their intervals, none missed twice.

    `tests.proof.proof_coverage` has hundreds, and `tests.proof.proof_intervals` parts that are cut by brute force.
    """
    hits, widths, left = model_trials.sources(powers, TRIALS)
    assert left == pytest.approx(np.full(TRIALS, 20), rel=0.07)
    assert (hits >= TRIALS - 1).all(), hits
    assert hits.sum() >= 0.9 * TRIALS * hits.size, hits
    if powers == (3, 4, 5):  # and they say something
        usual = np.median(widths, axis=0)
        assert (usual[:4] < model_trials.NARROW).all(), usual


def test_neighbours_that_err_together_widen_the_intervals():
    """Noise that hangs together over a twentieth of the part, of which 30 points count as one."""
    hits, together = model_trials.neighbours(TRIALS)
    assert hits >= 0.9 * TRIALS
    assert np.median(together) == pytest.approx(model_trials.AS_ONE, rel=0.5)


@pytest.mark.parametrize("rake", [0.0, pytest.param(-15.0, marks=pytest.mark.proof)])
def test_a_toroid_is_corrected_in_one_step(rake):
    """Everything at once on a part that is not round; cut again with what was found, it is as if nothing was wrong."""
    planned = replace(TOOL, rake=np.deg2rad(rake))
    part = tw.Part(surface=tw.Toroid(radius_x=12.0, radius_y=16.0), radius=5.0)
    real = replace(planned, offset=(0.003, -0.004, 0.0), radius_error=0.002, waviness=(0.0, 0.0, 2e-3, -1e-3))
    machine = replace(MACHINE, squareness=-2e-5)
    per_turn = {"per_turn": 720, "size": 41, "feed": 0.004}
    first = noisy(cut(part, real, machine, planned, **per_turn), 1, 5e-6)
    found = tw.diagnose(first, part, planned, MACHINE, feed=0.004)
    assert found.measured_rms_nm > 50
    assert found.unexplained_rms_nm < 6.5
    assert {finding.name for finding in found if finding.verdict == "correct"} >= {"offset x", "offset y"}
    servo = tw.SlowToolServo(feed=0.004, points_per_rev=720, spindle_rpm=60)
    # What no source explains for certain is taken off the surface.
    added = form_compensation(part, found.remainders[0], cutoff=0.5, beyond=2.0).table
    aim = replace(part, surface=part.surface + added)
    motion = tw.drive(tw.place(servo.spiral(aim, found.tool), aim, found.tool), servo, found.machine)
    again = tw.generate(motion, real, x=first.x, y=first.y, machine=machine)
    again = replace(again, z=np.where(np.isfinite(first.z) & (np.hypot(*again.points()) > 0.1), again.z, np.nan))
    left = tw.diagnose(again, part, found.tool, found.machine, feed=0.004)
    # Beyond a change of pose; cusps of 0.5 nm rms are among it.
    assert left.measured_rms_nm < 1.2


def test_an_error_that_does_not_repeat_is_reported():
    """The offset shifts between two maps, the squareness stays."""
    made = model_maps([FLAT])
    rng = np.random.default_rng(4)
    maps = []
    for shift in (0.002, 0.005):
        maps += made(Deviations(offset=(shift, 0.001, 0.0), squareness=4e-5), rng, 2e-5)
    found = tw.diagnose(maps, FLAT, TOOL, MACHINE, error_sources=("offset x", "offset y", "squareness"))
    moved = found["offset x"]
    assert moved.repeatable is False
    # An axial motion of 30 nm once in a turn is plausible, 0.6 um of offset on this flat.
    assert moved.map_values == pytest.approx((0.002, 0.005), abs=5e-4)
    assert moved.value == pytest.approx(0.0035, abs=3e-4)
    assert moved.interval[0] < 0.002
    assert moved.interval[1] > 0.005
    assert found["squareness"].repeatable is True
    assert found["squareness"].value == pytest.approx(4e-5, abs=5e-6)
    low, high = found["squareness"].interval  # a drift of 100 nm from rim to axis is plausible, which is 20 urad
    assert low < 4e-5 < high


def test_a_lag_needs_a_fiducial():
    """On a part that is not round the lag of Z looks like a clocking, and is separated from it if the pose is known."""
    part = tw.Part(surface=tw.XYPolynomial(terms={(2, 0): 0.03, (0, 2): 0.04, (3, 0): 0.001}), radius=5.0)
    (heights,) = model_maps([part])(Deviations(late=2e-4), np.random.default_rng(5), 2e-5)
    asked = {"error_sources": ("servo lag", "offset x"), "waviness": (3,)}
    hidden = tw.diagnose(heights, part, TOOL, MACHINE, **asked)["servo lag"]
    assert not hidden.determined
    assert "fiducial" in hidden.explanation
    seen = tw.diagnose(heights, part, TOOL, MACHINE, free=("piston", "tilt", "decentre"), **asked)["servo lag"]
    assert seen.determined
    assert seen.interval[0] < 2e-4 < seen.interval[1]
    assert seen.interval[0] < 2e-4 < seen.interval[1]
    assert seen.standard_uncertainty < 1.5e-4  # an axial motion of the spindle could do nearly the same


def test_a_piston_hides_the_offset_along_z():
    (heights,) = model_maps([SPHERE])(Deviations(offset=(0.0, 0.0, 0.003)), np.random.default_rng(6), 2e-5)
    assert not tw.diagnose(heights, SPHERE, TOOL, MACHINE, error_sources=("offset z",))["offset z"].determined
    seen = tw.diagnose(heights, SPHERE, TOOL, MACHINE, error_sources=("offset z",), free=("tilt", "decentre"))
    assert seen["offset z"].value == pytest.approx(0.003, abs=5e-5)
    assert tw.diagnosis.moves(seen)[0].axis == "Z"


def test_a_bent_mount_and_a_cause_of_ones_own():
    (heights,) = model_maps([SPHERE])(Deviations(), np.random.default_rng(7), 2e-5)
    x, y = heights.points()
    bent = replace(heights, z=heights.z + 3e-4 * (x * x - y * y) / 25 + 1e-4 * np.cos(x))
    ripple = tw.diagnosis.ErrorSource(name="ripple", signature=lambda cutting: np.cos(cutting.x), typical=1e-3)
    found = tw.diagnose(bent, SPHERE, TOOL, MACHINE, error_sources=("astigmatism", ripple))
    assert found["astigmatism cos"].value == pytest.approx(3e-4, rel=0.02)
    assert found["astigmatism cos"].verdict == "do not correct"
    assert found["ripple"].value == pytest.approx(1e-4, rel=0.05)
    assert abs(found["ripple"].value - 1e-4) < 3 * found["ripple"].standard_uncertainty
    assert np.nanstd(found.residual.z) * 1e6 == pytest.approx(20, rel=0.05)


def test_a_residual_pose_is_found_with_the_error_sources():
    """Registered to within 20 um and 0.2 mrad: the rest does not pass for an error of the tool."""
    part = tw.Part(surface=tw.Toroid(radius_x=12.0, radius_y=16.0), radius=5.0)
    (heights,) = model_maps([part])(Deviations(offset=(0.002, 0.003, 0.0)), np.random.default_rng(8), 5e-6)
    off = tw.Pose(shift=(0.02, -0.015, 0.001), rotation=3e-4, tilt=(2e-4, -1e-4))
    found = tw.diagnose(heights.moved(off), part, TOOL, MACHINE, error_sources=("offset x", "offset y"))
    assert found["offset x"].interval[0] < 0.002 < found["offset x"].interval[1]
    assert found["offset y"].interval[0] < 0.003 < found["offset y"].interval[1]
    assert found.unexplained_rms_nm == pytest.approx(5, rel=0.05)


@pytest.mark.parametrize(("dy", "shape"), [(0.02, "cone"), (-0.02, "cylinder")])
def test_the_core_at_the_centre_is_as_wide_as_the_tip_is_off(dy, shape):
    """The simulator leaves the core open, |dy| wide; a cone or a cylinder is put there."""
    servo = tw.SlowToolServo(feed=0.002, points_per_rev=180, spindle_rpm=60)
    motion = tw.drive(tw.place(servo.spiral(SPHERE, TOOL), SPHERE, TOOL), servo, MACHINE)
    x = np.linspace(-0.1, 0.1, 121)
    made = tw.generate(motion, replace(TOOL, offset=(0.0, dy, 0.0)), x=x, y=x)
    r = np.hypot(*made.points())
    assert np.isnan(made.z[r < 0.0195]).all()
    assert np.isfinite(made.z[(r > 0.0205) & (r < 0.1)]).all()
    cone = 0.002 * (1 - r / 0.02)
    core = np.where(np.isnan(made.z), SPHERE.surface.sag(*made.points()) + (cone if dy > 0 else 0.002), made.z)
    found = tw.diagnosis.centre_defect(replace(made, z=core), SPHERE, within=0.08)
    assert found.shape == shape
    assert found.radius == pytest.approx(0.02, abs=0.001)
    assert found.offset_y == pytest.approx(dy, abs=0.001)
    assert found.height == pytest.approx(0.002, rel=0.1)
    assert ("lower" if dy > 0 else "raise") in found.sentence
    whole = replace(made, z=SPHERE.surface.sag(*made.points()))
    assert tw.diagnosis.centre_defect(noisy(whole, 1, 1e-6), SPHERE, within=0.08) is None


def test_spikes_do_not_pull():
    """One point of a hundred is off by up to 20 um: it is left out of the fit, and stays in the residual."""
    (heights,) = model_maps([SPHERE])(Deviations(offset=(0.001, 0.0, 0.0)), np.random.default_rng(9), 2e-5)
    rng = np.random.default_rng(10)
    hit = np.isfinite(heights.z) & (rng.random(heights.z.shape) < 0.01)
    spiky = replace(heights, z=heights.z + hit * rng.uniform(0.001, 0.02, hit.shape))
    clean, found = (tw.diagnose(one, SPHERE, TOOL, MACHINE) for one in (heights, spiky))
    assert found.rejected == (hit.sum(),)
    assert clean.rejected == (0,)
    assert found["offset x"].value == pytest.approx(clean["offset x"].value, abs=1e-4)
    assert np.nanmin(found.residual.z[hit]) > 9e-4


def test_what_is_not_corrected_is_left_to_the_form():
    """Oracle: the injected noise itself, less the plane that the pose takes."""
    side = np.linspace(-5, 5, 81)
    x, y = np.meshgrid(side, side)
    z = np.where(np.hypot(x, y) < 5, 2e-5 * np.random.default_rng(4).normal(size=x.shape), np.nan)
    part = tw.Part(surface=tw.Plane(slope=(0.0, 0.0)), radius=5.0)
    tool, machine = tw.Tool(nose_radius=1.0, included=np.deg2rad(100)), tw.Machine.load("generic")
    found = tw.diagnose(tw.HeightMap(x=side, y=side, z=z), part, tool, machine)
    assert not [one.name for one in found if one.verdict == "correct"]
    assert found.explained_rms_nm < 3.5  # of 20 nm: 182 terms of 5,000 points can take 3.8
    assert (found.tool.offset, found.tool.radius_error, found.tool.waviness) == ((0, 0, 0), 0, tool.waviness)
    assert found.machine.squareness == 0
    # Form and residual are all of it.
    every = found.remainders[0].z + found.residual.z
    seen = ~np.isnan(every)
    plane = np.stack([np.ones(seen.sum()), x[seen], y[seen]], axis=1)
    left, flat = (one - plane @ np.linalg.lstsq(plane, one)[0] for one in (every[seen], z[seen]))
    np.testing.assert_allclose(left, flat, atol=3e-7)  # a decentred axis of turning takes the rest
    assert np.nanstd(found.residual.z) * 1e6 == pytest.approx(20, rel=0.03)


@pytest.mark.proof
def test_a_part_that_uses_little_of_the_nose_is_diagnosed_too():
    """On 0.3 deg of sweep all powers look alike, and none may grow until no edge has a contact. Oracle: the offset."""
    grid = tw.Part(surface=tw.SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5)), radius=5.0)
    # Chords of 720 points in a turn would make 3 nm, which look like a drift of X.
    found = tw.diagnose(
        cut(grid, replace(TOOL, offset=(0.002, 0.0, 0.0)), per_turn=2880), grid, TOOL, MACHINE, feed=FEED
    )
    assert [one.name for one in found if one.verdict == "correct"] == ["offset x"]
    low, high = found["offset x"].interval
    assert low < 0.002 < high
    assert found["offset x"].value == pytest.approx(0.002, abs=2e-4)


@pytest.mark.parametrize("offset", [pytest.param(0.0, marks=pytest.mark.proof), 0.003])
def test_cusps_are_not_taken_for_waves_of_the_nose(offset):
    """Cusps of 24 nm, seen at pixels of eight feeds, on slopes of 0.4 deg, where waves could bend the nose at will."""
    grid = tw.Part(surface=tw.SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5)), radius=5.0)
    tool = tw.Tool(nose_radius=0.514, included=np.deg2rad(60), clearance=np.deg2rad(10))
    actual = replace(tool, offset=(offset, 0.0, 0.0))
    seen = cut(grid, actual, planned=tool, per_turn=2880, size=121, feed=0.01)
    for some in ({"error_sources": ("offset x", "waviness")}, {}):
        found = tw.diagnose(seen, grid, tool, MACHINE, feed=0.01, **some)
        low, high = found["offset x"].interval
        assert low <= offset <= high
        assert found["offset x"].value == pytest.approx(offset, abs=5e-5)
        assert found.unexplained_rms_nm < 7.5  # of cusps alone: feed²/(8 R) · 2/sqrt(45) = 7.25 nm
