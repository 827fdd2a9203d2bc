"""Times and positions of a program of straight blocks on LinuxCNC, cycle by cycle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

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


class Blended(NamedTuple):
    """The cycles of a program on LinuxCNC."""

    time: Floats  # of the cycles, the first at rest (n,) [s]
    axes: Mapping[str, Floats]  # planned positions, by letter (n,) [mm or rad]
    ends: Floats  # when C passes the end of each block, 0 for the first point (m,) [s]


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
    positions = {letter: _positions(one, block, share, next_share) for letter, one in axes.items()}
    cycles = np.arange(count + 1) * period
    sense = np.sign(axes["C"][-1] - axes["C"][0])
    turned = np.maximum.accumulate(sense * positions["C"])
    ascending = np.append(True, np.diff(turned) > 0)
    ends = np.interp(sense * axes["C"], turned[ascending], cycles[ascending])
    return Blended(cycles, positions, ends)


def _limits(machine: Machine, letter: str) -> tuple[float, float]:
    """Return speed and acceleration of an axis, of C in degrees."""
    axis = machine.axes[letter]
    top = UNLIMITED if axis.speed is None else axis.speed
    most = UNLIMITED if axis.acceleration is None else axis.acceleration
    if letter in ROTARY:
        top = min(top, machine.spindle_rpm * 2 * np.pi / 60)
        return float(np.rad2deg(top)), float(np.rad2deg(most))
    return top, most


def _positions(points: Floats, block: Ints, share: Floats, next_share: Floats) -> Floats:
    """Return the positions of an axis at rest and after each cycle."""
    move = np.append(np.diff(points), 0.0)
    after = points[block] + share * move[block] + next_share * move[np.minimum(block + 1, move.size - 1)]
    return np.concatenate((points[:1], after))
