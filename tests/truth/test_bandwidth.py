"""The highest frequency of a fast tool's motion, against sines whose frequency is known."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw

TURN = 2 * np.pi


def limits(w, turned, *, rpm=120.0, machine="nanoform-fts-70", sense=1, residual=1e-5):
    machine = tw.Machine.load(machine)
    fast = replace(machine.axes["W"], bandwidth_residual=residual)
    machine = replace(machine, axes={**machine.axes, "W": fast})
    axes = {"C": sense * turned, "X": 9 - 1e-3 * turned, "Z": np.zeros(turned.size), "W": w}
    return tw.check_limits(tw.Motion(time=turned / (rpm * TURN / 60), axes=axes, machine=machine), machine)


@pytest.mark.parametrize("waves", [3, 20, 100])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_sine_is_found_at_its_frequency_and_half_a_wave_a_turn(waves, sense):
    turned = np.linspace(0, 9 * TURN, 9 * 1000 + 1)
    found = limits(1e-3 * np.sin(waves * turned), turned, sense=sense).frequency_hz["W"]
    assert found == pytest.approx(2 * (waves + 0.5), rel=1e-9)


@pytest.mark.parametrize("waves", [3.3, 41.07, 90.61])
@pytest.mark.parametrize("turns", [1.2, 2.0, 7.6])
def test_a_sine_that_does_not_close_is_found_within_two_waves(waves, turns):
    turned = np.sort(np.append(np.linspace(0, turns * TURN, int(turns * 1000)), [0.11, 0.13]))
    found = limits(1e-3 * np.sin(waves * turned), turned).frequency_hz["W"]
    assert 2 * waves < found < 2 * (waves + 4 / min(turns, 2))


def test_bursts_count_and_low_residuals_do_not():
    """10 nm: a sine of 9 nm remains unseen, one of 13 nm shows, for four turns too."""
    turned = np.linspace(0, 20 * TURN, 20 * 1000 + 1)
    slow = 1e-3 * np.sin(5 * turned)
    assert limits(slow + 0.9e-5 * np.sin(80 * turned), turned).frequency_hz["W"] == pytest.approx(11)
    assert limits(slow + 1.3e-5 * np.sin(80 * turned), turned).frequency_hz["W"] == pytest.approx(160)
    burst = np.where((turned > 8 * TURN) & (turned < 12 * TURN), 1.3e-5, 0.0)
    assert limits(slow + burst * np.sin(80 * turned), turned).frequency_hz["W"] == pytest.approx(160, abs=3)


@pytest.mark.parametrize("astigmatism", [0.0, 1e-3, 0.1, 1.0])
def test_the_frequency_does_not_depend_on_what_is_slower(astigmatism):
    turned = np.linspace(0, 6 * TURN, 6 * 1000 + 1)
    w = 1e-3 * np.sin(5 * turned) + 1.3e-5 * np.sin(80 * turned) + astigmatism * np.cos(2 * turned)
    assert limits(w, turned).frequency_hz["W"] == pytest.approx(160)
    assert limits(w, turned, residual=1e-6).frequency_hz["W"] == pytest.approx(161)
    assert limits(w, turned, residual=2e-5).frequency_hz["W"] == pytest.approx(11)


def test_lenses_need_the_same_bandwidth_on_an_astigmatic_base():
    """0.1 mm of astigmatism moves the places where the nose touches, so a little differs; alone it is slow."""
    machine = tw.Machine.load("nanoform-fts-70")
    tool = tw.Tool(nose_radius=0.5, clearance=np.deg2rad(12), included=np.deg2rad(100))
    lenses = tw.LensArray.square(lenslet=tw.Sphere(radius=20.0), pitch=1.0, within=3.0)
    base = tw.Zernike(terms={5: 0.1}, radius=2.0, indexing="fringe")
    servo = tw.FastToolServo(plan=tw.SlowToolServo(feed=0.05, spindle_rpm=60, points_per_rev=2400))

    def bandwidth(surface):
        part = tw.Part(surface=surface, radius=2.0)
        motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, machine)
        return tw.check_limits(motion, machine).frequency_hz["W"]

    alone = bandwidth(lenses)
    assert bandwidth(lenses + base) == pytest.approx(alone, rel=0.05)
    assert bandwidth(base) < alone / 20


@pytest.mark.parametrize("residual", [5e-6, 1e-5, 5e-5])
def test_what_remains_above_the_frequency_is_the_residual(residual):
    """Oracle: slope discontinuities of a triangle wave: its sines are 8 / (pi n)^2, their powers above n add up."""
    turned = np.linspace(0, 4 * TURN, 4 * 8000 + 1)
    height, waves = 5e-3, 3
    w = height * 2 / np.pi * np.arcsin(np.sin(waves * turned))
    odd = np.arange(1, 1001, 2)
    amplitude = height * 8 / (np.pi * odd) ** 2
    above = np.sqrt(np.cumsum(amplitude[::-1] ** 2)[::-1])
    last = odd[np.flatnonzero(above > residual)[-1]]
    found = limits(w, turned, residual=residual).frequency_hz["W"] / 2
    assert found == pytest.approx(waves * last, abs=1.0)


def test_bandwidth_finding_names_the_residual():
    turned = np.linspace(0, 3 * TURN, 3 * 20_000 + 1)
    (sentence,) = [one for one in limits(1e-4 * np.sin(400 * turned), turned).findings if "bandwidth" in one]
    assert "10 nm" in sentence


def test_a_fast_tool_is_judged_by_all_of_its_limits():
    """0.04 mm at 400 waves of 2 turns/s: beyond 0.035 mm, 700 Hz, 100 mm/s and 1e5 mm/s^2, all of them."""
    turned = np.linspace(0, 3 * TURN, 3 * 20_000 + 1)
    found = limits(0.04 * np.sin(400 * turned), turned)
    message = " ".join(found.findings)
    assert not found.ok
    for words in (
        "W speed reaches 200",
        "W acceleration reaches 1.0",
        "W bandwidth reaches 801 Hz",
        "W goes to 0.0399",
    ):
        assert words in message
    assert "104.9 rev/min" in message  # 120 * 700 / 801
    assert "to Z" in message
    assert found.utilisation["W bandwidth"] == pytest.approx(801 / 700)
    # The lathe itself turns steadily: a block every 1/32 of a turn and not 40 000 blocks/s.
    assert found.block_rate_hz < 2 * 64
    other = replace(tw.Machine.load("nanoform"), name="bare")
    axes = {"C": turned, "X": 9 - 1e-3 * turned, "Z": 0 * turned, "W": 0 * turned}
    bare = tw.check_limits(tw.Motion(time=turned, axes=axes, machine=other), other)
    assert "needs axis W, which bare does not have" in bare.findings[0]
    assert dict(bare.frequency_hz) == {}


def test_a_tool_at_rest_has_no_frequency():
    turned = np.linspace(0, 3 * TURN, 3001)
    assert limits(np.full(turned.size, 0.01), turned).frequency_hz["W"] == 0
