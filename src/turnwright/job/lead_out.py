"""Let the tool leave the part smoothly at the end of a pass, while C goes on turning."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import InputError
from turnwright.machine import FAST, Machine
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.placing import tip_height
from turnwright.tool import Tool

__all__ = ["add_lead_out"]

FEWEST_POINTS = 12
"""Blocks of a lead-out."""

PEAK_ACCELERATION, PEAK_JERK = 10 / math.sqrt(3), 60.0
"""Largest acceleration and jerk of 10 s³ - 15 s⁴ + 6 s⁵ over the share s of its time."""

SHARE = 0.5
"""Share of the acceleration and the jerk of Z that the lead-out may take; the path itself takes the rest."""

LAST_BLOCKS = 50
"""Blocks at the end of a pass whose mean step and time are those of its lead-out."""


def add_lead_out(motion: Motion, part: Part, tool: Tool, machine: Machine, height: float) -> Motion:
    """Return a motion that goes on around the axis at the radius where it ends, and rises by a height. [mm].

    The tip follows its exact contact with the part, plus a polynomial of the fifth degree that begins and ends at rest.
    Its time is the shortest with half of the acceleration and jerk of Z, but at least `FEWEST_POINTS` blocks.

    Raises
    ------
    InputError
        If the motion has velocities (PVT), or moves a fast tool.
    """
    if motion.velocity is not None or FAST.keys() & motion.axes.keys():
        raise InputError(
            "lead_out is stated, a program with velocities or a fast tool ends at rest on the part: leave it out"
        )
    last = slice(-min(LAST_BLOCKS, motion.time.size - 1) - 1, None)
    step = float(np.diff(motion.axes["C"][last]).mean())
    seconds = float(np.median(np.diff(motion.time[last])))
    axis = machine.axes["Z"]
    shortest = FEWEST_POINTS * seconds
    if axis.acceleration is not None:
        shortest = max(shortest, math.sqrt(PEAK_ACCELERATION * height / (SHARE * axis.acceleration)))
    if axis.jerk is not None:
        shortest = max(shortest, math.cbrt(PEAK_JERK * height / (SHARE * axis.jerk)))
    count = math.ceil(shortest / seconds)
    share = np.arange(1, count + 1) / count
    angle = motion.axes["C"][-1] + step * np.arange(count + 1)
    added: dict[str, Floats] = {letter: np.full(count, values[-1]) for letter, values in motion.axes.items()}
    y = np.full(count + 1, motion.axes["Y"][-1]) if "Y" in motion.axes else None
    radius = np.full(count + 1, motion.axes["X"][-1])
    contact = tip_height(part.surface, tool, angle=angle, radius=radius, y=y, sense=motion.sense, rim=part.reach)
    added["C"] = angle[1:]
    # The machine's error in Z is that of the last point, as X stands still.
    added["Z"] = motion.axes["Z"][-1] + contact[1:] - contact[0]
    added["Z"] = added["Z"] + height * (10 * share**3 - 15 * share**4 + 6 * share**5)
    time = np.concatenate((motion.time, motion.time[-1] + seconds * np.arange(1, count + 1)))
    axes = {letter: np.concatenate((values, added[letter])) for letter, values in motion.axes.items()}
    return replace(motion, time=time, axes=axes)
