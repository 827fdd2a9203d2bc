"""Find where the predicted surface is below the design by more than the plan allows: the final gouge check."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats
from turnwright.job.extremes import top_of_zones
from turnwright.job.prediction import Prediction
from turnwright.job.schema import Job
from turnwright.path import Motion
from turnwright.units import say_length

__all__ = ["Gouge", "find_gouge"]

ALLOWED_DEPTH_MM = 1e-6
"""Depth below the design that is always allowed. [mm]"""

ZONES = (5, 12)
"""Zones along the radius and around the axis; the lowest point of each is checked."""

NEIGHBOUR_POINTS = 3
"""Points of the program on either side of a point whose chords may cut it too low."""


class Gouge(NamedTuple):
    """A point where the predicted surface is too low. All [mm]."""

    x: float
    y: float
    depth: float
    allowed: float

    @property
    def sentence(self) -> str:
        """Depth, position and allowed depth."""
        return (
            f"the tool gouges by {say_length(self.depth)} at x = {self.x:.4g} mm, y = {self.y:.4g} mm, where the "
            f"decimals of the program and the chords between its points allow {say_length(self.allowed)}: use more "
            "points, or state a chord"
        )


def find_gouge(job: Job, whole: Prediction, motion: Motion, rounding_limit_nm: float) -> Gouge | None:
    """Return the point farthest below the allowed depth, ``None`` if there is none or the job cannot be checked.

    A job is checked only if tool and machine are as planned, the part has no correction, and the program has neither
    servo tracking nor heights by time: other deviations legitimately cut below the design.

    The plan allows the decimals of the program and the stated chord. Without a chord, or with a controller that cuts
    corners, it allows the chords between the points of the motion read back: up to the second difference of the path
    where that jumps or has a slope discontinuity.
    """
    deviates = job.actual.tool.stated or job.actual.machine.stated or job.simulation.tracking
    by_time = job.program.fast_tool == "time"  # its heights between the points are not bounded by the chord
    if deviates or by_time or job.part.correction is not None or job.strategy.along != "z":
        return None
    flat = ALLOWED_DEPTH_MM + rounding_limit_nm * 1e-6
    chord: float | None = getattr(job.servo(job.passes[-1]).spiral_strategy, "chord", None)
    if job.machine.controller.interpolation == "linuxcnc":
        chord = None  # it cuts the corners between chords
    low = [one for one in _lowest(whole) if one[2] > flat]
    if not low:
        return None
    allows = _Chords(job, motion).at if chord is None else lambda _x, _y: chord
    worst: Gouge | None = None
    for x, y, depth in low:
        allowed = flat + allows(x, y)
        if depth > allowed and (worst is None or depth - allowed > worst.depth - worst.allowed):
            worst = Gouge(x, y, depth, allowed)
    return worst


def _lowest(whole: Prediction) -> Iterator[tuple[float, float, float]]:
    """Yield the lowest point of the part and of each zone: x, y and depth below the design. [mm]."""
    if whole.form is not None:
        lowest = whole.form.lowest
        yield lowest.x, lowest.y, -lowest.error
    x, y = whole.error.points()
    depth = np.where(np.isnan(whole.error.z), -np.inf, -whole.error.z)
    for at in top_of_zones(depth, ZONES):
        yield float(x.flat[at]), float(y.flat[at]), float(depth.flat[at])


class _Chords:
    """Most distance of the chords between the points of a motion from the path."""

    def __init__(self, job: Job, motion: Motion) -> None:
        tool, axes = job.tool, motion.axes
        c = axes["C"]
        self.surface = job.part.surface
        self.x = axes["X"] + axes.get("U", 0.0)
        bends = [_bend(c, one) for one in (axes["Z"] + axes.get("W", 0.0), self.x, axes.get("Y", np.zeros(c.size)))]
        self.bend_z, self.bend_across = bends[0], bends[1] + bends[2]
        turned, steps = c % (2 * np.pi), np.abs(np.diff(c))
        edge = tool.cutting_edge(motion.sense)
        flank = max(abs(tool.arc[0]), abs(tool.arc[1]))
        # Where the path jumps, the flanks cut as well.
        self.reach = tool.actual_radius * np.sin(flank) + abs(edge.dx) + 2 * np.tan(flank) * self.bend_z.max()
        upright = edge.upright and not np.any(axes.get("Y", 0.0))
        part = job.part
        near = np.ones(c.size, dtype=np.bool_)
        if part.leaves_air:  # crossings of air have long blocks, and do not cut the part
            near = part.border.distance(self.x * np.cos(c), self.x * np.sin(c)) <= self.reach
        self.order = np.flatnonzero(near)[np.argsort(turned[near])]
        self.azimuth = turned[self.order]
        self.step = float(steps[near[1:] & near[:-1]].max(initial=0.0))
        self.lateral_reach = 0.0 if upright else self.reach + float(np.abs(axes.get("Y", 0.0)).max()) + abs(edge.dy)

    def at(self, x: float, y: float) -> float:
        """Return the most distance of a chord near a point from the path. [mm]."""
        radius = np.hypot(x, y)
        share = self.lateral_reach / radius if radius > self.lateral_reach else 1.0
        half = NEIGHBOUR_POINTS * self.step + (np.arcsin(share) if self.lateral_reach else 0.0)
        if radius <= self.lateral_reach or half >= np.pi / 2:
            near = self.order
        else:
            mid = np.arctan2(y, x)
            bounds = ((mid + turn - half, mid + turn + half) for turn in (-2 * np.pi, 0.0, 2 * np.pi, 4 * np.pi))
            near = np.concatenate([self.order[slice(*np.searchsorted(self.azimuth, one))] for one in bounds])
        near = near[np.abs(self.x[near] - radius) <= self.reach + self.lateral_reach]
        if near.size == 0:
            return 0.0
        slope = float(np.hypot(*self.surface.gradient(x, y)))
        return float((self.bend_z[near] + slope * self.bend_across[near]).max())


def _bend(c: Floats, values: Floats) -> Floats:
    """Return twice the distance of each point from the line through its neighbours. (n,) [mm]."""
    bends = np.zeros(c.size)
    share = (c[1:-1] - c[:-2]) / (c[2:] - c[:-2])
    bends[1:-1] = 2 * np.abs(values[1:-1] - values[:-2] - share * (values[2:] - values[:-2]))
    return bends
