"""Cross air outside the outline of a part: lift the tool, turn faster, and lower it again.

A crossing takes the least time in which all axes go from their state on the path, where the tool has left the part, to
that where it meets the part again, with speed, acceleration and jerk within their limits. Z rises to the height of the
crossing, rests there and descends; where this takes longer than C and X need, they take as long. [Berscheid2021]_ has
the profiles, of at most seven phases of constant jerk.

A gap too short for this height is crossed at the speed of the cut, as high as there is time for; where the tool could
hardly be lifted at all, it stays on the path.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.machine import Axis, Machine
from turnwright.motion.limits import SPEED_POWERS, TURN, Course

if TYPE_CHECKING:
    from ruckig import Trajectory

__all__ = ["cross_air", "cut_sections"]

UTILISATION = 0.95
"""Fraction of the limits that a crossing uses, so that rounded programs keep them."""

CUBIC_SHARE = 0.9
"""Further share of the accelerations for a controller with cubics, which differ from the profiles in those blocks in
which the jerk changes."""

UNSTATED_SPEED, UNSTATED_RAMP_S, UNSTATED_ONSET_S = 50.0, 0.05, 0.01
"""Speed of a slide without a limit [mm/s]; time to reach the highest speed of an axis without a limit of acceleration,
and to reach its acceleration without one of jerk. [s]"""

MIN_SETTLE_S, SETTLE_PERIODS, UNKNOWN_SERVO_HZ = 0.02, 2, 50.0
"""Time on the path at the speed of the cut before the tool meets the part again: at least so many seconds, or periods
of the slowest servo; and the frequency of a servo that states a response without one."""

SETTLING_SHARES = (1.0, 0.5, 0.25, 0.0)
"""Shares of this time that are tried, where a gap is too short for all of it."""

SPLINE_POINTS = 24
"""Points on the path before and after a gap, for a spline of the controller to forget the gap."""

LEAD_S = 0.3
"""Time in air before the first cut and after the last one, beyond the ramp of Z, for the spindle to start. [s]"""

POINTS_PER_RAMP = 12
"""Points of a program over a ramp of Z, beyond the ends of the phases."""

MAX_AIR_STEP_RAD = math.radians(30)
"""Largest step of C in air."""

MIN_POINTS = 3
"""Points of a path from the last one that cuts before a gap to the first one after it."""

STATE_POINTS = 3
"""Points of the parabola that gives the state at the end of a crossing."""

UNEVEN_POINTS = 3
"""Points that a crossing keeps away from one where the path demands more than the limits: blocks of a jerk."""

MAX_BELOW_MM = 1e-4
"""Depth below the path, outside the part, up to which the parabola at the end of a crossing is taken for the path."""

SLOWER = (1.5, 2.0, 3.0)
"""Ratios that are tried, where the path rises faster than Z can while C turns."""

MAX_SLOWER = 4.0
"""Largest ratio of the time of a crossing to that at the speed of the cut, or that the ramps of Z take."""

ROOM = 1 + 1e-9
"""Factor of the limits above a state that reaches them."""

MIN_LIFT = 0.01
"""Share of the height above the path from which a lift is worth while."""


class _State(NamedTuple):
    """Position, speed and acceleration of the axes. Each (axes,)."""

    position: Floats
    speed: Floats
    acceleration: Floats

    def reverse(self) -> _State:
        """Return the state reversed in time."""
        return _State(self.position, -self.speed, self.acceleration)


class _Limits(NamedTuple):
    """Limits of some axes. Each (axes,)."""

    speed: Floats
    acceleration: Floats
    jerk: Floats

    @classmethod
    def of(cls, machine: Machine, letters: list[str]) -> _Limits:
        """Return the limits of a machine that a crossing uses, finite ones also where the machine states none."""
        limits = []
        for letter in letters:
            axis = machine.axes.get(letter, Axis())
            speed = axis.speed or UNSTATED_SPEED
            if letter == "C":
                speed = min(axis.speed or math.inf, machine.spindle_rpm * TURN / 60)
            acceleration = axis.acceleration or speed / UNSTATED_RAMP_S
            limits.append((speed, acceleration, axis.jerk or acceleration / UNSTATED_ONSET_S))
        return cls(*(UTILISATION * np.array(limits).T))


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

    Sources
    -------
    [Berscheid2021]_ the profiles of least time, by the library of its authors.
    """
    crossings = _Crossings(course, air, machine)
    pieces: list[Course] = []
    before, size = 0, course.time.size
    for run in _runs(~np.isnan(air)):
        made = crossings.cross(int(run[0]) - 1, int(run[-1]) + 1, before + STATE_POINTS - 1 if pieces else 0)
        if made is None:
            continue
        first, crossing, last = made
        if first >= 0:
            pieces.append(course.select(slice(before, first + 1)))
        pieces.append(crossing)
        before = last
    if before < size:
        pieces.append(course.select(slice(before, size)))
    return pieces[0].join(*pieces[1:])


class _Crossings:
    """Crossings of the gaps of a path, of which ``leaves`` and ``meets`` are the last cut before and the first after.

    They are -1 and the size of the path where it begins or ends in air.
    """

    def __init__(self, course: Course, air: Floats, machine: Machine) -> None:
        self.course, self.air, self.machine = course, air, machine
        self.letters = ["C", "Z", *(letter for letter in course.axes if letter not in {"C", "Z"})]
        self.limits = _Limits.of(machine, self.letters)
        if machine.controller.interpolation == "hermite":
            self.limits = self.limits._replace(acceleration=CUBIC_SHARE * self.limits.acceleration)
        self.axes = np.stack([course.axes[letter] for letter in self.letters], axis=1)
        self.sense = 1.0 if self.axes[-1, 0] >= self.axes[0, 0] else -1.0
        self.axes[:, 0] *= self.sense
        self.velocity = None
        if course.velocity:
            self.velocity = np.stack([course.velocity[letter] for letter in self.letters], axis=1)
            self.velocity[:, 0] *= self.sense
        self.shortest = 1 / (UTILISATION * machine.block_rate_hz)
        self.margin = SPLINE_POINTS if "spline" in machine.controller.interpolation else 0

    def cross(self, leaves: int, meets: int, least: int) -> tuple[int, Course, int] | None:
        """Return a crossing and the points of the path where it begins and ends; ``None`` to stay on the path.

        It begins at the point ``least`` or later.
        """
        size = self.course.time.size
        at_end = leaves < 0 or meets >= size
        ways = [(False, False)] if at_end else [(False, False), (True, False)]
        if at_end or self.uneven[leaves + 1 : meets].any():  # it cannot stay on the path
            ways += [(lower, True) for lower, _ in ways]
        for lower, touches in ways:
            for first, last in self._ends(leaves, meets, least):
                if first < 0:
                    made = self._lead(last, slice(0, last + 1), entering=True, touches=touches)
                elif last >= size:
                    made = self._lead(first, slice(first, size), entering=False, touches=touches)
                else:
                    made = self._lift(first, last, lower=lower, touches=touches)
                if made is not None:
                    return first, made, last
        return None

    def _ends(self, leaves: int, meets: int, least: int) -> list[tuple[int, int]]:
        """Return the points between which a gap may be crossed, those with the most time to settle first."""
        time, size = self.course.time, self.course.time.size
        latest, earliest = self._even_ends(leaves, meets)
        ends = []
        for share in SETTLING_SHARES:
            margin, first, last = round(share * self.margin), leaves, meets
            if leaves >= 0:
                first = min(max(min(leaves + margin, latest), least), size - 1)
            if meets < size:
                settled = int(np.searchsorted(time, time[meets] - share * self.settle, "right"))
                last = max(min(meets - margin, settled), earliest, 0)
            if last - first >= MIN_POINTS and (first, last) not in ends:
                ends.append((first, last))
        return ends or ([(leaves, meets)] if leaves < 0 or meets >= size else [])

    @cached_property
    def settle(self) -> float:
        """Time for the servos to settle after a crossing. [s]."""
        responses = [axis.response for axis in self.machine.axes.values() if axis.response is not None]
        slowest = min((getattr(one, "frequency_hz", UNKNOWN_SERVO_HZ) for one in responses), default=math.inf)
        return max(MIN_SETTLE_S, SETTLE_PERIODS / slowest)

    @cached_property
    def uneven(self) -> Bools:
        """Whether the path demands more than the limits at a point, and more than its cuts do anywhere. (n,)."""
        time, cuts = self.course.time, np.isnan(self.air)
        marks = np.zeros(time.size, dtype=np.bool_)
        for k, letter in enumerate(self.letters):
            values, at = self.axes[:, k], time
            cutting, axis = cuts, self.machine.axes.get(letter, Axis())
            for order, kind in enumerate(SPEED_POWERS, 1):
                # The mean of the times gives divided differences, up to factors near 1.
                values, at = np.diff(values) / np.diff(at), (at[1:] + at[:-1]) / 2
                cutting = cutting[1:] & cutting[:-1]
                stated = getattr(axis, kind)
                if stated is not None:
                    most = max(float(np.abs(values[cutting]).max(initial=0.0)), stated)
                    over = np.flatnonzero(np.abs(values) > most * (1 + 1e-6))
                    marks[over] = True
                    marks[over + order] = True
        return marks

    def _even_ends(self, leaves: int, meets: int) -> tuple[int, int]:
        """Return the last point before, and the first after all uneven ones of a gap."""
        rough = np.flatnonzero(self.uneven[leaves + 1 : meets]) + leaves + 1
        if not rough.size:
            return meets, leaves
        return max(int(rough[0]) - UNEVEN_POINTS, leaves), min(int(rough[-1]) + UNEVEN_POINTS, meets)

    def _state(self, point: int, *, before: bool) -> _State:
        """Return the state on the path at a point, of the parabola through it and two points before, or after it."""
        size = self.course.time.size
        low = min(max(point - 2, 0), size - 3) if before else min(point, size - 3)
        near = slice(low, low + 3)
        time, axes = self.course.time[near], self.axes[near]
        slopes = np.diff(axes, axis=0) / np.diff(time)[:, np.newaxis]
        acceleration = 2 * (slopes[1] - slopes[0]) / (time[2] - time[0])
        speed = slopes[0] + acceleration * (self.course.time[point] - (time[0] + time[1]) / 2)
        if self.velocity is not None:
            rates = self.velocity[[point - 1, point] if before and point else [point, point + 1]]
            speed, acceleration = self.velocity[point], np.diff(rates, axis=0)[0] / np.diff(time)[1 if before else 0]
        acceleration[0] = 0.0  # the spindle runs at the speed of the cut
        return _State(self.axes[point].copy(), speed, acceleration)

    def _height(self, inside: slice) -> float:
        """Return the height of a crossing over a range of points of the path. [mm]."""
        return max(float(np.nanmax(self.air[inside])), float(self.axes[inside, 1].max()))

    def _lead(self, point: int, run: slice, *, entering: bool, touches: bool) -> Course | None:
        """Return the way from the air to the first cut, or from the last one to the air, C at the speed of the cut."""
        height, on_path = self._height(run), self._state(point, before=not entering)
        ramp = self._rise(on_path.reverse() if entering else on_path, height)
        if ramp is None:
            return None
        duration = ramp.duration + LEAD_S
        points = np.arange(self.course.time.size)[run]
        rate = (self.axes[points[-1]] - self.axes[points[0]]) / np.ptp(self.course.time[points])
        rate[0] = on_path.speed[0]
        there = _State(on_path.position + (-1 if entering else 1) * duration * rate, rate, np.zeros(rate.size))
        there.position[1] = height
        ends = (there, on_path) if entering else (on_path, there)
        turn = self._turn(*ends, duration)
        if turn is None:
            return None
        up, down = (None, ramp) if entering else (ramp, None)
        return self._sample(ends, turn, up, down, height, run, touches=touches)

    def _lift(self, first: int, last: int, *, lower: bool, touches: bool) -> Course | None:
        """Return a crossing between two points of the path; ``None`` if there is none within the limits.

        ``lower`` than its height, with C at the speed of the cut, if there is no time for it. If it ``touches`` the
        path it follows it there, even beyond the limits.
        """
        inside = slice(first, last + 1)
        ends = self._state(first, before=True), self._state(last, before=False)
        height, natural = self._height(inside), float(self.course.time[last] - self.course.time[first])
        if not lower:
            up, down, turn = self._rise(ends[0], height), self._rise(ends[1].reverse(), height), self._turn(*ends, 0.0)
            least = math.inf if up is None or down is None else up.duration + down.duration
            for wanted in (least, max(natural, least), *(factor * max(natural, least) for factor in SLOWER)):
                if turn is not None and turn.duration < wanted:
                    turn = self._turn(*ends, wanted)
                if turn is None or turn.duration > MAX_SLOWER * max(natural, least):
                    return None
                made = self._sample(ends, turn, up, down, height, inside, touches=touches)
                if made is not None:
                    return made
            return None
        turn = self._turn(*ends, natural)
        if turn is None or turn.duration > MAX_SLOWER * natural:
            return None
        lowest = float(self.axes[inside, 1].max())
        low, high, made = lowest, height, None
        while high - low > MIN_LIFT * (height - lowest):
            tried = (low + high) / 2
            up, down = self._rise(ends[0], tried), self._rise(ends[1].reverse(), tried)
            one = None
            if up is not None and down is not None and up.duration + down.duration <= turn.duration:
                one = self._sample(ends, turn, up, down, tried, inside, touches=touches)
            if one is None:
                high = tried
            else:
                low, made = tried, one
        return made

    def _turn(self, start: _State, end: _State, least: float) -> Trajectory | None:
        """Return the motion of all axes but Z between two states, of at least a duration [s]."""
        if math.isinf(least):
            return None
        some = [0, *range(2, len(self.letters))]
        made = _find_profile(
            _State(*(part[some] for part in start)), _State(*(part[some] for part in end)),
            _Limits(*(part[some] for part in self.limits)), least,
        )  # fmt: skip
        if made is not None and min(made.profiles[0][0].v) <= 0:
            return None  # C would turn back
        return made

    def _rise(self, start: _State, height: float) -> Trajectory | None:
        """Return the motion of Z from a state to rest at a height."""
        target = _State(np.array([height]), np.zeros(1), np.zeros(1))
        return _find_profile(
            _State(*(part[1:2] for part in start)), target, _Limits(*(part[1:2] for part in self.limits)), 0.0
        )

    def _sample(
        self,
        ends: tuple[_State, _State],
        turn: Trajectory,
        up: Trajectory | None,
        down: Trajectory | None,
        height: float,
        inside: slice,
        *,
        touches: bool,
    ) -> Course | None:
        """Return the course of a crossing at the points of its program; ``None`` if it is below the path."""
        duration = turn.duration
        steps = math.ceil((ends[1].position[0] - ends[0].position[0]) / MAX_AIR_STEP_RAD)
        knots, more = [_knots(turn)], [np.linspace(0, duration, steps + 1)]
        ramps = [(ramp, way) for ramp, way in ((up, 1), (down, -1)) if ramp is not None]
        for ramp, way in ramps:
            for times, one in ((knots, _knots(ramp)), (more, np.linspace(0, ramp.duration, POINTS_PER_RAMP + 1))):
                times.append(one if way > 0 else duration - one)
        time = np.array([0.0, duration])
        for times in (knots, more):  # in a block over a knot, cubics differ from the profiles
            time = _add_spaced(time, np.sort(np.concatenate(times)), self.shortest)
        position, speed = _evaluate(turn, time)
        position += np.delete(ends[0].position, 1)
        axes, velocity = np.insert(position, 1, height, axis=1), np.insert(speed, 1, 0.0, axis=1)
        for ramp, way in ramps:
            clock = time if way > 0 else duration - time
            on = np.flatnonzero(clock < ramp.duration)
            z, rate = _evaluate(ramp, clock[on])
            axes[on, 1], velocity[on, 1] = ends[0 if way > 0 else 1].position[1] + z[:, 0], way * rate[:, 0]
        for row, end in zip((0, -1), ends, strict=True):
            axes[row], velocity[row] = end.position, end.speed
        path = self.axes[inside]
        if touches:
            axes[:, 1] = np.maximum(axes[:, 1], np.interp(axes[:, 0], path[:, 0], path[:, 1]))
        # Between two points of the crossing there are many of the path, which may rise there.
        if (np.interp(path[:, 0], axes[:, 0], axes[:, 1], right=np.inf) < path[:, 1] - MAX_BELOW_MM).any():
            return None
        return self._course(time, axes, velocity)

    def _course(self, time: Floats, axes: Floats, velocity: Floats) -> Course:
        axes[:, 0] *= self.sense
        velocity[:, 0] *= self.sense
        named = {letter: axes[:, k] for k, letter in enumerate(self.letters)}
        rates = {letter: velocity[:, k] for k, letter in enumerate(self.letters)} if self.velocity is not None else {}
        return Course(
            time, {letter: named[letter] for letter in self.course.axes},
            {letter: rates[letter] for letter in self.course.velocity},
        )  # fmt: skip


def _find_profile(start: _State, end: _State, limits: _Limits, least: float) -> Trajectory | None:
    """Return the motion between two states in the least time, or a duration [s] if it is longer; ``None`` if none.

    A state beyond the limits, as the path may have, is one of its own.
    """
    from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory  # noqa: PLC0415 - costly to import

    count = start.position.size
    task, made = InputParameter(count), Trajectory(count)
    task.current_position, task.target_position = np.zeros(count), end.position - start.position
    task.current_velocity, task.target_velocity = start.speed, end.speed
    task.current_acceleration, task.target_acceleration = start.acceleration, end.acceleration
    task.max_velocity = np.maximum.reduce([limits.speed, *(ROOM * np.abs(one.speed) for one in (start, end))])
    most = [limits.acceleration, *(ROOM * np.abs(one.acceleration) for one in (start, end))]
    task.max_acceleration, task.max_jerk = np.maximum.reduce(most), limits.jerk
    if least:
        task.minimum_duration = least
    try:
        result = Ruckig(count).calculate(task, made)
    except RuckigError:  # it finds none, such as for a duration of many revolutions
        return None
    return made if result == Result.Working else None


def _knots(motion: Trajectory) -> Floats:
    """Return the times at which the jerk of any axis changes. (n,) [s]."""
    return np.concatenate([one.brake.duration + np.cumsum([0.0, *one.t]) for one in motion.profiles[0]])


def _evaluate(motion: Trajectory, time: Floats) -> tuple[Floats, Floats]:
    """Return the way from the start and the speed. Each (n, axes)."""
    states = np.array([motion.at_time(at)[:2] for at in time.tolist()])
    return states[:, 0], states[:, 1]


def _add_spaced(times: Floats, more: Floats, shortest: float) -> Floats:
    """Return times and those of others that are at least ``shortest`` from every one. (n,) [s]."""
    following = np.searchsorted(times, more, "right").clip(1, times.size - 1)
    free = (more - times[following - 1] >= shortest) & (times[following] - more >= shortest)
    chosen = [-math.inf]
    for at in more[free].tolist():
        if at - chosen[-1] >= shortest:
            chosen.append(at)
    return np.sort(np.concatenate([times, chosen[1:]]))
