"""The pose of a rigid body: rotation and shift."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Floats
from turnwright._tables import TableModel
from turnwright._validate import check_angle, check_numbers, finite_tuple
from turnwright.units import Angle, Length

__all__ = ["Pose", "angles_of", "rotation_matrix"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose(TableModel):
    r"""A rigid motion: a point p goes to ``shift + Rz(rotation) Rx(tilt[0]) Ry(tilt[1]) p``.

    The second tilt is about the y axis tilted by the first, the order of lens-design programs and of
    `turnwright.surface.Placed`.

    Parameters
    ----------
    shift
        Where the origin goes (x, y, z). [mm]
    rotation
        About z, counter-clockwise seen from the tool. [rad]
    tilt
        About x, then about y, before the rotation. [rad]

    Raises
    ------
    InputError
        If a number is missing or not finite, or an angle is beyond one turn (an angle in degrees often is).

    >>> quarter = Pose(shift=(1, 0, 0), rotation=np.pi / 2)
    >>> [float(round(one, 12)) for one in quarter.apply(2, 0, 5)]
    [1.0, 2.0, 5.0]
    >>> [float(round(one, 12)) for one in quarter.inverse.apply(1, 2, 5)]
    [2.0, 0.0, 5.0]
    """

    shift: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    rotation: Angle = 0.0
    tilt: tuple[Angle, Angle] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        for name, size in (("shift", 3), ("tilt", 2)):
            object.__setattr__(self, name, finite_tuple(getattr(self, name), name, size))
        object.__setattr__(self, "rotation", check_angle(self.rotation, "rotation"))
        for tilt in self.tilt:
            check_angle(tilt, "tilt")

    @classmethod
    def within_a_turn(cls, shift: Sequence[float] | Floats, rotation: float, tilt: Sequence[float] | Floats) -> Pose:
        """Return a pose from angles that may be beyond one turn, such as fitted ones; full turns are removed."""
        angles = np.fmod([rotation, *tilt], 2 * np.pi).tolist()
        return cls(shift=(shift[0], shift[1], shift[2]), rotation=angles[0], tilt=(angles[1], angles[2]))

    @classmethod
    def of(cls, matrix: ArrayLike, shift: ArrayLike) -> Pose:
        """Return the pose of a rotation matrix (3, 3) and a shift (3,) [mm]; its first tilt is within ±π/2."""
        rotation, *tilt = angles_of(np.asarray(matrix, dtype=np.float64))
        x, y, z = np.asarray(shift, dtype=np.float64)
        return cls(shift=(x, y, z), rotation=rotation, tilt=(tilt[0], tilt[1]))

    @property
    def matrix(self) -> Floats:
        """The rotation matrix. (3, 3)."""
        return rotation_matrix(self.rotation, *self.tilt)

    @property
    def inverse(self) -> Pose:
        """The inverse motion."""
        back = self.matrix.T
        return Pose.of(back, -back @ self.shift)

    def after(self, first: Pose) -> Pose:
        """Return the motion that applies ``first`` and then this one."""
        return Pose.of(self.matrix @ first.matrix, self.matrix @ first.shift + self.shift)

    def apply(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return the moved points. Broadcast [mm]."""
        x, y, z = (np.asarray(coordinate, dtype=np.float64) for coordinate in (x, y, z))
        moved = [
            row[0] * x + row[1] * y + row[2] * z + shift for row, shift in zip(self.matrix, self.shift, strict=True)
        ]
        return moved[0], moved[1], moved[2]


def rotation_matrix(rotation: float, about_x: float, about_y: float) -> Floats:
    """Return the matrix of a rotation and the two tilts before it. (3, 3)."""
    sr, cr, sa, ca, sb, cb = (part(angle) for angle in (rotation, about_x, about_y) for part in (math.sin, math.cos))
    return np.array(
        [
            [cr * cb - sr * sa * sb, -sr * ca, cr * sb + sr * sa * cb],
            [sr * cb + cr * sa * sb, cr * ca, sr * sb - cr * sa * cb],
            [-ca * sb, sa, ca * cb],
        ]
    )


def angles_of(matrix: Floats) -> tuple[float, float, float]:
    """Return the rotation and the two tilts before it of a matrix (3, 3); the first tilt is within ±π/2. [rad]."""
    (_, m01, _), (_, m11, _), (m20, m21, m22) = matrix.tolist()
    return math.atan2(-m01, m11), math.asin(max(-1.0, min(1.0, m21))), math.atan2(-m20, m22)
