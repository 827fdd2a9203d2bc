"""The exact maximum: the height at which the real edge touches a surface with many tangents, or none.

f - e is sampled along the edge at steps well below the surface's `feature_size`. A few samples are sufficient where
the surface curves up less than the edge: then f - e has one maximum in each smooth piece. This is tested between all
samples of a line, and with the slopes on both sides of its breaks; a line that fails is sampled more finely.

Every sampled maximum that may be the greatest within the sampling error is refined, on both sides of each slope
discontinuity or step, and the greatest is taken. Points that share an azimuth share one sampled line, which costs a few
evaluations per point. The arc is sufficient where the surface is nowhere steeper than the flanks. Where it is steeper,
or has a step, the window of each point is widened until no summit of the surface rises above its ends, also across the
axis.

Where a line runs along a step for some length, within rounding, the edge has material on both sides: the line is
searched once more on each side, and the highest of all counts.

Sources
-------
Reference solutions of the tests: brute-force dilation, and closed forms on spheres.
"""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import dilation as kernel
from turnwright.edge import Edge
from turnwright.errors import DomainError, GougeError, InputError
from turnwright.placing.breaks import (
    AXIS_ZONE_MM,
    WALL_STEP_RATIO,
    Breaks,
    evaluate_heights,
    find_breaks,
    find_extremes,
    find_walls,
    sample_surface,
    wall_offset,
)
from turnwright.placing.lenslets import touch_lenslets
from turnwright.placing.tangent import MAX_CURVATURE_RATIO, Contact, Tips, Touch
from turnwright.progress import Progress, run_chunks
from turnwright.surface import Lenslets, Surface

__all__ = ["CHUNK", "search"]

SAMPLES_PER_FEATURE = 16
SAMPLES_PER_EDGE = 128
TANGENT_SAMPLES = 8
"""Samples of a feature, and of an edge that has one tangent on each convex piece of the surface."""
LEVEL_SAMPLES = 2001
"""Samples of the arc between which places where the edge is level are looked for."""
MAX_SAMPLES = 2_000_000
"""Most samples of the tracks under the edge that are in memory together."""
CHUNK = 8192
MAX_LINE_SAMPLES = 20_000_000
"""Most samples of one line or track."""
MAX_WINDOW_RATIO = 32
"""Without a rim, contacts are searched for up the flanks as far as this many half widths of the arc."""


class _Candidates(NamedTuple):
    """Short intervals of the edge in which a point may have its contact. Each (n,)."""

    point: Ints
    start: Floats  # both ends and a first guess, as distances from the tip [mm]
    stop: Floats
    guess: Floats

    def first(self, count: int) -> _Candidates:
        return _Candidates(self.point[:count], self.start[:count], self.stop[:count], self.guess[:count])


class _TipState(NamedTuple):
    """State of each tip before the candidates are refined. Each (n,)."""

    height: Floats  # greatest f - e at the breaks themselves [mm]
    at: Floats  # its distance from the tip [mm]
    ended: Bools  # whether the domain ends there
    narrow: Bools  # whether the edge may touch outside the window; the other fields are then void


class _Window(NamedTuple):
    """Range of the edge that is sampled, and the step."""

    low: float  # distance from the tip [mm]
    high: float
    step: float
    finer: float  # step where the surface curves up by ``curvature`` or more
    curvature: float  # infinite where the step is the finer one [1/mm]
    top: float  # greatest height of the surface, -inf if it is less steep than the flanks [mm]
    across: float  # distance at which a line is searched on both sides of a wall [mm]
    lenslets: Lenslets | None = None  # that the surface is; they are tried first


class _Lines(NamedTuple):
    """Samples of the surface: a row for each of some tips, and on each row one or more positions of the tip."""

    tips: Tips
    offsets: Ints  # row i holds the positions offsets[i] to offsets[i + 1]
    position: Floats  # of the tip, along its row [mm]
    u: Floats  # (rows, n) equally spaced, along each row [mm]


def search(contact: Contact, tips: Tips, out: Touch, progress: Progress | None) -> None:
    """Fill ``out``: sample along the edge and refine every maximum that may be the greatest.

    Points of one azimuth share one sampled line through the axis. Points with an azimuth of their own, or with an edge
    that leaves the radial plane, get a sampled track under the edge each.
    """
    edge, count = contact.edge, tips.angle.size
    per_rev = _count_points_per_rev(tips.angle) if contact.upright else None
    width = edge.high_u - edge.low_u
    step = min(contact.feature / SAMPLES_PER_FEATURE, width / SAMPLES_PER_EDGE)
    ground = find_extremes(contact.surface, contact.extent, radial=contact.upright)
    steep = ground.steepest * (1 + abs(edge.rake_sin)) >= MAX_CURVATURE_RATIO * contact.flank
    top, across = ground.top if steep else -np.inf, wall_offset(contact, tips)
    window = _Window(edge.low_u, edge.high_u, step, step, np.inf, top, across)
    if edge.convex and contact.surface.convex_pieces and not steep:
        window = window._replace(
            step=min(contact.feature, width) / TANGENT_SAMPLES,
            curvature=MAX_CURVATURE_RATIO * edge.least_curvature(),
            lenslets=contact.surface.lenslets if edge.perfect and contact.upright else None,
        )

    def lines(start: int, stop: int) -> None:
        points = np.arange(start, count, per_rev)[:, None] + np.arange(stop - start)
        points = np.minimum(points, count).T
        used = points < count
        _search_both_sides(contact, window, tips, points[used], np.nonzero(used)[0], out)

    def tracks(start: int, stop: int) -> None:
        _search_both_sides(contact, window, tips, np.arange(start, stop), None, out)

    samples = width / step
    if per_rev is not None:
        samples += (2 * contact.extent if steep else contact.farthest - contact.nearest) / step
    if samples > MAX_LINE_SAMPLES:
        raise InputError(
            f"{type(contact.surface).__name__} has features of {contact.surface.feature_size:.3g} mm, which take "
            f"{samples:.3g} samples a line, the limit is {MAX_LINE_SAMPLES:.3g}: set a larger feature_size, or cut "
            "the features as a separate part"
        )
    if per_rev is not None:
        # More at once would not stay in the heap; on lenslets there is less of each.
        chunk = CHUNK * (4 if window.lenslets is None else 8)
        together = min(per_rev // 8, chunk * per_rev // count, int(MAX_SAMPLES / samples))
        run_chunks(lines, per_rev, max(1, together), progress)
    else:
        run_chunks(tracks, count, int(np.clip(MAX_SAMPLES // 4 * step / width, 1, CHUNK)), progress)


def _count_points_per_rev(angle: Floats) -> int | None:
    """Return the number of points per revolution if every revolution has the same azimuths, else ``None``."""
    turned = np.abs(angle - angle[0])
    n = int(np.searchsorted(turned, 2 * np.pi - 1e-9))
    if n < 1 or n >= angle.size:
        return None
    lag = turned[n:] - turned[:-n]
    return n if max(lag.max() - 2 * np.pi, 2 * np.pi - lag.min()) < 1e-9 else None


def _search_both_sides(
    contact: Contact, window: _Window, tips: Tips, points: Ints, line: Ints | None, out: Touch
) -> None:
    """Find the contacts of ``points``; those of an edge that stands along a step, on the higher side of it.

    ``line`` numbers the azimuth of each point, ascending; ``None`` if no two points share one.
    """
    walled = _search_widening(contact, window, tips, points, line, out)
    if contact.edge.rake_sin != 0 and contact.surface.in_pieces:
        _touch_level(contact, window, tips, points, out)
    if not walled.size:
        return
    along = np.isin(points, walled)
    points, line = points[along], None if line is None else line[along]
    some, every = tips.select(points), np.arange(points.size)
    for side in (-window.across, window.across):
        shifted = some._replace(lateral=some.lateral + side)
        there = Touch(*(np.empty(points.size) for _ in out))
        _search_widening(contact, window, shifted, every, line, there)
        higher = there.z > out.z[points]
        out.put(points[higher], there.select(higher))


def _find_level(edge: Edge) -> Floats:
    """Return where an edge is level: at its tip; with strong waviness at several places. (n,) [rad]."""
    if edge.perfect:
        return np.zeros(1)
    sweep = np.linspace(edge.low, edge.high, LEVEL_SAMPLES)
    rises = edge.trace(sweep)[3] > 0
    turns = np.flatnonzero(rises[1:] != rises[:-1])
    a, b, rising = sweep[turns], sweep[turns + 1], rises[turns]
    for _ in range(50):
        middle = 0.5 * (a + b)
        before = (edge.trace(middle)[3] > 0) == rising
        a, b = np.where(before, middle, a), np.where(before, b, middle)
    return 0.5 * (a + b)


def _touch_level(contact: Contact, window: _Window, tips: Tips, points: Ints, out: Touch) -> None:
    """Raise tips whose raked edge touches a step along the azimuth: it does so where it is level."""
    edge = contact.edge
    for sweep in _find_level(edge):
        at = np.full(points.size, sweep)
        for side in (-window.across, window.across):
            some = tips.select(points)
            x, y, e = contact.under_edge(some._replace(lateral=some.lateral + side), at)
            heights = evaluate_heights(contact, x, y)
            z = heights - e
            higher = (z > out.z[points] + WALL_STEP_RATIO * window.across) & (z < np.inf)
            higher &= np.hypot(x, y) > AXIS_ZONE_MM
            out.put(points[higher], Touch(z, at, x, y, heights).select(higher))


def _search_widening(
    contact: Contact, window: _Window, tips: Tips, points: Ints, line: Ints | None, out: Touch
) -> Ints:
    """Find the contacts of ``points`` on the arc, or further up the flanks where the arc does not touch.

    ``line`` numbers the azimuth of each point, ascending; ``None`` if no two points share one. Return which points have
    an edge that stands along a step for some length.
    """
    walled = [points[:0]]
    waiting = [(points, line, window)]
    while waiting:
        some, line, window = waiting.pop()
        if window.lenslets is not None:
            part = _touch_lenslets(contact, window, window.lenslets, tips.select(some), line)
            if part is not None:
                out.put(some, part)
                continue
            window = window._replace(lenslets=None)
        answer = _find_contacts(contact, window, tips.select(some), line)
        if answer is None:
            waiting.append((some, line, window._replace(step=window.finer, curvature=np.inf)))
            continue
        part, narrow, along_wall = answer
        walled.append(some[along_wall])
        if not narrow.any():
            out.put(some, part)
            continue
        out.put(some[~narrow], part.select(~narrow))
        some = some[narrow]
        if window.high > max(MAX_WINDOW_RATIO * contact.edge.high_u, 4 * contact.extent):
            raise GougeError(
                f"with the tip {tips.radius[some[0]]:.6g} mm from the axis the surface is above the edge "
                f"even {window.high:.3g} mm up its flanks: use a tool with a larger included angle, or a surface "
                "that rises less outside the part"
            )
        window = window._replace(low=2 * window.low, high=2 * window.high)
        if line is not None:
            waiting.append((some, line[narrow], window))
            continue
        # A wider window takes more memory: where each point has its own track, fewer points are done together.
        wide = min(window.high - window.low, 2 * contact.extent) / window.step
        pieces = int(np.ceil(some.size * wide / (MAX_SAMPLES // 4)))
        waiting += [(piece, None, window) for piece in np.array_split(some, min(max(pieces, 1), some.size))]
    return np.concatenate(walled)


def _touch_lenslets(
    contact: Contact, window: _Window, lenslets: Lenslets, tips: Tips, line: Ints | None
) -> Touch | None:
    step = min(contact.feature, window.high - window.low)
    lines = _lay_out_lines(contact, window._replace(step=step), tips, line, spans_part=False)
    return touch_lenslets(contact, lenslets, tips, *lines)


def _find_contacts(
    contact: Contact, window: _Window, tips: Tips, line: Ints | None
) -> tuple[Touch, Bools, Bools] | None:
    """Find the contacts of points on shared lines, or else on separate tracks.

    Return with them which points need a wider window, and which have an edge along a step; or ``None`` if the step of
    the window is too coarse.
    """
    edge, size = contact.edge, tips.angle.size
    spans_part = line is not None and window.top > -np.inf
    lines = _lay_out_lines(contact, window, tips, line, spans_part=spans_part)
    x, y = contact.at_distance(lines.tips, lines.u)
    sampled = sample_surface(contact, x, y)
    breaks, numbers = find_breaks(contact, lines.tips, lines.u, x, y, sampled)
    candidates, direct = _find_candidates(
        contact, window, lines, sampled[0], breaks, -np.inf if spans_part else window.top
    )
    if candidates is None:
        return None
    if not isinstance(candidates, _Candidates):
        _refuse_outside(contact.surface, tips, candidates)
    narrow, ended = direct.narrow, direct.ended
    best, z = np.zeros(size), np.zeros(size)
    if candidates.point.size or not narrow.all():
        top, sweep = _refine_maxima(contact, tips.select(candidates.point), candidates)
        touches = direct.height > -np.inf
        best[touches] = edge.sweeps(direct.at[touches])
        z = direct.height - edge.dz
        kernel.keep_highest(candidates.point, top, sweep, z, best, ended)
    if not (np.isfinite(z) | narrow).all():
        k = int(np.argmin(np.isfinite(z) | narrow))
        raise GougeError(
            f"no point of the edge touches with the tip {tips.radius[k]:.6g} mm from the axis at azimuth "
            f"{np.rad2deg(tips.angle[k]) % 360:.4g} deg, the surface must be finite there: check the prescription"
        )
    part = contact.touch(tips, z, best)
    ended &= ~narrow
    if ended.any():
        _check_ends(contact, tips.select(ended), part.select(ended))
    walled = np.zeros(size, dtype=np.bool_)
    if edge.rake_sin == 0:
        along_wall = find_walls(contact, lines.tips, lines.u, numbers, window.across)
        walled = np.repeat(along_wall, np.diff(lines.offsets))
    return part, narrow, walled


def _lay_out_lines(contact: Contact, window: _Window, tips: Tips, line: Ints | None, *, spans_part: bool) -> _Lines:
    """Return lines that tips share, across all of the part with ``spans_part``, or a separate track for each tip."""
    along = tips.radius + contact.edge.dx
    if line is None:
        rows, offsets, position = tips, np.arange(tips.angle.size + 1), np.zeros(tips.angle.size)
    else:
        # The line is the track of an edge whose tip is on the axis.
        offsets = np.append(np.flatnonzero(np.diff(line, prepend=-1)), line.size)
        count, position = offsets.size - 1, along
        rows = Tips(tips.angle[offsets[:-1]], np.full(count, -contact.edge.dx), tips.lateral[offsets[:-1]])
    first, last = float(position.min()) + window.low, float(position.max()) + window.high
    if spans_part:
        first, last = min(first, -contact.extent), max(last, contact.extent)
    if contact.rim < np.inf:
        # Nothing counts outside the rim.
        centre = along if line is None else np.zeros(1)
        first = max(first, -contact.rim - float(centre.max()))
        last = min(last, contact.rim - float(centre.min()))
    # The samples avoid the axis and round coordinates, where a surface may be singular.
    step = window.step
    origin = first - 2.381966 * step
    samples = int(np.ceil((last - origin) / step)) + 4
    u = np.ascontiguousarray(np.broadcast_to(origin + step * np.arange(samples), (rows.angle.size, samples)))
    return _Lines(rows, offsets, position, u)


def _find_candidates(
    contact: Contact, window: _Window, lines: _Lines, heights: Floats, breaks: Breaks, elsewhere: float
) -> tuple[_Candidates | int | None, _TipState]:
    """Run the kernel of this name with as much memory as it needs.

    An int is the tip without a surface under it; ``None`` means that the step of the window is too coarse.
    """
    count = lines.position.size
    direct = _TipState(np.empty(count), np.zeros(count), *np.empty((2, count), np.bool_))
    low, high = window.low, window.high
    beyond_rim = bool(contact.rim < np.inf and min(-low, high) > contact.rim + contact.farthest)
    size = 4 * count + 4 * heights.shape[1]
    while True:
        candidates = _Candidates(np.empty(size, dtype=np.int64), *np.empty((3, size)))
        answer = kernel.candidates(
            heights, float(lines.u[0, 0]), window.step, lines.offsets, lines.position, *breaks, contact.edge, low, high,
            elsewhere, beyond_rim, window.curvature, *candidates, *direct,
        )  # fmt: skip
        if answer >= 0:
            return candidates.first(answer), direct
        if answer == kernel.COARSE:
            return None, direct
        if answer <= kernel.OUTSIDE:
            return kernel.OUTSIDE - answer, direct
        size *= 4


def _refine_maxima(contact: Contact, tips: Tips, found: _Candidates) -> tuple[Floats, Floats]:
    """Return the greatest f - e in each short smooth interval of the nose, and its place."""
    edge = contact.edge
    begin, end, sweep = (edge.sweeps(u) for u in (found.start, found.stop, found.guess))
    best, place = np.full(sweep.size, -np.inf), sweep.copy()
    index = np.arange(sweep.size)
    state = np.stack([begin, end, begin, end, sweep])  # interval, bracket, next place to evaluate
    done = np.zeros(sweep.size, dtype=np.bool_)
    open_tips, b, p = tips, best, place
    for _ in range(100):
        value, first, top, step, _ = contact.newton_step(open_tips, state[4])
        kernel.bracket(contact.step_tol, *state, value, first, top, step, b, p, done)
        if done.all():
            best[index], place[index] = b, p
            break
        if 4 * np.count_nonzero(done) > done.size:
            best[index], place[index] = b, p
            keep = np.flatnonzero(~done)
            index, open_tips, b, p = index[keep], open_tips.select(keep), b[keep], p[keep]
            state, done = np.ascontiguousarray(state[:, keep]), done[keep]
    return best, place


def _check_ends(contact: Contact, tips: Tips, at: Touch) -> None:
    """Raise if a contact is at an end of the surface, unless the arc touches at the rim."""
    inside = np.hypot(at.x, at.y) < contact.rim * (1 - 1e-9)
    if inside.any():
        _refuse_outside(contact.surface, tips, int(np.argmax(inside)))
    edge = contact.edge
    on_flank = np.flatnonzero((at.sweep < edge.low) | (at.sweep > edge.high))
    if not on_flank.size:
        return
    # A flank may touch a wall that the rim cuts; it never meets a surface that rises all the way along the flank.
    tips, sweep, lift = tips.select(on_flank), at.sweep[on_flank], []
    for part in np.linspace(0.0, 0.99, 9):
        place = np.clip(sweep, edge.low, edge.high) * (1 - part) + sweep * part
        x, y, e = contact.under_edge(tips, place)
        lift.append(evaluate_heights(contact, x, y) - e)
    climbs = (np.diff(lift, axis=0) > 0).all(axis=0)
    if climbs.any():
        k = int(np.argmax(climbs))
        raise GougeError(
            f"with the tip {tips.radius[k]:.6g} mm from the axis at azimuth "
            f"{np.rad2deg(tips.angle[k]) % 360:.4g} deg a flank of the tool touches the rim of the path, "
            f"{contact.rim:.6g} mm from the axis, where the surface is steeper than the flank: use a tool with a "
            "larger included angle, or reduce the clear aperture or the lead-in"
        )


def _refuse_outside(surface: Surface, tips: Tips, which: int) -> NoReturn:
    raise DomainError(
        f"with the tip {tips.radius[which]:.6g} mm from the axis at azimuth "
        f"{np.rad2deg(tips.angle[which]) % 360:.4g} deg the edge touches where {type(surface).__name__} is not "
        f"defined, its domain is {surface.domain}: extend the surface, or reduce the clear aperture or the lead-in"
    )
