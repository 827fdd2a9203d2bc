"""The stages of a motion: the spiral in plan view, the tool path in contact, and the axes over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from turnwright._arrays import Compared, Floats, Ints, freeze, frozen, only_read, rounding, same_length
from turnwright._kernels import limits as kernel
from turnwright._validate import check_cumulative, check_numbers, positive
from turnwright.errors import InputError
from turnwright.machine import FAST, ROTARY, Machine
from turnwright.progress import require_memory
from turnwright.speed_profile import time_over_angle

__all__ = ["Motion", "Path", "SpindleMode", "Spiral", "block_points"]

LINEARITY_TOL_MM = 1e-7
"""Deviation of a linear axis from the straight line between two blocks of a lathe with a fast tool, a tenth of the last
decimal of its program."""

LINEARITY_TOL_RAD = 1e-9
"""The same for rotary axes."""

MAX_SPINDLE_S = 3.6e6
"""Longest cut in spindle mode, 1000 h; a longer one has a wrong unit."""

BYTES_PER_POINT = 100
"""Memory for a point of a motion in spindle mode while it is made."""

POINTS_PER_REV = 12
"""Points of a motion in spindle mode per revolution, between which its straight lines turn unambiguously."""

MAX_C_STEP_RAD = np.pi / 4
"""Step of C between two blocks of such a program, so that its sense is unambiguous."""


def _sense(angle: Floats, what: str) -> int:
    """Return +1 or -1, the direction in which the spindle angle runs."""
    if angle.size < 2:
        raise InputError(f"{what} has {angle.size} points, it needs at least 2: use a smaller feed or more points")
    check_cumulative(angle, f"the angle of {what}")
    before, after = angle[:-1], angle[1:]
    if (after > before).all():
        return 1
    if (after < before).all():
        return -1
    raise InputError(f"the spindle angle of {what} turns back, it must grow or fall throughout: correct its order")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spiral(Compared):
    """The commanded spiral in plan view.

    Parameters
    ----------
    angle
        Azimuth of the part under the tool, cumulative over the revolutions, strictly growing or strictly falling; the
        median step is at most half a turn. Angles that are evidently in degrees are refused. (n,) [rad]
    radius
        Commanded distance of the tip from the axis (for a path along the normal: of the contact point). (n,) [mm]
    y
        Height of the tip above centre, across the rake plane; ``None`` for a tip at centre height. (n,) [mm]
    radius_rate, y_rate
        Their derivatives by the angle; ``None`` if not known. (n,) [mm/rad]
    lift
        Offset of each point of the program above contact (below where negative), so that straight lines between the
        points deviate equally to both sides of the exact path; ``None`` for points on the path. (n,) [mm]
    sense
        +1 where the angle grows, -1 where it falls; derived from the angle.
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
        if abs(self.angle[-1] - self.angle[0]) < np.pi / 2 * (self.angle.size - 1):
            return  # half of the steps above half a turn would make a longer spiral
        step = float(np.median(np.abs(np.diff(self.angle))))
        # Sampled points of a spiral may be full turns apart.
        if step > np.pi * (1 + 1e-9) and abs(np.remainder(step + 1, 2 * np.pi) - 1) > 1e-6:
            raise InputError(
                f"the points of a spiral are {step:.4g} rad apart, the limit is half a turn: angles are in rad, "
                "use more points"
            )

    def select(self, points: Ints) -> Spiral:
        """Return the spiral through some of its points, without rates and lift."""
        y = None if self.y is None else self.y[points]
        return Spiral(angle=self.angle[points], radius=self.radius[points], y=y)

    @property
    def turns(self) -> float:
        """Number of spindle revolutions."""
        return float(abs(self.angle[-1] - self.angle[0]) / (2 * np.pi))

    @property
    def feed(self) -> float:
        """Mean feed per revolution. [mm/rev]."""
        return abs(float(self.radius[-1] - self.radius[0])) / self.turns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path(Compared):
    """The tool path in contact with the surface.

    Parameters
    ----------
    angle, radius, z
        Commanded tip position: spindle azimuth [rad], distance from the axis and height [mm]. Each (n,)
    sweep
        Angular position of the contact on the nose. (n,) [rad]
    contact_x, contact_y, contact_z
        The cutter-contact point in the part frame. Each (n,) [mm]
    clearance
        Smallest height of the edge above the surface: 0 in contact, negative where the tool gouges; for a path along
        z sampled over the edge and the path. (n,) [mm]
    y, y_rate, lift
        As in the `Spiral`. The height z is that in contact; a strategy whose spiral has a lift adds it to its axes.
    radius_rate, z_rate
        Derivatives of radius and z by the angle, where the spiral has its own. Each (n,) [mm/rad]
    air_height
        Least height of the tip where the tool crosses air outside the outline of the part, nan where it cuts; ``None``
        for a path that cuts throughout. In air the height z is that in contact with the surface as it would continue.
        (n,) [mm]
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
    air_height: Floats | None = None
    sense: int = field(init=False)

    def __post_init__(self) -> None:
        check_numbers(self, nan=("air_height",))
        names = ("angle", "radius", "z", "sweep", "contact_x", "contact_y", "contact_z", "clearance")
        freeze(self, names, ("y", "radius_rate", "y_rate", "z_rate", "lift"))
        if self.air_height is not None:
            object.__setattr__(self, "air_height", frozen(self.air_height, "air_height", finite=False))
            same_length([("angle", self.angle), ("air_height", self.air_height)])
        object.__setattr__(self, "sense", _sense(self.angle, "a path"))


@dataclass(frozen=True, slots=True, kw_only=True)
class SpindleMode:
    """Feed and speed of a cut in spindle mode: the spindle runs freely, and its angle is not known.

    Parameters
    ----------
    feed
        Advance of the tip along its path per revolution of the spindle. [mm/rev]
    spindle_rpm
        Spindle speed; with a surface speed the highest one, which is reached near the axis. [rev/min]
    surface_speed
        Speed of the part under the tip, if it is constant; ``None`` for a constant spindle speed. [mm/s]
    per_rev
        Whether the program states the feed per revolution (G95) instead of per minute (G94).

    >>> mode = SpindleMode(feed=0.002, spindle_rpm=2000.0, surface_speed=2000.0, per_rev=True)
    >>> (mode.omega(np.array([25.0, 1.0])) * 60 / (2 * np.pi)).round(3).tolist()
    [763.944, 2000.0]
    """

    feed: float
    spindle_rpm: float
    surface_speed: float | None = None
    per_rev: bool = False

    def __post_init__(self) -> None:
        check_numbers(self)
        positive(self.feed, "feed", "mm/rev")
        positive(self.spindle_rpm, "spindle_rpm", "rev/min")
        if self.surface_speed is not None:
            positive(self.surface_speed, "surface_speed", "mm/s")
            if not self.per_rev:
                raise InputError(
                    "surface_speed is set with a feed per minute, it needs a feed per revolution: set feed_mode to "
                    '"mm/rev"'
                )

    def omega(self, radius: Floats) -> Floats:
        """Return the spindle speed at positions of X. (n,) [rad/s]."""
        omega = np.full(radius.shape, self.spindle_rpm * (2 * np.pi / 60))
        if self.surface_speed is None:
            return omega
        with np.errstate(divide="ignore"):
            return np.asarray(np.minimum(omega, self.surface_speed / np.abs(radius)))

    def turns(self, x: Floats, z: Floats) -> Floats:
        """Return the revolutions of the spindle along straight lines between points. (n - 1,)."""
        return np.asarray(np.hypot(np.diff(x), np.diff(z)) / self.feed)

    def motion(
        self, x: Floats, z: Floats, machine: Machine, *, sense: int, angle: float = 0.0, turns: Floats | None = None
    ) -> Motion:
        """Return the motion along straight lines between the points of a program, the spindle starting at any angle.

        ``x``, ``z`` (n,) [mm] are X and Z as commanded; `Motion.blocks` of the result are these points. In between it
        has `POINTS_PER_REV` points per revolution on the lines. ``turns`` are the revolutions between the points where
        their feeds differ. (n - 1,)
        """
        turns = self.turns(x, z) if turns is None else turns
        points = float(turns.sum()) * POINTS_PER_REV
        require_memory(
            BYTES_PER_POINT * points, f"a cut of {turns.sum():.3g} revolutions", "check the units of feed and speed"
        )
        if not (turns > 0).all():
            raise InputError("two points of a cut in spindle mode are equal, each block must move: remove one")
        parts = np.ceil(turns * POINTS_PER_REV).astype(np.int64)
        blocks = np.concatenate(([0], np.cumsum(parts)))
        turned = np.concatenate(([0.0], np.cumsum(turns))) * (2 * np.pi)
        number = np.arange(blocks[-1] + 1)
        angles, radius, height = (np.interp(number, blocks, values) for values in (turned, x, z))
        time = time_over_angle(angles, self.omega(radius))
        if time[-1] > MAX_SPINDLE_S:
            raise InputError(
                f"the cut takes {time[-1] / 3600:.3g} h, the limit is {MAX_SPINDLE_S / 3600:g} h: check the units of "
                "feed and speed"
            )
        axes = {"C": angle + sense * angles, "X": radius, "Z": height}
        return Motion(time=time, axes=axes, machine=machine, stated_blocks=blocks, spindle_mode=self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion(Compared):
    """Axis positions over time, in Turnwright's convention (not the controller's).

    C is the azimuth of the part under the tool [rad], cumulative; X the commanded distance of the tip from the axis,
    Y (if present) its height above centre, Z its height, and W and U (if present) the contribution of a fast tool to Z
    and X [mm].
    Between the points every axis moves linearly, unless the controller also uses velocities, see `track`.

    Parameters
    ----------
    time
        Ascending. (n,) [s]
    axes
        Position by axis letter, at least "C", "X" and "Z". Each (n,)
    machine
        The machine that the commands are for; its geometric errors are compensated in them.
    velocity
        Velocity of every axis at the points, by letter, from a program of positions, velocities and times (PVT);
        ``None`` for other programs. Each (n,) [mm/s or rad/s]
    stated_blocks
        Indices of the points that are blocks of the lathe's program, where a program gives them; see `blocks`. (m,)
    spindle_mode
        Feed and speed of a cut in spindle mode, whose C is the angle turned from any start; ``None`` for a cut with C
        as an axis.
    """

    time: Floats
    axes: Mapping[str, Floats]
    machine: Machine
    velocity: Mapping[str, Floats] | None = None
    stated_blocks: Ints | None = None
    spindle_mode: SpindleMode | None = None
    sense: int = field(init=False)
    _block_points: Ints | slice | None = field(init=False, repr=False, default=None)

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
                    f"a motion has the axes {', '.join(sorted(axes))} and velocities of "
                    f"{', '.join(sorted(self.velocity))}: give one velocity for each axis"
                )
            velocity = {letter: frozen(values, f"velocity {letter}") for letter, values in self.velocity.items()}
            object.__setattr__(self, "velocity", MappingProxyType(velocity))
            same_length([("time", self.time), *velocity.items()])
        if not (self.time[1:] > self.time[:-1]).all():
            raise InputError("the time of a motion does not ascend: every block needs a duration above 0 s")
        object.__setattr__(self, "sense", _sense(axes["C"], "a motion"))

    @property
    def blocks(self) -> Ints:
        """Indices of the points that are blocks of the lathe's program: `stated_blocks`, or `block_points`. (m,)."""
        points = self.block_points
        return np.arange(self.time.size) if isinstance(points, slice) else points

    @property
    def block_points(self) -> Ints | slice:
        """As `blocks`, a slice where all points are blocks."""
        if self.stated_blocks is not None:
            return self.stated_blocks
        points = self._block_points
        if points is None:
            points = block_points(self.time, self.axes)
            if isinstance(points, np.ndarray):
                points.flags.writeable = False
            object.__setattr__(self, "_block_points", points)
        return points

    @property
    def feed(self) -> float:
        """Mean feed per revolution. [mm/rev]."""
        c, x = self.axes["C"], self.axes["X"]
        return abs(float(x[-1] - x[0]) / float(c[-1] - c[0])) * 2 * np.pi

    def reached(self, turned: float) -> int:
        """Return the index of the first point where C has turned this far, the number of points if it never has."""
        c = self.axes["C"]
        if self.sense > 0:
            at = int(np.searchsorted(c, c[0] + turned))
        else:
            at = c.size - int(np.searchsorted(c[::-1], c[0] - turned, side="right"))
        while at > 0 and abs(c[at - 1] - c[0]) >= turned:  # where the sum has rounded to the other side
            at -= 1
        while at < c.size and abs(c[at] - c[0]) < turned:
            at += 1
        return at

    def sample_revolutions(self) -> tuple[Motion, ...]:
        """Return the first revolution, one halfway and the last."""
        last = max(float(abs(self.axes["C"][-1] - self.axes["C"][0])) - 2 * np.pi, 0.0)
        ends = [(self.reached(start), self.reached(start + 2 * np.pi * (1 + 1e-9))) for start in (0.0, last / 2, last)]
        # Copies, which do not keep the whole motion.
        return tuple(self.select(np.arange(max(one - 1, 0), min(end + 1, self.time.size))) for one, end in ends)

    def lathe(self) -> Motion:
        """Return the motion of the lathe's own axes, as in its program: without W and U, and only the `blocks`."""
        if not FAST.keys() & self.axes.keys():
            return self
        return self.select(self.blocks, [letter for letter in self.axes if letter not in FAST])

    def select(self, points: Ints | slice, letters: Iterable[str] | None = None) -> Motion:
        """Return the motion through some of its points, of some of its axes or of all."""
        chosen = tuple(self.axes if letters is None else letters)

        def at_points(arrays: Mapping[str, Floats]) -> dict[str, Floats]:
            return {letter: arrays[letter][points] for letter in chosen}

        velocity = None if self.velocity is None else at_points(self.velocity)
        axes = at_points(self.axes)
        return Motion(
            time=self.time[points], axes=axes, machine=self.machine, velocity=velocity, spindle_mode=self.spindle_mode
        )


def block_points(time: Floats, axes: Mapping[str, Floats]) -> Ints | slice:
    """Return the indices of the points that are blocks of the lathe's program (m,), a slice if all are.

    Without a fast tool, all points are. With a fast tool, which has its own table of heights, the lathe takes every
    second, fourth, eighth point and so on, as long as each of its axes stays within 0.1 nm of the straight line between
    two blocks. The last block may be shorter; a controller with spline interpolation deviates slightly there. The angle
    may be given in place of the time.
    """
    if not FAST.keys() & axes.keys():
        return slice(None)
    every = np.arange(time.size)
    points, stride = every, 2
    while stride < time.size:
        fewer = np.append(every[:-1:stride], time.size - 1)
        if np.abs(np.diff(axes["C"][fewer])).max() > MAX_C_STEP_RAD:
            break
        for letter, values in axes.items():
            if letter in FAST:
                continue
            deviation = kernel.stride_error(only_read(time), only_read(values), stride)
            if deviation > (LINEARITY_TOL_RAD if letter in ROTARY else LINEARITY_TOL_MM) + rounding(values):
                return points
        points, stride = fewer, 2 * stride
    return points
