"""Numbers that no thing has: not finite, not whole where they count, degrees where radians are meant."""

import numpy as np
import pytest

import turnwright as tw
from turnwright._validate import require_finite
from turnwright.metrology import line_profile
from turnwright.speed_profile import SpeedProfile

FLAT = tw.Plane()
X = np.linspace(-1, 1, 5)
REFUSED = {
    "radius error nan": (lambda: tw.Tool(nose_radius=0.5, radius_error=np.nan), "radius_error is nan"),
    "radius error inf": (lambda: tw.Tool(nose_radius=0.5, radius_error=np.inf), "radius_error is inf"),
    "radius error of a nose": (lambda: tw.Tool(nose_radius=0.5, radius_error=5.0), "radius_error is 5 .*limits are"),
    "stock inf": (lambda: tw.Part(surface=FLAT, radius=1.0, stock=np.inf), "stock is inf"),
    "stock nan": (lambda: tw.Part(surface=FLAT, radius=1.0, stock=np.nan), "stock is nan"),
    "half a row": (lambda: tw.LensArray.square(pitch=1.0, lenslet=FLAT, rows=2.5, columns=2), "rows .*2.5.*whole"),
    "half a ring": (lambda: tw.LensArray.hexagonal(pitch=1.0, lenslet=FLAT, rings=1.5), "rings .*1.5.*whole"),
    "columns that fall": (lambda: tw.HeightMap(x=X[::-1], y=X, z=np.zeros((5, 5))), "x of the height map does not"),
    "rows that stay": (lambda: tw.HeightMap(x=X, y=X * 0, z=np.zeros((5, 5))), "y of the height map does not ascend"),
    "radii that fall": (
        lambda: tw.HeightMap(radius=-X, angle=X, z=np.zeros((5, 5))), "radius of the height map does not ascend",
    ),
    "no speeds": (lambda: SpeedProfile(radius=[], spindle_rpm=[]), "0 radii"),
    "no heights": (lambda: tw.HeightMap(x=X, y=X, z=np.zeros((5, 5))).thinned(0), "is 0, it must be a whole number"),
    "rotation in degrees": (lambda: FLAT.placed(rotation=90), "rotation is 90 rad"),
    "rotation of a pose in degrees": (lambda: tw.Pose(rotation=90), "rotation is 90 rad"),
    "tilt in degrees": (lambda: FLAT.placed(tilt=(1, 0)), "tilt is 1 rad.*to 0.7854 rad"),
    "spiral in degrees": (
        lambda: tw.Spiral(angle=np.arange(0, 3600, 5.0), radius=np.linspace(1, 0, 720)), "in rad",
    ),
    "phase in degrees": (
        lambda: tw.SineGrid(amplitude=(1e-3, 1e-3), period=(1.0, 1.0), phase=(90, 0)), "phase .* is 90 rad",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("make", "words"), REFUSED.values(), ids=REFUSED)
def test_numbers_that_no_thing_has_are_refused(make, words):
    with pytest.raises(tw.InputError, match=words):
        make()


def test_numbers_at_their_limits_are_taken():
    turn = 2 * np.pi
    assert FLAT.placed(rotation=turn).rotation == turn
    assert FLAT.placed(tilt=(np.pi / 4, -np.pi / 4)).tilt == (np.pi / 4, -np.pi / 4)
    assert tw.OffAxis(parent=tw.Conic(radius=10, conic=-1), distance=15.0).lean > np.pi / 4
    assert tw.Spiral(angle=np.arange(10) * np.pi, radius=np.linspace(1, 0, 10)).sense == 1
    assert tw.SineGrid(amplitude=(1e-3, 1e-3), period=(1.0, 1.0), phase=(turn, -turn)).phase == (turn, -turn)
    assert tw.Tool(nose_radius=0.5, radius_error=-0.05).actual_radius == 0.45


DEGREES = {
    "whole steps": np.arange(0, 3600, 5.0),
    "fine steps": -np.arange(0, 360 * 20 + 0.1, 0.3),
    "a turn that is open": np.arange(360.0),
    "steps that fit by one point less": np.linspace(0, 360 * 40, 40 * 720),
    "uneven steps": 360 * 30 * np.linspace(0, 1, 9001) ** 2,
}


@pytest.mark.parametrize("angle", DEGREES.values(), ids=DEGREES)
def test_turns_in_degrees_are_refused(angle):
    radius, machine = np.linspace(5, 0, angle.size), tw.Machine.load("generic")
    with pytest.raises(tw.InputError, match="in rad"):
        tw.Spiral(angle=angle, radius=radius)
    if angle[0] <= angle[-1]:
        with pytest.raises(tw.InputError, match="in rad"):
            tw.Motion(time=1 + np.arange(angle.size), axes={"C": angle, "X": radius, "Z": radius}, machine=machine)
    turned = np.deg2rad(angle)
    assert tw.Spiral(angle=turned, radius=radius).turns == pytest.approx(abs(angle[-1] - angle[0]) / 360)


@pytest.mark.parametrize("step", [0.05, 0.1, 0.12, 0.3, 0.45])
def test_spirals_in_round_steps_of_a_radian_are_taken(step):
    angle = np.arange(0, 4000.0, step)
    assert tw.Spiral(angle=angle, radius=np.linspace(5, 0, angle.size)) is not None


@pytest.mark.parametrize("per_turn", [8, 36, 90, 360, 720, 1000, 1257])
def test_spirals_of_any_plan_are_no_degrees(per_turn):
    rng = np.random.default_rng(per_turn)
    for turns in (1, 57, 57.3, 360, 1000):
        even = 2 * np.pi * np.arange(int(turns * per_turn) + 1) / per_turn
        for angle in (even, even + 100.0, -even, np.sort(rng.uniform(0, even[-1], 4000))):
            if np.median(np.abs(np.diff(angle))) <= np.pi:
                tw.Spiral(angle=angle, radius=np.linspace(5, 0, angle.size))


LARGEST = np.finfo(float).max


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "values",
    [
        [], [LARGEST, LARGEST], [-LARGEST, -LARGEST, 1.0], [LARGEST, np.inf], [np.inf, -np.inf], [np.nan, 1.0], [5, 7],
        np.array([6e4, 6e4], dtype=np.float16), np.array([2.0, 1j]), np.array([complex(np.nan, 1)]),
        np.ones((3, 4))[:, ::2],
    ],
)  # fmt: skip
def test_finite_values_are_those_of_which_each_is_finite(values):
    values = np.asarray(values)
    wrong = [value for value in values.ravel() if not np.isfinite(value)]
    if not wrong:
        require_finite(values, "it")
        return
    with pytest.raises(tw.InputError, match=f"it holds {len(wrong)} values that are not finite"):
        require_finite(values, "it")


BEYOND = {
    "rotation": lambda it: FLAT.placed(rotation=it),
    "tilt": lambda it: FLAT.placed(tilt=(0, it)),
    "tilt of what is placed": lambda it: tw.surface.Placed(surface=FLAT, tilt=(it, 0)),
    "tilt of a pose": lambda it: tw.Pose(tilt=(it, 0)),
    "phase of a grid": lambda it: tw.SineGrid(amplitude=(1e-3, 1e-3), period=(1.0, 1.0), phase=(0, it)),
    "azimuth": lambda it: tw.OffAxis(parent=tw.Conic(radius=10, conic=-1), distance=1.0, azimuth=it),
    "included": lambda it: tw.Tool(nose_radius=0.5, included=it),
    "rake": lambda it: tw.Tool(nose_radius=0.5, rake=-it),
    "clearance": lambda it: tw.Tool(nose_radius=0.5, clearance=it),
    "sweep of a certificate": lambda it: tw.WavinessTable(sweep=it * np.linspace(-1, 1, 9), deviation=np.zeros(9)),
    "squareness": lambda it: tw.Machine(
        name="t", axes=dict.fromkeys("CXZ", tw.Axis()), spindle_rpm=1.0, block_rate_hz=1.0, squareness=it
    ),
    "clocking": lambda it: tw.machine.Convention(clocking=it),
    "lobes": lambda it: tw.material.Lobes(count=3, amplitude=0.1, maximum=it),
    "rake of a coefficient": lambda it: tw.material.CuttingCoefficient(value=1.0, rake=((0.0, it), (1.0, 1.1))),
    "rake of a thickness": lambda it: tw.material.CriticalThickness(value=1e-4, rake=((-it, 0.0), (1.0, 1.1))),
    "inclination": lambda it: tw.cutting.OrthogonalChip(thickness=1e-3, width=1.0, inclination=it),
    "exit of a tooth": lambda it: tw.cutting.SlotMill(radius=1.0, feed_per_tooth=0.01, depth=0.1, exit=it),
    "phase of a vibration": lambda it: tw.cutting.Vibration(amplitude=1e-6, frequency_hz=10.0, phase=it),
    "friction angle": lambda it: tw.cutting.MinimumChip.of_edge(1e-5, it),
    "angles of a polar map": lambda it: tw.HeightMap(radius=X + 1, angle=it * (X + 1), z=np.zeros((5, 5))),
    "angle of a line": lambda it: line_profile(tw.HeightMap(x=X, y=X, z=np.zeros((5, 5))), (0, 0), angle=it),
}


@pytest.mark.parametrize("make", BEYOND.values(), ids=BEYOND)
@pytest.mark.parametrize("degrees", [7.0, 10.0, 60.0, 90.0])
def test_angles_in_degrees_are_refused(make, degrees):
    with pytest.raises(tw.InputError, match="in rad"):
        make(degrees)
    assert make(np.deg2rad(min(degrees, 5.0))) is not None
