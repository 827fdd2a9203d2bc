"""Motion of the axes along a path: spindle speed, and the ramps from and to rest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.errors import InputError, LimitError
from turnwright.machine import FAST, Machine, blend_blocks
from turnwright.motion.air import cross_air, cut_sections
from turnwright.motion.limits import (
    LIMIT_TOL,
    TURN,
    Course,
    find_demands,
    find_speed_factor,
)
from turnwright.motion.pvt import find_fastest_course, reach_stated_speed, slow_to_limits
from turnwright.path import Motion, Path, SpindleMode
from turnwright.speed_profile import SpeedProfile

__all__ = ["drive", "require_variable"]

MAX_PIECES = 1000
"""Pieces of a motion, each with its own highest spindle speed."""


SPEED_STEP, SPEED_TRIALS = 0.9, 25
"""Ratio of the spindle speeds that are tried where a path crosses air and no speed is stated, and their number."""

SAMPLES = 16
"""Turns of the path from which the time at these speeds is estimated."""

OFF_CYCLE = 1e-4
"""Share by which the program states blocks slower than LinuxCNC plays them. Where a block takes a whole number of servo
cycles, rounding would decide whether it takes one more."""

BLENDING_ROUNDS, BLENDING_TOL = 5, 1e-3
"""Times that a program is played to find times that it keeps, and the change of its time that is accepted."""

MIN_SECTION = 5
"""Points of the shortest cut that counts for the highest speed."""


class Servo(Protocol):
    """Part of a strategy that `drive` uses."""

    @property
    def spindle_rpm(self) -> float | None:
        """Spindle speed, or ``None`` for the highest one within every limit. [rev/min]."""

    @property
    def spindle_speeds(self) -> SpeedProfile | None:
        """Spindle speed over the radius, instead of a constant one."""

    @property
    def spindle_mode(self) -> SpindleMode | None:
        """Feed and speed in spindle mode, instead of a C axis."""

    def blocks(self, path: Path) -> Ints:
        """Return the indices of the points of a path that are points of its program in spindle mode."""

    def axes(self, path: Path) -> Mapping[str, Floats]:
        """Return the positions of the axes at the points of a path."""

    def rates(self, path: Path) -> Mapping[str, Floats] | None:
        """Return the derivatives of these axes with respect to the angle, or ``None`` if the path states none."""


def require_variable(machine: Machine) -> None:
    """Raise `LimitError` if the controller of a machine cannot vary the spindle speed."""
    if not machine.controller.variable_speed:
        raise LimitError(
            f"the spindle speed varies over the radius, the controller of {machine.name} has a constant one: state a "
            "constant speed, or set variable_speed = true in the [controller] of the machine file"
        )


def drive(path: Path, servo: Servo, machine: Machine, *, profile: SpeedProfile | None = None) -> Motion:
    r"""Return the motion of the axes along a path.

    Z is commanded to ``path.z - machine.z_error(X)``, so that the known errors of the machine are compensated and the
    tip is at ``path.z``. The spindle speed is the one that the strategy states, or the highest one within every stated
    limit, to 1e-9 of the limit; it may differ from revolution to revolution if the controller can vary it.

    A controller that takes velocities too (interpolation "hermite", PVT) gets those of the path. Its program starts and
    ends at rest: all axes accelerate and decelerate together along the path, within 0.1 nm of it, in ramps of at most
    half of the path. The search for the highest speed with ramps stops at the first step without a gain, so it may miss
    a higher one. With a fast tool the program accelerates and decelerates within one block.

    With the interpolation "linuxcnc" the times are those that this controller takes, which may be longer; the program
    states them.

    In spindle mode the motion follows straight lines between the points of the program, at the stated feed and speed.

    Parameters
    ----------
    path
        Path of the tool tip.
    servo
        Strategy: assigns the motion to the axes, and states the spindle speed.
    machine
        Limits, controller and known errors of the machine.
    profile
        Spindle speed over the radius; replaces that of the strategy.

    Raises
    ------
    LimitError
        If the machine lacks an axis, its spindle is too slow or cannot vary its speed, or a path with velocities is too
        short for its speed, or has too few points.

    Sources
    -------
    [Troutman2016]_ Table 7.1 (block rate and cycle time). Erratum to the thesis: an axis error acts at the X of the
    tool, not at the contact point.
    """
    axes: dict[str, Floats] = dict(servo.axes(path))
    missing = sorted(set(axes) - set(machine.axes))
    if missing:
        raise LimitError(
            f"the strategy moves axis {', '.join(missing)}, {machine.name} has {', '.join(sorted(machine.axes))}: "
            "choose another strategy or machine"
        )
    if servo.spindle_mode is not None:
        if path.air_height is not None:
            raise InputError(
                "the path leaves the part within a revolution, in spindle mode the tool cannot: plan and place it on "
                "the strategy's target(part)"
            )
        return _drive_spindle_mode(path, servo, servo.spindle_mode, machine)
    rates = servo.rates(path) if machine.controller.interpolation == "hermite" else None
    if machine.squareness or machine.straightness is not None:
        axes["Z"] = axes["Z"] - machine.z_error(axes["X"])
        if rates is not None:
            rates = {**rates, "Z": rates["Z"] - machine.z_error_slope(axes["X"]) * rates["X"]}
    rpm = servo.spindle_rpm
    angle = np.abs(path.angle - path.angle[0])
    slopes = {letter: path.sense * rate for letter, rate in (rates or {}).items()}
    course = Course(angle, axes, slopes)
    profile = servo.spindle_speeds if profile is None else profile
    stated = profile is not None or rpm is not None
    subject = "spindle_rpm is" if profile is None else "the speed profile reaches"
    if path.air_height is not None and not FAST.keys() & axes.keys():
        air = path.air_height - machine.z_error(axes["X"])
        if stated:
            speeds = [_find_omega(course, path, rpm, profile, machine)]
        else:
            speeds = list(_rank_speeds(course, air, machine))
        return _timed(_cross_air(course, speeds, air, machine, subject=subject), machine)
    course = course.at_speed(_find_omega(course, path, rpm, profile, machine))
    if slopes and not FAST.keys() & axes.keys():
        course = (
            reach_stated_speed(course, machine, subject=subject) if stated else find_fastest_course(course, machine)
        )
    if not stated:
        course = slow_to_limits(course, machine)
    return _timed(course, machine)


def _timed(course: Course, machine: Machine) -> Motion:
    """Return the motion of a course, at the times that the controller takes."""
    time = _blended_times(course, machine) if machine.controller.interpolation == "linuxcnc" else course.time
    return Motion(time=time, axes=course.axes, machine=machine, velocity=course.velocity or None)


def _blended_times(course: Course, machine: Machine) -> Floats:
    """Return times of the blocks that LinuxCNC keeps when the program states them. (n,) [s].

    A block is no shorter than a servo cycle, or than the block rate allows. Played again, the times that it takes
    change a little; the round that changes them least is taken.
    """
    shortest = max(machine.controller.cycle, 1 / machine.block_rate_hz)
    time, best, least = course.time * (1 + OFF_CYCLE), course.time, np.inf
    for number in range(BLENDING_ROUNDS):
        ends = blend_blocks(time, course.axes, machine).ends
        off = abs(float(ends[-1] / time[-1]) - 1)
        if number and off < least:
            best, least = time, off
        if number and off <= BLENDING_TOL:
            break
        time = np.append(0.0, np.cumsum(np.maximum(np.diff(ends) * (1 + OFF_CYCLE), shortest)))
    return best


def _cross_air(
    course: Course, speeds: Sequence[float | Floats], air: Floats, machine: Machine, *, subject: str
) -> Course:
    """Return a course that crosses air at the first of several speeds with which it keeps the limits.

    From rest to rest if it has velocities. A single speed is a stated one, and kept.
    """
    for number, omega in enumerate(speeds, 1):
        crossed = cross_air(course.at_speed(omega), air, machine)
        if len(speeds) > 1 and find_speed_factor(crossed, machine) < 1 - LIMIT_TOL:
            continue
        if not crossed.velocity:
            return crossed
        try:
            return reach_stated_speed(crossed, machine, subject=subject)
        except LimitError:
            if number == len(speeds):
                raise
    return slow_to_limits(crossed, machine)


def _rank_speeds(course: Course, air: Floats, machine: Machine) -> Iterable[float]:
    """Return spindle speeds by the time that they take: a faster one leaves less time to lift the tool. [rad/s]."""
    fastest, cuts = _find_omega_in_cuts(course, air, machine), cut_sections(air)
    turns = max(1, round(course.time[-1] / TURN))
    more = max(1, round(len(cuts) / turns))
    firsts = np.unique(np.linspace(0, max(len(cuts) - 1 - more, 0), SAMPLES).astype(int)).tolist()
    samples = [slice(cuts[one].start, cuts[min(one + more, len(cuts) - 1)].stop) for one in firsts]
    samples = [one for one in samples if one.stop - one.start >= MIN_SECTION]
    times = {}
    for omega in (fastest * SPEED_STEP ** np.arange(SPEED_TRIALS)).tolist():
        crossed = [cross_air(course.select(one).at_speed(omega), air[one], machine) for one in samples]
        within = all(not demand.exceeded for one in crossed for demand in find_demands(one, machine, (False, False)))
        times[omega] = (not within, sum(float(np.ptp(one.time)) for one in crossed))
    return sorted(times, key=times.__getitem__)


def _find_omega_in_cuts(course: Course, air: Floats, machine: Machine) -> float:
    """Return the highest spindle speed that the cuts allow. [rad/s]."""
    fastest = machine.spindle_rpm * TURN / 60
    for section in cut_sections(air):
        if section.stop - section.start >= MIN_SECTION:
            demands = find_demands(course.select(section), machine, (False, False))
            fastest = min(fastest, *(demand.speed_factor for demand in demands))
    return fastest


def _find_omega(
    course: Course, path: Path, rpm: float | None, profile: SpeedProfile | None, machine: Machine
) -> float | Floats:
    """Return the stated spindle speed, one or that at every point, or the highest within every limit. [rad/s]."""
    if profile is not None:
        require_variable(machine)
        return profile.at(path.radius)
    if rpm is None:
        return (_find_variable_speed if machine.controller.variable_speed else find_speed_factor)(course, machine)
    if rpm > machine.spindle_rpm:
        raise LimitError(
            f"spindle_rpm is {rpm:g} rev/min, the limit of {machine.name} is {machine.spindle_rpm:g} rev/min: reduce "
            "it, or leave it out for the highest possible speed"
        )
    return rpm * TURN / 60


def _drive_spindle_mode(path: Path, servo: Servo, mode: SpindleMode, machine: Machine) -> Motion:
    """Return the motion along straight lines between the points of the program, the spindle running freely."""
    most = machine.in_spindle_mode().spindle_rpm
    if mode.spindle_rpm > most:
        raise LimitError(
            f"spindle_rpm is {mode.spindle_rpm:g} rev/min, the limit of {machine.name} in spindle mode is {most:g} "
            "rev/min: reduce it"
        )
    commanded = replace(path, z=path.z - machine.z_error(path.radius))
    points = servo.blocks(commanded)
    x, z = path.radius[points], commanded.z[points]
    return mode.motion(x, z, machine, sense=path.sense, angle=float(path.angle[0]))


def _find_variable_speed(course: Course, machine: Machine) -> Floats:
    """Return the highest spindle speed at every point, found revolution by revolution. (n,) [rad/s].

    The time of ``course`` is the angle of the spindle.
    """
    angle = course.time
    count = max(1, min(int(angle[-1] / TURN), MAX_PIECES))
    borders = np.linspace(0, angle[-1], count + 1)
    ends = np.searchsorted(angle, borders)
    highest = np.empty(count)
    for k, (first, last) in enumerate(pairwise(ends.tolist())):
        # Three more blocks on either side: the jerk is a difference over three blocks.
        part = course.select(slice(max(first - 3, 0), last + 4))
        highest[k] = find_speed_factor(part, machine, ends=(k == 0, k == count - 1))
    squares = np.minimum(np.append(highest, np.inf), np.append(np.inf, highest)) ** 2
    rise = 2 * (machine.axes["C"].acceleration or np.inf) * borders[1]
    for order in (range(1, count + 1), range(count - 1, -1, -1)):
        step = 1 if order.step > 0 else -1
        for k in order:
            squares[k] = min(squares[k], squares[k - step] + rise)
    omega: Floats = np.sqrt(np.interp(angle, borders, squares))
    # The varying speed adds to the accelerations of the other axes.
    omega *= min(1.0, find_speed_factor(course.at_speed(omega), machine))
    # A constant speed may take less time, not counting what cubics need to start and to stop.
    constant = find_speed_factor(course, machine)
    if angle[-1] / constant <= course.at_speed(omega).time[-1]:
        return np.full(angle.size, constant)
    return omega
