"""Cut only where material is: the radii at which a blank stands above a roughing pass, and the path between them."""

from __future__ import annotations

import numpy as np

from turnwright.part import Part
from turnwright.path import Motion
from turnwright.tool import Tool

__all__ = ["cut_range", "trim"]

RADII, AZIMUTHS = 1000, 360
"""Places at which the blank is compared with a pass."""

FEWEST_POINTS = 3


def cut_range(part: Part, tool: Tool, allowance: float) -> tuple[float, float] | None:
    """Return the positions of the tip between which a pass with an allowance meets the blank, ``None`` if it does not.

    All positions without a stated top of the blank. [mm]
    """
    if part.blank is None or part.blank.surface is None or part.leaves_air:
        return -np.inf, np.inf
    radius = np.linspace(part.nearest, part.reach * (1 - 1e-12), RADII)
    angle = np.linspace(0, 2 * np.pi, AZIMUTHS, endpoint=False)[:, None]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    above = (part.blank.surface.sag(x, y) - part.surface.sag(x, y)).max(axis=0) > allowance
    if not above.any():
        return None
    met = radius[above]
    edge, step = tool.cutting_edge(), float(radius[1] - radius[0])
    margin = edge.half_width + abs(edge.dx) + step
    # Beyond the outermost radius of the part the pass begins as it does without a stated top.
    high = np.inf if met[-1] >= radius[-2] else met[-1] + margin
    low = -np.inf if met[0] <= max(radius[0], margin) else met[0] - margin
    return float(low), float(high)


def trim(motion: Motion, between: tuple[float, float] | None) -> Motion | None:
    """Return the part of a motion between two positions of X, ``None`` if there is none; one with velocities whole."""
    if between is None:
        return None
    low, high = between
    mode = motion.spindle_mode
    points = np.arange(motion.time.size) if mode is None else motion.blocks
    x = motion.axes["X"][points]
    inside = np.flatnonzero((x >= low) & (x <= high))
    if inside.size == x.size or motion.velocity is not None:
        return motion
    if inside.size < FEWEST_POINTS:
        return None
    # One point more at each end, so that the ends are outside the material.
    chosen = points[max(inside[0] - 1, 0) : inside[-1] + 2]
    if mode is None:
        section = motion.select(chosen)
        return Motion(
            time=section.time - section.time[0], axes=section.axes, machine=section.machine,
        )  # fmt: skip
    return mode.motion(
        motion.axes["X"][chosen], motion.axes["Z"][chosen], motion.machine, sense=motion.sense,
        angle=float(motion.axes["C"][chosen[0]]),
    )  # fmt: skip
