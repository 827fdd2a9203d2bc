"""Where a tool crosses air outside the outline of a part, and how high."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.outlined import OWN_BAND_MM
from turnwright.part import OVERLAP_FEEDS, OVERLAP_MM, Part, evenly
from turnwright.path import Path, Spiral

__all__ = ["place_apart"]

TURN = 2 * np.pi

WIDEST_EDGE_MM = 50.0
EDGE_PLACES, CHUNK = 129, 5_000
"""Places along the edge at which it is compared with a neighbouring part, and tips compared at once."""

TOP_POINTS = 2000
"""Points of a part at which its highest point is looked for."""

BISECTIONS = 40

AIR_MARGIN_MM = 0.02
"""Least height of the edge above a neighbouring part while it crosses air close to it."""

MAX_DEPTH_MM = 1e-6
"""Depth in a neighbouring part that is rounding."""


class _Placed(NamedTuple):
    """A part, the points of the spiral close to it, the path through them, and where the edge forms it."""

    part: Part
    points: Ints
    path: Path
    cuts: Bools


def place_apart(spiral: Spiral, part: Part, edge: Edge, place: Callable[[Spiral, Part], Path]) -> Path:
    """Return the path over a part that the tool leaves within a revolution, or over the parts of a chuck.

    Parameters
    ----------
    spiral, part, edge
        The spiral, the part and the edge.
    place
        Places the edge on a part at every point of a spiral.

    Raises
    ------
    InputError
        If the spiral misses the part, or the tool cannot pass between two parts of a chuck.
    """
    tips, overlap = _in_plan(spiral.angle, spiral.radius, spiral.y), _overlap(spiral)
    parts, placed = part.apart, []
    for one in parts:
        near = _find_near(spiral, one, edge, tips, overlap)
        if near.size:
            path = place(_select_near(spiral, near), one.continued)
            placed.append(_Placed(one, near, path, _find_cuts(near, path, one, overlap)))
    if not placed:
        raise InputError("the spiral has no 2 neighbouring points on the part: use a smaller feed or more points")
    for pair in combinations(placed, 2):
        _require_distance(*pair, overlap)
    near, path, cutting = _join(placed, edge.half_width + overlap)
    size = spiral.angle.size
    far, cuts, height = np.ones(size, dtype=np.bool_), np.zeros(size, dtype=np.bool_), np.zeros(size)
    far[near], cuts[near] = False, cutting
    height[far] = _heights_around(part, *(one[far] for one in tips), is_chuck=len(parts) > 1)
    path = _fill_in(spiral, path, near, height, tips)
    if len(parts) > 1:
        path = replace(path, z=_pass_neighbours(path, parts, cuts, edge))
    if cuts.all():
        return path
    # Material may be anywhere outside the outline, as high as the finished surface continues plus the stock.
    return replace(path, air_height=np.where(cuts, np.nan, path.z + part.stock + part.air_clearance))


def _find_near(spiral: Spiral, part: Part, edge: Edge, tips: tuple[Floats, Floats], overlap: float) -> Ints:
    """Return the points of a spiral at which the edge may touch the part, or close to it; none or at least 2. (n,)."""
    width = edge.half_width + abs(edge.dx) + abs(edge.dy)
    # Beyond the band in which the surface is its own it has kinks, and a placing would take long.
    close = part.border.distance(*tips) <= max(OWN_BAND_MM - width, width + overlap)
    # A point without a neighbour is no cut: it is far from the part, or the other end of a single revolution.
    joined = close[1:] & close[:-1] & (np.abs(np.diff(spiral.angle)) <= TURN / 2)
    return np.flatnonzero(np.append(joined, False) | np.append(False, joined))


def _select_near(spiral: Spiral, near: Ints) -> Spiral:
    """Return the spiral through some of its points, with its rates."""
    if near.size == spiral.angle.size:
        return spiral
    rates = {
        name: values[near]
        for name in ("radius_rate", "y_rate", "lift")
        if (values := getattr(spiral, name)) is not None
    }
    return replace(spiral.select(near), **rates)


def _join(placed: Sequence[_Placed], width: float) -> tuple[Ints, Path, Bools]:
    """Return the points at which the edge may touch any part, the path through them, and where it cuts.

    Where the edge cuts a part of a chuck, the path is that of this part alone; in air, the highest one of those whose
    contact is within ``width`` [mm] of the part, else that of the nearest.
    """
    if len(placed) == 1:
        return placed[0][1:]
    near = np.unique(np.concatenate([one.points for one in placed]))
    rank, owner = np.full(near.size, -np.inf), np.empty(near.size, dtype=np.int64)
    cuts = np.zeros(near.size, dtype=np.bool_)
    bound = 2 * max(float(np.abs(one.path.z).max()) for one in placed) + 1
    for k, (part, points, path, cutting) in enumerate(placed):
        at = np.searchsorted(near, points)
        distance = part.border.distance(path.contact_x, path.contact_y)
        ranked = np.select([cutting, distance <= width], [2 * bound - distance, bound + path.z], -distance)
        higher = ranked > rank[at]
        rank[at[higher]], owner[at[higher]], cuts[at[higher]] = ranked[higher], k, cutting[higher]
    values: dict[str, Floats] = {}
    for field in fields(Path):
        if not isinstance(getattr(placed[0].path, field.name), np.ndarray):
            continue
        values[field.name] = np.empty(near.size)
        for k, one in enumerate(placed):
            at = np.searchsorted(near, one.points)
            chosen = owner[at] == k
            values[field.name][at[chosen]] = getattr(one.path, field.name)[chosen]
    return near, replace(placed[0].path, **values), cuts  # type: ignore[arg-type]


def _require_distance(one: _Placed, other: _Placed, overlap: float) -> None:
    """Raise `InputError` if the tool would have to be at two heights at once to cut the edges of two parts."""
    both = np.intersect1d(one.points[one.cuts], other.points[other.cuts])
    if not both.size:
        return
    z, z_other = (at.path.z[np.searchsorted(at.points, both)] for at in (one, other))
    apart = np.abs(z - z_other).max()
    if apart > MAX_DEPTH_MM:
        raise InputError(
            f"the tool cannot pass between the parts {one.part.name!r} and {other.part.name!r}: it cuts "
            f"{overlap * 1e3:.4g} um beyond both, where their surfaces differ by {apart * 1e3:.3g} um: place them "
            "farther apart"
        )


def _fill_in(spiral: Spiral, placed: Path, near: Ints, height: Floats, tips: tuple[Floats, Floats]) -> Path:
    """Return the path over all points of a spiral from the one through its near points, elsewhere at given heights."""
    number = np.arange(spiral.angle.size)

    def joined(values: Floats, elsewhere: Floats) -> Floats:
        made = np.array(elsewhere)
        made[near] = values
        return made

    radius_rate, z_rate = spiral.radius_rate, None
    z = joined(placed.z, height)
    if placed.z_rate is not None and placed.radius_rate is not None and radius_rate is not None:
        z_rate = joined(placed.z_rate, np.gradient(z, spiral.angle))
        radius_rate = joined(placed.radius_rate, radius_rate)
    return Path(
        angle=spiral.angle, radius=joined(placed.radius, spiral.radius), z=z,
        sweep=np.interp(number, near, placed.sweep), contact_x=joined(placed.contact_x, tips[0]),
        contact_y=joined(placed.contact_y, tips[1]), contact_z=joined(placed.contact_z, height),
        clearance=np.interp(number, near, placed.clearance), y=spiral.y, y_rate=spiral.y_rate,
        radius_rate=radius_rate, z_rate=z_rate, lift=spiral.lift,
    )  # fmt: skip


def _pass_neighbours(path: Path, parts: Sequence[Part], cuts: Bools, edge: Edge) -> Floats:
    """Return the heights of a path that clears every part of a chuck with the whole edge, flanks included. (n,) [mm].

    Where it cuts a part it is not changed: `InputError` is raised if the edge would cut into another one there.
    """
    z = np.array(path.z)
    across = np.zeros(z.size) if path.y is None else path.y
    tip_x, tip_y = _in_plan(path.angle, path.radius, across)
    owner = np.argmin([one.border.distance(path.contact_x, path.contact_y) for one in parts], axis=0)
    for k, one in enumerate(parts):
        border_x, border_y = one.border.border(EDGE_PLACES)
        top = float(one.surface.evaluate(*evenly(one, TOP_POINTS), 0)[0].max())
        top = max(top, float(one.surface.evaluate(border_x, border_y, 0)[0].max())) + AIR_MARGIN_MM
        reach = edge.half_width + max(top - float(z.min()), 0.0) / edge.flank_slope + abs(edge.dx) + abs(edge.dy)
        reach = min(reach, WIDEST_EDGE_MM)
        others = np.flatnonzero(owner != k)  # close to a part itself, its path is placed above it
        distance = one.border.distance(tip_x[others], tip_y[others])
        places = np.linspace(-reach, reach, EDGE_PLACES)
        low = others[(distance <= reach) & (z[others] + _lowest_beyond(edge, places, distance) < top)]
        needed, at_x, at_y = np.full(z.size, -np.inf), np.zeros(z.size), np.zeros(z.size)
        for start in range(0, low.size, CHUNK):
            some = low[start : start + CHUNK]

            def over(place: Floats, some: Ints = some) -> tuple[Floats, Floats, Floats]:
                u, v, e = edge.points(edge.sweeps(place.ravel())).reshape(3, *place.shape)
                angle, radius, side = (values[some, np.newaxis] for values in (path.angle, path.radius, across))
                return *_in_plan(angle, radius + u, side + v), e

            every = _with_borders(np.tile(places, (some.size, 1)), one, over)
            x, y, e = over(every)
            over_part, row = np.full(x.shape, -np.inf), np.arange(some.size)
            on = one.covers(x, y)
            over_part[on] = one.surface.evaluate(x[on], y[on], 0)[0] - e[on]
            place = over_part.argmax(axis=1)
            highest = over_part[row, place]
            needed[some], at_x[some], at_y[some] = highest, x[row, place], y[row, place]
        # A wall rises between two points: the edge must be above from the point before, until the point after.
        before, after = np.append(-np.inf, needed[:-1]), np.append(needed[1:], -np.inf)
        walls = np.where(np.isinf(needed), np.maximum(before, after), needed)
        depth = np.where(cuts & (owner != k), walls - z, -np.inf)
        if depth.max() > MAX_DEPTH_MM:
            at = int(depth.argmax())
            near = at + np.array([0, -1, 1])[np.argmax([needed[at], before[at], after[at]])]
            cut = parts[int(owner[at])]
            raise InputError(
                f"the tool cannot pass between the parts {cut.name!r} and {one.name!r}: where it cuts the first it "
                f"would cut {depth[at] * 1e3:.3g} um into the second, at x = {at_x[near]:.4g} mm, y = "
                f"{at_y[near]:.4g} mm: place them farther apart, or bring their edges to one height"
            )
        above = np.maximum.reduce([before, walls, after]) + AIR_MARGIN_MM
        z = np.where(cuts | (owner == k), z, np.maximum(z, above))
    return z


def _lowest_beyond(edge: Edge, places: Floats, distance: Floats) -> Floats:
    """Return the lowest height of the edge at given distances from the tip or more. (n,) [mm]."""
    u, v, e = edge.points(edge.sweeps(places))
    away = np.hypot(u, v)
    order = np.argsort(away)
    lowest = np.minimum.accumulate(e[order][::-1])[::-1]
    return np.asarray(lowest[np.maximum(np.searchsorted(away[order], distance, "right") - 1, 0)])


def _with_borders(places: Floats, part: Part, over: Callable[[Floats], tuple[Floats, Floats, Floats]]) -> Floats:
    """Return places along the edge and those on the border of a part next to the tip. (n, m + 2) [mm]."""
    x, y, _ = over(places)
    on = part.covers(x, y)
    rows, middle = np.arange(places.shape[0]), places.shape[1] // 2
    borders = []
    for first, step in ((on[:, middle:].argmax(axis=1) + middle, -1), (middle - on[:, middle::-1].argmax(axis=1), 1)):
        inside, outside = places[rows, first], places[rows, np.clip(first + step, 0, places.shape[1] - 1)]
        for _ in range(BISECTIONS):
            between = (inside + outside) / 2
            x, y, _ = over(between[:, np.newaxis])
            covered = part.covers(x, y)[:, 0]
            inside, outside = np.where(covered, between, inside), np.where(covered, outside, between)
        borders.append(inside)
    return np.column_stack([places, *borders])


def _heights_around(part: Part, x: Floats, y: Floats, *, is_chuck: bool) -> Floats:
    """Return heights far outside the outline: of the continuation, or else of the nearest border. (n,)."""
    if is_chuck:  # between its parts no prescription holds
        return part.surface.evaluate(*part.border.nearest_border(x, y), 0)[0]
    surface = part.continuation
    with np.errstate(all="ignore"):
        z = np.array(surface.evaluate(x, y, 0)[0])
    defined = surface.inside(x, y)
    missing = ~np.isfinite(z) if defined is None else ~defined | ~np.isfinite(z)
    if missing.any():
        z[missing] = part.surface.evaluate(*part.border.nearest_border(x[missing], y[missing]), 0)[0]
    return z


def _find_cuts(points: Ints, path: Path, part: Part, overlap: float) -> Bools:
    """Return at which points of a path the edge forms the part, or moves to or from such a point. (n,).

    ``points`` are their numbers on the spiral.
    """
    distance = part.border.distance(path.contact_x, path.contact_y)
    step = np.hypot(np.diff(path.contact_x), np.diff(path.contact_y))
    # No point of a straight line between two contacts is closer than this.
    near = ((distance[1:] + distance[:-1] - step) / 2 <= overlap) & (np.diff(points) == 1)
    return np.asarray(np.append(near, False) | np.append(False, near))


def _overlap(spiral: Spiral) -> float:
    """Return how far outside the outline contacts belong to the cut, apart from the steps between points. [mm]."""
    order = np.argsort(spiral.angle) if spiral.sense < 0 else slice(None)
    angle, radius = spiral.angle[order], spiral.radius[order]
    there = angle <= angle[-1] - TURN
    advance = np.abs(np.interp(angle[there] + TURN, angle, radius) - radius[there])
    return OVERLAP_MM + OVERLAP_FEEDS * float(advance.max(initial=0.0))


def _in_plan(angle: Floats, radius: Floats, across: Floats | None) -> tuple[Floats, Floats]:
    """Return x and y of points at distances along and across the radial line of an azimuth, of their shape. [mm]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    if across is None:
        return radius * cosine, radius * sine
    return radius * cosine - across * sine, radius * sine + across * cosine
