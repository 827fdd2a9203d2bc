"""Times and positions of a program of straight blocks on LinuxCNC, cycle by cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._kernels import blending as kernel
from turnwright.errors import InputError, LimitError
from turnwright.machine.axes import ROTARY
from turnwright.machine.lathe import Machine

__all__ = ["Blended", "blend_blocks"]

MOST_CYCLES = 200_000_000
UNLIMITED = 1e12
"""Speed or acceleration of an axis without a stated limit. [mm/s, deg/s and per second]"""

DECIMALS = 9
"""Decimals that positions are rounded to: at least those of a program, so that they are the numbers that it has."""

STILL = 1e-8
"""Movement of an axis in a block that counts as none. [mm or deg]"""

SLOWEST = 0.1 / 60
"""Least speed of a block in inverse time. [mm/s]"""


@dataclass(frozen=True, eq=False)
class Blended:
    """The cycles of a program on LinuxCNC."""

    points: Mapping[str, Floats]  # positions of the axes at the points of the program, by letter (m,) [mm or rad]
    period: float  # of a cycle [s]
    block: Ints  # in which block each cycle ends (n,)
    share: Floats  # of it that is done (n,)
    next_share: Floats  # and of the block after it (n,)

    @property
    def time(self) -> Floats:
        """Times of the cycles, the first at rest. (n + 1,) [s]."""
        return np.asarray(np.arange(self.block.size + 1) * self.period)

    def positions(self, letter: str) -> Floats:
        """Return the positions of an axis at rest and after each cycle. (n + 1,) [mm or rad]."""
        points = self.points[letter]
        move = np.append(np.diff(points), 0.0)
        after = points[self.block] + self.share * move[self.block]
        after += self.next_share * move[np.minimum(self.block + 1, move.size - 1)]
        return np.concatenate((points[:1], after))

    @property
    def ends(self) -> Floats:
        """Times at which C passes the end of each block, 0 for the first point. (m,) [s]."""
        c = self.points["C"]
        sense = np.sign(c[-1] - c[0])
        turned = np.maximum.accumulate(sense * self.positions("C"))
        ascending = np.append(True, np.diff(turned) > 0)
        return np.asarray(np.interp(sense * c, turned[ascending], self.time[ascending]))


def blend_blocks(time: Floats, axes: Mapping[str, Floats], machine: Machine) -> Blended:
    """Return what LinuxCNC makes of straight blocks in inverse time, in which C moves.

    Parameters
    ----------
    time, axes
        Times of the points as programmed [s], and positions of the axes there by letter. Each (m,) [mm or rad]
    machine
        The machine: speed and acceleration of its axes, and the servo cycle of its controller.

    Raises
    ------
    InputError
        If there is an axis of a fast tool, or a block does not move C.
    LimitError
        If there are more than `MOST_CYCLES` cycles.

    Sources
    -------
    [LinuxCNC]_; oracle: its commands in every cycle, recorded in ``tests/data/linuxcnc``.
    """
    if foreign := sorted(set(axes) - set("CXYZ")):
        raise InputError(
            f'axis {foreign[0]} moves, the interpolation "linuxcnc" has C, X, Y and Z: choose a strategy without a '
            "fast tool"
        )
    period = machine.controller.cycle
    degrees = {letter: np.rad2deg(one) if letter in ROTARY else one for letter, one in axes.items()}
    moves = {letter: np.diff(np.round(one, DECIMALS)) for letter, one in degrees.items()}
    moves = {letter: np.where(np.abs(one) < STILL, 0.0, one) for letter, one in moves.items()}
    if not moves["C"].all():
        raise InputError("a block does not move C, with LinuxCNC every block of a cut must: use fewer points")
    straight = np.sqrt(sum(moves[letter] ** 2 for letter in moves if letter not in ROTARY))
    # C does not count for the length of a block, it turns in proportion.
    length = np.where(straight > 0, straight, np.abs(moves["C"]))
    at_top, speeding = np.zeros(length.size), np.zeros(length.size)
    for letter, move in moves.items():
        top, most = _limits(machine, letter)
        at_top = np.maximum(at_top, np.abs(move) / top)
        speeding = np.maximum(speeding, np.abs(move) / most)
    wanted = np.maximum(SLOWEST, length / np.diff(time))
    wanted = np.minimum(np.minimum(wanted, length / at_top), length / period)
    # As both neighbours of a blend move at once, each has half of the acceleration.
    acceleration = length / speeding / 2
    none = np.zeros(0)
    estimate = float(np.sum(np.maximum(length / wanted, np.sqrt(length / acceleration)))) / period
    if estimate > MOST_CYCLES:
        raise LimitError(
            f"the cut takes {estimate:.3g} servo cycles of {period:g} s, the limit is {MOST_CYCLES:.3g}: check the "
            "units of feed and speed"
        )
    count = kernel.play(length, wanted, acceleration, period, np.zeros(0, dtype=np.int64), none, none)
    block, share, next_share = np.empty(count, dtype=np.int64), np.empty(count), np.empty(count)
    kernel.play(length, wanted, acceleration, period, block, share, next_share)
    return Blended(axes, period, block, share, next_share)


def _limits(machine: Machine, letter: str) -> tuple[float, float]:
    """Return speed and acceleration of an axis, of C in degrees."""
    axis = machine.axes[letter]
    top = UNLIMITED if axis.speed is None else axis.speed
    most = UNLIMITED if axis.acceleration is None else axis.acceleration
    if letter in ROTARY:
        top = min(top, machine.spindle_rpm * 2 * np.pi / 60)
        return float(np.rad2deg(top)), float(np.rad2deg(most))
    return top, most
