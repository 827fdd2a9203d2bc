r"""Predict a window of the part from the section of the finishing pass that cuts it.

A tool placed along z never cuts below its target surface :math:`f`. With the tip at :math:`\rho` its lowest point
:math:`u_0` is on or above :math:`f(\rho + u_0)`, so a point at the distance :math:`u` from the tip is cut no lower
than

.. math:: e_a(u) - e_p(u_0) - s\,|u - u_0|

above the design, with :math:`e_p, e_a` the planned and the actual edge and :math:`s` the steepest slope. Where that is
higher than the highest point of the window, the pass has no effect. The highest point is known only after the window
has been generated, so the section is checked afterwards and widened until it suffices.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.job.predicting import predict
from turnwright.job.prediction import Prediction
from turnwright.job.schema import Job, Patch
from turnwright.motion import drive
from turnwright.path import Motion, Spiral
from turnwright.placing import place
from turnwright.strategy import FastToolServo, SlowToolServo, Strategy

__all__ = ["can_predict_window", "predict_window"]

TURN = 2 * math.pi
EDGE_SAMPLES = 4001
MAX_SWEEP_RAD = math.radians(89.9)
"""Largest contact angle at which the edge is compared with the surface. [rad]"""

SLOPE_MARGIN = 1.1
"""Factor by which the slope between the samples may exceed that at the samples."""

MIN_SAMPLES, MAX_SAMPLES = 48, 360
SAMPLES_PER_FEATURE = 8
HEIGHT_MARGIN_MM = 2e-4
"""First estimate of the height above the design, without cusps and deviations. [mm]"""

MAX_POINT_FRACTION = 0.7
"""Most points of the section as a fraction of the pass; with more of them it saves no time."""

MAX_WIDENINGS = 3


class _Edge(NamedTuple):
    """The edge against the surface: how far from the tip it can cut."""

    u: Floats  # points on the actual edge [mm]
    e: Floats  # height over the lowest point of the planned one [mm]
    lowest: float  # position of that point [mm]
    slope: float  # steepest of the surface; nan if it is in pieces
    rise: float  # highest minus lowest height of the surface, for surfaces with steps or slope discontinuities
    drop: float  # most by which errors of the actual machine lower a pass [mm]

    def reach(self, height: float) -> float | None:
        """Return the distance from the tip within which a pass may cut below a height; ``None`` if unbounded. [mm]."""
        rise = np.fmin(self.slope * np.abs(self.u - self.lowest), self.rise)
        near = self.e - rise <= height + self.drop
        if near[0] or near[-1]:
            return None
        return float(np.abs(self.u[near]).max(initial=0.0)) + float(np.diff(self.u).max())


def can_predict_window(job: Job) -> bool:
    """Whether a window depends only on the section of the finishing pass that cuts it.

    It does on a spiral whose points are independent of each other. Interpolation by the controller, servo lag, and
    points planned by chord or scallop depend on the rest of the path; a path along the normal may gouge; a raked tool,
    or one with a tool height error, cuts off its azimuth.
    """
    plan = job.servo(job.passes[-1])
    chord = getattr(plan.spiral_strategy, "chord", None)
    machines = (job.machine, job.actual_machine)
    upright = all(not one.rake and not one.offset[1] for one in (job.tool, job.actual_tool))
    return bool(
        isinstance(plan, SlowToolServo | FastToolServo)
        and job.part.outline is None
        and plan.along == "z"
        and chord is None
        and upright
        and not job.simulation.tracking
        and not job.program.precorrect
        and job.program.lead_out is None
        and all(one.controller.interpolation == "linear" for one in machines)
    )


def predict_window(job: Job, name: str) -> Prediction | None:
    """Predict a patch, or the "whole part", from a section of the finishing pass; ``None`` if not exact or not faster.

    The whole part needs only the points at the azimuths of its map. `can_predict_window` must be true.
    """
    part, tool = job.part.aimed, job.tool
    servo = job.servo(job.passes[-1])
    spiral = servo.spiral(part, tool)
    edge = _edge(job, spiral)
    patch = next((one for one in job.simulation.patches if one.name == name), None)
    height = spiral.feed**2 / (2 * job.actual_tool.actual_radius) + HEIGHT_MARGIN_MM
    height += abs(job.actual_tool.offset[2]) + abs(job.actual_tool.radius_error)
    for _ in range(MAX_WIDENINGS):
        reach = edge.reach(height)
        if reach is None:
            return None
        keep = _azimuths(job, spiral, reach) if patch is None else _points_near(patch, part.reach, spiral, reach)
        if not 2 <= keep.size <= MAX_POINT_FRACTION * spiral.angle.size:
            return None
        motion = _motion(job, servo, spiral, keep)
        prediction = predict(job, motion, only=(name,), extremes=False)[0]
        z = prediction.error.z if patch is not None else prediction.error.z[:, 0]
        if patch is not None and np.isnan(z).any():
            return None
        highest = float(np.nanmax(z, initial=0.0))
        if highest <= height:
            return prediction
        height = 1.01 * highest
    return None


def _motion(job: Job, servo: Strategy, spiral: Spiral, keep: Ints) -> Motion:
    """Return the motion through some of the points; the speed is arbitrary for straight lines."""
    path = place(spiral.select(keep), job.part.aimed, job.tool)
    return drive(path, servo.with_fields(spindle_rpm=servo.spindle_rpm or 1.0), job.machine)


def _edge(job: Job, spiral: Spiral) -> _Edge:
    part, planned, actual = job.part.aimed, job.tool, job.actual_tool
    sweep = np.linspace(-MAX_SWEEP_RAD, MAX_SWEEP_RAD, EDGE_SAMPLES)
    u, _, e = actual.edge(sweep)
    low, high = planned.arc
    base_u, _, base_e = planned.edge(np.linspace(low, high, EDGE_SAMPLES))
    lowest = int(np.argmin(base_e))
    surface = part.surface
    outer = float(np.abs(spiral.radius).max())
    fine = SAMPLES_PER_FEATURE / surface.feature_size
    radius = np.linspace(0.0, outer, int(np.clip(math.ceil(outer * fine), MIN_SAMPLES, MAX_SAMPLES)) + 1)
    angle = np.linspace(
        0.0, TURN, int(np.clip(math.ceil(TURN * outer * fine), MIN_SAMPLES, MAX_SAMPLES)), endpoint=False
    )
    x, y = (np.outer(one, radius).ravel() for one in (np.cos(angle), np.sin(angle)))
    with np.errstate(all="ignore"):
        z, zx, zy = (np.nan_to_num(one, posinf=0.0, neginf=0.0) for one in surface.evaluate(x, y, 1))
    slope = math.nan if surface.in_pieces else SLOPE_MARGIN * float(np.hypot(zx, zy).max())  # fmin ignores nan
    along = np.linspace(float(spiral.radius[0]), float(spiral.radius[-1]), EDGE_SAMPLES)
    error = job.actual_machine.z_error(along) - job.machine.z_error(along)
    return _Edge(
        u=u, e=e - float(base_e[lowest]), lowest=float(base_u[lowest]), slope=slope,
        rise=SLOPE_MARGIN * float(np.ptp(z)), drop=max(0.0, -float(error.min())),
    )  # fmt: skip


def _points_near(patch: Patch, rim: float, spiral: Spiral, reach: float) -> Ints:
    """Return the numbers of the points of a spiral that may affect a patch. (n,)."""
    (x0, x1), (y0, y1) = (axis[[0, -1]] for axis in patch.axes)
    corners = np.array([(x, y) for x in (x0, x1) for y in (y0, y1)])
    nearest = math.hypot(*(min(max(0.0, low), high) for low, high in ((x0, x1), (y0, y1))))
    far, near = float(np.hypot(*corners.T).max()) + reach, nearest - reach
    if far + 2 * reach >= rim:  # the contact beyond the clear aperture depends on the overrun
        far = math.inf
    if near <= 0:
        return _band(spiral, -far, far)
    # At its azimuth a pass is at its radius, at the opposite azimuth at minus its radius.
    middle = math.atan2(y0 + y1, x0 + x1)
    half = float(np.abs(_relative_angle(np.arctan2(corners[:, 1], corners[:, 0]), middle)).max())
    numbers = []
    for band, azimuth in ((_band(spiral, near, far), middle), (_band(spiral, -far, -near), middle + math.pi)):
        within = np.abs(_relative_angle(spiral.angle[band], azimuth)) <= half
        within[1:] |= within[:-1].copy()  # the motion between two points is a straight line
        within[:-1] |= within[1:].copy()
        numbers.append(band[within])
    return np.unique(np.concatenate(numbers))


def _band(spiral: Spiral, low: float, high: float) -> Ints:
    """Return the numbers of the points between two radii, and of one more on either side. (n,)."""
    outward = spiral.radius[-1] > spiral.radius[0]
    radius = spiral.radius if outward else spiral.radius[::-1]
    first, last = int(np.searchsorted(radius, low)) - 1, int(np.searchsorted(radius, high, "right")) + 1
    first, last = max(first, 0), min(last, radius.size)
    return np.arange(first, last) if outward else np.arange(radius.size - last, radius.size - first)


def _azimuths(job: Job, spiral: Spiral, reach: float) -> Ints:
    """Return the numbers of the points at the azimuths of the whole part's map, and of those near the axis. (n,).

    This needs the same azimuths in every revolution, with those of the map among them. Otherwise all points are
    returned, since scattered points take longer to place than evenly spaced ones.
    """
    plan: Any = job.servo(job.passes[-1]).spiral_strategy
    per_turn, angles = plan.points_per_rev, job.simulation.whole_part.angles
    even = per_turn is not None and per_turn % angles == 0
    keep = np.zeros(spiral.angle.size, dtype=np.bool_)
    keep[:: per_turn // angles if even and per_turn else 1] = True
    keep[-1] = True
    keep[_band(spiral, -reach, reach)] = True
    return np.flatnonzero(keep)


def _relative_angle(angle: Floats, middle: float) -> Floats:
    """Return angles relative to a middle, within half a revolution on either side."""
    return np.mod(angle - middle + math.pi, TURN) - math.pi
