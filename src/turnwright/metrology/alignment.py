"""What an array of lenslets does as a whole: shift, rotation and scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Alignment"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    r"""The shift, rotation and scale that bring the design centres closest to the found ones.

    What an array as a whole does, such as clocking of the part on the instrument or thermal growth, must not be
    mistaken for an error of the machine from lens to lens: that is the rest.

    Parameters
    ----------
    shift, shift_std
        Of the array, at the axis of the part, and its standard uncertainty from the scatter of the lenslets. [mm]
    rotation, rotation_std
        About the axis of the part, counter-clockwise seen from the tool. [rad]
    scale, scale_std
        Of all distances, less one. [1]
    rest
        Dislocations that remain. (n, 2) [mm]
    share
        How much of the dislocations, their mean removed, rotation and scale explain: share of the squares. [1]
    """

    shift: tuple[float, float]
    shift_std: float
    rotation: float
    rotation_std: float
    scale: float
    scale_std: float
    rest: Floats
    share: float

    @classmethod
    def of(cls, design: ArrayLike, centres: ArrayLike) -> Alignment:
        """Fit found centres to design centres, both (n, 2) [mm], n at least 2.

        Raises
        ------
        InputError
            If there are fewer than two lenslets, not as many of one as of the other, or all in one place.

        >>> corners = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
        >>> turned = Alignment.of(corners, corners @ [[1, 0.002], [-0.002, 1]])
        >>> round(turned.rotation, 6), round(turned.share, 6)
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
            raise InputError("all design centres stand in one place, two places are needed: give other centres")
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
            rest=frozen(residual, "rest", ndim=2),
            share=1 - float(np.sum(residual**2)) / dislocated if dislocated > 0 else float("nan"),
        )
