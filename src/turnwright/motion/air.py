r"""Cross air outside the outline of a part: lift the tool, turn faster, and lower it again.

Over a gap the tip leaves its path :math:`z_c(\theta)` for the height :math:`H` of the crossing and returns to it:

.. math:: z = (1 - S)\,z_c + S\,H, \qquad S(s) = 10 s^3 - 15 s^4 + 6 s^5,

with s from 0 to 1 in a time :math:`T_z` after the gap begins, and back before it ends. As H is nowhere below the path,
neither is the tip, and position, speed and acceleration are continuous. A quintic polynomial from the position, speed
and acceleration of the path to rest at H is tried first, as it needs no path to follow. Meanwhile the spindle
accelerates to :math:`\omega_p` and back at a trapezoidal acceleration, with the fastest :math:`\omega_p` that C, X and
Z allow. X stays on the spiral.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.machine import Axis, Machine
from turnwright.motion.limits import TURN, Course, find_axis_peaks

__all__ = ["cross_air", "cut_sections"]

UTILISATION = 0.95
"""Fraction of the limits that a crossing uses, so that rounded programs keep them."""

MIN_SETTLE_S, SETTLE_PERIODS, UNKNOWN_SERVO_HZ = 0.02, 2, 50.0
"""Time on the path at the speed of the cut before the tool meets the part again: at least so many seconds, or periods
of the slowest servo; and the frequency of a servo that states a response without one."""

SETTLING_SHARES = (1.0, 0.5, 0.25, 0.0)
"""Shares of this time that are tried, where the path is too uneven to be followed for longer."""

SPLINE_POINTS = 24
"""Points on the path before and after a gap, for a spline of the controller to forget the gap."""

LEAD_S = 0.3
"""Time in air before the first cut and after the last one, beyond the ramp of Z, for the spindle to start. [s]"""

POINTS_PER_RAMP = 24
"""Points of a program over a ramp of the spindle or of Z."""

MAX_AIR_STEP_RAD = math.radians(30)
"""Largest step of C in air."""

QUINTIC_SPEED, QUINTIC_ACCELERATION, QUINTIC_JERK = 15 / 8, 10 / math.sqrt(3), 60.0
"""Largest derivatives of the ramp of Z."""

ROUNDING = 0.2
"""Share of the ramp of the spindle speed in which its acceleration rises, and in which it falls."""

RAMP_ACCELERATION, RAMP_JERK = 1 / (1 - ROUNDING), 1 / (ROUNDING * (1 - ROUNDING))
"""Largest derivatives of this ramp."""

HALVINGS = 40
MAX_LONGER = 8
"""Times that the ramps of Z are made longer until they keep the limits."""

LONGER = 1.25

MIN_POINTS = 3
"""Points of a path from the last one that cuts before a gap to the first one after it."""

MIN_RAMP_S, MIN_RAMP_BLOCKS = 0.002, 4
"""Shortest ramp, in seconds and in the shortest blocks of the machine."""

MAX_SLOWER = 4.0
"""Largest ratio of the time of a crossing to that at the speed of the cut, or that the ramps of Z take."""

NEIGHBOURS = 8
"""Points of the cut on either side whose demands are compared with those of a crossing."""


class _Limits(NamedTuple):
    """Limits of an axis, infinite where it has none."""

    speed: float
    acceleration: float
    jerk: float

    @classmethod
    def of(cls, axis: Axis) -> _Limits:
        return cls(*(UTILISATION * (one or math.inf) for one in (axis.speed, axis.acceleration, axis.jerk)))


@dataclass(frozen=True)
class _Spindle:
    """The spindle angle over a crossing: from one speed to a faster one, and to a third."""

    ends: tuple[float, float]  # speeds before and after [rad/s]
    top: float
    ramps: tuple[float, float]  # durations [s]
    plateau: float  # [s]

    @property
    def duration(self) -> float:
        return sum(self.ramps) + self.plateau

    def at(self, time: Floats) -> tuple[Floats, Floats]:
        """Return the angle turned and the speed. Each (n,)."""
        turned, speed = self.top * time, np.full(time.size, self.top)
        for end, ramp, clock in zip(self.ends, self.ramps, (time, self.duration - time), strict=True):
            if ramp:
                share, sum_of_shares = _speed_ramp(np.clip(clock / ramp, 0.0, 1.0))
                rise = self.top - end
                speed -= rise * (1 - share)
                # The angle lost to the top speed: over the whole ramp half its time.
                lost = np.clip(clock / ramp, 0.0, 1.0) - sum_of_shares
                turned -= rise * ramp * (lost if clock is time else 0.5 - lost)
        return turned, speed

    def time_of(self, turned: Floats) -> Floats:
        """Return the times at which angles are reached. (n,) [s]."""
        clock = np.linspace(0, self.duration, 400)
        time = np.interp(turned, self.at(clock)[0], clock)
        for _ in range(4):
            angle, speed = self.at(time)
            time = np.clip(time + (turned - angle) / speed, 0.0, self.duration)
        return time


def _speed_ramp(s: Floats) -> tuple[Floats, Floats]:
    """Return the share of a change of speed, and its integral, at shares of the time of the ramp. Each (n,)."""
    r, most = ROUNDING, 1 / (1 - ROUNDING)
    t = np.minimum(s, 1 - s)
    share = np.where(t < r, most * t * t / (2 * r), most * (t - r / 2))
    integral = np.where(t < r, most * t**3 / (6 * r), most * (r * r / 6 + (t * t - r * r) / 2 - r * (t - r) / 2))
    late = s > 0.5
    return np.where(late, 1 - share, share), np.where(late, s - 0.5 + integral, integral)


def cut_sections(air: Floats) -> list[slice]:
    """Return the ranges of points that cut."""
    return [slice(int(run[0]), int(run[-1]) + 1) for run in _runs(np.isnan(air))]


def _runs(mask: Bools) -> list[Ints]:
    """Return the indices of each run of true values."""
    at = np.flatnonzero(mask)
    return np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if at.size else []


def cross_air(course: Course, air: Floats, machine: Machine) -> Course:
    """Return a course that crosses the air of a path faster and higher, with fewer points.

    Parameters
    ----------
    course
        Course of the path at the speed of the cut, its Z in contact.
    air
        Least Z where it crosses air, nan where it cuts. (n,) [mm]
    machine
        Machine with the limits of the axes.
    """
    size = course.time.size
    spline = "spline" in machine.controller.interpolation
    settle, cuts = _settling_time(machine), np.isnan(air)
    pieces: list[Course] = []
    before = 0
    for run in _runs(~cuts):
        leaves, meets = int(run[0]) - 1, int(run[-1]) + 1
        crossing, first, last = None, leaves, meets
        for share in SETTLING_SHARES:
            first, last = leaves, meets
            if leaves >= 0:
                first += round(share * SPLINE_POINTS) if spline else 0
            if meets < size:
                last -= round(share * SPLINE_POINTS) if spline else 0
                last = min(last, int(np.searchsorted(course.time, course.time[meets] - share * settle, "right")))
            if last - first >= MIN_POINTS:
                gap = _Crossing(course, air, cuts, machine, leaves=leaves, first=first, last=last, meets=meets)
                crossing = gap.make(at_any_rate=not share)
            if crossing is not None:
                break
        if crossing is None:
            continue
        if first >= 0:
            pieces.append(course.select(slice(before, first + 1)))
        pieces.append(crossing)
        before = last
    if before < size:
        pieces.append(course.select(slice(before, size)))
    return pieces[0].join(*pieces[1:])


def _settling_time(machine: Machine) -> float:
    """Return the time for the servos to settle after a crossing. [s]."""
    responses = [axis.response for axis in machine.axes.values() if axis.response is not None]
    slowest = min((getattr(one, "frequency_hz", UNKNOWN_SERVO_HZ) for one in responses), default=math.inf)
    return max(MIN_SETTLE_S, SETTLE_PERIODS / slowest)


class _Crossing:
    """One gap of a path, between its points ``first`` and ``last``; -1 or the size of the path at its ends.

    It follows the path from the point where it ``leaves`` the part to the first, and from the last to that where it
    ``meets`` the part again.
    """

    def __init__(
        self, course: Course, air: Floats, cuts: Bools, machine: Machine, *, leaves: int, first: int, last: int,
        meets: int,
    ) -> None:  # fmt: skip
        self.course, self.cuts, self.machine = course, cuts, machine
        self.leaves, self.first, self.last, self.meets = leaves, first, last, meets
        self.low, self.high = max(first, 0), min(last, course.time.size - 1)
        self.z = course.axes["Z"]
        inside = slice(self.low, self.high + 1)
        self.height = max(float(np.nanmax(air[inside])), float(self.z[inside].max()))
        self.limits = {letter: _Limits.of(machine.axes.get(letter, Axis())) for letter in course.axes}
        top = UTILISATION * machine.spindle_rpm * TURN / 60
        self.limits["C"] = self.limits["C"]._replace(speed=min(self.limits["C"].speed, top))
        self.turned = np.abs(course.axes["C"][inside] - course.axes["C"][self.low])
        self.shortest = 1 / (UTILISATION * machine.block_rate_hz)

    def make(self, *, at_any_rate: bool) -> Course | None:
        """Return the crossing with the points on the path around it; ``None`` to stay on the path.

        At an end of the path there is one ``at_any_rate``, even beyond the limits.
        """
        at_end = self.first < 0 or self.last == self.course.time.size
        up, down = self._ramp(self.low), self._ramp(self.high)
        for _ in range(MAX_LONGER):
            spindle = None if at_end else self._spindle(up + down)
            for direct in (True, False):
                made = self._end(up, down, direct=direct) if at_end else self._lift(spindle, up, down, direct=direct)
                if made is not None and self._keeps_limits(made):
                    return made
            up, down = LONGER * up, LONGER * down
        if at_end:
            return made if at_any_rate else None
        return self._bump() if at_any_rate else None

    def _ramp(self, point: int) -> float:
        """Return the time for the ramp of Z between a point of the path and the height of the crossing. [s]."""
        rise, limit = self.height - float(self.z[point]), self.limits["Z"]
        return max(
            QUINTIC_SPEED * rise / limit.speed,
            math.sqrt(QUINTIC_ACCELERATION * rise / limit.acceleration),
            math.cbrt(QUINTIC_JERK * rise / limit.jerk),
            MIN_RAMP_BLOCKS * self.shortest,
            MIN_RAMP_S,
        )

    def _speed(self, point: int) -> float:
        """Return the speed of C in the cut next to a point. [rad/s]."""
        c, time = self.course.axes["C"], self.course.time
        at = min(max(point + (1 if point == self.high else 0), 1), time.size - 1)
        return float(abs(c[at] - c[at - 1]) / (time[at] - time[at - 1]))

    def _spindle(self, least: float) -> _Spindle | None:
        """Return the fastest course of the spindle over the gap that takes at least a time [s]."""
        turned, ends = float(self.turned[-1]), (self._speed(self.low), self._speed(self.high))
        inside = slice(self.low, self.high + 1)
        advance = float(np.abs(np.diff(self.course.axes["X"][inside]) / np.diff(self.turned)).max())
        c, x = self.limits["C"], self.limits["X"]
        speed = min(c.speed, x.speed / max(advance, 1e-12))
        acceleration = min(c.acceleration, x.acceleration / max(advance, 1e-12))
        jerk = min(c.jerk, x.jerk / max(advance, 1e-12))
        if len(self.course.axes) > 3:  # Y swings over the angle: it must not swing faster
            speed = min(ends)

        def at(top: float) -> _Spindle:
            ramps = [
                max(
                    RAMP_ACCELERATION * abs(top - end) / acceleration,
                    math.sqrt(RAMP_JERK * abs(top - end) / jerk),
                    MIN_RAMP_S if top != end else 0.0,
                )
                for end in ends
            ]
            over = turned - sum((top + end) / 2 * ramp for end, ramp in zip(ends, ramps, strict=True))
            return _Spindle(ends, top, (ramps[0], ramps[1]), over / top)

        low, high = min(*ends, speed) * 1e-3, max(speed, *ends) if math.isfinite(speed) else 1e3 * max(ends)
        if at(high).plateau >= 0 and at(high).duration >= least:
            return at(high)
        for _ in range(HALVINGS):
            top = math.sqrt(low * high)
            one = at(top)
            if one.plateau >= 0 and one.duration >= least:
                low = top
            else:
                high = top
        made = at(low)
        slowest = turned / min(ends)
        return made if made.plateau >= 0 and least <= made.duration <= MAX_SLOWER * max(slowest, least) else None

    def _lift(self, spindle: _Spindle | None, up: float, down: float, *, direct: bool) -> Course | None:
        """Return the crossing with a course of the spindle; ``None`` if there is none, or no point for it."""
        if spindle is None:
            return None
        turned = self.turned
        wanted = np.concatenate([
            np.linspace(0, one, POINTS_PER_RAMP) + start
            for one, start in (
                (up, 0.0), (spindle.ramps[0], 0.0),
                (down, spindle.duration - down), (spindle.ramps[1], spindle.duration - spindle.ramps[1]),
            )
        ])  # fmt: skip
        plateau = np.arange(0.0, turned[-1], MAX_AIR_STEP_RAD)
        points = np.searchsorted(turned, np.append(spindle.at(np.sort(wanted))[0], plateau))
        points = np.unique(points[(points > 0) & (points < turned.size - 1)])
        if not points.size:
            return None
        time = spindle.time_of(turned[points])
        points, time = _space(points, time, spindle.duration, self.shortest)
        if not points.size:
            return None
        every = np.concatenate([[0], points, [turned.size - 1]])
        time = np.concatenate([[0.0], time, [spindle.duration]])
        return self._blend(self.low + every, time, spindle.at(time)[1], up, down, direct=direct)

    def _end(self, up: float, down: float, *, direct: bool) -> Course | None:
        """Return the way from the air to the first cut, or from the last cut to the air, at the speed of the cut."""
        time, size = self.course.time, self.course.time.size
        if self.first < 0:
            start = int(np.searchsorted(time, time[self.last] - (down + LEAD_S)))
            points = np.arange(min(start, self.last - 1), self.last + 1)
        else:
            end = int(np.searchsorted(time, time[self.first] + up + LEAD_S))
            points = np.arange(self.first, max(min(end, size - 1), self.first + 1) + 1)
        clock = time[points] - time[points[0]]
        speed = np.full(points.size, self._speed(self.high if self.first < 0 else self.low))
        if self.course.velocity:
            speed = np.abs(self.course.velocity["C"][points])
        if self.first < 0:
            return self._blend(points, clock, speed, 0.0, min(down, float(clock[-1])), direct=direct)
        return self._blend(points, clock, speed, min(up, float(clock[-1])), 0.0, direct=direct)

    def _blend(
        self, points: Ints, time: Floats, speed: Floats, up: float, down: float, *, direct: bool
    ) -> Course | None:
        """Return the course through points of the path, Z lifted over the times ``up`` and ``down`` [s].

        Directly from the speed and acceleration at both ends, if that stays above the path, else ``None``; or as a
        mixture with the path, which does so always.
        """
        axes = {letter: values[points] for letter, values in self.course.axes.items()}
        path, height = axes["Z"], self.height
        cut = np.abs(self.course.velocity["C"][points]) if self.course.velocity else speed
        velocity = {letter: values[points] / cut * speed for letter, values in self.course.velocity.items()}
        z, rate = np.full(time.size, height), np.zeros(time.size)
        for ramp, clock, point, way in ((up, time, self.low, 1), (down, time[-1] - time, self.high, -1)):
            on = clock < ramp
            s = clock[on] / ramp if ramp else clock[on]
            if direct:
                v, a = self._state(point)
                z[on], rate[on] = _quintic(s, ramp, path[0 if way > 0 else -1] - height, way * v, a)
                z[on] += height
                rate[on] *= way
            else:
                share, rise = s**3 * (10 - 15 * s + 6 * s * s), 30 * s * s * (1 - s) ** 2
                z[on] = path[on] + share * (height - path[on])
                if velocity:
                    rate[on] = (1 - share) * velocity["Z"][on] + way * rise / ramp * (height - path[on])
        if (z < path).any():
            return None
        if velocity:
            velocity["Z"] = rate
        z[[0, -1]] = np.where([up, down], path[[0, -1]], z[[0, -1]])
        return Course(time, {**axes, "Z": z}, velocity)

    def _state(self, point: int) -> tuple[float, float]:
        """Return speed and acceleration of Z on the path of the cut, next to a point. [mm/s, mm/s²]."""
        low = min(max(point - 1, 0), self.z.size - 3) if point == self.high else max(point - 2, 0)
        some = slice(low, low + 3)
        fit = np.polyfit(self.course.time[some] - self.course.time[point], self.z[some], 2)
        speed = float(self.course.velocity["Z"][point]) if self.course.velocity else float(fit[1])
        return speed, 2 * float(fit[0])

    def _bump(self) -> Course | None:
        """Return the crossing at the speed of the cut, lifted as far as the limits allow; ``None`` if they do not."""
        inside = slice(self.low, self.high + 1)
        course = self.course.select(inside)
        time = course.time - course.time[0]
        s = time / time[-1]
        lift = self.height - float(self.z[inside].max())
        for _ in range(HALVINGS):
            bump = lift * 64 * (s * (1 - s)) ** 3
            velocity = dict(course.velocity)
            if velocity:
                velocity["Z"] = velocity["Z"] + lift * 192 * (s * (1 - s)) ** 2 * (1 - 2 * s) / time[-1]
            made = Course(time, {**course.axes, "Z": course.axes["Z"] + bump}, velocity)
            if self._keeps_limits(made):
                return made
            lift /= 2
        return None

    def _keeps_limits(self, made: Course) -> bool:
        """Return whether a crossing keeps the limits, or demands no more than the cut around it."""
        pieces, cuts = [made], []
        if self.first >= 0:
            near = self.cuts[max(self.leaves - NEIGHBOURS, 0) : self.leaves + 1]
            count = max(near.size if near.all() else int(np.argmin(near[::-1])), 1)
            cuts.append(self.course.select(slice(self.leaves + 1 - count, self.leaves + 1)))
            pieces.insert(0, self.course.select(slice(self.leaves + 1 - count, self.first + 1)))
        if self.last < self.course.time.size:
            near = self.cuts[self.meets : self.meets + NEIGHBOURS + 1]
            count = max(near.size if near.all() else int(np.argmin(near)), 1)
            cuts.append(self.course.select(slice(self.meets, self.meets + count)))
            pieces.append(self.course.select(slice(self.last, self.meets + count)))
        joined = pieces[0].join(*pieces[1:])
        cut = [self._peaks(one) for one in cuts if one.time.size > NEIGHBOURS // 2]
        for letter, demand in self._peaks(joined).items():
            limit = self.limits[letter]
            for kind in ("speed", "acceleration", "jerk"):
                allowed = max([getattr(limit, kind) / UTILISATION, *(one[letter][kind] for one in cut)])
                if demand[kind] > allowed:
                    return False
        return True

    def _peaks(self, course: Course) -> dict[str, dict[str, float]]:
        every = np.arange(course.time.size)
        peaks = find_axis_peaks(course, every, self.machine, (False, False))
        return {letter: top for letter, (top, _) in peaks.items()}


def _quintic(s: Floats, length: float, start: float, speed: float, acceleration: float) -> tuple[Floats, Floats]:
    """Return position and speed on the way from a state to rest at 0, at shares of the time it takes. Each (n,)."""
    v, a = speed * length, acceleration * length * length / 2
    third, fourth, fifth = -10 * start - 6 * v - 3 * a, 15 * start + 8 * v + 3 * a, -6 * start - 3 * v - a
    position = start + s * (v + s * (a + s * (third + s * (fourth + s * fifth))))
    rate = v + s * (2 * a + s * (3 * third + s * (4 * fourth + s * 5 * fifth)))
    return position, rate / (length or 1.0)


def _space(points: Ints, time: Floats, duration: float, shortest: float) -> tuple[Ints, Floats]:
    """Return the points at least ``shortest`` apart in time, and from both ends."""
    chosen, last = [], 0.0
    for number, at in enumerate(time.tolist()):
        if at - last >= shortest and duration - at >= shortest:
            chosen.append(number)
            last = at
    return points[chosen], time[chosen]
