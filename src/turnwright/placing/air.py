"""Where a tool crosses air outside the outline of a part, and how high."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from itertools import combinations

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.outlined import OWN_BAND_MM
from turnwright.part import OVERLAP_FEEDS, OVERLAP_MM, Part, evenly
from turnwright.path import Path, Spiral

__all__ = ["cross_air", "find_near", "join_parts", "require_distances", "select_near"]

TURN = 2 * np.pi

WIDEST_EDGE_MM = 50.0
EDGE_PLACES, CHUNK = 129, 5_000
"""Places along the edge at which it is compared with a neighbouring part, and tips compared at once."""

TOP_POINTS = 2000
"""Points of a part at which its highest point is looked for."""

BISECTIONS, ON_BORDER_MM = 40, 1e-9

AIR_MARGIN_MM = 0.02
"""Least height of the edge above a neighbouring part while it crosses air close to it."""

MAX_DEPTH_MM = 1e-6
"""Depth in a neighbouring part that is rounding."""


def find_near(spiral: Spiral, part: Part, edge: Edge) -> Ints:
    """Return the points of a spiral at which the edge may touch the part, or close to it; none or at least 2. (n,)."""
    x, y = _plan(spiral)
    width = edge.half_width + abs(edge.dx) + abs(edge.dy)
    # Beyond the band in which the surface is its own it has kinks, and a placing would take long.
    reach = max(OWN_BAND_MM - width, width + _overlap(spiral))
    close = part.border.distance(x, y) <= reach
    # A point without a neighbour is no cut: it is far from the part, or the other end of a single revolution.
    joined = close[1:] & close[:-1] & (np.abs(np.diff(spiral.angle)) <= TURN / 2)
    return np.flatnonzero(np.append(joined, False) | np.append(False, joined))


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


def join_parts(
    parts: Sequence[Part], spiral: Spiral, placed: Sequence[tuple[Ints, Path]], edge: Edge
) -> tuple[Ints, Path, Bools]:
    """Return the points at which the edge may touch any part, the path through them, and where it cuts.

    Where the edge cuts a part of a chuck, the path is that of this part alone; in air, the highest one of those that
    the edge may reach, else the nearest.
    """
    overlap = _overlap(spiral)
    width = edge.half_width + overlap
    near = np.unique(np.concatenate([points for points, _ in placed]))
    rank, owner = np.full(near.size, -np.inf), np.empty(near.size, dtype=np.int64)
    cuts = np.zeros(near.size, dtype=np.bool_)
    bound = 2 * max(float(np.abs(path.z).max()) for _, path in placed) + 1
    for k, (points, path) in enumerate(placed):
        at, cutting = np.searchsorted(near, points), _find_cuts(points, path, parts[k], overlap)
        distance = parts[k].border.distance(path.contact_x, path.contact_y)
        ranked = np.select([cutting, distance <= width], [2 * bound - distance, bound + path.z], -distance)
        higher = ranked > rank[at]
        rank[at[higher]], owner[at[higher]], cuts[at[higher]] = ranked[higher], k, cutting[higher]
    values: dict[str, Floats] = {}
    for one in fields(Path):
        if not isinstance(getattr(placed[0][1], one.name), np.ndarray):
            continue
        values[one.name] = np.empty(near.size)
        for k, (points, path) in enumerate(placed):
            chosen = owner[np.searchsorted(near, points)] == k
            values[one.name][np.searchsorted(near, points[chosen])] = getattr(path, one.name)[chosen]
    return near, replace(placed[0][1], **values), cuts  # type: ignore[arg-type]


def require_distances(parts: Sequence[Part], spiral: Spiral, placed: Sequence[tuple[Ints, Path]]) -> None:
    """Raise `InputError` if the tool would have to be at two heights at once to cut the edges of two parts."""
    for (one, there), (other, other_there) in combinations(zip(parts, placed, strict=True), 2):
        _require_distance(one, other, there, other_there, _overlap(spiral))


def _require_distance(
    one: Part, other: Part, placed: tuple[Ints, Path], there: tuple[Ints, Path], overlap: float
) -> None:
    (points, path), (points_there, path_there) = placed, there
    cuts = points[_find_cuts(points, path, one, overlap)]
    both = np.intersect1d(cuts, points_there[_find_cuts(points_there, path_there, other, overlap)])
    if not both.size:
        return
    apart = np.abs(path.z[np.searchsorted(points, both)] - path_there.z[np.searchsorted(points_there, both)]).max()
    if apart > MAX_DEPTH_MM:
        raise InputError(
            f"the tool cannot pass between the parts {one.name!r} and {other.name!r}: it cuts {overlap * 1e3:.4g} um "
            f"beyond both, where their surfaces differ by {apart * 1e3:.3g} um: place them farther apart"
        )


def cross_air(spiral: Spiral, part: Part, edge: Edge, near: Ints, placed: Path, cutting: Bools) -> Path:
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
    z[far] = contact_z[far] = _heights_around(part, x[far], y[far])
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
    cuts = np.zeros(number.size, dtype=np.bool_)
    cuts[near] = cutting
    if len(part.apart) > 1:
        path = replace(path, z=_pass_neighbours(path, part, cuts, edge))
    if cuts.all():
        return path
    return replace(path, air_height=np.where(cuts, np.nan, path.z + part.stock + part.air_clearance))


def _pass_neighbours(path: Path, part: Part, cuts: Bools, edge: Edge) -> Floats:
    """Return the heights of a path that clears every part of a chuck with the whole edge, flanks included. (n,) [mm].

    Where it cuts a part it is not changed: `InputError` is raised if the edge would cut into another one there.
    """
    z = np.array(path.z)
    across = np.zeros(z.size) if path.y is None else path.y
    cosine, sine = np.cos(path.angle), np.sin(path.angle)
    tip_x, tip_y = path.radius * cosine - across * sine, path.radius * sine + across * cosine
    owner = np.argmin([one.border.distance(path.contact_x, path.contact_y) for one in part.apart], axis=0)
    for k, one in enumerate(part.apart):
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
                along, side = path.radius[some, np.newaxis] + u, across[some, np.newaxis] + v
                x = along * cosine[some, np.newaxis] - side * sine[some, np.newaxis]
                return x, along * sine[some, np.newaxis] + side * cosine[some, np.newaxis], e

            every = _with_borders(np.tile(places, (some.size, 1)), one, over)
            x, y, e = over(every)
            over_part, row = np.full(x.shape, -np.inf), np.arange(some.size)
            on = one.border.distance(x, y) <= ON_BORDER_MM
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
            cut = part.apart[int(owner[at])]
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
    on = part.border.covers(x, y)
    rows, middle = np.arange(places.shape[0]), places.shape[1] // 2
    borders = []
    for first, step in ((on[:, middle:].argmax(axis=1) + middle, -1), (middle - on[:, middle::-1].argmax(axis=1), 1)):
        inside, outside = places[rows, first], places[rows, np.clip(first + step, 0, places.shape[1] - 1)]
        for _ in range(BISECTIONS):
            between = (inside + outside) / 2
            x, y, _ = over(between[:, np.newaxis])
            covered = part.border.covers(x, y)[:, 0]
            inside, outside = np.where(covered, between, inside), np.where(covered, outside, between)
        borders.append(inside)
    return np.column_stack([places, *borders])


def _heights_around(part: Part, x: Floats, y: Floats) -> Floats:
    """Return heights far outside the outline: of the continuation, or else of the nearest border. (n,)."""
    if len(part.apart) == 1:
        with np.errstate(all="ignore"):
            z = part.continuation.evaluate(x, y, 0)[0]
        defined = part.continuation.inside(x, y)
        missing = ~np.isfinite(z) if defined is None else ~defined | ~np.isfinite(z)
    else:  # between the parts of a chuck no prescription holds
        z, missing = np.empty(x.size), np.ones(x.size, dtype=np.bool_)
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


def _plan(spiral: Spiral) -> tuple[Floats, Floats]:
    """Return x and y of the tips. Each (n,) [mm]."""
    cosine, sine = np.cos(spiral.angle), np.sin(spiral.angle)
    across = 0.0 if spiral.y is None else spiral.y
    return spiral.radius * cosine - across * sine, spiral.radius * sine + across * cosine
