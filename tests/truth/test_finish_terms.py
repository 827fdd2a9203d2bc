"""Terms of the finish other than the tool's shape, each against a closed form."""

import mpmath
import numpy as np
import pytest

import turnwright as tw
from turnwright.cutting.finish import MinimumChip, Vibration, add_vibration, cusp_height, predict_uncut_height
from turnwright.errors import InputError
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
def test_minimum_chip_makes_cusps_of_brammertz_height(flat, chip):
    found = finish(flat, TOOL, radius=cusps(), angle=[0.7], minimum_chip=MinimumChip(thickness=chip))
    exact_flat = NOSE - np.sqrt(NOSE**2 - FEED**2 / 4)
    assert np.ptp(found.terms["kinematic"].z) == pytest.approx(exact_flat, abs=1e-8)
    assert np.ptp(found.surface.z) == pytest.approx(cusp_height(FEED, NOSE, chip), abs=2e-8)
    assert found.terms["minimum chip"].z.min() == 0.0


def test_the_strip_left_standing_is_as_wide_as_the_geometry_says(flat):
    chip, radius = 20e-6, cusps()
    extra = predict_uncut_height(flat, TOOL, MinimumChip(thickness=chip), radius=radius, angle=[0.7]).z[0]
    width = np.count_nonzero(extra > 0) * (radius[1] - radius[0]) / 2
    assert width == pytest.approx(NOSE * chip / FEED, rel=1e-2)


def test_springback_leaves_its_share(flat):
    radius = cusps()
    full, half, none = (
        predict_uncut_height(flat, TOOL, MinimumChip(thickness=20e-6, recovery=share), radius=radius, angle=[0.7]).z
        for share in (1.0, 0.5, 0.0)
    )
    assert np.abs(half - full / 2).max() < 1e-15
    assert np.abs(none).max() == 0.0


@pytest.mark.parametrize(
    ("feed", "nose", "curvature"),
    [(0.01, 0.5, 0.0), (0.02, 0.05, 0.0), (0.02, 0.5, 1.0), (0.02, 0.5, -1 / 3), (0.05, 0.1, 4.0), (0.01, 0.5, 1e-9)],
)
def test_cusp_height_is_that_of_two_circles(feed, nose, curvature):
    """Circles around centres on an arc of radius 1/curvature - nose cross half way between them; 40 digits."""
    with mpmath.workdps(40):
        f, r, k = (mpmath.mpf(one) for one in (feed, nose, curvature))
        centre = r
        if k:
            arc = 1 / k - r
            centre = 1 / k - mpmath.sign(arc) * mpmath.sqrt(arc**2 - f**2 / 4)
        expected = centre - mpmath.sqrt(r**2 - f**2 / 4)
        assert cusp_height(feed, nose, curvature=curvature) == pytest.approx(float(expected), rel=1e-13)


@pytest.mark.parametrize(("nose", "chip", "curvature"), [(0.05, 1e-3, 0.0), (0.5, 4e-5, 1.0), (0.5, 4e-5, -0.5)])
def test_cusp_height_with_a_minimum_chip_is_that_of_two_circles(nose, chip, curvature):
    """The first pass where it is as far from the second as the thinnest chip: a root in 40 digits."""
    feed = 0.02
    with mpmath.workdps(40):
        f, r, k, t = (mpmath.mpf(one) for one in (feed, nose, curvature, chip))
        arc = 1 / k - r if k else 0
        up = 1 / k - mpmath.sign(arc) * mpmath.sqrt(arc**2 - f**2 / 4) if k else r

        def first(x):
            return up - mpmath.sqrt(r**2 - (x + f / 2) ** 2)

        def thickness(x):
            return r - mpmath.sqrt((x - f / 2) ** 2 + (first(x) - up) ** 2) - t

        x = mpmath.findroot(thickness, (f / 100, f / 2.1), solver="anderson")
        expected = first(x) - (k * x**2 / (1 + mpmath.sqrt(1 - (k * x) ** 2)))
        assert cusp_height(feed, nose, chip, curvature=curvature) == pytest.approx(float(expected), rel=1e-12)


def test_cusp_height_is_brammertz_to_the_first_order():
    f, r, t = 1e-3, 1.0, 1e-7
    assert cusp_height(f, r, t) == pytest.approx(f**2 / (8 * r) + t / 2 * (1 + r * t / f**2), rel=1e-6)


@pytest.mark.parametrize(("friction", "share"), [(0.0, 1 - np.sqrt(0.5)), (np.pi / 6, 1 - np.cos(np.pi / 6))])
def test_minimum_chip_at_angles_of_known_cosine(friction, share):
    assert MinimumChip.of_edge(100e-6, friction).thickness == pytest.approx(share * 100e-6, rel=1e-12)


def test_a_vibration_of_whole_cycles_per_turn_leaves_itself(flat):
    shake = Vibration(amplitude=20e-6, frequency_hz=12 * RPM / 60, phase=0.4)
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    found = finish(flat, TOOL, radius=[0.70001], angle=angle, vibration=shake)
    assert np.abs(found.terms["vibration"].z[:, 0] - 20e-6 * np.sin(12 * angle + 0.4)).max() < 20e-6 * 1e-3


@pytest.mark.parametrize("amplitude", [0.5e-6, 2e-6, 8e-6])
def test_half_a_cycle_more_offsets_neighbouring_revolutions(flat, amplitude):
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


def test_a_vibrating_motion_adds_its_sine_to_one_axis(flat):
    shake = Vibration(amplitude=1e-5, frequency_hz=95.0, phase=1.0)
    moved = add_vibration(flat, shake)
    assert np.abs(moved.axes["Z"] - 1e-5 * np.sin(2 * np.pi * 95 * moved.time + 1.0)).max() < 1e-15
    assert np.diff(moved.time).max() <= 1 / (72 * 95) + 1e-12
    assert np.abs(np.interp(moved.time, flat.time, flat.axes["X"]) - moved.axes["X"]).max() < 1e-12
    assert np.isin(flat.time.round(9), moved.time.round(9)).all()


def test_a_nose_that_no_two_passes_hold_in_a_valley_is_refused():
    """Two centres half a feed off the middle stand on an arc of radius 1/curvature - R, if that is so much."""
    feed, nose = 0.0004, 0.004
    most = 1 / (nose + feed / 2)
    assert np.isfinite(cusp_height(feed, nose, curvature=most))
    for curvature in (245.0, most * (1 + 1e-12)):
        with pytest.raises(InputError, match="curvature must be"):
            cusp_height(feed, nose, curvature=curvature)
