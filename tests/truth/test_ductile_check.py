"""The ductile-mode check of the infrared lens, and its remedies against the chips that they lead to."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from turnwright.cutting.chip import RoundChip, chip_map
from turnwright.cutting.ductile_check import check_ductile, predict_chips
from turnwright.job import Job
from turnwright.material import CriticalThickness, Material
from turnwright.units import say_length

GLASS = Material.load("irg26")


@pytest.fixture(scope="module")
def lens():
    job = Job.load("examples/infrared_lens.toml")
    return job.part, job.tool, job.machine


def planned(lens, feed, stock, **tool):
    part, nose, machine = lens
    part, nose = replace(part, stock=stock), replace(nose, **tool)
    servo = tw.SlowToolServo(feed=feed, points_per_rev=180, spindle_rpm=20, lead_in=0.25)
    motion = tw.drive(tw.place(servo.spiral(part, nose), part, nose), servo, machine)
    points = np.arange(0, motion.axes["C"].size, max(1, motion.axes["C"].size // 20_000))
    return part, nose, motion, points


def test_the_infrared_lens_is_ductile_in_finishing(lens):
    """Issue: 7.5 um and 2 um/rev give about 200 nm. Oracle: the chip on a flat, curvature changes it by 1.5 %."""
    part, tool, motion, points = planned(lens, 0.002, 0.0075)
    chips = chip_map(motion, tool, part, material=GLASS, points=points)
    assert chips.thickest * 1e6 == pytest.approx(200, abs=4)
    flat = RoundChip(nose_radius=1.5, feed=0.002, depth=0.0075).thickest
    assert chips.thickest == pytest.approx(flat, rel=0.02)
    gate = check_ductile(chips, GLASS, tool)
    assert gate.ductile
    assert gate.ok
    assert gate.share == 0
    margin = 100 * (1 - chips.thickest / 600e-6)
    assert gate.sentence.startswith("ductile")
    assert f"{margin:.0f} %" in gate.sentence
    assert say_length(chips.thickest) in gate.sentence
    assert say_length(600e-6) in gate.sentence


def test_the_infrared_lens_is_brittle_in_roughing(lens):
    """Issue: 25 um and 25 um/rev give about 4.3 um."""
    part, tool, motion, points = planned(lens, 0.025, 0.025)
    chips = chip_map(motion, tool, part, material=GLASS, points=points)
    assert np.median(chips.thickness[chips.inside]) * 1e3 == pytest.approx(4.33, abs=0.05)
    assert chips.thickest * 1e3 == pytest.approx(4.4, abs=0.05)
    short = check_ductile(chips, GLASS, tool, allowance=0.001)
    assert not short.ok
    assert not short.ductile
    assert short.share > 0.95
    assert f"more than {say_length(short.fracture)}" in short.sentence
    # A crack as long as the thickest chip, from where on the edge the chip of 600 nm stands.
    sweep = np.linspace(0, 0.1, 100_001)
    begins = sweep[np.argmax(RoundChip(nose_radius=1.5, feed=0.025, depth=0.025).thickness(sweep) > 600e-6)]
    assert short.fracture == pytest.approx(chips.thickest - 1.5 * (1 - np.cos(begins)), rel=0.01)
    enough = check_ductile(chips, GLASS, tool, allowance=0.0075)
    assert enough.ok
    assert "within the 7.5 um" in enough.sentence


def test_the_feed_that_is_proposed_just_holds(lens):
    part, tool, motion, points = planned(lens, 0.025, 0.025)
    gate = check_ductile(chip_map(motion, tool, part, material=GLASS, points=points), GLASS, tool)
    part, tool, motion, points = planned(lens, gate.largest_feed, 0.025)
    held = chip_map(motion, tool, part, material=GLASS, points=points)
    assert held.thickest == pytest.approx(600e-6, rel=0.01)


def test_the_rake_that_is_proposed_holds_and_the_next_does_not():
    material = Material(name="crystal", critical=CriticalThickness(value=1e-4, rake=(np.deg2rad([-45, 0]), [4.0, 1.0])))
    part = tw.Part(surface=tw.Plane(slope=(0.0, 0.0)), radius=1.0, stock=0.004)
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100))
    servo = tw.SlowToolServo(feed=0.001, points_per_rev=36, spindle_rpm=60, lead_in=0.2)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, tw.Machine.load("generic"))
    chips = chip_map(motion, tool, part, material=material)
    thickest = RoundChip(nose_radius=0.5, feed=0.001, depth=0.004).thickest
    assert chips.thickest == pytest.approx(thickest, rel=1e-6)
    gate = check_ductile(chips, material, tool)
    needed = -(thickest / 1e-4 - 1) / 3 * 45
    assert np.rad2deg(gate.rake) == pytest.approx(np.floor(needed), abs=1e-9)
    assert f"a rake of {np.rad2deg(gate.rake):.3g} deg" in gate.sentence


def test_the_effective_rake_is_that_of_the_climbing_surface():
    """Oracle: on a tilted plane the surface climbs by atan(slope . cutting direction)."""
    part = tw.Part(surface=tw.Plane(slope=(0.2, 0.0)), radius=1.0, stock=0.004)
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100), rake=np.deg2rad(-10))
    servo = tw.SlowToolServo(feed=0.02, points_per_rev=72, spindle_rpm=60, lead_in=0.2)
    for sense in (1, -1):
        turned = replace(servo, sense=sense)
        motion = tw.drive(tw.place(turned.spiral(part, tool), part, tool), turned, tw.Machine.load("generic"))
        chips = chip_map(motion, tool, part)
        climb = np.arctan(-sense * 0.2 * np.sin(motion.axes["C"]))
        np.testing.assert_allclose(chips.rake, np.deg2rad(-10) - climb, atol=1e-12)
        lowest, highest = tw.check_access(part, tool, sense=sense).rake_range
        assert chips.rake.min() == pytest.approx(lowest, abs=1e-3)
        assert chips.rake.max() == pytest.approx(highest, abs=1e-3)


FLAT = RoundChip(nose_radius=0.5, feed=0.01, depth=0.004)


def flat_gate(critical, uncertainty=None, *, allowance=0.0, ratio=1.0, rake=None, tool_rake=0.0):
    """The gate of a flat, whose every chip beyond the first turns is ``FLAT``."""
    material = Material(
        name="glass",
        critical=CriticalThickness(value=critical, uncertainty=uncertainty, rake=rake),
        fracture_ratio=ratio,
    )
    part = tw.Part(surface=tw.Plane(slope=(0.0, 0.0)), radius=1.0, stock=0.004)
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100), rake=tool_rake)
    servo = tw.SlowToolServo(feed=0.01, points_per_rev=36, spindle_rpm=60, lead_in=0.2)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, tw.Machine.load("generic"))
    chips = chip_map(motion, tool, part, material=material)
    return check_ductile(chips, material, tool, allowance=allowance)


def test_margin_uncertainty_is_that_of_the_material():
    """Oracle: how far the chip stays below limits drawn at random, as a share of the limit that is stated."""
    critical = 2 * FLAT.thickest
    gate = flat_gate(critical, 0.02 * critical)
    assert gate.margin[gate.worst] == pytest.approx(0.5, rel=1e-6)
    limits = np.random.default_rng(0).normal(critical, 0.02 * critical, 400_000)
    inside = np.abs((limits - FLAT.thickest) / critical - gate.margin[gate.worst]) < gate.uncertainty
    assert inside.mean() == pytest.approx(0.9545, abs=0.003)
    assert gate.sentence.startswith("ductile")
    assert "50 % +- 4 %" in gate.sentence
    assert flat_gate(critical).uncertainty is None


@pytest.mark.parametrize(
    ("times", "relative", "verdict"),
    [
        # t against t_c (1 - 2u) from above, t_c (1 + 2u) from below, by hand, a thousandth to either side.
        (1.001, None, "ductile"),
        (0.999, None, "brittle"),
        (1.251, 0.1, "ductile"),
        (1.249, 0.1, "uncertain"),
        (0.834, 0.1, "uncertain"),
        (0.833, 0.1, "brittle"),
        (0.51, 0.5, "uncertain"),
        (1e3, 0.5, "uncertain"),  # a limit that may be 0: no chip is thin enough
    ],
)
def test_verdict_outside_the_uncertainty(times, relative, verdict):
    critical = times * FLAT.thickest
    gate = flat_gate(critical, None if relative is None else relative * critical)
    assert gate.verdict == verdict
    assert gate.ductile == (verdict == "ductile")
    words = {"ductile": "ductile, ", "brittle": "brittle: ", "uncertain": "ductile regime not certain"}
    assert gate.sentence.startswith(words[verdict])
    # Only at the axis, where half a feed is left, the chip is thinner.
    assert gate.doubtful == pytest.approx(float(verdict == "uncertain"), abs=0.01)
    assert gate.share == pytest.approx(float(times < 1), abs=0.01)


def test_an_uncertain_pass_is_treated_as_brittle():
    """Oracles: the chip of the feed that is proposed; where on the nose the chip is t_c - 2u."""
    critical = 1.1 * FLAT.thickest
    gate = flat_gate(critical, 0.1 * critical)
    assert gate.verdict == "uncertain"
    safe = 0.8 * critical
    sweep = np.linspace(0, FLAT.sweep[1], 200_001)
    begins = sweep[np.argmax(FLAT.thickness(sweep) > safe)]
    assert gate.fracture == pytest.approx(max(FLAT.thickest - 0.5 * (1 - np.cos(begins)), 0.0), abs=2e-6)
    held = RoundChip(nose_radius=0.5, feed=gate.largest_feed, depth=0.004)
    assert held.thickest == pytest.approx(safe, rel=1e-5)
    # Long cracks against the material that later passes remove.
    short, enough = (flat_gate(critical, 0.1 * critical, allowance=one, ratio=20.0) for one in (0.001, 0.03))
    assert 0.001 < short.fracture < 0.03
    assert not short.ok
    assert "uncertainty" in short.sentence
    assert f"feed at most {gate.largest_feed * 1e3:.3g} um/rev" in short.sentence
    assert enough.ok
    assert "within the 30 um" in enough.sentence
    # A chip below the limit by more than the uncertainty makes no cracks.
    assert flat_gate(critical, 0.01 * critical).fracture == 0


def test_a_rake_is_proposed_that_holds_beyond_doubt():
    critical = FLAT.thickest / 2.1
    rake = (np.deg2rad([-45, 0]), [4.0, 1.0])
    for relative in (0.0, 0.1):
        gate = flat_gate(critical, relative * critical, rake=rake)
        needed = -(2.1 / (1 - 2 * relative) - 1) / 3 * 45
        assert np.rad2deg(gate.rake) == pytest.approx(np.floor(needed), abs=1e-9)


def test_predicted_cracks_match_the_chips_of_a_pass():
    """Oracle: the lowest place of the edge that is beyond the limit, on a dense grid of the nose."""
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100))
    critical, ratio = 0.5 * FLAT.thickest, 12.0
    sweep = np.linspace(0, FLAT.sweep[1], 200_001)
    begins = sweep[np.argmax(FLAT.thickness(sweep) > critical)]
    deep = ratio * FLAT.thickest - 0.5 * (1 - np.cos(begins))
    assert flat_gate(critical, ratio=ratio).fracture == pytest.approx(deep, rel=1e-3)
    for longer, allowance, words in (
        (ratio, deep + 1e-5, f"{say_length(deep)} deep"),
        (ratio, deep - 1e-5, "not enough"),
        (0.4, 0.0, "cracks end above"),
    ):
        glass = Material(name="glass", critical=CriticalThickness(value=critical), fracture_ratio=longer)
        prediction = predict_chips(tool, glass, feed=0.01, depth=0.004, bend=0.0, rakes=(0.0, 0.0), allowance=allowance)
        assert words in prediction
        assert ("not enough" in prediction) == (words == "not enough")


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (1.26, "ductile up to a feed of"),
        (1.24, "ductile regime not certain"),
        (0.83, "brittle: "),
    ],
)
def test_predicted_verdict_matches_the_ductile_check(times, words):
    critical = times * FLAT.thickest
    glass = Material(name="glass", critical=CriticalThickness(value=critical, uncertainty=0.1 * critical))
    tool = tw.Tool(nose_radius=0.5, included=np.deg2rad(100))
    prediction = predict_chips(tool, glass, feed=0.01, depth=0.004, bend=0.0, rakes=(0.0, 0.0), allowance=0.0)
    assert words in prediction
    assert " +- " in prediction
    feed = float(prediction.split("feed of " if times > 1.25 else "feed at most ")[1].split(" um/rev")[0]) * 1e-3
    assert RoundChip(nose_radius=0.5, feed=feed, depth=0.004).thickest == pytest.approx(0.8 * critical, rel=0.01)
