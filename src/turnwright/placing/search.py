r"""The exact maximum: how high the real edge touches a surface that may have many tangents, or none.

For the commanded tip at distance :math:`\rho` from the axis at azimuth :math:`\theta`, moving along Z only,

.. math:: Z(\rho, \theta) = \max_u \; [\, f(\rho + u, \theta) - e(u) \,]

a grey-scale dilation of the surface by the edge: free of gouges by construction, whatever the surface and the edge.

f - e is sampled along the edge well below the surface's `feature_size`; every sampled maximum that may be the greatest
within the sampling error is refined, on either side of each kink or step, and the greatest is taken. Points that share
an azimuth share one sampled line, so that this costs a few evaluations a point. The arc is enough where the surface is
nowhere steeper than the flanks. Where it is, or has a step, each point's window widens until no summit of the surface
reaches over its ends, also across the axis.

*The rim.* The nose hangs over the outermost turn. A surface with one tangent as far as the arc reaches from there is
continued so far; of any other nothing counts outside the rim, where a formula may run away, step or end and nothing is
to be left. Either rule is the same for all tips, so that neighbours agree, and neither lifts a tip off the part.

Sources
-------
Oracles: brute-force dilation, and closed forms on spheres.
"""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._kernels import dilation as kernel
from turnwright.errors import DomainError, GougeError, InputError
from turnwright.placing.breaks import Breaks, find_breaks, ground_of, heights_at
from turnwright.placing.tangent import CONCAVITY, Contact, Tips, Touch
from turnwright.progress import Progress, run_chunks
from turnwright.surface import Surface

__all__ = ["CHUNK", "search"]

SAMPLES_PER_FEATURE = 16
SAMPLES_PER_EDGE = 128
MOST_SAMPLES = 2_000_000
"""Samples of the tracks under the edge that are held at once."""
CHUNK = 8192
LONGEST = 20_000_000
"""Samples of one line or track beyond which a search is refused."""
WIDEST = 32
"""How far up the flanks a contact is looked for, in half widths of the arc, where the surface goes on without a rim."""


class _Candidates(NamedTuple):
    """Short intervals of the edge in which a point may have its contact. Each (n,)."""

    point: Ints
    start: Floats  # ends and a first guess, as distances from the tip [mm]
    stop: Floats
    guess: Floats

    def first(self, count: int) -> _Candidates:
        """Return so many of them, from the beginning."""
        return _Candidates(self.point[:count], self.start[:count], self.stop[:count], self.guess[:count])


class _Direct(NamedTuple):
    """What is known of each tip before any candidate is refined. Each (n,)."""

    height: Floats  # greatest f - e of those that stand exactly on a break [mm]
    at: Floats  # and where, from the tip [mm]
    ended: Bools  # whether the domain ends there
    narrow: Bools  # whether the edge may touch beyond the window, so that nothing else is known


class _Window(NamedTuple):
    """Which part of the edge is looked along, and how closely."""

    low: float  # from its tip [mm]
    high: float
    step: float
    top: float  # height that the surface reaches elsewhere, -inf where it is less steep than the flanks [mm]


class _Lines(NamedTuple):
    """Places where the surface is looked at: a row for each of some tips, and on it one or more places of the tip."""

    tips: Tips
    offsets: Ints  # row i holds the positions offsets[i] to offsets[i + 1]
    position: Floats  # of the tip, along its row [mm]
    u: Floats  # (rows, n) equally spaced, along each row [mm]


def search(contact: Contact, tips: Tips, out: Touch, progress: Progress | None) -> None:
    """Fill ``out`` by sampling along the edge and refining every maximum that may be the greatest.

    Points of one azimuth share one sampled line through the axis. Points that share nothing, or whose edge leaves the
    radial plane, get a sampled track under the edge each.
    """
    edge, count = contact.edge, tips.angle.size
    turn = _turn_length(tips.angle) if contact.upright else None
    width = edge.high_u - edge.low_u
    step = min(contact.feature / SAMPLES_PER_FEATURE, width / SAMPLES_PER_EDGE)
    ground = ground_of(contact.surface, contact.extent, radial=contact.upright)
    steep = ground.steepest * (1 + abs(edge.rake_sin)) >= CONCAVITY * contact.flank
    window = _Window(edge.low_u, edge.high_u, step, ground.top if steep else -np.inf)

    def lines(start: int, stop: int) -> None:
        points = np.arange(start, count, turn)[:, None] + np.arange(stop - start)
        points = np.minimum(points, count).T
        used = points < count
        _widen(contact, window, tips, points[used], np.nonzero(used)[0], out)

    def tracks(start: int, stop: int) -> None:
        _widen(contact, window, tips, np.arange(start, stop), None, out)

    samples = width / step
    if turn is not None:
        samples += (2 * contact.extent if steep else contact.farthest - contact.nearest) / step
    if samples > LONGEST:
        raise InputError(
            f"{type(contact.surface).__name__} has features of {contact.surface.feature_size:.3g} mm, which take "
            f"{samples:.3g} samples a line, the limit is {LONGEST:.3g}: state a larger feature_size, or cut the "
            "features in a part of their own"
        )
    if turn is not None:
        together = min(turn // 8, 4 * CHUNK * turn // count, int(MOST_SAMPLES / samples))
        run_chunks(lines, turn, max(1, together), progress)
    else:
        run_chunks(tracks, count, int(np.clip(MOST_SAMPLES // 4 * step / width, 1, CHUNK)), progress)


def _turn_length(angle: Floats) -> int | None:
    """Return the number of points a turn if every turn has the same azimuths, else ``None``."""
    n = int(np.searchsorted(np.abs(angle - angle[0]), 2 * np.pi - 1e-9))
    if n < 1 or n >= angle.size:
        return None
    lag = np.abs(angle[n:] - angle[:-n])
    return n if np.abs(lag - 2 * np.pi).max() < 1e-9 else None


def _widen(contact: Contact, window: _Window, tips: Tips, points: Ints, line: Ints | None, out: Touch) -> None:
    """Find the contacts of ``points`` on the arc, or further up the flanks where the arc does not touch.

    ``line`` says, ascending, which of them share an azimuth; ``None`` where none do.
    """
    waiting = [(points, line, window)]
    while waiting:
        some, line, window = waiting.pop()
        part, narrow = _bring_down(contact, window, tips.some(some), line)
        for target, values in zip(out, part, strict=True):
            target[some[~narrow]] = values[~narrow]
        if not narrow.any():
            continue
        some = some[narrow]
        if window.high > max(WIDEST * contact.edge.high_u, 4 * contact.extent):
            raise GougeError(
                f"with the tip {tips.radius[some[0]]:.6g} mm from the axis the surface stands above the edge "
                f"even {window.high:.3g} mm up its flanks: take a tool with a larger included angle, or a surface "
                "that does not run away outside the part"
            )
        window = window._replace(low=2 * window.low, high=2 * window.high)
        if line is not None:
            waiting.append((some, line[narrow], window))
            continue
        # A wider window takes more room: where every point has its own, fewer points at a time.
        wide = min(window.high - window.low, 2 * contact.extent) / window.step
        pieces = int(np.ceil(some.size * wide / (MOST_SAMPLES // 4)))
        waiting += [(piece, None, window) for piece in np.array_split(some, min(max(pieces, 1), some.size))]


def _bring_down(contact: Contact, window: _Window, tips: Tips, line: Ints | None) -> tuple[Touch, Bools]:
    """Find the contacts of points on lines, or (without) on tracks of their own, and which need a wider window."""
    edge, size = contact.edge, tips.angle.size
    whole = line is not None and window.top > -np.inf
    lines = _lines_under(contact, window, tips, line, whole=whole)
    x, y = np.empty(lines.u.shape), np.empty(lines.u.shape)
    kernel.places(edge, *lines.tips, lines.u, x, y)
    heights = heights_at(contact, x, y)
    breaks = find_breaks(contact, lines.tips, lines.u, x, y, heights)
    found, direct = _candidates(contact, window, lines, heights, breaks, -np.inf if whole else window.top)
    if not isinstance(found, _Candidates):
        _refuse_outside(contact.surface, tips, found)
    narrow, ended = direct.narrow, direct.ended
    best, z = np.zeros(size), np.zeros(size)
    if found.point.size or not narrow.all():
        top, sweep = _maxima(contact, tips.some(found.point), found)
        best = edge.sweeps(direct.at)
        z = direct.height - edge.dz
        kernel.keep_highest(found.point, top, sweep, z, best, ended)
    if not (np.isfinite(z) | narrow).all():
        k = int(np.argmin(np.isfinite(z) | narrow))
        raise GougeError(
            f"no place on the edge touches with the tip {tips.radius[k]:.6g} mm from the axis at azimuth "
            f"{np.rad2deg(tips.angle[k]) % 360:.4g} deg, the surface must be finite there: check the prescription"
        )
    part = Touch(z, best, *contact.under_edge(tips, best), z + edge.points(best)[2])
    ended &= ~narrow
    if ended.any():
        _judge_ends(contact, tips.some(ended), part.some(ended))
    return part, narrow


def _lines_under(contact: Contact, window: _Window, tips: Tips, line: Ints | None, *, whole: bool) -> _Lines:
    """Return places of tips on lines that they share, over all of the part with ``whole``, or each on its own track."""
    along = tips.radius + contact.edge.dx
    if line is None:
        rows, offsets, position = tips, np.arange(tips.angle.size + 1), np.zeros(tips.angle.size)
    else:
        # The line itself is the track of an edge whose tip stands on the axis.
        offsets = np.append(np.flatnonzero(np.diff(line, prepend=-1)), line.size)
        count, position = offsets.size - 1, along
        rows = Tips(tips.angle[offsets[:-1]], np.full(count, -contact.edge.dx), np.zeros(count))
    first, last = float(position.min()) + window.low, float(position.max()) + window.high
    if whole:
        first, last = min(first, -contact.extent), max(last, contact.extent)
    if contact.rim < np.inf:
        # Nothing counts outside the rim.
        centre = along if line is None else np.zeros(1)
        first = max(first, -contact.rim - float(centre.max()))
        last = min(last, contact.rim - float(centre.min()))
    # Not on the axis, nor on any other round place where a prescription may be special.
    step = window.step
    origin = first - 2.381966 * step
    samples = int(np.ceil((last - origin) / step)) + 4
    u = np.ascontiguousarray(np.broadcast_to(origin + step * np.arange(samples), (rows.angle.size, samples)))
    return _Lines(rows, offsets, position, u)


def _candidates(
    contact: Contact, window: _Window, lines: _Lines, heights: Floats, breaks: Breaks, elsewhere: float
) -> tuple[_Candidates | int, _Direct]:
    """Run the kernel of this name with as much room as it needs; an int is the tip that nothing is under."""
    count = lines.position.size
    direct = _Direct(np.empty(count), np.zeros(count), *np.empty((2, count), np.bool_))
    low, high = window.low, window.high
    whole = bool(contact.rim < np.inf and min(-low, high) > contact.rim + contact.farthest)
    size = 4 * count + 4 * heights.shape[1]
    while True:
        found = _Candidates(np.empty(size, dtype=np.int64), *np.empty((3, size)))
        answer = kernel.candidates(
            heights, float(lines.u[0, 0]), window.step, lines.offsets, lines.position, *breaks, contact.edge, low, high,
            elsewhere, whole, *found, *direct,
        )  # fmt: skip
        if answer >= 0:
            return found.first(answer), direct
        if answer <= kernel.OUTSIDE:
            return kernel.OUTSIDE - answer, direct
        size *= 4


def _maxima(contact: Contact, tips: Tips, found: _Candidates) -> tuple[Floats, Floats]:
    """Return the greatest f - e in each short smooth interval of the nose, and where it is."""
    edge = contact.edge
    begin, end, sweep = (edge.sweeps(u) for u in (found.start, found.stop, found.guess))
    best, place = np.full(sweep.size, -np.inf), sweep.copy()
    index = np.arange(sweep.size)
    state = np.stack([begin, end, begin, end, sweep])  # interval, bracket, where to look next
    done = np.zeros(sweep.size, dtype=np.bool_)
    left, b, p = tips, best, place
    for _ in range(100):
        x, y, value, first, top, step, bend = np.empty((7, done.size))
        kernel.under_edge(edge, *left, state[4], x, y)
        with np.errstate(all="ignore"):
            jet = contact.surface.evaluate(x, y, 2)
        kernel.newton_step(edge, left.angle, state[4], *jet, value, first, top, step, bend)
        kernel.bracket(*state, value, first, top, step, b, p, done)
        if done.all():
            best[index], place[index] = b, p
            break
        if 4 * np.count_nonzero(done) > done.size:
            best[index], place[index] = b, p
            keep = np.flatnonzero(~done)
            index, left, b, p = index[keep], left.some(keep), b[keep], p[keep]
            state, done = np.ascontiguousarray(state[:, keep]), done[keep]
    return best, place


def _judge_ends(contact: Contact, tips: Tips, at: Touch) -> None:
    """Refuse contacts at an end of the surface, unless it is the rim and the arc that touches."""
    inside = np.hypot(at.x, at.y) < contact.rim * (1 - 1e-9)
    if inside.any():
        _refuse_outside(contact.surface, tips, int(np.argmax(inside)))
    edge = contact.edge
    on_flank = np.flatnonzero((at.sweep < edge.low) | (at.sweep > edge.high))
    if not on_flank.size:
        return
    # A wall that the rim happens to cut is touched like any other; a surface that climbs all the way is not met.
    tips, sweep, lift = tips.some(on_flank), at.sweep[on_flank], []
    for part in np.linspace(0.0, 0.99, 9):
        place = np.clip(sweep, edge.low, edge.high) * (1 - part) + sweep * part
        lift.append(heights_at(contact, *contact.under_edge(tips, place)) - edge.points(place)[2])
    climbs = (np.diff(lift, axis=0) > 0).all(axis=0)
    if climbs.any():
        k = int(np.argmax(climbs))
        raise GougeError(
            f"with the tip {tips.radius[k]:.6g} mm from the axis at azimuth "
            f"{np.rad2deg(tips.angle[k]) % 360:.4g} deg a flank of the tool stands on the rim of the path, "
            f"{contact.rim:.6g} mm from the axis, where the surface is steeper than the flank: take a tool with a "
            "larger included angle, or reduce the clear radius or the lead-in"
        )


def _refuse_outside(surface: Surface, tips: Tips, which: int) -> NoReturn:
    raise DomainError(
        f"with the tip {tips.radius[which]:.6g} mm from the axis at azimuth "
        f"{np.rad2deg(tips.angle[which]) % 360:.4g} deg the edge touches where {type(surface).__name__} is not "
        f"defined, its domain is {surface.domain}: extend the surface, or reduce the clear radius or the lead-in"
    )
