"""Ramps of a PVT motion: acceleration from rest and deceleration to rest, within every limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints, only_read, rounding
from turnwright._kernels.limits import shortest
from turnwright.errors import LimitError
from turnwright.machine import ROTARY, Machine
from turnwright.motion.limits import (
    LIMIT_TOL,
    TURN,
    Course,
    find_demands,
    find_first_limit,
    find_speed_factor,
)
from turnwright.path import LINEARITY_TOL_MM, LINEARITY_TOL_RAD, Motion

__all__ = ["find_fastest_course", "reach_stated_speed", "slow_to_limits"]

SPEED_TOL = 3e-10
"""Relative tolerance of the highest speed; the jerk is then within 1e-9 of its limit, unless times are rounded more."""

MOST_ROUNDED = LIMIT_TOL / 3
"""Most of the relative tolerance that the rounding of times adds, in a motion of hours with blocks of microseconds."""

MIN_RAMP_S = 0.2
"""Duration of the shortest ramp from rest to full speed."""

MIN_RAMP_FRACTION = 1 / 40
"""Fraction of the spindle angle that the shortest ramp takes at most."""

STATED_SPEED_UTILISATION = 0.98
"""Highest utilisation of a limit in a ramp to a stated speed, unless the motion itself demands more."""

RAMP_RATIO = 1.1
"""Ratio of the spindle angles of successive trial ramps."""

BLOCK_DIVISORS = (1, 2, 4, 8)
"""Divisors of the shortest block of the motion that bound the blocks of a ramp; the first sufficient one is used."""

QUARTERS = np.array([[0.25], [0.5], [0.75]])
"""Places along a block at which it is compared with the path."""

MAX_ITERATIONS = 8

MIN_JERK_POINTS = 4
"""Points that a divided difference of third order needs."""

PRINT_MARGIN = 1e-6
"""Relative reduction of a printed highest speed, so that the rounded number is possible."""


def from_rest_to_rest(motion: Motion) -> Motion:
    """Return a motion along the same path that starts and ends at rest, with velocities at its points.

    Between the ramps it has the speed of ``motion``, or the highest one that the limits of the machine allow if that
    is lower; see `drive`.
    """
    assert motion.velocity is not None  # noqa: S101 - for the type checker
    course = Course(motion.time - motion.time[0], motion.axes, motion.velocity)
    ramped = _add_ramps(course, motion.machine, stated=True)
    if ramped.speed_factor == 1 and not any(demand.exceeded for demand in find_demands(ramped.course, motion.machine)):
        course = ramped.course
    else:
        fastest = find_fastest_course(course, motion.machine)
        course = slow_to_limits(fastest.scale_speed(min(1.0, course.top_rpm / fastest.top_rpm)), motion.machine)
    return replace(motion, time=course.time, axes=course.axes, velocity=course.velocity)


def slow_to_limits(course: Course, machine: Machine) -> Course:
    """Return a course slowed down until it keeps every limit."""
    for _ in range(MAX_ITERATIONS):
        factor = find_speed_factor(course, machine)
        # The shortest block is known only to the rounding of its times.
        rounded = rounding(course.time) / shortest(only_read(course.time))[1]
        if factor >= 1 - min(max(SPEED_TOL, rounded), MOST_ROUNDED):
            break
        course = course.scale_speed(factor)
    return course


class _RampedCourse(NamedTuple):
    course: Course
    inner: slice  # points of the original course at full speed
    speed_factor: float  # by which the limits allow the ramps to be scaled, at most 1


def reach_stated_speed(course: Course, machine: Machine, *, subject: str) -> Course:
    """Return a course from rest to rest that reaches its stated speed; ``subject`` begins the error message."""
    ramped = _add_ramps(course, machine, stated=True)
    if ramped.speed_factor == 1 and not any(demand.exceeded for demand in find_demands(ramped.course, machine)):
        return ramped.course
    fastest = find_fastest_course(course, machine)
    highest, rpm = fastest.top_rpm, course.top_rpm
    if highest >= rpm:
        return fastest.scale_speed(rpm / highest)
    if ramped.speed_factor == 1:  # the path itself exceeds a limit, which `check_limits` reports
        return ramped.course
    turns = abs(float(course.axes["C"][-1] - course.axes["C"][0])) / TURN
    binding = find_first_limit(fastest, machine).name
    raise LimitError(
        f"{subject} {rpm:.7g} rev/min, the limit of {machine.name} from rest to rest along this path of {turns:.4g} "
        f"revolutions is {highest * (1 - PRINT_MARGIN):.7g} rev/min (by the {binding}): reduce it, leave it out for "
        "the highest possible speed, or use more revolutions"
    )


def find_fastest_course(course: Course, machine: Machine) -> Course:
    """Return a course from rest to rest at the highest speed within every limit."""
    course = course.scale_speed(find_speed_factor(course, machine))
    # Points within the ramps do not limit the speed, since they are passed more slowly.
    best = _ramp_at_speed_of(course, _shortest_inner(course), machine)
    for _ in range(MAX_ITERATIONS):
        faster = _ramp_at_speed_of(course, best.inner, machine)
        if faster.course.top_rpm < best.course.top_rpm * (1 + LIMIT_TOL):
            break
        best = faster
    return best.course


def _ramp_at_speed_of(course: Course, inner: slice, machine: Machine) -> _RampedCourse:
    """Return a course from rest to rest at the speed that its inner points allow, or less if the ramps require it."""
    inner_course = course.select(inner)
    if inner_course.time.size >= MIN_JERK_POINTS:
        course = course.scale_speed(find_speed_factor(inner_course, machine))
    ramped = _add_ramps(course, machine, stated=False)
    return ramped._replace(course=ramped.course.scale_speed(find_speed_factor(ramped.course, machine)))


def _shortest_inner(course: Course) -> slice:
    """Return the points at full speed between the shortest possible ramps."""
    time = course.time - course.time[0]
    phase = min(MIN_RAMP_S / 2, MIN_RAMP_FRACTION * time[-1])
    return slice(int(np.searchsorted(time, phase)), int(np.searchsorted(time, time[-1] - phase, "right")))


def _add_ramps(course: Course, machine: Machine, *, stated: bool) -> _RampedCourse:
    """Return a course with ramps that keep every limit.

    At a stated speed the ramps stay below the limits, so that they do not bind; where the course itself demands more,
    so may the ramps.
    """
    limits = {
        demand.name: max(STATED_SPEED_UTILISATION * demand.limit, demand.value) if stated else demand.limit
        for demand in find_demands(course, machine)
    }
    points = course.time.size
    begin = _find_ramp(course, machine, limits)
    end = _find_ramp(course.reverse(), machine, limits)
    if begin is None or end is None:
        turned = abs(float(course.axes["C"][-1] - course.axes["C"][0]))
        raise LimitError(
            f"the path has {points} points in {turned:.3g} rad, too few to accelerate from rest and to stop on "
            f"{machine.name}: use more revolutions or more points per revolution"
        )
    inner = slice(begin.last, points - end.last)
    ramped = begin.course.join(course.select(inner)).join(end.course.reverse())
    return _RampedCourse(ramped, inner, min(begin.speed_factor, end.speed_factor, 1.0))


class _Ramp(NamedTuple):
    """Acceleration from rest to the speed of a course."""

    course: Course
    last: int  # index of the first point at full speed
    speed_factor: float  # by which the limits allow the ramp to be scaled


def _find_ramp(course: Course, machine: Machine, limits: Mapping[str, float]) -> _Ramp | None:
    """Return the shortest ramp within the limits, or the one nearest to that; ``None`` if there are too few points."""
    time = course.time - course.time[0]
    middle = int(np.searchsorted(time, time[-1] / 2 * (1 + SPEED_TOL), "right")) - 1
    if middle == 0:
        return None
    shortest = _shortest_inner(course).start
    # Steps from the middle towards the start, so that the same ramps are tried at any speed.
    longer = max(0, math.floor(math.log(time[middle] / time[shortest], RAMP_RATIO)))
    phase = np.append(time[shortest], time[middle] / RAMP_RATIO ** np.arange(longer, -1, -1.0))
    numbers = np.unique(np.searchsorted(time, phase * (1 - SPEED_TOL)).clip(1, middle))
    min_block = float(np.diff(time).min())
    best: _Ramp | None = None
    for last in numbers.tolist():
        ramp = _make_ramp(course, last, min_block)
        if ramp is None:
            continue
        demands = find_demands(ramp.join(course.select(slice(last, last + 2))), machine)
        speed_factor = min(demand._replace(limit=limits[demand.name]).speed_factor for demand in demands)
        if best is None or speed_factor > best.speed_factor:
            best = _Ramp(ramp, last, speed_factor)
        if speed_factor >= 1 - SPEED_TOL:
            return best._replace(speed_factor=1.0)
    return best


def _make_ramp(course: Course, last: int, shortest: float) -> Course | None:
    """Return the course from rest to full speed at a point; ``None`` if the path has too few points.

    The acceleration rises linearly from 0 and falls linearly back to 0. Blocks are divided until they stay within
    0.1 nm of the path; ``shortest`` is the shortest block of the course. [s]
    """
    clock = course.time[: last + 1] - course.time[0]
    length = 2 * clock[-1]
    ends = _ramp_time(length, clock)
    for divided in BLOCK_DIVISORS:
        max_parts = np.maximum(np.floor(np.diff(ends) / shortest * divided * (1 + SPEED_TOL)), 1).astype(np.int64)
        ramp, deviation = _divide_blocks(course, ends, length, max_parts)
        if deviation.max() <= 1:
            return ramp
    return None


def _divide_blocks(course: Course, ends: Floats, length: float, max_parts: Ints) -> tuple[Course, Floats]:
    """Return a ramp to the speed of a course, with its blocks divided as far as the path requires.

    ``ends`` are the ends of the blocks in the ramp (n + 1,) [s], ``length`` is its duration [s]. The second result is
    the deviation of each block from the path over its tolerance. (m - 1,)
    """
    clock = course.time[: ends.size] - course.time[0]
    parts = np.ones(max_parts.size, dtype=np.int64)
    while True:
        number = np.repeat(np.arange(max_parts.size), parts)
        share = (np.arange(number.size) - (np.cumsum(parts) - parts)[number]) / parts[number]
        time = np.append(ends[number] + share * np.diff(ends)[number], ends[-1])
        phase, speed_factor = _ramp_phase(length, time)
        first = np.append(share == 0, True)
        phase[first] = clock
        speed_factor[0], speed_factor[-1] = 0.0, 1.0
        ramp = Course(time, *_evaluate_course(course, np.append(number, max_parts.size - 1), phase, speed_factor))
        off = _path_deviation(course, ramp, number, phase, speed_factor)
        worst = np.maximum.reduceat(off, np.flatnonzero(share == 0))
        too_coarse = (worst > 1) & (parts < max_parts)
        if not too_coarse.any():
            return ramp, off
        # The error of a cubic grows with the fourth power of its length.
        refined = np.maximum(np.ceil(parts * worst**0.25), parts + 1).astype(np.int64)
        parts = np.where(too_coarse, np.minimum(refined, max_parts), parts)


def _evaluate_course(
    course: Course, block: Ints, phase: Floats, speed_factor: float | Floats
) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return positions and velocities on the cubics of a course, at a factor of its speed. Each (n,)."""
    start, span = course.time[block] - course.time[0], course.time[block + 1] - course.time[block]
    u = (phase - start) / span
    axes, velocity = {}, {}
    for letter, position in course.axes.items():
        speed = course.velocity[letter]
        rise, a = position[block + 1] - position[block], span * speed[block]
        c = a + span * speed[block + 1] - 2 * rise
        b = rise - a - c
        axes[letter] = np.where(u == 1, position[block + 1], position[block] + u * (a + u * (b + u * c)))
        velocity[letter] = speed_factor * (a + u * (2 * b + u * 3 * c)) / span
    return axes, velocity


def _path_deviation(course: Course, ramp: Course, block: Ints, phase: Floats, speed_factor: Floats) -> Floats:
    """Return the deviation of each block of a ramp from the path, over its tolerance. (n - 1,)."""
    span = np.diff(ramp.time)

    def between(values: Floats, rates: Floats) -> Floats:
        rise, a = np.diff(values), span * rates[:-1]
        c = a + span * rates[1:] - 2 * rise
        out: Floats = values[:-1] + QUARTERS * (a + QUARTERS * (rise - a - c + QUARTERS * c))
        return out

    off = np.zeros(span.size)
    exact, _ = _evaluate_course(course, block, between(phase, speed_factor), 1.0)
    for letter, position in ramp.axes.items():
        miss = np.abs(between(position, ramp.velocity[letter]) - exact[letter]).max(axis=0)
        off = np.maximum(off, miss / (LINEARITY_TOL_RAD if letter in ROTARY else LINEARITY_TOL_MM))
    return off


def _ramp_phase(length: float, time: Floats) -> tuple[Floats, Floats]:
    """Return the distance of a ramp, as time at full speed [s], and its speed over full speed. Each (n,)."""
    s = time / length
    late = s > 0.5
    phase = length * np.where(late, s - 0.5 + (1 - s) ** 3 * 2 / 3, s**3 * 2 / 3)
    return phase, np.where(late, 1 - 2 * (1 - s) ** 2, 2 * s**2)


def _ramp_time(length: float, phase: Floats) -> Floats:
    """Return the time at which a ramp has covered a distance, given as time at full speed. (n,) [s]."""
    share = phase / length
    early = np.cbrt(1.5 * share)
    # The cubic of the second half has three real roots: solve it by the trigonometric formula.
    late = 1 - math.sqrt(2) * np.sin(np.arcsin((0.5 - np.clip(share, 1 / 12, 0.5)) * 3 / math.sqrt(2)) / 3)
    return length * np.where(share > 1 / 12, late, early)
