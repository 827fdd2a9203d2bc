r"""The exact height at which the real edge touches a surface.

For the commanded tip at distance :math:`\rho` from the axis at azimuth :math:`\theta`, moving along Z only,

.. math:: Z(\rho, \theta) = \max_u \; [\, f(\rho + u, \theta) - e(u) \,]

a grey-scale dilation of the surface by the edge: free of gouges by construction, whatever the surface and the edge.
The maximum is found in one of two ways.

*One tangent.* If the surface curves up less than the edge everywhere, f - e is strictly concave and has one maximum,
the tangent solution, which Newton finds from the tip. The condition is tested beforehand on a grid over the whole part
and again at every point that Newton visits, that is at the density of the program itself.

*Search.* Otherwise f - e is sampled along the edge well below the surface's `feature_size`; every sampled maximum
that may be the greatest within the sampling error is refined, on either side of each kink or step, and the greatest is
taken. Points that share an azimuth share one sampled line, so that this costs a few evaluations a point. The arc is
enough where the surface is nowhere steeper than the flanks. Where it is, or has a step, each point's window widens
until no summit of the surface reaches over its ends, also across the axis.

*The rim.* The nose hangs over the outermost turn. A surface with one tangent as far as the arc reaches from there is
continued so far; of any other nothing counts outside the rim, where a formula may run away, step or end and nothing is
to be left. Either rule is the same for all tips, so that neighbours agree, and neither lifts a tip off the part.

Sources
-------
[Li2018]_ Eq. 8 takes the normal at the tip, exact only on a straight profile; [Troutman2016]_ ch. 6 has the tangent
solution and the error of a wavy edge. Oracles: brute-force dilation, and closed forms on spheres.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, Ints, frozen, same_length
from turnwright._kernels import dilation as kernel
from turnwright.errors import DomainError, GougeError, InputError
from turnwright.progress import Progress, run_chunks
from turnwright.surface import Surface
from turnwright.tool import Tool

__all__ = ["Touch", "follow", "tip_height", "touch"]

CONCAVITY = 0.9
"""Largest share of the edge's own curvature that the surface may have where a single tangent is taken for granted."""
SAMPLES_PER_FEATURE = 16
SAMPLES_PER_EDGE = 128
SAMPLES_PER_PERIOD = 4
"""Samples per feature size of the grid that settles whether there is one tangent."""
MOST_SAMPLES = 2_000_000
"""Samples of that grid, and of the tracks under the edge that are held at once."""
MOST_ON_GROUND = 500_000
"""Samples of the grid that settles whether the surface is steeper than the flanks anywhere."""
FEWEST_ON_GROUND = 96
"""Fewest samples on a radius of that grid."""
STEP = 1e-11
"""A height that jumps by less than this between two pieces is rounding. [mm]"""
CHUNK = 8192
FINEST = 1e-4
"""Least feature that is looked for, as a share of the nose radius."""
LONGEST = 20_000_000
"""Samples of one line or track beyond which a search is refused."""
WIDEST = 32
"""How far up the flanks a contact is looked for, in half widths of the arc, where the surface goes on without a rim."""
BESIDE = 1e-9
"""How far from a kink or step its slopes are looked at, which only say to which side it rises. [mm]"""


class Touch(NamedTuple):
    """Where and how high the edge touches. Each (n,)."""

    z: Floats  # commanded tip [mm]
    sweep: Floats  # place on the nose [rad]
    x: Floats  # contact point in the part frame [mm]
    y: Floats
    surface_z: Floats


class _Candidates(NamedTuple):
    """Short intervals of the edge in which a point may have its contact. Each (n,)."""

    point: Ints
    start: Floats  # ends and a first guess, as distances from the tip [mm]
    stop: Floats
    guess: Floats


class _Breaks(NamedTuple):
    """Kinks and steps of sampled lines, row by row, see `candidates` in the kernels."""

    offsets: Ints
    after: Ints
    at: Floats
    height: Floats
    slope: Floats


class _Ground(NamedTuple):
    """How steep the surface is where the edge may come."""

    steepest: float  # along the radius, or in any direction; infinite at a step
    top: float  # greatest height [mm]


class _Same:
    """A surface, equal to itself alone, so that looking it up costs nothing."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.surface is other.surface

    def __hash__(self) -> int:
        return id(self.surface)


_Tips = tuple[Floats, Floats, Floats]
"""Azimuth, distance from the axis and distance across, of each row."""


def tip_height(
    surface: Surface,
    tool: Tool,
    *,
    angle: ArrayLike,
    radius: ArrayLike,
    y: ArrayLike | None = None,
    sense: int,
    rim: float = np.inf,
    progress: Progress | None = None,
) -> Floats:
    """Return the commanded tip heights at which the edge touches the surface. (n,) [mm]. See `touch`."""
    return touch(surface, tool, angle=angle, radius=radius, y=y, sense=sense, rim=rim, progress=progress).z


def touch(
    surface: Surface,
    tool: Tool,
    *,
    angle: ArrayLike,
    radius: ArrayLike,
    y: ArrayLike | None = None,
    sense: int,
    rim: float = np.inf,
    progress: Progress | None = None,
) -> Touch:
    """Bring the edge down onto the surface along Z.

    Parameters
    ----------
    surface, tool
        What is to be left, and the real tool.
    angle, radius
        Rake plane, and where the commanded tip stands along it. (n,) [rad], (n,) [mm]
    y
        How far across that plane it stands, toward growing azimuth; ``None`` for at centre. (n,) [mm]
    sense
        +1 where the angle grows with time, -1 where it falls.
    rim
        How far from the axis the surface is wanted; no nearer than the farthest tip. Outside, it is continued under
        the arc of the outermost tips if it has one tangent as far; otherwise it counts as ended, and an edge that would
        touch outside is lowered onto the rim. By default all of the surface counts. [mm]
    progress
        Called with (done, total).

    Raises
    ------
    DomainError
        If the edge touches where the surface is not defined.
    GougeError
        If no place on the edge can be found that touches, which a surface with infinite heights does, or one that is
        steeper than the flanks as far as the rim.
    """
    angle, radius = frozen(angle, "angle"), frozen(radius, "radius")
    aside = np.zeros(angle.size) if y is None else frozen(y, "y")
    same_length([("angle", angle), ("radius", radius), ("y", aside)])
    contact = _Contact(surface, tool, sense, radius, aside, rim)
    out = Touch(*(np.empty(angle.size) for _ in range(5)))
    if contact.one_tangent():
        doubtful: list[int] = []

        def work(start: int, stop: int) -> None:
            part = slice(start, stop)
            if doubtful:
                return
            if not contact.newton(angle[part], radius[part], aside[part], Touch(*(a[part] for a in out))):
                doubtful.append(start)

        run_chunks(work, angle.size, CHUNK, progress)
        if not doubtful:
            return out
    contact.search(angle, radius, aside, out, progress)
    return out


def follow(
    surface: Surface, tool: Tool, *, angle: Floats, radius: Floats, y: Floats, sweep: Floats, sense: int
) -> Touch:
    """Return the tangents near those places on the nose, whether or not the edge touches somewhere else: no search.

    Near a valley of the path two lenslets touch in turn; either one's own tangent is what it would be without the
    other. Heights are nan where Newton's method finds none. For the arguments see `touch`; ``sweep`` is where on the
    nose to start. (n,) [rad]
    """
    edge = tool.cutting_edge(sense)
    s, tilt = sweep.copy(), 0.5 * float(min(-edge.low, edge.high))
    lost = np.zeros(s.size, dtype=np.bool_)
    for _ in range(12):
        x, at_y, value, first, top, step, bend = np.empty((7, s.size))
        kernel.under_edge(edge, angle, radius, y, s, x, at_y)
        with np.errstate(all="ignore"):
            jet = surface.evaluate(x, at_y, 2)
        kernel.newton_step(edge, angle, s, *jet, value, first, top, step, bend)
        lost |= ~(np.abs(step) < tilt)
        s += np.where(lost, 0.0, step)
        far = ~lost & ((np.abs(step) > kernel.CLOSE) | (np.abs(top - value) > kernel.LITTLE))
        if not far.any():
            break
    lost |= far | (s < edge.low) | (s > edge.high)
    kernel.under_edge(edge, angle, radius, y, s, x, at_y)
    z = np.where(lost, np.nan, top)
    return Touch(z, s, x, at_y, z + tool.edge(s, sense)[2])


def _turn_length(angle: Floats) -> int | None:
    """Return the number of points a turn if every turn has the same azimuths, else ``None``."""
    n = int(np.searchsorted(np.abs(angle - angle[0]), 2 * np.pi - 1e-9))
    if n < 1 or n >= angle.size:
        return None
    lag = np.abs(angle[n:] - angle[:-n])
    return n if np.abs(lag - 2 * np.pi).max() < 1e-9 else None


@lru_cache(maxsize=8)
def _ground(same: _Same, radius: float, *, radial: bool) -> _Ground:
    """Look at a surface on whole diameters, a quarter of its feature size apart if that is not too many samples.

    ``radial`` says that an edge in the radial plane feels its slopes; another one passes beside the axis.
    """
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
    return _Ground(steepest, top + bend)


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


def _of(tips: _Tips, row: Ints) -> _Tips:
    """Return some of the tips."""
    angle, radius, aside = (part[row] for part in tips)
    return angle, radius, aside


class _Contact:
    """One surface and one edge, with what both ways of finding the contact share."""

    def __init__(self, surface: Surface, tool: Tool, sense: int, radius: Floats, aside: Floats, rim: float) -> None:
        self.kernel = kernel
        self.surface = surface
        self.edge = tool.cutting_edge(sense)
        self.upright = bool(self.edge.rake_sin == 0 and self.edge.dy == 0 and not aside.any())
        self.nearest = float(radius.min() + self.edge.dx)
        self.farthest = float(radius.max() + self.edge.dx)
        self.arc = (float(self.edge.low_u), float(self.edge.high_u))
        # A curvature that vanishes may change by its own size over no distance at all; the nose does not feel it.
        self.feature = max(surface.feature_size, FINEST * float(self.edge.radius))
        # What the plan covers.
        outermost = float(np.hypot(radius + self.edge.dx, aside).max())
        self.rim = max(rim, outermost)
        self.extent = self.rim if self.rim < np.inf else outermost
        self.reach = self.extent + max(self.arc[1], -self.arc[0])
        self.flank = float(self.edge.rake_cos * min(-self.edge.low_slope, self.edge.high_slope))
        # Height that the surface reaches outside of what is looked at, where it is steeper than the flanks.
        self.top = -np.inf

    def edge_curvature(self) -> float:
        """Return the least curvature of the edge anywhere on its arc, as height over distance. [1/mm]."""
        return self.edge.least_curvature()

    def one_tangent(self) -> bool:
        """Say whether, on a grid over the part, the surface curves up less than the edge everywhere."""
        if not self.edge.convex or self.surface.in_pieces:
            return False
        self.limit = CONCAVITY * self.edge_curvature()
        # The grid is finer than the surface's features; where that is too fine, the search is as quick.
        fine = self.feature / SAMPLES_PER_PERIOD
        rings = max(97, int(np.ceil(self.reach / fine))) if fine > 0 else MOST_SAMPLES
        spokes = max(120, int(np.ceil(2 * np.pi * self.reach / fine))) if fine > 0 else MOST_SAMPLES
        if rings * spokes > MOST_SAMPLES:
            return False
        ring = np.linspace(0, self.reach, rings)
        steepest, sharpest, change = 0.0, -np.inf, 0.0
        for angle in np.array_split(np.linspace(0, 2 * np.pi, spokes, endpoint=False), -(-rings * spokes // 65536)):
            c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
            slope, bend = self._steepness(ring * c, ring * s, c, s)
            steepest = max(steepest, float(slope.max(initial=0.0)))
            sharpest = max(sharpest, float(bend.max(initial=-np.inf)))
            # Between the rings the curvature may be greater by about what it changes from ring to ring.
            with np.errstate(invalid="ignore"):
                steps = np.abs(np.diff(bend, axis=1))
            change = max(change, float(steps[np.isfinite(steps)].max(initial=0.0)))
        # On the flanks, which are straight, the surface may come up again unless it is nowhere as steep as they are.
        return bool(steepest < CONCAVITY * self.flank and sharpest + change < self.limit)

    def _steepness(self, x: Floats, y: Floats, c: Floats, s: Floats) -> tuple[Floats, Floats]:
        """Return the greatest slope, and the curvature upward, that an edge at azimuth (c, s) may meet at (x, y)."""
        inside = self.surface.inside(x, y)
        with np.errstate(all="ignore"):
            _, zx, zy, zxx, zxy, zyy = self.surface.evaluate(x, y, 2)
        slope, bend = np.abs(zx * c + zy * s), zxx * c * c + 2 * zxy * c * s + zyy * s * s
        if not self.upright:
            # Out of the radial plane any direction counts, and the slope across lifts a leaning edge.
            slope, lean = np.hypot(zx, zy), abs(self.edge.rake_sin)
            mean, half = 0.5 * (zxx + zyy), np.hypot(0.5 * (zxx - zyy), zxy)
            bend = (mean + half) * (1 + lean) ** 2 + slope * lean / self.edge.radius
            slope = slope * (1 + lean)
        there = np.isfinite(bend) & np.isfinite(slope)
        if inside is not None:
            there &= inside
        # With a rim there must be one tangent as far as the arc reaches, or all tips are searched for.
        elsewhere = np.inf if self.rim < np.inf else -np.inf
        return np.where(there, slope, 0.0), np.where(there, bend, elsewhere)

    def newton(self, angle: Floats, radius: Floats, aside: Floats, out: Touch) -> bool:
        """Fill ``out`` with the tangent solution; return whether it is certain to be the only one."""
        if self.upright and self.edge.perfect:
            certain = self._newton_round(angle, radius, out)
        else:
            certain = self._newton_edge(angle, radius, aside, out)
        # Nothing is said of the flanks beyond the arc.
        return certain and bool((out.sweep >= self.edge.low).all() and (out.sweep <= self.edge.high).all())

    def _newton_round(self, angle: Floats, radius: Floats, out: Touch) -> bool:
        """Newton for a perfect nose in the radial plane, with loops that vectorise."""
        cosine, sine = np.empty((2, angle.size))
        u = np.zeros(angle.size)
        self.kernel.round_start(self.edge, angle, radius, cosine, sine, out.x, out.y)
        for _ in range(12):
            with np.errstate(all="ignore"):
                jet = self.surface.evaluate(out.x, out.y, 2)
            far, doubtful = self.kernel.round_step(
                self.edge, self.limit, cosine, sine, radius, u, *jet, out.z, out.x, out.y
            )
            if doubtful:
                return False
            if not far:
                break
        else:
            return False
        nose = self.edge.radius
        np.arcsin(u / nose, out=out.sweep)
        np.add(out.z, (nose + self.edge.dz) - np.sqrt(nose * nose - u * u), out=out.surface_z)
        return self._inside(out.x, out.y)

    def _newton_edge(self, angle: Floats, radius: Floats, aside: Floats, out: Touch) -> bool:
        """Newton for any convex edge, in the sweep; points that have arrived drop out."""
        sweep = np.zeros(angle.size)
        active: Ints | slice = slice(None)
        a, r, v, s = angle, radius, aside, sweep
        for _ in range(12):
            x, y, value, first, top, step, bend = np.empty((7, s.size))
            self.kernel.under_edge(self.edge, a, r, v, s, x, y)
            with np.errstate(all="ignore"):
                jet = self.surface.evaluate(x, y, 2)
            self.kernel.newton_step(self.edge, a, s, *jet, value, first, top, step, bend)
            if not (bend < self.limit).all():
                return False
            # Newton from the tip could leave the arc on a steep place: walk there.
            s = s + np.clip(step, -0.3, 0.3)
            out.z[active], sweep[active] = top, s
            far = (np.abs(step) > self.kernel.CLOSE) | (np.abs(top - value) > self.kernel.LITTLE)
            if not far.any():
                break
            if 2 * np.count_nonzero(far) < far.size:
                keep = np.flatnonzero(far)
                active = keep if isinstance(active, slice) else active[keep]
                a, r, v, s = a[keep], r[keep], v[keep], s[keep]
        else:
            return False
        out.sweep[:] = sweep
        self._contact_points(angle, radius, aside, out)
        return self._inside(out.x, out.y)

    def _inside(self, x: Floats, y: Floats) -> bool:
        inside = self.surface.inside(x, y)
        return inside is None or bool(inside.all())

    def _contact_points(self, angle: Floats, radius: Floats, aside: Floats, out: Touch) -> None:
        """Set the contact point from the sweep."""
        x, y = np.empty(angle.size), np.empty(angle.size)
        self.kernel.under_edge(self.edge, angle, radius, aside, np.ascontiguousarray(out.sweep), x, y)
        out.x[:], out.y[:] = x, y
        out.surface_z[:] = out.z + self._edge_at(out.sweep)[2]

    def _edge_at(self, sweep: Floats) -> Floats:
        return self.edge.points(sweep)

    def _outside(self, angle: float, radius: float) -> NoReturn:
        raise DomainError(
            f"with the tip {radius:.6g} mm from the axis at azimuth {np.rad2deg(angle) % 360:.4g} deg the edge touches "
            f"where {type(self.surface).__name__} is not defined, its domain is {self.surface.domain}: extend the "
            "surface, or reduce the clear radius or the lead-in"
        )

    # ---------------------------------------------------------------------------------------------------- search

    def search(self, angle: Floats, radius: Floats, aside: Floats, out: Touch, progress: Progress | None) -> None:
        """Fill ``out`` by sampling along the edge and refining every maximum that may be the greatest.

        Points of one azimuth share one sampled line through the axis. Points that share nothing, or whose edge leaves
        the radial plane, get a sampled track under the edge each.
        """
        turn = _turn_length(angle) if self.upright else None
        width = self.arc[1] - self.arc[0]
        step = min(self.feature / SAMPLES_PER_FEATURE, width / SAMPLES_PER_EDGE)
        ground = _ground(_Same(self.surface), self.extent, radial=self.upright)
        steep = ground.steepest * (1 + abs(self.edge.rake_sin)) >= CONCAVITY * self.flank
        self.top = ground.top if steep else -np.inf

        def lines(start: int, stop: int) -> None:
            points = np.arange(start, angle.size, turn)[:, None] + np.arange(stop - start)
            points = np.minimum(points, angle.size).T
            used = points < angle.size
            self._widening(angle, radius, aside, points[used], np.nonzero(used)[0], step, out)

        def tracks(start: int, stop: int) -> None:
            self._widening(angle, radius, aside, np.arange(start, stop), None, step, out)

        samples = width / step
        if turn is not None:
            samples += (2 * self.extent if steep else self.farthest - self.nearest) / step
        if samples > LONGEST:
            raise InputError(
                f"{type(self.surface).__name__} has features of {self.surface.feature_size:.3g} mm, which take "
                f"{samples:.3g} samples a line, the limit is {LONGEST:.3g}: state a larger feature_size, or cut the "
                "features in a part of their own"
            )
        if turn is not None:
            together = min(turn // 8, 4 * CHUNK * turn // angle.size, int(MOST_SAMPLES / samples))
            run_chunks(lines, turn, max(1, together), progress)
        else:
            run_chunks(tracks, angle.size, int(np.clip(MOST_SAMPLES // 4 * step / width, 1, CHUNK)), progress)

    def _widening(
        self, angle: Floats, radius: Floats, aside: Floats, points: Ints, line: Ints | None, step: float, out: Touch
    ) -> None:
        """Find the contacts of ``points`` on the arc, or further up the flanks where the arc does not touch.

        ``line`` says, ascending, which of them share an azimuth; ``None`` where none do.
        """
        waiting = [(points, line, *self.arc)]
        while waiting:
            some, line, low, high = waiting.pop()
            part, narrow = self._touch(angle[some], radius[some], aside[some], line, step, low, high)
            for target, values in zip(out, part, strict=True):
                target[some[~narrow]] = values[~narrow]
            if not narrow.any():
                continue
            some = some[narrow]
            if high > max(WIDEST * self.arc[1], 4 * self.extent):
                raise GougeError(
                    f"with the tip {radius[some[0]]:.6g} mm from the axis the surface stands above the edge "
                    f"even {high:.3g} mm up its flanks: take a tool with a larger included angle, or a surface "
                    "that does not run away outside the part"
                )
            low, high = 2 * low, 2 * high
            if line is not None:
                waiting.append((some, line[narrow], low, high))
                continue
            # A wider window takes more room: where every point has its own, fewer points at a time.
            pieces = int(np.ceil(some.size * min(high - low, 2 * self.extent) / step / (MOST_SAMPLES // 4)))
            waiting += [(piece, None, low, high) for piece in np.array_split(some, min(max(pieces, 1), some.size))]

    def _touch(
        self, angle: Floats, radius: Floats, aside: Floats, line: Ints | None, step: float, low: float, high: float
    ) -> tuple[Touch, Bools]:
        """Find the contacts of points on lines, or (without) on tracks of their own, and which need a wider window."""
        whole = line is not None and self.top > -np.inf
        if line is None:
            offsets = np.arange(angle.size + 1)
            row_angle, row_radius, row_aside, position = angle, radius, aside, np.zeros(angle.size)
        else:
            # The line itself is the track of an edge whose tip stands on the axis.
            offsets = np.append(np.flatnonzero(np.diff(line, prepend=-1)), line.size)
            row_angle, row_radius = angle[offsets[:-1]], np.full(offsets.size - 1, -self.edge.dx)
            row_aside = np.zeros(offsets.size - 1)
            position = radius + self.edge.dx
        first, last = float(position.min()) + low, float(position.max()) + high
        if whole:
            first, last = min(first, -self.extent), max(last, self.extent)
        if self.rim < np.inf:
            # Nothing counts outside the rim.
            tips = radius + self.edge.dx if line is None else np.zeros(1)
            first = max(first, -self.rim - float(tips.max()))
            last = min(last, self.rim - float(tips.min()))
        # Not on the axis, nor on any other round place where a prescription may be special.
        origin = first - 2.381966 * step
        samples = int(np.ceil((last - origin) / step)) + 4
        u = np.ascontiguousarray(np.broadcast_to(origin + step * np.arange(samples), (row_angle.size, samples)))
        x, y = np.empty(u.shape), np.empty(u.shape)
        self.kernel.places(self.edge, row_angle, row_radius, row_aside, u, x, y)
        heights = self._heights(x, y)
        breaks = self._breaks(x, y, heights, u, (row_angle, row_radius, row_aside))
        found, direct, direct_at, ended, narrow = self._candidates(
            heights, origin, step, offsets, position, breaks, low, high, -np.inf if whole else self.top
        )
        if not isinstance(found, _Candidates):
            self._outside(float(angle[found]), float(radius[found]))
        best, z = np.zeros(angle.size), np.zeros(angle.size)
        if found.point.size or not narrow.all():
            top, sweep = self._maximum(angle[found.point], radius[found.point], aside[found.point], found)
            best[:] = self.edge.sweeps(direct_at)
            z = direct - self.edge.dz
            self.kernel.keep_highest(found.point, top, sweep, z, best, ended)
        if not (np.isfinite(z) | narrow).all():
            k = int(np.argmin(np.isfinite(z) | narrow))
            raise GougeError(
                f"no place on the edge touches with the tip {radius[k]:.6g} mm from the axis at azimuth "
                f"{np.rad2deg(angle[k]) % 360:.4g} deg, the surface must be finite there: check the prescription"
            )
        part = Touch(z, best, *np.empty((3, angle.size)))
        self._contact_points(angle, radius, aside, part)
        ended &= ~narrow
        if ended.any():
            self._judge_ends(angle[ended], radius[ended], aside[ended], Touch(*(values[ended] for values in part)))
        return part, narrow

    def _judge_ends(self, angle: Floats, radius: Floats, aside: Floats, at: Touch) -> None:
        """Refuse contacts at an end of the surface, unless it is the rim and the arc that touches."""
        distance = np.hypot(at.x, at.y)
        inside = distance < self.rim * (1 - 1e-9)
        if inside.any():
            k = int(np.argmax(inside))
            self._outside(float(angle[k]), float(radius[k]))
        on_flank = np.flatnonzero((at.sweep < self.edge.low) | (at.sweep > self.edge.high))
        if not on_flank.size:
            return
        # A wall that the rim happens to cut is touched like any other; a surface that climbs all the way is not met.
        angle, radius, aside, sweep = (one[on_flank] for one in (angle, radius, aside, at.sweep))
        x, y, lift = np.empty(on_flank.size), np.empty(on_flank.size), []
        for part in np.linspace(0.0, 0.99, 9):
            place = np.clip(sweep, self.edge.low, self.edge.high) * (1 - part) + sweep * part
            self.kernel.under_edge(self.edge, angle, radius, aside, place, x, y)
            lift.append(self._heights(x, y) - self._edge_at(place)[2])
        climbs = (np.diff(lift, axis=0) > 0).all(axis=0)
        if climbs.any():
            k = int(np.argmax(climbs))
            raise GougeError(
                f"with the tip {radius[k]:.6g} mm from the axis at azimuth {np.rad2deg(angle[k]) % 360:.4g} deg a "
                f"flank of the tool stands on the rim of the path, {self.rim:.6g} mm from the axis, where the surface "
                "is steeper than the flank: take a tool with a larger included angle, or reduce the clear radius or "
                "the lead-in"
            )

    def _heights(self, x: Floats, y: Floats) -> Floats:
        """Return the surface's heights, -inf where it is not defined or does not count."""
        with np.errstate(all="ignore"):
            heights = self.surface.evaluate(x, y, 0)[0]
        inside = self.surface.inside(x, y)
        missing = np.isnan(heights) if inside is None else ~inside | np.isnan(heights)
        if self.rim < np.inf:
            missing |= self._beyond(x, y) > 0
        heights[missing] = -np.inf
        return heights

    def _beyond(self, x: Floats, y: Floats) -> Ints:
        """Return 1 outside the rim, else 0."""
        return np.where(x * x + y * y > self.rim**2, 1, 0)

    def _candidates(
        self,
        heights: Floats,
        origin: float,
        step: float,
        offsets: Ints,
        position: Floats,
        breaks: _Breaks,
        low: float,
        high: float,
        elsewhere: float,
    ) -> tuple[_Candidates | int, Floats, Floats, Bools, Bools]:
        """Run the kernel of this name with as much room as it needs; an int is the tip that nothing is under."""
        direct, direct_at = np.empty(position.size), np.zeros(position.size)
        ended, narrow = np.empty((2, position.size), np.bool_)
        whole = bool(self.rim < np.inf and min(-low, high) > self.rim + self.farthest)
        size = 4 * position.size + 4 * heights.shape[1]
        while True:
            point = np.empty(size, dtype=np.int64)
            start, stop, guess = np.empty((3, size))
            found = self.kernel.candidates(
                heights, origin, step, offsets, position, *breaks, self.edge, low, high,
                elsewhere, whole, point, start, stop, guess, direct, direct_at, ended, narrow,
            )  # fmt: skip
            if found >= 0:
                intervals = _Candidates(point[:found], start[:found], stop[:found], guess[:found])
                return intervals, direct, direct_at, ended, narrow
            if found <= self.kernel.OUTSIDE:
                return self.kernel.OUTSIDE - found, direct, direct_at, ended, narrow
            size *= 4

    # ------------------------------------------------------------------------------------------- kinks and steps

    def _breaks(self, x: Floats, y: Floats, heights: Floats, u: Floats, tips: _Tips) -> _Breaks:
        """Return every kink or step between samples of different pieces, and every end of the domain, to the last bit.

        Beyond an end of the domain, or the rim, the height is -inf.
        """
        found: list[tuple[Ints, Ints, Floats, Floats]] = []
        beyond = self._beyond(x, y) if self.rim < np.inf else None
        missing = heights == -np.inf if beyond is None else (heights == -np.inf) & (beyond == 0)
        for labels, label in (
            (self.surface.piece(x, y), self.surface.piece),
            (beyond, self._beyond),
            (missing if missing.any() else None, self._missing),
        ):
            if labels is not None:
                row, after = np.nonzero(labels[:, 1:] != labels[:, :-1])
                found.append(self._split(label, row, after, u[row, after], u[row, after + 1], tips, 4))
        if not found:
            none = np.empty(0, dtype=np.int64)
            return _Breaks(np.zeros(x.shape[0] + 1, dtype=np.int64), none, np.empty(0), *np.empty((2, 2, 0)))
        row, after, before_at, behind_at = (np.concatenate(parts) for parts in zip(*found, strict=True))
        order = np.lexsort((before_at, after, row))
        row, after = row[order], after[order]
        sides = np.stack([before_at[order], behind_at[order]])
        height, slope = np.empty(sides.shape), np.empty(sides.shape)
        for side in range(2):
            height[side] = self._heights(*self._place(_of(tips, row), sides[side]))
            # A little inside the piece: right on the axis, a slope is the difference of infinities.
            beside = sides[side] + (2 * side - 1) * BESIDE
            x, y = self._place(_of(tips, row), beside)
            with np.errstate(all="ignore"):
                _, zx, zy = self.surface.evaluate(x, y, 1)
            self.kernel.slopes_along(self.edge, tips[0][row], beside, zx, zy, slope[side])
        offsets = np.searchsorted(row, np.arange(heights.shape[0] + 1))
        return _Breaks(offsets, after, 0.5 * (sides[0] + sides[1]), height, slope)

    def _place(self, tips: _Tips, u: Floats) -> tuple[Floats, Floats]:
        x, y = np.empty((2, u.size, 1))
        self.kernel.places(self.edge, *tips, u[:, None], x, y)
        return x[:, 0], y[:, 0]

    def _missing(self, x: Floats, y: Floats) -> Ints:
        """Return 1 where the surface has no height, else 0."""
        return np.where(self._heights(x, y) == -np.inf, 1, 0)

    def _split(
        self,
        label: Callable[[Floats, Floats], Ints | None],
        row: Ints,
        after: Ints,
        a: Floats,
        b: Floats,
        tips: _Tips,
        depth: int,
    ) -> tuple[Ints, Ints, Floats, Floats]:
        """Return where between a and b the label, a piece, changes: rows, samples before, and the sides of each change.

        A piece cuts a line in one interval. So where the piece of one end stops, and where that of the other begins,
        are found by bisection; what lies between them, if anything, is other pieces and is split again.
        """
        here = _of(tips, row)

        def piece(place: Floats) -> Ints:
            pieces = label(*self._place(here, place))
            assert pieces is not None  # noqa: S101 - only called for a surface in pieces
            return pieces

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
            if max((over - low).max(initial=0.0), (high - under).max(initial=0.0)) <= 4e-16 * self.farthest:
                break
        sliver = (under - over > 1e-13) & (depth > 0)
        if not sliver.any():
            return row, after, low, high
        # One piece in between has no change in it.
        more = sliver.copy()
        more[sliver] = piece(over)[sliver] != piece(under)[sliver]
        inner = self._split(label, row[more], after[more], over[more], under[more], tips, depth - 1)
        return (
            np.concatenate([row[~sliver], row[sliver], row[sliver], inner[0]]),
            np.concatenate([after[~sliver], after[sliver], after[sliver], inner[1]]),
            np.concatenate([low[~sliver], low[sliver], under[sliver], inner[2]]),
            np.concatenate([high[~sliver], over[sliver], high[sliver], inner[3]]),
        )

    def _maximum(self, angle: Floats, radius: Floats, aside: Floats, found: _Candidates) -> tuple[Floats, Floats]:
        """Return the greatest f - e in each short smooth interval of the nose, and where it is."""
        begin, end, sweep = np.empty((3, angle.size))
        for target, u in zip((begin, end, sweep), (found.start, found.stop, found.guess), strict=True):
            target[:] = self.edge.sweeps(u)
        best, place = np.full(angle.size, -np.inf), sweep.copy()
        index = np.arange(angle.size)
        state = np.stack([begin, end, begin, end, sweep])  # interval, bracket, where to look next
        done = np.zeros(angle.size, dtype=np.bool_)
        b, p, a, r, v = best, place, angle, radius, aside
        for _ in range(100):
            x, y, value, first, top, step, bend = np.empty((7, a.size))
            self.kernel.under_edge(self.edge, a, r, v, state[4], x, y)
            with np.errstate(all="ignore"):
                jet = self.surface.evaluate(x, y, 2)
            self.kernel.newton_step(self.edge, a, state[4], *jet, value, first, top, step, bend)
            self.kernel.bracket(*state, value, first, top, step, b, p, done)
            if done.all():
                best[index], place[index] = b, p
                break
            if 4 * np.count_nonzero(done) > done.size:
                best[index], place[index] = b, p
                keep = np.flatnonzero(~done)
                index, a, r, v, b, p = index[keep], a[keep], r[keep], v[keep], b[keep], p[keep]
                state, done = np.ascontiguousarray(state[:, keep]), done[keep]
        return best, place
