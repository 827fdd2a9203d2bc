"""Find the highest spindle speed, constant or over the radius, at which the servos keep their share of the error."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import LimitError
from turnwright.generation import generate_polar
from turnwright.heightmap import HeightMap
from turnwright.job.contributions import FEWEST_ANGLES, lines, without_servos
from turnwright.machine import Machine
from turnwright.motion import check_limits, drive
from turnwright.part import Part
from turnwright.path import Motion, Path, Spiral
from turnwright.speed_profile import SpeedProfile
from turnwright.strategy import Strategy
from turnwright.tool import Tool
from turnwright.tracking import precorrect, track

__all__ = ["NEAR", "ROUNDS", "Servos", "at_speed", "few_lines", "guess", "largest", "round_down"]

TURN = 2 * math.pi
NEAR = 0.93
"""Fraction of a limit from which on a search stops."""

TARGET = (1 + NEAR) / 2

ROUNDS = 8
MIN_SPEED_FRACTION = 0.05
"""Smallest fraction to which a speed profile is lowered so that the axes can ramp to it and to rest."""

SAMPLE_STEP = 4
"""Only every n-th sample is used where only the difference of two surfaces counts."""

TRACKING_CHORD_MM = 1e-5
FIRST_EXPONENT = 1.6
"""Exponent of the tracking error over the speed to begin with: 1, or 2 with feed forward."""

EXPONENT_RANGE = (0.5, 4.0)

MAX_STEP_RATIO = 8.0
"""Largest ratio by which a value is reduced in one iteration, since the error may be overestimated."""

VALUE_RATIO = 4.0
ERROR_RATIO = 0.95
"""A value does not cause an error that stays above ERROR_RATIO while the value is reduced by VALUE_RATIO."""

RINGS = 24
MARGIN_BLOCKS = 3
"""Blocks on either side of a ring that count for its limits: the span of a jerk."""

LIMIT_TOL = 1e-3
"""Relative excess up to which a limit counts as kept, as in `check_limits`."""


def few_lines(part: Part, feed: float, passed: Floats) -> tuple[Floats, Floats]:
    """Return radii and azimuths that resolve the difference of two surfaces. (n,) [mm], (m,) [rad]."""
    radius, angle = lines(part, SAMPLE_STEP * feed, passed)
    return radius, angle[:: min(SAMPLE_STEP, angle.size // FEWEST_ANGLES)]


def round_down(value: float) -> float:
    """Round a number down to four digits."""
    places = 3 - math.floor(math.log10(value))
    return float(Decimal(math.floor(value * 10.0**places)).scaleb(-places))


def at_speed(motion: Motion, factor: float) -> Motion:
    """Return a motion with its speed multiplied by a factor."""
    faster = None
    if motion.velocity is not None:
        faster = {letter: values * factor for letter, values in motion.velocity.items()}
    return replace(motion, time=motion.time / factor, velocity=faster)


def guess(known: list[tuple[float, float]], limit: float) -> float:
    """Estimate the value whose error is just within its limit, from known (value, error); infinity if none is known.

    The pairs with errors closest to the limit are used, with a power law between them.
    """
    pairs = sorted((abs(math.log(error / limit)), value, error) for value, error in known if 0 < error < math.inf)
    if not pairs:
        return math.inf
    _, value, error = pairs[0]
    exponent = FIRST_EXPONENT
    for _, other, other_error in pairs[1:]:
        if other != value and other_error != error:
            exponent = math.log(other_error / error) / math.log(other / value)
            exponent = min(max(exponent, EXPONENT_RANGE[0]), EXPONENT_RANGE[1])
            break
    return float(value * (TARGET * limit / error) ** (1 / exponent))


def largest(error: Callable[[float], float], limit: float, first: float, most: float = math.inf) -> float:
    """Find a value, up to ``most``, whose increasing error is within its limit and close to it; 0 if there is none.

    The search ends after a number of iterations, and where a smaller value does not reduce the error.
    """
    low, high = 0.0, math.inf
    pairs: list[tuple[float, float]] = []
    value = min(first, most)
    for _ in range(2 * ROUNDS):
        pairs.append((value, error(value)))
        if pairs[-1][1] <= limit:
            low = value
            if value == most or pairs[-1][1] >= NEAR * limit:
                break
        else:
            high = value
            if any(
                other >= VALUE_RATIO * value and ERROR_RATIO * other_error <= pairs[-1][1]
                for other, other_error in pairs
                if other_error < math.inf
            ):
                break
        top = min(high, most)
        if low and top / low < 1 / NEAR:
            break
        value = guess(pairs, limit)
        if value >= most and high > most:
            value = most
        elif not low < value < top:
            value = (low + top) / 2
        value = max(value, pairs[-1][0] / MAX_STEP_RATIO)
    return low


class Servos:
    """Surface errors from the servos of a machine, for motions over a part that may be precorrected for them.

    ``spiral`` is that of any of the motions: its feed sets the sampling, and azimuths keep clear of its ends.
    """

    def __init__(self, part: Part, tool: Tool, machine: Machine, *, spiral: Spiral, corrected: bool) -> None:
        self.tool, self.machine, self.feed, self.corrected = tool, machine, spiral.feed, corrected
        self.ideal = without_servos(machine, corrected=corrected)
        self.radius, self.angle = few_lines(part, spiral.feed, spiral.angle)
        self.known: list[tuple[float, float]] = []  # (spindle speed [rad/s], error [mm]) for any points

    def commanded(self, nominal: Motion) -> Motion:
        """Return the motion of the program, precorrected so that the axes follow the nominal one."""
        return precorrect(nominal, self.machine) if self.corrected else nominal

    def constant(self, top: Motion, share: float) -> Motion:
        """Return a motion at the highest constant speed within the limits and the share of the servos [mm].

        ``top`` is at the highest speed within the limits of the machine. Raises `LimitError` if there is no such speed.
        """
        nominal_surface = self._surface(top, self.ideal)
        speed = abs(float(top.axes["C"][-1] - top.axes["C"][0]) / float(top.time[-1] - top.time[0]))

        def error(factor: float) -> float:
            command = self._try_command(at_speed(top, factor))
            if command is None:
                return math.inf
            if self.corrected and not (limits := check_limits(command, self.machine)).ok:
                return share * max(*limits.utilisation.values(), 1 + 2 * LIMIT_TOL)
            largest_error = float(self._error(command, nominal_surface).max())
            self.known.append((speed * factor, largest_error))
            return largest_error

        factor = largest(error, share, guess(self.known, share) / speed, 1.0)
        if not factor:
            raise LimitError(
                f"the tracking error of {self.machine.name} exceeds {share * 1e6:.3g} nm at any speed: relax form_pv, "
                f"or {'choose another machine' if self.corrected else 'set precorrect = true in [program]'}"
            )
        return at_speed(top, factor)

    def varied(
        self, path: Path, servo: Strategy, machine: Machine, share: float, steady: Motion
    ) -> tuple[SpeedProfile, Motion] | None:
        """Return the fastest speed over the radius within the limits and the share of the servos [mm], and its motion.

        The speed of every ring starts from the error of a motion at constant speed within the share, and is then
        reduced or increased iteratively by the error of the ring.
        """
        top = drive(path, servo, machine)
        nominal_surface = self._surface(top, self.ideal)
        rings = _Rings(path)
        # Without velocities the motion has no ramps, whose speeds must not count.
        even = drive(replace(path, z_rate=None), servo, machine)
        most = rings.least(np.abs(np.diff(even.axes["C"]) / np.diff(even.time)))
        speed = np.minimum(most, np.abs(np.diff(steady.axes["C"]) / np.diff(steady.time)).max())
        nominal, profile = steady, None
        best: tuple[SpeedProfile, Motion] | None = None
        for _ in range(ROUNDS):
            command = self._try_command(nominal)
            if command is None:
                speed = speed * NEAR
            else:
                ratio = rings.worst(self.radius, self._error(command, nominal_surface), self.feed) / share
                utilisation = rings.utilisation(command, self.machine)
                ratio = np.maximum(
                    ratio, utilisation if self.corrected else np.where(utilisation > 1 + LIMIT_TOL, utilisation, 0.0)
                )
                if profile is not None and ratio.max() <= 1 + (LIMIT_TOL if self.corrected else 0.0):
                    if best is None or nominal.time[-1] < best[1].time[-1]:
                        best = profile, nominal
                    if ((ratio >= NEAR * NEAR) | (speed >= NEAR * most)).all():
                        break
                speed = np.minimum(most, speed * (NEAR / np.maximum(ratio, 1e-3)) ** (1 / FIRST_EXPONENT))
            speed, profile, nominal = _drive_rings(path, servo, machine, rings, speed)
        return best

    def _try_command(self, nominal: Motion) -> Motion | None:
        """Return the command, or ``None`` where the controller would slow it down and it cannot be precorrected."""
        try:
            return self.commanded(nominal)
        except LimitError:
            return None

    def _surface(self, motion: Motion, machine: Machine) -> HeightMap:
        real = track(motion, machine, chord=TRACKING_CHORD_MM)
        return generate_polar(real, self.tool, radius=self.radius, angle=self.angle)

    def _error(self, command: Motion, nominal: HeightMap) -> Floats:
        """Return the largest error of the real surface of a command at each radius. (n,) [mm]."""
        error: Floats = np.nanmax(np.abs(self._surface(command, self.machine).z - nominal.z), axis=0)
        return error


def _drive_rings(
    path: Path, servo: Strategy, machine: Machine, rings: _Rings, target: Floats
) -> tuple[Floats, SpeedProfile, Motion]:
    """Return speed of each ring, profile and motion; the target speed is lowered until the axes can ramp to it."""
    speed = target
    while True:
        profile = rings.profile(speed)
        try:
            return speed, profile, drive(path, servo, machine, profile=profile)
        except LimitError:
            if speed[0] < MIN_SPEED_FRACTION * target[0]:
                raise
            speed = speed * NEAR


class _Rings:
    """Rings of revolutions that a path passes through in order, each with its own spindle speed."""

    def __init__(self, path: Path) -> None:
        inward = path.radius[0] > path.radius[-1]
        # A tool that swings along X enters the next ring where it first reaches the radius of that ring.
        outermost = np.maximum.accumulate(path.radius[::-1] if inward else path.radius)
        self.borders = np.linspace(max(float(outermost[0]), 0.0), float(outermost[-1]), RINGS + 1).round(6)
        at = np.searchsorted(outermost, self.borders[1:-1])
        size = path.radius.size
        ends = np.concatenate(([0], size - 1 - at[::-1] if inward else at, [size - 1]))
        pieces = [slice(first, last + 1) for first, last in pairwise(ends.tolist())]
        self.pieces = pieces[::-1] if inward else pieces
        self.start = float(path.angle[0])
        self.turned = np.abs(path.angle - self.start)
        contact = np.hypot(path.contact_x, path.contact_y)
        self.reach = [(contact[piece].min(), contact[piece].max()) for piece in self.pieces]

    def least(self, speed: Floats) -> Floats:
        """Return the lowest spindle speed in each ring, given the speed of every block of the path."""
        return np.array([speed[max(piece.start - 1, 0) : piece.stop].min() for piece in self.pieces])

    def worst(self, radius: Floats, error: Floats, feed: float) -> Floats:
        """Return the largest error within the contact radii of each ring, given the error at some radii."""
        return np.array(
            [error[(radius >= low - feed) & (radius <= high + feed)].max(initial=0.0) for low, high in self.reach]
        )

    def utilisation(self, motion: Motion, machine: Machine) -> Floats:
        highest = np.zeros(len(self.pieces))
        # A motion with ramps has more points than its path, one that crosses air has fewer.
        turned = np.abs(motion.axes["C"] - self.start)
        for ring, piece in enumerate(self.pieces):
            first, last = np.searchsorted(turned, self.turned[[piece.start, piece.stop - 1]])
            blocks = slice(max(int(first) - MARGIN_BLOCKS, 0), int(last) + 1 + MARGIN_BLOCKS)
            highest[ring] = max(check_limits(motion.select(blocks), machine).utilisation.values())
        return highest

    def profile(self, speed: Floats) -> SpeedProfile:
        """Return the speed over the radius that never exceeds the speed of a ring [rad/s]."""
        borders = np.minimum(np.append(speed, np.inf), np.append(np.inf, speed)) * (60 / TURN)
        return SpeedProfile(radius=self.borders, spindle_rpm=np.array([round_down(one) for one in borders.tolist()]))
