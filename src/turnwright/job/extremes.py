r"""Find the highest and the lowest point of a cut surface over the whole clear aperture.

A grid hits the top of a cusp by chance, and never that of the cusp on the axis, the highest of an Archimedean spiral.
So the part is scanned across all revolutions, at azimuths that no program repeats, and with finer steps around the axis
and along the rim. From the best points of each zone the search climbs from revolution to revolution and from point to
point of the program, then refines the crossing of two passes. Errors by decimals and servos are scattered, without a
slope to climb, so that points of the program are tried as well. The surface has steps where the motion ends, and at the
edge of the core that a tool height error leaves uncut; both are searched along these lines.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.generation import Prepared, Tiles
from turnwright.heightmap import HeightMap
from turnwright.machine import Machine
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.progress import Progress, run_chunks
from turnwright.tool import Tool

__all__ = ["Extreme", "Extremes", "find_extremes", "top_of_zones"]

TURN = 2 * math.pi
NM = 1e6
GOLDEN = (math.sqrt(5) - 1) / 2

RADII_PER_FEED = 8
FEWEST_ANGLES, MOST_ANGLES = 72, 360
AZIMUTHS_PER_FEATURE = 4
SCAN_POINTS, SCAN_POINTS_OFF_PLANE = 500_000, 100_000
"""Most points of the scan, and of a scan with a tool that does not move in a plane through the axis."""

BAND_FEEDS = 3
"""Width in feeds of a band of radii where not all revolutions are scanned, and of the zones at axis and rim."""

ZONES = (6, 8)
"""Zones along the radius and around the axis, the search starts from the best point of each."""

OVERALL_STARTS = 24
MIN_PLACES_PER_THREAD = 2048
"""Points of a chunk of work; smaller chunks take less time than their overhead."""

STAGES = 6
"""Steps of progress: four scans and two searches."""

CLIMBERS, FINALISTS = 10, 4
CLIMBERS_OFF_PLANE, FINALISTS_OFF_PLANE = 4, 2
"""Points that the search climbs from and that it refines; off the plane each takes ten times as long."""

RADIAL_LOOKS = 17
"""Radii of one step of the search along a radius; the next step is between the neighbours of the highest."""

AZIMUTH_LOOKS = 5
"""Azimuths searched around one point, up to one step of the program on either side."""

COARSE_LOOKS, FINE_LOOKS = 4, 9
"""Steps of the search along a radius: to less than 0.1 % of the height of a cusp, and to 1e-8 of it."""

MIN_RADIUS_FEEDS = 1e-9
"""Least radius of a point off the axis, in feeds."""

POINTS_PER_CHUNK = 16_384
"""Points of the program of a chunk of work, whose arrays fit into the cache of a processor."""

PLACES_PER_LINE, MOST_POINTS = 4, 500_000
"""Points tried per line of the program, and most points tried."""

MAX_CRESTS, MAX_VALLEYS = 2000, 500
"""Most crossings tried at points of the program, and most points closest to the design that are refined."""

REFINEMENTS, REFINEMENT_STEPS = 16, 9
"""Steps of the search around the axis and azimuths of each; each step is a third as wide as the one before."""

HALVINGS = 50
MIN_ALONG_MM = 1e-8
"""Least distance of a point from the edge of the uncut core, along the pass. [mm]"""

ROUNDINGS = 64
"""Distance of a point from the radius where all passes end, in units of the rounding of a coordinate."""

END_OFFSET_MM = 1e-9
"""Lateral distance of a point from the end of a motion. [mm]"""

END_PLACES = 100
"""Number of these points on either side of the axis."""


class Extreme(NamedTuple):
    """A point on the part, and the error there. [mm]."""

    x: float
    y: float
    error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Extremes:
    """Points with the highest and the lowest cut minus design over the clear aperture. [mm]."""

    highest: Extreme
    lowest: Extreme

    @property
    def pv_nm(self) -> float:
        """Peak to valley. [nm]."""
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
    """Return the highest and the lowest error of a cut surface over the clear aperture, rim and axis included.

    ``None`` where no pass cuts the part. ``known`` is a polar map of the error: the result is at least as high and low.
    """
    search = _Search(motion, tool, part, machine)
    report = progress or (lambda _done, _total: None)
    report(0, STAGES)
    scans = search.scans(report)
    if known is not None:
        assert known.radius is not None  # noqa: S101 - the map is polar
        assert known.angle is not None  # noqa: S101
        shape = known.z.shape
        scans.append(
            _Places(np.broadcast_to(known.radius, shape), np.broadcast_to(known.angle[:, None], shape), known.z)
        )
    extremes = []
    for number, sign in enumerate((1.0, -1.0)):
        place = search.find_extreme(scans, sign)
        if place is None:
            return None
        extremes.append(place)
        report(STAGES - 1 + number, STAGES)
    return Extremes(highest=extremes[0], lowest=extremes[1])


def top_of_zones(values: Floats, zones: tuple[int, int]) -> list[int]:
    """Return the flat index of the highest value in each zone of a polar map, along the radius and around the axis."""
    rows, columns = (np.arange(size) for size in values.shape)
    tops = []
    for across in np.array_split(columns, min(zones[0], columns.size)):
        for around in np.array_split(rows, min(zones[1], rows.size)):
            row, column = divmod(int(np.argmax(values[np.ix_(around, across)])), across.size)
            tops.append(int(around[row] * columns.size + across[column]))
    return tops


class _Places(NamedTuple):
    """Points of a scan, one azimuth per row."""

    radius: Floats
    angle: Floats
    error: Floats


class _Tip(NamedTuple):
    """The tip of the tool at points of a motion. Each the same shape [rad, mm]."""

    c: Floats
    x: Floats
    y: Floats
    z: Floats


class _Search:
    def __init__(self, motion: Motion, tool: Tool, part: Part, machine: Machine | None) -> None:
        self.part = part
        self.on_axis = bool(part.covers(np.zeros(1), np.zeros(1))[0])
        self.ready = Prepared.of(motion, tool, machine, distances=(part.nearest, part.reach), most_rings=10_000)
        self.feed = min(self.ready.cut.feed, part.reach)
        turned = np.abs(np.diff(motion.axes["C"]))
        self.step = min(float(np.median(turned[turned > 0])) if turned.any() else TURN, TURN / FEWEST_ANGLES)
        self.upright = self.ready.cut.upright and self.ready.cut.edge.convex
        self.edge: _Places | None = None
        edge = self.ready.cut.edge
        self.uncut = 0.0
        if edge.rake_sin == 0 and edge.dy != 0 and self.ready.most_y == 0:
            # All passes end at one radius, and rounding decides which of them reach a point there.
            size = edge.radius + part.reach + float(np.abs(self.ready.cut.bounds[:2]).max())
            self.uncut = abs(edge.dy) + ROUNDINGS * np.finfo(float).eps * size

    def at(self, radius: Floats, angle: Floats) -> Floats:
        """Return the error at points, close together in each row; nan where no pass cuts. (n, m) [mm]."""
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        rows, columns = x.shape
        x, y = x.ravel(), y.ravel()
        tiles = Tiles(np.arange(rows + 1) * columns, np.arange(rows + 1))
        z = np.empty(x.size)
        run_chunks(
            lambda start, stop: self.ready.fill(x, y, tiles, (start, stop), z),
            rows,
            max(1, MIN_PLACES_PER_THREAD // columns),
        )
        z[(z >= 1e299) | (radius.ravel() < self.uncut)] = np.nan
        there = ~np.isnan(z)
        z[there] -= self.part.heights(x[there], y[there])
        return z.reshape(rows, columns)

    def scans(self, report: Progress) -> list[_Places]:
        """Return the error across all revolutions, around the axis and along the rim."""
        rim, feed = self.part.reach, self.feed
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
        if self.part.outline is not None:
            scans.append(self._scan_border())
        if self.on_axis and np.isnan(scans[0].error[:, 0]).any():
            self.edge = self.around_core(self._azimuths(FEWEST_ANGLES))
            scans.append(self.edge)
        return scans

    def _scan_border(self) -> _Places:
        """Return the error along the outline, and across the feeds next to it."""
        x, y = self.part.border.border(4 * MOST_ANGLES)
        radius, angle = np.hypot(x, y)[:, None], np.arctan2(y, x)[:, None]
        depth = np.linspace(-BAND_FEEDS, BAND_FEEDS, 2 * BAND_FEEDS * RADII_PER_FEED + 1) * self.feed
        radius = np.abs(radius + depth)
        angle = np.broadcast_to(angle, radius.shape)
        return _Places(radius, angle, self.at(radius, angle))

    def _bands(self, most: int) -> Floats:
        """Return radii across all revolutions, or across bands of them where they are too many. (n,) [mm]."""
        rim, feed = self.part.reach, self.feed
        low = self.part.nearest
        every = math.ceil((rim - low) / feed * RADII_PER_FEED) + 1
        if every <= most:
            return np.linspace(low, rim, every)
        width = BAND_FEEDS * RADII_PER_FEED
        bands = max(most // width, 2)
        starts = np.linspace(low, max(rim - BAND_FEEDS * feed, low), bands)
        return np.unique((starts[:, None] + np.arange(width) * feed / RADII_PER_FEED).ravel())

    def _scan(self, radius: Floats, count: int) -> _Places:
        angle = self._azimuths(count)
        error = self.part.form_error(self.ready.polar(radius, angle)).z
        shape = error.shape
        return _Places(np.broadcast_to(radius, shape), np.broadcast_to(angle[:, None], shape), error)

    def _azimuths(self, count: int) -> Floats:
        # No program has its points at these azimuths, so that points between them are scanned as well.
        each = np.arange(count)
        return (each + each * GOLDEN % 1) * (TURN / count)

    def core(self, angle: Floats) -> Floats:
        """Return the radius of the uncut core at azimuths. (n,) [mm]."""

        def uncut(radius: Floats) -> Bools:
            return np.isnan(self.at(radius[:, None], angle[:, None])[:, 0])

        if self.uncut:
            return np.full(angle.size, self.uncut)
        low, high = np.zeros(angle.size), np.full(angle.size, self.feed)
        while (within := uncut(high)).any() and high.max() < self.part.reach:
            low, high = np.where(within, high, low), np.where(within, np.minimum(2 * high, self.part.reach), high)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            within = uncut(middle)
            low, high = np.where(within, middle, low), np.where(within, high, middle)
        return high

    def around_core(self, angle: Floats) -> _Places:
        """Return the error along the edge of the uncut core, and with growing steps beyond it."""
        # A pass leaves the edge of the core at right angles to the radius.
        along = np.geomspace(MIN_ALONG_MM, self.feed, 3 * RADII_PER_FEED)
        radius = np.hypot(self.core(angle)[:, None], along)
        angle = np.broadcast_to(angle[:, None], radius.shape)
        return _Places(radius, angle, self.at(radius, angle))

    def of_program(self, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the best points that belong to points of the program, on crests or valleys. Each (n,).

        Decimals of the program and servos scatter them, so that no scan and no climb finds the best one. A valley is
        where the motion is closest to the design; a crest is where two passes cross, unless a third is lower there.
        """
        cut = self.ready.cut
        # Tips so far out that their edge does not reach the part are left out.
        reach = self.part.reach + max(-cut.edge.low_u, cut.edge.high_u) + self.feed
        near = np.flatnonzero(np.abs(cut.x[:-1] + cut.edge.dx) <= reach)
        if near.size == 0:
            return np.empty(0), np.empty(0), np.empty(0)
        if near.size * PLACES_PER_LINE <= MOST_POINTS:
            step = 1 / PLACES_PER_LINE
            line = (near[:, None] + step * np.arange(PLACES_PER_LINE)).ravel()
        else:
            step = math.ceil(near.size / MOST_POINTS)
            line = near[::step]
        radius, angle = self._valleys(line, step) if sign < 0 else self._crests(line)
        value = sign * self.at(radius[:, None], angle[:, None])[:, 0]
        there = ~np.isnan(value)
        return self._best(radius[there], angle[there], value[there], OVERALL_STARTS)

    def _tip(self, line: Floats) -> _Tip:
        """Return the tip at fractional indices of points of the program."""
        cut = self.ready.cut
        before = np.clip(line.astype(np.int64), 0, cut.c.size - 2)
        share = np.clip(line - before, 0.0, 1.0)

        def between(values: Floats) -> Floats:
            begin = values[before]
            return np.asarray(begin + share * (values[before + 1] - begin))

        y = between(cut.y) if cut.y.size else np.zeros(line.shape)
        c, x, z = between(cut.c), between(cut.x), between(cut.z)
        return _Tip(c, x + cut.edge.dx, y + cut.edge.dy, z + cut.edge.dz)

    def _contact(self, tip: _Tip, u: Floats) -> tuple[Floats, Floats, Floats]:
        """Return radius, azimuth and height of the point of the edge that is ``u`` from its tip."""
        edge = self.ready.cut.edge
        w = edge.profile(u.ravel())[0].reshape(u.shape)
        along, across = tip.x + u, tip.y + edge.rake_sin * w
        return np.hypot(along, across), tip.c + np.arctan2(across, along), tip.z + edge.rake_cos * w

    def _gap(self, tip: _Tip, u: Floats) -> tuple[Floats, Floats, Floats]:
        """Return radius, azimuth and error where the edge is ``u`` from its tip; infinite beyond the part."""
        radius, angle, error = self._contact(tip, u)
        inside = radius <= self.part.reach
        if self.part.outline is not None:
            inside &= self.part.covers(radius * np.cos(angle), radius * np.sin(angle))
        r, a = radius[inside], angle[inside]
        error[inside] -= self.part.surface.sag(r * np.cos(a), r * np.sin(a))
        error[~inside] = np.inf
        return radius, angle, error

    def _valleys(self, line: Floats, step: float) -> tuple[Floats, Floats]:
        """Return where the motion comes closest to the design. Each (n,)."""
        edge = self.ready.cut.edge

        def contacts(line: Floats) -> tuple[Floats, ...]:
            """Return the distance of the contact from the tip, its last change, and the error there."""
            tip, u, before = self._tip(line), np.zeros(line.size), np.zeros(line.size)
            cosine, sine = np.cos(tip.c), np.sin(tip.c)
            for _ in range(3):
                radius, angle, _ = self._contact(tip, u)
                radius = np.minimum(radius, self.part.reach)
                zx, zy = self.part.continuation.gradient(radius * np.cos(angle), radius * np.sin(angle))
                slope = (zx * cosine + zy * sine) / edge.rake_cos
                before, u = u, edge.radius * slope / np.sqrt(1 + slope**2)
            return u, np.abs(u - before), self._gap(tip, u)[2]

        u, change, error = _in_chunks(contacts, line)
        first = _least(error, MAX_VALLEYS)
        # At an edge of the design the slope jumps, and with it the contact on the tool.
        wide = change[first] + self.feed / RADII_PER_FEED
        line, u, each = line[first], u[first], np.arange(first.size)
        share = np.linspace(-1, 1, REFINEMENT_STEPS)
        for _ in range(RADII_PER_FEED):
            lines = np.clip(line[:, None, None] + step * share[:, None], 0, self.ready.cut.c.size - 1)
            places = u[:, None, None] + wide[:, None, None] * share
            lines, places = (one.reshape(each.size, -1) for one in np.broadcast_arrays(lines, places))
            top = self._gap(self._tip(lines), places)[2].argmin(axis=1)
            line, u, step, wide = lines[each, top], places[each, top], step / 2, wide / 2
        radius, angle, error = self._gap(self._tip(line), u)
        return radius[np.isfinite(error)], angle[np.isfinite(error)]

    def _crests(self, line: Floats) -> tuple[Floats, Floats]:
        """Return the highest crossings of successive passes at one azimuth. Each (n,)."""
        cut = self.ready.cut
        along, each = cut.sense * cut.c, np.arange(cut.c.size, dtype=np.float64)

        def crossings(line: Floats) -> tuple[Floats, ...]:
            tip, both = self._tip(line), []
            for other in (-TURN, TURN):
                there = cut.sense * tip.c + other
                inside = (there >= along[0]) & (there <= along[-1])
                next_tip = self._tip(np.interp(there[inside], along, each))
                both.append(self._crossing(_Tip(*(values[inside] for values in tip)), next_tip))
            return tuple(map(np.concatenate, zip(*both, strict=True)))

        radius, angle, error = _in_chunks(crossings, line)
        first = _least(-error, MAX_CRESTS)
        return radius[first], angle[first]

    def _crossing(self, tip: _Tip, other: _Tip) -> tuple[Floats, Floats, Floats]:
        """Return the crossings of two passes at one azimuth, and the error there. Each (n,)."""
        edge = self.ready.cut.edge
        (_, x, _, z), (_, x_next, _, z_next) = tip, other
        apart, low, high = x_next - x, np.minimum(x, x_next), np.maximum(x, x_next)
        at = (x + x_next) / 2 + edge.radius * (z_next - z) / np.where(apart == 0, np.inf, apart)
        for _ in range(4):
            at = np.clip(at, 3 * low - 2 * high, 3 * high - 2 * low)
            (w, slope), (w_next, slope_next) = edge.profile(at - x), edge.profile(at - x_next)
            rate = edge.rake_cos * (slope - slope_next)
            at = at - (z - z_next + edge.rake_cos * (w - w_next)) / np.where(rate == 0, np.inf, rate)
        radius, angle, error = self._gap(tip, at - x)
        inside = np.isfinite(error)
        return radius[inside], angle[inside], error[inside]

    def find_extreme(self, scans: list[_Places], sign: float) -> Extreme | None:
        """Return the highest point, or with a negative ``sign`` the lowest."""
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
        """Return the best points of each zone of a scan, and those overall. Each (n,)."""
        # At most one per azimuth and band of radii, otherwise all would be on one cusp.
        size = BAND_FEEDS * RADII_PER_FEED
        rows, columns = scan.error.shape
        cells = -(-columns // size)
        padded = np.full((rows, cells * size), -np.inf)
        value = np.multiply(scan.error, sign, out=padded[:, :columns])
        value[np.isnan(value)] = -np.inf
        chosen = top_of_zones(value, ZONES)
        cell = padded.reshape(-1, size)
        inside = cell.argmax(axis=1)
        tops = cell[np.arange(inside.size), inside]
        first = _least(-tops, OVERALL_STARTS)
        chosen += ((first // cells) * columns + (first % cells) * size + inside[first]).tolist()
        row, column = np.divmod(np.unique(chosen), columns)
        there = np.isfinite(value[row, column])
        row, column = row[there], column[there]
        return scan.radius[row, column], scan.angle[row, column], value[row, column]

    def _along(
        self, radius: Floats, angle: Floats, half: Floats | float, looks: int, sign: float
    ) -> tuple[Floats, Floats]:
        """Return the radius of the highest error within ``half`` of a point along its azimuth, and that error. (n,)."""
        # The axis itself, which takes as long as a thousand points, is part of the scans.
        least, rim = MIN_RADIUS_FEEDS * self.feed, self.part.reach
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
        """Return the highest points within a feed and a step of the program around points. Each (n,)."""
        share = np.linspace(-1, 1, AZIMUTH_LOOKS) * self.step
        angles = (angle[:, None] + share).ravel()
        best, value = self._along(np.repeat(radius, AZIMUTH_LOOKS), angles, 0.75 * self.feed, COARSE_LOOKS, sign)
        shape = (radius.size, AZIMUTH_LOOKS)
        top = value.reshape(shape).argmax(axis=1)
        each = np.arange(radius.size) * AZIMUTH_LOOKS + top
        return best[each], angles[each], value[each]

    def _climb(self, radius: Floats, angle: Floats, best: Floats, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the points after climbing from pass to pass and from azimuth to azimuth. Each (n,)."""
        rim = self.part.reach
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
        """Return the refined highest points next to points. Each (n,)."""
        widest = 0.75 * self.feed
        half, reach = np.full(radius.size, self.step), np.full(radius.size, widest)
        share = np.linspace(-1, 1, REFINEMENT_STEPS)
        for _ in range(REFINEMENTS):
            angles = angle[:, None] + half[:, None] * share
            # A narrower range needs fewer steps for the same resolution.
            looks = max(FINE_LOOKS - int(math.log(widest / reach.max(), (RADIAL_LOOKS - 1) / 2)), COARSE_LOOKS)
            every = (np.repeat(radius, REFINEMENT_STEPS), angles.ravel(), np.repeat(reach, REFINEMENT_STEPS))
            near, value = (one.reshape(angles.shape) for one in self._along(*every, looks, sign))
            radius, angle, best = _higher(radius, angle, best, near, angles, value)
            # The range along the radius by which the highest point moves between azimuths.
            reach = np.clip(np.ptp(near, axis=1), reach / 3, widest)
            half = half / 3
        return radius, angle, best

    def _search_core(self, sign: float) -> tuple[float, float, float]:
        """Return the highest point next to the uncut core: error, radius and azimuth.

        The ends of successive passes can be closer there than a search along a fixed radius resolves.
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
        """Return the highest points next to the ends of a motion at the axis: error, radius and azimuth.

        The surface has a step there, and is highest on one side of it.
        """
        cut, candidates = self.ready.cut, []
        edge = cut.edge
        outward = np.geomspace(MIN_ALONG_MM, min(BAND_FEEDS * self.feed, 0.999 * self.part.reach), END_PLACES)
        for end in (0, -1):
            y = edge.dy + (cut.y[end] if cut.y.size else 0.0)
            for side in (-END_OFFSET_MM, END_OFFSET_MM):
                along = np.concatenate([-outward[::-1], outward])
                for _ in range(FINE_LOOKS + 1):
                    w, _ = edge.profile(along - cut.x[end] - edge.dx)
                    across = y + edge.rake_sin * w + side
                    radius, angle = np.hypot(along, across), cut.c[end] + np.arctan2(across, along)
                    error = sign * self.at(radius[:, None], angle[:, None])[:, 0]
                    error = np.where(np.isnan(error) | (radius > self.part.reach), -np.inf, error)
                    top = int(np.argmax(error))
                    candidates.append((float(error[top]), float(radius[top]), float(angle[top])))
                    along = np.linspace(along[max(top - 1, 0)], along[min(top + 1, along.size - 1)], RADIAL_LOOKS)
        return candidates

    def _best(self, radius: Floats, angle: Floats, best: Floats, count: int) -> tuple[Floats, Floats, Floats]:
        """Return the best points, one of each group of close ones."""
        order = np.argsort(-best, kind="stable")
        cell = np.stack([radius[order] / (self.feed / 2), angle[order] % TURN / self.step]).round()
        order = order[np.sort(np.unique(cell, axis=1, return_index=True)[1])[:count]]
        return radius[order], angle[order], best[order]


def _in_chunks(work: Callable[[Floats], tuple[Floats, ...]], line: Floats) -> tuple[Floats, ...]:
    """Return what a function returns for points of the program, a chunk at a time, joined. Each (n,)."""
    results: dict[int, tuple[Floats, ...]] = {}

    def fill(start: int, stop: int) -> None:
        results[start] = work(line[start:stop])

    run_chunks(fill, line.size, POINTS_PER_CHUNK)
    return tuple(map(np.concatenate, zip(*(results[start] for start in sorted(results)), strict=True)))


def _least(values: Floats, count: int) -> Ints:
    """Return the indices of the least values, in any order. (n,)."""
    return np.argpartition(values, count)[:count] if values.size > count else np.arange(values.size)


def _higher(
    radius: Floats, angle: Floats, best: Floats, radii: Floats, angles: Floats, values: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return each point (n,), or the highest of its candidates (n, k) where that is higher, with its value."""
    each, top = np.arange(radius.size), values.argmax(axis=1)
    highest = values[each, top]
    better = highest > best
    return (
        np.where(better, radii[each, top], radius),
        np.where(better, angles[each, top], angle),
        np.where(better, highest, best),
    )
