"""The axes in time: at which speed, and whether the machine can follow."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from turnwright._arrays import frozen, only_read, same_length
from turnwright._kernels import limits as limits_kernel
from turnwright._kernels import tracking as tracking_kernel
from turnwright._validate import check_numbers
from turnwright.errors import InputError, LimitError
from turnwright.machine import FAST, ROTARY, Axis
from turnwright.path import STRAIGHT, TURNED, Motion, Path, block_points

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright._arrays import Floats, Ints
    from turnwright.machine import Machine

__all__ = ["Limits", "SpeedProfile", "check_limits", "drive", "require_variable"]

TURN = 2 * math.pi
NM = 1e6

SLACK = 1e-3
"""A limit counts as kept up to this share above it: no data sheet is more exact, and a program read back is rounded."""

STATED = "spindle speed as stated"
"""What binds a motion that keeps every limit with room to spare."""

ROUNDED = 3e-10
"""A speed that is sought is left as it is up to this share above a limit: a jerk is then within 1e-9 of its own."""

RESIDUAL = 1e-5
"""What may remain of a motion above the bandwidth of an axis that states nothing else. [mm or rad]"""

HANN_POWER = 3 / 8
"""Mean square of the Hann window."""

FULL = 0.99
"""Share of a limit from which on it is the limit that binds: the speed that `drive` finds uses all of one."""

MOST_PIECES = 1000
"""Pieces of a motion that have a spindle speed of their own."""

POWERS = {"speed": 1, "acceleration": 2, "jerk": 3}
"""How each quantity grows with the spindle speed."""

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


class Servo(Protocol):
    """What `drive` needs of a strategy."""

    @property
    def spindle_rpm(self) -> float | None:
        """Spindle speed, or ``None`` for the highest that keeps every limit. [rev/min]."""

    def axes(self, path: Path) -> Mapping[str, Floats]:
        """Return the position of every axis at the points of a path."""

    def rates(self, path: Path) -> Mapping[str, Floats] | None:
        """Return the derivatives by the angle of all these axes, or ``None`` if the path states none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpeedProfile:
    r"""Spindle speed over the radius, for a controller that may vary it.

    Between two radii :math:`\omega^2` runs straight over the radius, so that at a steady feed the spindle speeds up
    steadily in time; beyond the ends the speed is held.

    Parameters
    ----------
    radius
        Where X stands, ascending. (n,) [mm]
    spindle_rpm
        Spindle speed there. (n,) [rev/min]

    Raises
    ------
    InputError
        If the radii do not ascend, or a speed is not positive.

    >>> profile = SpeedProfile(radius=[1.0, 2.0], spindle_rpm=[500.0, 100.0])
    >>> (profile.at(np.array([0.0, 1.0, 1.5, 3.0])) * 60 / TURN).round(3).tolist()
    [500.0, 500.0, 360.555, 100.0]
    """

    radius: Floats
    spindle_rpm: Floats

    def __post_init__(self) -> None:
        check_numbers(self)
        for name in ("radius", "spindle_rpm"):
            object.__setattr__(self, name, frozen(getattr(self, name), name))
        same_length([("radius", self.radius), ("spindle_rpm", self.spindle_rpm)])
        if not self.radius.size:
            raise InputError("a speed profile has 0 radii, it needs at least 1: give a radius and its spindle speed")
        if not (self.radius[1:] > self.radius[:-1]).all():
            raise InputError("the radii of a speed profile do not ascend: sort them, and give each one speed")
        if not (self.spindle_rpm > 0).all():
            raise InputError(
                f"a speed of the profile is {self.spindle_rpm.min():g} rev/min, it must be above 0 rev/min: increase it"
            )

    def at(self, radius: Floats) -> Floats:
        """Return the spindle speed where X stands at some radii. (n,) [rad/s]."""
        omega: Floats = np.sqrt(np.interp(radius, self.radius, (self.spindle_rpm * (TURN / 60)) ** 2))
        return omega


def require_variable(machine: Machine) -> None:
    """Raise if the controller of a machine keeps one spindle speed."""
    if not machine.controller.variable_speed:
        raise LimitError(
            f"the spindle speed shall vary over the radius, the controller of {machine.name} keeps one: state one "
            "speed, or variable_speed = true in the [controller] of the machine file if it may"
        )


_Peaks = tuple[dict[str, float], dict[str, int]]
"""Travel and peaks of an axis by name, and the numbers of the points they are found at."""


class _Asked(NamedTuple):
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


def drive(path: Path, servo: Servo, machine: Machine, *, profile: SpeedProfile | None = None) -> Motion:
    r"""Return the motion of the axes along a path.

    Time is the angle turned over the spindle speed, which is steady unless the controller may vary it. Z is commanded
    to ``path.z - machine.z_error(X)``, so that the tip stands at ``path.z`` in spite of the machine's known errors;
    they act at the position of X, wherever on the edge the contact is.

    If the strategy states no spindle speed, it is the highest one :math:`\omega` that keeps every stated limit, as
    `check_limits` measures it, to 1e-9 of the limit: along a given path block rate and speeds grow with
    :math:`\omega`, accelerations with :math:`\omega^2` and jerks with :math:`\omega^3`, so each limit allows one speed
    and the lowest of them binds.

    Where the controller may vary the speed (``Controller.variable_speed``), every turn has a highest one of its own.
    :math:`\omega^2` then runs straight over the angle from turn to turn, so that the spindle speeds up steadily in time
    between them, no faster than the C axis may, and the whole motion is slowed down by what that adds to the other
    axes.

    A controller that takes velocities too (interpolation "hermite", PVT) gets them from the rates that the path states,
    :math:`\dot q = \omega\, dq/d\theta`, with the derivative of the machine's errors along X in that of Z. Where
    straightness, a table with straight lines in between, has a corner, that is the slope of the line beyond.

    Its program begins and ends at rest, so the motion does too. All axes together come to their speed and to rest along
    the path itself, with an acceleration that rises evenly from nothing and falls evenly back to it. Blocks are divided
    there until the cubics in time stay within 0.1 nm of those that a steady spindle makes between the points. Either
    end takes as little of the path as the limits allow, in steps of a tenth: 0.1 s at full speed (of a short motion a
    fortieth) or more, and half of the path at most. A stated speed is reached between the ends, or refused with the
    highest one possible; where the path itself asks for more than a limit, so may the ends.

    The highest speed keeps every limit with these ends, whose points are passed at less. Longer ends leave fewer points
    at full speed, which may allow a higher one, with longer ends again; the search goes on as long as each such step
    gains, so a higher speed beyond one that gains nothing is missed, by a tenth in one of a hundred short paths. Beside
    a fast tool, whose lathe has blocks of its own, the motion is steady to its ends, and its program comes to speed and
    to rest in one block, which counts.

    Parameters
    ----------
    path
        Where the tip stands.
    servo
        The strategy: which axis carries what, and the spindle speed.
    machine
        What the axes can do, and how they err.
    profile
        Spindle speed over the radius, in place of what the strategy says of it.

    Raises
    ------
    LimitError
        If the machine lacks an axis that is needed, turns slower than what is asked, or cannot vary its speed, or if
        the path is too short for a motion in velocities to come to a stated speed and to rest, or has too few points
        for that at any speed.

    Sources
    -------
    [Troutman2016]_ Table 7.1 (block rate and cycle time). Erratum to the thesis: an axis error acts at the X of the
    tool, not at the contact point.
    """
    axes: dict[str, Floats] = dict(servo.axes(path))
    lacking = sorted(set(axes) - set(machine.axes))
    if lacking:
        raise LimitError(
            f"the strategy moves axis {', '.join(lacking)}, {machine.name} has {', '.join(sorted(machine.axes))}: "
            "choose another strategy or machine"
        )
    rates = servo.rates(path) if machine.controller.interpolation == "hermite" else None
    if machine.squareness or machine.straightness is not None:
        axes["Z"] = axes["Z"] - machine.z_error(axes["X"])
        if rates is not None:
            rates = {**rates, "Z": rates["Z"] - machine.z_error_slope(axes["X"]) * rates["X"]}
    rpm = servo.spindle_rpm
    turned = np.abs(path.angle - path.angle[0])
    slopes = {letter: path.sense * rate for letter, rate in (rates or {}).items()}
    course = _Course(turned, axes, slopes)
    omega: float | Floats
    if profile is not None:
        require_variable(machine)
        omega = profile.at(path.radius)
    elif rpm is None and machine.controller.variable_speed:
        omega = _varied(course, machine)
    elif rpm is None:
        omega = _highest(course, machine)
    elif rpm > machine.spindle_rpm:
        raise LimitError(
            f"spindle_rpm is {rpm:g} rev/min, the limit of {machine.name} is {machine.spindle_rpm:g} rev/min: turn "
            "slower, or state none to have the highest speed found"
        )
    else:
        omega = rpm * TURN / 60
    course = course.at(omega)
    stated = profile is not None or rpm is not None
    if slopes and not FAST.keys() & axes.keys():
        subject = "spindle_rpm is" if profile is None else "the speed profile goes up to"
        course = _reach_stated_speed(course, machine, subject=subject) if stated else _fastest(course, machine)
    if not stated:
        course = _within(course, machine)
    return Motion(time=course.time, axes=course.axes, machine=machine, velocity=course.velocity or None)


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
    course = _Course(motion.time - motion.time[0], motion.axes, motion.velocity)
    made = _with_ends(course, motion.machine, stated=True)
    if made.pace == 1 and not any(one.exceeded for one in _of_points(made.course, motion.machine)):
        course = made.course
    else:
        fastest = _fastest(course, motion.machine)
        course = _within(fastest.quicker(min(1.0, course.top_rpm / fastest.top_rpm)), motion.machine)
    return replace(motion, time=course.time, axes=course.axes, velocity=course.velocity)


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
    course = _Course(motion.time, motion.axes, motion.velocity or {})
    peaks = _all_peaks(course, motion.blocks, machine)
    asked = _asked(course, motion.blocks, peaks, machine)
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


def _asked(
    course: _Course, blocks: Ints, peaks: Mapping[str, _Peaks], machine: Machine, *, bands: bool = True
) -> list[_Asked]:
    """Return all that a course asks of the stated limits of a machine, the block rate first."""
    number, shortest = limits_kernel.shortest(only_read(course.time[blocks]))
    turning = TURN / 60
    top, at = peaks["C"]
    asked = [
        _Asked("block rate", 1, 1 / shortest, machine.block_rate_hz, "blocks/s", int(blocks[number])),
        _Asked("spindle speed", 1, top["speed"] / turning, machine.spindle_rpm, "rev/min", at["speed"]),
    ]
    for letter, (top, at) in peaks.items():
        axis = machine.axes.get(letter, Axis())
        for kind, power in POWERS.items():
            limit = getattr(axis, kind)
            if limit is not None:
                unit = f"{_length(letter)}/s" + ("", "^2", "^3")[power - 1]
                asked.append(_Asked(f"{letter} {kind}", power, top[kind], limit, unit, at[kind]))
        if bands and axis.bandwidth_hz is not None:
            frequency, point = _frequency(course.time, course.axes["C"], course.axes[letter], axis)
            residual = axis.bandwidth_residual or RESIDUAL
            size = f"{residual:.3g} rad" if letter in ROTARY else f"{residual * NM:.3g} nm"
            what = f", above which less than {size} of its motion remains,"
            asked.append(_Asked(f"{letter} bandwidth", 1, frequency, axis.bandwidth_hz, "Hz", point, what))
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


def _varied(course: _Course, machine: Machine) -> Floats:
    """Return the spindle speed at every point, each turn as fast as its own limits let it. (n,) [rad/s].

    The time of the course is the angle turned.
    """
    turned = course.time
    count = max(1, min(int(turned[-1] / TURN), MOST_PIECES))
    borders = np.linspace(0, turned[-1], count + 1)
    ends = np.searchsorted(turned, borders)
    quickest = np.empty(count)
    for k, (first, last) in enumerate(pairwise(ends.tolist())):
        # Three blocks on either side count too: as far as a jerk is seen.
        part = course.some(slice(max(first - 3, 0), last + 4))
        quickest[k] = _highest(part, machine, ends=(k == 0, k == count - 1))
    squares = np.minimum(np.append(quickest, np.inf), np.append(np.inf, quickest)) ** 2
    rise = 2 * (machine.axes["C"].acceleration or np.inf) * borders[1]
    for order in (range(1, count + 1), range(count - 1, -1, -1)):
        step = 1 if order.step > 0 else -1
        for k in order:
            squares[k] = min(squares[k], squares[k - step] + rise)
    omega: Floats = np.sqrt(np.interp(turned, borders, squares))
    # What speeding up adds to the accelerations of the other axes is known only now.
    return omega * min(1.0, _highest(course.at(omega), machine))


def _highest(course: _Course, machine: Machine, *, ends: tuple[bool, bool] = (True, True)) -> float:
    """Return how much quicker a motion may be so that it just keeps every stated limit.

    With the angle for its time that is the highest spindle speed. [rad/s]
    """
    return _first_limit(course, machine, ends).pace


def _first_limit(course: _Course, machine: Machine, ends: tuple[bool, bool] = (True, True)) -> _Asked:
    """Return the limit that a motion comes to first if it is made quicker; ``ends`` says which of its ends it has."""
    blocks = block_points(course.time, course.axes)
    return min(_asked(course, blocks, _all_peaks(course, blocks, machine, ends), machine), key=lambda one: one.pace)


def _within(course: _Course, machine: Machine) -> _Course:
    """Return a course slowed down by the little that it is above a limit: rounding, and what its ends take."""
    for _ in range(ROUNDS):
        room = _highest(course, machine)
        if room >= 1 - ROUNDED:
            break
        course = course.quicker(room)
    return course


class _Course(NamedTuple):
    """Positions of the axes in time, and their velocities where they are stated."""

    time: Floats
    axes: Mapping[str, Floats]
    velocity: Mapping[str, Floats]

    def at(self, omega: float | Floats) -> _Course:
        """Return the same course, whose time is the angle turned, at a spindle speed. [rad/s]."""
        velocity = {letter: omega * values for letter, values in self.velocity.items()}
        return _Course(_clock(self.time, omega), self.axes, velocity)

    @property
    def top_rpm(self) -> float:
        """Highest spindle speed at its points. [rev/min]."""
        return float(np.abs(self.velocity["C"]).max()) * 60 / TURN

    def backwards(self) -> _Course:
        """Return the same course from its end to its beginning."""
        return _Course(
            self.time[-1] - self.time[::-1],
            {letter: values[::-1] for letter, values in self.axes.items()},
            {letter: -values[::-1] for letter, values in self.velocity.items()},
        )

    def quicker(self, factor: float) -> _Course:
        """Return the same course at so many times its speed."""
        return _Course(
            self.time / factor, self.axes, {letter: factor * values for letter, values in self.velocity.items()}
        )

    def some(self, at: slice) -> _Course:
        """Return some of its points."""
        return _Course(
            self.time[at],
            {letter: values[at] for letter, values in self.axes.items()},
            {letter: values[at] for letter, values in self.velocity.items()},
        )

    def then(self, other: _Course) -> _Course:
        """Return this course, and from its last point on another that begins there."""
        return _Course(
            np.concatenate([self.time, self.time[-1] + (other.time[1:] - other.time[0])]),
            {letter: np.concatenate([values, other.axes[letter][1:]]) for letter, values in self.axes.items()},
            {letter: np.concatenate([values, other.velocity[letter][1:]]) for letter, values in self.velocity.items()},
        )


class _Ends(NamedTuple):
    """A course from rest to rest."""

    course: _Course
    inner: slice  # of the points of the course given, those at full speed
    pace: float  # how much quicker coming to speed and to rest may be, at most 1


def _reach_stated_speed(course: _Course, machine: Machine, *, subject: str) -> _Course:
    """Return a course from rest to rest that reaches its stated speed; ``subject`` begins the message if none can."""
    made = _with_ends(course, machine, stated=True)
    if made.pace == 1 and not any(one.exceeded for one in _of_points(made.course, machine)):
        return made.course
    fastest = _fastest(course, machine)
    highest, rpm = fastest.top_rpm, course.top_rpm
    if highest >= rpm:
        return fastest.quicker(rpm / highest)
    if made.pace == 1:  # what the path itself asks for is too much, as `check_limits` says
        return made.course
    turns = abs(float(course.axes["C"][-1] - course.axes["C"][0])) / TURN
    raise LimitError(
        f"{subject} {rpm:.7g} rev/min, the limit of {machine.name} from rest to rest along this path of {turns:.4g} "
        f"turns is {highest * (1 - DIGITS):.7g} rev/min, set by the {_first_limit(fastest, machine).name}: turn "
        "slower, state none to have the highest speed found, or give the path more turns"
    )


def _fastest(course: _Course, machine: Machine) -> _Course:
    """Return a course from rest to rest at the highest speed that keeps every limit."""
    course = course.quicker(_highest(course, machine))
    # The first and last bit of a path do not count, since they are passed at less, nor what longer ends then take.
    best = _at_speed_of(course, _shortest_ends(course), machine)
    for _ in range(ROUNDS):
        more = _at_speed_of(course, best.inner, machine)
        if more.course.top_rpm < best.course.top_rpm * (1 + SLACK):
            break
        best = more
    return best.course


def _at_speed_of(course: _Course, inner: slice, machine: Machine) -> _Ends:
    """Return a course from rest to rest at the speed that some of its points allow, or lower where its ends ask so."""
    own = course.some(inner)
    if own.time.size >= FEWEST:
        course = course.quicker(_highest(own, machine))
    made = _with_ends(course, machine, stated=False)
    return made._replace(course=made.course.quicker(_highest(made.course, machine)))


def _shortest_ends(course: _Course) -> slice:
    """Return which points of a course have its speed if it comes to it, and to rest, as soon as it ever does."""
    time = course.time - course.time[0]
    phase = min(SHORTEST_RAMP_S / 2, SHORTEST_RAMP * time[-1])
    return slice(int(np.searchsorted(time, phase)), int(np.searchsorted(time, time[-1] - phase, "right")))


def _with_ends(course: _Course, machine: Machine, *, stated: bool) -> _Ends:
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


def _of_points(course: _Course, machine: Machine) -> list[_Asked]:
    """Return what a course without a fast tool asks of the limits, but for the bandwidths."""
    every = np.arange(course.time.size)
    return _asked(course, every, _all_peaks(course, every, machine), machine, bands=False)


class _Ramp(NamedTuple):
    """How a course comes from rest to its speed."""

    course: _Course
    last: int  # number of the point from which on it has its speed
    pace: float  # how much quicker this may be, by the limits


def _speeding_up(course: _Course, machine: Machine, limits: Mapping[str, float]) -> _Ramp | None:
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


def _ramp(course: _Course, last: int, shortest: float) -> _Course | None:
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


def _divided(course: _Course, ends: Floats, length: float, most: Ints) -> tuple[_Course, Floats]:
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
    _Course
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
        made = _Course(time, *_along(course, np.append(number, most.size - 1), phase, pace))
        off = _astray(course, made, number, phase, pace)
        worst = np.maximum.reduceat(off, np.flatnonzero(share == 0))
        finer = (worst > 1) & (parts < most)
        if not finer.any():
            return made, off
        # Cubics miss by the fourth power of their length.
        wanted = np.maximum(np.ceil(parts * worst**0.25), parts + 1).astype(np.int64)
        parts = np.where(finer, np.minimum(wanted, most), parts)


def _along(
    course: _Course, block: Ints, phase: Floats, pace: float | Floats
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


def _astray(course: _Course, made: _Course, block: Ints, phase: Floats, pace: Floats) -> Floats:
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


def _all_peaks(
    course: _Course, blocks: Ints, machine: Machine, ends: tuple[bool, bool] = (True, True)
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
