"""The highest spindle speed, or speeds over the radius, at which the servos keep their share of the form error."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from turnwright.errors import LimitError
from turnwright.generation import generate_polar
from turnwright.job.contributions import FEWEST_ANGLES, lines, without_servos
from turnwright.motion import check_limits, drive
from turnwright.speed_profile import SpeedProfile
from turnwright.tracking import precorrect, track

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.heightmap import HeightMap
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.path import Motion, Path, Spiral
    from turnwright.strategy import Strategy
    from turnwright.tool import Tool

__all__ = ["NEAR", "ROUNDS", "Servos", "at_speed", "few_lines", "guess", "largest", "plain"]

TURN = 2 * math.pi

NEAR = 0.93
"""A share that is used up to here needs no better plan."""

AIM = (1 + NEAR) / 2

ROUNDS = 8
"""Plans that are tried for one number."""

SLOWEST = 0.05
"""Share of its speed below which a profile is not lowered so that its motion can come to it and to rest."""

COARSE = 4
"""Where only the difference of two surfaces counts, one sample in so many will do."""

NEAR_ENOUGH = 1e-5
"""How finely the real motion is followed while a speed is sought. [mm]"""

POWER = 1.6
"""Servos err with the speed, or with its square where they look ahead: a power to begin with."""

POWERS = (0.5, 4.0)
"""Powers that two tries of a number may suggest."""

LEAP = 8.0
"""A number is made smaller by at most this factor between two tries: its error may be less than two tries suggest."""

SMALLER = 4.0
FALLS = 0.95
"""An error that is still more than FALLS of itself for a number so many times SMALLER does not come from the number."""

RINGS = 24
"""Rings that have a speed of their own."""

SEEN = 3
"""Blocks on either side of a ring that count for its limits: as far as a jerk is seen."""

SLACK = 1e-3
"""A limit counts as kept up to this share above it, as for `check_limits`."""


def few_lines(part: Part, feed: float, passed: Floats) -> tuple[Floats, Floats]:
    """Return radii and azimuths at which the difference of two surfaces shows. (n,) [mm], (m,) [rad]."""
    radius, angle = lines(part, COARSE * feed, passed)
    return radius, angle[:: min(COARSE, angle.size // FEWEST_ANGLES)]


def plain(value: float) -> float:
    """Return the next lower number of four digits, as a person would write it."""
    places = 3 - math.floor(math.log10(value))
    return float(Decimal(math.floor(value * 10.0**places)).scaleb(-places))


def at_speed(motion: Motion, factor: float) -> Motion:
    """Return a motion at so many times its speed."""
    faster = None
    if motion.velocity is not None:
        faster = {letter: values * factor for letter, values in motion.velocity.items()}
    return replace(motion, time=motion.time / factor, velocity=faster)


def guess(known: list[tuple[float, float]], limit: float) -> float:
    """Return where an error will be just within its limit, from known (value, error), nearest in error; or infinity."""
    seen = sorted((abs(math.log(error / limit)), value, error) for value, error in known if 0 < error < math.inf)
    if not seen:
        return math.inf
    _, value, error = seen[0]
    power = POWER
    for _, other, its in seen[1:]:
        if other != value and its != error:
            power = min(max(math.log(its / error) / math.log(other / value), POWERS[0]), POWERS[1])
            break
    return float(value * (AIM * limit / error) ** (1 / power))


def largest(error: Callable[[float], float], limit: float, first: float, most: float = math.inf) -> float:
    """Return a value, up to ``most``, whose growing error is within its limit and near to it; 0 if none was found.

    The search ends after some tries, and where a smaller value leaves the error as it was.
    """
    low, high = 0.0, math.inf
    known: list[tuple[float, float]] = []
    value = min(first, most)
    for _ in range(2 * ROUNDS):
        known.append((value, error(value)))
        if known[-1][1] <= limit:
            low = value
            if value == most or known[-1][1] >= NEAR * limit:
                break
        else:
            high = value
            if any(other >= SMALLER * value and FALLS * its <= known[-1][1] for other, its in known if its < math.inf):
                break
        top = min(high, most)
        if low and top / low < 1 / NEAR:
            break
        value = guess(known, limit)
        if value >= most and high > most:
            value = most
        elif not low < value < top:
            value = (low + top) / 2
        value = max(value, known[-1][0] / LEAP)
    return low


class Servos:
    """What the servos of a machine make of the motions over a part.

    Parameters
    ----------
    part, tool, machine
        What is cut, with what and on what.
    spiral
        Of any of the motions: its feed sets how densely the surface is sampled, and azimuths keep clear of its ends.
    corrected
        Whether the motions are corrected for the servos beforehand.
    """

    def __init__(self, part: Part, tool: Tool, machine: Machine, *, spiral: Spiral, corrected: bool) -> None:
        self.tool, self.machine, self.feed, self.corrected = tool, machine, spiral.feed, corrected
        self.ideal = without_servos(machine, corrected=corrected)
        self.radius, self.angle = few_lines(part, spiral.feed, spiral.angle)
        self.known: list[tuple[float, float]] = []  # (spindle speed [rad/s], error [mm]), whatever the points

    def commanded(self, meant: Motion) -> Motion:
        """Return what the program says so that the axes pass where they are meant to."""
        return precorrect(meant, self.machine) if self.corrected else meant

    def constant(self, top: Motion, share: float) -> Motion:
        """Return a motion at the highest share of its speed at which limits and servos keep theirs.

        Parameters
        ----------
        top
            At the highest speed within the limits of the machine.
        share
            How far the real surface may be from that of the motion. [mm]

        Raises
        ------
        LimitError
            If there is none.
        """
        wanted = self._surface(top, self.ideal)
        speed = abs(float(top.axes["C"][-1] - top.axes["C"][0]) / float(top.time[-1] - top.time[0]))

        def error(factor: float) -> float:
            meant = at_speed(top, factor)
            command = self._possible(meant)
            if command is None:
                return math.inf
            if self.corrected and not (limits := check_limits(command, self.machine)).ok:
                return share * max(*limits.utilisation.values(), 1 + 2 * SLACK)
            found = float(self._off(command, wanted).max())
            self.known.append((speed * factor, found))
            return found

        factor = largest(error, share, guess(self.known, share) / speed, 1.0)
        if not factor:
            raise LimitError(
                f"the servos of {self.machine.name} err by more than {share * 1e6:.3g} nm at any speed: allow more "
                f"form_pv, or {'choose another machine' if self.corrected else 'set precorrect = true in [program]'}"
            )
        return at_speed(top, factor)

    def varied(
        self, path: Path, servo: Strategy, machine: Machine, share: float, steady: Motion
    ) -> tuple[SpeedProfile, Motion] | None:
        """Return the quickest speed over the radius found at which limits and servos keep theirs, and its motion.

        Every ring begins with the speed that the error of a steady motion suggests for it, and is slowed down or sped
        up by its own error, again and again.

        Parameters
        ----------
        path, servo, machine
            What moves, where the speed may vary.
        share
            How far the real surface may be from that of the motion. [mm]
        steady
            The motion at one speed that keeps it.
        """
        top = drive(path, servo, machine)
        wanted = self._surface(top, self.ideal)
        rings = _Rings(path)
        # Without velocities it is not brought to rest, which is no speed to keep.
        even = drive(replace(path, z_rate=None), servo, machine)
        most = rings.least(np.abs(np.diff(even.axes["C"]) / np.diff(even.time)))
        speed = np.minimum(most, np.abs(np.diff(steady.axes["C"]) / np.diff(steady.time)).max())
        meant, profile = steady, None
        best: tuple[SpeedProfile, Motion] | None = None
        for _ in range(ROUNDS):
            command = self._possible(meant)
            if command is None:
                speed = speed * NEAR
            else:
                ratio = rings.worst(self.radius, self._off(command, wanted), self.feed) / share
                asked = rings.asked(command, self.machine)
                ratio = np.maximum(ratio, asked if self.corrected else np.where(asked > 1 + SLACK, asked, 0.0))
                if profile is not None and ratio.max() <= 1 + (SLACK if self.corrected else 0.0):
                    if best is None or meant.time[-1] < best[1].time[-1]:
                        best = profile, meant
                    if ((ratio >= NEAR * NEAR) | (speed >= NEAR * most)).all():
                        break
                speed = np.minimum(most, speed * (NEAR / np.maximum(ratio, 1e-3)) ** (1 / POWER))
            speed, profile, meant = _reached(path, servo, machine, rings, speed)
        return best

    def _possible(self, meant: Motion) -> Motion | None:
        """Return the command, or nothing where the controller would slow it down so that it cannot be corrected."""
        try:
            return self.commanded(meant)
        except LimitError:
            return None

    def _surface(self, motion: Motion, machine: Machine) -> HeightMap:
        real = track(motion, machine, chord=NEAR_ENOUGH)
        return generate_polar(real, self.tool, radius=self.radius, angle=self.angle)

    def _off(self, command: Motion, wanted: HeightMap) -> Floats:
        """Return how far the real surface of a command is from the one wanted, at each radius. (n,) [mm]."""
        off: Floats = np.nanmax(np.abs(self._surface(command, self.machine).z - wanted.z), axis=0)
        return off


def _reached(
    path: Path, servo: Strategy, machine: Machine, rings: _Rings, wanted: Floats
) -> tuple[Floats, SpeedProfile, Motion]:
    """Return the speed of each ring, lowered as far as coming to it and to rest asks for, its profile and motion."""
    speed = wanted
    while True:
        profile = rings.profile(speed)
        try:
            return speed, profile, drive(path, servo, machine, profile=profile)
        except LimitError:
            if speed[0] < SLOWEST * wanted[0]:
                raise
            speed = speed * NEAR


class _Rings:
    """Rings of turns that a path goes through one after the other, each with a spindle speed of its own."""

    def __init__(self, path: Path) -> None:
        inward = path.radius[0] > path.radius[-1]
        # A tool that swings along X passes into the next ring once it has gone as far as that for the first time.
        outermost = np.maximum.accumulate(path.radius[::-1] if inward else path.radius)
        self.borders = np.linspace(max(float(outermost[0]), 0.0), float(outermost[-1]), RINGS + 1).round(6)
        at = np.searchsorted(outermost, self.borders[1:-1])
        size = path.radius.size
        ends = np.concatenate(([0], size - 1 - at[::-1] if inward else at, [size - 1]))
        pieces = [slice(first, last + 1) for first, last in pairwise(ends.tolist())]
        self.pieces = pieces[::-1] if inward else pieces
        self.turned = np.abs(path.angle - path.angle[0])
        contact = np.hypot(path.contact_x, path.contact_y)
        self.reach = [(contact[piece].min(), contact[piece].max()) for piece in self.pieces]

    def least(self, speed: Floats) -> Floats:
        """Return the least spindle speed in each ring, of those in every block of the path."""
        return np.array([speed[max(piece.start - 1, 0) : piece.stop].min() for piece in self.pieces])

    def worst(self, radius: Floats, off: Floats, feed: float) -> Floats:
        """Return the largest error in the reach of each ring, of those at some radii."""
        return np.array(
            [off[(radius >= low - feed) & (radius <= high + feed)].max(initial=0.0) for low, high in self.reach]
        )

    def asked(self, motion: Motion, machine: Machine) -> Floats:
        """Return the largest share of a limit that is used in each ring."""
        asked = np.zeros(len(self.pieces))
        # A motion that comes to speed and to rest has more points than its path.
        turned = np.abs(motion.axes["C"] - motion.axes["C"][0])
        for ring, piece in enumerate(self.pieces):
            first, last = np.searchsorted(turned, self.turned[[piece.start, piece.stop - 1]])
            here = slice(max(int(first) - SEEN, 0), int(last) + 1 + SEEN)
            axes = {letter: values[here] for letter, values in motion.axes.items()}
            velocity = motion.velocity and {letter: values[here] for letter, values in motion.velocity.items()}
            own = replace(motion, time=motion.time[here], axes=axes, velocity=velocity, stated_blocks=None)
            asked[ring] = max(check_limits(own, machine).utilisation.values())
        return asked

    def profile(self, speed: Floats) -> SpeedProfile:
        """Return the speed over the radius that is nowhere above that of a ring [rad/s]."""
        borders = np.minimum(np.append(speed, np.inf), np.append(np.inf, speed)) * (60 / TURN)
        return SpeedProfile(radius=self.borders, spindle_rpm=np.array([plain(one) for one in borders.tolist()]))
