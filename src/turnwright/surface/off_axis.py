"""Off-axis parts: a piece of a larger surface, brought to the spindle axis."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._validate import check_angle, check_numbers
from turnwright.errors import DomainError, InputError
from turnwright.pose import Pose
from turnwright.surface.base import Surface
from turnwright.surface.compound import Placed
from turnwright.units import Angle, Thickness

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["OffAxis"]


@dataclass(frozen=True, slots=True, kw_only=True)
class OffAxis(Surface):
    r"""A piece of a parent surface away from its axis, with its own vertex on the spindle axis and level there.

    The point of the parent at ``distance`` and ``azimuth`` goes to the origin. The parent is turned by the smallest
    angle that brings its normal at that point along z, so the directions of the parent stay those of the part: an
    off-axis paraboloid with azimuth 0 has its parent's axis at negative x.

    Parameters
    ----------
    parent
        The surface that the part is a piece of, about its own axis.
    distance
        From the parent's axis to the vertex of the part, across the axis. [mm]
    azimuth
        Of the part's vertex about the parent's axis, counter-clockwise from x seen from the tool. [rad]

    Raises
    ------
    InputError
        If the parent is no surface, or a number is not finite or out of its range.
    DomainError
        If the parent is not defined at the vertex of the part.

    Notes
    -----
    With the gradient :math:`(f_x, f_y)` of the parent at the vertex, the turn is by :math:`\arctan |\nabla f|` about
    the level axis across the gradient. Heights and derivatives are those of the parent so moved, see `Placed`.

    Examples
    --------
    >>> from turnwright.surface.conic import Conic
    >>> parabola = OffAxis(parent=Conic(radius=100.0, conic=-1.0), distance=60.0)
    >>> parabola.vertex
    (60.0, 0.0, 18.0)
    >>> round(float(np.rad2deg(parabola.lean)), 3)   # arctan(60/100)
    30.964
    """

    family = "off-axis"
    example = MappingProxyType({"parent": {"family": "conic", "radius": "200 mm", "conic": -1.0}, "distance": "30 mm"})
    parent: Surface
    distance: Thickness
    azimuth: Angle = 0.0
    _moved: Placed = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        if not isinstance(self.parent, Surface):
            raise InputError(f"the parent of an off-axis part is {self.parent!r}, it must be a surface: give a Surface")
        distance = float(self.distance)
        azimuth = check_angle(self.azimuth, "the azimuth of an off-axis part")
        if distance < 0:
            raise InputError(
                f"the distance of an off-axis part is {distance:g} mm, it must be 0 mm or more: turn azimuth"
            )
        try:
            fx, fy = (float(part) for part in self.parent.gradient(*self._at))
            height = float(self.parent.sag(*self._at))
        except DomainError as error:
            raise DomainError(f"the distance of the off-axis part is {distance:g} mm: {error}") from error
        # The smallest turn that takes the normal n to z: I + [n x z] + [n x z]^2 / (1 + n_z), n_z > 0.
        nx, ny, nz = np.array([-fx, -fy, 1.0]) / np.sqrt(1 + fx * fx + fy * fy)
        turn = np.array(
            [
                [1 - nx * nx / (1 + nz), -nx * ny / (1 + nz), -nx],
                [-nx * ny / (1 + nz), 1 - ny * ny / (1 + nz), -ny],
                [nx, ny, nz],
            ]
        )
        pose = Pose.of(turn, -turn @ (*self._at, height))
        object.__setattr__(self, "distance", distance)
        object.__setattr__(self, "azimuth", azimuth)
        moved = Placed(surface=self.parent, shift=pose.shift, rotation=pose.rotation, tilt=pose.tilt)
        object.__setattr__(self, "_moved", moved)

    @property
    def _at(self) -> tuple[float, float]:
        """Where the part's vertex stands over the parent's own plane. [mm]."""
        return float(self.distance * np.cos(self.azimuth)), float(self.distance * np.sin(self.azimuth))

    @property
    def vertex(self) -> tuple[float, float, float]:
        """Where the part's vertex lies in the frame of the parent (x, y, z). [mm]."""
        return *self._at, float(self.parent.sag(*self._at))

    @property
    def lean(self) -> float:
        """Angle by which the parent's axis leans in the part: that of the parent's slope at the vertex. [rad]."""
        return float(np.arctan(np.hypot(*self.parent.gradient(*self._at))))

    @property
    def pose(self) -> Pose:
        """Where the frame of the parent sits in the part's."""
        return self._moved.pose

    @property
    def remarks(self) -> tuple[str, ...]:
        """Say where vertex, tilt and shift of the part are. See `Surface.remarks`."""
        at, own = (_shown(values, "mm") for values in (self.vertex, self.pose.shift))
        tilt = _shown(np.rad2deg(self.pose.tilt), "deg")
        sentence = (
            f"off-axis part: its vertex lies at {at} of the parent, which leans by {_shown([np.rad2deg(self.lean)])} "
            f"deg in the part: its tilt is {tilt}, its rotation {_shown([np.rad2deg(self.pose.rotation)])} deg, its "
            f"own vertex is shifted to {own}"
        )
        return sentence, *self.parent.remarks

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return the height and its derivatives in the part frame. See `Surface.evaluate`."""
        return self._moved.evaluate(x, y, order)

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where the parent is defined and does not overhang."""
        return self._moved.inside(x, y)

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return the parent's poles. See `Surface.poles`."""
        return self._moved.poles(x, y, reach)

    @property
    def domain(self) -> str:
        """Say in words where the part is defined."""
        return self._moved.domain

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the pieces of the parent."""
        return self._moved.piece(x, y)

    @property
    def feature_size(self) -> float:
        """The parent's, foreshortened. [mm]."""
        return self._moved.feature_size


def _shown(values: Iterable[float], unit: str = "") -> str:
    """Return numbers to six decimals, those of several axes with their names."""
    plain = [f"{round(float(value), 6) + 0.0:.6f}".rstrip("0").rstrip(".") for value in values]
    return ", ".join(f"{axis} = {one} {unit}" for axis, one in zip("xyz", plain, strict=False)) if unit else plain[0]
