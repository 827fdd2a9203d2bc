"""What must hold of any chip: lengths scale, turned parts turn, edges mirror, force is homogeneous."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

import turnwright as tw
from laws import examples

MACHINE = tw.Machine.load("generic")
SETTINGS = examples(8)


def chips(surface, *, scale=1.0, feed=0.02, stock=0.004, material=None, sense=1, inside_out=False):
    part = tw.Part(surface=surface, radius=0.6 * scale, stock=stock * scale)
    tool = tw.Tool(nose_radius=0.5 * scale, included=np.deg2rad(100))
    servo = tw.SlowToolServo(
        feed=feed * scale, points_per_rev=24, spindle_rpm=60, lead_in=0.2 * scale, sense=sense, inside_out=inside_out
    )
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, MACHINE)
    return tw.cutting.chip_map(motion, tool, part, material=material)


@SETTINGS
@given(st.floats(0.1, 10), st.floats(3, 30))
def test_lengths_scale(scale, radius):
    one, other = chips(tw.Sphere(radius=radius)), chips(tw.Sphere(radius=radius * scale), scale=scale)
    np.testing.assert_allclose(other.thickness, one.thickness * scale, rtol=1e-6, atol=1e-12 * scale)
    np.testing.assert_allclose(other.area, one.area * scale**2, rtol=1e-6, atol=1e-15 * scale**2)
    np.testing.assert_allclose(other.width, one.width * scale, rtol=1e-6, atol=1e-9 * scale)


@SETTINGS
@given(st.floats(0.002, 0.03), st.floats(0.001, 0.006))
def test_no_chip_is_thicker_than_the_cut_is_deep_nor_than_feed(feed, stock):
    found = chips(tw.SineGrid(amplitude=(1e-3, 1e-3), period=(1.0, 1.3)), feed=feed, stock=stock)
    assert (found.thickness <= stock * (1 + 1e-9)).all()
    steady = found.inside & (np.hypot(found.x, found.y) < 0.5)
    # Along the normal a turn moves by at most the feed over the cosine of the slope, and bends by f²/2R.
    assert found.thickness[steady].max() <= feed * 1.01 + feed**2
    assert (found.area >= 0).all()
    assert (found.width >= 0).all()


@SETTINGS
@given(st.floats(-0.2, 0.2))
def test_the_other_sense_cuts_the_same_chips_of_a_mirrored_part(slope):
    one = chips(tw.Plane(slope=(0.05, slope)))
    other = chips(tw.Plane(slope=(0.05, -slope)), sense=-1)
    np.testing.assert_allclose(other.thickness, one.thickness, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(other.rake, one.rake, atol=1e-9)


@SETTINGS
@given(st.floats(100, 5000), st.floats(1.1, 4))
def test_forces_are_homogeneous_in_the_coefficients(value, times):
    material = tw.Material(
        name="any",
        cutting=tw.material.CuttingCoefficient(value=value),
        thrust=tw.material.CuttingCoefficient(value=value / 2),
    )
    stiffer = replace(
        material,
        cutting=tw.material.CuttingCoefficient(value=value * times),
        thrust=tw.material.CuttingCoefficient(value=value / 2 * times),
    )
    surface = tw.Sphere(radius=5.0)
    one, other = chips(surface, material=material), chips(surface, material=stiffer)
    np.testing.assert_allclose(other.cutting, one.cutting * times, rtol=1e-12)
    np.testing.assert_allclose(other.axial, one.axial * times, rtol=1e-12)
    np.testing.assert_allclose(other.radial, one.radial * times, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("inside_out", [False, True])
def test_force_along_the_cut_is_coefficient_times_area(inside_out):
    material = tw.Material(
        name="any",
        cutting=tw.material.CuttingCoefficient(value=1000.0),
        thrust=tw.material.CuttingCoefficient(value=500.0),
    )
    found = chips(tw.SineGrid(amplitude=(2e-3, 1e-3), period=(1.5, 1.1)), material=material, inside_out=inside_out)
    # At the rim the blank ends in a wall, which rays along the normal meet elsewhere than heights do.
    cut = (np.hypot(found.x, found.y) < 0.5) & (found.area > 1e-6)
    np.testing.assert_allclose(found.cutting[cut], 1000.0 * found.area[cut], rtol=1e-6)
