r"""The highest and the lowest place of what a motion leaves, over the whole clear aperture.

A grid meets the top of a cusp by chance, and the cusp on the axis, which an Archimedean spiral leaves highest, never.
So the part is scanned across all passes, at azimuths that no program repeats, and more closely about the axis and along
the rim; from the best places of each zone the search climbs from pass to pass and from point to point of the program,
and closes in on the crossing of the edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright.generation import Prepared, Tiles, generate_polar
from turnwright.progress import run_chunks

if TYPE_CHECKING:
    from turnwright._arrays import Floats
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

PER_FEED = 8
"""Radii of the scan from pass to pass."""

FEWEST_ANGLES, MOST_ANGLES = 72, 360
"""Azimuths of the scan."""

PER_FEATURE = 4
"""Azimuths to a feature of the surface at the rim, if they are not too many."""

SCAN, SCAN_ASIDE = 500_000, 100_000
"""Places of the scan at most; of a tool that does not move in the plane through the axis."""

BAND = 3
"""Feeds that a band of radii is wide where not all passes are scanned, and how far from axis and rim all are."""

ZONES = (6, 8)
"""Zones along the radius and around the axis, from each of which the best place is followed."""

BEST = 24
"""Best places of all that are followed too."""

CLIMBERS, FINALISTS = 10, 4
"""Places that the search climbs from, and closes in on."""

CLIMBERS_ASIDE, FINALISTS_ASIDE = 4, 2
"""The same of a tool that does not move in the plane through the axis, whose places cost ten times as much."""

INNER = 17
"""Radii that a crossing is looked for among; the next look is between two of the neighbours of the highest."""

AROUND = 5
"""Azimuths of a look at one place, from point to point of the program."""

COARSE, FINE = 4, 9
"""Looks along a radius: a cusp to less than 0.1 % of its height, and to the rounding of its place."""

TINY = 1e-9
"""Least distance from the axis of a place beside it, in feeds."""

CLOSER = 11
"""Looks around the axis, of eight steps each, two steps of one the width of the next."""


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
    stages = 5
    told = progress or (lambda _done, _total: None)
    told(0, stages)
    scans = search.scans(told)
    if known is not None:
        x, y = known.points()
        scans.append(_Places(np.hypot(x, y), np.arctan2(y, x), known.z))
    found = []
    for number, sign in enumerate((1.0, -1.0)):
        place = search.followed(scans, sign)
        if place is None:
            return None
        found.append(place)
        told(stages - 1 + number, stages)
    return Extremes(highest=found[0], lowest=found[1])


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
        self.upright = self.ready.cut.upright and self.ready.cut.convex

    def at(self, radius: Floats, angle: Floats) -> Floats:
        """Return the error at places, those of a row near each other; nan where no pass is. (n, m) [mm]."""
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        rows, columns = x.shape
        x, y = x.ravel(), y.ravel()
        tiles = Tiles(np.arange(x.size), np.arange(rows + 1) * columns, np.arange(rows + 1))
        z = np.empty(x.size)
        run_chunks(lambda start, stop: self.ready.fill(x, y, tiles, (start, stop), z), rows, max(1, min(64, rows // 8)))
        z[z >= 1e299] = np.nan
        there = ~np.isnan(z)
        z[there] -= self.part.surface.sag(x[there], y[there])
        return z.reshape(rows, columns)

    def scans(self, told: Progress) -> list[_Places]:
        """Return the error across all passes, about the axis and along the rim."""
        rim, feed = self.part.radius, self.feed
        features = TURN * rim / self.part.surface.feature_size * PER_FEATURE
        angles = int(np.clip(math.ceil(features), FEWEST_ANGLES, MOST_ANGLES))
        most = SCAN if self.upright else SCAN_ASIDE
        near = min(BAND * feed, rim)
        fine = 3 * PER_FEED * BAND if self.upright else PER_FEED * BAND
        found = []
        for number, (radius, count) in enumerate(
            (
                (self._bands(most // angles), angles),
                (np.linspace(0, near, fine + 1), MOST_ANGLES if self.upright else FEWEST_ANGLES),
                (np.linspace(rim - near, rim, PER_FEED * BAND + 1), MOST_ANGLES),
                (np.array([rim]), 4 * MOST_ANGLES),
            )
        ):
            found.append(self._scan(radius, count))
            told(1 + number, 5)
        return found

    def _bands(self, most: int) -> Floats:
        """Return radii across all passes, or where these are too many across bands of them. (n,) [mm]."""
        rim, feed = self.part.radius, self.feed
        every = math.ceil(rim / feed * PER_FEED) + 1
        if every <= most:
            return np.linspace(0, rim, every)
        width = BAND * PER_FEED
        bands = max(most // width, 2)
        starts = np.linspace(0, rim - BAND * feed, bands)
        return np.unique((starts[:, None] + np.arange(width) * feed / PER_FEED).ravel())

    def _scan(self, radius: Floats, count: int) -> _Places:
        # No program has its points at such azimuths, so that places between its points are met as well.
        each = np.arange(count)
        angle = (each + each * GOLDEN % 1) * (TURN / count)
        made = generate_polar(self.motion, self.tool, radius=radius, angle=angle, machine=self.machine)
        error = made.minus(self.part.surface).z
        shape = error.shape
        return _Places(np.broadcast_to(radius, shape), np.broadcast_to(angle[:, None], shape), error)

    def followed(self, scans: list[_Places], sign: float) -> Extreme | None:
        """Return the highest place, or with a negative ``sign`` the lowest."""
        starts = [self._starts(one, sign) for one in scans]
        radius, angle, best = (np.concatenate(one) for one in zip(*starts, strict=True))
        if best.size == 0:
            return None
        top = int(np.argmax(best))
        known = (float(best[top]), float(radius[top]), float(angle[top]))
        order = np.unique(np.stack([radius, angle]), axis=1, return_index=True)[1]
        radius, angle, best = self._looked(radius[order], angle[order], sign)
        climbers, finalists = (CLIMBERS, FINALISTS) if self.upright else (CLIMBERS_ASIDE, FINALISTS_ASIDE)
        radius, angle, best = self._climbed(*_best(radius, angle, best, climbers), sign)
        radius, angle, best = self._closed_in(*_best(radius, angle, best, finalists), sign)
        top = int(np.argmax(best))
        value, r, a = max(known, (float(best[top]), float(radius[top]), float(angle[top])))
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
        size = BAND * PER_FEED
        cells = -(-columns // size)
        padded = np.full((rows, cells * size), -np.inf)
        padded[:, :columns] = value
        cell = padded.reshape(rows, cells, size)
        inside = cell.argmax(axis=2)
        tops = cell.max(axis=2).ravel()
        first = np.argpartition(-tops, min(BEST, tops.size - 1))[:BEST]
        chosen += ((first // cells) * columns + (first % cells) * size + inside.ravel()[first]).tolist()
        at = np.unique(chosen)
        at = at[np.isfinite(flat[at])]
        return scan.radius.ravel()[at], scan.angle.ravel()[at], flat[at]

    def _along(self, radius: Floats, angle: Floats, half: float, looks: int, sign: float) -> tuple[Floats, Floats]:
        """Return where along each radius, within ``half`` of a place, the error is highest, and how high. (n,)."""
        # The axis itself, which has no azimuth and costs as much as a thousand places, is in the scans.
        least, rim = TINY * self.feed, self.part.radius
        share = np.linspace(-1, 1, INNER)
        best, value = radius, np.full(radius.size, -np.inf)
        for _ in range(looks):
            at = np.clip(best[:, None] + half * share, least, rim)
            found = sign * self.at(at, np.broadcast_to(angle[:, None], at.shape))
            found = np.where(np.isnan(found), -np.inf, found)
            top = found.argmax(axis=1)
            each = np.arange(top.size)
            better = found[each, top] >= value
            best = np.where(better, at[each, top], best)
            value = np.where(better, found[each, top], value)
            half *= 2 / (INNER - 1)
        return best, value

    def _looked(self, radius: Floats, angle: Floats, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the highest within a feed and a step of the program around places. Each (n,)."""
        share = np.linspace(-1, 1, AROUND) * self.step
        angles = (angle[:, None] + share).ravel()
        best, value = self._along(np.repeat(radius, AROUND), angles, 0.75 * self.feed, COARSE, sign)
        shape = (radius.size, AROUND)
        top = value.reshape(shape).argmax(axis=1)
        each = np.arange(radius.size) * AROUND + top
        return best[each], angles[each], value[each]

    def _climbed(self, radius: Floats, angle: Floats, best: Floats, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return where the places come when they climb from pass to pass and from azimuth to azimuth. Each (n,)."""
        rim = self.part.radius
        ways = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j], dtype=np.float64)
        along, around = rim / ZONES[0] / 2, TURN / FEWEST_ANGLES
        while along > self.feed / 2 or around > self.step / 2:
            r = np.clip(radius[:, None] + along * ways[:, 0], 0.0, rim)
            a = angle[:, None] + around * ways[:, 1]
            near, turned, value = (one.reshape(r.shape) for one in self._looked(r.ravel(), a.ravel(), sign))
            top = value.argmax(axis=1)
            each = np.arange(top.size)
            better = value[each, top] > best
            radius = np.where(better, near[each, top], radius)
            angle = np.where(better, turned[each, top], angle)
            best = np.where(better, value[each, top], best)
            along, around = max(along / 2, self.feed / 3), max(around / 2, self.step / 3)
        return radius, angle, best

    def _closed_in(self, radius: Floats, angle: Floats, best: Floats, sign: float) -> tuple[Floats, Floats, Floats]:
        """Return the very tops next to places. Each (n,)."""
        half = self.step
        share = np.linspace(-1, 1, 9)
        for _ in range(CLOSER):
            angles = (angle[:, None] + half * share).ravel()
            near, value = self._along(np.repeat(radius, share.size), angles, 0.75 * self.feed, FINE, sign)
            shape = (radius.size, share.size)
            top = value.reshape(shape).argmax(axis=1)
            each = np.arange(radius.size) * share.size + top
            better = value[each] > best
            radius, angle = np.where(better, near[each], radius), np.where(better, angles[each], angle)
            best = np.where(better, value[each], best)
            half /= 2
        return radius, angle, best


def _best(radius: Floats, angle: Floats, best: Floats, count: int) -> tuple[Floats, Floats, Floats]:
    order = np.argsort(-best, kind="stable")[:count]
    return radius[order], angle[order], best[order]
