"""The axes in time: at which speed, and whether the machine can follow."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from turnwright.errors import LimitError
from turnwright.machine import FAST
from turnwright.motion.limits import TURN, Course, highest_pace
from turnwright.motion.pvt import fastest_course, reach_stated_speed, slowed_to_limits
from turnwright.path import Motion, Path

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright._arrays import Floats
    from turnwright.machine import Machine
    from turnwright.speed_profile import SpeedProfile

__all__ = ["drive", "require_variable"]

MOST_PIECES = 1000
"""Pieces of a motion that have a spindle speed of their own."""


class Servo(Protocol):
    """What `drive` needs of a strategy."""

    @property
    def spindle_rpm(self) -> float | None:
        """Spindle speed, or ``None`` for the highest that keeps every limit. [rev/min]."""

    @property
    def spindle_speeds(self) -> SpeedProfile | None:
        """Spindle speed over the radius, in place of one speed."""

    def axes(self, path: Path) -> Mapping[str, Floats]:
        """Return the position of every axis at the points of a path."""

    def rates(self, path: Path) -> Mapping[str, Floats] | None:
        """Return the derivatives by the angle of all these axes, or ``None`` if the path states none."""


def require_variable(machine: Machine) -> None:
    """Raise if the controller of a machine keeps one spindle speed."""
    if not machine.controller.variable_speed:
        raise LimitError(
            f"the spindle speed shall vary over the radius, the controller of {machine.name} keeps one: state one "
            "speed, or variable_speed = true in the [controller] of the machine file if it may"
        )


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
    course = Course(turned, axes, slopes)
    omega: float | Floats
    profile = servo.spindle_speeds if profile is None else profile
    if profile is not None:
        require_variable(machine)
        omega = profile.at(path.radius)
    elif rpm is None and machine.controller.variable_speed:
        omega = _varied(course, machine)
    elif rpm is None:
        omega = highest_pace(course, machine)
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
        course = reach_stated_speed(course, machine, subject=subject) if stated else fastest_course(course, machine)
    if not stated:
        course = slowed_to_limits(course, machine)
    return Motion(time=course.time, axes=course.axes, machine=machine, velocity=course.velocity or None)


def _varied(course: Course, machine: Machine) -> Floats:
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
        quickest[k] = highest_pace(part, machine, ends=(k == 0, k == count - 1))
    squares = np.minimum(np.append(quickest, np.inf), np.append(np.inf, quickest)) ** 2
    rise = 2 * (machine.axes["C"].acceleration or np.inf) * borders[1]
    for order in (range(1, count + 1), range(count - 1, -1, -1)):
        step = 1 if order.step > 0 else -1
        for k in order:
            squares[k] = min(squares[k], squares[k - step] + rise)
    omega: Floats = np.sqrt(np.interp(turned, borders, squares))
    # What speeding up adds to the accelerations of the other axes is known only now.
    return omega * min(1.0, highest_pace(course.at(omega), machine))
