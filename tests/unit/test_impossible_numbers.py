"""Numbers that no thing has: not finite, not whole where they count, degrees where radians are meant."""

import numpy as np
import pytest

import turnwright as tw
from turnwright.motion import SpeedProfile

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
    "tilt in degrees": (lambda: FLAT.placed(tilt=(1, 0)), "tilt is 1 rad.*limit is 0.7854 rad"),
    "spiral in degrees": (
        lambda: tw.Spiral(angle=np.arange(0, 3600, 5.0), radius=np.linspace(1, 0, 720)), "angles are in rad",
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
