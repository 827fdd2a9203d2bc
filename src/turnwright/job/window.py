r"""The share of a finishing pass that reaches a place on the part: all that its surface depends on, and no more.

The tool placed along z never cuts below the surface :math:`f` that it is aimed at. With the tip at :math:`\rho` its
lowest point :math:`u_0` is on or above :math:`f(\rho + u_0)`, so a point a distance :math:`u` from the tip is left at
least

.. math:: e_a(u) - e_p(u_0) - s\,|u - u_0|

above the design, with :math:`e_p, e_a` the planned and the actual edge and :math:`s` the steepest slope. Where that is
more than the highest point of the place stands above the design anyway, the pass changes nothing. Which passes those
are is known when the place has been generated from the others, so the answer is checked after the fact and the share
widened until it holds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from turnwright.job.predicting import predict
from turnwright.motion import drive
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.strategy import FastToolServo, SlowToolServo

if TYPE_CHECKING:
    from turnwright._arrays import Floats, Ints
    from turnwright.job.result import Prediction
    from turnwright.job.schema import Job, Patch
    from turnwright.path import Motion, Path
    from turnwright.strategy import Strategy

__all__ = ["can_be_parted", "predict_parted"]

TURN = 2 * math.pi

STEPS = 4001
"""Places on the edge, from wall to wall, at which it is compared with the surface."""

WALL = math.radians(89.9)
"""Where they end. [rad]"""

STEEPER = 1.1
"""The slope between the places that are looked at may be more than at them."""

FEWEST, MOST = 48, 360
"""Radii and azimuths at which the slope is looked at."""

PER_FEATURE = 8
"""Of them to a feature of the surface, if they are not too many."""

GUESS = 2e-4
"""Height above the design, beside that of cusps and deviations, that is thought of first. [mm]"""

WORTH = 0.7
"""A share of more points than this is not worth the trouble."""

ROUNDS = 3
"""How often the share is widened before all is placed."""


class _Edge(NamedTuple):
    """How far off the tip a pass may reach."""

    u: Floats  # places on the actual edge [mm]
    e: Floats  # height over the lowest point of the planned one [mm]
    lowest: float  # where that is [mm]
    slope: float  # steepest of the surface; nan if it is in pieces
    rise: float  # highest minus lowest height of the surface, where it has steps or valleys and a slope says nothing
    drop: float  # by how much the errors of the actual machine may lower a pass [mm]

    def reach(self, height: float) -> float | None:
        """Return how far from the tip a pass may leave less than a height above the design; ``None`` if anywhere."""
        beside = np.fmin(self.slope * np.abs(self.u - self.lowest), self.rise)
        near = self.e - beside <= height + self.drop
        if near[0] or near[-1]:
            return None
        return float(np.abs(self.u[near]).max(initial=0.0)) + float(np.diff(self.u).max())


def can_be_parted(job: Job) -> bool:
    """Say whether a place depends on its own share of the finishing pass alone.

    It does on a spiral whose points stand by themselves. What the controller rounds, the servos drag along, or a plan
    by chord or scallop finds on its way in, depends on the rest of the path; a path along the normal may gouge; a raked
    tool or one off centre cuts beside its own azimuth.
    """
    plan = job.servo(job.passes[-1])
    chord = getattr(plan.lays_out, "chord", None)
    machines = (job.machine, job.actual_machine)
    upright = all(not one.rake and not one.offset[1] for one in (job.tool, job.actual_tool))
    return bool(
        isinstance(plan, SlowToolServo | FastToolServo)
        and plan.along == "z"
        and chord is None
        and upright
        and not job.simulation.tracking
        and not job.program.precorrect
        and all(one.controller.interpolation == "linear" for one in machines)
    )


def predict_parted(job: Job, name: str) -> Prediction | None:
    """Predict one place from its own share of the finishing pass; ``None`` where that is not exact or not worth it.

    Parameters
    ----------
    job
        One that `can_be_parted`.
    name
        Of a patch, or "whole part": that needs only the points at the azimuths that are looked at.
    """
    part, tool = job.part.aimed, job.tool
    servo = job.servo(job.passes[-1])
    spiral = servo.spiral(part, tool)
    edge = _edge(job, spiral)
    patch = next((one for one in job.simulation.patches if one.name == name), None)
    height = spiral.feed**2 / (2 * job.actual_tool.actual_radius) + GUESS
    height += abs(job.actual_tool.offset[2]) + abs(job.actual_tool.radius_error)
    for _ in range(ROUNDS):
        reach = edge.reach(height)
        if reach is None:
            return None
        keep = _azimuths(job, spiral, reach) if patch is None else _around(patch, part.radius, spiral, reach)
        if not 2 <= keep.size <= WORTH * spiral.angle.size:
            return None
        motion = _motion(job, servo, spiral, keep)
        found = predict(job, motion, only=(name,), extremes=False)[0]
        z = found.error.z if patch is not None else found.error.z[:, 0]
        if patch is not None and np.isnan(z).any():
            return None
        left = float(np.nanmax(z, initial=0.0))
        if left <= height:
            return found
        height = 1.01 * left
    return None


def _motion(job: Job, servo: Strategy, spiral: Spiral, keep: Ints) -> Motion:
    """Return the motion of some of the points, at any speed: it goes straight between them, however fast."""
    some = Spiral(angle=spiral.angle[keep], radius=spiral.radius[keep])
    path = place(some, job.part.aimed, job.tool)
    return drive(path, _Steady(servo), job.machine)


class _Steady(NamedTuple):
    """A strategy at one speed: which one does not matter."""

    servo: Strategy

    @property
    def spindle_rpm(self) -> float:
        """Spindle speed. [rev/min]."""
        return self.servo.spindle_rpm or 1.0

    @property
    def spindle_speeds(self) -> None:
        """Nothing: it keeps one speed."""

    def axes(self, path: Path) -> dict[str, Floats]:
        """Return the axes of the strategy."""
        return self.servo.axes(path)

    def rates(self, _path: Path) -> None:
        """Return nothing: only a controller that takes velocities asks."""


def _edge(job: Job, spiral: Spiral) -> _Edge:
    part, planned, actual = job.part.aimed, job.tool, job.actual_tool
    sweep = np.linspace(-WALL, WALL, STEPS)
    u, _, e = actual.edge(sweep)
    low, high = planned.arc
    base_u, _, base_e = planned.edge(np.linspace(low, high, STEPS))
    lowest = int(np.argmin(base_e))
    surface = part.surface
    outer = float(np.abs(spiral.radius).max())
    fine = PER_FEATURE / surface.feature_size
    radius = np.linspace(0.0, outer, int(np.clip(math.ceil(outer * fine), FEWEST, MOST)) + 1)
    angle = np.linspace(0.0, TURN, int(np.clip(math.ceil(TURN * outer * fine), FEWEST, MOST)), endpoint=False)
    x, y = (np.outer(one, radius).ravel() for one in (np.cos(angle), np.sin(angle)))
    with np.errstate(all="ignore"):
        z, zx, zy = (np.nan_to_num(one, posinf=0.0, neginf=0.0) for one in surface.evaluate(x, y, 1))
    slope = math.nan if surface.in_pieces else STEEPER * float(np.hypot(zx, zy).max())  # nan is passed over
    along = np.linspace(float(spiral.radius[0]), float(spiral.radius[-1]), STEPS)
    error = job.actual_machine.z_error(along) - job.machine.z_error(along)
    return _Edge(
        u=u, e=e - float(base_e[lowest]), lowest=float(base_u[lowest]), slope=slope, rise=STEEPER * float(np.ptp(z)),
        drop=max(0.0, -float(error.min())),
    )  # fmt: skip


def _around(patch: Patch, rim: float, spiral: Spiral, reach: float) -> Ints:
    """Return the numbers of the points of a spiral that may matter to a patch. (n,)."""
    (x0, x1), (y0, y1) = (axis[[0, -1]] for axis in patch.axes)
    corners = np.array([(x, y) for x in (x0, x1) for y in (y0, y1)])
    nearest = math.hypot(*(min(max(0.0, low), high) for low, high in ((x0, x1), (y0, y1))))
    far, near = float(np.hypot(*corners.T).max()) + reach, nearest - reach
    if far + 2 * reach >= rim:  # what the edge touches beyond the clear radius depends on how far the path goes
        far = math.inf
    if near <= 0:
        return _band(spiral, -far, far)
    # Seen along its own azimuth a pass stands at its radius, from the other side, beyond the axis, at minus that.
    middle = math.atan2(y0 + y1, x0 + x1)
    half = float(np.abs(_turned(np.arctan2(corners[:, 1], corners[:, 0]), middle)).max())
    kept = []
    for band, azimuth in ((_band(spiral, near, far), middle), (_band(spiral, -far, -near), middle + math.pi)):
        within = np.abs(_turned(spiral.angle[band], azimuth)) <= half
        within[1:] |= within[:-1].copy()  # between two points the motion goes straight
        within[:-1] |= within[1:].copy()
        kept.append(band[within])
    return np.unique(np.concatenate(kept))


def _band(spiral: Spiral, low: float, high: float) -> Ints:
    """Return the numbers of the points between two radii, and of the next ones on either side. (n,)."""
    outward = spiral.radius[-1] > spiral.radius[0]
    radius = spiral.radius if outward else spiral.radius[::-1]
    first, last = int(np.searchsorted(radius, low)) - 1, int(np.searchsorted(radius, high, "right")) + 1
    first, last = max(first, 0), min(last, radius.size)
    return np.arange(first, last) if outward else np.arange(radius.size - last, radius.size - first)


def _azimuths(job: Job, spiral: Spiral, reach: float) -> Ints:
    """Return the numbers of the points at the azimuths of the whole part's map, and of those near the axis. (n,).

    Only where the same azimuths return in every turn, the map's among them: then the tool stands there at a point of
    its path. Points on either side of other azimuths are scattered, and cost more to place than all that are even.
    """
    plan: Any = job.servo(job.passes[-1]).lays_out
    per_turn, angles = plan.points_per_rev, job.simulation.whole_part.angles
    even = per_turn is not None and per_turn % angles == 0
    keep = np.zeros(spiral.angle.size, dtype=np.bool_)
    keep[:: per_turn // angles if even and per_turn else 1] = True
    keep[-1] = True
    keep[_band(spiral, -reach, reach)] = True
    return np.flatnonzero(keep)


def _turned(angle: Floats, middle: float) -> Floats:
    """Return angles from a middle, in half a turn to either side."""
    return np.mod(angle - middle + math.pi, TURN) - math.pi
