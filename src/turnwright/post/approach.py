"""Approach and plunge of a pass: down from a clear plane, and into the material only while C turns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import LimitError, ProgramError
from turnwright.machine import FAST, Machine
from turnwright.motion import from_rest_to_rest
from turnwright.path import Motion

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = [
    "DOWN_FEED",
    "GAP",
    "MOST_CLEARANCE",
    "PLUNGE_FEED",
    "TRAVERSE_FEED",
    "Approach",
    "entry_path",
    "entry_shares",
    "entry_words",
    "link_seconds",
    "plan_approach",
]

TURN = 2 * math.pi

GAP = 0.1
"""Smallest distance from the material with C at rest, vertical and lateral. [mm]"""
PLUNGE_FEED = 0.03
"""Default of the largest plunge feed into material. [mm/s]"""
MOST_CLEARANCE = 1000.0
"""Largest height of the clear plane above a pass. [mm]"""
TRAVERSE_FEED, DOWN_FEED = 500 / 60, 100 / 60
"""Feeds in free space: to and along the clear plane, and down from it. [mm/s]"""
MIN_PLUNGE_PER_REV = 1e-3
"""Plunge per revolution of a pass with a finer feed. [mm/rev]"""
MAX_POINTS = 5_000_000
"""Points of a plunge; more come from a wrong unit of a feed or a height."""
MAX_REV_S = 60.0
"""Time per revolution of a plunge whose pass is shorter than one revolution, or whose heights are extrapolated."""
MAX_REV_PVT_S = 4.0
"""The same for a pass with velocities (PVT)."""
MAX_BLOCK_PVT_S = 1.5
"""Time of a block of a plunge with velocities, at full speed; the first block, from rest, takes twice as long."""
FEED_FACTOR_PVT = 0.95
"""Fraction of the plunge feed used with velocities, as cubics between the points are slightly faster."""
MIN_STEP_PVT_RAD = math.radians(0.05)
"""Step of C in a plunge with velocities, which acceleration divides; also that of a closed pass below one turn."""
HEIGHTS_PER_STEP = 16
"""Entry heights per step of C with velocities: points of the acceleration lie between those of the pass."""
MIN_POINT_DISTANCE_RAD = math.radians(1e-5)
"""Distance in C below which a program cannot distinguish two points."""
SUBDIVISIONS = (16, 8, 4, 2, 1)
"""Subdivisions of a step of C with velocities; the largest that the block rate allows is tried first, as cubics through
few points deviate from the heights. Where acceleration cannot follow the path with it, the others are tried."""
FULL_SPEED_FRACTION = 0.99
"""Fraction of the speed from which a pass with velocities counts as at full speed."""
MAX_STEP_RAD = 0.9 * math.pi
"""Step of C in a plunge."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Approach:
    """Approach to the first point of a pass, in Turnwright's axes.

    Parameters
    ----------
    clear
        Height of the clear plane, along which the tool moves above all material. [mm]
    start
        Position by axis letter at the end of the straight move down from the clear plane, with C at rest.
    plunge
        Motion from there to the first point of the pass, while C turns; ``None`` where the pass begins in free space.
    per_rev
        Plunge per revolution; 0 without a plunge. [mm/rev]
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
        """Mean feed of the plunge, without the rise and fall of the surface. [mm/s]."""
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


def plan_approach(
    motion: Motion,
    *,
    clearance: float,
    depth: float | None,
    plunge_feed: float,
    name: str,
    heights: Floats | None = None,
) -> Approach:
    """Return the approach to a pass, see `write_nc`.

    ``depth`` is the height of the material above the path where the pass begins, ``None`` where it is clear of it [mm];
    ``heights`` are Z of the lathe at the angles of `entry_path`, shifted so that they begin at the first point of the
    pass. (n,) [mm]
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
    """Return the motion down to the first point of a pass, and its plunge per revolution [mm/rev]."""
    turned, time, around, advance = _extrapolate_first_turn(motion)
    z_angle, z = _height_angles(motion, turned), around["Z"]
    if heights is None:
        z_angle, uncertainty = turned, z - _extrapolate_one_term_less(motion, z)
    else:
        _require_heights(heights, z_angle, f"pass {name}")
        z, uncertainty = heights - heights[0] + z[0], np.zeros(turned.size)
        around["Z"] = z[:: (z_angle.size - 1) // (turned.size - 1)].copy()
    time, turns = _pace_plunge(motion, turned, time, height, plunge_feed, max(advance, MIN_PLUNGE_PER_REV), uncertainty)
    each = turned.size - 1
    if turns * each > MAX_POINTS:
        raise ProgramError(
            f"pass {name} plunges {height:.4g} mm by {height / turns * 1e3:.3g} um/rev with {turns * each:.3g} points, "
            f"the limit is {MAX_POINTS:.0e} points: reduce the depth of cut, or raise the plunge feed"
        )
    number = np.arange(turns * each + 1)
    turn, place = number // each, number % each
    axes = {letter: values[place] for letter, values in around.items()}
    axes["C"] = motion.axes["C"][0] + motion.sense * (turned[place] + TURN * (turn - turns))
    clock = time[place] + time[-1] * turn
    # Linear in time, so that no block is faster where C turns faster.
    axes["Z"] = axes["Z"] + height * (1 - clock / clock[-1])
    for letter, values in axes.items():
        values[-1] = motion.axes[letter][0]
    plunge = Motion(
        time=clock, axes={letter: axes[letter] for letter in motion.axes}, machine=motion.machine,
        spindle_mode=motion.spindle_mode,
    )  # fmt: skip
    if motion.velocity is None:
        return plunge, height / turns
    curves = {letter: _periodic_spline(turned, values) for letter, values in around.items()} | {
        "Z": _periodic_spline(z_angle, z)
    }
    fits = [each for each in SUBDIVISIONS if each == 1 or _fits(each, turned, time[-1], turns, motion.machine)]
    for subdivision in [*fits, *(each for each in reversed(SUBDIVISIONS) if each not in fits)]:
        with suppress(LimitError):
            divided = _add_velocities(plunge, curves, subdivision, height / turns)
            rested = _drop_close_points(from_rest_to_rest(divided))
            # Where C accelerates, points lie between the steps: not on cubics through the steps, but on the curves.
            return _on_curves(plunge, rested, curves, height / turns), height / turns
    raise ProgramError(
        f"pass {name} has too few points per revolution for a plunge with C rotating: use more, or begin it outside "
        "the blank"
    )


def _pace_plunge(
    motion: Motion, turned: Floats, time: Floats, height: float, plunge_feed: float, advance: float, uncertainty: Floats
) -> tuple[Floats, int]:
    """Return the time over one revolution of a plunge (n,) [s], and its number of revolutions."""
    longest = MAX_REV_S / float(time[-1])
    if motion.velocity is not None:
        widest = float(np.diff(turned).max())
        time = turned * min(1 / _find_top_speed(motion), MAX_BLOCK_PVT_S / widest)
        longest = MAX_BLOCK_PVT_S / float(np.diff(time).max())
    # Possible excess feed of extrapolated heights: twice the contribution of the last term of the extrapolation.
    excess = float((2 * np.abs(np.diff(uncertainty)) / np.diff(time)).max())
    slower = min(max(1.0, 2 * excess / plunge_feed), max(longest, 1.0))
    time = time * slower
    feed = plunge_feed if motion.velocity is None else FEED_FACTOR_PVT * plunge_feed
    per_rev = min(max(feed - excess / slower, feed / 2) * float(time[-1]), advance)
    turns = math.ceil(height / per_rev - 1e-9)
    # With velocities it accelerates from rest and stops again.
    return time, turns if motion.velocity is None else max(turns, 2)


def _find_top_speed(motion: Motion) -> float:
    """Return the largest speed of C in the plunge of a pass with velocities. [rad/s]."""
    assert motion.velocity is not None  # noqa: S101 - for the type checker
    turned = np.abs(motion.axes["C"] - motion.axes["C"][0])
    if turned[-1] < 2 * TURN:
        return max(float(turned[-1] / (motion.time[-1] - motion.time[0])), TURN / MAX_REV_PVT_S)
    return float(np.abs(motion.velocity["C"])[turned <= 2 * TURN].max())


def entry_path(motion: Motion, *, most: int = 3) -> tuple[Floats, dict[str, Floats]]:
    """Return the path of one revolution at the first point of a pass, where the heights of its plunge are needed.

    Angles from the first point, 0 to one full turn, as dense as the points of the pass, or 16 times as dense with
    velocities (n,) [rad]; and every axis but C at the radius of the first point, by letter, extrapolated from the first
    revolutions, at ``most`` so many (n,) [mm].
    """
    turned, _, axes, _ = _extrapolate_first_turn(motion, most=most)
    if motion.velocity is None:
        return turned, axes
    angle = _height_angles(motion, turned)
    return angle, {letter: _periodic_spline(turned, values)(angle) for letter, values in axes.items()}


def _height_angles(motion: Motion, turned: Floats) -> Floats:
    """Return the angles at which the heights of a plunge are needed; denser for the acceleration with velocities."""
    return turned if motion.velocity is None else _subdivide(turned, HEIGHTS_PER_STEP)


def _require_heights(heights: Floats, angle: Floats, what: str) -> None:
    if heights.shape != angle.shape or not np.isfinite(heights).all():
        raise ProgramError(
            f"{what} has entry heights of shape {heights.shape}, they must be finite and {angle.shape}: give one for "
            "each angle of entry_path"
        )


def entry_shares(motion: Motion, heights: Floats) -> tuple[Floats, dict[str, Floats]]:
    """Split the heights of a plunge, Z and W together, between lathe and fast tool.

    The lathe moves as in the first revolutions of the pass, the fast tool adds the difference. Returned are Z at the
    angles of `entry_path` of the lathe's motion, (m,) [mm], and the fast tool's axes by letter at those of the whole
    motion. Each (n,) [mm]
    """
    angle, axes = entry_path(motion)
    _require_heights(heights, angle, "the pass")
    turned, lathe = entry_path(motion.lathe())
    z = lathe["Z"]
    lathe_z = np.interp(angle, turned, z) if motion.velocity is None else _periodic_spline(turned, z)(angle)
    fast = {letter: values for letter, values in axes.items() if letter in FAST}
    return z, fast | {"W": heights - heights[0] + axes["Z"][0] + axes["W"][0] - lathe_z}


def _periodic_spline(turned: Floats, values: Floats) -> CubicSpline:
    """Return the periodic cubic spline of values over one turn."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

    return CubicSpline(turned, np.append(values[:-1], values[0]), bc_type="periodic")


def _subdivide(turned: Floats, each: int) -> Floats:
    steps = turned.size - 1
    return np.interp(np.arange(each * steps + 1) / each, np.arange(steps + 1), turned)


def _fits(subdivision: int, turned: Floats, turn_s: float, turns: int, machine: Machine) -> bool:
    steps = np.diff(turned).min() / subdivision
    points = turns * (turned.size - 1) * subdivision
    fast_enough = steps * turn_s / TURN * machine.block_rate_hz >= 1
    return bool(fast_enough and steps >= MIN_STEP_PVT_RAD and points <= MAX_POINTS)


def _drop_close_points(plunge: Motion) -> Motion:
    """Return a motion without the points near rest that a program cannot distinguish."""
    assert plunge.velocity is not None  # noqa: S101 - for the type checker
    c = np.abs(plunge.axes["C"] - plunge.axes["C"][0])
    if np.diff(c).min() >= MIN_POINT_DISTANCE_RAD:
        return plunge
    unit = np.floor(c / MIN_POINT_DISTANCE_RAD)
    distinct = np.append(True, np.diff(unit) > 0)
    distinct[-1] = True
    before = int(np.flatnonzero(distinct[:-1])[-1])
    distinct[before] = before == 0 or c[-1] - c[before] >= MIN_POINT_DISTANCE_RAD
    return replace(
        plunge, time=plunge.time[distinct],
        axes={letter: values[distinct] for letter, values in plunge.axes.items()},
        velocity={letter: values[distinct] for letter, values in plunge.velocity.items()},
    )  # fmt: skip


def _add_velocities(plunge: Motion, curves: Mapping[str, CubicSpline], subdivision: int, per_rev: float) -> Motion:
    """Return a plunge at constant speed with the velocities of its axes, each step subdivided."""
    steps = np.arange(subdivision * (plunge.time.size - 1) + 1) / subdivision
    number = np.arange(plunge.time.size)
    time = np.interp(steps, number, plunge.time)
    axes = {letter: np.interp(steps, number, values) for letter, values in plunge.axes.items()}
    pace = (axes["C"][-1] - axes["C"][0]) / (time[-1] - time[0])
    velocity = dict.fromkeys(axes, np.zeros(time.size)) | {"C": np.full(time.size, pace)}
    return _on_curves(plunge, replace(plunge, time=time, axes=axes, velocity=velocity), curves, per_rev)


def _on_curves(plunge: Motion, motion: Motion, curves: Mapping[str, CubicSpline], per_rev: float) -> Motion:
    """Return a motion of a plunge with the axes but C on their curves over one turn, at its times and angles."""
    assert motion.velocity is not None  # noqa: S101 - for the type checker
    c, speed = motion.axes["C"], motion.velocity["C"]
    turned = np.mod(np.abs(c - plunge.axes["C"][0]), TURN)
    axes, velocity = {"C": np.array(c)}, {"C": speed}
    for letter, curve in curves.items():
        axes[letter], velocity[letter] = curve(turned), np.abs(speed) * curve(turned, 1)
    axes["Z"] += per_rev * np.abs(c - c[-1]) / TURN
    velocity["Z"] -= per_rev * np.abs(speed) / TURN
    for letter, values in axes.items():
        values[-1] = plunge.axes[letter][-1]
    return replace(
        motion, axes={letter: axes[letter] for letter in plunge.axes},
        velocity={letter: velocity[letter] for letter in plunge.axes},
    )  # fmt: skip


def _extrapolate_one_term_less(motion: Motion, z: Floats) -> Floats:
    """Return the heights extrapolated from one revolution fewer; ``z`` if the pass has only one. (n,)."""
    turns = float(abs(motion.axes["C"][-1] - motion.axes["C"][0])) / TURN + 1e-9
    if turns < 2:
        return z
    return _extrapolate_first_turn(motion, most=min(int(turns), 3) - 1)[2]["Z"]


def _extrapolate_first_turn(motion: Motion, *, most: int = 3) -> tuple[Floats, Floats, dict[str, Floats], float]:
    """Return the path of one revolution at the radius of the first point of a pass.

    The other axes at the radius of the first point are extrapolated by a parabola through the first three revolutions,
    or through ``most`` if that is fewer. After one full turn the extrapolation error is known from the first point. It
    grows as the product of the distances from the three radii and is subtracted in proportion all around, so that the
    turn closes without a step. Returned are the angle from the first point, 0 to one full turn (n,) [rad]; the time
    (n,) [s]; every axis but C, by letter (n,) [mm]; and the change of X in the first revolution [mm].
    """
    if motion.velocity is None:  # else which points begin the turn is decided by the speeds of the whole pass
        motion = motion.select(slice(motion.reached((most + 1) * TURN) + 4))
    angle = np.abs(motion.axes["C"] - motion.axes["C"][0])
    x = motion.axes["X"]
    last = int(np.searchsorted(angle, TURN - 1e-9))
    letters = [letter for letter in motion.axes if letter != "C"]
    if last >= angle.size:
        # A pass of less than a revolution is closed by interpolation, at constant speed.
        step = max(min(float(np.diff(angle).max()), math.pi / 4), MIN_STEP_PVT_RAD)
        turned = np.linspace(0, TURN, max(math.ceil(TURN / step), 8) + 1)
        pace = min(float(motion.time[-1] - motion.time[0]) / float(angle[-1]), MAX_REV_S / TURN)
        axes = {letter: np.interp(turned, angle, motion.axes[letter], period=TURN) for letter in letters}
        axes["X"] = np.full(turned.size, x[0])
        return turned, turned * pace, axes, abs(float(x[-1] - x[0])) * TURN / float(angle[-1])
    turned = angle[:last] if motion.velocity is None else _drop_acceleration_points(motion, angle, last)
    closing = TURN - turned[-1]
    if last > 2 and closing < 0.5 * float(np.median(np.diff(turned))):
        # A point close to the end of the turn would make a short block: drop it, or move it to the middle of the gap.
        wide = closing + turned[-1] - turned[-2] >= MAX_STEP_RAD
        turned = np.append(turned[:-1], [turned[-2] + (TURN - turned[-2]) / 2] if wide else [])
    turned = np.append(turned, TURN)
    time = np.interp(turned, angle, motion.time) - motion.time[0]

    count = min(int(angle[-1] / TURN + 1e-9), most)
    first_turns = slice(0, int(np.searchsorted(angle, count * TURN)) + 4)

    def at(values: Floats, turn: int) -> Floats:
        place = turned + turn * TURN
        if motion.velocity is None:
            return np.interp(place, angle, values)
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - costly to import

        return np.asarray(CubicSpline(angle[first_turns], values[first_turns])(np.minimum(place, angle[-1])))

    radii = [at(x, turn) for turn in range(count)]
    axes = {"X": np.full(turned.size, x[0])}
    weights = _lagrange_weights(radii, float(x[0]))
    fraction = turned / TURN
    if len(weights) > 1:
        growth = np.prod([float(x[0]) - radius for radius in radii[: len(weights)]], axis=0)
        fraction = np.clip(growth / growth[-1], 0.0, 1.0)
    for letter in letters:
        if letter != "X":
            values = sum(weight * at(motion.axes[letter], turn) for turn, weight in enumerate(weights))
            first = motion.axes[letter][0]
            axes[letter] = np.asarray(values - (np.asarray(values)[-1] - first) * fraction)
            axes[letter][[0, -1]] = first
    return turned, time, axes, abs(float(at(x, 0)[-1] - x[0]))


def _drop_acceleration_points(motion: Motion, angle: Floats, last: int) -> Floats:
    """Return the angles of the first points of a pass, without the subdivision of its acceleration. (n,) [rad]."""
    assert motion.velocity is not None  # noqa: S101 - for the type checker
    speed, steps = np.abs(motion.velocity["C"]), np.diff(angle)
    steady = np.minimum(speed[1:], speed[:-1]) >= FULL_SPEED_FRACTION * speed.max()
    least = max(float(steps[steady].min()) if steady.any() else float(steps.max()) / 2, MIN_STEP_PVT_RAD)
    selected = [0]
    for number in range(1, last):
        if angle[number] - angle[selected[-1]] >= least * (1 - 1e-6):
            selected.append(number)
    return np.asarray(angle[selected])


def _lagrange_weights(radii: list[Floats], radius: float) -> list[Floats]:
    """Return the Lagrange weights of revolutions at a radius, without revolutions at nearly the same radius."""
    largest = max((float(np.ptp(radius)) for radius in radii), default=0.0)
    gaps = [float(np.abs(after - before).min()) for before, after in pairwise(radii)]
    count = next((k + 1 for k, gap in enumerate(gaps) if not gap > max(1e-9, 0.2 * largest)), len(radii))
    weights = []
    for i in range(count):
        weight = np.ones(radii[0].size)
        for j in range(count):
            if j != i:
                weight = weight * (radius - radii[j]) / (radii[i] - radii[j])
        weights.append(weight)
    return weights


def link_seconds(approaches: list[tuple[Approach, Motion]], machine: Machine) -> float:
    """Return the time of all approaches, plunges and retracts, without the move to the first clear plane. [s]."""
    seconds = 0.0
    place: dict[str, float] | None = None
    for approach, motion in approaches:
        if place is not None:
            lateral = math.hypot(*(approach.start[letter] - place[letter] for letter in "XY" if letter in place))
            seconds += (abs(place["Z"] - approach.clear) + lateral) / TRAVERSE_FEED
            seconds += motion.sense * (approach.start["C"] - place["C"]) % TURN / TURN * 60 / machine.spindle_rpm
        seconds += (approach.clear - approach.start["Z"]) / DOWN_FEED + approach.plunge_s
        place = {letter: float(values[-1]) for letter, values in motion.axes.items()}
        seconds += (approach.clear - place["Z"]) / DOWN_FEED
        place["Z"] = approach.clear
    return seconds


def entry_words(approach: Approach) -> str:
    """Return a sentence on the entry into the material of a pass."""
    if approach.plunge is None:
        return "begins clear of the material, no plunge"
    rotating = "C" if approach.plunge.spindle_mode is None else "the spindle"
    return (
        f"{rotating} rotates while the tool plunges {approach.height:.3f} mm at {approach.plunge_feed * 60:.3f} "
        f"mm/min, {approach.per_rev * 1e3:.3f} um a revolution"
    )
