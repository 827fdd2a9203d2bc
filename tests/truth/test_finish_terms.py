"""Terms of the finish beside the tool's shape, each against a closed form."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.cutting.finish import MinimumChip, Vibration, cusp_height, left_standing, vibrated
from turnwright.job import finish

NOSE, FEED, RPM = 0.5, 0.01, 60.0
TOOL = tw.Tool(nose_radius=NOSE, clearance=np.deg2rad(10), included=np.deg2rad(60))
MACHINE = tw.Machine.load("nanotech-350fg")


@pytest.fixture(scope="module")
def flat():
    """A facing cut in exact spirals: straight lines in X between the points are the spiral itself."""
    turns, per = 60, 90
    angle = np.linspace(0, 2 * np.pi * turns, turns * per + 1)
    axes = {"C": angle, "X": 1.0 - FEED * angle / (2 * np.pi), "Z": np.zeros(angle.size)}
    return tw.Motion(time=angle / (2 * np.pi) * 60 / RPM, axes=axes, machine=MACHINE)


def cusps(start=0.6995, count=40_001):
    """A window of two feeds, so fine that a height in it is seen to 0.01 nm."""
    return np.linspace(start, start + 2 * FEED, count)


@pytest.mark.parametrize("chip", [2e-6, 10e-6, 40e-6, 90e-6])
def test_what_thin_chips_leave_makes_cusps_as_high_as_brammertz_says(flat, chip):
    found = finish(flat, TOOL, radius=cusps(), angle=[0.7], minimum_chip=MinimumChip(thickness=chip))
    exact_flat = NOSE - np.sqrt(NOSE**2 - FEED**2 / 4)
    assert np.ptp(found.terms["kinematic"].z) == pytest.approx(exact_flat, abs=1e-8)
    assert np.ptp(found.surface.z) == pytest.approx(cusp_height(FEED, NOSE, chip), abs=2e-8)
    assert found.terms["minimum chip"].z.min() == 0.0


def test_the_strip_left_standing_is_as_wide_as_the_geometry_says(flat):
    chip, radius = 20e-6, cusps()
    extra = left_standing(flat, TOOL, MinimumChip(thickness=chip), radius=radius, angle=[0.7]).z[0]
    width = np.count_nonzero(extra > 0) * (radius[1] - radius[0]) / 2
    assert width == pytest.approx(NOSE * chip / FEED, rel=1e-2)


def test_material_pressed_down_for_good_leaves_nothing_and_half_of_it_half(flat):
    radius = cusps()
    full, half, none = (
        left_standing(flat, TOOL, MinimumChip(thickness=20e-6, recovery=share), radius=radius, angle=[0.7]).z
        for share in (1.0, 0.5, 0.0)
    )
    assert np.abs(half - full / 2).max() < 1e-15
    assert np.abs(none).max() == 0.0


def test_the_formula_of_brammertz_without_a_minimum_chip_is_the_parabola_of_the_cusp():
    assert cusp_height(0.01, 0.5) == pytest.approx(0.01**2 / 4)


@pytest.mark.parametrize(("friction", "share"), [(0.0, 1 - np.sqrt(0.5)), (np.pi / 6, 1 - np.cos(np.pi / 6))])
def test_the_minimum_chip_of_an_edge_at_angles_whose_cosine_is_known(friction, share):
    assert MinimumChip.of_edge(100e-6, friction).thickness == pytest.approx(share * 100e-6, rel=1e-12)


def test_a_vibration_of_whole_cycles_per_turn_leaves_itself(flat):
    shake = Vibration(amplitude=20e-6, frequency_hz=12 * RPM / 60, phase=0.4)
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    found = finish(flat, TOOL, radius=[0.70001], angle=angle, vibration=shake)
    assert np.abs(found.terms["vibration"].z[:, 0] - 20e-6 * np.sin(12 * angle + 0.4)).max() < 20e-6 * 1e-3


@pytest.mark.parametrize("amplitude", [0.5e-6, 2e-6, 8e-6])
def test_half_a_cycle_more_per_turn_sets_neighbouring_turns_apart(flat, amplitude):
    """Turns stand at +a and -a by turns: the peak is where the two parabolas meet, above the lower tip."""
    shake = Vibration(amplitude=amplitude, frequency_hz=1.5 * RPM / 60)
    found = finish(flat, TOOL, radius=cusps(count=4001), angle=[np.pi / 3], vibration=shake)
    height = (FEED / 2 + 2 * amplitude * NOSE / FEED) ** 2 / (2 * NOSE)
    assert np.ptp(found.surface.z) == pytest.approx(height, rel=1e-3)


def test_the_terms_add_up_to_the_surface(flat):
    found = finish(
        flat, TOOL, radius=cusps(count=501), angle=[0.1, 2.0],
        vibration=Vibration(amplitude=3e-6, frequency_hz=17.3), minimum_chip=MinimumChip(thickness=15e-6),
    )  # fmt: skip
    assert list(found.terms) == ["kinematic", "vibration", "minimum chip"]
    total = sum(one.z for one in found.terms.values())
    assert np.abs(total - found.surface.z).max() < 1e-15


def test_a_vibrating_motion_passes_through_its_sine_at_every_point_and_keeps_the_other_axes(flat):
    shake = Vibration(amplitude=1e-5, frequency_hz=95.0, phase=1.0)
    moved = vibrated(flat, shake)
    assert np.abs(moved.axes["Z"] - 1e-5 * np.sin(2 * np.pi * 95 * moved.time + 1.0)).max() < 1e-15
    assert np.diff(moved.time).max() <= 1 / (72 * 95) + 1e-12
    assert np.abs(np.interp(moved.time, flat.time, flat.axes["X"]) - moved.axes["X"]).max() < 1e-12
    assert np.isin(flat.time.round(9), moved.time.round(9)).all()
