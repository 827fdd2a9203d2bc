r"""The quasi-elliptical tool servo: the tool stands still over the part while its path passes a sharp valley.

C turns steadily. With the tip at the distance :math:`\rho` from the axis, X and Y swing it along the cutting direction
by an angle :math:`\gamma` away from the rake plane, so that it cuts at the azimuth :math:`\psi = \theta + \gamma`,

.. math:: X = \rho\cos\gamma, \qquad Y = \rho\sin\gamma,

while the rake plane still holds the radial line of azimuth :math:`\theta`. Z is the exact height in that pose.

*Which valley.* The height of the tip is the greatest of those that each lenslet asks for by itself,
:math:`Z = \max_i Z_i(\rho, \psi, \theta)`, and it has a kink where the edge leaves one lenslet and touches the next,
:math:`D = Z_j - Z_i = 0`. A nose of finite radius touches beside its tip, so that is not where the tip passes the
border of two cells. Nor does it stay in its place: while the tip stands still, the rake plane turns on and the radius
grows smaller, and with them the azimuth :math:`\Psi(\theta)` of the valley goes on at the rate
:math:`q = -D_\theta/D_\psi`, some hundredths of the speed of the spindle. A tip that only stood still over the part
would leave a kink of :math:`D_\theta` in Z, hundreds of nanometres per radian; so it stands still over the valley.

*How it swings.* With moments :math:`t_k` and valleys :math:`\Psi_k(\theta)`, followed to their second derivative,

.. math:: \psi = (1 - \sigma)\,\Psi_k + \sigma\,\Psi_{k+1}, \qquad \sigma = s - \frac{\sin 2\pi s}{2\pi}, \qquad
   s = \frac{\theta - t_k}{t_{k+1} - t_k} .

First and second derivative of :math:`\sigma` vanish at either end, so that :math:`\psi - \Psi_k` passes zero with the
third power: D has no slope there, and Z no kink. Nothing drifts, since every valley is passed at its own moment.

Sources
-------
[Zhu2019]_ is the idea. Its nearest-lens rule (Eqs 4 and 5), the sign of Eq. 11, the end condition of Eq. 14 and the
pose of Eq. 18 are not used, see the errata. Where the Y axis is slow, the moments that keep its limit at the least
displacement are an isotonic regression [deLeeuw2009]_.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, TypedDict

import numpy as np

from turnwright._arrays import frozen
from turnwright._validate import check_numbers, positive
from turnwright.errors import InputError, LimitError
from turnwright.path import Spiral
from turnwright.placing import follow, touch
from turnwright.speed_profile import Speeds
from turnwright.strategy.base import Strategy
from turnwright.strategy.slow import SlowToolServo
from turnwright.units import Count, Feed, Flag, Size, Speed, Step, Thickness, unit

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats, Ints
    from turnwright.part import Part
    from turnwright.path import Path
    from turnwright.progress import Progress
    from turnwright.tool import Tool

__all__ = ["QuasiEllipticalToolServo", "Valleys"]

TURN = 2 * math.pi

LOOKS = 8
"""Places to a feature at which the path is looked at for valleys."""

FEWEST = 360
"""Such places to a turn, at least."""

AGAIN = 8
"""Places between two valleys at which a planned swing is looked at for others."""

BLOCK = 1 << 20
"""Such places that are held at once."""

BESIDE = (5e-3, 1e-5, 1e-5)
"""How far before and behind a valley either side is read, one step of Newton's method each, in features. The error of a
step goes with the square of it."""

CLOSER = 4
"""How often the moment at which a valley is passed is found anew, for the valley as it is then."""

MOST_HALVES = 40
"""How often an interval with a valley inside is divided."""

SHORTEST = 1e-6
"""An interval shorter than this is not: there the edge leaves a crest or the rim, and no valley. [rad]"""

OFF = 1e-6
"""A valley this far from another is another. [rad]"""

SAME = 1e-9
"""Heights that differ by less are the same. [mm]"""

APART = 1e-3
"""How far apart the rate of a valley is compared with itself. [rad]"""

SWING = 16
"""An interval longer than this many features is not swung over as a whole: two pitches of a lens array."""

WIDEST = 1.0
"""Nor is one longer than this. [rad]"""

LEFT = 1e-9
"""A kink of this much is none. [mm/rad]"""

FAINT = 1e-6
"""A kink below this does not shake a servo. [mm/rad]"""

ROUNDS = 6
"""How often a swing is planned anew for the valleys as they are in its own poses."""

MARGIN = 0.95
"""Share of the limit of Y that the swing itself may use; the turning radius takes some."""

FOLLOWS = 0.5
"""A valley that goes on at more than this share of the speed of the spindle is grazed, not passed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Valleys:
    """The valleys that a path passes, and what a swinging tool makes of them.

    Parameters
    ----------
    angle
        Spindle angle at which the swinging tool passes each. Ascending in the sense of the cut. (n,) [rad]
    azimuth
        Azimuth of the part under the tip at that moment, cumulative like the angle. (n,) [rad]
    radius
        Distance of the tip from the axis there. (n,) [mm]
    jump
        Kink in the height of a tool that does not swing. (n,) [mm/rad]
    left
        Kink that is left in that of the one that does. (n,) [mm/rad]
    stood
        Whether the tool stands still there and leaves less than 1e-6 mm/rad. Not where the policy for short intervals
        lets it pass, at the ends of the path, where the edge hangs over the rim, and where it passes within nanometres
        of a corner of three pieces. (n,)
    stroke
        Largest height above or below centre that the swing takes. [mm]
    """

    angle: Floats
    azimuth: Floats
    radius: Floats
    jump: Floats
    left: Floats
    stood: Bools
    stroke: float

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("angle", "azimuth", "radius", "jump", "left"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        self.stood.flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True)
class QuasiEllipticalToolServo(Strategy):
    r"""Quasi-elliptical tool servo: a slow tool servo whose tool swings along the cut, still at each sharp valley.

    Points and radii are those of a `SlowToolServo`; only the azimuth of the tip is another. Between two valleys that
    are an arc w apart the swing is at most :math:`w/2\pi` high and :math:`2\pi\rho^2\omega^2/w` quick, so that where a
    path cuts a corner of a cell the Y axis would have to jump. What to do there is for you to say:

    * ``short="merge"``: valleys less than ``shortest`` apart count as one, which lies between them; the tool passes
      each of them slowly, and Z keeps a part of its kinks.
    * ``short="skip"``: of two valleys less than ``shortest`` apart the one with the smaller kink is passed in motion.
    * ``short="slow"``: the tool stands still at all of them and takes its time from one to the next, so that Y keeps
      to ``y_acceleration``. That time is missing at the longer intervals on either side, where the tool is then ahead
      or behind: it costs stroke, not kinks. The spindle still turns steadily.

    Parameters
    ----------
    feed, spindle_rpm, spindle_speeds, points_per_rev, arc_length, max_step, inside_out, sense, lead_in
        As for a `SlowToolServo`; "slow" needs ``spindle_rpm``.
    along
        The tool is placed along "z".
    short
        Policy for short intervals between valleys: "merge", "skip" or "slow".
    shortest
        Length of an arc below which an interval is short, for "merge" and "skip". [mm]
    y_acceleration
        Limit of the Y axis, for "slow". [mm/s²]

    Raises
    ------
    InputError
        If a length is not positive, or the policy lacks what it needs or has what it does not.

    Notes
    -----
    Only what the piece numbers of the surface tell apart is a valley, see `Surface.piece`; a crest is none. The path is
    looked at eight times a feature, so that a piece cut in a chord shorter than that, and left on the side where it was
    entered, may be missed.

    Sources
    -------
    [Zhu2019]_, with errata; see the module.

    >>> QuasiEllipticalToolServo(feed=0.005, points_per_rev=3600, short="merge", shortest=0.01).short
    'merge'
    """

    kind = "quasi-elliptical tool servo"
    example = MappingProxyType({"feed": "8 um/rev", "points_per_rev": 1440, "short": "skip", "shortest": "10 um"})
    ways = ("points_per_rev", "arc_length", "max_step")
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
        check_numbers(self)
        self._check_speed()
        self._base()
        if self.short not in ("merge", "skip", "slow"):
            raise InputError(f'short is {self.short!r}, it must be "merge", "skip" or "slow": choose one')
        needed, other = ("y_acceleration", "shortest") if self.short == "slow" else ("shortest", "y_acceleration")
        if getattr(self, needed) is None or getattr(self, other) is not None:
            raise InputError(f'short="{self.short}" goes with {needed} and without {other}: give just that one')
        if self.short == "slow" and self.spindle_rpm is None:
            raise InputError('short="slow" needs the time that Y has, but no spindle_rpm is given: state it')
        positive(getattr(self, needed), needed, "mm/s^2" if self.short == "slow" else "mm")

    def _base(self) -> SlowToolServo:
        """Return the servo without the swing."""
        return SlowToolServo(
            feed=self.feed, spindle_rpm=self.spindle_rpm, points_per_rev=self.points_per_rev,
            arc_length=self.arc_length, max_step=self.max_step, inside_out=self.inside_out, sense=self.sense,
            lead_in=self.lead_in,
        )  # fmt: skip

    def spiral(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Spiral:
        """Return the swinging spiral for a part and a tool.

        Raises
        ------
        GougeError, LimitError
            As the spiral of a `SlowToolServo`.
        InputError
            If the surface has no pieces, so no valleys.
        LimitError
            If the Y axis is too slow for the spindle (``short="slow"``).
        """
        base = self._base().spiral(part, tool)
        return self._plan(base, part, tool, progress)[0].spiral(base.angle)

    def valleys(self, part: Part, tool: Tool, *, progress: Progress | None = None) -> Valleys:
        """Return the valleys of the path, and what the policy for short intervals costs at each. See `spiral`."""
        base = self._base().spiral(part, tool)
        course, found, stood = self._plan(base, part, tool, progress)
        swung = course.spiral(base.angle)
        psi, rate = course.azimuth(found.at)
        left = np.abs(found.steep * (rate - found.rate))
        return Valleys(
            angle=self.sense * found.at, azimuth=self.sense * psi, radius=course.radius(found.at),
            jump=found.steep * (1 - found.rate), left=left,
            stood=stood & (left < FAINT), stroke=float(np.abs(swung.y).max()),  # type: ignore[arg-type]
        )  # fmt: skip

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes at the points of a path: C the azimuth of the rake plane [rad], X, Y and Z the tip [mm]."""
        if path.y is None:
            raise InputError("the path has no y, so it is not of a swinging tool: place the spiral of this strategy")
        return {"C": path.angle, "X": path.radius, "Y": path.y, "Z": path.z}

    def _plan(
        self, base: Spiral, part: Part, tool: Tool, progress: Progress | None
    ) -> tuple[_Course, _Crossings, Bools]:
        """Return the swing, the valleys as they are met in its own poses, and at which of them it stands still."""
        if not part.surface.in_pieces:
            raise InputError(
                f"{type(part.surface).__name__} is one smooth piece, so there is no valley to stand still at: use a "
                "SlowToolServo"
            )
        begin, end = (float(angle) for angle in base.sense * base.angle[[0, -1]])
        edges = np.array([begin, end])
        slope = float(base.radius[-1] - base.radius[0]) / (end - begin)
        course = _Course(
            sense=base.sense, start=float(base.radius[0]) - slope * begin, slope=slope,
            longest=SWING * part.surface.feature_size, moment=edges, line=edges, rate=np.ones(2), bend=np.zeros(2),
        )  # fmt: skip
        reader = _Reader(base, part, tool)
        step = part.surface.feature_size / LOOKS
        turn = max(math.ceil(TURN * float(np.abs(base.radius).max()) / step), FEWEST)
        count = math.ceil((end - begin) / TURN * turn)
        together = max(1, BLOCK // turn) * turn
        blocks = []
        for first in range(0, count, together):
            last = min(first + together, count)
            # Whole steps of a turn, so that every turn has the same azimuths.
            blocks.append(reader.crossings(course, begin + np.arange(first, last + 1.0) * (TURN / turn)))
            if progress is not None:
                progress(last, count)
        found = _Crossings(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
        stands = self._stands(found, course)
        worst = found.at.size + 1
        for _ in range(ROUNDS):
            swung, stands = self._swing(reader, course, stands)
            found = reader.crossings(swung, swung.looks(found))
            stood = _among(found, stands)
            # Turned aside, the edge may touch a lenslet more or one less.
            new = self._stands(found, course)
            bad = int(np.count_nonzero(~_among(new, stands)))
            if self.short != "slow" or not 0 < bad < worst:
                break
            worst, stands = bad, new
        return swung, found, stood

    def _stands(self, found: _Crossings, course: _Course) -> _Crossings:
        """Return where the tool is to stand still."""
        # A grazed valley has no place to stand at, and at both ends of the path there is no room for half a swing.
        room = course.half(found.line)
        kept = found.some(
            (np.abs(found.rate) <= FOLLOWS)
            & (found.line - course.moment[0] >= room)
            & (course.moment[-1] - found.line >= room)
        )
        if kept.line.size < 2:
            return kept
        kept = kept.some(np.append(True, np.diff(np.maximum.accumulate(kept.line)) > OFF))
        if self.shortest is None:
            return kept
        radius = np.abs(course.radius(kept.line))
        if self.short == "skip":
            keep = np.arange(kept.line.size)
            while (close := np.diff(kept.line[keep]) * radius[keep[1:]] < self.shortest).any():
                first = np.flatnonzero(close & ~np.append(False, close[:-1]))
                weaker = kept.steep[keep[first]] <= kept.steep[keep[first + 1]]
                keep = np.delete(keep, np.where(weaker, first, first + 1))
            return kept.some(keep)
        close = np.diff(kept.line) * radius[1:] < self.shortest
        group = np.append(0, np.cumsum(~close))
        alone = np.bincount(group) == 1
        weight = np.bincount(group, kept.steep)
        line, rate = (np.bincount(group, kept.steep * values) / weight for values in (kept.line, kept.rate))
        one = kept.some(np.append(0, np.flatnonzero(~close) + 1))
        # One that was merged is a place and no valley: it has no contacts of its own.
        sweeps = (np.where(alone, sweep, np.nan) for sweep in (one.sweep_before, one.sweep_after))
        return _Crossings(line, line, rate, one.steep, one.z, *sweeps)

    def _swing(self, reader: _Reader, plain: _Course, stands: _Crossings) -> tuple[_Course, _Crossings]:
        """Return the course that stands still at these valleys, and where they are when it does."""
        begin, end = plain.moment[[0, -1]]
        line, rate = stands.line.copy(), stands.rate.copy()
        moment = line
        alone = np.flatnonzero(~np.isnan(stands.sweep_before))
        sweeps = np.stack([stands.sweep_before[alone], stands.sweep_after[alone]])
        for _ in range(3):
            moment = self._moments(plain, line, rate)
            met = reader.meet(plain, moment[alone], line[alone] + rate[alone] * (moment - stands.at)[alone], sweeps)
            good = np.isfinite(met.line)
            line[alone[good]], rate[alone[good]] = met.line[good], met.rate[good]
            stands = stands._replace(at=moment)
        bend = np.zeros(line.size)
        rates = [
            reader.meet(plain, moment[alone] + way * APART, line[alone] + way * APART * rate[alone], sweeps).rate
            for way in (-1, 1)
        ]
        bend[alone] = np.clip(np.nan_to_num((rates[1] - rates[0]) / (2 * APART)), -1.0, 1.0)
        # Where valleys are far apart the tool does not swing all the way.
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

    def _moments(self, plain: _Course, line: Floats, rate: Floats) -> Floats:
        """Return when the tool stands still at each valley."""
        if self.y_acceleration is None or line.size == 0:
            return line.copy()
        from scipy.optimize import isotonic_regression  # noqa: PLC0415 - costly to import

        omega = float(self.spindle_rpm) * TURN / 60  # type: ignore[arg-type]
        edges = np.concatenate([plain.moment[:1], line, plain.moment[-1:]])
        radius = np.abs(plain.radius(edges))
        # From one valley to the next, W on, in the time T, it asks for 2 pi rho (W - q T) (omega / T)^2, and where
        # the next one is faster by d for 4 rho d omega^2 / T more, at other places.
        rates = np.concatenate([[1.0], rate, [1.0]])
        share = omega**2 * np.maximum(radius[1:], radius[:-1]) / (MARGIN * self.y_acceleration)
        receding = np.maximum(-np.minimum(rates[1:], rates[:-1]), 0.0)
        linear = 0.5 * share * (TURN * receding + 4 * np.abs(np.diff(rates)))
        least = linear + np.sqrt(linear**2 + TURN * share * np.maximum(np.diff(edges), 0.0))
        taken = np.append(0.0, np.cumsum(least))
        weights = np.ones(edges.size)
        weights[[0, -1]] = 1e9  # the ends stay where they are
        moment = np.asarray(isotonic_regression(edges - taken, weights=weights).x) + taken
        off = float(np.abs(moment - edges).max())
        if off > WIDEST / 2:
            raise LimitError(
                f"Y would swing {off * float(radius.max()):.3g} mm away to keep y_acceleration "
                f"{self.y_acceleration:g} mm/s^2 at {self.spindle_rpm:g} rev/min, the limit is half a radian: turn "
                "slower"
            )
        return np.ascontiguousarray(moment[1:-1], dtype=np.float64)


class _Crossings(NamedTuple):
    """Valleys where a course meets them. Each (n,)."""

    at: Floats  # moment, that is the angle of the spindle along the cut [rad]
    line: Floats  # azimuth of the valley, along the cut, at that moment [rad]
    rate: Floats  # how fast that goes on with the spindle [rad/rad]
    steep: Floats  # kink in the height per azimuth of the tip [mm/rad]
    z: Floats  # height of the tip [mm]
    sweep_before: Floats  # where on the nose the edge touches on either side [rad]
    sweep_after: Floats

    def some(self, which: Ints | Bools) -> _Crossings:
        """Return some of them."""
        return _Crossings(*(values[which] for values in self))


class _Side(NamedTuple):
    """One end of intervals with a valley inside. Each (n,)."""

    at: Floats
    psi: Floats
    z: Floats
    sweep: Floats
    x: Floats  # contact
    y: Floats
    piece: Ints

    def some(self, which: Ints | Bools) -> _Side:
        """Return some of them."""
        return _Side(*(values[which] for values in self))  # type: ignore[arg-type]


class _Course(NamedTuple):
    """How the tip goes round the part: its azimuth for each moment, both along the cut, from node to node."""

    sense: int
    start: float  # radius at moment 0 [mm]
    slope: float  # of the radius [mm/rad]
    longest: float  # arc that is swung over as a whole [mm]
    moment: Floats  # nodes, where the tip is at `line` and goes on at `rate`
    line: Floats
    rate: Floats
    bend: Floats  # second derivative of its azimuth there [1/rad]

    def radius(self, at: Floats) -> Floats:
        """Return the distance of the tip from the axis. (n,) [mm]."""
        return self.start + self.slope * at

    def half(self, at: Floats) -> Floats:
        """Return the longest half of a swing. (n,) [rad]."""
        return 0.5 * np.minimum(self.longest / np.maximum(np.abs(self.radius(at)), 1e-300), WIDEST)

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
        """Return where the valley of node k is by then, and its rate."""
        time = at - self.moment[k]
        turning = self.bend[k] * time
        return self.line[k] + (self.rate[k] + 0.5 * turning) * time, self.rate[k] + turning

    def meets(self, valley: _Crossings, bend: Floats, low: Floats, high: Floats) -> Floats:
        """Return when the tip is over a valley that goes on as it does, between two moments. (n,) [rad]."""
        with np.errstate(invalid="ignore"):
            for _ in range(60):
                middle = 0.5 * (low + high)
                time = middle - valley.at
                short = self.azimuth(middle)[0] < valley.line + (valley.rate + 0.5 * bend * time) * time
                low, high = np.where(short, middle, low), np.where(short, high, middle)
        return 0.5 * (low + high)

    def spiral(self, angle: Floats) -> Spiral:
        """Return the tip at some angles of the spindle, with its rates."""
        at = self.sense * angle
        psi, rate = self.azimuth(at)
        radius, swing = self.radius(at), self.sense * (psi - at)
        cosine, sine = np.cos(swing), np.sin(swing)
        inward, turning = self.sense * self.slope, radius * (rate - 1)
        return Spiral(
            angle=angle, radius=radius * cosine, y=radius * sine,
            radius_rate=inward * cosine - turning * sine, y_rate=inward * sine + turning * cosine,
        )  # fmt: skip

    def looks(self, found: _Crossings) -> Floats:
        """Return moments, some between any two of these valleys. (n,) [rad]."""
        edges = np.concatenate([self.line[:1], found.line, self.line[-1:]])
        between = edges[:-1, None] + np.diff(edges)[:, None] * ((np.arange(AGAIN) + 0.5) / AGAIN)
        goal = between.ravel()
        k = np.clip(np.searchsorted(self.line, goal, side="right") - 1, 0, self.line.size - 2)
        fixed = _Crossings(goal, goal, *np.zeros((5, goal.size)))
        return np.unique(self.meets(fixed, np.zeros(1), self.moment[k], self.moment[k + 1]))


class _Pose(TypedDict):
    """Where the tool stands, as `touch` takes it. Each (n,)."""

    angle: Floats
    radius: Floats
    y: Floats


class _Reader:
    """Finds valleys in the path of a tip."""

    def __init__(self, base: Spiral, part: Part, tool: Tool) -> None:
        self.surface = part.surface
        self.tool = tool
        self.sense = base.sense
        # What `place` will leave out, for all tips alike.
        self.rim = max(part.radius, float(np.abs(base.radius + tool.offset[0]).max()))

    def _pose(self, course: _Course, at: Floats, psi: Floats) -> _Pose:
        swing = self.sense * (psi - at)
        radius = course.radius(at)
        return {"angle": self.sense * at, "radius": radius * np.cos(swing), "y": radius * np.sin(swing)}

    def _look(self, course: _Course, at: Floats) -> _Side:
        """Return what the edge touches at some moments of a course."""
        psi = course.azimuth(at)[0]
        pose = self._pose(course, at, psi)
        top = touch(self.surface, self.tool, **pose, sense=self.sense, rim=self.rim)
        piece = self.surface.piece(top.x, top.y)
        assert piece is not None  # noqa: S101 - only asked of a surface in pieces
        return _Side(at, psi, top.z, top.sweep, top.x, top.y, piece)

    def _slopes(self, course: _Course, at: Floats, psi: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the slopes of the height by azimuth and by moment, which only a contact fixed on the edge makes."""
        with np.errstate(all="ignore"):
            _, zx, zy = self.surface.evaluate(x, y, 1)
        cosine, sine = np.cos(self.sense * psi), np.sin(self.sense * psi)
        radius = course.radius(at)
        tip_x, tip_y = radius * cosine, radius * sine
        by_azimuth = self.sense * (tip_x * zy - tip_y * zx)
        by_moment = course.slope * (cosine * zx + sine * zy) + self.sense * ((x - tip_x) * zy - (y - tip_y) * zx)
        return by_azimuth, by_moment

    def meet(self, course: _Course, at: Floats, psi: Floats, sweeps: Floats) -> _Crossings:
        """Return the valleys near some azimuths at these moments, nan where there is none; ``sweeps`` is (2, n).

        Either side is read a little before or behind the valley, where its lenslet is sure to be the one that the
        surface has there, and carried over by its slope.
        """
        psi, sweeps = psi.copy(), sweeps.copy()
        for beside in BESIDE:
            aside = beside * self.surface.feature_size / np.maximum(np.abs(course.radius(at)), 1e-300)
            heights, by_azimuth, by_moment = np.empty((3, 2, at.size))
            for side, way in enumerate((-1, 1)):
                there = psi + way * aside
                pose = self._pose(course, at, there)
                near = follow(self.surface, self.tool, **pose, sweep=sweeps[side], sense=self.sense)
                by_azimuth[side], by_moment[side] = self._slopes(course, at, there, near.x, near.y)
                heights[side] = near.z - way * aside * by_azimuth[side]
                sweeps[side] = np.where(np.isfinite(near.z), near.sweep, sweeps[side])
            (steep,), (on,), (step,) = (np.diff(values, axis=0) for values in (by_azimuth, by_moment, heights))
            with np.errstate(all="ignore"):
                step = -step / steep
            step[~(np.abs(step * course.radius(at)) < self.surface.feature_size)] = np.nan
            psi += step
        with np.errstate(all="ignore"):
            return _Crossings(at, psi, -on / steep, steep, heights[0] + by_azimuth[0] * step, *sweeps)

    def crossings(self, course: _Course, at: Floats) -> _Crossings:
        """Return the valleys that a course passes, as far as places that far apart tell. Ascending."""
        looked = self._look(course, at)
        k = np.flatnonzero(looked.piece[1:] != looked.piece[:-1])
        low, high = looked.some(k), looked.some(k + 1)
        found = []
        for _ in range(MOST_HALVES):
            if low.at.size == 0:
                break
            met = self._between(course, low, high)
            # Not in the middle, where a tool may stand right over the valley.
            inside = low.at + 0.382 * (high.at - low.at)
            # Newton's method is for intervals as short as those of the first look.
            wide = (high.psi - low.psi) * np.abs(course.radius(low.at)) > self.surface.feature_size / LOOKS
            middle = self._look(course, np.where(wide, inside, met.at))
            # A third piece may stand above the valley of two: then there is one on either side of it.
            third = (middle.piece != low.piece) & (middle.piece != high.piece)
            with np.errstate(invalid="ignore"):
                good = ~wide & ~third & (np.abs(middle.z - met.z) < SAME)
                found.append(met.some(good & (met.steep * (1 - met.rate) > LEFT)))
            failed = ~(wide | third | good)
            if failed.any():
                for values, others in zip(middle, self._look(course, inside[failed]), strict=True):
                    values[failed] = others
            more = ~good & (high.at - low.at > SHORTEST)
            first, second = more & (middle.piece != low.piece), more & (middle.piece != high.piece)
            low, high = (
                _joined(low.some(first), middle.some(second)),
                _joined(middle.some(first), high.some(second)),
            )
        every = _Crossings(*(np.concatenate(parts) for parts in zip(*found, strict=True))) if found else _none()
        return every.some(np.argsort(every.at, kind="stable"))

    def _between(self, course: _Course, low: _Side, high: _Side) -> _Crossings:
        """Return the valley between either side, wherever a third piece stands."""
        at = 0.5 * (low.at + high.at)
        # To the first order the heights say where.
        lines = []
        for side in (low, high):
            steep, on = self._slopes(course, side.at, side.psi, side.x, side.y)
            lines.append((side.z + on * (at - side.at) - steep * side.psi, steep))
        with np.errstate(all="ignore"):
            psi = (lines[0][0] - lines[1][0]) / (lines[1][1] - lines[0][1])
        room = FOLLOWS * (high.at - low.at)
        psi = np.where(np.isfinite(psi), np.clip(psi, low.psi - room, high.psi + room), 0.5 * (low.psi + high.psi))
        sweeps = np.stack([low.sweep, high.sweep])
        met = self.meet(course, at, psi, sweeps)
        bend = np.zeros(at.size)
        for _ in range(CLOSER):
            moment = np.clip(course.meets(met, bend, low.at, high.at), low.at, high.at)
            time = moment - met.at
            with np.errstate(invalid="ignore", divide="ignore"):
                near = self.meet(course, moment, met.line + (met.rate + 0.5 * bend * time) * time, np.stack(met[5:]))
                bend = np.where(np.abs(time) > APART * 1e-3, (near.rate - met.rate) / time, bend)
            met = near
        return met


def _among(found: _Crossings, stands: _Crossings) -> Bools:
    """Return which valleys are among those where a tool stands still."""
    if stands.at.size == 0:
        return np.zeros(found.at.size, dtype=np.bool_)
    after = np.clip(np.searchsorted(stands.at, found.at), 1, max(stands.at.size - 1, 1))
    k = np.minimum(after, stands.at.size - 1)
    k = np.where(np.abs(stands.at[k - 1] - found.at) < np.abs(stands.at[k] - found.at), k - 1, k)
    near = stands.some(k)
    time = found.at - near.at
    off = np.abs(found.line - near.line - near.rate * time)
    return (off < OFF + time**2) & ~np.isnan(near.sweep_before)


def _joined(*sides: _Side) -> _Side:
    return _Side(*(np.concatenate(parts) for parts in zip(*sides, strict=True)))


def _none() -> _Crossings:
    return _Crossings(*np.empty((7, 0)))
