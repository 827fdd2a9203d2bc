"""Several parts on one chuck, each with its own prescription, place and clocking, cut by one spiral."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._tables import TableModel, read_by
from turnwright._validate import check_angle, check_numbers, finite, finite_tuple, instance_of
from turnwright.errors import InputError
from turnwright.outline import Outline
from turnwright.pose import Pose
from turnwright.surface import Gridded, Surface
from turnwright.units import NAME_PATTERN, Angle, Length, Text

__all__ = ["Assembled", "Chuck", "Mounted"]

PIECE_BITS = 48
"""Bits of the number of a piece for those of one part."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounted(TableModel):
    """A part on a chuck, or a fiducial: a sphere, a flat or a groove that is cut along.

    Parameters
    ----------
    name
        Name of the part.
    surface
        Its finished surface, in the frame of the part.
    outline
        Its clear aperture in this frame, in plan view.
    position
        Position of the origin of this frame on the chuck (x, y). [mm]
    height
        Height of the origin above that of the chuck's frame. [mm]
    clocking
        Rotation of the part about its own z, counter-clockwise seen from the tool. [rad]
    tilt
        Tilt of its surface about its own x axis, then about its own y axis, before the clocking. [rad]
    correction
        Heights added to the surface for the tool path, in the frame of the chuck, as `correct` writes them.

    Raises
    ------
    InputError
        If the name is empty, or a number is not finite or out of range.
    """

    name: Text
    surface: Surface
    outline: Outline
    position: tuple[Length, Length] = (0.0, 0.0)
    height: Length = 0.0
    clocking: Angle = 0.0
    tilt: tuple[Angle, Angle] = (0.0, 0.0)
    correction: Annotated[Gridded | None, read_by("correction")] = None

    def __post_init__(self) -> None:
        check_numbers(self)
        if not re.fullmatch(NAME_PATTERN, self.name):
            raise InputError(
                f"a part of the chuck has the name {self.name[:40]!r}, it must have 1 to 30 letters, digits, spaces, _ "
                "or -"
            )
        instance_of(self.surface, Surface, f"the surface of {self.name!r}")
        instance_of(self.outline, Outline, f"the outline of {self.name!r}")
        object.__setattr__(self, "position", finite_tuple(self.position, f"position of {self.name!r}", 2))
        object.__setattr__(self, "tilt", finite_tuple(self.tilt, f"tilt of {self.name!r}", 2))
        finite(self.height, f"height of {self.name!r}")
        check_angle(self.clocking, f"clocking of {self.name!r}")

    @property
    def border(self) -> Outline:
        """The outline on the chuck."""
        return self.outline.moved(self.position, self.clocking)

    @property
    def pose(self) -> Pose:
        """Position and clocking on the chuck, without tilt."""
        return Pose(shift=(*self.position, self.height), rotation=self.clocking)

    @property
    def placed(self) -> Surface:
        """The finished surface on the chuck."""
        return self.surface.placed(shift=(*self.position, self.height), rotation=self.clocking, tilt=self.tilt)

    @property
    def aimed(self) -> Surface:
        """The surface on the chuck that the tool path is planned for, its correction included."""
        return self.placed if self.correction is None else self.placed + self.correction


@dataclass(frozen=True, slots=True, kw_only=True)
class Assembled(Surface):
    """Surfaces side by side, each where its own outline is the nearest.

    Parameters
    ----------
    surfaces
        Surfaces in one frame.
    outlines, names
        Outline and name of each.
    """

    surfaces: tuple[Surface, ...]
    outlines: tuple[Outline, ...]
    names: tuple[str, ...]

    def number(self, x: Floats, y: Floats) -> Ints:
        """Return the number of the surface at points, of their shape."""
        return np.asarray(np.argmin([one.distance(x, y) for one in self.outlines], axis=0))

    def evaluate(self, x: Floats, y: Floats, order: int) -> tuple[Floats, ...]:
        """Return height and derivatives. See `Surface.evaluate`."""
        number = self.number(x, y)
        made = tuple(np.full(x.shape, np.nan) for _ in range((1, 3, 6)[order]))
        for k, surface in enumerate(self.surfaces):
            if (on := number == k).any():
                for values, one in zip(made, surface.evaluate(x[on], y[on], order), strict=True):
                    values[on] = one
        return made

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where the nearest surface is defined."""
        number, inside = self.number(x, y), np.ones(x.shape, dtype=np.bool_)
        for k, surface in enumerate(self.surfaces):
            on = number == k
            if on.any() and (defined := surface.inside(x[on], y[on])) is not None:
                inside[on] = defined
        return inside

    def poles(self, x: Floats, y: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return the poles of every surface on its outline. See `Surface.poles`."""
        poles = []
        for surface, outline in zip(self.surfaces, self.outlines, strict=True):
            at_x, at_y = surface.poles(x, y, reach)
            on = outline.covers(at_x, at_y)
            poles.append((at_x[on], at_y[on]))
        return tuple(np.concatenate(one) for one in zip(*poles, strict=True))  # type: ignore[return-value]

    def piece(self, x: Floats, y: Floats) -> Ints | None:
        """Return the pieces: at least one for each surface."""
        number = self.number(x, y).astype(np.int64)
        piece = number << PIECE_BITS
        for k, surface in enumerate(self.surfaces):
            on = number == k
            if on.any() and (within := surface.piece(x[on], y[on])) is not None:
                piece[on] += within
        return piece

    @property
    def feature_size(self) -> float:
        """Size of the finest structure of any surface. [mm]."""
        return min(one.feature_size for one in self.surfaces)

    @property
    def cost(self) -> int:
        """Cost of the surfaces per point, in additions."""
        return max(one.cost for one in self.surfaces)

    @property
    def domain(self) -> str:
        """The domains of the surfaces."""
        return "the domain of the nearest part"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks of all surfaces."""
        return tuple(dict.fromkeys(sentence for one in self.surfaces for sentence in one.remarks))


@dataclass(frozen=True, slots=True, kw_only=True)
class Chuck(Assembled):
    """Several parts on one chuck.

    Parameters
    ----------
    parts
        The parts and fiducials.

    Raises
    ------
    InputError
        If there is no part, two have the same name, or two outlines overlap.

    Examples
    --------
    >>> from turnwright.surface import Sphere
    >>> mirror = {"surface": Sphere(radius=200.0), "outline": Outline(rectangle=(20.0, 10.0))}
    >>> pair = Chuck(parts=[Mounted(name="A", position=(30.0, 0.0), **mirror),
    ...                     Mounted(name="B", position=(-30.0, 0.0), clocking=np.pi, **mirror)])
    >>> pair.sag(np.array([30.0, -30.0]), np.zeros(2)).tolist()
    [0.0, 0.0]
    """

    family: ClassVar[str] = "chuck"
    has_outline: ClassVar[bool] = True
    example: ClassVar[Mapping[str, Any]] = MappingProxyType({
        "parts": [{
            "name": "A", "surface": {"family": "plane"}, "outline": {"disc": "2 mm"},
            "position": ["3 mm", "0 mm"],
        }]
    })  # fmt: skip
    hidden: ClassVar[tuple[str, ...]] = ("surfaces", "outlines", "names")
    parts: tuple[Mounted, ...]
    surfaces: tuple[Surface, ...] = field(init=False, repr=False, compare=False)
    outlines: tuple[Outline, ...] = field(init=False, repr=False, compare=False)
    names: tuple[str, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        parts = tuple(instance_of(one, Mounted, "a part of the chuck") for one in self.parts)
        names = tuple(one.name for one in parts)
        if not parts:
            raise InputError("a chuck has 0 parts, it needs at least 1")
        if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
            raise InputError(f"two parts of the chuck have the name {twice!r}: rename one")
        borders = tuple(one.border for one in parts)
        for k, border in enumerate(borders):
            for j in range(k):
                if borders[j].overlaps(border):
                    raise InputError(
                        f"the parts {names[j]!r} and {names[k]!r} of the chuck overlap: move or shrink one"
                    )
        surfaces = tuple(one.placed for one in parts)
        for key, value in (("parts", parts), ("surfaces", surfaces), ("outlines", borders), ("names", names)):
            object.__setattr__(self, key, value)

    @property
    def outline(self) -> Outline:
        """The outlines of all parts."""
        return Outline(several=self.outlines)

    @property
    def aimed(self) -> Assembled:
        """The surfaces that the tool path is planned for, corrections included."""
        if all(one.correction is None for one in self.parts):
            return self
        return Assembled(surfaces=tuple(one.aimed for one in self.parts), outlines=self.outlines, names=self.names)

    def mounted(self, name: str) -> Mounted:
        """Return the part of a name.

        Raises
        ------
        InputError
            If the chuck has no part of this name.
        """
        for one in self.parts:
            if one.name == name:
                return one
        raise InputError(f"the chuck has no part {name[:40]!r}, it has {', '.join(one.name for one in self.parts)}")
