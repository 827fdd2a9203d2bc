"""Where a tool crosses air outside the outline of a part, and how high."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.part import OVERLAP_FEEDS, OVERLAP_MM, Part
from turnwright.path import Path, Spiral

__all__ = ["cross_air", "find_near", "select_near"]

TURN = 2 * np.pi

NEAR_MM = 5.0
"""Distance from the border, beyond the width of the edge, up to which the tool is placed on the continued surface."""


NEAR_POINTS = 26
"""Points before and after them that are placed as well: a spline of the controller forgets a gap within 24."""


def find_near(spiral: Spiral, part: Part, edge: Edge) -> Ints:
    """Return the points of a spiral at which the edge may touch the part, or close to it. (n,)."""
    x, y = _plan(spiral)
    reach = edge.half_width + abs(edge.dx) + abs(edge.dy) + NEAR_MM + _overlap(spiral)
    close = part.border.distance(x, y) <= reach
    near = np.flatnonzero(close)
    if near.size >= 2:
        starts, ends = near[np.diff(near, prepend=-2) > 1], near[np.diff(near, append=close.size + 1) > 1] + 1
        change = np.zeros(close.size + 1, dtype=np.int64)
        np.add.at(change, np.maximum(starts - NEAR_POINTS, 0), 1)
        np.add.at(change, np.minimum(ends + NEAR_POINTS, close.size), -1)
        near = np.flatnonzero(np.cumsum(change[:-1]) > 0)
    if near.size < 2:
        raise InputError(
            f"the spiral has {near.size} points on the part, it needs at least 2: use a smaller feed or more points"
        )
    return near


def select_near(spiral: Spiral, near: Ints) -> Spiral:
    """Return the spiral through some of its points, with its rates."""
    if near.size == spiral.angle.size:
        return spiral
    rates = {
        name: values[near]
        for name in ("radius_rate", "y_rate", "lift")
        if (values := getattr(spiral, name)) is not None
    }
    return replace(spiral.select(near), **rates)


def cross_air(spiral: Spiral, part: Part, near: Ints, placed: Path) -> Path:
    """Return the path over all points of a spiral from the one through its near points, with the heights in air.

    Material may be anywhere outside the outline, as high as the finished surface continues plus the stock.
    """
    number = np.arange(spiral.angle.size)

    def fill(values: Floats) -> Floats:
        return np.interp(number, near, values)

    x, y = _plan(spiral)
    far = np.ones(number.size, dtype=np.bool_)
    far[near] = False
    z, contact_z = fill(placed.z), fill(placed.contact_z)
    z[far] = contact_z[far] = part.continuation.evaluate(x[far], y[far], 0)[0]
    x[near], y[near] = placed.contact_x, placed.contact_y
    radius = np.array(spiral.radius)
    radius[near] = placed.radius
    radius_rate, z_rate = spiral.radius_rate, None
    if placed.z_rate is not None and placed.radius_rate is not None and radius_rate is not None:
        z_rate = np.gradient(z, spiral.angle)
        radius_rate = np.array(radius_rate)
        z_rate[near], radius_rate[near] = placed.z_rate, placed.radius_rate
    path = Path(
        angle=spiral.angle, radius=radius, z=z, sweep=fill(placed.sweep), contact_x=x, contact_y=y,
        contact_z=contact_z, clearance=fill(placed.clearance), y=spiral.y, y_rate=spiral.y_rate,
        radius_rate=radius_rate, z_rate=z_rate, lift=spiral.lift,
    )  # fmt: skip
    cuts = _find_cuts(path, part, _overlap(spiral))
    if cuts.all():
        return path
    return replace(path, air_height=np.where(cuts, np.nan, z + part.stock + part.air_clearance))


def _find_cuts(path: Path, part: Part, overlap: float) -> Bools:
    """Return at which points of a path the edge forms the part, or moves to or from such a point. (n,)."""
    distance = part.border.distance(path.contact_x, path.contact_y)
    step = np.hypot(np.diff(path.contact_x), np.diff(path.contact_y))
    # No point of a straight line between two contacts is closer than this.
    near = (distance[1:] + distance[:-1] - step) / 2 <= overlap
    return np.asarray(np.append(near, False) | np.append(False, near))


def _overlap(spiral: Spiral) -> float:
    """Return how far outside the outline contacts belong to the cut, apart from the steps between points. [mm]."""
    order = np.argsort(spiral.angle) if spiral.sense < 0 else slice(None)
    angle, radius = spiral.angle[order], spiral.radius[order]
    there = angle <= angle[-1] - TURN
    advance = np.abs(np.interp(angle[there] + TURN, angle, radius) - radius[there])
    return OVERLAP_MM + OVERLAP_FEEDS * float(advance.max(initial=0.0))


def _plan(spiral: Spiral) -> tuple[Floats, Floats]:
    """Return x and y of the tips. Each (n,) [mm]."""
    cosine, sine = np.cos(spiral.angle), np.sin(spiral.angle)
    across = 0.0 if spiral.y is None else spiral.y
    return spiral.radius * cosine - across * sine, spiral.radius * sine + across * cosine
