"""Where a surface has no tangent: its steps, valleys and lips between smooth pieces, and the ends of its domain.

Along a line under the edge these places are located to rounding, by bisection between two samples of different pieces.
A piece is assumed to meet a line in one interval. A line may also run along a border for some length; there, rounding
decides on which side of a step a point is. Outside the domain, or outside the rim, the height is -inf. The
greatest slope of the surface (infinite at a step) decides whether the search covers the arc alone or the flanks too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import dilation as kernel
from turnwright.placing.tangent import SAMPLES_PER_PERIOD, Contact, SurfaceKey, Tips
from turnwright.surface import Surface

__all__ = [
    "AXIS_ZONE_MM",
    "SLOPE_OFFSET_MM",
    "WALL_STEP_RATIO",
    "Breaks",
    "Segments",
    "SurfaceExtremes",
    "evaluate_heights",
    "find_breaks",
    "find_extremes",
    "find_segments",
    "find_walls",
    "sample_surface",
    "wall_offset",
]

MAX_GRID_SAMPLES = 500_000
"""Most samples of the grid that decides whether the surface is steeper than the flanks anywhere."""
MIN_RADIAL_SAMPLES = 96
"""Least number of samples on a radius of that grid."""
STEP_TOL_MM = 1e-11
"""A smaller jump of the height between two pieces is rounding. [mm]"""
OUTSIDE = -1
"""Number of the piece outside the domain or the rim."""
SLOPE_OFFSET_MM = 1e-9
"""Distance from a slope discontinuity or step at which the slopes on both sides are evaluated. [mm]"""
AXIS_ZONE_MM = 1e-6
"""Radius around the axis that is ignored: a formula in the azimuth gives rounding errors there. [mm]"""
WALL_OFFSET_MM, WALL_OFFSET_ROUNDINGS = 2e-11, 8.0
"""Least distance to both sides of a line at which a wall along it is looked for, and the distance in roundings of the
position that an azimuth gives. [mm]"""
WALL_STEP_RATIO = 10.0
"""A lower step, over that distance, is the slope of the surface."""
WALL_SAMPLES = 8
"""Every how many samples a wall is looked for along pieces that are not convex."""
BREAK_WIDTH = 3.2e-15
"""Greatest distance of both sides of a break, over the largest distance from the axis: some roundings."""
SECANTS, BORDERS = 12, 3
"""Most steps to a border that the surface knows, and borders that are tried for a change of piece."""
LEAST_BULGE_MM = 1e-6
"""Length of a curved track below which it leaves a piece by no more than rounding."""


class SurfaceExtremes(NamedTuple):
    """Greatest slope and height of the surface where the edge may touch it."""

    steepest: float  # slope along the radius, or in any direction; infinite at a step
    top: float  # greatest height [mm]


class Breaks(NamedTuple):
    """Slope discontinuities and steps of sampled lines, row by row, see `candidates` in the kernels."""

    offsets: Ints
    after: Ints
    at: Floats
    height: Floats
    slope: Floats


class _Intervals(NamedTuple):
    """Intervals of lines in which a label changes. Each (n,)."""

    row: Ints  # index of the line
    after: Ints  # index of the sample before the interval
    a: Floats  # ends, as distances from the tip [mm]
    b: Floats
    first: Ints  # label at a
    last: Ints  # and at b

    def select(self, which: Bools | Ints) -> _Intervals:
        row, after, a, b, first, last = self
        return _Intervals(row[which], after[which], a[which], b[which], first[which], last[which])


class Segments(NamedTuple):
    """Parts of lines, each on one piece of a surface; row i holds ``offsets[i]`` to ``offsets[i + 1]``, ascending."""

    offsets: Ints
    start: Floats  # ends, as distances from the tip of the row [mm]
    stop: Floats
    piece: Ints  # its number, `OUTSIDE` outside the rim


class _Lines(NamedTuple):
    """Pieces of a surface along some lines."""

    locate: Callable[[Ints, Floats], tuple[Floats, Floats]]  # x and y on lines by index, at distances from their tips
    piece_of: Callable[[Floats, Floats], Ints]  # at x and y
    border: Callable[[Ints, Ints, Ints, Floats], Floats]  # `Surface.border` of two pieces, on lines

    def piece(self, row: Ints, u: Floats) -> Ints:
        return self.piece_of(*self.locate(row, u))


def find_extremes(surface: Surface, radius: float, *, radial: bool) -> SurfaceExtremes:
    """Return the extremes of a surface, sampled along diameters.

    With ``radial`` the edge lies in the radial plane and only slopes along the radius count; otherwise the edge passes
    the axis at a distance and slopes in every direction count.
    """
    return _find_extremes_cached(SurfaceKey(surface), radius, radial=radial)


@lru_cache(maxsize=8)
def _find_extremes_cached(same: SurfaceKey, radius: float, *, radial: bool) -> SurfaceExtremes:
    surface = same.surface
    spacing = min(surface.feature_size / SAMPLES_PER_PERIOD, radius / MIN_RADIAL_SAMPLES)
    spacing = max(spacing, radius * float(np.sqrt(2 * np.pi / MAX_GRID_SAMPLES)))
    rows, samples = int(np.ceil(np.pi * radius / spacing)), int(np.ceil(2 * radius / spacing)) + 1
    # The samples avoid the axis, and lines along which pieces may meet.
    along = np.linspace(-radius, radius, samples) * (1 - 1e-9) + 0.1 * spacing * np.linspace(1, 0, samples)
    across = 0.0 if radial else 0.381966 * spacing
    steepest, top, bend = 0.0, -np.inf, 0.0
    for angle in np.array_split((np.arange(rows) + 0.381966) * (np.pi / rows), -(-rows * samples // 65536)):
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        x, y = along * c - across * s, along * s + across * c
        inside = surface.inside(x, y)
        with np.errstate(all="ignore"):
            z, zx, zy = surface.evaluate(x, y, 1)
            if inside is not None:
                z[~inside] = np.nan
            slope = np.abs(zx * c + zy * s) if radial else np.hypot(zx, zy)
            rise = np.abs(np.diff(z, axis=1))
            second = np.abs(np.diff(z, 2, axis=1))
        smooth = np.ones(rise.shape, dtype=np.bool_)
        pieces = surface.piece(x, y)
        if pieces is not None:
            smooth = pieces[:, 1:] == pieces[:, :-1]
            row, before = np.nonzero(~smooth)
            jump, high = _find_largest_jump(surface, c[row, 0], s[row, 0], across, along[before], along[before + 1])
            steepest = np.inf if jump > STEP_TOL_MM else steepest
            top = max(top, high)
        for values, valid in ((slope, np.isfinite(z)), (rise / np.diff(along), smooth)):
            steepest = max(steepest, float(np.max(values, where=valid & np.isfinite(values), initial=0.0)))
        valid = np.isfinite(second) & smooth[:, 1:] & smooth[:, :-1]
        bend = max(bend, float(np.max(second, where=valid, initial=0.0)))
        top = max(top, float(np.max(z, where=np.isfinite(z), initial=-np.inf)))
    # Between the samples the surface may be higher by about the second difference of its heights.
    return SurfaceExtremes(steepest, top + bend)


def _find_largest_jump(
    surface: Surface, c: Floats, s: Floats, across: float, a: Floats, b: Floats
) -> tuple[float, float]:
    """Return the greatest jump at the changes of piece between a and b on some lines, and the greatest height there."""
    if not c.size:
        return 0.0, -np.inf

    def at(along: Floats) -> tuple[Floats, Floats]:
        return along * c - across * s, along * s + across * c

    first, low, high = surface.piece(*at(a)), a.copy(), b.copy()
    for _ in range(60):
        middle = 0.5 * (low + high)
        mine = surface.piece(*at(middle)) == first
        low, high = np.where(mine, middle, low), np.where(mine, high, middle)
    with np.errstate(all="ignore"):
        sides = np.stack([surface.evaluate(*at(side), 0)[0] for side in (low, high)])
        jump = np.abs(sides[1] - sides[0])
    return tuple(  # type: ignore[return-value] # of two
        float(np.max(values, where=np.isfinite(values), initial=least))
        for values, least in ((jump, 0.0), (sides, -np.inf))
    )


def sample_surface(contact: Contact, x: Floats, y: Floats) -> tuple[Floats, Ints | None]:
    """Return the surface's heights, -inf outside its domain and outside the rim, and its pieces."""
    with np.errstate(all="ignore"):
        heights, pieces = contact.surface.sample(x, y)
    missing = np.isnan(heights)
    if contact.rim < np.inf:
        missing |= _is_outside_rim(contact.rim, x, y)
    heights[missing] = -np.inf
    return heights, pieces


def evaluate_heights(contact: Contact, x: Floats, y: Floats) -> Floats:
    """Return the surface's heights, -inf outside its domain and outside the rim."""
    return sample_surface(contact, x, y)[0]


def _is_outside_rim(rim: float, x: Floats, y: Floats) -> Bools:
    return np.asarray(x * x + y * y > rim**2)


def find_breaks(
    contact: Contact, tips: Tips, u: Floats, x: Floats, y: Floats, sampled: tuple[Floats, Ints | None]
) -> tuple[Breaks, Ints]:
    """Locate every slope discontinuity or step between samples of different pieces, and every end of the domain.

    They are located to rounding. The pieces of all samples are returned too. Each of the ``tips`` has a line of
    samples: ``u`` is their distance from the tip, ``x`` and ``y`` their position on the part, ``sampled`` the surface
    there, see `sample_surface`. Each (rows, n) [mm]
    """
    surface, edge = contact.surface, contact.edge
    heights, pieces = sampled
    missing = heights == -np.inf
    lines = _lines_under(contact, tips, ends=bool((missing & ~_is_outside_rim(contact.rim, x, y)).any()))
    numbers = _number(pieces, missing)
    between = _find_changes(u, numbers)
    if edge.rake_sin != 0 and surface.in_pieces:
        bulges = _find_bulges(contact, tips, u, numbers, lines)
        between = _Intervals(*(np.concatenate(both) for both in zip(between, bulges, strict=True)))
    row, after, before_at, behind_at, *_ = _split_intervals(lines, between, BREAK_WIDTH * contact.farthest, 4)
    order = np.lexsort((before_at, after, row))
    row, after = row[order], after[order]
    sides = np.stack([before_at[order], behind_at[order]])
    height, slope = np.empty(sides.shape), np.empty(sides.shape)
    for side in range(2):
        height[side] = evaluate_heights(contact, *lines.locate(row, sides[side]))
        # Slopes are evaluated slightly inside the piece: right on the axis they may be differences of infinities.
        inner = sides[side] + (2 * side - 1) * SLOPE_OFFSET_MM
        with np.errstate(all="ignore"):
            _, zx, zy = surface.evaluate(*lines.locate(row, inner), 1)
        kernel.slopes_along(edge, tips.angle[row], inner, zx, zy, slope[side])
    offsets = np.searchsorted(row, np.arange(heights.shape[0] + 1))
    return Breaks(offsets, after, 0.5 * (sides[0] + sides[1]), height, slope), numbers


def find_segments(contact: Contact, tips: Tips, u: Floats) -> Segments:
    """Divide lines where pieces of a surface meet that ends nowhere inside the rim, see `find_breaks`."""
    x, y = contact.at_distance(tips, u)
    numbers = _number(contact.surface.piece(x, y), _is_outside_rim(contact.rim, x, y))
    lines, (rows, _) = _lines_under(contact, tips, ends=False), u.shape
    row, _, before_at, behind_at, *_ = _split_intervals(
        lines, _find_changes(u, numbers), BREAK_WIDTH * contact.farthest, 4
    )
    at = 0.5 * (before_at + behind_at)
    order = np.lexsort((at, row))
    row, at = row[order], at[order]
    offsets = np.searchsorted(row, np.arange(rows + 1)) + np.arange(rows + 1)
    start, stop = np.empty((2, offsets[-1]))
    before = np.arange(row.size) + row  # the segment before each border
    start[offsets[:-1]], start[before + 1] = u[:, 0], at
    stop[offsets[1:] - 1], stop[before] = u[:, -1], at
    # Where several borders coincide to rounding, their order may be wrong; the middle of a segment tells its piece.
    piece = lines.piece(np.repeat(np.arange(rows), np.diff(offsets)), 0.5 * (start + stop))
    return Segments(offsets, start, stop, piece)


def _number(pieces: Ints | None, outside: Bools) -> Ints:
    return np.where(outside, OUTSIDE, 0 if pieces is None else pieces)


def _lines_under(contact: Contact, tips: Tips, *, ends: bool) -> _Lines:
    """Return the pieces along the lines of tips; ``ends`` is whether the surface ends anywhere inside the rim."""
    surface = contact.surface

    def locate(row: Ints, u: Floats) -> tuple[Floats, Floats]:
        x, y = contact.at_distance(tips.select(row), u[:, None])
        return x[:, 0], y[:, 0]

    def piece_of(x: Floats, y: Floats) -> Ints:
        # The rim is all that ends most surfaces; their heights need not be evaluated.
        if not ends:
            return _number(surface.piece(x, y), _is_outside_rim(contact.rim, x, y))
        heights, pieces = sample_surface(contact, x, y)
        return _number(pieces, heights == -np.inf)

    def border(first: Ints, second: Ints, row: Ints, u: Floats) -> Floats:
        x, y = locate(row, u)
        value = surface.border(first, second, x, y)
        if not ends:
            at_rim = np.flatnonzero((first == OUTSIDE) != (second == OUTSIDE))
            beyond = x[at_rim] ** 2 + y[at_rim] ** 2 - contact.rim**2
            value[at_rim] = np.where(first[at_rim] == OUTSIDE, beyond, -beyond)
        return value

    return _Lines(locate, piece_of, border)


def _find_changes(u: Floats, numbers: Ints) -> _Intervals:
    """Return the intervals between two samples of different pieces, of lines with samples at ``u``. (rows, n)."""
    row, after = np.nonzero(numbers[:, 1:] != numbers[:, :-1])
    return _Intervals(row, after, u[row, after], u[row, after + 1], numbers[row, after], numbers[row, after + 1])


def _find_bulges(contact: Contact, tips: Tips, u: Floats, numbers: Ints, lines: _Lines) -> _Intervals:
    """Return where a curved track leaves a piece and comes back to it between two samples, in intervals with a change.

    The track of a raked edge lies between its chord and the tangents at the ends: where these meet is in the same piece
    too unless the track may leave it. Such intervals are halved.
    """
    row, after = np.nonzero(numbers[:, 1:] == numbers[:, :-1])
    number = numbers[row, after]
    same, bulges = _Intervals(row, after, u[row, after], u[row, after + 1], number, number), []
    while True:
        x, y = np.empty((2, same.row.size))
        kernel.tangents_meet(contact.edge, *tips.select(same.row), same.a, same.b, x, y)
        same = same.select(lines.piece_of(x, y) != same.first)
        middle = 0.5 * (same.a + same.b)
        inner = lines.piece(same.row, middle)
        pairs = zip(same._replace(b=middle, last=inner), same._replace(a=middle, first=inner), strict=True)
        same = _Intervals(*(np.concatenate(both) for both in pairs))
        outside = same.first != same.last
        bulges.append(same.select(outside))
        same = same.select(~outside & (same.b - same.a > LEAST_BULGE_MM))
        if not same.row.size:
            return _Intervals(*(np.concatenate(parts) for parts in zip(*bulges, strict=True)))


def wall_offset(contact: Contact, tips: Tips) -> float:
    """Return how far from the plane that is meant an edge may stand by rounding, with a margin. [mm]."""
    turned = float(np.abs(tips.angle).max(initial=1.0))
    return max(WALL_OFFSET_MM, WALL_OFFSET_ROUNDINGS * float(np.finfo(np.float64).eps) * contact.extent * turned)


def find_walls(contact: Contact, tips: Tips, u: Floats, numbers: Ints, across: float) -> Bools:
    """Return which straight lines under an edge run along a step for some length, within the distance ``across``.

    ``numbers`` are the pieces at distances ``u`` from each tip. (rows, n) A line that meets a convex piece only on its
    border is inside it nowhere: one sample of each piece shows it.
    """
    surface, (rows, samples) = contact.surface, u.shape
    walled = np.zeros(rows, dtype=np.bool_)
    if not surface.in_pieces:
        return walled
    begins = np.ones(u.shape, dtype=np.bool_)
    begins[:, 1:] = numbers[:, 1:] != numbers[:, :-1]
    first = np.flatnonzero(begins)
    looked = np.zeros(u.shape, dtype=np.bool_)
    looked.ravel()[(first + np.append(first[1:], u.size)) // 2] = True
    if not surface.convex_pieces:
        looked[:, ::WALL_SAMPLES] = True
    places = np.flatnonzero(looked)
    row = places // samples
    apart, _ = _compare_sides(contact, tips.select(row), u.ravel()[places][:, None], across)
    row = np.unique(row[apart[:, 0]])
    if row.size:
        # The step may vanish where the pieces were looked at.
        apart, sides = _compare_sides(contact, tips.select(row), u[row], across)
        z = [evaluate_heights(contact, *side) for side in sides]
        with np.errstate(invalid="ignore"):
            step = np.abs(z[1] - z[0])
        walled[row] = (apart & (step > WALL_STEP_RATIO * across) & (step < np.inf)).any(axis=1)
    return walled


def _compare_sides(
    contact: Contact, tips: Tips, u: Floats, across: float
) -> tuple[Bools, tuple[tuple[Floats, Floats], ...]]:
    """Return where the pieces on both sides of edges differ, at distances ``u`` from each tip, and x and y there."""
    sides = tuple(contact.at_distance(tips._replace(lateral=tips.lateral + way * across), u) for way in (-1, 1))
    numbers = [contact.surface.piece(*side) for side in sides]
    return np.asarray(numbers[0] != numbers[1]), sides


def _split_intervals(lines: _Lines, between: _Intervals, close: float, depth: int) -> _Intervals:
    """Return both sides, at most ``close`` apart, of each change of piece in some intervals.

    A piece is assumed to meet a line in one interval. Bisection locates where the first piece ends. If that is not
    where the last one begins, bisection locates this too, and the interval in between is split again.
    """
    ends = _bisect(lines, between, close)
    several = np.flatnonzero(ends.last != between.last)
    if not several.size:
        return ends
    more = between._replace(a=ends.b, first=ends.last).select(several)
    begins = _bisect(lines, more._replace(a=more.b, b=more.a, first=more.last, last=more.first), close)
    wide = (begins.b - more.a > 1e-13) & (depth > 0)
    ends.b[several] = np.where(wide, more.a, begins.a)
    more, begins = more.select(wide), begins.select(wide)
    # A single piece in between contains no change.
    inner = more._replace(b=begins.b, last=begins.last)
    parts = (
        ends,
        begins._replace(a=begins.b, b=begins.a, first=begins.last, last=begins.first),
        _split_intervals(lines, inner.select(inner.first != inner.last), close, depth - 1),
    )
    return _Intervals(*(np.concatenate(one) for one in zip(*parts, strict=True)))


def _bisect(lines: _Lines, between: _Intervals, close: float) -> _Intervals:
    """Return both sides, at most ``close`` apart, of where the first piece of intervals ends."""
    sides = between._replace(a=between.a.copy(), b=between.b.copy(), last=between.last.copy())
    _narrow(lines, sides, close)
    for _ in range(64):
        wide = np.flatnonzero(np.abs(sides.b - sides.a) > close)
        if not wide.size:
            break
        _move_side(lines, sides, wide, 0.5 * (sides.a[wide] + sides.b[wide]))
    return sides


def _move_side(lines: _Lines, sides: _Intervals, which: Ints, at: Floats) -> None:
    """Move one side of ``which`` intervals to ``at``: the one of which this is the piece, or else the far one."""
    piece = lines.piece(sides.row[which], at)
    mine = piece == sides.first[which]
    sides.a[which[mine]] = at[mine]
    sides.b[which[~mine]], sides.last[which[~mine]] = at[~mine], piece[~mine]


def _narrow(lines: _Lines, sides: _Intervals, close: float) -> None:
    """Move the sides closer together where the surface knows the border of the pieces at both of them."""
    for _ in range(BORDERS):
        wide = np.flatnonzero(np.abs(sides.b - sides.a) > 2 * close)
        if not wide.size:
            break
        some = sides.select(wide)
        crossing = _cross(lines, some, 0.25 * close)
        crossed = np.flatnonzero(~np.isnan(crossing))
        if not crossed.size:
            break
        wide, crossing, some = wide[crossed], crossing[crossed], some.select(crossed)
        margin, ends = 0.4 * close * np.sign(some.b - some.a), np.sort([some.a, some.b], axis=0)
        for at in (crossing + margin, crossing - margin):  # another piece may lie before the border
            _move_side(lines, sides, wide, np.clip(at, *ends))


def _cross(lines: _Lines, sides: _Intervals, close: float) -> Floats:
    """Return where lines cross the border of two pieces, by the Illinois method; nan where they do not. (n,) [mm]."""
    row, _, low, high, first, last = sides
    at_low, at_high = (lines.border(first, last, row, end) for end in (low, high))
    crossing = np.where((at_low > 0) & (at_high <= 0), high, np.nan)
    active = np.flatnonzero(~np.isnan(crossing))
    low, at_low, high, at_high = (one[active] for one in (low, at_low, high, at_high))
    for _ in range(SECANTS):
        at = high - at_high * (high - low) / (at_high - at_low)
        moving = np.abs(at - crossing[active]) > close
        crossing[active] = at
        if not moving.any():
            break
        active, at = active[moving], at[moving]
        low, at_low, high, at_high = (one[moving] for one in (low, at_low, high, at_high))
        value = lines.border(first[active], last[active], row[active], at)
        beyond = value * at_high < 0
        low, at_low = np.where(beyond, high, low), np.where(beyond, at_high, 0.5 * at_low)
        high, at_high = at, value
    return crossing
