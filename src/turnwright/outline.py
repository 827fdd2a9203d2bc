"""The outline of a part: a disc, an annulus, a rectangle or a polygon anywhere on the chuck, with holes; or several."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Annotated

import numpy as np
from annotated_types import MinLen

from turnwright._arrays import Bools, Floats
from turnwright._tables import TableModel
from turnwright._validate import check_angle, check_numbers, finite_tuple, instance_of, positive
from turnwright.errors import InputError
from turnwright.units import Angle, Length, Size

__all__ = ["BORDER_TOL", "Outline"]

SHAPES = ("disc", "annulus", "rectangle", "polygon", "several")

MAX_CORNERS = 10_000
MAX_HOLES = 1000

BORDER_TOL = 1e-9
"""Distance outside the border up to which a point counts as on the part. [mm]"""

BORDER_POINTS = 3600
"""Points of the border at which the slope of the surface is evaluated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline(TableModel):
    """The outline of a part in plan view; give one of its five shapes.

    Parameters
    ----------
    disc
        Radius of a disc. [mm]
    annulus
        Outer and inner radius of an annulus. [mm]
    rectangle
        Length along x and along y, before it is rotated. [mm]
    polygon
        Corners (x, y) in order, before it is rotated and moved. [mm]
    several
        Outlines apart from each other, as of several parts on a chuck; without centre, angle and holes of its own.
    centre
        Position of the centre, or for a polygon of its origin, in the part frame (x, y). [mm]
    angle
        Rotation of a rectangle or polygon about this centre, counter-clockwise seen from the tool. [rad]
    holes
        Holes inside the outline, each an outline without holes, with its centre in the part frame. The distance between
        any two borders is above 0.

    Raises
    ------
    InputError
        If not exactly one shape is given, a polygon crosses itself, a hole is not inside, or two of several outlines
        overlap.

    >>> mirror = Outline(rectangle=(40.0, 20.0), centre=(40.0, 0.0), holes=(Outline(disc=2.0, centre=(45.0, 0.0)),))
    >>> mirror.reach.__round__(6), mirror.nearest
    (60.827625, 20.0)
    >>> mirror.distance(np.array([40.0, 45.0, 70.0]), np.array([0.0, 0.0, 0.0])).tolist()
    [-3.0, 2.0, 10.0]
    """

    disc: Size | None = None
    annulus: tuple[Size, Size] | None = None
    rectangle: tuple[Size, Size] | None = None
    polygon: Annotated[tuple[tuple[Length, Length], ...], MinLen(3)] | None = None
    several: Annotated[tuple[Outline, ...], MinLen(1)] | None = None
    centre: tuple[Length, Length] = (0.0, 0.0)
    angle: Angle = 0.0
    holes: tuple[Outline, ...] = ()

    def __post_init__(self) -> None:
        check_numbers(self)
        shapes = [name for name in SHAPES if getattr(self, name) is not None]
        if len(shapes) != 1:
            raise InputError(
                f"an outline has {' and '.join(shapes) or 'no shape'}, it needs exactly one of {', '.join(SHAPES)}"
            )
        object.__setattr__(self, "centre", finite_tuple(self.centre, "centre of an outline", 2))
        check_angle(self.angle, "angle of an outline")
        if self.angle and (self.disc is not None or self.annulus is not None):
            raise InputError(f"a {shapes[0]} has the angle {self.angle:g} rad, which has no effect: leave it out")
        if self.disc is not None:
            positive(self.disc, "disc of an outline", "mm")
        for name in ("annulus", "rectangle"):
            if (sizes := getattr(self, name)) is not None:
                object.__setattr__(self, name, finite_tuple(sizes, f"{name} of an outline", 2))
                for size in sizes:
                    positive(size, f"{name} of an outline", "mm")
        if self.annulus is not None and self.annulus[0] <= self.annulus[1]:
            raise InputError(
                f"the annulus has the radii {self.annulus[0]:g} and {self.annulus[1]:g} mm, the first must be the "
                "larger: exchange them"
            )
        if self.polygon is not None:
            object.__setattr__(self, "polygon", _check_polygon(self.polygon))
        object.__setattr__(
            self, "holes", tuple(instance_of(one, Outline, "a hole of an outline") for one in self.holes)
        )
        if self.several is not None:
            self._check_several()
            return
        self._check_holes()

    def _check_several(self) -> None:
        """Raise unless several outlines are apart from each other."""
        several = tuple(instance_of(one, Outline, "one of several outlines") for one in self.several or ())
        object.__setattr__(self, "several", several)
        if self.angle or self.centre != (0.0, 0.0) or self.holes:
            raise InputError("several outlines have a centre, an angle or holes in common: state them at each outline")
        if not 1 <= len(several) <= MAX_HOLES:
            raise InputError(f"several outlines are {len(several)}, the limits are 1 and {MAX_HOLES}")
        if any(one.several is not None for one in several):
            raise InputError("one of several outlines has several itself: list them all")
        for (i, one), (j, other) in combinations(enumerate(several, 1), 2):
            if one.overlaps(other):
                raise InputError(f"outlines {i} and {j} of several overlap: move or shrink one")

    def overlaps(self, other: Outline) -> bool:
        """Return whether this outline and another have points in common."""
        loops, others = list(self._loops()), list(other._loops())
        return (
            not all(_is_apart(one, two) for one in loops for two in others)
            or bool(self.covers(*others[0].point)[0])
            or bool(other.covers(*loops[0].point)[0])
        )

    def moved(self, shift: tuple[float, float], rotation: float) -> Outline:
        """Return the outline rotated about the origin, counter-clockwise [rad], then shifted [mm]."""
        if self.several is not None:
            return Outline(several=tuple(one.moved(shift, rotation) for one in self.several))
        cosine, sine = math.cos(rotation), math.sin(rotation)
        x, y = self.centre
        turned = self.rectangle is not None or self.polygon is not None
        return replace(
            self, centre=(cosine * x - sine * y + shift[0], sine * x + cosine * y + shift[1]),
            angle=math.remainder(self.angle + rotation, 2 * math.pi) if turned else 0.0,
            holes=tuple(one.moved(shift, rotation) for one in self.holes),
        )  # fmt: skip

    def _check_holes(self) -> None:
        """Raise unless all holes are inside, and apart from each other."""
        if len(self.holes) > MAX_HOLES:
            raise InputError(f"an outline has {len(self.holes)} holes, the limit is {MAX_HOLES}")
        outer = next(self._loops())
        for number, hole in enumerate(self.holes, 1):
            if hole.holes or hole.annulus is not None:
                raise InputError(f"holes[{number}] of an outline is not a disc, a rectangle or a polygon: simplify it")
            curve = next(hole._loops())  # noqa: SLF001 - of this class
            if not _is_apart(outer, curve) or not outer.signed(*curve.point)[0] < 0:
                raise InputError(f"holes[{number}] of an outline is not inside it: move or shrink the hole")
            if self.annulus is not None and _Circle(self.centre, self.annulus[1]).signed(*curve.point)[0] < 0:
                raise InputError(f"holes[{number}] of an outline is inside the annulus: remove it")
        borders = list(self._loops())[1:]
        for (i, one), (j, other) in combinations(enumerate(borders, 1), 2):
            if not _is_apart(one, other) or one.signed(*other.point)[0] < 0 or other.signed(*one.point)[0] < 0:
                raise InputError(f"holes {i} and {j} of an outline overlap: join them into one polygon, or move one")

    def _loops(self) -> Iterator[_Circle | _Polygon]:
        """Yield the closed curves of the border, the outer one first; of several, one outline after the other."""
        if self.several is not None:
            for one in self.several:
                yield from one._loops()  # noqa: SLF001 - of this class
            return
        if self.disc is not None or self.annulus is not None:
            yield _Circle(self.centre, self.disc if self.disc is not None else self.annulus[0])  # type: ignore[index]
        else:
            if self.rectangle is not None:
                across, along = self.rectangle[0] / 2, self.rectangle[1] / 2
                corners = np.array([(across, along), (-across, along), (-across, -along), (across, -along)])
            else:
                corners = np.array(self.polygon)
            if self.angle:
                cosine, sine = math.cos(self.angle), math.sin(self.angle)
                corners = corners @ np.array([[cosine, sine], [-sine, cosine]])
            yield _Polygon(corners + np.array(self.centre))
        if self.annulus is not None:
            yield _Circle(self.centre, self.annulus[1])
        for hole in self.holes:
            yield from hole._loops()  # noqa: SLF001 - of this class

    @property
    def is_centred(self) -> bool:
        """Whether the outline is a disc or an annulus about the axis, without holes."""
        return (self.disc is not None or self.annulus is not None) and self.centre == (0.0, 0.0) and not self.holes

    @property
    def reach(self) -> float:
        """Largest distance of the part from the axis. [mm]."""
        return max(loop.farthest for loop in self._loops())

    @property
    def nearest(self) -> float:
        """Smallest distance of the part from the axis; 0 if the axis is on the part. [mm]."""
        return max(0.0, float(self.distance(np.zeros(1), np.zeros(1))[0]))

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Least and greatest x, least and greatest y of the part. [mm]."""
        if self.several is not None:
            low_x, high_x, low_y, high_y = zip(*(one.box for one in self.several), strict=True)
            return min(low_x), max(high_x), min(low_y), max(high_y)
        loop = next(self._loops())
        if isinstance(loop, _Circle):
            (x, y), radius = loop.centre, loop.radius
            return x - radius, x + radius, y - radius, y + radius
        return float(loop.x.min()), float(loop.x.max()), float(loop.y.min()), float(loop.y.max())

    @property
    def area(self) -> float:
        """Area of the part. [mm²]."""
        if self.several is not None:
            return sum(one.area for one in self.several)
        outer, *inner = self._loops()
        return outer.area - sum(hole.area for hole in inner)

    @property
    def words(self) -> str:
        """The outline in words."""
        if self.several is not None:
            return "; ".join(one.words for one in self.several)
        x, y = self.centre
        place = "" if self.centre == (0.0, 0.0) else f", centre at x = {x:g} mm, y = {y:g} mm"
        turned = f", turned by {math.degrees(self.angle):g} deg" if self.angle and self.disc is None else ""
        if self.disc is not None:
            shape = f"disc of radius {self.disc:g} mm"
        elif self.annulus is not None:
            shape = f"annulus of radii {self.annulus[0]:g} and {self.annulus[1]:g} mm"
        elif self.rectangle is not None:
            shape = f"rectangle of {self.rectangle[0]:g} by {self.rectangle[1]:g} mm"
        else:
            shape = f"polygon of {len(self.polygon or ())} corners"
        holes = f", {len(self.holes)} {'hole' if len(self.holes) == 1 else 'holes'}" if self.holes else ""
        return shape + turned + place + holes

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the exact distance of points from the border, negative on the part.

        Parameters
        ----------
        x, y
            Points, of one shape. [mm]
        """
        if self.several is not None:
            return np.asarray(np.minimum.reduce([one.distance(x, y) for one in self.several]))
        outer, *inner = self._loops()
        shape = np.shape(x)
        x, y = (np.ascontiguousarray(one, dtype=np.float64).ravel() for one in (x, y))
        distance = outer.signed(x, y)
        for hole in inner:
            np.maximum(distance, -hole.signed(x, y), out=distance)
        return distance.reshape(shape)

    def covers(self, x: Floats, y: Floats) -> Bools:
        """Return the mask of points on the part, border included."""
        return np.asarray(self.distance(x, y) <= BORDER_TOL)

    def nearest_border(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the point of the border that is nearest to each point. Each (n,) [mm]."""
        best_x, best_y, best = np.empty(x.size), np.empty(x.size), np.full(x.size, np.inf)
        for loop in self._loops():
            near_x, near_y, _ = loop.nearest(x, y)
            square = (near_x - x) ** 2 + (near_y - y) ** 2
            closer = square < best
            best_x, best_y = np.where(closer, near_x, best_x), np.where(closer, near_y, best_y)
            best = np.minimum(best, square)
        return best_x, best_y

    def border(self, count: int = BORDER_POINTS) -> tuple[Floats, Floats]:
        """Return points along the border, corners included, at least ``count``. Each (n,) [mm]."""
        parts = [np.stack(one) for one in self.curves(count)]
        return tuple(np.concatenate(parts, axis=1))

    def curves(self, count: int = 360) -> list[tuple[Floats, Floats]]:
        """Return x and y along each closed curve of the border, outer before inner ones; at least ``count`` points."""
        return [loop.points(count) for loop in self._loops()]


class _Circle:
    def __init__(self, centre: tuple[float, float], radius: float) -> None:
        self.centre, self.radius = centre, radius

    @property
    def farthest(self) -> float:
        return math.hypot(*self.centre) + self.radius

    @property
    def area(self) -> float:
        return math.pi * self.radius**2

    @property
    def point(self) -> tuple[Floats, Floats]:
        """A point on the curve. Each (1,)."""
        return np.array([self.centre[0] + self.radius]), np.array([self.centre[1]])

    def signed(self, x: Floats, y: Floats) -> Floats:
        """Return the distance from the curve, negative inside. (n,)."""
        return np.asarray(np.hypot(x - self.centre[0], y - self.centre[1]) - self.radius)

    def nearest(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Bools]:
        """Return the nearest point of the curve, and whether each point is inside. Each (n,)."""
        dx, dy = x - self.centre[0], y - self.centre[1]
        distance = np.hypot(dx, dy)
        at = distance > 0
        scale = self.radius / np.where(at, distance, 1.0)
        near_x = self.centre[0] + np.where(at, dx * scale, self.radius)
        return near_x, self.centre[1] + dy * scale, distance < self.radius

    def points(self, count: int) -> tuple[Floats, Floats]:
        angle = np.linspace(0, 2 * math.pi, count, endpoint=False)
        return self.centre[0] + self.radius * np.cos(angle), self.centre[1] + self.radius * np.sin(angle)


class _Polygon:
    def __init__(self, corners: Floats) -> None:
        self.x, self.y = (np.ascontiguousarray(one) for one in corners.T)

    @property
    def farthest(self) -> float:
        return float(np.hypot(self.x, self.y).max())

    @property
    def area(self) -> float:
        return abs(float(self.x @ np.roll(self.y, -1) - self.y @ np.roll(self.x, -1))) / 2

    @property
    def point(self) -> tuple[Floats, Floats]:
        return self.x[:1], self.y[:1]

    def signed(self, x: Floats, y: Floats) -> Floats:
        near_x, near_y, inside = self.nearest(x, y)
        return np.asarray(np.hypot(x - near_x, y - near_y) * np.where(inside, -1.0, 1.0))

    def nearest(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Bools]:
        from turnwright._kernels.polygon import nearest  # noqa: PLC0415 - costly to import

        near_x, near_y, inside = np.empty(x.size), np.empty(x.size), np.empty(x.size, dtype=np.bool_)
        nearest(self.x, self.y, np.ascontiguousarray(x), np.ascontiguousarray(y), near_x, near_y, inside)
        return near_x, near_y, inside

    def points(self, count: int) -> tuple[Floats, Floats]:
        x, y = np.append(self.x, self.x[0]), np.append(self.y, self.y[0])
        length = np.hypot(np.diff(x), np.diff(y))
        parts = np.ceil(length / length.sum() * count).astype(np.int64)
        number = np.repeat(np.arange(parts.size), parts)
        share = (np.arange(number.size) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[number]
        return x[number] + share * np.diff(x)[number], y[number] + share * np.diff(y)[number]


def _is_apart(one: _Circle | _Polygon, other: _Circle | _Polygon) -> bool:
    """Return whether two curves do not touch."""
    if isinstance(one, _Circle) and isinstance(other, _Circle):
        between = math.hypot(one.centre[0] - other.centre[0], one.centre[1] - other.centre[1])
        return between > one.radius + other.radius or between < abs(one.radius - other.radius)
    if isinstance(one, _Circle):
        one, other = other, one
    x, y = np.append(one.x, one.x[0]), np.append(one.y, one.y[0])  # type: ignore[union-attr]
    if isinstance(other, _Circle):
        # The distances of an edge from the centre are all above the radius, or all below it.
        along = np.stack([np.diff(x), np.diff(y)])
        before = np.stack([other.centre[0] - x[:-1], other.centre[1] - y[:-1]])
        share = np.clip((along * before).sum(axis=0) / (along**2).sum(axis=0), 0.0, 1.0)
        least = np.hypot(*(before - share * along))
        ends = np.hypot(x - other.centre[0], y - other.centre[1])
        return bool((least > other.radius).all() or (ends < other.radius).all())
    return not _crossings(x, y, np.append(other.x, other.x[0]), np.append(other.y, other.y[0])).any()


def _crossings(ax: Floats, ay: Floats, bx: Floats, by: Floats) -> Bools:
    """Return which pieces of two polylines touch. (n - 1, m - 1)."""
    p, q = np.stack([ax, ay], axis=1), np.stack([bx, by], axis=1)

    def side(start: Floats, end: Floats, point: Floats) -> Floats:
        one, other = end - start, point - start
        return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])

    a, b = p[:-1, None], p[1:, None]
    c, d = q[None, :-1], q[None, 1:]
    apart = (side(a, b, c) * side(a, b, d) > 0) | (side(c, d, a) * side(c, d, b) > 0)
    for axis in (0, 1):
        low, high = np.minimum(a, b)[..., axis], np.maximum(a, b)[..., axis]
        apart |= (np.maximum(c, d)[..., axis] < low) | (np.minimum(c, d)[..., axis] > high)
    return np.asarray(~apart)


def _check_polygon(corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, ...], ...]:
    """Return the corners of a polygon if it has an area and does not cross itself."""
    if not 3 <= len(corners) <= MAX_CORNERS:
        raise InputError(f"the polygon of an outline has {len(corners)} corners, the limits are 3 and {MAX_CORNERS}")
    corners = tuple(finite_tuple(one, "a corner of a polygon", 2) for one in corners)  # type: ignore[misc]
    x, y = np.array([*corners, corners[0]]).T
    if not (np.hypot(np.diff(x), np.diff(y)) > 0).all():
        raise InputError("two neighbouring corners of the polygon of an outline are equal: remove one")
    count = len(corners)
    for start in range(0, count, 256):
        touching = _crossings(x[start : start + 257], y[start : start + 257], x, y)
        row = np.arange(touching.shape[0])
        for step in (-1, 0, 1):
            touching[row, (row + start + step) % count] = False
        if touching.any():
            i, j = np.argwhere(touching)[0]
            raise InputError(
                f"edges {start + i + 1} and {j + 1} of the polygon of an outline touch: give its corners in order"
            )
    if abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))) / 2 <= 1e-9:
        raise InputError("the polygon of an outline has no area: give its corners in order")
    return corners
