"""Measure how far the edge of a motion is below the finished surface: at its points, and on the borders of the parts.

A corner of an outline may be wholly between two points of a program. So the border, corners included, is compared with
the surface that the motion leaves there, with the tool between its points too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright.generation import generate_points
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.placing import tip_height
from turnwright.tool import Tool

__all__ = ["Depths", "block_over", "chord_over", "depth_at_border", "depth_at_points"]

TURN = 2 * np.pi

PLACES = 250_000
"""Places on the edge that are compared with the part at once."""


class Depths(NamedTuple):
    """Depths below the finished surface, -inf off the part, and where. Each (n,) [mm]."""

    depth: Floats
    x: Floats
    y: Floats

    @property
    def deepest(self) -> tuple[float, float, float]:
        """Greatest depth, x and y. [mm]."""
        if not self.depth.size:
            return -np.inf, np.nan, np.nan
        k = int(self.depth.argmax())
        return float(self.depth[k]), float(self.x[k]), float(self.y[k])


def depth_at_points(part: Part, tool: Tool, motion: Motion, steps: int) -> Depths:
    """Return the greatest depth of the edge at every point of a motion, of so many steps along its arc."""
    u, v, e = tool.edge(np.linspace(*tool.arc, steps + 1), motion.sense)
    axes, size = motion.axes, motion.time.size
    tip_y = axes.get("Y", np.zeros(size))
    tip_z = axes["Z"] + motion.machine.z_error(axes["X"])
    made = Depths(*np.full((3, size), -np.inf))
    chunk = max(PLACES // u.size, 1)
    for start in range(0, size, chunk):
        some = slice(start, start + chunk)
        along, across = axes["X"][some, None] + u, tip_y[some, None] + v
        c, s = np.cos(axes["C"][some, None]), np.sin(axes["C"][some, None])
        x, y = along * c - across * s, along * s + across * c
        height = _heights(part, x, y) - e
        rows, place = np.arange(x.shape[0]), height.argmax(axis=1)
        made.depth[some] = height[rows, place] - tip_z[some]
        made.x[some], made.y[some] = x[rows, place], y[rows, place]
    return made


def depth_at_border(part: Part, tool: Tool, motion: Motion) -> Depths:
    """Return the depth of the surface that a motion leaves on the borders of an outline or a chuck."""
    x, y = part.border.border()
    far, width = np.hypot(x, y), 2 * tool.cutting_edge(motion.sense).half_width
    reach = np.abs(motion.axes["X"])
    near = (far >= reach.min() - width) & (far <= reach.max() + width)
    x, y = x[near], y[near]
    if not x.size:
        return Depths(x, x, y)
    below = _heights(part, x, y) - generate_points(motion, tool, x=x, y=y)
    return Depths(np.where(np.isnan(below), -np.inf, below), x, y)


def block_over(motion: Motion, tool: Tool, x: float, y: float) -> tuple[int, float]:
    """Return the block whose edge is lowest over a point, and the share of the block at which it passes there."""
    axes, sense = motion.axes, motion.sense
    c, edge = sense * axes["C"], tool.cutting_edge(sense)
    z = axes["Z"] + motion.machine.z_error(axes["X"])
    radius, azimuth = np.hypot(x, y), sense * np.arctan2(y, x)
    best, at = np.inf, float(c[0])
    for side, turned in ((1.0, 0.0), (-1.0, np.pi)):
        first = azimuth + turned + TURN * np.ceil((c[0] - azimuth - turned) / TURN)
        passes = np.arange(first, c[-1], TURN)
        if passes.size:
            e = edge.rake_cos * edge.profile(side * radius - np.interp(passes, c, axes["X"]) - edge.dx)[0]
            e += np.interp(passes, c, z)
            if e.min() < best:
                best, at = float(e.min()), float(passes[e.argmin()])
    block = int(np.clip(np.searchsorted(c, at) - 1, 0, c.size - 2))
    return block, float((at - c[block]) / (c[block + 1] - c[block]))


def chord_over(part: Part, tool: Tool, motion: Motion, block: int, share: float) -> float:
    """Return the depth of a straight block below the contact with the part, if both its ends are in contact. [mm]."""
    ends, shares = slice(block, block + 2), np.array([0.0, share, 1.0])
    angle, radius, y = (
        np.interp(shares, (0.0, 1.0), motion.axes[letter][ends]) if letter in motion.axes else None for letter in "CXY"
    )
    surface = part.continuation
    start, at, end = tip_height(surface, tool, angle=angle, radius=radius, y=y, sense=motion.sense)  # type: ignore[arg-type]
    return float(at - start - share * (end - start))


def _heights(part: Part, x: Floats, y: Floats) -> Floats:
    """Return the finished surface, -inf off the part. Shape of the points. [mm]."""
    on = np.hypot(x, y) <= part.reach
    on[on] = part.covers(x[on], y[on])
    heights = np.full(x.shape, -np.inf)
    with np.errstate(all="ignore"):
        there = part.surface.evaluate(x[on], y[on], 0)[0]
    inside = part.surface.inside(x[on], y[on])
    heights[on] = np.where(np.isfinite(there) if inside is None else np.isfinite(there) & inside, there, -np.inf)
    return heights
