"""Regression for chips of uniform thickness along the edge, with the transition out of the ductile regime.

F tests choose between no transition, a drop of the forces [Hansen2000]_ and a change of slope. An edge force or a size
effect, which also bends the forces, is not a transition. Model and intervals: docs/theory/learning_forces.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright.cutting.learning.cuts import Cuts
from turnwright.cutting.learning.regression import (
    MAX_CHANCE,
    MIN_ROWS,
    TINY,
    WARNING_CONFIDENCE,
    Fit,
    Rows,
    hansen,
    interval,
)
from turnwright.cutting.learning.results import FORCE_NAMES, Transition
from turnwright.errors import InputError

__all__ = ["StraightRows"]

COMPONENTS = 2
"""Cutting force and thrust."""

SLOPE_SIGMA = 3.0
"""Coverage factor for the slope of the forces beyond a transition."""

SLOPE_TOL = 0.05
"""Slope that counts as 0, relative to the ductile slope."""

MAX_SLOPE_UNCERTAINTY = 0.3
"""Largest expanded uncertainty of a slope, relative to the ductile slope, for a decision."""

ROUNDING_VARIANCE = 1e-18
"""Variance of forces without noise, relative to their mean square."""

EXTRA_COLUMNS = 2
"""Columns that a transition adds: a force per width beyond it, and one proportional to the thickness."""

TRIAL_THICKNESSES = 60
"""Trial thicknesses of a change of slope, before refinement."""

BISECTIONS = 16
"""Bisections for each end of the interval."""

MAX_EXPONENT = 0.7
"""Largest exponent of a size effect that is tried as an alternative; those of metals are 0.1 to 0.5."""

MIN_NOISE = 0.5
"""Lower bound of the variance of the noisier side, relative to that of all rows."""


class StraightRows(Rows):
    """Rows of chips of uniform thickness along the edge: each component determines one coefficient."""

    judged = slice(0, 1)

    def __init__(self, cuts: Cuts, drift: int | None = None) -> None:
        """Take the cuts and the degree of their drift."""
        force, engaged = np.column_stack((cuts.cutting, cuts.thrust)), cuts.thickness > 0
        super().__init__(
            force, tuple(FORCE_NAMES), engaged, cuts.thickness,
            time=cuts.time, record=cuts.record, drift=drift, uncertainty=cuts.uncertainty,
        )  # fmt: skip
        area = cuts.thickness * cuts.width if cuts.area is None else cuts.area
        self.areas = np.column_stack((area, area if cuts.thrust_area is None else cuts.thrust_area))
        self.widths = np.divide(
            self.areas, cuts.thickness[:, None], out=np.zeros_like(self.areas), where=engaged[:, None]
        )
        self.spread = np.zeros_like(cuts.thickness) if cuts.spread is None else cuts.spread
        self.reference = float(np.exp(np.log(cuts.thickness[engaged]).mean()))
        self.load, self.labels = self.areas[:, 0], tuple(FORCE_NAMES.values())
        self.selected = np.arange(COMPONENTS)

    def ductile(self, component: int, limit: float = np.inf) -> Floats:
        """Return the columns of a coefficient and of its edge force or exponent. (n, 1 or 2).

        Beyond ``limit`` [mm] they are constant per width.
        """
        width, thickness = self.widths[:, component], np.minimum(self.thickest, limit)
        area = width * thickness if limit < np.inf else self.areas[:, component]
        if self.power is not None:
            ratio = np.where(self.engaged, thickness / self.reference, 1.0)
            falls = area * ratio ** -self.power[component]
            return np.column_stack((falls, -falls * np.log(ratio)))
        return np.column_stack((area, width)) if self.edge else area[:, None]

    def columns(self, limit: float) -> Floats:
        """Return the design matrix, see `Rows.columns`."""
        thin, p = (self.thickest <= limit)[:, None], self.parts
        columns = np.zeros((self.engaged.size, COMPONENTS, 2 * p + (2 * COMPONENTS if limit < np.inf else 0)))
        for c in range(COMPONENTS):
            columns[:, c, p * c : p * (c + 1)] = self.ductile(c) * thin
            if limit < np.inf:
                brittle = np.column_stack((self.widths[:, c], self.areas[:, c])) * ~thin
                columns[:, c, 2 * p + 2 * c : 2 * p + 2 * c + 2] = brittle
        return columns[:, self.selected]

    def part(self, component: int) -> StraightRows:
        """Return the rows with one force component."""
        single = super().part(component)
        assert isinstance(single, StraightRows)  # noqa: S101 - a copy
        single.selected = self.selected[[component]]
        return single

    def groups(
        self, relative: Sequence[float] | Floats = (0.0, 0.0)
    ) -> Iterator[tuple[Rows, Sequence[float] | Floats]]:
        """Return each component separately, since it determines its own coefficient only."""
        yield from ((self.part(c), relative[c : c + 1]) for c in range(COMPONENTS))

    def surely_ductile(self, low: float) -> Bools:
        """Return the mask of rows that are ductile for every limit of at least ``low``."""
        return np.asarray(self.thickest + self.spread <= low)

    def surely_brittle(self, high: float) -> Bools:
        """Return the mask of rows that are brittle for every limit of at most ``high``."""
        return np.asarray(self.thickest - self.spread >= high)

    @property
    def free(self) -> int:
        """Degrees of freedom after the drift, a line and a limit."""
        return int(max(self.engaged.size - self.drift.shape[1] - 3, 1))

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


def _find_drop(rows: StraightRows, confidence: float) -> _Drop | None:
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
        chance=_bound_chance(rows, residual, at),
    )
    return _Drop(split, squares[:, best], weight, max(eta))


def _split_squares(rows: StraightRows, component: int, order: Ints, after: Ints) -> Floats:
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
    rows: StraightRows, order: Ints, cut: int, limit: float
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


def _transition(rows: StraightRows, confidence: float) -> Transition | None:
    """Return the transition: none, a drop, or a change of slope.

    A change of slope has fewer parameters. A drop is chosen if it fits significantly better; if that is undecided, the
    interval includes both. Neither is chosen if an edge force or a size effect fits as well.
    """
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    drop, bend = _find_drop(rows, confidence), _find_slope_change(rows, confidence)
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


def _as_transition(bend: _SlopeChange | None) -> Transition | None:
    """Return a change of slope as a transition; ``None`` if it is not clear, or its interval includes 0."""
    if bend is None or bend.chance > MAX_CHANCE or bend.straight or not bend.falls or bend.low == 0:
        return None
    return Transition(bend.value, bend.low, bend.high, (1.0, 1.0), bend.chance)


def _check_constant_forces(rows: StraightRows, limit: float) -> list[str]:
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


@dataclass(frozen=True, slots=True)
class _SlopeChange:
    """Slope discontinuity of the forces over the chip thickness."""

    value: float  # thickness of the discontinuity, and its interval. [mm]
    low: float
    high: float
    squares: Floats  # residual sum of squares of each component. (2,)
    chance: float  # upper bound of the probability that forces without a discontinuity show one as clear
    smooth: Floats  # residual sum of squares of each component with an edge force or a size effect instead. (2,)
    straight: bool  # whether an edge force or a size effect fits as well
    falls: bool  # whether the cutting force grows more slowly beyond


def _find_slope_change(rows: StraightRows, confidence: float) -> _SlopeChange | None:
    """Find the thickness at which the forces change their slope; ``None`` if there are too few rows."""
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    low, high = float(ascending[MIN_ROWS - 1]), float(ascending[-MIN_ROWS])
    if ascending.size < 2 * MIN_ROWS or not low < high * (1 - 1e-9):
        return None
    fits = [Fit(rows.part(component)) for component in range(COMPONENTS)]
    # Half of the trial thicknesses are quantiles of the rows, half are evenly spaced.
    grid = np.unique(
        np.concatenate(
            (np.linspace(low, high, TRIAL_THICKNESSES), np.quantile(ascending, np.linspace(0, 1, TRIAL_THICKNESSES)))
        )
    )
    grid = grid[(grid >= low) & (grid <= high)]
    table = np.array([[_fit_bent(rows, fits, c, limit)[1] for c in range(COMPONENTS)] for limit in grid])
    tiny = np.array([1e-14 * float((fit.free_force**2).sum()) + TINY for fit in fits])
    at = int(np.argmin((table / np.maximum(table.min(axis=0), tiny)).sum(axis=1)))
    variance = np.maximum(table[at], tiny) / rows.free

    def squares(limit: float) -> float:
        return float(sum(_fit_bent(rows, fits, c, limit)[1] / variance[c] for c in range(COMPONENTS)))

    best, least, within = interval(squares, grid, (table / variance).sum(axis=1), 1e-6 * high)
    solutions = [_fit_bent(rows, fits, c, best) for c in range(COMPONENTS)]
    residual = np.column_stack([solution[2] for solution in solutions])
    noise = _largest_variance(rows, residual / np.sqrt(variance), best)
    reach = float(f.ppf(confidence, 1, max(rows.free / noise, 1.0))) * noise
    ends = within(reach, (0.0, float(ascending[-1])), BISECTIONS)
    smooth = np.array([_fit_smooth(rows, fits, c) for c in range(COMPONENTS)])
    gain = float((smooth / variance).sum() - least) / noise
    answer = solutions[0][0]
    below = (rows.line(0, answer, best) - rows.line(0, answer, 0.99 * best)) / (0.01 * best)
    return _SlopeChange(
        value=best,
        low=ends[0],
        high=ends[1],
        squares=np.array([solution[1] for solution in solutions]),
        chance=_bound_chance(rows, residual, best),
        smooth=smooth,
        straight=rows.engaged.size * float(f.sf(gain, 1, rows.free)) > MAX_CHANCE,
        falls=bool(answer[-1] < below),
    )


def _fit_bent(rows: StraightRows, fits: list[Fit], component: int, limit: float) -> tuple[Floats, float, Floats]:
    beyond = rows.widths[:, component] * np.maximum(rows.thickest - limit, 0.0)
    return fits[component].solve(np.column_stack((rows.ductile(component, limit), beyond))[:, None])


def _fit_smooth(rows: StraightRows, fits: list[Fit], component: int) -> float:
    """Return the smallest sum of squares with an edge force or a size effect, without a transition."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - costly to import

    if rows.power is not None:
        return np.inf
    ductile = rows.ductile(component)
    chip = np.where(rows.engaged, rows.thickest / rows.reference, 1.0)

    def falling(power: float) -> float:
        return fits[component].solve(np.column_stack((ductile[:, 0] * chip**-power, ductile[:, 1:]))[:, None])[1]

    size_effect = minimize_scalar(falling, bounds=(0.0, MAX_EXPONENT), method="bounded", options={"xatol": 1e-5})
    if rows.edge:
        return float(size_effect.fun)
    columns = np.column_stack((ductile, rows.widths[:, component]))
    (slope, edge), squares, _ = fits[component].solve(columns[:, None])
    # A cutting force that hardly grows is that of brittle chips, not an edge force.
    plausible = component > 0 or edge <= slope * rows.thickest.max()
    return min(float(size_effect.fun), squares if plausible else np.inf)


def _largest_variance(rows: StraightRows, residual: Floats, limit: float) -> float:
    """Return the larger long-run variance of both sides; the components of a row may be correlated."""
    variances = []
    for side in (rows.thickest <= limit, rows.thickest > limit):
        inside = rows.engaged & side
        count = int(np.count_nonzero(inside))
        if count >= 2 * MIN_ROWS:
            covariance = residual[inside].T @ residual[inside] / (count - 1)
            variances.append(rows.correlation(residual, inside) * float(np.linalg.eigvalsh(covariance).max()))
    return max([MIN_NOISE, *variances] if variances else [float(COMPONENTS)])


def _bound_chance(rows: StraightRows, residual: Floats, limit: float) -> float:
    """Return an upper bound of the probability that forces without a transition show one as clear.

    For one component and one split, the gain of straight lines with normal noise follows an F distribution with two
    numerator degrees of freedom. Lines that meet between two rows gain at most as much as the split there. The sum of
    the probabilities over all splits and both components therefore bounds both kinds of transition, whatever the
    correlation of the components (Bonferroni). The noise is that of all cuts, or of the noisier side if that is larger.

    Parameters
    ----------
    rows
        All rows.
    residual
        Residuals with a transition. (n, 2)
    limit
        Thickness of the transition. [mm]
    """
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    after = np.flatnonzero(np.diff(ascending) > 0) + 1
    places = np.count_nonzero((after >= MIN_ROWS) & (after <= ascending.size - MIN_ROWS))
    thin = rows.engaged & (rows.thickest <= limit)
    sides = [side for side in (thin, rows.engaged & ~thin) if np.count_nonzero(side) >= 2 * MIN_ROWS]
    chances = []
    for component in range(COMPONENTS):
        part, component_residual = rows.part(component), residual[:, [component]]
        without = Fit(part).solve(rows.ductile(component)[:, None])[1]
        free = max(ascending.size - rows.drift.shape[1] - rows.parts - EXTRA_COLUMNS, 1)
        tau = max(part.correlation(component_residual, side) for side in sides or [rows.engaged])
        squares = component_residual[:, 0] ** 2
        noise = tau * max([squares[rows.engaged].sum() / free, *(squares[side].mean() for side in sides)])
        noise += ROUNDING_VARIANCE * float(((part.force * part.weights) ** 2).mean()) + TINY
        gain = max(without - float(squares.sum()), 0.0) / noise / EXTRA_COLUMNS
        chances.append(float(f.sf(gain, EXTRA_COLUMNS, max(free / tau, 1.0))))
    return min(1.0, COMPONENTS * int(places) * min(chances))
