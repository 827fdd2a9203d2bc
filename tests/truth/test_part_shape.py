"""What `check` says of the shape of a part. Oracles: closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import turnwright as tw
from turnwright.job import part_shape


def shape(surface, radius=5.0):
    return part_shape(tw.Part(surface=surface, radius=radius))


@pytest.mark.parametrize("radius", [40.0, -40.0])
def test_a_sphere_is_its_own_best_fit(radius):
    found = shape(tw.Sphere(radius=radius))
    sag = 40.0 - np.sqrt(40.0**2 - 25.0)
    assert found.highest - found.lowest == pytest.approx(sag, rel=1e-12)
    assert found.steepest == pytest.approx(np.arcsin(5.0 / 40.0), rel=1e-12)
    assert found.sphere_radius == pytest.approx(radius, rel=1e-6)
    assert found.departure_pv < 1e-9
    least = found.concave_radius if radius > 0 else found.convex_radius
    assert least == pytest.approx(40.0, rel=1e-9)
    assert np.isinf(found.convex_radius if radius > 0 else found.concave_radius)


def test_a_paraboloid_curves_most_at_its_vertex():
    found = shape(tw.Conic(radius=20.0, conic=-1.0))
    assert found.concave_radius == pytest.approx(20.0, rel=1e-9)
    assert found.steepest == pytest.approx(np.arctan(5.0 / 20.0), rel=1e-12)
    # The best sphere of r²/2R by hand: the departure is of fourth order, r⁴/8R³ and its part in piston and power.
    assert 1e-5 < found.departure_pv < 5.0**4 / (8 * 20.0**3)


def test_a_sine_grid_curves_both_ways():
    found = shape(tw.SineGrid(amplitude=(0.002, 0.002), period=(2.5, 2.5)), radius=2.5)
    wave = 2 * np.pi / 2.5
    assert found.convex_radius == pytest.approx(1 / (0.002 * wave**2), rel=2e-3)
    assert found.concave_radius == pytest.approx(1 / (0.002 * wave**2), rel=2e-3)


def test_a_plane_is_flat():
    found = shape(tw.Plane(slope=(0.01, 0.0)))
    assert found.steepest == pytest.approx(np.arctan(0.01), rel=1e-12)
    assert found.departure_pv < 1e-12
    assert found.facts["Least radius of curvature"] == "none, it is flat"
    assert found.facts["Best-fit sphere"] == "none, the part is flat"


def test_where_no_sphere_fits_the_departure_is_from_the_plane():
    found = replace(shape(tw.Plane(slope=(0.01, 0.0))), departure_pv=2e-3, departure_rms=1e-3)
    assert found.facts["Best-fit sphere"] == "none, a plane fits best, departure PV 2 um, RMS 1 um"


def test_the_vertex_of_an_off_axis_part_is_at_0_nm():
    """Oracle: it is moved there; what rounding leaves of it is no height."""
    surface = tw.OffAxis(parent=tw.Conic(radius=200.0, conic=-1.0), distance=40.0)
    shape = part_shape(tw.Part(surface=surface, radius=8.0))
    assert float(surface.sag(0.0, 0.0)) != 0
    assert shape.facts["Heights"].startswith("0 nm to ")
