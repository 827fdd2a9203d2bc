"""Where a tool crosses air outside the outline of a part, and how high."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import permutations

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.outlined import OWN_BAND_MM
from turnwright.part import OVERLAP_FEEDS, OVERLAP_MM, Part
from turnwright.path import Path, Spiral

__all__ = ["cross_air", "find_near", "join_parts", "require_passage", "select_near"]

TURN = 2 * np.pi

NEAR_POINTS = 26
"""Points before and after those that may touch the part that are placed as well: a spline of the controller forgets a
gap within 24."""

WIDEST_EDGE_MM = 50.0
PASSAGE_TIPS, PASSAGE_PLACES = 20_000, 65
"""Tips close to another part, and places along the edge, where the edge is compared with the other part."""

MAX_PASSAGE_DEPTH_MM = 1e-6
"""Depth in another part that is rounding. [mm]"""

NEAR_POINTS = 26
"""Points before and after them that are placed as well: a spline of the controller forgets a gap within 24."""


def find_near(spiral: Spiral, part: Part, edge: Edge) -> Ints:
    """Return the points of a spiral at which the edge may touch the part, or close to it. (n,)."""
    x, y = _plan(spiral)
    width = edge.half_width + abs(edge.dx) + abs(edge.dy)
    # Beyond the band in which the surface is its own it has kinks, and a placing would take long.
    reach = max(OWN_BAND_MM - width, width + _overlap(spiral))
    near = np.flatnonzero(part.border.distance(x, y) <= reach)
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


def join_parts(part: Part, spiral: Spiral, placed: Sequence[tuple[Ints, Path]], edge: Edge) -> tuple[Ints, Path, Bools]:
    """Return the points at which the edge may touch any part, the path through them, and where it cuts.

    Where the edge cuts a part of a chuck, the path is that of this part alone; in air, the highest one of those that
    the edge may reach, else the nearest.
    """
    parts, overlap = part.apart, _overlap(spiral)
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


def require_passage(spiral: Spiral, part: Part, placed: Sequence[tuple[Ints, Path]], edge: Edge) -> None:
    """Raise `InputError` if the edge would cut into one part of a chuck while it cuts another."""
    overlap = _overlap(spiral)
    for (one, (points, path)), other in permutations(zip(part.apart, placed, strict=True), 2):
        second, (_, there) = other
        cuts = np.flatnonzero(_find_cuts(points, path, one, overlap))
        _require_distance(one, second, (points, path), other[1], overlap)
        rise = max(0.0, float(there.z.max() - path.z[cuts].min(initial=0.0)))
        reach = min(edge.half_width + rise / edge.flank_slope + abs(edge.dx) + abs(edge.dy), WIDEST_EDGE_MM)
        tips = select_near(spiral, points[cuts])
        close = np.flatnonzero(second.border.distance(*_plan(tips)) <= reach)
        close = close[:: max(1, close.size // PASSAGE_TIPS)]
        if not close.size:
            continue
        u, v, e = (
            values[:, np.newaxis] for values in edge.points(edge.sweeps(np.linspace(-reach, reach, PASSAGE_PLACES)))
        )
        cosine, sine = np.cos(tips.angle[close]), np.sin(tips.angle[close])
        along, across = path.radius[cuts[close]] + u, v + (0.0 if tips.y is None else tips.y[close])
        x, y = along * cosine - across * sine, along * sine + across * cosine
        depth = np.where(second.covers(x, y), second.heights(x, y) - path.z[cuts[close]] - e, -np.inf)
        if depth.max() > MAX_PASSAGE_DEPTH_MM:
            at = np.unravel_index(int(depth.argmax()), depth.shape)
            raise InputError(
                f"the tool cannot pass between the parts {one.name!r} and {second.name!r}: where it cuts the first it "
                f"would cut {depth[at] * 1e3:.3g} um into the second, at x = {x[at]:.4g} mm, y = {y[at]:.4g} mm: place "
                "them farther apart, or bring their edges to one height"
            )


def _require_distance(
    one: Part, other: Part, placed: tuple[Ints, Path], there: tuple[Ints, Path], overlap: float
) -> None:
    """Raise `InputError` if the tool would have to be at two heights at once to cut the edges of two parts."""
    (points, path), (points_there, path_there) = placed, there
    cuts = points[_find_cuts(points, path, one, overlap)]
    both = np.intersect1d(cuts, points_there[_find_cuts(points_there, path_there, other, overlap)])
    if not both.size:
        return
    apart = np.abs(path.z[np.searchsorted(points, both)] - path_there.z[np.searchsorted(points_there, both)]).max()
    if apart > MAX_PASSAGE_DEPTH_MM:
        raise InputError(
            f"the tool cannot pass between the parts {one.name!r} and {other.name!r}: it cuts {overlap * 1e3:.4g} um "
            f"beyond both, where their surfaces differ by {apart * 1e3:.3g} um: place them farther apart"
        )


def cross_air(spiral: Spiral, part: Part, near: Ints, placed: Path, cutting: Bools) -> Path:
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
    if cuts.all():
        return path
    return replace(path, air_height=np.where(cuts, np.nan, z + part.stock + part.air_clearance))


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
