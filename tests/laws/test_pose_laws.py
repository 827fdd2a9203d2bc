"""Rigid motions against SciPy's rotations."""

import numpy as np
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from turnwright import HeightMap, Plane, Pose

angles = st.floats(-1.5, 1.5)
shifts = st.tuples(*[st.floats(-100, 100)] * 3)
poses = st.builds(Pose, shift=shifts, rotation=st.floats(-3.1, 3.1), tilt=st.tuples(angles, angles))
POINTS = np.random.default_rng(1).normal(size=(3, 50)) * 10


@given(poses)
def test_a_pose_turns_as_scipy_does(pose):
    turn = Rotation.from_euler("ZXY", [pose.rotation, *pose.tilt])
    np.testing.assert_allclose(pose.matrix, turn.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(pose.apply(*POINTS), turn.apply(POINTS.T).T + np.reshape(pose.shift, (3, 1)), atol=1e-12)


@given(poses, poses)
def test_poses_follow_each_other_and_come_back(one, other):
    np.testing.assert_allclose(one.inverse.apply(*one.apply(*POINTS)), POINTS, atol=1e-11)
    np.testing.assert_allclose(other.after(one).apply(*POINTS), other.apply(*one.apply(*POINTS)), atol=1e-11)


@given(poses)
def test_a_placed_surface_stands_where_its_pose_puts_it(pose):
    small = Pose(shift=pose.shift, rotation=pose.rotation, tilt=(0.5 * pose.tilt[0], 0.5 * pose.tilt[1]))
    placed = Plane(slope=(0.1, 0.05)).placed(shift=small.shift, rotation=small.rotation, tilt=small.tilt)
    x, y = POINTS[:2]
    at = small.apply(x, y, 0.1 * x + 0.05 * y)
    np.testing.assert_allclose(placed.sag(at[0], at[1]), at[2], atol=1e-9)


def test_a_moved_map_keeps_its_valid_points_only():
    z = np.arange(6.0).reshape(2, 3)
    z[0, 1] = np.nan
    moved = HeightMap(x=np.arange(3.0), y=np.arange(2.0), z=z).moved(Pose(shift=(1, 2, 3)))
    assert moved.scattered
    np.testing.assert_array_equal(moved.x, [1, 3, 1, 2, 3])
    np.testing.assert_array_equal(moved.z, [3, 5, 6, 7, 8])
