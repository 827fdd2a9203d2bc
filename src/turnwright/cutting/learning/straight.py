r"""Regression for chips of uniform thickness along the edge, with the transition out of the ductile regime.

In the ductile regime the forces are proportional to the uncut chip area A; beyond the critical thickness they leave
that line,

.. math:: F = d(t) + \begin{cases} K A & h \le h_c \\ (q_0 + q_1 h)\,A/h & h > h_c \end{cases}

where the amplifier drift d is a polynomial in time, determined by the samples in air in the same fit, so that its
uncertainty is included in that of K. The critical thickness :math:`h_c` is the split with the smallest sum of squares.
The position of a jump is not normally distributed; its interval consists of all splits that the likelihood ratio does
not reject,

.. math:: \frac{S(h_c) - S(\hat h_c)}{\eta^2} \le -2 \ln\!\bigl(1 - \sqrt{p}\bigr)

(7.35 for p = 95 %), where η² is the long-run variance of the noise on the side that the split would assign wrongly
[Hansen2000]_. Rows within the interval are excluded from the fit of K. All variances include correlation in time.

The forces may also grow more slowly beyond the critical thickness, without a drop. F tests choose between no
transition, a drop and a change of slope. An edge force or a size effect, which also bends the forces, is not a
transition.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.cutting.learning.cuts import Cuts
from turnwright.cutting.learning.fit import MAX_CHANCE, TINY, WARNING_CONFIDENCE, Fit, hansen
from turnwright.cutting.learning.learned import FORCE_NAMES, Transition
from turnwright.cutting.learning.rows import MIN_ROWS
from turnwright.cutting.learning.slope_change import ROUNDING_VARIANCE, SlopeChange, bound_chance, find_slope_change
from turnwright.cutting.learning.uniform_rows import COMPONENTS, UniformRows
from turnwright.errors import InputError

__all__ = ["StraightRows", "least_chance"]

SLOPE_SIGMA = 3.0
"""Coverage factor for the slope of the forces beyond a transition."""

SLOPE_TOL = 0.05
"""Slope that counts as 0, relative to the ductile slope."""

MAX_SLOPE_UNCERTAINTY = 0.3
"""Largest expanded uncertainty of a slope, relative to the ductile slope, for a decision."""


class StraightRows(UniformRows):
    """Rows of chips of uniform thickness, with the transition that they show."""

    def find_warnings(self, split: Transition | None, ductile: Bools) -> list[str]:
        """Return warnings if the forces beyond the limit are constant, or few rows are ductile."""
        if split is None:
            return []
        warnings, count = _check_constant_forces(self, split.value), int(np.count_nonzero(ductile))
        if count <= MIN_ROWS:
            warnings.append(
                f"only {count} cuts are certainly ductile, at least {MIN_ROWS + 1} are needed: coefficients and "
                "critical thickness are wrong if these are brittle too, so measure thinner chips"
            )
        return warnings

    def transition(self, confidence: float) -> Transition | None:
        """Return the transition: none, a drop, or a change of slope."""
        return _transition(self, confidence)


@dataclass(frozen=True, slots=True)
class _Drop:
    """Best split with a drop: residual sum of squares and weight of each component, and long-run variance."""

    split: Transition
    squares: Floats
    weight: Floats
    noise: float


def _find_drop(rows: UniformRows, confidence: float) -> _Drop | None:
    """Find the thickness at which the forces jump, with its interval."""
    engaged = np.flatnonzero(rows.engaged)
    order = engaged[np.argsort(rows.thickest[engaged], kind="stable")]
    ascending = rows.thickest[order]
    # Number of rows on the thin side; rows of equal thickness are not split.
    after = np.flatnonzero(np.diff(ascending) > 0) + 1
    after = after[(after >= MIN_ROWS) & (after <= ascending.size - MIN_ROWS)]
    if not after.size:
        return None
    middle = (ascending[after - 1] + ascending[after]) / 2
    squares = np.array([_split_squares(rows, component, order, after) for component in range(COMPONENTS)])
    scale = np.maximum(squares.min(axis=1) / rows.free, TINY)
    rough = int(np.argmin((squares / scale[:, None]).sum(axis=0)))
    # The weights of the components follow from the noise of the ductile side.
    weight = 1 / np.diag(_compare_sides(rows, order, int(after[rough]), float(middle[rough]))[0])
    joint = weight @ squares
    best = int(np.argmin(joint))
    at = float(middle[best])
    thin, thick, drop, residual, answer = _compare_sides(rows, order, int(after[best]), at)
    jump = max(float(weight @ drop**2), TINY)
    eta = [float((weight * drop) @ side @ (weight * drop) / jump) for side in (thin, thick)]
    # A split below the best one assigns ductile rows to the brittle side, so the noise of the brittle side applies.
    allowed = joint - joint[best] <= hansen(confidence) * np.where(np.arange(joint.size) < best, eta[1], eta[0])
    inside = after[allowed]
    low, high = order[inside.min() - 1], order[inside.max()]
    split = Transition(
        value=at,
        low=max(float(rows.thickest[low] - rows.spread[low]), 0.0),
        high=float(rows.thickest[high] + rows.spread[high]),
        remaining=tuple(rows.remaining(component, answer, at) for component in range(COMPONENTS)),
        chance=bound_chance(rows, residual, at),
    )
    return _Drop(split, squares[:, best], weight, max(eta))


def _split_squares(rows: UniformRows, component: int, order: Ints, after: Ints) -> Floats:
    """Return the residual sum of squares of each split, from cumulative sums of column products. (k,)."""
    ductile, beyond = rows.ductile(component), np.column_stack((rows.widths[:, component], rows.areas[:, component]))
    table = np.column_stack((rows.drift, ductile, beyond, rows.force[:, component]))
    table = table * rows.weights[:, component, None]
    size = np.maximum(np.linalg.norm(table, axis=0), TINY)
    size[-1] = 1.0
    table = table / size
    of_split = np.repeat([0, 1, 2, 0], [rows.drift.shape[1], ductile.shape[1], 2, 1])
    products = np.cumsum(table[order, :, None] * table[order, None, :], axis=0)
    air = table[~rows.engaged].T @ table[~rows.engaged]
    thin, thick = (np.outer(of_split != side, of_split != side) for side in (2, 1))
    sums = products[after - 1] * thin + (products[-1] - products[after - 1]) * thick + air
    normal, right, total = sums[:, :-1, :-1], sums[:, :-1, -1], float(sums[0, -1, -1])
    # The columns of the brittle side are collinear if all its chips are equally thick: regularise.
    normal = normal + 1e-11 * np.trace(normal, axis1=1, axis2=2)[:, None, None] / right.shape[1] * np.eye(
        right.shape[1]
    )
    answer = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(total - np.einsum("ij,ij->i", answer, right), 1e-14 * total))


def _compare_sides(
    rows: UniformRows, order: Ints, cut: int, limit: float
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return long-run covariances of the thin and thick side of a split, its jump, the residuals and the parameters.

    (2, 2), (2, 2), (2,), (n, 2) and (k,).
    """
    fit, columns = Fit(rows), rows.columns(limit)
    answer, _, residual = fit.solve(columns)
    line, first = answer[: 2 * rows.parts], order[cut]
    jump = rows.weights[first] * (rows.columns(np.inf)[first] @ line - columns[first] @ answer)
    covariances = []
    for which in (order[:cut], order[cut:]):
        side = np.zeros(rows.engaged.size, dtype=np.bool_)
        side[which] = True
        covariances.append(
            rows.correlation(residual, side) * residual[which].T @ residual[which] / max(which.size - 1, 1)
        )
    # With few rows on one side, the larger covariance is used for both.
    if min(cut, order.size - cut) < 2 * MIN_ROWS:
        covariances = [max(covariances, key=np.trace)] * 2
    floor = np.diag(ROUNDING_VARIANCE * (fit.force**2).mean(axis=0) + TINY)
    return covariances[0] + floor, covariances[1] + floor, jump, residual, answer


def least_chance(cuts: Cuts, confidence: float = 0.95) -> float:
    """Return the smallest ``chance`` of a drop or a change of slope, whether it is reported or not."""
    rows = StraightRows(cuts)
    drop, bend = _find_drop(rows, confidence), find_slope_change(rows, confidence)
    candidates = (bend, None if drop is None else drop.split)
    return min([1.0, *(candidate.chance for candidate in candidates if candidate is not None)])


def _transition(rows: UniformRows, confidence: float) -> Transition | None:
    """Return the transition: none, a drop, or a change of slope.

    A change of slope has fewer parameters. A drop is chosen if it fits significantly better; if that is undecided, the
    interval includes both. Neither is chosen if an edge force or a size effect fits as well.
    """
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    drop, bend = _find_drop(rows, confidence), find_slope_change(rows, confidence)
    n = rows.engaged.size

    def probability(drop: _Drop, squares: Floats, numbers: int) -> float:
        """Return the probability that noise alone lets a drop, with more parameters, fit better by as much."""
        # The noise is that of the larger model.
        gain = float(drop.weight @ (squares - drop.squares)) / drop.noise / numbers
        return n * float(f.sf(gain, numbers, rows.free))

    for candidate in (bend, None if drop is None else drop.split):
        if candidate is not None and candidate.chance <= MAX_CHANCE:
            _check_constant_forces(rows, candidate.value)
    split = None if drop is None or drop.split.chance > MAX_CHANCE or drop.split.remaining[0] >= 1 else drop.split
    if bend is None or drop is None:
        return _as_transition(bend) or split
    if probability(drop, bend.smooth, COMPONENTS) > MAX_CHANCE:
        split = None
    bent, chance = _as_transition(bend), probability(drop, bend.squares, COMPONENTS + 1)
    if bent is None or chance < MAX_CHANCE:
        return split
    if split is not None and chance < n * MAX_CHANCE:
        return replace(bent, low=min(bent.low, split.low), high=max(bent.high, split.high))
    return bent


def _as_transition(bend: SlopeChange | None) -> Transition | None:
    """Return a change of slope as a transition; ``None`` if it is not clear, or its interval includes 0."""
    if bend is None or bend.chance > MAX_CHANCE or bend.straight or not bend.falls or bend.low == 0:
        return None
    return Transition(bend.value, bend.low, bend.high, (1.0, 1.0), bend.chance)


def _check_constant_forces(rows: UniformRows, limit: float) -> list[str]:
    """Return a warning if both forces are constant beyond a limit; raise if only one of them is.

    Fracture changes both forces; saturation changes one channel.
    """
    level, precise, constant, proportional = [], [], [], []
    thick = rows.thickest > limit
    for component in range(COMPONENTS):
        beyond = rows.widths[:, component] * np.maximum(rows.thickest - limit, 0.0)
        fit = Fit(rows.part(component))
        solution = fit.estimate(np.column_stack((beyond, rows.ductile(component, limit)))[:, None], WARNING_CONFIDENCE)
        slope, sigma, ductile_slope = solution.value[0], solution.sigma[0], solution.value[1]
        force = np.abs(rows.force[:, component])
        level.append(float(force[thick].mean()))
        tolerance = max(SLOPE_SIGMA * sigma, SLOPE_TOL * ductile_slope)
        precise.append(SLOPE_SIGMA * sigma < MAX_SLOPE_UNCERTAINTY * ductile_slope)
        constant.append(abs(slope) < tolerance and force[thick].max() >= force[~thick].max())
        proportional.append(abs(slope - ductile_slope) < tolerance)
    if all(constant):
        warning = (
            f"both forces are constant beyond it, at {level[0]:.4g} N and {level[1]:.4g} N: if these are the ends of "
            "the measuring ranges, the critical thickness is not that of the material"
        )
        return [warning]
    names = tuple(FORCE_NAMES.values())
    for which, second in ((0, 1), (1, 0)):
        if all(precise) and constant[which] and proportional[second]:
            raise InputError(
                f"the {names[which]} is constant at {level[which]:.4g} N from {limit * 1e6:.4g} nm on while the "
                f"{names[second]} stays proportional: fracture would change both, so the channel is saturated; record "
                "with a larger range, or remove these cuts"
            )
    return []
