"""Least-squares fit of measured points to a prescription by a rigid motion, with exact gradients."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from turnwright._arrays import Bools, Floats, Ints, robust_scatter
from turnwright._kernels.registration import bend
from turnwright.pose import Pose, angles_of, rotation_matrix
from turnwright.progress import run_chunks
from turnwright.surface import Surface

Loss: TypeAlias = Literal["linear", "huber", "tukey"]

NAMES = ("x", "y", "z", "rotation", "tilt_x", "tilt_y")
"""The six degrees of freedom of a pose: the position of the pivot, and the three angles of `Pose`."""

BLOCK_POINTS = 1 << 14
"""Points processed at a time, so that their data stay in the cache."""

LOSS_WIDTHS = {"huber": 1.345, "tukey": 4.685}
"""Width of each robust loss in standard deviations: 95 % efficiency on Gaussian noise."""

MIN_SCATTER_MM = 1e-9
"""Lower bound of the scatter: smaller residuals are rounding, and none is an outlier."""

FOOT_STEPS = 3
"""Iterations to the foot of a perpendicular; each reduces the error by the distance times the curvature."""

CONVERGENCE_TOL = 0.01
"""Change of the heights, relative to its standard error, at which the iteration stops."""

MAX_FINAL_DAMPING = 1e-3
"""Damping from which a small step does not indicate convergence."""

ROUNDING_MM = 1e-13
"""Rms change of the heights that is rounding."""

MAX_STEPS, MAX_IDLE_STEPS = 60, 6
"""Steps, and successive steps that change chi-square by less than a hundredth."""

FULL_SHARE = 0.999
"""Points on the part, relative to the most so far, from which points exchanged at the rim do not count."""

OUTLIER_COST = 25.0
"""Cost of a point that leaves the part, in mean squares: five standard deviations, as in the comparison of poses."""

EFFECT_TOL = 1e-11
"""Effect of a degree of freedom on the heights, relative to the largest effect, that is rounding."""

MAX_TILT_RAD = 1.5
"""Tilt beyond which a map cannot show the front of a part."""

MIN_ON_PART_SHARE = 0.5
"""Points on the part, relative to the most so far, below which a step is rejected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """Points relative to the pivot, and the design with which they are compared.

    ``points`` is (3, n); ``area`` (n,) holds their areas with a mean of 1, or ``None`` if they are equal; ``within`` is
    the radius about the axis of the part inside which points count [mm]. ``bends`` (6,) holds the centres of its
    principal curvatures, see `turnwright._kernels.registration.bend`.
    """

    points: Floats
    area: Floats | None
    surface: Surface
    terms: tuple[Surface, ...]
    within: float
    normal: bool
    loss: Loss
    bends: Floats

    def only(self, index: Ints) -> Problem:
        """Return the problem of some of the points."""
        area = None if self.area is None else self.area[index]
        return replace(self, points=np.ascontiguousarray(self.points[:, index]), area=area)

    def weighed(self, weight: Floats, which: Ints | Bools) -> Floats:
        """Return the weights of some of the points times their areas. (m,)."""
        return weight if self.area is None else weight * self.area[which]

    def mean(self, values: Floats, which: Ints | Bools) -> float:
        """Average values of some of the points over their area."""
        return float(np.mean(values)) if self.area is None else float(np.average(values, weights=self.area[which]))


class Rows(NamedTuple):
    """Residuals of the points that count, and their derivatives by pose and terms."""

    which: Ints  # the points that count
    at: Floats  # where they are in the part frame (3, m)
    residual: Floats  # (m,)
    columns: Floats  # (6 + terms, m)


class Fit(NamedTuple):
    """Result of the least-squares fit: the state (6 + terms,), and the quality of the fit."""

    state: Floats
    normal: Floats  # J W Jᵀ over all unknowns
    used: int  # points
    square: float  # mean square of the residuals, as the loss weighs them [mm²]
    cost: float  # mean of the loss [mm²]
    scale: float  # scatter that the loss was scaled by [mm]
    steps: int

    @property
    def rms(self) -> float:
        """Root mean square of the residuals. [mm]."""
        return float(np.sqrt(self.square))


class _Sums(NamedTuple):
    normal: Floats
    right: Floats
    cost: float
    square: float
    weight: float
    area: float
    used: int


def wrap_angle(angle: Floats | float) -> Any:
    """Return angles in [-π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def turns(state: Floats) -> tuple[Floats, Floats]:
    """Return the rotation matrix of a state, and the axes of its three angles, as rows. (3, 3) each."""
    rotation, about_x, about_y = (float(angle) for angle in state[3:6])
    c, s = math.cos(rotation), math.sin(rotation)
    ca, sa = math.cos(about_x), math.sin(about_x)
    return rotation_matrix(rotation, about_x, about_y), np.array([[0, 0, 1], [c, s, 0], [-s * ca, c * ca, sa]])


def pose_of(state: Floats, pivot: Floats) -> Pose:
    """Return the pose of a state."""
    turn, _ = turns(state)
    return Pose.within_a_turn(state[:3] - turn @ pivot, state[3], state[4:6])


def state_of(pose: Pose, pivot: Floats, terms: int) -> Floats:
    """Return the state of a pose, the terms at zero."""
    at = [float(one) for one in pose.apply(*pivot)]
    return np.array([*at, pose.rotation, *pose.tilt, *[0.0] * terms])


def rows(problem: Problem, state: Floats, span: slice) -> Rows:
    """Return residuals along part z, or along the normal, and their exact derivatives."""
    turn, axes = turns(state)
    arm = turn @ problem.points[:, span]
    at = arm + state[:3, None]
    counts = at[0] * at[0] + at[1] * at[1] <= problem.within**2
    index = np.arange(at.shape[1])
    if not counts.all():
        index = np.flatnonzero(counts)
        arm, at = np.ascontiguousarray(arm[:, index]), np.ascontiguousarray(at[:, index])
    z, zx, zy, shapes = _design(problem, state, at[0], at[1])
    residual = at[2] - z
    if problem.normal:
        # At the foot of the perpendicular the distance to the tangent plane is the distance to the surface.
        for _ in range(FOOT_STEPS):
            along = residual / (1 + zx * zx + zy * zy)
            x, y = at[0] + along * zx, at[1] + along * zy
            z, zx, zy, shapes = _design(problem, state, x, y)
            residual = at[2] - z - (at[0] - x) * zx - (at[1] - y) * zy
    columns = np.empty((6 + len(shapes), index.size))
    columns[0], columns[1], columns[2] = -zx, -zy, 1.0
    moment = np.stack([arm[1] + arm[2] * zy, -arm[2] * zx - arm[0], -arm[0] * zy + arm[1] * zx])
    np.matmul(axes, moment, out=columns[3:6])
    for k, shape in enumerate(shapes):
        columns[6 + k] = -shape
    if problem.normal:
        shrink = 1 / np.sqrt(1 + zx * zx + zy * zy)
        residual, columns = residual * shrink, columns * shrink
    finite = np.isfinite(residual)
    if not finite.all():  # a pole, or a foot outside of the domain
        index, at, residual, columns = index[finite], at[:, finite], residual[finite], columns[:, finite]
    return Rows(index + span.start, at, residual, columns)


def _design(problem: Problem, state: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats, list[Floats]]:
    """Return height and slopes of the surface with its terms, and the height of each term."""
    z, zx, zy = problem.surface.evaluate(x, y, 1)
    shapes = []
    for amplitude, term in zip(state[6:], problem.terms, strict=True):
        shape, slope_x, slope_y = term.evaluate(x, y, 1)
        z, zx, zy = z + amplitude * shape, zx + amplitude * slope_x, zy + amplitude * slope_y
        shapes.append(shape)
    return z, zx, zy, shapes


def weights(residual: Floats, scale: float, loss: Loss) -> tuple[Floats, Floats]:
    """Return the weight and the loss [mm²] of each residual."""
    if loss == "linear":
        return np.ones_like(residual), residual * residual
    width = LOSS_WIDTHS[loss] * scale
    size = np.abs(residual)
    if loss == "huber":
        beyond = np.maximum(size, width)
        return width / beyond, np.where(size <= width, size * size, width * (2 * size - width))
    share = np.maximum(1 - (size / width) ** 2, 0.0)
    return share * share, width * width / 3 * (1 - share**3)


def _sums(problem: Problem, state: Floats, scale: float) -> _Sums:
    """Add up the normal equations over all points."""
    parts: dict[int, _Sums] = {}

    def add(start: int, block: Rows) -> None:
        weight, cost = weights(block.residual, scale, problem.loss)
        weight, cost = problem.weighed(weight, block.which), problem.weighed(cost, block.which)
        alike = problem.loss == "linear" and problem.area is None
        weighted = block.columns if alike else block.columns * weight
        parts[start] = _Sums(
            weighted @ block.columns.T,
            weighted @ block.residual,
            float(cost.sum()),
            float((weight * block.residual) @ block.residual),
            float(weight.sum()),
            float(block.which.size if problem.area is None else problem.area[block.which].sum()),
            block.which.size,
        )

    _run_blocks(problem, state, add)
    # In the order of the points, so that the sums are the same every time.
    return _Sums(*(sum(values) for values in zip(*(parts[start] for start in sorted(parts)), strict=True)))


def residuals(problem: Problem, state: Floats) -> Floats:
    """Return the residual of every point, nan where it does not count. (n,) [mm]."""
    out = np.full(problem.points.shape[1], np.nan)

    def fill(_: int, block: Rows) -> None:
        out[block.which] = block.residual

    _run_blocks(problem, state, fill)
    return out


def _run_blocks(problem: Problem, state: Floats, work: Callable[[int, Rows], None]) -> None:
    """Call ``work(start, rows)`` for every block of points, on all cores if there are several."""
    count = problem.points.shape[1]
    threads = 1 if count <= 2 * BLOCK_POINTS else None
    run_chunks(
        lambda start, stop: work(start, rows(problem, state, slice(start, stop))), count, BLOCK_POINTS, threads=threads
    )


def scatter(residual: Floats) -> float:
    """Return the robust standard deviation of the residuals. [mm]."""
    return max(robust_scatter(residual[np.isfinite(residual)]), MIN_SCATTER_MM)


def fit(
    problem: Problem,
    state: Floats,
    free: Sequence[int],
    size: Floats,
    *,
    steps: int = MAX_STEPS,
    close: float = 1e-14,
    least: float = MIN_ON_PART_SHARE,
    seen: float = 0.0,
) -> Fit:
    """Minimise the loss over the free components of the state by Levenberg-Marquardt.

    ``size`` (6 + terms,) is the change of each component that moves a point of the map by 1 mm. The iteration stops
    when no point moves by more than ``close`` mm. A step is rejected if fewer points remain on the part than the share
    ``least`` of the most so far; ``seen`` is a share known to lie there. A robust loss is rescaled by the scatter until
    it converges.
    """
    if problem.loss == "linear":
        return _march(problem, state, free, size, 1.0, steps, close, least, seen)
    scale, taken = np.inf, 0
    for _ in range(12):
        new = scatter(residuals(problem, state))
        if new > 0.98 * scale:  # it shrinks as outliers lose their pull
            break
        scale = new
        march = _march(problem, state, free, size, scale, steps, close, least, seen)
        state, taken = march.state, taken + march.steps
    return march._replace(steps=taken)


def _march(
    problem: Problem, state: Floats, free: Sequence[int], size: Floats, scale: float, steps: int, close: float,
    least: float, seen: float,
) -> Fit:  # fmt: skip
    """Levenberg-Marquardt with a fixed scale of the loss; undamped as long as steps succeed."""
    chosen = np.asarray(free, dtype=np.int64)
    sums = _sums(problem, state, scale)
    damping, taken, idle, begun = 0.0, 0, 0, sums.cost / max(sums.area, 1e-300)
    most = max(sums.used, seen * problem.points.shape[1])
    while taken < steps and sums.used > 0 and chosen.size:
        taken += 1
        unit = size[chosen]
        normal = sums.normal[np.ix_(chosen, chosen)] * np.outer(unit, unit)
        right = sums.right[chosen] * unit
        step = _solve(normal, right, damping)
        trial = _apply_step(problem, state, chosen, -step * unit)
        moved = float(np.abs(step).max(initial=0.0))
        changed = float(np.sqrt(max(float(step @ normal @ step), 0.0) / max(sums.weight, 1e-300)))
        leans = float(np.abs(trial[4:6]).max())
        there = _sums(problem, trial, scale) if moved < 1e3 and leans < MAX_TILT_RAD else None
        better = False
        if there is not None and there.used >= max(least * most, chosen.size + 1):
            slack = chance(problem, trial - state, sums.used, there.used)
            better = there.cost / there.area <= sums.cost / sums.area * (1 + slack)
            if there.used < FULL_SHARE * most:  # no pose gains by losing points: each costs as much as an outlier
                price = max(begun, OUTLIER_COST * sums.cost / max(sums.area, 1e-300))
                better &= there.cost - price * there.area <= sums.cost - price * sums.area
        gain = 0.0
        if better and there is not None:
            gain = (sums.cost / sums.area - there.cost / there.area) * sums.used
            state, sums, most = trial, there, max(most, there.used)
            damping = 0.0 if damping < 1e-6 else damping / 10
        else:
            if moved < 1e-9:  # rounding decides the rest
                break
            damping = max(10 * damping, 1e-6)
            if damping > 1e8:
                break
        idle = 0 if gain > CONVERGENCE_TOL * sums.cost / max(sums.area, 1e-300) else idle + 1
        if idle >= MAX_IDLE_STEPS:  # the edge of the part stops it
            break
        sure = np.sqrt(sums.square / max(sums.weight, 1e-300) / sums.used)
        if damping < MAX_FINAL_DAMPING and (moved <= close or changed <= max(ROUNDING_MM, CONVERGENCE_TOL * sure)):
            break
    square = sums.square / max(sums.weight, 1e-300)
    return Fit(state, sums.normal, sums.used, square, sums.cost / max(sums.area, 1e-300), scale, taken)


def _apply_step(problem: Problem, state: Floats, chosen: Ints, step: Floats) -> Floats:
    """Return the state after a step of the chosen components, as a rotation about the centres of curvature.

    Shift and tilt are nearly equivalent about such a centre: the valley of the loss is curved in these components, and
    straight in rotations about the centre. Components that are not chosen stay; a fixed rotation is turned back.
    """
    trial = state.copy()
    trial[chosen] += step
    if not {0, 1} & set(chosen.tolist()) or not {4, 5} <= set(chosen.tolist()):
        return trial
    matrix, axes = turns(state)
    turn = (trial - state)[3:6] @ axes
    beyond = np.empty(3)
    bend(state[:3], turn, problem.bends, beyond)
    at = trial[:3] + beyond
    matrix = rotation_about(turn) @ matrix
    if 3 not in chosen:
        back = angles_of(matrix)[0] - state[3]
        c, s = np.cos(back), np.sin(back)
        at[:2] = c * at[0] + s * at[1], c * at[1] - s * at[0]
    return place_pivot(trial, chosen, at, matrix)


def place_pivot(state: Floats, free: Sequence[int] | Ints, at: Floats, matrix: Floats) -> Floats:
    """Return a state whose free components put the pivot at a place and turn the points by a matrix."""
    angles = state[3:6] + wrap_angle(np.array(angles_of(matrix)) - state[3:6])
    chosen = [k for k in free if k < 6]
    moved = state.copy()
    moved[chosen] = np.array([*at, *angles])[chosen]
    return moved


def rotation_about(turn: Floats | Sequence[float]) -> Floats:
    """Return the matrix that turns about a vector by its length. (3, 3)."""
    angle = math.hypot(*turn)
    if angle == 0:
        return np.eye(3)
    x, y, z = np.asarray(turn) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def chance(problem: Problem, step: Floats, used: int, other: int) -> float:
    """Return the relative change of the mean cost that points exchanged at the rim of the part may cause."""
    if min(used, other) == problem.points.shape[1]:
        return 0.0
    exchanged = 2 * float(np.hypot(step[0], step[1])) / problem.within * used + abs(used - other)
    return 3 * float(np.sqrt(2 * exchanged)) / max(used, 1)


def _solve(normal: Floats, right: Floats, damping: float) -> Floats:
    """Solve the damped equations; undetermined directions take no step."""
    width = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    width = np.maximum(width, EFFECT_TOL * width.max())
    scaled = normal / np.outer(width, width)
    scaled[np.diag_indices_from(scaled)] += damping
    values, vectors = np.linalg.eigh(scaled)
    along = vectors.T @ (right / width)
    significant = values > 1e-15 * values[-1]
    return np.asarray((vectors[:, significant] @ (along[significant] / values[significant])) / width)
