r"""The quasi-elliptical tool servo: the tool is at rest relative to the part while its path passes a sharp valley.

C turns at constant speed. With the tip at the distance :math:`\rho` from the axis, X and Y swing it along the cutting
direction by an angle :math:`\gamma` from the rake plane, so that it cuts at the azimuth
:math:`\psi = \theta + \gamma`,

.. math:: X = \rho\cos\gamma, \qquad Y = \rho\sin\gamma,

while the rake plane still contains the radial line of azimuth :math:`\theta`. Z is the exact height in that pose.

*Valleys.* The height of the tip is the greatest of the heights at which the edge would touch each lenslet alone,
:math:`Z = \max_i Z_i(\rho, \psi, \theta)`. It has a slope discontinuity where the edge leaves one lenslet and touches
the next, :math:`D = Z_j - Z_i = 0`. While the tip is at rest on the part, the azimuth :math:`\Psi(\theta)` of the
valley changes at the rate :math:`q = -D_\theta/D_\psi`; the tip is at rest relative to the moving valley.

*The swing.* With passing moments :math:`t_k` and valleys :math:`\Psi_k(\theta)`, expanded to their second derivative,

.. math:: \psi = (1 - \sigma)\,\Psi_k + \sigma\,\Psi_{k+1}, \qquad \sigma = s - \frac{\sin 2\pi s}{2\pi}, \qquad
   s = \frac{\theta - t_k}{t_{k+1} - t_k} .

The first and second derivatives of :math:`\sigma` vanish at both ends, so that Z has no slope discontinuity.

Sources
-------
The principle is that of [Zhu2019]_. Its nearest-lens rule (Eqs 4 and 5), the sign of Eq. 11, the end condition of
Eq. 14 and the pose of Eq. 18 are not used, see the errata. Where the Y axis is slow, the moments that keep its limit
with the least displacement are found by isotonic regression [deLeeuw2009]_.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, frozen
from turnwright._validate import check_numbers
from turnwright.edge import Edge
from turnwright.errors import InputError, LimitError
from turnwright.part import Part
from turnwright.path import Path, Spiral
from turnwright.placing import Tips, follow, touch_down
from turnwright.progress import Progress
from turnwright.speed_profile import Speeds
from turnwright.strategy.base import Strategy
from turnwright.strategy.sampling import TURN
from turnwright.strategy.slow import SlowToolServo
from turnwright.tool import Tool
from turnwright.units import Count, Feed, Flag, Size, Speed, Step, Thickness, unit

__all__ = ["QuasiEllipticalToolServo", "Valleys"]

SAMPLES_PER_FEATURE = 8
"""Samples of the path per feature size in which valleys are detected."""

MIN_SAMPLES_PER_REV = 360
"""Least number of these samples per revolution."""

SAMPLES_PER_SWING = 8
"""Samples between two valleys at which a planned swing is checked for further valleys."""

BLOCK_SAMPLES = 1 << 20
"""Most samples that are in memory together."""

SIDE_OFFSETS = (5e-3, 1e-5, 1e-5)
"""Distances before and behind a valley at which both sides are evaluated, one for each step of Newton's method, in
feature sizes. The error of a step grows with the square of the distance."""

PASSING_ITERATIONS = 4
"""Iterations for the moment at which a moving valley is passed."""

MAX_BISECTIONS = 40
"""Most bisections of an interval that contains a valley."""

MIN_INTERVAL_RAD = 1e-6
"""Shorter intervals are not bisected: there the edge leaves a crest or the rim, not a valley. [rad]"""

VALLEY_TOL_RAD = 1e-6
"""Valleys further apart than this are different ones. [rad]"""

HEIGHT_TOL_MM = 1e-9
"""Heights that differ by less are equal. [mm]"""

RATE_STEP_RAD = 1e-3
"""Step of the difference that gives the derivative of a valley's rate. [rad]"""

MAX_SWING_FEATURES = 16
"""The longest interval that a single swing covers, in feature sizes: two pitches of a lens array."""

MAX_SWING_RAD = 1.0
"""The longest interval that a single swing covers. [rad]"""

MIN_JUMP = 1e-9
"""Smaller slope discontinuities are ignored. [mm/rad]"""

RESIDUAL_JUMP_LIMIT = 1e-6
"""A smaller slope discontinuity has no effect on a servo. [mm/rad]"""

PLAN_ITERATIONS = 6
"""Most iterations of the plan: the swing changes the pose of the tool, and with it the valleys."""

Y_LIMIT_FRACTION = 0.95
"""Fraction of the limit of Y that the swing may use; the changing radius uses the remainder."""

MAX_VALLEY_RATE = 0.5
"""A valley that moves at more than this fraction of the spindle speed is grazed, not passed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Valleys:
    """The valleys that a path passes, and the slope discontinuities of Z without and with the swing.

    Parameters
    ----------
    angle
        Spindle angle at which the swinging tool passes each. Ascending in the sense of the cut. (n,) [rad]
    azimuth
        Azimuth of the part under the tip at that moment, cumulative like the angle. (n,) [rad]
    radius
        Distance of the tip from the axis there. (n,) [mm]
    slope_jump
        Slope discontinuity of Z without the swing. (n,) [mm/rad]
    residual_jump
        Residual slope discontinuity of Z with the swing. (n,) [mm/rad]
    is_at_rest
        Whether the tool is at rest over the valley and ``residual_jump`` is below 1e-6 mm/rad. It is not at
        valleys that the policy for short intervals skips, at the ends of the path, where the edge projects over the
        rim, and within nanometres of a corner of three pieces. (n,)
    stroke
        Largest displacement of the swing along Y, above or below centre. [mm]
    """

    angle: Floats
    azimuth: Floats
    radius: Floats
    slope_jump: Floats
    residual_jump: Floats
    is_at_rest: Bools
    stroke: float

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("angle", "azimuth", "radius", "slope_jump", "residual_jump"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        self.is_at_rest.flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True)
class QuasiEllipticalToolServo(Strategy):
    r"""Quasi-elliptical tool servo: a slow tool servo whose tool swings along the cut and rests at each sharp valley.

    Points and radii are those of a `SlowToolServo`, as are the fields not listed here; only the azimuth of the tip
    differs. Between two valleys that are an arc w apart, the swing has an amplitude of at most :math:`w/2\pi` and an
    acceleration of at most :math:`2\pi\rho^2\omega^2/w`. Where a path cuts a corner of a cell, w is short and the Y
    axis would have to jump. The policy for such short intervals is chosen by ``short``:

    * ``short="merge"``: valleys less than ``shortest`` apart are replaced by one between them; the tool passes each of
      them slowly, and Z keeps a part of the slope discontinuities.
    * ``short="skip"``: of two valleys less than ``shortest`` apart, the one with the smaller slope discontinuity is
      passed in motion.
    * ``short="slow"``: the tool rests at all of them and takes more time from one to the next, so that Y keeps to
      ``y_acceleration``. This time is taken from the longer intervals on both sides, where the tool is then ahead or
      behind: the stroke of Y grows, and Z stays smooth. The spindle speed stays constant.

    Parameters
    ----------
    short
        Policy for short intervals between valleys: "merge", "skip" or "slow", which requires ``spindle_rpm``.
    shortest
        Length of an arc below which an interval is short, for "merge" and "skip". [mm]
    y_acceleration
        Limit of the Y axis, for "slow". [mm/s²]

    Raises
    ------
    InputError
        If a length is not positive, or the fields do not fit the policy.

    Notes
    -----
    Valleys are detected by the piece numbers of the surface, see `Surface.piece`; crests are ignored. The path is
    sampled eight times per feature size. A piece that the path crosses in a shorter chord, between two samples of the
    same neighbour, may be missed.

    Sources
    -------
    [Zhu2019]_, with errata; see the module.

    >>> QuasiEllipticalToolServo(feed=0.005, points_per_rev=3600, short="merge", shortest=0.01).short
    'merge'
    """

    kind = "quasi-elliptical tool servo"
    example = MappingProxyType({"feed": "8 um/rev", "points_per_rev": 1440, "short": "skip", "shortest": "10 um"})
    ways = ("points_per_rev", "arc_length", "max_step")
    like = SlowToolServo
    feed: Feed
    short: Literal["merge", "skip", "slow"]
    shortest: Size | None = None
    y_acceleration: Annotated[float, unit("mm/s^2", above=0.0)] | None = None
    spindle_rpm: Speed | None = None
    spindle_speeds: Speeds | None = None
    points_per_rev: Count | None = None
    arc_length: Size | None = None
    max_step: Step | None = None
    inside_out: Flag = False
    sense: Literal[1, -1] = 1
    along: Literal["z"] = "z"
    lead_in: Thickness | None = None

    def __post_init__(self) -> None:
        self._check_fields()
        self._make_slow_servo()
        needed, other = ("y_acceleration", "shortest") if self.short == "slow" else ("shortest", "y_acceleration")
        if getattr(self, needed) is None or getattr(self, other) is not None:
            raise InputError(f'short="{self.short}" needs {needed} and must not have {other}: set {needed} alone')
        if self.short == "slow" and self.spindle_rpm is None:
            raise InputError('short="slow" needs spindle_rpm, none is set: set the spindle speed')

    def _make_slow_servo(self) -> SlowToolServo:
        return SlowToolServo(
            feed=self.feed, spindle_rpm=self.spindle_rpm, points_per_rev=self.points_per_rev,
            arc_length=self.arc_length, max_step=self.max_step, inside_out=self.inside_out, sense=self.sense,
            lead_in=self.lead_in,
        )  # fmt: skip

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the swinging spiral for a part and a tool, see `Strategy`."""
        base = self._make_slow_servo().spiral(part, tool)
        return self._plan(base, part, tool, progress)[0].spiral(base.angle)

    def valleys(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Valleys:
        """Return the valleys of the path, with the residual slope discontinuity at each. See `spiral`."""
        base = self._make_slow_servo().spiral(part, tool)
        course, crossings, at_rest = self._plan(base, part, tool, progress)
        swung = course.spiral(base.angle)
        psi, rate = course.azimuth(crossings.at)
        residual_jump = np.abs(crossings.steep * (rate - crossings.rate))
        return Valleys(
            angle=self.sense * crossings.at, azimuth=self.sense * psi, radius=course.radius(crossings.at),
            slope_jump=crossings.steep * (1 - crossings.rate), residual_jump=residual_jump,
            is_at_rest=at_rest & (residual_jump < RESIDUAL_JUMP_LIMIT), stroke=float(np.abs(swung.y).max()),  # type: ignore[arg-type]
        )  # fmt: skip

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: C the azimuth of the rake plane [rad], X, Y and Z the tip [mm]."""
        if path.y is None:
            raise InputError("the path has no Y positions: place the spiral of this strategy")
        return {"C": path.angle, "X": path.radius, "Y": path.y, "Z": path.z}

    def _plan(
        self, base: Spiral, part: Part, tool: Tool, progress: Progress | None
    ) -> tuple[_Course, _Crossings, Bools]:
        """Return the course with its swing, the valleys on it, and at which of them the tool rests."""
        if not part.surface.in_pieces:
            raise InputError(
                f"{type(part.surface).__name__} is one smooth piece and has no valleys: use a SlowToolServo"
            )
        begin, end = (float(angle) for angle in base.sense * base.angle[[0, -1]])
        edges = np.array([begin, end])
        slope = float(base.radius[-1] - base.radius[0]) / (end - begin)
        course = _Course(
            sense=base.sense, start=float(base.radius[0]) - slope * begin, slope=slope,
            longest=MAX_SWING_FEATURES * part.surface.feature_size,
            moment=edges, line=edges, rate=np.ones(2), bend=np.zeros(2),
        )  # fmt: skip
        reader = _Reader(base, part, tool.cutting_edge(base.sense))
        step = part.surface.feature_size / SAMPLES_PER_FEATURE
        turn = max(math.ceil(TURN * float(np.abs(base.radius).max()) / step), MIN_SAMPLES_PER_REV)
        count = math.ceil((end - begin) / TURN * turn)
        together = max(1, BLOCK_SAMPLES // turn) * turn
        blocks = []
        for first in range(0, count, together):
            last = min(first + together, count)
            # Steps that divide a revolution, so that every revolution has the same azimuths.
            blocks.append(reader.crossings(course, begin + np.arange(first, last + 1.0) * (TURN / turn)))
            if progress is not None:
                progress(last, count)
        crossings = _Crossings(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
        stands = self._select_valleys(crossings, course)
        worst = crossings.at.size + 1
        for _ in range(PLAN_ITERATIONS):
            swung, stands = self._plan_swing(reader, course, stands)
            crossings = reader.crossings(swung, swung.sample_moments(crossings))
            at_rest = _match_valleys(crossings, stands)
            # In the swung pose the edge may touch one lenslet more, or one less.
            new = self._select_valleys(crossings, course)
            bad = int(np.count_nonzero(~_match_valleys(new, stands)))
            if self.short != "slow" or not 0 < bad < worst:
                break
            worst, stands = bad, new
        return swung, crossings, at_rest

    def _select_valleys(self, found: _Crossings, course: _Course) -> _Crossings:
        # The tool cannot rest at a grazed valley, nor at the ends of the path, where half a swing does not fit.
        room = course.half(found.line)
        stands = found.select(
            (np.abs(found.rate) <= MAX_VALLEY_RATE)
            & (found.line - course.moment[0] >= room)
            & (course.moment[-1] - found.line >= room)
        )
        if stands.line.size < 2:
            return stands
        stands = stands.select(np.append(True, np.diff(np.maximum.accumulate(stands.line)) > VALLEY_TOL_RAD))
        if self.shortest is None:
            return stands
        radius = np.abs(course.radius(stands.line))
        if self.short == "skip":
            keep = np.arange(stands.line.size)
            while (close := np.diff(stands.line[keep]) * radius[keep[1:]] < self.shortest).any():
                first = np.flatnonzero(close & ~np.append(False, close[:-1]))
                weaker = stands.steep[keep[first]] <= stands.steep[keep[first + 1]]
                keep = np.delete(keep, np.where(weaker, first, first + 1))
            return stands.select(keep)
        close = np.diff(stands.line) * radius[1:] < self.shortest
        group = np.append(0, np.cumsum(~close))
        alone = np.bincount(group) == 1
        weight = np.bincount(group, stands.steep)
        line, rate = (np.bincount(group, stands.steep * values) / weight for values in (stands.line, stands.rate))
        one = stands.select(np.append(0, np.flatnonzero(~close) + 1))
        # The mean of merged valleys is not a valley itself, so it has no contacts.
        sweeps = (np.where(alone, sweep, np.nan) for sweep in (one.sweep_before, one.sweep_after))
        return _Crossings(line, line, rate, one.steep, one.z, *sweeps)

    def _plan_swing(self, reader: _Reader, plain: _Course, stands: _Crossings) -> tuple[_Course, _Crossings]:
        """Return the course that rests at these valleys, and the valleys at those moments."""
        begin, end = plain.moment[[0, -1]]
        line, rate = stands.line.copy(), stands.rate.copy()
        moment = line
        alone = np.flatnonzero(~np.isnan(stands.sweep_before))
        sweeps = np.stack([stands.sweep_before[alone], stands.sweep_after[alone]])
        for _ in range(3):
            moment = self._schedule_moments(plain, line, rate)
            met = reader.find_valleys(
                plain, moment[alone], line[alone] + rate[alone] * (moment - stands.at)[alone], sweeps
            )
            good = np.isfinite(met.line)
            line[alone[good]], rate[alone[good]] = met.line[good], met.rate[good]
            stands = stands._replace(at=moment)
        bend = np.zeros(line.size)
        rates = [
            reader.find_valleys(
                plain, moment[alone] + way * RATE_STEP_RAD, line[alone] + way * RATE_STEP_RAD * rate[alone], sweeps
            ).rate
            for way in (-1, 1)
        ]
        bend[alone] = np.clip(np.nan_to_num((rates[1] - rates[0]) / (2 * RATE_STEP_RAD)), -1.0, 1.0)
        # Where valleys are far apart, the tool swings only near them.
        gap, half = np.diff(np.concatenate([[begin], moment, [end]])), plain.half(np.concatenate([moment, [end]]))
        wide = np.flatnonzero(gap > 2 * half)
        edges = np.concatenate([[begin], moment, [end]])
        leave, arrive = edges[wide] + half[wide], edges[wide + 1] - half[wide]
        leave, arrive = leave[wide > 0], arrive[wide < moment.size]
        steady = np.concatenate([[begin], leave, arrive, [end]])
        moments = np.concatenate([moment, steady])
        order = np.argsort(moments, kind="stable")
        course = plain._replace(
            moment=moments[order],
            line=np.concatenate([line, steady])[order],
            rate=np.concatenate([rate, np.ones(steady.size)])[order],
            bend=np.concatenate([bend, np.zeros(steady.size)])[order],
        )
        return course, stands._replace(line=line, rate=rate)

    def _schedule_moments(self, plain: _Course, line: Floats, rate: Floats) -> Floats:
        """Return the moments at which the tool rests at each valley. (n,) [rad]."""
        if self.y_acceleration is None or line.size == 0:
            return line.copy()
        from scipy.optimize import isotonic_regression  # noqa: PLC0415 - costly to import

        omega = float(self.spindle_rpm) * TURN / 60  # type: ignore[arg-type]
        edges = np.concatenate([plain.moment[:1], line, plain.moment[-1:]])
        radius = np.abs(plain.radius(edges))
        # A swing from one valley to the next, at a distance W in the angle T, takes the acceleration
        # 2 pi rho (W - q T) (omega / T)^2, and 4 rho d omega^2 / T more where the rates of the valleys differ by d.
        rates = np.concatenate([[1.0], rate, [1.0]])
        share = omega**2 * np.maximum(radius[1:], radius[:-1]) / (Y_LIMIT_FRACTION * self.y_acceleration)
        receding = np.maximum(-np.minimum(rates[1:], rates[:-1]), 0.0)
        linear = 0.5 * share * (TURN * receding + 4 * np.abs(np.diff(rates)))
        least = linear + np.sqrt(linear**2 + TURN * share * np.maximum(np.diff(edges), 0.0))
        taken = np.append(0.0, np.cumsum(least))
        weights = np.ones(edges.size)
        weights[[0, -1]] = 1e9  # the ends stay where they are
        moment = np.asarray(isotonic_regression(edges - taken, weights=weights).x) + taken
        off = float(np.abs(moment - edges).max())
        if off > MAX_SWING_RAD / 2:
            raise LimitError(
                f"Y would swing by {off * float(radius.max()):.3g} mm to stay within y_acceleration "
                f"{self.y_acceleration:g} mm/s^2 at {self.spindle_rpm:g} rev/min, the limit is half the "
                "radius: use a lower spindle speed"
            )
        return np.ascontiguousarray(moment[1:-1], dtype=np.float64)


class _Crossings(NamedTuple):
    """Crossings of a course with valleys. Each (n,)."""

    at: Floats  # moment: spindle angle along the cut [rad]
    line: Floats  # azimuth of the valley, along the cut, at that moment [rad]
    rate: Floats  # derivative of that azimuth by the spindle angle [rad/rad]
    steep: Floats  # slope discontinuity of the height by the azimuth of the tip [mm/rad]
    z: Floats  # height of the tip [mm]
    sweep_before: Floats  # place on the nose at which the edge touches on either side [rad]
    sweep_after: Floats

    def select(self, which: Ints | Bools) -> _Crossings:
        return _Crossings(*(values[which] for values in self))


class _Side(NamedTuple):
    """One end of intervals that contain a valley. Each (n,)."""

    at: Floats
    psi: Floats
    z: Floats
    sweep: Floats
    x: Floats  # contact
    y: Floats
    piece: Ints

    def select(self, which: Ints | Bools) -> _Side:
        return _Side(*(values[which] for values in self))  # type: ignore[arg-type]


class _Course(NamedTuple):
    """Course of the tip around the part: its azimuth at each moment, both along the cut, from node to node."""

    sense: int
    start: float  # radius at moment 0 [mm]
    slope: float  # of the radius [mm/rad]
    longest: float  # longest arc of a single swing [mm]
    moment: Floats  # nodes, where the tip is at `line` and moves at `rate`
    line: Floats
    rate: Floats
    bend: Floats  # second derivative of its azimuth there [1/rad]

    def radius(self, at: Floats) -> Floats:
        """Return the distance of the tip from the axis. (n,) [mm]."""
        return self.start + self.slope * at

    def half(self, at: Floats) -> Floats:
        """Return half of the longest swing. (n,) [rad]."""
        return 0.5 * np.minimum(self.longest / np.maximum(np.abs(self.radius(at)), 1e-300), MAX_SWING_RAD)

    def azimuth(self, at: Floats) -> tuple[Floats, Floats]:
        """Return the azimuth of the tip [rad] and its derivative by the moment. Each (n,)."""
        k = np.clip(np.searchsorted(self.moment, at, side="right") - 1, 0, self.moment.size - 2)
        time = np.maximum(self.moment[k + 1] - self.moment[k], 1e-300)
        s = (at - self.moment[k]) / time
        share = s - np.sin(TURN * s) / TURN
        (before, rate), (after, next_rate) = self._valley(k, at), self._valley(k + 1, at)
        apart = after - before
        return before + share * apart, rate + share * (next_rate - rate) + apart * (1 - np.cos(TURN * s)) / time

    def _valley(self, k: Ints, at: Floats) -> tuple[Floats, Floats]:
        """Return the azimuth and the rate of the valley of node k at some moments."""
        time = at - self.moment[k]
        turning = self.bend[k] * time
        return self.line[k] + (self.rate[k] + 0.5 * turning) * time, self.rate[k] + turning

    def find_meeting(self, valley: _Crossings, bend: Floats, low: Floats, high: Floats) -> Floats:
        """Return the moment between two others at which the tip is over a moving valley. (n,) [rad]."""
        with np.errstate(invalid="ignore"):
            for _ in range(60):
                middle = 0.5 * (low + high)
                time = middle - valley.at
                short = self.azimuth(middle)[0] < valley.line + (valley.rate + 0.5 * bend * time) * time
                low, high = np.where(short, middle, low), np.where(short, high, middle)
        return 0.5 * (low + high)

    def spiral(self, angle: Floats) -> Spiral:
        at = self.sense * angle
        psi, rate = self.azimuth(at)
        radius, swing = self.radius(at), self.sense * (psi - at)
        cosine, sine = np.cos(swing), np.sin(swing)
        inward, turning = self.sense * self.slope, radius * (rate - 1)
        return Spiral(
            angle=angle, radius=radius * cosine, y=radius * sine,
            radius_rate=inward * cosine - turning * sine, y_rate=inward * sine + turning * cosine,
        )  # fmt: skip

    def sample_moments(self, found: _Crossings) -> Floats:
        """Return sample moments between every two of these valleys. (n,) [rad]."""
        edges = np.concatenate([self.line[:1], found.line, self.line[-1:]])
        between = edges[:-1, None] + np.diff(edges)[:, None] * (
            (np.arange(SAMPLES_PER_SWING) + 0.5) / SAMPLES_PER_SWING
        )
        goal = between.ravel()
        k = np.clip(np.searchsorted(self.line, goal, side="right") - 1, 0, self.line.size - 2)
        fixed = _Crossings(goal, goal, *np.zeros((5, goal.size)))
        return np.unique(self.find_meeting(fixed, np.zeros(1), self.moment[k], self.moment[k + 1]))


class _Reader:
    def __init__(self, base: Spiral, part: Part, edge: Edge) -> None:
        self.surface, self.edge, self.sense = part.surface, edge, base.sense
        # The rim that `place` uses for all tips.
        self.rim = max(part.reach, float(np.abs(base.radius + edge.dx).max()))

    def _tips(self, course: _Course, at: Floats, psi: Floats) -> Tips:
        swing = self.sense * (psi - at)
        radius = course.radius(at)
        return Tips(self.sense * at, radius * np.cos(swing), radius * np.sin(swing))

    def _touch_along(self, course: _Course, at: Floats) -> _Side:
        psi = course.azimuth(at)[0]
        top = touch_down(self.surface, self.edge, self._tips(course, at, psi), self.rim)
        piece = self.surface.piece(top.x, top.y)
        assert piece is not None  # noqa: S101 - only called for a surface in pieces
        return _Side(at, psi, top.z, top.sweep, top.x, top.y, piece)

    def _find_slopes(self, course: _Course, at: Floats, psi: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the derivatives of the height by azimuth and by moment, with the contact fixed on the edge."""
        with np.errstate(all="ignore"):
            _, zx, zy = self.surface.evaluate(x, y, 1)
        cosine, sine = np.cos(self.sense * psi), np.sin(self.sense * psi)
        radius = course.radius(at)
        tip_x, tip_y = radius * cosine, radius * sine
        by_azimuth = self.sense * (tip_x * zy - tip_y * zx)
        by_moment = course.slope * (cosine * zx + sine * zy) + self.sense * ((x - tip_x) * zy - (y - tip_y) * zx)
        return by_azimuth, by_moment

    def find_valleys(self, course: _Course, at: Floats, psi: Floats, sweeps: Floats) -> _Crossings:
        """Return the valleys near some azimuths at these moments, nan where there is none; ``sweeps`` is (2, n).

        Both sides are evaluated a small distance before and behind the valley, where the surface is certainly that of
        the lenslet, and extrapolated by their slopes.
        """
        psi, sweeps = psi.copy(), sweeps.copy()
        for distance in SIDE_OFFSETS:
            offset = distance * self.surface.feature_size / np.maximum(np.abs(course.radius(at)), 1e-300)
            heights, by_azimuth, by_moment = np.empty((3, 2, at.size))
            for side, way in enumerate((-1, 1)):
                there = psi + way * offset
                near = follow(self.surface, self.edge, self._tips(course, at, there), sweeps[side])
                by_azimuth[side], by_moment[side] = self._find_slopes(course, at, there, near.x, near.y)
                heights[side] = near.z - way * offset * by_azimuth[side]
                sweeps[side] = np.where(np.isfinite(near.z), near.sweep, sweeps[side])
            (steep,), (on,), (step,) = (np.diff(values, axis=0) for values in (by_azimuth, by_moment, heights))
            with np.errstate(all="ignore"):
                step = -step / steep
            step[~(np.abs(step * course.radius(at)) < self.surface.feature_size)] = np.nan
            psi += step
        with np.errstate(all="ignore"):
            return _Crossings(at, psi, -on / steep, steep, heights[0] + by_azimuth[0] * step, *sweeps)

    def crossings(self, course: _Course, at: Floats) -> _Crossings:
        """Return the valleys that a course passes, ascending, as detected between the samples at ``at``."""
        looked = self._touch_along(course, at)
        k = np.flatnonzero(looked.piece[1:] != looked.piece[:-1])
        low, high = looked.select(k), looked.select(k + 1)
        valleys = []
        for _ in range(MAX_BISECTIONS):
            if low.at.size == 0:
                break
            met = self._between(course, low, high)
            # The interval is not divided in the middle, where a tool may rest right over the valley.
            inside = low.at + 0.382 * (high.at - low.at)
            # Newton's method is used only for intervals as short as those of the first sampling.
            wide = (high.psi - low.psi) * np.abs(
                course.radius(low.at)
            ) > self.surface.feature_size / SAMPLES_PER_FEATURE
            middle = self._touch_along(course, np.where(wide, inside, met.at))
            # A third piece may rise above the valley of two: then there is a valley on both sides of it.
            third = (middle.piece != low.piece) & (middle.piece != high.piece)
            with np.errstate(invalid="ignore"):
                good = ~wide & ~third & (np.abs(middle.z - met.z) < HEIGHT_TOL_MM)
                valleys.append(met.select(good & (met.steep * (1 - met.rate) > MIN_JUMP)))
            failed = ~(wide | third | good)
            if failed.any():
                for values, others in zip(middle, self._touch_along(course, inside[failed]), strict=True):
                    values[failed] = others
            more = ~good & (high.at - low.at > MIN_INTERVAL_RAD)
            first, second = more & (middle.piece != low.piece), more & (middle.piece != high.piece)
            low, high = (
                _join_sides(low.select(first), middle.select(second)),
                _join_sides(middle.select(first), high.select(second)),
            )
        none = _Crossings(*np.empty((7, 0)))
        every = _Crossings(*(np.concatenate(parts) for parts in zip(none, *valleys, strict=True)))
        return every.select(np.argsort(every.at, kind="stable"))

    def _between(self, course: _Course, low: _Side, high: _Side) -> _Crossings:
        """Return the valley between both sides, without regard to a third piece."""
        at = 0.5 * (low.at + high.at)
        # First estimate: the intersection of both tangents.
        lines = []
        for side in (low, high):
            steep, on = self._find_slopes(course, side.at, side.psi, side.x, side.y)
            lines.append((side.z + on * (at - side.at) - steep * side.psi, steep))
        with np.errstate(all="ignore"):
            psi = (lines[0][0] - lines[1][0]) / (lines[1][1] - lines[0][1])
        room = MAX_VALLEY_RATE * (high.at - low.at)
        psi = np.where(np.isfinite(psi), np.clip(psi, low.psi - room, high.psi + room), 0.5 * (low.psi + high.psi))
        sweeps = np.stack([low.sweep, high.sweep])
        met = self.find_valleys(course, at, psi, sweeps)
        bend = np.zeros(at.size)
        for _ in range(PASSING_ITERATIONS):
            moment = np.clip(course.find_meeting(met, bend, low.at, high.at), low.at, high.at)
            time = moment - met.at
            with np.errstate(invalid="ignore", divide="ignore"):
                near = self.find_valleys(
                    course, moment, met.line + (met.rate + 0.5 * bend * time) * time, np.stack(met[5:])
                )
                bend = np.where(np.abs(time) > RATE_STEP_RAD * 1e-3, (near.rate - met.rate) / time, bend)
            met = near
        return met


def _match_valleys(found: _Crossings, stands: _Crossings) -> Bools:
    if stands.at.size == 0:
        return np.zeros(found.at.size, dtype=np.bool_)
    after = np.clip(np.searchsorted(stands.at, found.at), 1, max(stands.at.size - 1, 1))
    k = np.minimum(after, stands.at.size - 1)
    k = np.where(np.abs(stands.at[k - 1] - found.at) < np.abs(stands.at[k] - found.at), k - 1, k)
    near = stands.select(k)
    time = found.at - near.at
    off = np.abs(found.line - near.line - near.rate * time)
    return (off < VALLEY_TOL_RAD + time**2) & ~np.isnan(near.sweep_before)


def _join_sides(*sides: _Side) -> _Side:
    return _Side(*(np.concatenate(parts) for parts in zip(*sides, strict=True)))
