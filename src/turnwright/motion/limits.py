"""What a motion asks of the axes, and the limits of the machine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from turnwright._arrays import only_read
from turnwright._kernels import limits as limits_kernel, tracking as tracking_kernel
from turnwright.machine import FAST, ROTARY, Axis
from turnwright.path import Motion, block_points

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright._arrays import Floats, Ints
    from turnwright.machine import Machine

__all__ = [
    "SLACK",
    "TURN",
    "Course",
    "LimitDemand",
    "Limits",
    "axis_peaks",
    "check_limits",
    "first_limit",
    "highest_pace",
    "limit_demands",
]

TURN = 2 * math.pi

NM = 1e6

SLACK = 1e-3
"""A limit counts as kept up to this share above it: no data sheet is more exact, and a program read back is rounded."""

STATED = "spindle speed as stated"
"""What binds a motion that keeps every limit with room to spare."""

RESIDUAL = 1e-5
"""What may remain of a motion above the bandwidth of an axis that states nothing else. [mm or rad]"""

HANN_POWER = 3 / 8
"""Mean square of the Hann window."""

FULL = 0.99
"""Share of a limit from which on it is the limit that binds: the speed that `drive` finds uses all of one."""

POWERS = {"speed": 1, "acceleration": 2, "jerk": 3}
"""How each quantity grows with the spindle speed."""

_Peaks = tuple[dict[str, float], dict[str, int]]
"""Travel and peaks of an axis by name, and the numbers of the points they are found at."""


class LimitDemand(NamedTuple):
    """Something that a motion asks of a limit."""

    name: str
    power: int  # of the spindle speed, with which it grows
    value: float
    limit: float
    unit: str
    point: int
    what: str = ""

    @property
    def pace(self) -> float:
        """How many times as quick the motion may be."""
        return math.inf if self.value == 0 else (self.limit / self.value) ** (1 / self.power)

    @property
    def exceeded(self) -> bool:
        """Whether the limit is not kept."""
        return self.value > self.limit * (1 + SLACK)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a motion asks of a machine.

    Parameters
    ----------
    cycle_time_s
        From the first point to the last. [s]
    points
        Program points.
    spindle_rpm
        Speed of the spindle: of a motion in velocities, which comes to speed and to rest, that in between, the highest
        one; of any other the mean. [rev/min]
    block_rate_hz
        Blocks per second where they are shortest; with a fast tool those of the lathe, see `Motion.lathe`.
    peak_speed, peak_acceleration, peak_jerk
        Largest magnitude by axis letter. [mm or rad, and s]
    travel
        Lowest and highest position by axis letter. [mm or rad]
    frequency_hz
        Highest frequency of the motion, by letter of each axis whose machine states a bandwidth; see `check_limits`.
    utilisation
        Share of each stated limit that is used, by its name such as "block rate" or "Z acceleration".
    binding
        What the cycle time is bound by: the limit that is used most, or "spindle speed as stated" where every limit has
        room, so that whoever chose the speed could have chosen a higher one.
    ok
        Whether every stated limit is kept.
    findings
        A sentence for each that is not.
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

    @property
    def nearest(self) -> str:
        """Name of the limit that is used most, whether it binds or not."""
        return max(self.utilisation, key=self.utilisation.__getitem__)


def check_limits(motion: Motion, machine: Machine) -> Limits:
    """Return what a motion asks of a machine, and which of its limits binds.

    A controller with interpolation "hermite" (PVT) makes a cubic of the positions and velocities at both ends of each
    block, with the velocities that the motion states or else those that `track` takes. Speed, acceleration, jerk and
    travel are then those of the cubics, inside the blocks and on either side of each point. The jerk is the third
    derivative of each cubic; the acceleration may jump from one to the next, which no number for the jerk shows.

    Of any other motion, that of a fast tool among them, speed, acceleration and jerk are divided differences over one,
    two and three neighbouring blocks, as steep as the points of the program are; a controller that rounds the corners
    asks less of the slides.

    A program whose positions are rounded to :math:`q` shows up to :math:`2q/t^2` of acceleration and :math:`4q/t^3` of
    jerk that is not in the motion, and three times as much by cubics, with :math:`t` the block time: 2 mm/s² and
    4000 mm/s³ for nanometres at 1000 blocks/s. Beside a fast tool the blocks of the lathe are those of `Motion.lathe`.

    The highest frequency of an axis is the lowest one above which less than its ``bandwidth_residual`` remains, 10 nm
    where nobody states another: no two turns of its motion (under a Hann window, less their mean) hold more power there
    than a sine of that amplitude, whatever moves more slowly. Between the points the motion is taken as a cubic spline.
    A pure sine of n periods per turn is found at n + 1/2, and one of 1 um at n + 2 at most if n is not whole.

    Parameters
    ----------
    motion
        The axes in time; planned here or read back from a program.
    machine
        The lathe that is to follow.

    Sources
    -------
    Divided differences are exact for polynomials of their degree, at any spacing. Extremes of a cubic: its derivatives
    are a parabola and a straight line. [Troutman2016]_ Table 7.1.
    """
    course = Course(motion.time, motion.axes, motion.velocity or {})
    peaks = axis_peaks(course, motion.blocks, machine)
    asked = limit_demands(course, motion.blocks, peaks, machine)
    length = float(motion.time[-1] - motion.time[0])
    rpm = abs(float(motion.axes["C"][-1] - motion.axes["C"][0])) / length * 60 / TURN
    if motion.velocity is not None:
        rpm = course.top_rpm
    utilisation = {one.name: one.value / one.limit for one in asked}
    findings = [
        f"{one.name} reaches {one.value:.5g} {one.unit}{one.what} at {motion.time[one.point] / 60:.2f} min "
        f"(X {motion.axes['X'][one.point]:.4g} mm), the limit of {machine.name} is {one.limit:.5g} {one.unit}: "
        f"turn at {rpm * one.pace:.4g} rev/min or less"
        for one in asked
        if one.exceeded
    ]
    for letter, (top, _) in peaks.items():
        findings += _beyond(letter, top, machine)
    return Limits(
        cycle_time_s=length,
        points=motion.time.size,
        spindle_rpm=rpm,
        block_rate_hz=asked[0].value,
        peak_speed=MappingProxyType({letter: top["speed"] for letter, (top, _) in peaks.items()}),
        peak_acceleration=MappingProxyType({letter: top["acceleration"] for letter, (top, _) in peaks.items()}),
        peak_jerk=MappingProxyType({letter: top["jerk"] for letter, (top, _) in peaks.items()}),
        travel=MappingProxyType({letter: (top["low"], top["high"]) for letter, (top, _) in peaks.items()}),
        frequency_hz=MappingProxyType({one.name.split()[0]: one.value for one in asked if one.unit == "Hz"}),
        utilisation=MappingProxyType(utilisation),
        binding=max(utilisation, key=utilisation.__getitem__) if max(utilisation.values()) >= FULL else STATED,
        ok=not findings,
        findings=tuple(findings),
    )


def limit_demands(
    course: Course, blocks: Ints, peaks: Mapping[str, _Peaks], machine: Machine, *, bands: bool = True
) -> list[LimitDemand]:
    """Return all that a course asks of the stated limits of a machine, the block rate first."""
    number, shortest = limits_kernel.shortest(only_read(course.time[blocks]))
    turning = TURN / 60
    top, at = peaks["C"]
    asked = [
        LimitDemand("block rate", 1, 1 / shortest, machine.block_rate_hz, "blocks/s", int(blocks[number])),
        LimitDemand("spindle speed", 1, top["speed"] / turning, machine.spindle_rpm, "rev/min", at["speed"]),
    ]
    for letter, (top, at) in peaks.items():
        axis = machine.axes.get(letter, Axis())
        for kind, power in POWERS.items():
            limit = getattr(axis, kind)
            if limit is not None:
                unit = f"{_length(letter)}/s" + ("", "^2", "^3")[power - 1]
                asked.append(LimitDemand(f"{letter} {kind}", power, top[kind], limit, unit, at[kind]))
        if bands and axis.bandwidth_hz is not None:
            frequency, point = _frequency(course.time, course.axes["C"], course.axes[letter], axis)
            residual = axis.bandwidth_residual or RESIDUAL
            size = f"{residual:.3g} rad" if letter in ROTARY else f"{residual * NM:.3g} nm"
            what = f", above which less than {size} of its motion remains,"
            asked.append(LimitDemand(f"{letter} bandwidth", 1, frequency, axis.bandwidth_hz, "Hz", point, what))
    return asked


def _beyond(letter: str, top: Mapping[str, float], machine: Machine) -> list[str]:
    """Return a sentence if a machine lacks an axis, and for each end of its travel that is passed."""
    axis = machine.axes.get(letter)
    if axis is None:
        return [f"the motion needs axis {letter}, {machine.name} does not have it: choose another machine"]
    slide = FAST.get(letter)
    remedy = f"let {slide} carry more of the motion" if slide else "move the part on the spindle"
    return [
        f"{letter} goes to {top[end]:.5g} {_length(letter)}, the {end} end of its travel on {machine.name} "
        f"is {limit:.5g} {_length(letter)}: {remedy}, or choose another machine"
        for end, limit, beyond in (("low", axis.low, -1), ("high", axis.high, 1))
        if limit is not None and (top[end] - limit) * beyond > 0
    ]


def _clock(turned: Floats, omega: float | Floats) -> Floats:
    """Return the time at some angles, the spindle speeding up steadily from one to the next. (n,) [s]."""
    if isinstance(omega, float):
        return turned / omega
    return np.concatenate([[0.0], np.cumsum(2 * np.diff(turned) / (omega[1:] + omega[:-1]))])


def highest_pace(course: Course, machine: Machine, *, ends: tuple[bool, bool] = (True, True)) -> float:
    """Return how much quicker a motion may be so that it just keeps every stated limit.

    With the angle for its time that is the highest spindle speed. [rad/s]
    """
    return first_limit(course, machine, ends).pace


def first_limit(course: Course, machine: Machine, ends: tuple[bool, bool] = (True, True)) -> LimitDemand:
    """Return the limit that a motion comes to first if it is made quicker; ``ends`` says which of its ends it has."""
    blocks = block_points(course.time, course.axes)
    return min(
        limit_demands(course, blocks, axis_peaks(course, blocks, machine, ends), machine), key=lambda one: one.pace
    )


class Course(NamedTuple):
    """Positions of the axes in time, and their velocities where they are stated."""

    time: Floats
    axes: Mapping[str, Floats]
    velocity: Mapping[str, Floats]

    def at(self, omega: float | Floats) -> Course:
        """Return the same course, whose time is the angle turned, at a spindle speed. [rad/s]."""
        velocity = {letter: omega * values for letter, values in self.velocity.items()}
        return Course(_clock(self.time, omega), self.axes, velocity)

    @property
    def top_rpm(self) -> float:
        """Highest spindle speed at its points. [rev/min]."""
        return float(np.abs(self.velocity["C"]).max()) * 60 / TURN

    def backwards(self) -> Course:
        """Return the same course from its end to its beginning."""
        return Course(
            self.time[-1] - self.time[::-1],
            {letter: values[::-1] for letter, values in self.axes.items()},
            {letter: -values[::-1] for letter, values in self.velocity.items()},
        )

    def quicker(self, factor: float) -> Course:
        """Return the same course at so many times its speed."""
        return Course(
            self.time / factor, self.axes, {letter: factor * values for letter, values in self.velocity.items()}
        )

    def some(self, at: slice) -> Course:
        """Return some of its points."""
        return Course(
            self.time[at],
            {letter: values[at] for letter, values in self.axes.items()},
            {letter: values[at] for letter, values in self.velocity.items()},
        )

    def then(self, other: Course) -> Course:
        """Return this course, and from its last point on another that begins there."""
        return Course(
            np.concatenate([self.time, self.time[-1] + (other.time[1:] - other.time[0])]),
            {letter: np.concatenate([values, other.axes[letter][1:]]) for letter, values in self.axes.items()},
            {letter: np.concatenate([values, other.velocity[letter][1:]]) for letter, values in self.velocity.items()},
        )


def _frequency(time: Floats, angle: Floats, position: Floats, axis: Axis) -> tuple[float, int]:
    """Return the highest frequency of a motion, see `check_limits`, and the number of a point it is found at."""
    from scipy import fft, interpolate  # noqa: PLC0415 - costly to import

    time = np.abs(time - time[0])
    turned = np.abs(angle - angle[0]) / TURN
    span = min(2.0, float(turned[-1]))
    starts = np.linspace(0.0, turned[-1] - span, math.ceil(turned[-1] - span + 1))
    begin, end = np.interp(starts, turned, time), np.interp(starts + span, turned, time)
    first, last = np.searchsorted(time, begin, "right") - 1, np.searchsorted(time, end) + 1
    size = fft.next_fast_len(max(int((last - first).max()), 16), real=True)
    share = np.arange(size) / size
    window = 0.5 - 0.5 * np.cos(TURN * share)

    def windowed(k: int) -> Floats:
        here = slice(first[k], last[k])
        # Straight lines would add frequencies of their own.
        part: Floats = interpolate.CubicSpline(time[here], position[here])(begin[k] + share * (end[k] - begin[k]))
        part -= part.mean()
        part *= window
        return part

    power = np.array([windowed(k) @ windowed(k) for k in range(starts.size)])
    faint = size * HANN_POWER * (axis.bandwidth_residual or RESIDUAL) ** 2 / 2
    highest, at = 0.0, 0
    for k in np.flatnonzero(power > faint).tolist():
        bins = np.abs(fft.rfft(windowed(k))) ** 2 * (2 / size)
        above = np.cumsum(bins[::-1])[::-1]  # with the bin itself
        found = (np.count_nonzero(above > faint) - 1) / float(end[k] - begin[k])
        if found > highest:
            highest, at = found, int(np.searchsorted(time, (begin[k] + end[k]) / 2))
    return highest, at


def axis_peaks(
    course: Course, blocks: Ints, machine: Machine, ends: tuple[bool, bool] = (True, True)
) -> dict[str, _Peaks]:
    """Return travel and peaks of every axis and where they are: of the fast tool at all points, else at the blocks."""
    peaks = {}
    for letter, position in course.axes.items():
        if letter in FAST:  # its own controller goes straight
            peaks[letter] = _peaks(course.time, position, None)
            continue
        time, points = course.time[blocks], position[blocks]
        velocity = None
        if machine.controller.interpolation == "hermite":
            velocity = np.empty(time.size)
            if letter in course.velocity:
                velocity[:] = course.velocity[letter][blocks]
            else:
                tracking_kernel.rates(only_read(time), only_read(points), velocity)
            if FAST.keys() & course.axes.keys() or letter not in course.velocity:
                # Such a motion comes to its speed, and to rest, within a block.
                velocity[[0, -1]] = np.where(ends, 0.0, velocity[[0, -1]])
        top, at = _peaks(time, points, velocity)
        peaks[letter] = top, {name: int(blocks[point]) for name, point in at.items()}
    return peaks


def _peaks(time: Floats, position: Floats, velocity: Floats | None) -> _Peaks:
    """Return travel and peaks of an axis by name, and the numbers of the points they are found at.

    Of cubics if it states velocities, else of straight lines.
    """
    value, place = np.empty(5), np.empty(5, dtype=np.int64)
    if velocity is None:
        limits_kernel.peaks(only_read(time), only_read(position), value, place)
    else:
        limits_kernel.cubic_peaks(only_read(time), only_read(position), only_read(velocity), value, place)
    names = ("low", "high", *POWERS)
    return dict(zip(names, value.tolist(), strict=True)), dict(zip(names, place.tolist(), strict=True))


def _length(letter: str) -> str:
    """Return the unit that an axis counts in."""
    return "rad" if letter in ROTARY else "mm"
