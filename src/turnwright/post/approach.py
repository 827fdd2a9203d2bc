"""How the tool comes to a pass and leaves it: down from a clear plane, and into the material only while C turns."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from turnwright.errors import LimitError, ProgramError
from turnwright.machine import FAST
from turnwright.motion import from_rest_to_rest
from turnwright.path import Motion

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scipy.interpolate import CubicSpline

    from turnwright._arrays import Floats
    from turnwright.machine import Machine

__all__ = [
    "DOWN",
    "GAP",
    "MOST_CLEARANCE",
    "PLUNGE_FEED",
    "TRAVERSE",
    "Approach",
    "approach_to",
    "entry_path",
    "entry_shares",
    "entry_words",
    "link_seconds",
]

TURN = 2 * math.pi

GAP = 0.1
"""Height above material, and distance beside it, down to which the tool may move with C at rest. [mm]"""
PLUNGE_FEED = 0.03
"""Fastest plunge into material, unless another is stated. [mm/s]"""
MOST_CLEARANCE = 1000.0
"""Highest clear plane above a pass. [mm]"""
TRAVERSE, DOWN = 500 / 60, 100 / 60
"""Feeds in free space: to and along the clear plane, and down from it. [mm/s]"""
LEAST_ADVANCE = 1e-3
"""Least plunge in a revolution, however fine the feed of the pass. [mm/rev]"""
MOST_POINTS = 5_000_000
"""Points of a plunge: beyond this a feed or a height is a slip of the unit."""
SLOWEST = 60.0
"""Longest revolution of a plunge whose pass is less than one, or whose heights are extrapolated. [s]"""
SLOWEST_PVT = 4.0
"""The same where the pass states velocities. [s]"""
LONGEST_PVT = 1.5
"""Longest block of a plunge there at its speed; the first one, from rest, takes twice as long. [s]"""
ROOM_PVT = 0.95
"""Share of the stated feed there: between the points of the pass cubics fall a little faster."""
FINEST = math.radians(0.05)
"""Least step of C there, whose way to speed divides it, and where a pass of less than a turn is closed. [rad]"""
BETWEEN = 16
"""Heights that are wanted on each step of C there: on the way to speed its points lie between those of the pass."""
LEAST_STEP = math.radians(1e-5)
"""Points of C nearer than this are one to a program. [rad]"""
FINER = (16, 8, 4, 2, 1)
"""Into how many each step of C is divided there, the finest that the block rate allows: cubics through few points leave
the heights between them. Where the way to speed cannot stay on the path with that, others are tried."""
STEADY = 0.99
"""A pass that states velocities is at its speed from this share of it on."""
WIDEST = 0.9 * math.pi
"""Widest step of C in a plunge. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Approach:
    """How the tool comes to the first point of a pass, in Turnwright's own axes.

    Parameters
    ----------
    clear
        Height of the clear plane, along which the tool moves above all material. [mm]
    start
        Position by axis letter where the way straight down from the clear plane ends, C at rest until then.
    plunge
        From there to the first point of the pass, while C turns; ``None`` where the pass begins in free space.
    per_rev
        Plunge in a revolution; 0 without one. [mm/rev]
    """

    clear: float
    start: Mapping[str, float]
    plunge: Motion | None
    per_rev: float = 0.0

    @property
    def plunge_s(self) -> float:
        """Time of the plunge. [s]."""
        return 0.0 if self.plunge is None else float(self.plunge.time[-1] - self.plunge.time[0])

    @property
    def plunge_feed(self) -> float:
        """Mean speed of the plunge, what the surface under the tool rises and falls by apart. [mm/s]."""
        return 0.0 if self.plunge is None else self.per_rev * self.turns / self.plunge_s

    @property
    def turns(self) -> float:
        """Revolutions of C in the plunge."""
        if self.plunge is None:
            return 0.0
        return float(abs(self.plunge.axes["C"][-1] - self.plunge.axes["C"][0])) / TURN

    @property
    def height(self) -> float:
        """Height above the path of the pass at which the plunge begins. [mm]."""
        return self.per_rev * self.turns


def approach_to(
    motion: Motion,
    *,
    clearance: float,
    depth: float | None,
    plunge_feed: float,
    name: str,
    heights: Floats | None = None,
) -> Approach:
    """Return the approach to a pass.

    Straight down from the clear plane, C at rest, to 0.1 mm above the material; then C turns at the speed of the pass
    and the tool follows the heights of one revolution at the radius where the pass begins, raised by less and less. In
    a revolution it plunges by no more than the pass advances (or 1 um), and in no block faster than ``plunge_feed``.
    Where the heights are extrapolated, what that may add to the fall of a block counts, and C turns slower if it must,
    up to a minute a revolution.

    Parameters
    ----------
    motion
        The pass.
    clearance
        Of the clear plane above its highest point. [mm]
    depth
        Height of the material above the path at the radius where the pass begins; ``None`` where it begins clear of
        the material. [mm]
    plunge_feed
        Fastest plunge. [mm/s]
    name
        Of the pass, for messages.
    heights
        Z of the lathe at the radius where the pass begins, at the angles of `entry_path`; shifted so that they begin
        at the first point of the pass. Without them they are extrapolated from its first revolutions. (n,) [mm]
    """
    clear = float(motion.axes["Z"].max()) + clearance
    first = {letter: float(values[0]) for letter, values in motion.axes.items()}
    if depth is None:
        return Approach(clear=clear, start=first, plunge=None)
    plunge, per_rev = _plunge(motion, max(depth, 0.0) + GAP, plunge_feed, name, heights)
    start = {letter: float(values[0]) for letter, values in plunge.axes.items()}
    return Approach(clear=max(clear, start["Z"]), start=start, plunge=plunge, per_rev=per_rev)


def _plunge(
    motion: Motion, height: float, plunge_feed: float, name: str, heights: Floats | None
) -> tuple[Motion, float]:
    """Return the motion down to the first point of a pass, and its depth in a revolution [mm/rev]."""
    turned, time, around, advance = _first_turn(motion)
    z_angle, z = _wanted(motion, turned), around["Z"]
    if heights is None:
        z_angle, doubt = turned, z - _one_term_less(motion, z)
    else:
        _require_heights(heights, z_angle, f"pass {name}")
        z, doubt = heights - heights[0] + z[0], np.zeros(turned.size)
        around["Z"] = z[:: (z_angle.size - 1) // (turned.size - 1)].copy()
    time, turns = _paced(motion, turned, time, height, plunge_feed, max(advance, LEAST_ADVANCE), doubt)
    each = turned.size - 1
    if turns * each > MOST_POINTS:
        raise ProgramError(
            f"pass {name} plunges {height:.4g} mm by {height / turns * 1e3:.3g} um in a revolution, "
            f"{turns * each:.3g} points, the limit is {MOST_POINTS:.0e}: take less off at a time, or raise the plunge "
            "feed"
        )
    number = np.arange(turns * each + 1)
    turn, place = number // each, number % each
    axes = {letter: values[place] for letter, values in around.items()}
    axes["C"] = motion.axes["C"][0] + motion.sense * (turned[place] + TURN * (turn - turns))
    clock = time[place] + time[-1] * turn
    # Evenly in time, so that no block is faster where C is.
    axes["Z"] = axes["Z"] + height * (1 - clock / clock[-1])
    for letter, values in axes.items():
        values[-1] = motion.axes[letter][0]
    plunge = Motion(time=clock, axes={letter: axes[letter] for letter in motion.axes}, machine=motion.machine)
    if motion.velocity is None:
        return plunge, height / turns
    curves = {letter: _closed(turned, values) for letter, values in around.items()} | {"Z": _closed(z_angle, z)}
    fits = [one for one in FINER if one == 1 or _fits(one, turned, time[-1], turns, motion.machine)]
    for finer in [*fits, *(one for one in reversed(FINER) if one not in fits)]:
        with suppress(LimitError):
            divided = _in_velocities(plunge, turned, curves, finer, height / turns)
            return _apart(from_rest_to_rest(divided)), height / turns
    raise ProgramError(
        f"pass {name} has too few points per turn to plunge with C turning: give it more, or begin it beside the blank"
    )


def _paced(
    motion: Motion, turned: Floats, time: Floats, height: float, plunge_feed: float, advance: float, doubt: Floats
) -> tuple[Floats, int]:
    """Return the time over a turn of a plunge (n,) [s], and its turns."""
    longest = SLOWEST / float(time[-1])
    if motion.velocity is not None:
        widest = float(np.diff(turned).max())
        time = turned * min(1 / _fastest(motion), LONGEST_PVT / widest)
        longest = LONGEST_PVT / float(np.diff(time).max())
    # What the heights may fall beyond the part's: twice what the last term of their extrapolation adds to a block.
    beyond = float((2 * np.abs(np.diff(doubt)) / np.diff(time)).max())
    slower = min(max(1.0, 2 * beyond / plunge_feed), max(longest, 1.0))
    time = time * slower
    room = plunge_feed if motion.velocity is None else ROOM_PVT * plunge_feed
    per_rev = min(max(room - beyond / slower, room / 2) * float(time[-1]), advance)
    turns = math.ceil(height / per_rev - 1e-9)
    # In velocities it comes to speed and to rest.
    return time, turns if motion.velocity is None else max(turns, 2)


def _fastest(motion: Motion) -> float:
    """Return how fast C turns at most in the plunge to a pass that states velocities. [rad/s]."""
    assert motion.velocity is not None  # noqa: S101 - for the type checker
    passed = np.abs(motion.axes["C"] - motion.axes["C"][0])
    if passed[-1] < 2 * TURN:
        return max(float(passed[-1] / (motion.time[-1] - motion.time[0])), TURN / SLOWEST_PVT)
    return float(np.abs(motion.velocity["C"])[passed <= 2 * TURN].max())


def entry_path(motion: Motion) -> tuple[Floats, dict[str, Floats]]:
    """Return the path of a pass around its first point, where the heights of its plunge are wanted.

    Parameters
    ----------
    motion
        The pass.

    Returns
    -------
    turned, axes
        Angles from the first point, 0 to a whole turn, as dense as the points of the pass, or 16 times where it states
        velocities (n,) [rad]; and every axis but C there at the radius of the first point, by letter, extrapolated from
        the first revolutions (n,) [mm].
    """
    turned, _, axes, _ = _first_turn(motion)
    if motion.velocity is None:
        return turned, axes
    angle = _wanted(motion, turned)
    return angle, {letter: _closed(turned, values)(angle) for letter, values in axes.items()}


def _wanted(motion: Motion, turned: Floats) -> Floats:
    """Return the angles at which the heights of a plunge are wanted: on its way to speed points lie between others."""
    return turned if motion.velocity is None else _finely(turned, BETWEEN)


def _require_heights(heights: Floats, angle: Floats, what: str) -> None:
    if heights.shape != angle.shape or not np.isfinite(heights).all():
        raise ProgramError(
            f"{what} has entry heights of shape {heights.shape}, they must be finite and {angle.shape}: give one for "
            "each angle of its first revolution"
        )


def entry_shares(motion: Motion, heights: Floats) -> tuple[Floats, dict[str, Floats]]:
    """Share the heights of a plunge among lathe and fast tool.

    The lathe goes on as in the first revolutions of the pass, the fast tool adds the rest.

    Parameters
    ----------
    motion
        The pass, with W.
    heights
        Z and W together, at the angles of `entry_path`. (n,) [mm]

    Returns
    -------
    lathe, fast
        Z at the angles of `entry_path` of the lathe's share, (m,) [mm]; the fast tool's axes by letter at those of the
        motion. Each (n,) [mm]
    """
    angle, axes = entry_path(motion)
    _require_heights(heights, angle, "the pass")
    turned, lathe = entry_path(motion.lathe())
    z = lathe["Z"]
    between = np.interp(angle, turned, z) if motion.velocity is None else _closed(turned, z)(angle)
    fast = {letter: values for letter, values in axes.items() if letter in FAST}
    return z, fast | {"W": heights - heights[0] + axes["Z"][0] + axes["W"][0] - between}


def _closed(turned: Floats, values: Floats) -> CubicSpline:
    """Return the cubic spline of values that repeat with every turn."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

    return CubicSpline(turned, np.append(values[:-1], values[0]), bc_type="periodic")


def _finely(turned: Floats, each: int) -> Floats:
    """Return angles with each step divided into some."""
    steps = turned.size - 1
    return np.interp(np.arange(each * steps + 1) / each, np.arange(steps + 1), turned)


def _fits(finer: int, turned: Floats, turn_s: float, turns: int, machine: Machine) -> bool:
    """Say whether each step of a plunge may be divided into so many."""
    steps = np.diff(turned).min() / finer
    points = turns * (turned.size - 1) * finer
    fast_enough = steps * turn_s / TURN * machine.block_rate_hz >= 1
    return bool(fast_enough and steps >= FINEST and points <= MOST_POINTS)


def _apart(plunge: Motion) -> Motion:
    """Return a motion without the points, near where it is at rest, that a program cannot tell apart."""
    assert plunge.velocity is not None  # noqa: S101 - for the type checker
    c = np.abs(plunge.axes["C"] - plunge.axes["C"][0])
    if np.diff(c).min() >= LEAST_STEP:
        return plunge
    unit = np.floor(c / LEAST_STEP)
    kept = np.append(True, np.diff(unit) > 0)
    kept[-1] = True
    before = int(np.flatnonzero(kept[:-1])[-1])
    kept[before] = before == 0 or c[-1] - c[before] >= LEAST_STEP
    return replace(
        plunge, time=plunge.time[kept], axes={letter: values[kept] for letter, values in plunge.axes.items()},
        velocity={letter: values[kept] for letter, values in plunge.velocity.items()},
    )  # fmt: skip


def _in_velocities(
    plunge: Motion, turned: Floats, curves: Mapping[str, CubicSpline], finer: int, per_rev: float
) -> Motion:
    """Return a plunge at a steady speed with the velocities of its axes, each step divided into some."""
    each = turned.size - 1
    steps = np.arange(finer * (plunge.time.size - 1) + 1) / finer
    angle = _finely(turned, finer)
    place = np.arange(steps.size) % (finer * each)
    time = np.interp(steps, np.arange(plunge.time.size), plunge.time)
    c = np.interp(steps, np.arange(plunge.time.size), plunge.axes["C"])
    pace = (c[-1] - c[0]) / (time[-1] - time[0])
    axes, velocity = {"C": c}, {"C": np.full(c.size, pace)}
    for letter, curve in curves.items():
        axes[letter], velocity[letter] = curve(angle)[place], abs(pace) * curve(angle, 1)[place]
    left = np.abs(c - c[-1]) / TURN
    axes["Z"], velocity["Z"] = axes["Z"] + per_rev * left, velocity["Z"] - per_rev * abs(pace) / TURN
    for letter, values in axes.items():
        values[-1] = plunge.axes[letter][-1]
    return replace(
        plunge, time=time, axes={letter: axes[letter] for letter in plunge.axes},
        velocity={letter: velocity[letter] for letter in plunge.axes},
    )  # fmt: skip


def _one_term_less(motion: Motion, z: Floats) -> Floats:
    """Return the heights around the first point from one revolution less; those given if it has only one. (n,)."""
    turns = float(abs(motion.axes["C"][-1] - motion.axes["C"][0])) / TURN + 1e-9
    if turns < 2:
        return z
    return _first_turn(motion, most=min(int(turns), 3) - 1)[2]["Z"]


def _first_turn(motion: Motion, *, most: int = 3) -> tuple[Floats, Floats, dict[str, Floats], float]:
    """Return the path of a pass around its first point, at the radius of that point.

    The radius of a pass changes over its first revolution. What its other axes are at the radius of the first point is
    extrapolated from its first three revolutions by the parabola through them, or from fewer if ``most`` says so. After
    a whole turn the error of that is known, as the first point is; it grows as the product of the distances from the
    three radii, and this share of it is taken off all around, so that the turn closes without a step.

    Returns
    -------
    turned, time, axes, advance
        Angle from the first point, 0 to a whole turn (n,) [rad]; time (n,) [s]; every axis but C there, by letter (n,)
        [mm]; and how far the first revolution moves X [mm].
    """
    angle = np.abs(motion.axes["C"] - motion.axes["C"][0])
    x = motion.axes["X"]
    last = int(np.searchsorted(angle, TURN - 1e-9))
    letters = [letter for letter in motion.axes if letter != "C"]
    if last >= angle.size:
        # Less than a revolution says nothing of the rest of the way around: it is bridged, at an even pace.
        step = max(min(float(np.diff(angle).max()), math.pi / 4), FINEST)
        turned = np.linspace(0, TURN, max(math.ceil(TURN / step), 8) + 1)
        pace = min(float(motion.time[-1] - motion.time[0]) / float(angle[-1]), SLOWEST / TURN)
        axes = {one: np.interp(turned, angle, motion.axes[one], period=TURN) for one in letters}
        axes["X"] = np.full(turned.size, x[0])
        return turned, turned * pace, axes, abs(float(x[-1] - x[0])) * TURN / float(angle[-1])
    turned = angle[:last] if motion.velocity is None else _as_at_speed(motion, angle, last)
    closing = TURN - turned[-1]
    if last > 2 and closing < 0.5 * float(np.median(np.diff(turned))):
        # A point so near to the end of the turn would make a block too short: it goes, or to the middle of its gap.
        wide = closing + turned[-1] - turned[-2] >= WIDEST
        turned = np.append(turned[:-1], [turned[-2] + (TURN - turned[-2]) / 2] if wide else [])
    turned = np.append(turned, TURN)
    time = np.interp(turned, angle, motion.time) - motion.time[0]

    known = min(int(angle[-1] / TURN + 1e-9), most)
    some = slice(0, int(np.searchsorted(angle, known * TURN)) + 4)

    def at(values: Floats, turn: int) -> Floats:
        place = turned + turn * TURN
        if motion.velocity is None:
            return np.interp(place, angle, values)
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

        return np.asarray(CubicSpline(angle[some], values[some])(np.minimum(place, angle[-1])))

    radii = [at(x, turn) for turn in range(known)]
    axes = {"X": np.full(turned.size, x[0])}
    weights = _weights(radii, float(x[0]))
    share = turned / TURN
    if len(weights) > 1:
        away = np.prod([float(x[0]) - one for one in radii[: len(weights)]], axis=0)
        share = np.clip(away / away[-1], 0.0, 1.0)
    for letter in letters:
        if letter != "X":
            values = sum(weight * at(motion.axes[letter], turn) for turn, weight in enumerate(weights))
            first = motion.axes[letter][0]
            axes[letter] = np.asarray(values - (np.asarray(values)[-1] - first) * share)
            axes[letter][[0, -1]] = first
    return turned, time, axes, abs(float(at(x, 0)[-1] - x[0]))


def _as_at_speed(motion: Motion, angle: Floats, last: int) -> Floats:
    """Return the angles of the first points of a pass without those that its way to speed is divided by. (n,) [rad]."""
    assert motion.velocity is not None  # noqa: S101 - for the type checker
    speed, steps = np.abs(motion.velocity["C"]), np.diff(angle)
    steady = np.minimum(speed[1:], speed[:-1]) >= STEADY * speed.max()
    least = max(float(steps[steady].min()) if steady.any() else float(steps.max()) / 2, FINEST)
    kept = [0]
    for number in range(1, last):
        if angle[number] - angle[kept[-1]] >= least * (1 - 1e-6):
            kept.append(number)
    return np.asarray(angle[kept])


def _weights(radii: list[Floats], radius: float) -> list[Floats]:
    """Return Lagrange's weights of some revolutions at a radius; of the first alone where the others coincide."""
    far = max((float(np.ptp(one)) for one in radii), default=0.0)
    apart = [float(np.abs(after - before).min()) for before, after in pairwise(radii)]
    count = next((k + 1 for k, gap in enumerate(apart) if not gap > max(1e-9, 0.2 * far)), len(radii))
    weights = []
    for i in range(count):
        weight = np.ones(radii[0].size)
        for j in range(count):
            if j != i:
                weight = weight * (radius - radii[j]) / (radii[i] - radii[j])
        weights.append(weight)
    return weights


def link_seconds(approaches: list[tuple[Approach, Motion]], machine: Machine) -> float:
    """Return the time of all approaches, plunges and retracts; that of the way to the first clear plane apart. [s]."""
    seconds = 0.0
    place: dict[str, float] | None = None
    for approach, motion in approaches:
        if place is not None:
            lateral = math.hypot(*(approach.start[letter] - place[letter] for letter in "XY" if letter in place))
            seconds += (abs(place["Z"] - approach.clear) + lateral) / TRAVERSE
            seconds += motion.sense * (approach.start["C"] - place["C"]) % TURN / TURN * 60 / machine.spindle_rpm
        seconds += (approach.clear - approach.start["Z"]) / DOWN + approach.plunge_s
        place = {letter: float(values[-1]) for letter, values in motion.axes.items()}
        seconds += (approach.clear - place["Z"]) / DOWN
        place["Z"] = approach.clear
    return seconds


def entry_words(approach: Approach) -> str:
    """Say how the tool enters the material of a pass."""
    if approach.plunge is None:
        return "begins clear of the material, no plunge"
    return (
        f"C turns while the tool plunges {approach.height:.3f} mm at {approach.plunge_feed * 60:.3f} mm/min, "
        f"{approach.per_rev * 1e3:.3f} um a revolution"
    )
