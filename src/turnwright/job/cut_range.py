"""Cut only where material is: the radii at which a blank stands above a roughing pass, and the path between them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from turnwright._arrays import Floats
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.tool import Tool

__all__ = ["cut_range", "trim"]

FEWEST_RADII, FEWEST_AZIMUTHS, MOST_PLACES = 1000, 360, 8_000_000
"""Places at which the blank is compared with a pass; more where its features are small."""

PER_FEATURE = 8
"""Places per feature of the blank or the part."""

CHUNK = 500_000


def cut_range(part: Part, tool: Tool, allowance: float) -> tuple[float, float] | None:
    """Return the positions of the tip between which a pass with an allowance meets the blank, ``None`` if it does not.

    All positions without a stated top of the blank. [mm]
    """
    if part.shaped_blank is None or part.leaves_air:
        return -np.inf, np.inf
    radius, highest = _highest_stock(part)
    above = highest > allowance
    if not above.any():
        return None
    met = radius[above]
    edge, step = tool.cutting_edge(), float(radius[1] - radius[0])
    margin = edge.half_width + abs(edge.dx) + step
    # Beyond the outermost radius of the part the pass begins as it does without a stated top.
    high = np.inf if met[-1] >= radius[-2] else met[-1] + margin
    low = -np.inf if met[0] <= max(radius[0], margin) else met[0] - margin
    return float(low), float(high)


@lru_cache(maxsize=4)
def _highest_stock(part: Part) -> tuple[Floats, Floats]:
    """Return radii, and the greatest thickness of material over the azimuth there. Each (n,) [mm]."""
    assert part.blank is not None and part.blank.surface is not None  # noqa: S101, PT018 - for the type checker
    fine = min(part.blank.surface.feature_size, part.surface.feature_size)
    radii, azimuths = FEWEST_RADII, FEWEST_AZIMUTHS
    if fine > 0:
        radii = max(radii, int(PER_FEATURE * part.reach / fine))
        azimuths = max(azimuths, int(PER_FEATURE * 2 * np.pi * part.reach / fine))
    coarser = max(1.0, np.sqrt(radii * azimuths / MOST_PLACES))
    radius = np.linspace(part.nearest, part.reach * (1 - 1e-12), int(radii / coarser))
    angle = np.linspace(0, 2 * np.pi, int(azimuths / coarser), endpoint=False)
    highest = np.full(radius.size, -np.inf)
    rows = max(1, CHUNK // radius.size)
    for start in range(0, angle.size, rows):
        some = angle[start : start + rows, None]
        highest = np.maximum(highest, part.thickness(radius * np.cos(some), radius * np.sin(some)).max(axis=0))
    return radius, highest


def trim(motion: Motion, between: tuple[float, float]) -> Motion | None:
    """Return the part of a motion between two positions of X, ``None`` if it does not come there.

    A motion with velocities is returned whole.
    """
    mode = motion.spindle_mode
    points = np.arange(motion.time.size) if mode is None else motion.blocks
    x = motion.axes["X"][points]
    low, high = max(between[0], float(x.min())), min(between[1], float(x.max()))
    if low > high:
        return None
    if (low <= x.min() and high >= x.max()) or motion.velocity is not None:
        return motion
    if mode is None:
        # One point more at each end, so that the ends are outside the material.
        inside = np.flatnonzero((x >= low) & (x <= high))
        first, last = (inside[0], inside[-1]) if inside.size else (int(np.abs(x - low).argmin()),) * 2
        section = motion.select(points[max(first - 1, 0) : last + 2])
        return replace(section, time=section.time - section.time[0])
    # Few blocks are needed in spindle mode, so the first and the last one are cut where the range ends.
    order = 1 if x[-1] > x[0] else -1
    ends = [low, high][::order]
    within = (x > low) & (x < high)
    z = motion.axes["Z"][points]
    cut_x = np.concatenate((ends[:1], x[within], ends[1:]))
    cut_z = np.interp(cut_x * order, x * order, z)
    c = np.interp(ends[0] * order, x * order, motion.axes["C"][points])
    return mode.motion(cut_x, cut_z, motion.machine, sense=motion.sense, angle=float(c))
