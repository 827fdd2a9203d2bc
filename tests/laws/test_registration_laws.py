"""Registration finds the motion that was put in."""

import numpy as np
from hypothesis import given, strategies as st

from laws import examples
from turnwright import HeightMap, Part, Pose, XYPolynomial, register

PART = Part(
    surface=XYPolynomial(terms={(2, 0): 1 / 60, (0, 2): 1 / 40, (3, 0): 2e-3, (1, 2): -1e-3, (0, 3): 1e-3}), radius=6.0
)
RNG = np.random.default_rng(1)
X, Y = RNG.uniform(-4, 4, (2, 400))
MAP = HeightMap(x=X, y=Y, z=PART.surface.sag(X, Y))

angles = st.floats(-0.08, 0.08)
poses = st.builds(Pose, shift=st.tuples(*[st.floats(-4, 4)] * 3), rotation=angles, tilt=st.tuples(angles, angles))


@examples(15)
@given(poses)
def test_a_moved_map_is_found_where_it_was_moved_from(pose):
    found = register(MAP.moved(pose.inverse), PART)
    np.testing.assert_allclose(found.pose.shift, pose.shift, atol=1e-9)
    np.testing.assert_allclose([found.pose.rotation, *found.pose.tilt], [pose.rotation, *pose.tilt], atol=1e-10)
    assert np.nanmax(np.abs(found.residual.z)) < 1e-10


@examples(8)
@given(poses)
def test_the_residual_does_not_depend_on_how_the_map_lies(pose):
    rough = HeightMap(x=X, y=Y, z=MAP.z + 1e-5 * np.sin(3 * X) * np.cos(2 * Y))
    here, there = register(rough, PART), register(rough.moved(pose.inverse), PART)
    np.testing.assert_allclose(there.residual.z, here.residual.z, atol=1e-9)
    np.testing.assert_allclose(there.pose.after(pose.inverse).shift, here.pose.shift, atol=1e-7)
