"""Three views of one motion: where the tool is sent, where it stands, and how the axes move in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from turnwright._arrays import Compared, Floats, Ints, freeze, frozen, rounding, same_length
from turnwright._validate import check_cumulative, check_numbers
from turnwright.errors import InputError
from turnwright.machine import FAST, ROTARY, Machine

__all__ = ["Motion", "Path", "Spiral", "block_points"]

STRAIGHT = 1e-7
"""How far an axis may be from the straight line between two blocks of a lathe with a fast tool, a tenth of the last
decimal of its program. [mm]"""

TURNED = 1e-9
"""The same for axes that turn. [rad]"""

MOST_TURN = np.pi / 4
"""Widest step of C between two blocks of such a program, so that nobody doubts its sense. [rad]"""


def _sense(angle: Floats, what: str) -> int:
    """Return +1 or -1, the direction in which the spindle angle runs."""
    if angle.size < 2:
        raise InputError(f"{what} has {angle.size} points, it needs at least 2: take a smaller feed or more points")
    check_cumulative(angle, f"the angle of {what}")
    before, after = angle[:-1], angle[1:]
    if (after > before).all():
        return 1
    if (after < before).all():
        return -1
    raise InputError(f"the spindle angle of {what} turns back: make it grow or fall all the way")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spiral(Compared):
    """Where the tool is sent, in plan view.

    Parameters
    ----------
    angle
        Azimuth of the part under the tool, cumulative over the turns, strictly growing or strictly falling, in most
        steps by half a turn at most. Degrees are refused where their steps are wider than that, where they are coarse,
        even and a whole part of 360, and where the ends lie a whole number of times 360 apart; uneven steps of less
        than 3.1 degrees cannot be known from coarse ones in radians. (n,) [rad]
    radius
        Commanded distance of the tip from the axis (for a path along the normal: of the contact point). (n,) [mm]
    y
        Height of the tip above centre, that is across the rake plane; ``None`` for a tip that stays at centre. (n,)
        [mm]
    radius_rate, y_rate
        Their derivatives by the angle; ``None`` where nobody states them. (n,) [mm/rad]
    lift
        How far above contact each point of the program is to stand (below where negative), so that straight lines
        between the points keep to both sides of the exact path; ``None`` for points on it. (n,) [mm]
    sense
        +1 where the angle grows, -1 where it falls; found from the angle.
    """

    angle: Floats
    radius: Floats
    y: Floats | None = None
    radius_rate: Floats | None = None
    y_rate: Floats | None = None
    lift: Floats | None = None
    sense: int = field(init=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        freeze(self, ("angle", "radius"), ("y", "radius_rate", "y_rate", "lift"))
        object.__setattr__(self, "sense", _sense(self.angle, "a spiral"))
        step = float(np.median(np.abs(np.diff(self.angle))))
        # Tips of a spiral that are looked at one by one may lie whole turns apart.
        if step > np.pi * (1 + 1e-9) and abs(np.remainder(step + 1, 2 * np.pi) - 1) > 1e-6:
            raise InputError(
                f"the points of a spiral are {step:.4g} rad apart, the limit is half a turn: angles are in rad, "
                "take more points"
            )

    @property
    def turns(self) -> float:
        """Number of spindle revolutions."""
        return float(abs(self.angle[-1] - self.angle[0]) / (2 * np.pi))

    @property
    def feed(self) -> float:
        """Mean advance per turn. [mm/rev]."""
        return abs(float(self.radius[-1] - self.radius[0])) / self.turns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path(Compared):
    """Where the tool stands, in contact with the surface.

    Parameters
    ----------
    angle, radius, z
        Commanded tip position: spindle azimuth [rad], distance from the axis and height [mm]. Each (n,)
    sweep
        Where on the nose the edge touches. (n,) [rad]
    contact_x, contact_y, contact_z
        The cutter-contact point in the part frame. Each (n,) [mm]
    clearance
        Least height of the whole edge above the surface: 0 in contact, negative where the tool gouges; of a path along
        z as seen at places spread over the edge and the path. (n,) [mm]
    y, y_rate, lift
        As in the `Spiral` that was placed. The height z is that in contact; a strategy whose spiral has a lift adds it
        in its axes.
    radius_rate, z_rate
        Derivatives of radius and z by the angle, where the spiral states its own. Each (n,) [mm/rad]
    """

    angle: Floats
    radius: Floats
    z: Floats
    sweep: Floats
    contact_x: Floats
    contact_y: Floats
    contact_z: Floats
    clearance: Floats
    y: Floats | None = None
    radius_rate: Floats | None = None
    y_rate: Floats | None = None
    z_rate: Floats | None = None
    lift: Floats | None = None
    sense: int = field(init=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        names = ("angle", "radius", "z", "sweep", "contact_x", "contact_y", "contact_z", "clearance")
        freeze(self, names, ("y", "radius_rate", "y_rate", "z_rate", "lift"))
        object.__setattr__(self, "sense", _sense(self.angle, "a path"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion(Compared):
    """How the axes move in time, in Turnwright's own convention whatever the controller's.

    C is the azimuth of the part under the tool [rad], cumulative; X the commanded distance of the tip from the axis,
    Y (if there is one) its height above centre, Z its height, and W and U (if there are any) what a fast tool adds to Z
    and to X [mm].
    Between the points every axis moves linearly, unless the controller takes their velocities too, see `track`.

    Parameters
    ----------
    time
        Ascending. (n,) [s]
    axes
        Position by axis letter, at least "C", "X" and "Z". Each (n,)
    machine
        The machine that the commands are meant for; its geometric errors are already corrected in them.
    velocity
        Velocity of every axis at the points, by letter, as a program in positions, velocities and times (PVT) states
        it; ``None`` where it states none. Each (n,) [mm/s or rad/s]
    stated_blocks
        Numbers of the points that are blocks of the lathe's program, where a program says so; see `blocks`. (m,)
    """

    time: Floats
    axes: Mapping[str, Floats]
    machine: Machine
    velocity: Mapping[str, Floats] | None = None
    stated_blocks: Ints | None = None
    sense: int = field(init=False)

    def __post_init__(self) -> None:
        check_numbers(self)
        object.__setattr__(self, "time", frozen(self.time, "time"))
        missing = {"C", "X", "Z"} - set(self.axes)
        if missing:
            raise InputError(f"a motion lacks axis {', '.join(sorted(missing))}: give C, X and Z")
        axes = {letter: frozen(values, f"axis {letter}") for letter, values in self.axes.items()}
        object.__setattr__(self, "axes", MappingProxyType(axes))
        same_length([("time", self.time), *axes.items()])
        if self.velocity is not None:
            if set(self.velocity) != set(axes):
                raise InputError(
                    f"a motion moves {', '.join(sorted(axes))} at velocities of {', '.join(sorted(self.velocity))}: "
                    "give one for each"
                )
            velocity = {letter: frozen(values, f"velocity {letter}") for letter, values in self.velocity.items()}
            object.__setattr__(self, "velocity", MappingProxyType(velocity))
            same_length([("time", self.time), *velocity.items()])
        if not (self.time[1:] > self.time[:-1]).all():
            raise InputError("the time of a motion does not ascend: every block needs a duration above 0 s")
        object.__setattr__(self, "sense", _sense(axes["C"], "a motion"))

    @property
    def blocks(self) -> Ints:
        """Numbers of the points that are blocks of the lathe's program: as stated, or else the `block_points`. (m,)."""
        return block_points(self.time, self.axes) if self.stated_blocks is None else self.stated_blocks

    @property
    def feed(self) -> float:
        """Mean advance per turn. [mm/rev]."""
        c, x = self.axes["C"], self.axes["X"]
        return abs(float(x[-1] - x[0]) / float(c[-1] - c[0])) * 2 * np.pi

    def lathe(self) -> Motion:
        """Return the share of the lathe itself, what its program holds: no W or U, and only the `blocks`."""
        if not FAST.keys() & self.axes.keys():
            return self
        points = self.blocks

        def share(of: Mapping[str, Floats]) -> dict[str, Floats]:
            return {letter: values[points] for letter, values in of.items() if letter not in FAST}

        velocity = None if self.velocity is None else share(self.velocity)
        return Motion(time=self.time[points], axes=share(self.axes), machine=self.machine, velocity=velocity)


def block_points(time: Floats, axes: Mapping[str, Floats]) -> Ints:
    """Return the numbers of the points that are blocks of the lathe's program. (m,).

    Without a fast tool all are. A fast tool has its own table of heights, so that a lathe needs no more blocks than its
    own axes ask for: every second, fourth, eighth point and so on, as long as every axis stays within 0.1 nm of the
    straight line between two blocks. The last block takes what is left and may be shorter; a controller that
    interpolates by splines rounds a little there.

    Parameters
    ----------
    time
        Ascending, or the angle that stands for it. (n,) [s or rad]
    axes
        Position by letter. Each (n,) [mm or rad]
    """
    every = np.arange(time.size)
    if not FAST.keys() & axes.keys():
        return every
    points, stride = every, 2
    while stride < time.size:
        fewer = np.append(every[:-1:stride], time.size - 1)
        if np.abs(np.diff(axes["C"][fewer])).max() > MOST_TURN:
            break
        for letter, values in axes.items():
            if letter in FAST:
                continue
            off = np.abs(np.interp(time, time[fewer], values[fewer]) - values).max()
            if off > (TURNED if letter in ROTARY else STRAIGHT) + rounding(values):
                return points
        points, stride = fewer, 2 * stride
    return points
