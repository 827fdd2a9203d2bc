"""What registration refuses."""

import numpy as np
import pytest

from turnwright import HeightMap, InputError, Part, Plane, Pose, Sphere, XYPolynomial, register

PART = Part(surface=Sphere(radius=20.0), radius=5.0)
AXIS = np.linspace(-3, 3, 13)
X, Y = np.meshgrid(AXIS, AXIS)
MAP = HeightMap(x=AXIS, y=AXIS, z=PART.surface.sag(X, Y))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"free": ("x", "tip")}, r"free has \['tip'\], allowed are x, y, z, rotation, tilt_x, tilt_y"),
        ({"free": ()}, "free has no entry"),
        ({"distance": "radial"}, 'distance is \'radial\', it must be "vertical" or "normal"'),
        ({"loss": "l1"}, 'loss is \'l1\', it must be "linear", "huber" or "tukey"'),
        ({"undetermined": "no"}, "undetermined is 'no'"),
        ({"reach": -1.0}, "reach of the search is -1 mm"),
        ({"clocking": 7.0}, "clocking of the search is 7 rad"),
        ({"noise_nm": 0.0}, "noise is 0 nm"),
        ({"form_error": -1.0}, "form_error is -1 mm"),
        ({"terms": [Plane()]}, "the term Plane has the height 0 mm over the part"),
        ({"start": Pose(shift=(50, 0, 0)), "reach": 0.0}, "fewer than 8 of the .* heights of the map lie within 5 mm"),
    ],
)
def test_a_wrong_request_is_named(options, match):
    with pytest.raises(InputError, match=match):
        register(MAP, PART, **options)


@pytest.mark.parametrize("across", [0.02, 5e-6])
def test_a_field_too_small_to_be_looked_for_is_refused(across):
    """Metres that are read as millimetres, say; 100 um of the same part are found."""
    part = Part(surface=XYPolynomial(terms={(2, 0): 1e-3, (0, 2): 2e-3, (3, 0): 2e-4, (1, 2): -1e-4}), radius=3.0)
    axis = np.linspace(-across / 2, across / 2, 41)
    x, y = np.meshgrid(axis, axis)
    small = HeightMap(x=axis, y=axis, z=part.surface.sag(x, y))
    with pytest.raises(InputError, match=r"a reach of 5 mm .* million positions .* Check the unit .* of at most"):
        register(small, part)
    assert register(small, part, reach=across, clocking=0.0).rms_nm < 1e-3


def test_a_reach_beyond_the_part_costs_no_places():
    """Oracle: the same map within a reach that ends at the rim; where none of it lies on the part, no place counts."""
    wide, near = (register(MAP, PART, reach=reach, clocking=0.0) for reach in (1e4, 5.0))
    assert wide.rms_nm < 1e-3
    np.testing.assert_allclose(wide.pose.shift, near.pose.shift, atol=1e-6)


def test_a_map_without_heights_or_lengths_is_refused():
    with pytest.raises(InputError, match="has 0 valid heights, a registration needs 7"):
        register(HeightMap(x=AXIS, y=AXIS, z=np.full((13, 13), np.nan)), PART)
    with pytest.raises(InputError, match="no pixel size"):
        register(HeightMap(x=AXIS, y=AXIS, z=MAP.z, calibrated=False), PART)


def test_fixed_degrees_of_freedom_keep_the_start_and_are_named():
    start = Pose(shift=(0.1, -0.2, 0.0), rotation=0.3)
    found = register(MAP, PART, start=start)
    assert found.held == ("x", "y", "rotation")
    assert found.pose.rotation == 0.3
    assert found.names == ("z", "tilt_x", "tilt_y")
    np.testing.assert_allclose(found.pose.apply(*found.pivot)[:2], start.apply(*found.pivot)[:2], atol=1e-12)
    assert any(one == "Not determined by the fit and fixed at the start: x, y, rotation." for one in found.sentences)


def test_only_what_is_free_moves():
    found = register(MAP, PART, free=("z",))
    assert found.names == ("z",)
    assert found.pose.rotation == 0
    assert found.pose.tilt == (0, 0)
    assert found.pose.shift == pytest.approx((0, 0, 0), abs=1e-12)
