"""Let the tool leave the part smoothly at the end of a pass, while C goes on turning."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from turnwright.errors import InputError
from turnwright.machine import FAST, Machine
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.placing import tip_height
from turnwright.tool import Tool

__all__ = ["add_lead_out"]

FEWEST_POINTS = 12
"""Blocks of a lead-out."""

PEAKS = (15 / 8, 10 / math.sqrt(3), 60.0)
"""Largest speed, acceleration and jerk of the rise 10 s³ - 15 s⁴ + 6 s⁵ over the share s of its time."""

SHARE = 0.5
"""Share of the limits of X and Z that the lead-out may take; the path itself takes the rest."""

SMALL_STEPS = 0.05
"""Share of the steps of the last revolution that are smaller than those of its lead-out."""

MOST_POINTS = 100_000


def add_lead_out(motion: Motion, part: Part, tool: Tool, machine: Machine, height: float) -> Motion:
    """Return a motion that goes on around the axis, while X comes to rest, and rises by a height. [mm].

    C keeps its speed, and points as close as the closest of its last revolution. X slows down smoothly where the pass
    ends. The tip follows its exact contact with the part, plus a polynomial of the fifth degree that begins and ends at
    rest. The time is the shortest with half of speed, acceleration and jerk of Z and X, but at least `FEWEST_POINTS`
    blocks.

    Raises
    ------
    InputError
        If the motion has velocities (PVT), moves a fast tool, or the rise takes too many blocks.
    """
    if motion.velocity is not None or FAST.keys() & motion.axes.keys():
        raise InputError(
            "lead_out is stated, a program with velocities or a fast tool ends at rest on the part: leave it out"
        )
    step, seconds, advance = _last_turn(motion)
    x, z = machine.axes["X"], machine.axes["Z"]
    shortest = max(
        FEWEST_POINTS * seconds,
        _shortest(height, z.speed, z.acceleration, z.jerk),
        _shortest(abs(advance), x.acceleration, x.jerk),  # the speed of X falls as the rise grows
    )
    count = math.ceil(shortest / seconds)
    if count > MOST_POINTS:
        raise InputError(
            f"lead_out is {height:g} mm, which takes {count:.3g} blocks at the end of a pass, the limit is "
            f"{MOST_POINTS:,}: reduce it"
        )
    share = np.arange(count + 1) / count
    angle = motion.axes["C"][-1] + step * np.arange(count + 1)
    stopping = share - share**4 * (2.5 - 3 * share + share**2)  # the integral of one minus the rise
    radius = motion.axes["X"][-1] + advance * count * seconds * stopping
    y = np.full(count + 1, motion.axes["Y"][-1]) if "Y" in motion.axes else None
    contact = tip_height(part.surface, tool, angle=angle, radius=radius, y=y, sense=motion.sense, rim=part.reach)
    contact = contact - machine.z_error(radius)
    rise = height * share**3 * (10 - 15 * share + 6 * share**2)
    added = {letter: np.full(count, values[-1]) for letter, values in motion.axes.items()}
    added |= {"C": angle[1:], "X": radius[1:], "Z": (motion.axes["Z"][-1] + contact - contact[0] + rise)[1:]}
    time = np.concatenate((motion.time, motion.time[-1] + seconds * np.arange(1, count + 1)))
    axes = {letter: np.concatenate((values, added[letter])) for letter, values in motion.axes.items()}
    return replace(motion, time=time, axes=axes)


def _last_turn(motion: Motion) -> tuple[float, float, float]:
    """Return a small step of C in the last revolution [rad], its time [s], and the speed of X there [mm/s]."""
    turned = np.abs(motion.axes["C"][-1] - motion.axes["C"])
    turn, quarter = (min(int(np.searchsorted(-turned, -2 * np.pi / parts)), motion.time.size - 2) for parts in (1, 4))
    taken = float(motion.time[-1] - motion.time[turn])
    step = float(np.quantile(np.abs(np.diff(motion.axes["C"][turn:])), SMALL_STEPS))
    seconds = step * float(motion.time[-1] - motion.time[quarter]) / float(turned[quarter])
    return motion.sense * step, seconds, float(motion.axes["X"][-1] - motion.axes["X"][turn]) / taken


def _shortest(size: float, *limits: float | None) -> float:
    """Return the shortest time of a rise of that size, from the limits of its first derivatives. [s]."""
    peaks = zip(limits, PEAKS, range(1, len(limits) + 1), strict=False)
    return max((peak * size / (SHARE * limit)) ** (1 / order) if limit else 0.0 for limit, peak, order in peaks)
