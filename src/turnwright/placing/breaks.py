"""Where a surface has no tangent: its steps, valleys and lips between smooth pieces, and the ends of its domain.

Along a line under the edge they are found to the last bit, by bisection between two samples of different pieces: a
piece cuts a line in one interval. Beyond an end of the domain, or the rim, the height is -inf. How steep a surface is
anywhere, infinitely at a step, settles whether the arc is enough to look along or the flanks are needed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import dilation as kernel
from turnwright.edge import Edge
from turnwright.placing.tangent import SAMPLES_PER_PERIOD, Contact, Tips
from turnwright.surface import Surface

__all__ = ["BESIDE", "Breaks", "Ground", "find_breaks", "ground_of", "heights_at"]

MOST_ON_GROUND = 500_000
"""Samples of the grid that settles whether the surface is steeper than the flanks anywhere."""
FEWEST_ON_GROUND = 96
"""Fewest samples on a radius of that grid."""
STEP = 1e-11
"""A height that jumps by less than this between two pieces is rounding. [mm]"""
BESIDE = 1e-9
"""How far from a kink or step its slopes are looked at, which only say to which side it rises. [mm]"""


class Ground(NamedTuple):
    """How steep the surface is where the edge may come."""

    steepest: float  # along the radius, or in any direction; infinite at a step
    top: float  # greatest height [mm]


class Breaks(NamedTuple):
    """Kinks and steps of sampled lines, row by row, see `candidates` in the kernels."""

    offsets: Ints
    after: Ints
    at: Floats
    height: Floats
    slope: Floats


class _Between(NamedTuple):
    """Places of lines, in pairs between which something changes. Each (n,)."""

    row: Ints  # of which line
    after: Ints  # the sample before them
    a: Floats  # as distances from the tip [mm]
    b: Floats

    def some(self, which: Bools) -> _Between:
        """Return some of them."""
        return _Between(self.row[which], self.after[which], self.a[which], self.b[which])


class _Same:
    """A surface, equal to itself alone, so that looking it up costs nothing."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.surface is other.surface

    def __hash__(self) -> int:
        return id(self.surface)


def ground_of(surface: Surface, radius: float, *, radial: bool) -> Ground:
    """Look at a surface on whole diameters, a quarter of its feature size apart if that is not too many samples.

    ``radial`` says that an edge in the radial plane feels its slopes; another one passes beside the axis.
    """
    return _ground(_Same(surface), radius, radial=radial)


@lru_cache(maxsize=8)
def _ground(same: _Same, radius: float, *, radial: bool) -> Ground:
    """Look at a surface as `ground_of` describes it; the last surfaces are kept."""
    surface = same.surface
    spacing = min(surface.feature_size / SAMPLES_PER_PERIOD, radius / FEWEST_ON_GROUND)
    spacing = max(spacing, radius * float(np.sqrt(2 * np.pi / MOST_ON_GROUND)))
    rows, samples = int(np.ceil(np.pi * radius / spacing)), int(np.ceil(2 * radius / spacing)) + 1
    # Not on the axis, nor on lines where pieces may meet.
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
            jump, high = _jumps(surface, c[row, 0], s[row, 0], across, along[before], along[before + 1])
            steepest = np.inf if jump > STEP else steepest
            top = max(top, high)
        for values, known in ((slope, np.isfinite(z)), (rise / np.diff(along), smooth)):
            steepest = max(steepest, float(np.max(values, where=known & np.isfinite(values), initial=0.0)))
        known = np.isfinite(second) & smooth[:, 1:] & smooth[:, :-1]
        bend = max(bend, float(np.max(second, where=known, initial=0.0)))
        top = max(top, float(np.max(z, where=np.isfinite(z), initial=-np.inf)))
    # Between the samples the surface may stand higher by about what it bends from one to the next.
    return Ground(steepest, top + bend)


def _jumps(surface: Surface, c: Floats, s: Floats, across: float, a: Floats, b: Floats) -> tuple[float, float]:
    """Return the greatest jump where the piece changes between a and b on some lines, and the greatest height there."""
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


def heights_at(contact: Contact, x: Floats, y: Floats) -> Floats:
    """Return the surface's heights, -inf where it is not defined or does not count."""
    with np.errstate(all="ignore"):
        heights = contact.surface.evaluate(x, y, 0)[0]
    inside = contact.surface.inside(x, y)
    missing = np.isnan(heights) if inside is None else ~inside | np.isnan(heights)
    if contact.rim < np.inf:
        missing |= _beyond(contact.rim, x, y) > 0
    heights[missing] = -np.inf
    return heights


def _beyond(rim: float, x: Floats, y: Floats) -> Ints:
    """Return 1 outside the rim, else 0."""
    return np.where(x * x + y * y > rim**2, 1, 0)


def _place(edge: Edge, tips: Tips, u: Floats) -> tuple[Floats, Floats]:
    """Return where on the part the edges of some tips stand at distances from them. Each (n,) [mm]."""
    x, y = np.empty((2, u.size, 1))
    kernel.places(edge, *tips, u[:, None], x, y)
    return x[:, 0], y[:, 0]


def find_breaks(contact: Contact, tips: Tips, u: Floats, x: Floats, y: Floats, heights: Floats) -> Breaks:
    """Return every kink or step between samples of different pieces, and every end of the domain, to the last bit.

    Each of the ``tips`` has a line of samples: where they stand from the tip and on the part, and how high the surface
    is there. Each (rows, n) [mm]
    """
    surface, edge = contact.surface, contact.edge
    beyond = _beyond(contact.rim, x, y) if contact.rim < np.inf else None
    missing = heights == -np.inf if beyond is None else (heights == -np.inf) & (beyond == 0)
    found = []
    for labels, label in (
        (surface.piece(x, y), surface.piece),
        (beyond, lambda x, y: _beyond(contact.rim, x, y)),
        (missing if missing.any() else None, lambda x, y: np.where(heights_at(contact, x, y) == -np.inf, 1, 0)),
    ):
        if labels is not None:
            row, after = np.nonzero(labels[:, 1:] != labels[:, :-1])
            between = _Between(row, after, u[row, after], u[row, after + 1])
            found.append(_split(label, edge, tips, between, 4e-16 * contact.farthest, 4))
    if not found:
        none = np.empty(0, dtype=np.int64)
        return Breaks(np.zeros(x.shape[0] + 1, dtype=np.int64), none, np.empty(0), *np.empty((2, 2, 0)))
    row, after, before_at, behind_at = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((before_at, after, row))
    row, after = row[order], after[order]
    sides = np.stack([before_at[order], behind_at[order]])
    height, slope = np.empty(sides.shape), np.empty(sides.shape)
    own = tips.some(row)
    for side in range(2):
        height[side] = heights_at(contact, *_place(edge, own, sides[side]))
        # A little inside the piece: right on the axis, a slope is the difference of infinities.
        beside = sides[side] + (2 * side - 1) * BESIDE
        x, y = _place(edge, own, beside)
        with np.errstate(all="ignore"):
            _, zx, zy = surface.evaluate(x, y, 1)
        kernel.slopes_along(edge, own.angle, beside, zx, zy, slope[side])
    offsets = np.searchsorted(row, np.arange(heights.shape[0] + 1))
    return Breaks(offsets, after, 0.5 * (sides[0] + sides[1]), height, slope)


def _split(
    label: Callable[[Floats, Floats], Ints | None], edge: Edge, tips: Tips, between: _Between, close: float, depth: int
) -> _Between:
    """Return the two sides, no further apart than ``close``, of each change of the label, a piece, between two places.

    A piece cuts a line in one interval. So where the piece of one end stops, and where that of the other begins, are
    found by bisection; what lies between them, if anything, is other pieces and is split again.
    """
    own = tips.some(between.row)

    def piece(place: Floats) -> Ints:
        pieces = label(*_place(edge, own, place))
        assert pieces is not None  # noqa: S101 - only called for a surface in pieces
        return pieces

    row, after, a, b = between
    first, last = piece(a), piece(b)
    low, over = a.copy(), b.copy()  # last known in the first piece, first known out of it
    under, high = a.copy(), b.copy()  # last known out of the last piece, first known in it
    for _ in range(64):
        middle = 0.5 * (low + over)
        mine = piece(middle) == first
        low, over = np.where(mine, middle, low), np.where(mine, over, middle)
        middle = 0.5 * (under + high)
        mine = piece(middle) == last
        high, under = np.where(mine, middle, high), np.where(mine, under, middle)
        if max((over - low).max(initial=0.0), (high - under).max(initial=0.0)) <= close:
            break
    sliver = (under - over > 1e-13) & (depth > 0)
    if not sliver.any():
        return _Between(row, after, low, high)
    # One piece in between has no change in it.
    more = sliver.copy()
    more[sliver] = piece(over)[sliver] != piece(under)[sliver]
    parts = (
        _Between(row, after, low, high).some(~sliver),
        _Between(row, after, low, over).some(sliver),
        _Between(row, after, under, high).some(sliver),
        _split(label, edge, tips, _Between(row, after, over, under).some(more), close, depth - 1),
    )
    return _Between(*(np.concatenate(one) for one in zip(*parts, strict=True)))
