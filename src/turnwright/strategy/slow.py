"""The slow tool servo: spindle as C axis, slides X and Z, one spiral."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Literal

import numpy as np

from turnwright._arrays import Floats
from turnwright._kernels import chord as kernel
from turnwright._validate import whole_number
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.part import OVERLAP_FEEDS, OVERLAP_MM, Part
from turnwright.path import Path, Spiral
from turnwright.placing import Tips, touch_down
from turnwright.progress import Progress, require_memory
from turnwright.speed_profile import Speeds
from turnwright.strategy.base import Strategy
from turnwright.strategy.ends import check_overrun, find_ends, require_overlap
from turnwright.strategy.sampling import (
    REFINEMENT_RATIO,
    TURN,
    WIDEST_STEP,
    check_count,
    check_interval,
    check_samples,
    sample_turns,
)
from turnwright.tool import Tool
from turnwright.units import Count, Feed, Flag, Size, Speed, Step, Thickness

__all__ = ["SlowToolServo"]

BYTES_PER_POINT = 160
"""Memory for a point of a path with its contact and motion, 20 numbers."""

BYTES_PER_SAMPLE = 24
"""Memory for a sample of a path from which the points are selected."""

SAMPLING_FACTOR = 48
"""A path is sampled finely enough where its possible bulge between samples is below the tolerance over this factor. The
samples are then at least 13 times as dense as program points, since a bulge falls with the square of the step."""

CUBIC_FACTOR = 300
"""A path is interpolated by cubics where their error is below the tolerance over this factor."""

MAX_CUBIC_PARTS = 8
"""Most parts of an interval that a cubic interpolates, so that at least two samples per program point are placed."""

AIR_CHORD_MM = 0.1
"""Chord in air, where the path is not that of the tool."""

OUTLINE_STEP = math.radians(1)
"""Largest angle between points that are set by the chord, where they must resolve an outline. [rad]"""

BLOCK_SAMPLES = 1 << 20
"""Samples of the path that are placed together."""

PIECE_SAMPLES = 1 << 16
"""Samples of these between which cubics interpolate, and from which points are selected, together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowToolServo(Strategy):
    r"""Slow tool servo (slow slide servo): steady C, X advancing by the feed per revolution, Z following the surface.

    The tip runs along an Archimedean spiral between the rim and the axis. The inner end is exact; the outer end is
    moved outward by less than one step if this makes every step equal. The points are set in one of four ways:

    * ``points_per_rev``: constant angle, the same azimuths in every revolution, starting at azimuth 0.
    * ``arc_length``: constant length along the spiral. Near the centre the angle between points grows without bound.
    * ``arc_length`` and ``max_step``: constant arc length outside. Inside, where the angle would exceed ``max_step``,
      constant angle (the largest fraction of a revolution that does not).
    * ``chord``: the fewest points for which straight lines in machine axes between them keep within ``chord`` of the
      exact path.

    The fields of every strategy are those of `Strategy`.

    Parameters
    ----------
    feed
        Advance of X per spindle revolution. [mm/rev]
    points_per_rev
        Program points per revolution.
    arc_length
        Distance between program points along the spiral. [mm]
    max_step
        Largest angle between program points, with ``arc_length`` or ``chord``; with ``chord`` alone it is 30 deg. [rad]
    chord
        Largest height between the exact path and straight lines between the points, for a path along z. [mm]
    lead_in
        Distance outside the clear aperture at which the tip starts. ``None`` for the least distance that cuts the rim:
        half a feed, so that the outermost cusp is no higher than the others, plus, where the surface falls towards the
        rim, the distance by which the edge touches inside its tip. A value that is set is used exactly; an error is
        raised if it would leave a band uncut. [mm]
    overrun
        Distance beyond the axis at which the tip ends, or starts. A quarter of a feed keeps the cusp at the axis as low
        as the others. It is 0 by default: beyond the axis the part moves toward the clearance face. [mm]

    Raises
    ------
    InputError
        If a length is not positive, or the points are not set in exactly one way.

    Sources
    -------
    [Li2018]_ section 2 (spiral, constant angle and constant arc), [Troutman2016]_ section 6.3 (chord). Erratum to
    Troutman's Eq. 6.5: its curvature of the arc diverges at the centre; the step is
    :math:`\sqrt{8\,\mathrm{chord} / \max|z_{\theta\theta}|}`, with the tip's own height, not the surface's.

    >>> servo = SlowToolServo(feed=0.025, points_per_rev=3600, lead_in=0.0)
    >>> from turnwright.surface import Plane
    >>> from turnwright.part import OVERLAP_FEEDS, OVERLAP_MM, Part
    >>> from turnwright.tool import Tool
    >>> spiral = servo.spiral(Part(surface=Plane(), radius=7.5), Tool(nose_radius=1.5))
    >>> spiral.angle.size, round(spiral.turns, 9)
    (1080001, 300.0)
    """

    kind = "slow tool servo"
    crosses_air = True
    example = MappingProxyType({"feed": "8 um/rev", "points_per_rev": 360})
    ways = ("points_per_rev", "arc_length", "max_step", "chord")
    feed: Feed
    spindle_rpm: Speed | None = None
    spindle_speeds: Speeds | None = None
    points_per_rev: Count | None = None
    arc_length: Size | None = None
    max_step: Step | None = None
    chord: Size | None = None
    inside_out: Flag = False
    sense: Literal[1, -1] = 1
    along: Literal["z", "normal"] = "z"
    lead_in: Thickness | None = None
    overrun: Thickness = 0.0

    def __post_init__(self) -> None:
        self._check_fields()
        ways = [name for name in ("points_per_rev", "arc_length", "chord") if getattr(self, name) is not None]
        if len(ways) != 1:
            raise InputError(
                f"the points of the spiral are set by {' and '.join(ways) or 'nothing'}: give exactly one of "
                "points_per_rev, arc_length and chord"
            )
        if self.points_per_rev is not None:
            object.__setattr__(self, "points_per_rev", whole_number(self.points_per_rev, "points_per_rev", 8))
        if self.max_step is not None:
            if self.points_per_rev is not None:
                raise InputError(
                    "max_step is set with points_per_rev, it goes with arc_length or chord alone: remove one"
                )
            if self.max_step > TURN / 8:
                raise InputError(f"max_step is {math.degrees(self.max_step):g} deg, the limit is 45 deg")
        check_overrun(self.overrun, self.feed)

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the spiral for a part and a tool, see `Strategy`."""
        edge = tool.cutting_edge(self.sense)
        require_overlap(edge, self.feed)
        if self.points_per_rev is not None:
            last, end = self._count_points(part, edge, self.points_per_rev)
            if progress is not None:
                progress(0, last + 1)
            spiral = self._select_points(_number_points(last), last, self.points_per_rev, end)
        else:
            end, start = self._find_ends(part, edge)
            if self.chord is not None:
                turned = self._set_points_by_chord(part, edge, end, start, progress)
            else:
                turned = self._set_points_by_arc(end, start, progress)
            angle = turned if self.inside_out else turned[-1] - turned[::-1]
            radius = end + self.feed / TURN * (turned if self.inside_out else turned[::-1])
            spiral = Spiral(angle=self.sense * angle, radius=radius)
        outward = self.sense if self.inside_out else -self.sense
        return replace(spiral, radius_rate=np.full(spiral.radius.size, outward * self.feed / TURN))

    def preview_spiral(self, part: Part, tool: Tool, *, turns: int, per_turn: int) -> Spiral:
        """Return some of the points of `spiral`; with ``points_per_rev``, without computing all of them."""
        if self.points_per_rev is None:
            return super(SlowToolServo, self).preview_spiral(part, tool, turns=turns, per_turn=per_turn)
        edge = tool.cutting_edge(self.sense)
        last, end = self._count_points(part, edge, self.points_per_rev)
        wanted = sample_turns(last / self.points_per_rev, turns, per_turn)
        return self._select_points(np.unique(np.round(wanted * self.points_per_rev)), last, self.points_per_rev, end)

    def extent(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> tuple[int, Spiral]:
        """Return the size of `spiral` and its ends; with ``points_per_rev``, without computing the other points."""
        if self.points_per_rev is None:
            return super(SlowToolServo, self).extent(part, tool, progress=progress)
        edge = tool.cutting_edge(self.sense)
        require_overlap(edge, self.feed)
        last, end = self._count_points(part, edge, self.points_per_rev)
        turn = np.arange(min(self.points_per_rev, last) + 1.0)
        at = np.unique(np.append(last - turn, 0) if self.inside_out else np.append(turn, last))
        return last + 1, self._select_points(at, last, self.points_per_rev, end)

    def _count_points(self, part: Part, edge: Edge, per_turn: int) -> tuple[int, float]:
        """Return the number of the last point, and the commanded radius of the inner end [mm]."""
        end, start = self._find_ends(part, edge)
        return _count_steps((start - end) / self.feed * per_turn), end

    def _select_points(self, at: Floats, last: int, per_turn: int, end: float) -> Spiral:
        step = TURN / per_turn
        radius = (at if self.inside_out else last - at) * step
        radius *= self.feed / TURN  # in place, as fresh memory for millions of points takes longer than this
        radius += end
        return Spiral(angle=at * (self.sense * step), radius=radius)

    def _find_ends(self, part: Part, edge: Edge) -> tuple[float, float]:
        """Return the commanded radii of the inner end and of the outer end, before the steps are made equal. [mm]."""
        step = self.arc_length or part.reach * (
            TURN / self.points_per_rev if self.points_per_rev else self._widest(part)
        )
        return find_ends(part, edge, self.feed, self.lead_in, self.overrun, step=step)

    def _widest(self, part: Part) -> float:
        """Return the largest angle between points that are set by the chord. [rad]."""
        widest = self.max_step or WIDEST_STEP
        return min(widest, OUTLINE_STEP) if part.leaves_air else widest

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: C the azimuth [rad], X the radius, Z the height [mm]."""
        return {"C": path.angle, "X": path.radius, "Z": path.z}

    def _set_points_by_arc(self, end: float, start: float, progress: Progress | None) -> Floats:
        """Return the angle turned from the inner end: constant arc outside, constant angle inside. (n,) [rad]."""
        pitch = self.feed / TURN
        inner, outer = end / pitch, start / pitch
        arc = self.arc_length / pitch  # type: ignore[operator]
        inside = np.zeros(1)
        if self.max_step is not None:
            step = TURN / math.ceil(TURN / self.max_step * (1 - 1e-12))
            # Along the spiral r = pitch * psi an angle step is sqrt(1 + psi²) * step long, in units of the pitch.
            border = math.sqrt(max((arc / step) ** 2 - 1, 0.0))
            inside = _number_points((min(border, outer) - inner) / step) * step
        first, last = _spiral_length(np.array([inner + inside[-1], outer])).tolist()
        steps = (last - first) / arc
        if progress is not None:
            progress(0, inside.size + _count_steps(steps))
        outside = first + arc * _number_points(steps)[1:]
        return np.concatenate([inside, _invert_spiral_length(outside) - inner])

    def _set_points_by_chord(
        self, part: Part, edge: Edge, end: float, start: float, progress: Progress | None
    ) -> Floats:
        """Return the angles turned from the inner end of the fewest points for the chord. (n,) [rad]."""
        pitch = self.feed / TURN
        widest = self._widest(part)
        tolerance = float(self.chord)  # type: ignore[arg-type]
        steps = math.ceil(TURN / widest * (1 - 1e-12))
        finest = max(256, 12 * steps, 8 * TURN * part.reach / part.surface.feature_size)
        per_turn = steps * math.ceil(finest / steps)
        samples = _number_points((start - end) / self.feed * per_turn, BYTES_PER_SAMPLE)
        total = float(samples[-1]) * (TURN / per_turn)

        def height(turned: Floats) -> Floats:
            angle = turned if self.inside_out else total - turned
            tips = Tips.at(self.sense * angle, end + pitch * turned)
            return touch_down(
                part.surface, edge, tips, np.inf if part.leaves_air else max(part.reach, end + pitch * total)
            ).z

        def allow(turned: Floats) -> Floats:
            """Return the tolerance at angles: that of the chord, and far more in air. (n,) [mm]."""
            if not part.leaves_air:
                return np.full(turned.size, tolerance)
            angle = turned if self.inside_out else total - turned
            radius = end + pitch * turned
            beyond = OVERLAP_MM + OVERLAP_FEEDS * self.feed + widest * part.reach + edge.half_width + abs(edge.dx)
            off = part.border.distance(radius * np.cos(angle), self.sense * radius * np.sin(angle))
            return np.where(off > beyond, AIR_CHORD_MM, tolerance)

        points = [np.zeros(1)]
        # The last two steps of a piece may be short, as they end at its border, and would limit the block rate of the
        # whole cut. Their points are selected again with the next piece.
        carried = [np.empty(0)] * 3
        if progress is not None:
            progress(0, max(round(total / TURN), 1))
        for low, high in _split_evenly(samples.size - 1, BLOCK_SAMPLES):
            turned = samples[low : high + 1] * (TURN / per_turn)
            for placed in _sample_with_cubics(turned, height(turned), height, allow):
                piece = _refine_samples(*placed, height, allow)
                if carried[0].size:
                    piece[2][0] = min(piece[2][0], carried[2][-1])
                    piece = tuple(np.concatenate([one[:-1], new]) for one, new in zip(carried, piece, strict=True))
                turned = piece[0]
                keep = np.empty(turned.size, dtype=np.int64)
                count = kernel.fewest(*piece, widest, keep)
                if turned[-1] < total:
                    count = max(count - 2, 1)
                    carried = [one[keep[count - 1] :] for one in piece]
                points.append(turned[keep[1:count]])
                if progress is not None:
                    progress(round(float(turned[-1]) / TURN), round(total / TURN))
        count = sum(part.size for part in points)
        check_count(count, "the feed and of the chord")
        _require_room(count)
        return np.concatenate(points)


def _require_room(count: float, bytes_each: int = BYTES_PER_POINT) -> None:
    require_memory(
        bytes_each * count, f"a path of {count:.3g} points", "use a larger feed, fewer points, or more memory"
    )


def _number_points(count: float, bytes_each: int = BYTES_PER_POINT) -> Floats:
    """Return 0, 1, 2 and so on up to ``count``, rounded up (except for rounding errors). (n,)."""
    last = _count_steps(count)
    _require_room(last, bytes_each)
    return np.arange(last + 1, dtype=np.float64)


def _count_steps(steps: float) -> int:
    check_count(steps, "the feed and of the step")
    return max(math.ceil(steps - 1e-6), 0)


def _spiral_length(psi: Floats) -> Floats:
    """Return the length of the spiral r = psi from its centre. (n,)."""
    return (psi * np.sqrt(1 + psi**2) + np.arcsinh(psi)) / 2


def _invert_spiral_length(length: Floats) -> Floats:
    """Return psi where the spiral r = psi has a given length from its centre. (n,) [rad]."""
    psi = np.empty_like(length)
    for first in range(0, length.size, BLOCK_SAMPLES):
        goal = np.abs(length[first : first + BLOCK_SAMPLES])
        # Both bounds lie above the root of a convex function, so Newton's method converges without overshoot.
        guess = np.minimum(goal, np.sqrt(2 * goal))
        for _ in range(6):
            guess = guess - (_spiral_length(guess) - goal) / np.sqrt(1 + guess**2)
        psi[first : first + BLOCK_SAMPLES] = np.copysign(guess, length[first : first + BLOCK_SAMPLES])
    return psi


def _split_evenly(intervals: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield the first and the last sample of blocks of at most so many intervals; neighbours share their border."""
    return pairwise(np.linspace(0, intervals, math.ceil(intervals / most) + 1).astype(np.int64).tolist())


def _sample_with_cubics(
    turned: Floats, z: Floats, height: Callable[[Floats], Floats], allow: Callable[[Floats], Floats], density: int = 1
) -> Iterator[tuple[Floats, Floats, float]]:
    """Interpolate even samples of a path by cubics wherever it is smooth enough; where it is rough, sample it closer.

    The error of a cubic through four even samples, around an interval or on one side of it, is at most 1/24 of the
    fourth difference on a smooth path. At a slope discontinuity it is less than the greater of two neighbouring fourth
    differences, which is used as the bound. Samples at the same azimuths in every revolution are placed at a fraction
    of the cost of scattered ones; they are ``density`` times as dense as the first. Yielded are, piece by piece, angles
    [rad], heights (n,) [mm] and the largest error of the heights [mm].
    """
    first, doubt, bend = np.empty(z.size - 1, dtype=np.int64), *np.empty((2, z.size - 1))
    kernel.doubts(z, first, doubt, bend)
    tolerance = _allow_between(turned, allow)
    parts = np.sqrt(SAMPLING_FACTOR / tolerance * bend)
    smooth = (doubt <= tolerance / CUBIC_FACTOR) & (parts <= MAX_CUBIC_PARTS)
    if np.count_nonzero(~smooth) > max(smooth.size // REFINEMENT_RATIO, 4):
        check_samples(4 * density * PIECE_SAMPLES, float(tolerance.min()))
        turned, coarse = np.linspace(turned[0], turned[-1], 2 * smooth.size + 1), z
        z = np.empty(turned.size)
        z[::2], z[1::2] = coarse, height(turned[1::2])
        for low, high in _split_evenly(2 * smooth.size, BLOCK_SAMPLES):
            block = slice(low, high + 1)
            yield from _sample_with_cubics(turned[block], z[block], height, allow, 2 * density)
        return
    pieces = list(_split_evenly(smooth.size, PIECE_SAMPLES))
    counts = [max(2, math.ceil(parts[low:high][smooth[low:high]].max(initial=0.0))) for low, high in pieces]
    rough = [low + np.flatnonzero(~smooth[low:high]) for low, high in pieces]
    step = np.diff(turned)
    between = np.concatenate(
        [
            (turned[at, None] + step[at, None] * (np.arange(1, most) / most)).ravel()
            for at, most in zip(rough, counts, strict=True)
        ]
    )
    placed = height(between) if between.size else between
    for (low, high), most, at in zip(pieces, counts, rough, strict=True):
        fine = np.empty((high - low, most))
        kernel.interpolate(z, low, first, fine)
        some, placed = np.split(placed, [at.size * (most - 1)])
        fine[at - low, 1:] = some.reshape(-1, most - 1)
        tight = smooth[low:high] & (tolerance[low:high] <= tolerance[low:high].min())
        yield (
            np.linspace(turned[low], turned[high], fine.size + 1),
            np.append(fine, z[high]),
            float(doubt[low:high][tight].max(initial=0.0)),
        )


def _allow_between(turned: Floats, allow: Callable[[Floats], Floats]) -> Floats:
    """Return the tolerance between neighbouring samples. (n - 1,) [mm]."""
    allowed = allow(turned)
    return np.asarray(np.minimum(allowed[1:], allowed[:-1]))


def _refine_samples(
    turned: Floats, z: Floats, doubt: float, height: Callable[[Floats], Floats], allow: Callable[[Floats], Floats]
) -> tuple[Floats, ...]:
    """Sample a path until its bulge between the samples is negligible.

    The bound of the bulge from the straight line between two samples is half the step times the change of slope to
    either neighbour. It is four times the bulge of a smooth path, and at least that of a slope discontinuity inside.
    The heights have an error up to ``doubt``. Returned are angles [rad], heights [mm] and the tolerance at each sample
    less that error and the largest bulge next to it [mm]. Each (n,)
    """
    while True:
        bulge, slack = np.empty(turned.size - 1), allow(turned)
        if kernel.bulges(turned, z, slack, bulge) <= 1 / SAMPLING_FACTOR:
            kernel.lessen(slack, bulge, 2 * doubt)
            return turned, z, slack
        step, tolerance = np.diff(turned), np.minimum(slack[1:], slack[:-1])
        coarse = np.flatnonzero(bulge / tolerance > 1 / SAMPLING_FACTOR)
        check_interval(step[coarse], turned[coarse], float(tolerance.min()))
        # The bulge of a smooth path falls with the square of the step, that of a slope discontinuity with the step: the
        # latter takes some more iterations.
        parts = np.clip(np.ceil(np.sqrt(bulge[coarse] / tolerance[coarse] * SAMPLING_FACTOR)), 2, 8).astype(np.int64)
        which = np.repeat(np.arange(coarse.size), parts - 1)
        rank = np.arange(which.size) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
        check_samples(turned.size + which.size, float(tolerance.min()))
        new = turned[coarse[which]] + step[coarse[which]] * (rank / parts[which])
        at = coarse[which] + 1
        turned, z = np.insert(turned, at, new), np.insert(z, at, height(new))
