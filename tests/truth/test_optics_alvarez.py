"""Alvarez pairs against the second derivative in closed form, and a published lens."""

import math

import numpy as np
import pytest

import turnwright as tw
from turnwright.optics import alvarez_focal_length

GERMANIUM_GLASS = 2.801
"""Refractive index of the published pair."""


@pytest.fixture(scope="module")
def lens():
    return tw.Job.load("examples/infrared_lens.toml").part.surface


@pytest.mark.parametrize(
    ("shear", "paraxial", "fitted"),
    [(0.0, 76.6916, 76.708), (-1.0, 49.2318, 49.251), (-1.8, 38.2816, 38.295), (0.5, 106.372, 106.368)],
)
def test_alvarez_pair_of_the_thesis(lens, shear, paraxial, fitted):
    focal = alvarez_focal_length(lens, lens, shear=shear, index=GERMANIUM_GLASS)
    assert focal == pytest.approx(paraxial, rel=5e-6)
    over_disc = alvarez_focal_length(lens, lens, shear=shear, index=GERMANIUM_GLASS, radius=3.0)
    assert over_disc == pytest.approx(fitted, rel=1e-5)


def test_alvarez_pair_loses_its_power(lens):
    powers = [1 / alvarez_focal_length(lens, lens, shear=d, index=GERMANIUM_GLASS) for d in (1.787, 1.797)]
    assert powers[0] > 0 > powers[1]


def test_alvarez_pair_of_simulated_surfaces(lens):
    """Each lens is cut with a feed of 20 um and 360 points per revolution."""
    part = tw.Part(surface=lens, radius=7.25)
    tool = tw.Tool(nose_radius=1.5, clearance=np.deg2rad(15), included=np.deg2rad(120))
    servo = tw.SlowToolServo(feed=0.02, spindle_rpm=50, points_per_rev=360)
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool, along="z"), servo, tw.Machine.load("generic"))
    made = tw.generate_polar(
        motion, tool, radius=np.linspace(0, 7.25, 200), angle=np.linspace(0, 2 * np.pi, 96, endpoint=False)
    )
    for shear, paraxial in ((-1.8, 38.2816), (0.0, 76.6916), (0.5, 106.372)):
        focal = alvarez_focal_length(made, made, shear=shear, index=GERMANIUM_GLASS)
        assert focal == pytest.approx(paraxial, rel=1e-3)


def test_alvarez_pair_without_power_is_infinite():
    cubic = tw.XYPolynomial(terms={(3, 0): 1e-3 / 3, (1, 2): 1e-3})
    assert alvarez_focal_length(cubic, cubic, shear=0.0, index=1.5) == math.inf
    # T = -2 d a r²: its curvature is -4 a d.
    assert alvarez_focal_length(cubic, cubic, shear=0.7, index=1.5, radius=2.0) == pytest.approx(
        1 / (0.5 * 4 * 1e-3 * 0.7)
    )


def test_alvarez_pair_needs_heights_where_it_is():
    x = np.linspace(-6, 6, 61)
    cubic = tw.XYPolynomial(terms={(3, 0): 1e-3 / 3, (1, 2): 1e-3})
    made = tw.HeightMap(x=x, y=x, z=cubic.sag(*np.meshgrid(x, x)))
    assert alvarez_focal_length(made, made, shear=3.0, index=1.5, radius=2.0) == pytest.approx(1 / 6e-3, rel=1e-6)
    for shear, radius in ((7.0, None), (4.5, 2.0)):
        with pytest.raises(tw.InputError, match="no height"):
            alvarez_focal_length(made, made, shear=shear, index=1.5, radius=radius)
