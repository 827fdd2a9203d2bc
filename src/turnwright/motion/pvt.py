"""Coming to speed and to rest within every limit, block by block."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright.errors import LimitError
from turnwright.machine import ROTARY
from turnwright.motion.limits import (
    SLACK,
    TURN,
    Course,
    LimitDemand,
    axis_peaks,
    first_limit,
    highest_pace,
    limit_demands,
)
from turnwright.path import STRAIGHT, TURNED, Motion

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright._arrays import Floats, Ints
    from turnwright.machine import Machine

__all__ = ["fastest_course", "reach_stated_speed", "slowed_to_limits"]

ROUNDED = 3e-10
"""A speed that is sought is left as it is up to this share above a limit: a jerk is then within 1e-9 of its own."""

SHORTEST_RAMP_S = 0.2
"""Time that a motion takes to come to its speed at least."""

SHORTEST_RAMP = 1 / 40
"""But of the angle that is turned no more than this share."""

ROOM = 0.98
"""Share of a limit that coming to a stated speed uses at most, unless the speed is near to the highest."""

RAMP_STEP = 1.1
"""Each way of coming to speed that is tried takes so many times the angle of the one before."""

DIVIDED = (1, 2, 4, 8)
"""Blocks while speeding up are not shorter than the shortest of the motion over the first of these that will do."""

ROUNDS = 8
"""How often a motion is gone along at the speed that it was found to allow, at most."""

FEWEST = 4
"""Points that show a jerk."""

DIGITS = 1e-6
"""A highest speed is printed lower by this share, so that it is possible with the digits that are printed."""


def from_rest_to_rest(motion: Motion) -> Motion:
    """Return a motion in velocities along the same path, from rest to rest.

    It has the speed of the motion given between the ends, or the highest one that the limits of its machine allow if
    that is less; see `drive`.

    Raises
    ------
    LimitError
        If the path has too few points to come to any speed.
    """
    assert motion.velocity is not None  # noqa: S101 - for the type checker
    course = Course(motion.time - motion.time[0], motion.axes, motion.velocity)
    made = _with_ends(course, motion.machine, stated=True)
    if made.pace == 1 and not any(one.exceeded for one in _of_points(made.course, motion.machine)):
        course = made.course
    else:
        fastest = fastest_course(course, motion.machine)
        course = slowed_to_limits(fastest.quicker(min(1.0, course.top_rpm / fastest.top_rpm)), motion.machine)
    return replace(motion, time=course.time, axes=course.axes, velocity=course.velocity)


def slowed_to_limits(course: Course, machine: Machine) -> Course:
    """Return a course slowed down by the little that it is above a limit: rounding, and what its ends take."""
    for _ in range(ROUNDS):
        room = highest_pace(course, machine)
        if room >= 1 - ROUNDED:
            break
        course = course.quicker(room)
    return course


class _Ends(NamedTuple):
    """A course from rest to rest."""

    course: Course
    inner: slice  # of the points of the course given, those at full speed
    pace: float  # how much quicker coming to speed and to rest may be, at most 1


def reach_stated_speed(course: Course, machine: Machine, *, subject: str) -> Course:
    """Return a course from rest to rest that reaches its stated speed; ``subject`` begins the message if none can."""
    made = _with_ends(course, machine, stated=True)
    if made.pace == 1 and not any(one.exceeded for one in _of_points(made.course, machine)):
        return made.course
    fastest = fastest_course(course, machine)
    highest, rpm = fastest.top_rpm, course.top_rpm
    if highest >= rpm:
        return fastest.quicker(rpm / highest)
    if made.pace == 1:  # what the path itself asks for is too much, as `check_limits` says
        return made.course
    turns = abs(float(course.axes["C"][-1] - course.axes["C"][0])) / TURN
    raise LimitError(
        f"{subject} {rpm:.7g} rev/min, the limit of {machine.name} from rest to rest along this path of {turns:.4g} "
        f"turns is {highest * (1 - DIGITS):.7g} rev/min, set by the {first_limit(fastest, machine).name}: turn "
        "slower, state none to have the highest speed found, or give the path more turns"
    )


def fastest_course(course: Course, machine: Machine) -> Course:
    """Return a course from rest to rest at the highest speed that keeps every limit."""
    course = course.quicker(highest_pace(course, machine))
    # The first and last bit of a path do not count, since they are passed at less, nor what longer ends then take.
    best = _at_speed_of(course, _shortest_ends(course), machine)
    for _ in range(ROUNDS):
        more = _at_speed_of(course, best.inner, machine)
        if more.course.top_rpm < best.course.top_rpm * (1 + SLACK):
            break
        best = more
    return best.course


def _at_speed_of(course: Course, inner: slice, machine: Machine) -> _Ends:
    """Return a course from rest to rest at the speed that some of its points allow, or lower where its ends ask so."""
    own = course.some(inner)
    if own.time.size >= FEWEST:
        course = course.quicker(highest_pace(own, machine))
    made = _with_ends(course, machine, stated=False)
    return made._replace(course=made.course.quicker(highest_pace(made.course, machine)))


def _shortest_ends(course: Course) -> slice:
    """Return which points of a course have its speed if it comes to it, and to rest, as soon as it ever does."""
    time = course.time - course.time[0]
    phase = min(SHORTEST_RAMP_S / 2, SHORTEST_RAMP * time[-1])
    return slice(int(np.searchsorted(time, phase)), int(np.searchsorted(time, time[-1] - phase, "right")))


def _with_ends(course: Course, machine: Machine, *, stated: bool) -> _Ends:
    """Return a course from rest to rest.

    Coming to speed and to rest keeps every limit. At a stated speed it keeps some room, so that it is not what binds,
    and may ask for what the course itself asks for where that is more.
    """
    limits = {
        one.name: max(ROOM * one.limit, one.value) if stated else one.limit for one in _of_points(course, machine)
    }
    points = course.time.size
    begin = _speeding_up(course, machine, limits)
    end = _speeding_up(course.backwards(), machine, limits)
    if begin is None or end is None:
        turned = abs(float(course.axes["C"][-1] - course.axes["C"][0]))
        raise LimitError(
            f"the path has {points} points in {turned:.3g} rad, too few to come to speed and to rest along it on "
            f"{machine.name}: give it more turns or more points per turn"
        )
    inner = slice(begin.last, points - end.last)
    made = begin.course.then(course.some(inner)).then(end.course.backwards())
    return _Ends(made, inner, min(begin.pace, end.pace, 1.0))


def _of_points(course: Course, machine: Machine) -> list[LimitDemand]:
    """Return what a course without a fast tool asks of the limits, but for the bandwidths."""
    every = np.arange(course.time.size)
    return limit_demands(course, every, axis_peaks(course, every, machine), machine, bands=False)


class _Ramp(NamedTuple):
    """How a course comes from rest to its speed."""

    course: Course
    last: int  # number of the point from which on it has its speed
    pace: float  # how much quicker this may be, by the limits


def _speeding_up(course: Course, machine: Machine, limits: Mapping[str, float]) -> _Ramp | None:
    """Return the shortest way to the speed of a course that keeps the limits, or else the one nearest to that.

    Nothing if the course has too few points.
    """
    time = course.time - course.time[0]
    middle = int(np.searchsorted(time, time[-1] / 2 * (1 + ROUNDED), "right")) - 1
    if middle == 0:
        return None
    shortest = _shortest_ends(course).start
    # Steps down from the middle, so that the same ramps are tried at any speed.
    longer = max(0, math.floor(math.log(time[middle] / time[shortest], RAMP_STEP)))
    phase = np.append(time[shortest], time[middle] / RAMP_STEP ** np.arange(longer, -1, -1.0))
    numbers = np.unique(np.searchsorted(time, phase * (1 - ROUNDED)).clip(1, middle))
    own = float(np.diff(time).min())
    best: _Ramp | None = None
    for last in numbers.tolist():
        made = _ramp(course, last, own)
        if made is None:
            continue
        asked = _of_points(made.then(course.some(slice(last, last + 2))), machine)
        pace = min(one._replace(limit=limits[one.name]).pace for one in asked)
        if best is None or pace > best.pace:
            best = _Ramp(made, last, pace)
        if pace >= 1 - ROUNDED:
            return best._replace(pace=1.0)
    return best


def _ramp(course: Course, last: int, shortest: float) -> Course | None:
    """Return how a course, whose shortest block is given, comes from rest to its speed at one of its points.

    The acceleration rises as evenly from nothing as it falls back to it, and blocks are divided as far as is needed to
    stay within 0.1 nm of the path. Nothing if its points are too few for that.
    """
    clock = course.time[: last + 1] - course.time[0]
    length = 2 * clock[-1]
    ends = _when(length, clock)
    for divided in DIVIDED:
        most = np.maximum(np.floor(np.diff(ends) / shortest * divided * (1 + ROUNDED)), 1).astype(np.int64)
        made, astray = _divided(course, ends, length, most)
        if astray.max() <= 1:
            return made
    return None


def _divided(course: Course, ends: Floats, length: float, most: Ints) -> tuple[Course, Floats]:
    """Return a course that comes to speed in some time, its blocks divided as far as its path asks for.

    Parameters
    ----------
    course
        At its speed from the beginning.
    ends
        When each of the blocks is to end. (n + 1,) [s]
    length
        The time it takes to come to speed. [s]
    most
        Into how many each of the blocks may be divided. (n,)

    Returns
    -------
    Course
        From rest to speed.
    ndarray
        By how much its blocks stray from the path in spite of that, as a share of what they may. (m - 1,)
    """
    clock = course.time[: ends.size] - course.time[0]
    parts = np.ones(most.size, dtype=np.int64)
    while True:
        number = np.repeat(np.arange(most.size), parts)
        share = (np.arange(number.size) - (np.cumsum(parts) - parts)[number]) / parts[number]
        time = np.append(ends[number] + share * np.diff(ends)[number], ends[-1])
        phase, pace = _eased(length, time)
        first = np.append(share == 0, True)
        phase[first] = clock
        pace[0], pace[-1] = 0.0, 1.0
        made = Course(time, *_along(course, np.append(number, most.size - 1), phase, pace))
        off = _astray(course, made, number, phase, pace)
        worst = np.maximum.reduceat(off, np.flatnonzero(share == 0))
        finer = (worst > 1) & (parts < most)
        if not finer.any():
            return made, off
        # Cubics miss by the fourth power of their length.
        wanted = np.maximum(np.ceil(parts * worst**0.25), parts + 1).astype(np.int64)
        parts = np.where(finer, np.minimum(wanted, most), parts)


def _along(
    course: Course, block: Ints, phase: Floats, pace: float | Floats
) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return positions and velocities on the cubics of a course, where it goes through them at some pace. Each (n,)."""
    start, span = course.time[block] - course.time[0], course.time[block + 1] - course.time[block]
    u = (phase - start) / span
    axes, velocity = {}, {}
    for letter, position in course.axes.items():
        speed = course.velocity[letter]
        rise, a = position[block + 1] - position[block], span * speed[block]
        c = a + span * speed[block + 1] - 2 * rise
        b = rise - a - c
        axes[letter] = np.where(u == 1, position[block + 1], position[block] + u * (a + u * (b + u * c)))
        velocity[letter] = pace * (a + u * (2 * b + u * 3 * c)) / span
    return axes, velocity


def _astray(course: Course, made: Course, block: Ints, phase: Floats, pace: Floats) -> Floats:
    """Return how far each block of what was made strays from the path, as a share of what it may. (n - 1,)."""
    span = np.diff(made.time)

    def between(values: Floats, rates: Floats, u: float) -> Floats:
        rise, a = np.diff(values), span * rates[:-1]
        c = a + span * rates[1:] - 2 * rise
        out: Floats = values[:-1] + u * (a + u * (rise - a - c + u * c))
        return out

    off = np.zeros(span.size)
    for u in (0.25, 0.5, 0.75):
        exact, _ = _along(course, block, between(phase, pace, u), 1.0)
        for letter, position in made.axes.items():
            miss = np.abs(between(position, made.velocity[letter], u) - exact[letter])
            off = np.maximum(off, miss / (TURNED if letter in ROTARY else STRAIGHT))
    return off


def _eased(length: float, time: Floats) -> tuple[Floats, Floats]:
    """Return how far a motion from rest is, in time at full speed [s], and at which share of its speed. Each (n,)."""
    s = time / length
    late = s > 0.5
    phase = length * np.where(late, s - 0.5 + (1 - s) ** 3 * 2 / 3, s**3 * 2 / 3)
    return phase, np.where(late, 1 - 2 * (1 - s) ** 2, 2 * s**2)


def _when(length: float, phase: Floats) -> Floats:
    """Return when a motion from rest is as far as some time at full speed, up to its ramp's end. (n,) [s]."""
    share = phase / length
    early = np.cbrt(1.5 * share)
    # The cubic of the second half has three real roots, so that it is solved by an angle.
    late = 1 - math.sqrt(2) * np.sin(np.arcsin((0.5 - np.clip(share, 1 / 12, 0.5)) * 3 / math.sqrt(2)) / 3)
    return length * np.where(share > 1 / 12, late, early)
