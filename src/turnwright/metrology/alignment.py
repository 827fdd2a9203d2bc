"""Shift, rotation and scale of a lens array as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    r"""Shift, rotation and scale that bring the design centres closest to the measured ones.

    Parameters
    ----------
    shift, shift_std
        Of the array, at the axis of the part, and its standard uncertainty from the scatter of the lenslets. [mm]
    rotation, rotation_std
        About the axis of the part, counter-clockwise seen from the tool. [rad]
    scale, scale_std
        Scale factor of all distances, minus one. [1]
    residual
        Residual dislocations. (n, 2) [mm]
    explained_fraction
        Share of the sum of squares of the dislocations, their mean removed, that rotation and scale explain. [1]
    """

    shift: tuple[float, float]
    shift_std: float
    rotation: float
    rotation_std: float
    scale: float
    scale_std: float
    residual: Floats
    explained_fraction: float

    @classmethod
    def of(cls, design: ArrayLike, centres: ArrayLike) -> Alignment:
        """Fit measured centres to design centres, both (n, 2) [mm], n at least 2.

        Raises
        ------
        InputError
            If there are fewer than two lenslets, the numbers of centres differ, or all centres coincide.

        >>> corners = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
        >>> turned = Alignment.of(corners, corners @ [[1, 0.002], [-0.002, 1]])
        >>> round(turned.rotation, 6), round(turned.explained_fraction, 6)
        (0.002, 1.0)
        """
        from_, to = frozen(design, "design centres", ndim=2), frozen(centres, "centres", ndim=2)
        if from_.shape != to.shape or from_.shape[1] != 2 or from_.shape[0] < 2:
            raise InputError(
                f"design centres and centres have the shapes {from_.shape} and {to.shape}, both must be (n, 2) with n "
                "of 2 or more: give x and y of at least two lenslets"
            )
        middle = from_.mean(axis=0)
        about, moved = from_ - middle, to - to.mean(axis=0)
        spread = float(np.sum(about**2))
        if spread <= 0:
            raise InputError("the design centres coincide, at least two must differ: give other centres")
        # As complex numbers a rotation with scale is one factor, found by linear least squares.
        along = float(np.sum(about * moved)) / spread
        across = float(np.sum(about[:, 0] * moved[:, 1] - about[:, 1] * moved[:, 0])) / spread
        turn = np.array([[along, -across], [across, along]])
        residual = moved - about @ turn.T
        shift = to.mean(axis=0) - turn @ middle
        freedom = 2 * from_.shape[0] - 4
        scatter = float(np.sqrt(np.sum(residual**2) / freedom)) if freedom else float("nan")
        dislocated = float(np.sum((moved - about) ** 2))
        return cls(
            shift=(float(shift[0]), float(shift[1])),
            shift_std=scatter * float(np.sqrt(1 / from_.shape[0] + middle @ middle / spread)),
            rotation=float(np.arctan2(across, along)),
            rotation_std=scatter / float(np.sqrt(spread)),
            scale=float(np.hypot(along, across)) - 1,
            scale_std=scatter / float(np.sqrt(spread)),
            residual=frozen(residual, "residual", ndim=2),
            explained_fraction=1 - float(np.sum(residual**2)) / dislocated if dislocated > 0 else float("nan"),
        )
