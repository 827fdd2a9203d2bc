"""Heights over a grid: designed, generated, measured or their difference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats, frozen
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.surface import Surface

__all__ = ["HeightMap"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightMap:
    """Heights over a rectangular grid (``x``, ``y``) or over a polar one (``radius``, ``angle``).

    Parameters
    ----------
    z
        Heights; nan is a missing point. (ny, nx), or (n_angle, n_radius) [mm]
    x, y
        Ascending columns (nx,) and rows (ny,) of a rectangular grid. [mm]
    radius, angle
        Columns (n_radius,) [mm] and rows (n_angle,) [rad] of a polar grid.
    name
        What the map shows.

    Raises
    ------
    InputError
        If the axes do not fit the heights, or are neither both rectangular nor both polar.
    """

    z: Floats
    x: Floats | None = None
    y: Floats | None = None
    radius: Floats | None = None
    angle: Floats | None = None
    name: str = ""

    def __post_init__(self) -> None:
        given = [name for name in ("x", "y", "radius", "angle") if getattr(self, name) is not None]
        if given not in (["x", "y"], ["radius", "angle"]):
            raise InputError(
                f"a height map has the axes {', '.join(given) or 'none'}: give x and y, or radius and angle"
            )
        for name in given:
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        object.__setattr__(self, "z", frozen(self.z, "z", ndim=2, finite=False))
        shape = (getattr(self, given[1]).size, getattr(self, given[0]).size)
        if self.z.shape != shape:
            raise InputError(
                f"z has the shape {self.z.shape} and its axes {shape}: rows are {given[1]}, columns {given[0]}"
            )

    @property
    def polar(self) -> bool:
        """Whether the grid is polar."""
        return self.radius is not None

    def points(self) -> tuple[Floats, Floats]:
        """Return x and y of every height. Each the shape of ``z`` [mm]."""
        if self.radius is not None and self.angle is not None:
            return np.cos(self.angle)[:, None] * self.radius, np.sin(self.angle)[:, None] * self.radius
        x, y = np.meshgrid(self.x, self.y)  # type: ignore[arg-type]
        return x, y

    def minus(self, other: HeightMap | Surface) -> HeightMap:
        """Return this map minus another on the same grid, or minus a surface. Cut minus design is the error.

        Raises
        ------
        InputError
            If the other map has another grid.
        DomainError
            If the surface is not defined at a point of the map.
        """
        if isinstance(other, HeightMap):
            for name in ("x", "y", "radius", "angle"):
                mine, theirs = getattr(self, name), getattr(other, name)
                if (mine is None) != (theirs is None) or (mine is not None and not np.array_equal(mine, theirs)):
                    raise InputError(f"the two height maps differ in {name}: bring them to one grid first")
            z = self.z - other.z
        else:
            z = self.z - other.sag(*self.points())
        return HeightMap(
            z=z, x=self.x, y=self.y, radius=self.radius, angle=self.angle, name=f"{self.name} error".strip()
        )
