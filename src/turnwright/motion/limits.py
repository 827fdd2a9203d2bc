"""Demands of a motion on the axes, compared with the limits of the machine."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints, only_read
from turnwright._kernels import limits as limits_kernel, spline as spline_kernel, tracking as tracking_kernel
from turnwright.machine import FAST, ROTARY, Axis, Machine, blend_blocks
from turnwright.path import Motion, block_points
from turnwright.progress import run_chunks
from turnwright.speed_profile import time_over_angle

__all__ = [
    "LIMIT_TOL",
    "TURN",
    "Course",
    "LimitDemand",
    "Limits",
    "check_limits",
    "find_demands",
    "find_first_limit",
    "find_speed_factor",
]

TURN = 2 * math.pi

NM_PER_MM = 1e6

LIMIT_TOL = 1e-3
"""Relative excess at which a limit still counts as kept; covers rounded programs and the accuracy of data sheets."""

STATED_SPEED = "spindle speed as stated"
"""Binding constraint of a motion that stays below every limit."""

BLENDING, BLENDING_SHARE = "blending of blocks", 0.75
"""Binding constraint of a motion on LinuxCNC, and share of a block's time that blending takes where it binds: the rest
is that of whole servo cycles."""

DEFAULT_RESIDUAL = 1e-5
"""Default ``bandwidth_residual`` of an axis: amplitude of motion above its bandwidth. [mm or rad]"""

HANN_POWER = 3 / 8
"""Mean square of the Hann window."""

MANY_POINTS = 100_000
"""Points of a motion from which its axes are searched for peaks at the same time."""

SAMPLES_PER_CHUNK = 100_000
"""Samples of a motion of a chunk of work; smaller chunks take less time than their overhead."""

BINDING_UTILISATION = 0.99
"""Utilisation from which a limit counts as binding."""

AIR_SPEED_RATIO = 1.2
"""Ratio of the fastest to the slowest C within a revolution above which it is taken to cross air."""

SPEED_POWERS = {"speed": 1, "acceleration": 2, "jerk": 3}
"""Power of the spindle speed to which each quantity is proportional."""

_AxisPeaks = tuple[dict[str, float], dict[str, int]]
"""Travel and peaks of an axis by name, and the indices of their points."""


class LimitDemand(NamedTuple):
    """Largest value of a limited quantity in a motion, with its limit."""

    name: str
    power: int  # the value is proportional to this power of the spindle speed
    value: float
    limit: float
    unit: str
    point: int
    definition: str = ""

    @property
    def speed_factor(self) -> float:
        """Factor by which the speed of the motion may be multiplied."""
        return math.inf if self.value == 0 else (self.limit / self.value) ** (1 / self.power)

    @property
    def exceeded(self) -> bool:
        """Whether the value is above the limit."""
        return self.value > self.limit * (1 + LIMIT_TOL)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Demands of a motion on a machine, and the utilisation of its limits.

    Parameters
    ----------
    cycle_time_s
        Time from the first point to the last. [s]
    points
        Number of program points.
    spindle_rpm
        Spindle speed: the highest one if the motion states velocities, else the mean. [rev/min]
    block_rate_hz
        Highest block rate; with a fast tool that of the lathe, see `Motion.lathe`. [blocks/s]
    peak_speed, peak_acceleration, peak_jerk
        Largest magnitude by axis letter. [mm or rad, and s]
    travel
        Lowest and highest position by axis letter. [mm or rad]
    frequency_hz
        Highest frequency of the motion by axis letter, for axes with a stated bandwidth; see `check_limits`. [Hz]
    utilisation
        Value over limit, by the name of each stated limit such as "block rate" or "Z acceleration". [1]
    binding
        Limit with the highest utilisation, or "spindle speed as stated" if no limit prevents a higher speed.
    ok
        Whether every stated limit is kept.
    findings
        One sentence for each limit that is exceeded.
    spindle_mode
        Whether the cut is in spindle mode, so that C is no axis.
    """

    cycle_time_s: float
    points: int
    spindle_rpm: float
    block_rate_hz: float
    peak_speed: Mapping[str, float]
    peak_acceleration: Mapping[str, float]
    peak_jerk: Mapping[str, float]
    travel: Mapping[str, tuple[float, float]]
    frequency_hz: Mapping[str, float]
    utilisation: Mapping[str, float]
    binding: str
    ok: bool
    findings: tuple[str, ...]
    spindle_mode: bool = False

    @property
    def nearest(self) -> str:
        """Name of the limit with the highest utilisation, whether it binds or not."""
        return max(self.utilisation, key=self.utilisation.__getitem__)


def check_limits(motion: Motion, machine: Machine) -> Limits:
    """Compare the demands of a motion with the limits of a machine.

    Speed, acceleration and jerk are divided differences over one, two and three neighbouring blocks; for a controller
    with interpolation "hermite" (PVT) they, and the travel, are the extremes of the cubics in each block. Positions
    rounded to :math:`q` add up to :math:`2q/t^2` to the acceleration and :math:`4q/t^3` to the jerk, where :math:`t` is
    the block time. With a fast tool the blocks of the lathe are those of `Motion.lathe`. The cycle time is that of the
    motion; with the interpolation "linuxcnc" that of this controller.

    The highest frequency of an axis is the lowest one above which the motion has less power than a sine of amplitude
    ``bandwidth_residual`` (10 nm by default). The power is that of any two revolutions, after removal of their mean,
    under a Hann window. Between the points the motion is a cubic spline.

    Parameters
    ----------
    motion
        Axes in time; planned here or read back from a program.
    machine
        Machine with the limits.

    Returns
    -------
    Limits
        Peaks, utilisation of each limit, and a finding for each limit that is exceeded.

    Sources
    -------
    Divided differences are exact for polynomials of their degree, at any spacing. Extremes of a cubic: its derivatives
    are a parabola and a straight line. [Troutman2016]_ Table 7.1.
    """
    course = Course(motion.time, motion.axes, motion.velocity or {})
    blocks = motion.block_points
    peaks = _find_axis_peaks(course, blocks, machine)
    if motion.spindle_mode is not None:
        machine = machine.in_spindle_mode()
    demands = _find_limit_demands(course, blocks, peaks, machine)
    length, slowest = float(motion.time[-1] - motion.time[0]), STATED_SPEED
    if machine.controller.interpolation == "linuxcnc" and motion.spindle_mode is None:
        length = float(blend_blocks(motion.time, motion.axes, machine).time[-1])
        slowest = BLENDING if _is_blended_slowly(motion, machine) else STATED_SPEED
    rpm = _cutting_rpm(motion)
    if motion.velocity is not None:
        rpm = course.top_rpm
    utilisation = {demand.name: demand.value / demand.limit for demand in demands}
    findings = [
        f"{demand.name} reaches {demand.value:.5g} {demand.unit}{demand.definition} at "
        f"{motion.time[demand.point] / 60:.2f} min (X {motion.axes['X'][demand.point]:.4g} mm), the limit of "
        f"{machine.name} is {demand.limit:.5g} {demand.unit}: "
        f"reduce the spindle speed to {rpm * demand.speed_factor:.4g} rev/min or less"
        for demand in demands
        if demand.exceeded
    ]
    for letter, (top, _) in peaks.items():
        findings += _check_travel(letter, top, machine)
    return Limits(
        cycle_time_s=length,
        points=motion.time.size if motion.spindle_mode is None else motion.blocks.size,
        spindle_rpm=rpm,
        block_rate_hz=demands[0].value,
        peak_speed=MappingProxyType({letter: top["speed"] for letter, (top, _) in peaks.items()}),
        peak_acceleration=MappingProxyType({letter: top["acceleration"] for letter, (top, _) in peaks.items()}),
        peak_jerk=MappingProxyType({letter: top["jerk"] for letter, (top, _) in peaks.items()}),
        travel=MappingProxyType({letter: (top["low"], top["high"]) for letter, (top, _) in peaks.items()}),
        frequency_hz=MappingProxyType(
            {demand.name.split()[0]: demand.value for demand in demands if demand.unit == "Hz"}
        ),
        utilisation=MappingProxyType(utilisation),
        binding=max(utilisation, key=utilisation.__getitem__)
        if max(utilisation.values()) >= BINDING_UTILISATION
        else slowest,
        ok=not findings,
        findings=tuple(findings),
        spindle_mode=motion.spindle_mode is not None,
    )


def _is_blended_slowly(motion: Motion, machine: Machine) -> bool:
    """Return whether most blocks take little more than their blending does, with half of the acceleration each."""
    least = np.zeros(motion.time.size - 1)
    for letter, values in motion.axes.items():
        if (most := machine.axes[letter].acceleration) is not None:
            least = np.maximum(least, np.sqrt(2 * np.abs(np.diff(values)) / most))
    return bool(np.median(least / np.diff(motion.time)) > BLENDING_SHARE)


def _cutting_rpm(motion: Motion) -> float:
    """Return the mean spindle speed, or that of the cuts if each revolution crosses air faster. [rev/min]."""
    turned = motion.axes["C"] - motion.axes["C"][0]
    np.abs(turned, out=turned)
    speed = np.diff(turned)
    speed /= np.diff(motion.time)
    mean = float(turned[-1] / (motion.time[-1] - motion.time[0]))
    starts = np.unique(np.searchsorted(turned[1:], np.arange(0.0, turned[-1], TURN)))
    ratio = np.maximum.reduceat(speed, starts) / np.maximum(np.minimum.reduceat(speed, starts), 1e-9 * mean)
    crosses_air = starts.size > 1 and float(np.median(ratio)) > AIR_SPEED_RATIO
    return (float(np.quantile(speed, 0.1)) if crosses_air else mean) * 60 / TURN


def _find_limit_demands(
    course: Course, blocks: Ints | slice, peaks: Mapping[str, _AxisPeaks], machine: Machine, *, bands: bool = True
) -> list[LimitDemand]:
    """Return the demands of a course on every stated limit of a machine, the block rate first."""
    number, shortest = limits_kernel.shortest(only_read(course.time[blocks]))
    rad_per_s = TURN / 60
    top, at = peaks["C"]
    demands = [
        LimitDemand("block rate", 1, 1 / shortest, machine.block_rate_hz, "blocks/s", _point(blocks, number)),
        LimitDemand("spindle speed", 1, top["speed"] / rad_per_s, machine.spindle_rpm, "rev/min", at["speed"]),
    ]
    for letter, (top, at) in peaks.items():
        axis = machine.axes.get(letter, Axis())
        for kind, power in SPEED_POWERS.items():
            limit = getattr(axis, kind)
            if limit is not None:
                unit = f"{_length_unit(letter)}/s" + ("", "^2", "^3")[power - 1]
                demands.append(LimitDemand(f"{letter} {kind}", power, top[kind], limit, unit, at[kind]))
        if bands and axis.bandwidth_hz is not None:
            frequency, point = _find_frequency(course.time, course.axes["C"], course.axes[letter], axis)
            residual = axis.bandwidth_residual or DEFAULT_RESIDUAL
            size = f"{residual:.3g} rad" if letter in ROTARY else f"{residual * NM_PER_MM:.3g} nm"
            definition = f" (less than {size} of motion above it)"
            demands.append(LimitDemand(f"{letter} bandwidth", 1, frequency, axis.bandwidth_hz, "Hz", point, definition))
    return demands


def _check_travel(letter: str, top: Mapping[str, float], machine: Machine) -> list[str]:
    axis = machine.axes.get(letter)
    if axis is None:
        return [f"the motion needs axis {letter}, which {machine.name} does not have: choose another machine"]
    slide = FAST.get(letter)
    remedy = f"move more of the motion to {slide}" if slide else "move the part on the spindle"
    return [
        f"{letter} goes to {top[end]:.5g} {_length_unit(letter)}, the {end} end of its travel on {machine.name} "
        f"is {limit:.5g} {_length_unit(letter)}: {remedy}, or choose another machine"
        for end, limit, beyond in (("low", axis.low, -1), ("high", axis.high, 1))
        if limit is not None and (top[end] - limit) * beyond > 0
    ]


def find_speed_factor(course: Course, machine: Machine, *, ends: tuple[bool, bool] = (True, True)) -> float:
    """Return the factor by which the speed may be multiplied until the motion reaches the first limit.

    If the time of the course is the spindle angle, the factor is the highest spindle speed. [rad/s]
    """
    return find_first_limit(course, machine, ends).speed_factor


def find_first_limit(course: Course, machine: Machine, ends: tuple[bool, bool] = (True, True)) -> LimitDemand:
    """Return the limit that a motion reaches first as its speed rises.

    ``ends`` states whether the course includes the start and the end of the motion.
    """
    blocks = block_points(course.time, course.axes)
    demands = _find_limit_demands(course, blocks, _find_axis_peaks(course, blocks, machine, ends), machine)
    return min(demands, key=lambda demand: demand.speed_factor)


def find_demands(course: Course, machine: Machine, ends: tuple[bool, bool] = (True, True)) -> list[LimitDemand]:
    """Return the demands of a course, all of whose points are blocks, on all limits except the bandwidths."""
    every = slice(None)
    return _find_limit_demands(course, every, _find_axis_peaks(course, every, machine, ends), machine, bands=False)


class Course(NamedTuple):
    """Positions of the axes in time, with velocities if they are stated."""

    time: Floats
    axes: Mapping[str, Floats]
    velocity: Mapping[str, Floats]

    def at_speed(self, omega: float | Floats) -> Course:
        """Return the course, whose time is the spindle angle, at a speed of constant acceleration. [rad/s]."""
        time = self.time / omega if isinstance(omega, float) else time_over_angle(self.time, omega)
        return Course(time, self.axes, {letter: omega * values for letter, values in self.velocity.items()})

    @property
    def top_rpm(self) -> float:
        """Highest spindle speed at the points. [rev/min]."""
        return float(np.abs(self.velocity["C"]).max()) * 60 / TURN

    def reverse(self) -> Course:
        """Return the course reversed in time."""
        return Course(
            self.time[-1] - self.time[::-1],
            {letter: values[::-1] for letter, values in self.axes.items()},
            {letter: -values[::-1] for letter, values in self.velocity.items()},
        )

    def scale_speed(self, factor: float) -> Course:
        """Return the course with its speed multiplied by a factor."""
        return Course(
            self.time / factor, self.axes, {letter: factor * values for letter, values in self.velocity.items()}
        )

    def select(self, at: slice) -> Course:
        """Return the course at a range of its points."""
        return Course(
            self.time[at],
            {letter: values[at] for letter, values in self.axes.items()},
            {letter: values[at] for letter, values in self.velocity.items()},
        )

    def join(self, *others: Course) -> Course:
        """Return this course followed by others, each of which starts at the last point of the one before."""
        time = [self.time]
        for one in others:
            time.append(time[-1][-1] + (one.time[1:] - one.time[0]))

        def joined(values: Floats, more: Iterable[Floats]) -> Floats:
            return np.concatenate([values, *(one[1:] for one in more)])

        return Course(
            np.concatenate(time),
            {letter: joined(values, (one.axes[letter] for one in others)) for letter, values in self.axes.items()},
            {
                letter: joined(values, (one.velocity[letter] for one in others))
                for letter, values in self.velocity.items()
            },
        )


def _find_frequency(time: Floats, angle: Floats, position: Floats, axis: Axis) -> tuple[float, int]:
    """Return the highest frequency of a motion, see `check_limits`, and the index of a point where it occurs."""
    from scipy import fft  # noqa: PLC0415 - costly to import

    time, position = only_read(np.abs(time - time[0])), only_read(position)
    turned = np.abs(angle - angle[0]) / TURN
    span = min(2.0, float(turned[-1]))
    starts = np.linspace(0.0, turned[-1] - span, math.ceil(turned[-1] - span + 1))
    begin, end = np.interp(starts, turned, time), np.interp(starts + span, turned, time)
    first, last = np.searchsorted(time, begin, "right") - 1, np.searchsorted(time, end) + 1
    size = fft.next_fast_len(max(int((last - first).max()), 16), real=True)
    window = 0.5 - 0.5 * np.cos(TURN * np.arange(size) / size)
    threshold = size * HANN_POWER * (axis.bandwidth_residual or DEFAULT_RESIDUAL) ** 2 / 2
    frequency = np.zeros(starts.size)
    # Linear interpolation would add frequencies of its own.
    slope = np.empty(time.size)
    spline_kernel.fill_slopes(time, position, slope)
    slope = only_read(slope)

    def analyse(start: int, stop: int) -> None:
        part = np.empty(size)
        for k in range(start, stop):
            spline_kernel.sample(time, position, slope, first[k], begin[k], end[k], part)
            part -= part.mean()
            part *= window
            if not part @ part > threshold:
                continue
            bins = np.abs(fft.rfft(part)) ** 2 * (2 / size)
            above = np.cumsum(bins[::-1])[::-1]  # including the bin itself
            frequency[k] = (np.count_nonzero(above > threshold) - 1) / float(end[k] - begin[k])

    run_chunks(analyse, starts.size, max(1, SAMPLES_PER_CHUNK // size))
    top = int(np.argmax(frequency))
    at = int(np.searchsorted(time, (begin[top] + end[top]) / 2)) if frequency[top] else 0
    return float(frequency[top]), at


def _find_axis_peaks(
    course: Course, blocks: Ints | slice, machine: Machine, ends: tuple[bool, bool] = (True, True)
) -> dict[str, _AxisPeaks]:
    """Return travel and peaks of every axis; of a fast tool from all points, else from the blocks."""
    time, is_fast_tool = course.time[blocks], bool(FAST.keys() & course.axes.keys())

    def peaks_of(letter: str) -> _AxisPeaks:
        if letter in FAST:  # its own controller interpolates linearly
            return _find_peaks(course.time, course.axes[letter], None)
        points = course.axes[letter][blocks]
        velocity = None
        if machine.controller.interpolation == "hermite":
            if letter in course.velocity:
                velocity = course.velocity[letter][blocks]
                velocity = velocity.copy() if is_fast_tool else velocity
            else:
                velocity = np.empty(time.size)
                tracking_kernel.rates(only_read(time), only_read(points), velocity)
            if is_fast_tool or letter not in course.velocity:
                # The program of such a motion accelerates and decelerates within one block.
                velocity[[0, -1]] = np.where(ends, 0.0, velocity[[0, -1]])
        top, at = _find_peaks(time, points, velocity)
        return top, {name: _point(blocks, number) for name, number in at.items()}

    letters, peaks = list(course.axes), {}

    def work(first: int, _stop: int) -> None:
        peaks[letters[first]] = peaks_of(letters[first])

    run_chunks(work, len(letters), 1, threads=None if course.time.size > MANY_POINTS else 1)
    return {letter: peaks[letter] for letter in letters}


def _point(blocks: Ints | slice, number: int) -> int:
    return int(number) if isinstance(blocks, slice) else int(blocks[number])


def _find_peaks(time: Floats, position: Floats, velocity: Floats | None) -> _AxisPeaks:
    """Return travel and peaks of an axis: of cubics if velocities are given, else of straight lines."""
    value, place = np.empty(5), np.empty(5, dtype=np.int64)
    if velocity is None:
        limits_kernel.peaks(only_read(time), only_read(position), value, place)
    else:
        limits_kernel.cubic_peaks(only_read(time), only_read(position), only_read(velocity), value, place)
    names = ("low", "high", *SPEED_POWERS)
    return dict(zip(names, value.tolist(), strict=True)), dict(zip(names, place.tolist(), strict=True))


def _length_unit(letter: str) -> str:
    return "rad" if letter in ROTARY else "mm"
