"""Off-axis parts: a segment of a parent surface, moved to the spindle axis."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._validate import check_angle, check_numbers, instance_of
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
    r"""An off-axis segment of a parent surface, with its vertex on the spindle axis and its normal along it.

    The point of the parent at ``distance`` and ``azimuth`` moves to the origin. The parent is rotated by the smallest
    angle that brings its normal at that point along z, so its directions x and y are kept: an off-axis paraboloid with
    azimuth 0 has its parent's axis at negative x.

    Parameters
    ----------
    parent
        The parent surface, about its own axis.
    distance
        Distance of the part's vertex from the parent's axis. [mm]
    azimuth
        Azimuth of the part's vertex about the parent's axis, counter-clockwise from x seen from the tool. [rad]

    Raises
    ------
    InputError
        If the parent is not a surface, or a number is not finite or out of range.
    DomainError
        If the parent is not defined at the vertex of the part.

    Notes
    -----
    With the gradient :math:`(f_x, f_y)` of the parent at the vertex, the rotation is by :math:`\arctan |\nabla f|`
    about the horizontal axis perpendicular to the gradient. Heights and derivatives are those of `Placed`.

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
        instance_of(self.parent, Surface, "the parent of an off-axis part")
        distance = float(self.distance)
        azimuth = check_angle(self.azimuth, "the azimuth of an off-axis part")
        if distance < 0:
            raise InputError(
                f"the distance of an off-axis part is {distance:g} mm, it must be 0 mm or more: use the opposite "
                "azimuth"
            )
        try:
            fx, fy = (float(part) for part in self.parent.gradient(*self._at))
            height = float(self.parent.sag(*self._at))
        except DomainError as error:
            raise DomainError(f"the distance of the off-axis part is {distance:g} mm: {error}") from error
        # The smallest rotation from the normal n to z: I + [n x z] + [n x z]^2 / (1 + n_z), n_z > 0.
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
        """Position of the part's vertex in the parent's xy plane. [mm]."""
        return float(self.distance * np.cos(self.azimuth)), float(self.distance * np.sin(self.azimuth))

    @property
    def vertex(self) -> tuple[float, float, float]:
        """Position of the part's vertex in the parent's frame (x, y, z). [mm]."""
        return *self._at, float(self.parent.sag(*self._at))

    @property
    def lean(self) -> float:
        """Angle between the axes of parent and part, the slope angle of the parent at the vertex. [rad]."""
        return float(np.arctan(np.hypot(*self.parent.gradient(*self._at))))

    @property
    def pose(self) -> Pose:
        """Pose of the parent's frame in the part frame."""
        return self._moved.pose

    @property
    def cost(self) -> int:
        """Cost of the moved parent. See `Surface.cost`."""
        return self._moved.cost

    @property
    def remarks(self) -> tuple[str, ...]:
        """Vertex of the part, and pose of the parent. See `Surface.remarks`."""
        vertex, shift = (_format_values(values, "mm") for values in (self.vertex, self.pose.shift))
        tilt = _format_values(np.rad2deg(self.pose.tilt), "deg")
        sentence = (
            f"off-axis part: its vertex is at {vertex} of the parent; in the part, the parent's axis is inclined by "
            f"{_format_values([np.rad2deg(self.lean)])} deg (tilt {tilt}, rotation "
            f"{_format_values([np.rad2deg(self.pose.rotation)])} deg) and its vertex is at {shift}"
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
        """The domain of the part in words."""
        return self._moved.domain

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the pieces of the parent."""
        return self._moved.piece(x, y)

    @property
    def feature_size(self) -> float:
        """Feature size of the parent, foreshortened. [mm]."""
        return self._moved.feature_size


def _format_values(values: Iterable[float], unit: str = "") -> str:
    """Return a number to six decimals; with a unit, the numbers of several axes with their names."""
    texts = [f"{round(float(value), 6) + 0.0:.6f}".rstrip("0").rstrip(".") for value in values]
    return ", ".join(f"{axis} = {text} {unit}" for axis, text in zip("xyz", texts, strict=False)) if unit else texts[0]
