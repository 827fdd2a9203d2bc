r"""The highest and the lowest place of what a motion leaves, over the whole clear aperture.

A grid meets the top of a cusp by chance, and the cusp on the axis, which an Archimedean spiral leaves highest, never.
So the part is scanned across all passes, at azimuths that no program repeats, and more closely about the axis and along
the rim; from the best places of each zone the search climbs from pass to pass and from point to point of the program,
and closes in on the crossing of the edges. What decimals and servos scatter has no slope to climb: there the points of
the program are tried themselves. The surface leaps where the motion ends, and passes end one after the other at the
edge of what a tool off centre leaves uncut; both are find_extreme along their own lines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright.generation import Prepared, Tiles, generate_polar
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats
    from turnwright.heightmap import HeightMap
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Motion
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = ["Extreme", "Extremes", "find_extremes"]

TURN = 2 * math.pi
NM = 1e6
GOLDEN = (math.sqrt(5) - 1) / 2

RADII_PER_FEED = 8
"""Radii of the scan from pass to pass."""

FEWEST_ANGLES, MOST_ANGLES = 72, 360
"""Azimuths of the scan."""

AZIMUTHS_PER_FEATURE = 4
"""Azimuths to a feature of the surface at the rim, if they are not too many."""

SCAN_POINTS, SCAN_POINTS_OFF_PLANE = 500_000, 100_000
"""Places of the scan at most; of a tool that does not move in the plane through the axis."""

BAND_FEEDS = 3
"""Feeds that a band of radii is wide where not all passes are scanned, and how far from axis and rim all are."""

ZONES = (6, 8)
"""Zones along the radius and around the axis, from each of which the best place is find_extreme."""

OVERALL_STARTS = 24
"""Best places of all that are find_extreme too."""

MIN_PLACES_PER_THREAD = 2048
"""Places that a thread looks at before it takes more: fewer cost less time than to begin a thread."""

STAGES = 6
"""Steps of progress: four scans and two searches."""

CLIMBERS, FINALISTS = 10, 4
"""Places that the search climbs from, and closes in on."""

CLIMBERS_OFF_PLANE, FINALISTS_OFF_PLANE = 4, 2
"""The same of a tool that does not move in the plane through the axis, whose places cost ten times as much."""

RADIAL_LOOKS = 17
"""Radii that a crossing is looked for among; the next look is between two of the neighbours of the highest."""

AZIMUTH_LOOKS = 5
"""Azimuths of a look at one place, from point to point of the program."""

COARSE_LOOKS, FINE_LOOKS = 4, 9
"""Looks along a radius: a cusp to less than 0.1 % of its height, and to 1e-8 of it."""

MIN_RADIUS_FEEDS = 1e-9
"""Least distance from the axis of a place beside it, in feeds."""

PLACES_PER_LINE, MOST_POINTS = 4, 500_000
"""Places of the program to a line of it, and places of the program at most."""

MAX_CRESTS, MAX_VALLEYS = 2000, 500
"""Crossings at points of the program that are tried, and places closest to the design that are looked at closely."""

REFINEMENTS, REFINEMENT_STEPS = 16, 9
"""Looks around the axis and their azimuths; each look is a third as wide as the one before it."""

HALVINGS = 50
"""How often the distance from the axis is halved within which no pass cuts."""

MIN_ALONG_MM = 1e-8
"""How close a look comes to the edge of what no pass cuts, along the pass. [mm]"""

ROUNDINGS = 64
"""How many roundings of its place a look keeps away from where all passes end."""

END_OFFSET_MM = 1e-9
"""How far beside the place where a motion begins or ends a look is. [mm]"""

END_PLACES = 100
"""Places of such a look on either side of the axis."""


class Extreme(NamedTuple):
    """A place on the part, and the error there."""

    x: float
    y: float
    error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Extremes:
    """Where the error of a part is highest and lowest over the clear aperture.

    Parameters
    ----------
    highest, lowest
        Place and cut minus design. [mm]
    """

    highest: Extreme
    lowest: Extreme

    @property
    def pv_nm(self) -> float:
        """Peak to valley."""
        return (self.highest.error - self.lowest.error) * NM


def find_extremes(
    motion: Motion,
    tool: Tool,
    part: Part,
    *,
    machine: Machine | None = None,
    known: HeightMap | None = None,
    progress: Progress | None = None,
) -> Extremes | None:
    """Return the highest and the lowest error that a motion leaves within the clear radius, rim and axis included.

    Parameters
    ----------
    motion
        As the axes move.
    tool
        The actual tool.
    part
        The design, and its clear radius.
    machine
        The actual machine; that of the motion if not given.
    known
        Polar map of the error that is there already: the answer is at least what it shows.
    progress
        Called with (done, total).

    Returns
    -------
    Extremes
        ``None`` where no pass covers any place.
    """
    search = _Search(motion, tool, part, machine)
    report = progress or (lambda _done, _total: None)
    report(0, STAGES)
    scans = search.scans(report)
    if known is not None:
        x, y = known.points()
        scans.append(_Places(np.hypot(x, y), np.arctan2(y, x), known.z))
    extremes = []
    for number, sign in enumerate((1.0, -1.0)):
        place = search.find_extreme(scans, sign)
        if place is None:
            return None
        extremes.append(place)
        report(STAGES - 1 + number, STAGES)
    return Extremes(highest=extremes[0], lowest=extremes[1])


class _Places(NamedTuple):
    """Places of a scan, one azimuth a row."""

    radius: Floats
    angle: Floats
    error: Floats


class _Search:
    """The error anywhere on a part."""

    def __init__(self, motion: Motion, tool: Tool, part: Part, machine: Machine | None) -> None:
        self.motion, self.tool, self.part, self.machine = motion, tool, part, machine
        self.ready = Prepared.of(motion, tool, machine, distances=(0.0, part.radius), most_rings=10_000)
        self.feed = min(self.ready.cut.feed, part.radius)
        turned = np.abs(np.diff(motion.axes["C"]))
        self.step = min(float(np.median(turned[turned > 0])) if turned.any() else TURN, TURN / FEWEST_ANGLES)
        self.upright = self.ready.cut.upright and self.ready.cut.edge.convex
        self.edge: _Places | None = None
        edge = self.ready.cut.edge
        self.uncut = 0.0
        if edge.rake_sin == 0 and edge.dy != 0 and self.ready.most_y == 0:
            # All passes end at one distance from the axis, and there rounding decides which of them reach a place.
            size = edge.radius + part.radius + float(np.abs(self.ready.cut.bounds[:2]).max())
            self.uncut = abs(edge.dy) + ROUNDINGS * np.finfo(float).eps * size

    def at(self, radius: Floats, angle: Floats) -> Floats:
        """Return the error at places, those of a row near each other; nan where no pass is. (n, m) [mm]."""
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        rows, columns = x.shape
        x, y = x.ravel(), y.ravel()
        tiles = Tiles(np.arange(x.size), np.arange(rows + 1) * columns, np.arange(rows + 1))
        z = np.empty(x.size)
        run_chunks(
            lambda start, stop: self.ready.fill(x, y, tiles, (start, stop), z),
            rows,
            max(1, MIN_PLACES_PER_THREAD // columns),
        )
        z[(z >= 1e299) | (radius.ravel() < self.uncut)] = np.nan
        there = ~np.isnan(z)
        z[there] -= self.part.surface.sag(x[there], y[there])
        return z.reshape(rows, columns)

    def scans(self, report: Progress) -> list[_Places]:
        """Return the error across all passes, about the axis and along the rim."""
        rim, feed = self.part.radius, self.feed
        features = TURN * rim / self.part.surface.feature_size * AZIMUTHS_PER_FEATURE
        angles = int(np.clip(math.ceil(features), FEWEST_ANGLES, MOST_ANGLES))
        most = SCAN_POINTS if self.upright else SCAN_POINTS_OFF_PLANE
        near = min(BAND_FEEDS * feed, rim)
        fine = 3 * RADII_PER_FEED * BAND_FEEDS if self.upright else RADII_PER_FEED * BAND_FEEDS
        scans = []
        for number, (radius, count) in enumerate(
            (
                (self._bands(most // angles), angles),
                (np.linspace(0, near, fine + 1), MOST_ANGLES if self.upright else FEWEST_ANGLES),
                (np.linspace(rim - near, rim, RADII_PER_FEED * BAND_FEEDS + 1), MOST_ANGLES),
                (np.array([rim]), 4 * MOST_ANGLES),
            )
        ):
            scans.append(self._scan(radius, count))
            report(1 + number, STAGES)
        if np.isnan(scans[0].error[:, 0]).any():
            self.edge = self.around_core(self._azimuths(FEWEST_ANGLES))
            scans.append(self.edge)
        return scans

    def _bands(self, most: int) -> Floats:
        """Return radii across all passes, or where these are too many across bands of them. (n,) [mm]."""
        rim, feed = self.part.radius, self.feed
        every = math.ceil(rim / feed * RADII_PER_FEED) + 1
        if every <= most:
            return np.linspace(0, rim, every)
        width = BAND_FEEDS * RADII_PER_FEED
        bands = max(most // width, 2)
        starts = np.linspace(0, rim - BAND_FEEDS * feed, bands)
        return np.unique((starts[:, None] + np.arange(width) * feed / RADII_PER_FEED).ravel())

    def _scan(self, radius: Floats, count: int) -> _Places:
        angle = self._azimuths(count)
        made = generate_polar(self.motion, self.tool, radius=radius, angle=angle, machine=self.machine)
        error = made.minus(self.part.surface).z
        shape = error.shape
        return _Places(np.broadcast_to(radius, shape), np.broadcast_to(angle[:, None], shape), error)

    def _azimuths(self, count: int) -> Floats:
        # No program has its points at such azimuths, so that places between its points are met as well.
        each = np.arange(count)
        return (each + each * GOLDEN % 1) * (TURN / count)

    def core(self, angle: Floats) -> Floats:
        """Return how far from the axis the part is cut first at azimuths. (n,) [mm]."""

        def uncut(radius: Floats) -> Bools:
            return np.isnan(self.at(radius[:, None], angle[:, None])[:, 0])

        if self.uncut:
            return np.full(angle.size, self.uncut)
        low, high = np.zeros(angle.size), np.full(angle.size, self.feed)
        while (within := uncut(high)).any() and high.max() < self.part.radius:
            low, high = np.where(within, high, low), np.where(within, np.minimum(2 * high, self.part.radius), high)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            within = uncut(middle)
            low, high = np.where(within, middle, low), np.where(within, high, middle)
        return high

    def around_core(self, angle: Floats) -> _Places:
        """Return the error along the edge of what no pass cuts about the axis, and ever more sparsely beyond it."""
        # A pass leaves the edge of the core at right angles to the radius.
        along = np.geomspace(MIN_ALONG_MM, self.feed, 3 * RADII_PER_FEED)
        radius = np.hypot(self.core(angle)[:, None], along)
        angle = np.broadcast_to(angle[:, None], radius.shape)
        return _Places(radius, angle, self.at(radius, angle))

    def of_program(self, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the best of the places that the points of the program leave: bends of a crest or a valley. Each (n,).

        Decimals of a program, and servos, scatter them, so that no scan and no climb finds the best one. A valley is as
        deep as the motion comes close to the design; a crest is where two passes cross, unless a third is lower there.
        """
        size = self.ready.cut.c.size
        step = 1 / PLACES_PER_LINE if size * PLACES_PER_LINE <= MOST_POINTS else math.ceil(size / MOST_POINTS)
        line = np.arange(0, size - 1, step)
        radius, angle = self._valleys(line, step) if sign < 0 else self._crests(line)
        value = sign * self.at(radius[:, None], angle[:, None])[:, 0]
        there = ~np.isnan(value)
        return self._best(radius[there], angle[there], value[there], OVERALL_STARTS)

    def _tip(self, line: Floats) -> tuple[Floats, ...]:
        """Return C, X, Y and Z of the tip at whole and broken numbers of points of the program."""
        cut = self.ready.cut
        each = np.arange(cut.c.size)
        y = np.interp(line, each, cut.y) if cut.y.size else np.zeros(line.shape)
        c, x, z = (np.interp(line, each, one) for one in (cut.c, cut.x, cut.z))
        return c, x + cut.edge.dx, y + cut.edge.dy, z + cut.edge.dz

    def _gap(self, line: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
        """Return radius, azimuth and error where the edge is ``u`` from its tip; infinite beyond the part."""
        c, x, y, z = self._tip(line)
        edge = self.ready.cut.edge
        w = edge.profile(u.ravel())[0].reshape(u.shape)
        along, across = x + u, y + edge.rake_sin * w
        radius, angle = np.hypot(along, across), c + np.arctan2(across, along)
        error = z + edge.rake_cos * w
        inside = radius <= self.part.radius
        r, a = radius[inside], angle[inside]
        error[inside] -= self.part.surface.sag(r * np.cos(a), r * np.sin(a))
        error[~inside] = np.inf
        return radius, angle, error

    def _valleys(self, line: Floats, step: float) -> tuple[Floats, Floats]:
        """Return where the motion comes closest to the design. Each (n,)."""
        c, edge, u, before = self._tip(line)[0], self.ready.cut.edge, np.zeros(line.size), np.zeros(line.size)
        for _ in range(3):
            radius, angle, _ = self._gap(line, u)
            radius = np.minimum(radius, self.part.radius)
            zx, zy = self.part.surface.gradient(radius * np.cos(angle), radius * np.sin(angle))
            slope = (zx * np.cos(c) + zy * np.sin(c)) / edge.rake_cos
            before, u = u, edge.radius * slope / np.sqrt(1 + slope**2)
        first = np.argsort(self._gap(line, u)[2])[:MAX_VALLEYS]
        # Over an edge of the design the slope leaps, and with it the place on the edge.
        wide = np.abs(u - before)[first] + self.feed / RADII_PER_FEED
        line, u, each = line[first], u[first], np.arange(first.size)
        share = np.linspace(-1, 1, REFINEMENT_STEPS)
        for _ in range(RADII_PER_FEED):
            lines = np.clip(line[:, None, None] + step * share[:, None], 0, self.ready.cut.c.size - 1)
            places = u[:, None, None] + wide[:, None, None] * share
            lines, places = (one.reshape(each.size, -1) for one in np.broadcast_arrays(lines, places))
            top = self._gap(lines, places)[2].argmin(axis=1)
            line, u, step, wide = lines[each, top], places[each, top], step / 2, wide / 2
        radius, angle, error = self._gap(line, u)
        return radius[np.isfinite(error)], angle[np.isfinite(error)]

    def _crests(self, line: Floats) -> tuple[Floats, Floats]:
        """Return where passes over one azimuth cross highest. Each (n,)."""
        cut = self.ready.cut
        along, each = cut.sense * cut.c, np.arange(cut.c.size)
        crossings = []
        for other in (-TURN, TURN):
            there = cut.sense * self._tip(line)[0] + other
            inside = (there >= along[0]) & (there <= along[-1])
            crossings.append(self._crossing(line[inside], np.interp(there[inside], along, each)))
        radius, angle, error = (np.concatenate(one) for one in zip(*crossings, strict=True))
        first = np.argsort(-error)[:MAX_CRESTS]
        return radius[first], angle[first]

    def _crossing(self, line: Floats, other: Floats) -> tuple[Floats, Floats, Floats]:
        """Return where two passes over one azimuth cross, and the error there. Each (n,)."""
        edge = self.ready.cut.edge
        (_, x, _, z), (_, x_next, _, z_next) = self._tip(line), self._tip(other)
        apart, low, high = x_next - x, np.minimum(x, x_next), np.maximum(x, x_next)
        at = (x + x_next) / 2 + edge.radius * (z_next - z) / np.where(apart == 0, np.inf, apart)
        for _ in range(4):
            at = np.clip(at, 3 * low - 2 * high, 3 * high - 2 * low)
            (w, slope), (w_next, slope_next) = edge.profile(at - x), edge.profile(at - x_next)
            rate = edge.rake_cos * (slope - slope_next)
            at = at - (z - z_next + edge.rake_cos * (w - w_next)) / np.where(rate == 0, np.inf, rate)
        radius, angle, error = self._gap(line, at - x)
        inside = np.isfinite(error)
        return radius[inside], angle[inside], error[inside]

    def find_extreme(self, scans: list[_Places], sign: float) -> Extreme | None:
        """Return the highest place, or with a negative ``sign`` the lowest."""
        starts = [self._starts(one, sign) for one in scans]
        starts.append(self.of_program(sign))
        radius, angle, best = (np.concatenate(one) for one in zip(*starts, strict=True))
        if best.size == 0:
            return None
        top = int(np.argmax(best))
        best_start = (float(best[top]), float(radius[top]), float(angle[top]))
        order = np.unique(np.stack([radius, angle]), axis=1, return_index=True)[1]
        radius, angle, best = self._refine(radius[order], angle[order], sign)
        climbers, finalists = (CLIMBERS, FINALISTS) if self.upright else (CLIMBERS_OFF_PLANE, FINALISTS_OFF_PLANE)
        radius, angle, best = self._climb(*self._best(radius, angle, best, climbers), sign)
        radius, angle, best = self._polish(*self._best(radius, angle, best, finalists), sign)
        top = int(np.argmax(best))
        highest = (float(best[top]), float(radius[top]), float(angle[top]))
        value, r, a = max(best_start, highest, self._search_core(sign), *self._search_ends(sign))
        return Extreme(r * math.cos(a), r * math.sin(a), sign * value)

    def _starts(self, scan: _Places, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the best places of all zones of a scan, and of all. Each (n,)."""
        value = np.where(np.isnan(scan.error), -np.inf, sign * scan.error)
        rows, columns = value.shape
        chosen = []
        for across in np.array_split(np.arange(columns), min(ZONES[0], columns)):
            for around in np.array_split(np.arange(rows), min(ZONES[1], rows)):
                zone = value[around[0] : around[-1] + 1, across[0] : across[-1] + 1]
                i, j = divmod(int(np.argmax(zone)), zone.shape[1])
                chosen.append((around[0] + i) * columns + across[0] + j)
        flat = value.ravel()
        # One of each azimuth and of each band of radii, or all would lie on one cusp.
        size = BAND_FEEDS * RADII_PER_FEED
        cells = -(-columns // size)
        padded = np.full((rows, cells * size), -np.inf)
        padded[:, :columns] = value
        cell = padded.reshape(rows, cells, size)
        inside = cell.argmax(axis=2)
        tops = cell.max(axis=2).ravel()
        first = np.argpartition(-tops, min(OVERALL_STARTS, tops.size - 1))[:OVERALL_STARTS]
        chosen += ((first // cells) * columns + (first % cells) * size + inside.ravel()[first]).tolist()
        at = np.unique(chosen)
        at = at[np.isfinite(flat[at])]
        return scan.radius.ravel()[at], scan.angle.ravel()[at], flat[at]

    def _along(
        self, radius: Floats, angle: Floats, half: Floats | float, looks: int, sign: float
    ) -> tuple[Floats, Floats]:
        """Return where along each radius, within ``half`` of a place, the error is highest, and how high. (n,)."""
        # The axis itself, which has no azimuth and costs as much as a thousand places, is in the scans.
        least, rim = MIN_RADIUS_FEEDS * self.feed, self.part.radius
        share = np.linspace(-1, 1, RADIAL_LOOKS)
        best, value = radius, np.full(radius.size, -np.inf)
        half = np.broadcast_to(half, radius.shape)[:, None]
        for _ in range(looks):
            at = np.clip(best[:, None] + half * share, least, rim)
            errors = sign * self.at(at, np.broadcast_to(angle[:, None], at.shape))
            errors = np.where(np.isnan(errors), -np.inf, errors)
            top = errors.argmax(axis=1)
            each = np.arange(top.size)
            better = errors[each, top] > value
            best = np.where(better, at[each, top], best)
            value = np.where(better, errors[each, top], value)
            half = half * 2 / (RADIAL_LOOKS - 1)
        return best, value

    def _refine(self, radius: Floats, angle: Floats, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the highest within a feed and a step of the program around places. Each (n,)."""
        share = np.linspace(-1, 1, AZIMUTH_LOOKS) * self.step
        angles = (angle[:, None] + share).ravel()
        best, value = self._along(np.repeat(radius, AZIMUTH_LOOKS), angles, 0.75 * self.feed, COARSE_LOOKS, sign)
        shape = (radius.size, AZIMUTH_LOOKS)
        top = value.reshape(shape).argmax(axis=1)
        each = np.arange(radius.size) * AZIMUTH_LOOKS + top
        return best[each], angles[each], value[each]

    def _climb(self, radius: Floats, angle: Floats, best: Floats, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return where the places come when they climb from pass to pass and from azimuth to azimuth. Each (n,)."""
        rim = self.part.radius
        ways = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j], dtype=np.float64)
        along, around = rim / ZONES[0] / 2, TURN / FEWEST_ANGLES
        while along > self.feed / 2 or around > self.step / 2:
            r = np.clip(radius[:, None] + along * ways[:, 0], 0.0, rim)
            a = angle[:, None] + around * ways[:, 1]
            near, turned, value = (one.reshape(r.shape) for one in self._refine(r.ravel(), a.ravel(), sign))
            radius, angle, best = _higher(radius, angle, best, near, turned, value)
            along, around = max(along / 2, self.feed / 3), max(around / 2, self.step / 3)
        return radius, angle, best

    def _polish(self, radius: Floats, angle: Floats, best: Floats, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the very tops next to places. Each (n,)."""
        widest = 0.75 * self.feed
        half, reach = np.full(radius.size, self.step), np.full(radius.size, widest)
        share = np.linspace(-1, 1, REFINEMENT_STEPS)
        for _ in range(REFINEMENTS):
            angles = angle[:, None] + half[:, None] * share
            # A narrower look needs fewer of the finer ones to end as fine.
            looks = max(FINE_LOOKS - int(math.log(widest / reach.max(), (RADIAL_LOOKS - 1) / 2)), COARSE_LOOKS)
            every = (np.repeat(radius, REFINEMENT_STEPS), angles.ravel(), np.repeat(reach, REFINEMENT_STEPS))
            near, value = (one.reshape(angles.shape) for one in self._along(*every, looks, sign))
            radius, angle, best = _higher(radius, angle, best, near, angles, value)
            # As far as the top moves along the radius from azimuth to azimuth.
            reach = np.clip(np.ptp(near, axis=1), reach / 3, widest)
            half = half / 3
        return radius, angle, best

    def _search_core(self, sign: float) -> tuple[float, float, float]:
        """Return the highest about what no pass cuts around the axis: error, radius and azimuth.

        Passes end there one after the other, some of them within less than a look along a fixed radius resolves.
        """
        best = (-math.inf, 0.0, 0.0)
        if self.edge is None:
            return best
        highest = np.where(np.isnan(self.edge.error), -math.inf, sign * self.edge.error).max(axis=1)
        for start in np.argsort(-highest)[:FINALISTS_OFF_PLANE]:
            middle, half = float(self.edge.angle[start, 0]), TURN / FEWEST_ANGLES
            for _ in range(REFINEMENTS):
                near = self.around_core(middle + half * np.linspace(-1, 1, REFINEMENT_STEPS))
                error = np.where(np.isnan(near.error), -math.inf, sign * near.error)
                i, j = np.unravel_index(error.argmax(), error.shape)
                best = max(best, (float(error[i, j]), float(near.radius[i, j]), float(near.angle[i, j])))
                middle, half = float(near.angle[i, 0]), half / 3
        return best

    def _search_ends(self, sign: float) -> list[tuple[float, float, float]]:
        """Return the highest next to the edge where a motion begins and ends at the axis: error, radius and azimuth.

        There the surface leaps, and it is highest on one side of the leap.
        """
        cut, candidates = self.ready.cut, []
        edge = cut.edge
        outward = np.geomspace(MIN_ALONG_MM, min(BAND_FEEDS * self.feed, 0.999 * self.part.radius), END_PLACES)
        for end in (0, -1):
            y = edge.dy + (cut.y[end] if cut.y.size else 0.0)
            for side in (-END_OFFSET_MM, END_OFFSET_MM):
                along = np.concatenate([-outward[::-1], outward])
                for _ in range(FINE_LOOKS + 1):
                    w, _ = edge.profile(along - cut.x[end] - edge.dx)
                    across = y + edge.rake_sin * w + side
                    radius, angle = np.hypot(along, across), cut.c[end] + np.arctan2(across, along)
                    error = sign * self.at(radius[:, None], angle[:, None])[:, 0]
                    error = np.where(np.isnan(error) | (radius > self.part.radius), -np.inf, error)
                    top = int(np.argmax(error))
                    candidates.append((float(error[top]), float(radius[top]), float(angle[top])))
                    along = np.linspace(along[max(top - 1, 0)], along[min(top + 1, along.size - 1)], RADIAL_LOOKS)
        return candidates

    def _best(self, radius: Floats, angle: Floats, best: Floats, count: int) -> tuple[Floats, Floats, Floats]:
        """Return the best of places, one of those that lie together."""
        order = np.argsort(-best, kind="stable")
        cell = np.stack([radius[order] / (self.feed / 2), angle[order] % TURN / self.step]).round()
        order = order[np.sort(np.unique(cell, axis=1, return_index=True)[1])[:count]]
        return radius[order], angle[order], best[order]


def _higher(
    radius: Floats, angle: Floats, best: Floats, radii: Floats, angles: Floats, values: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return each place (n,), or the highest of its looks (n, k) where that is higher, with its value."""
    each, top = np.arange(radius.size), values.argmax(axis=1)
    highest = values[each, top]
    better = highest > best
    return (
        np.where(better, radii[each, top], radius),
        np.where(better, angles[each, top], angle),
        np.where(better, highest, best),
    )
