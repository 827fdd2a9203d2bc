"""What a correction of the part takes from a diagnosis that knows the marks of the causes at some points only."""

import numpy as np
import pytest

import turnwright as tw
from cases import every_second

PART = tw.Part(surface=tw.Plane(slope=(0.0, 0.0)), radius=5.0)
TOOL = tw.Tool(nose_radius=0.5, included=np.deg2rad(100), clearance=np.deg2rad(10))
HUM = tw.diagnosis.ErrorSource(name="hum", signature=lambda cut: np.cos(3 * cut.x) * np.sin(2 * cut.y), typical=1e-3)


def height(x, y):
    return 3e-4 * np.cos(3 * x) * np.sin(2 * y)


def grid():
    x, y = np.linspace(-5, 5, 61), np.linspace(-5, 5, 47)
    return tw.HeightMap(x=x, y=y, z=height(*np.meshgrid(x, y)))


def rings():
    radius, angle = np.linspace(0.1, 5, 50), np.linspace(0, 6, 40)
    x, y = np.cos(angle)[:, None] * radius, np.sin(angle)[:, None] * radius
    return tw.HeightMap(radius=radius, angle=angle, z=height(x, y))


def scattered(gone):
    rng = np.random.default_rng(7)
    radius, angle = 5 * np.sqrt(rng.random(3000)), 2 * np.pi * rng.random(3000)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return tw.HeightMap(x=x, y=y, z=np.where(x < gone, np.nan, height(x, y)))


@pytest.mark.parametrize(
    ("measured", "points"), every_second([grid(), rings(), scattered(-9.0), scattered(1.0)], [100, 700, 60_000])
)
def test_a_cause_that_no_plan_takes_care_of_is_left_to_the_part(measured, points):
    """Oracle: the heights that were made. The residual and the mark of the cause are them again, where both stand."""
    found = tw.diagnose(
        measured, PART, TOOL, tw.Machine.load("generic"), error_sources=[HUM], free=(), min_effect_nm=1.0, points=points
    )
    assert found["hum"].verdict == "correct"
    left = found.remainders[0]
    known = np.isfinite(left.z)
    assert np.count_nonzero(known) >= np.count_nonzero(np.isfinite(found.signatures[0]["hum"].z)) > 20
    x, y = left.points()
    np.testing.assert_allclose(left.z[known], height(x, y)[known], rtol=0, atol=3e-12)
