"""Weighted least squares of forces: rows with their drift, coefficients with uncertainties and intervals."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright._validate import whole_number
from turnwright.cutting.learning.results import FORCE_NAMES, Transition
from turnwright.cutting.learning.signals import MAX_DRIFT_DEGREE, correlation_time
from turnwright.errors import InputError

__all__ = ["MAX_CHANCE", "MIN_ROWS", "TINY", "WARNING_CONFIDENCE", "Fit", "Rows", "Solution", "hansen", "interval"]

MIN_ROWS = 4
"""Number of rows on either side of a transition."""

MAX_CHANCE = 0.01
"""Probability of a chance result below which a transition is reported."""

WARNING_CONFIDENCE = 0.999
"""Confidence level of the interval outside which a deviation is reported."""

MIN_ROBUST_ROWS = 50
"""Number of rows in time above which the covariance is estimated from the residual of each row."""

MAX_CONDITION = 1e8
"""Condition number of the columns above which they are not distinguishable."""

TINY = float(np.finfo(np.float64).tiny)


class Rows(ABC):
    """Rows of a regression, with the state of the fit."""

    turns: ClassVar[bool] = False
    """Whether the rows are those of a rotating cutter, whose angle is estimated from the forces."""

    judged: ClassVar[slice] = slice(None)
    """Components whose noise is judged."""

    def __init__(
        self,
        force: Floats,
        components: tuple[str, ...],
        engaged: Bools,
        thickest: Floats,
        *,
        time: Floats | None,
        record: Floats | None,
        drift: int | None,
        uncertainty: Floats | None = None,
    ) -> None:
        self.force, self.components, self.engaged, self.thickest = force, components, engaged, thickest
        self.labels, self.load = components, thickest
        n = engaged.size
        if np.count_nonzero(engaged) < MIN_ROWS:
            raise InputError(
                f"at least {MIN_ROWS} rows must be cuts, got {np.count_nonzero(engaged)}: measure more cuts"
            )
        record = np.zeros(n) if record is None else record
        self.in_time = time is not None
        self.order = np.arange(n) if time is None else np.lexsort((time, record))
        self.drift = np.zeros((n, 0)) if drift is None else _drift_columns(time, record, ~engaged, drift)
        self.stated = uncertainty is not None
        self.weights = np.ones_like(force) if uncertainty is None else 1 / uncertainty
        self.determined: tuple[str, ...] = tuple(FORCE_NAMES)
        self.edge = False
        self.power: list[float] | None = None
        self.reference = 1.0

    @property
    def parts(self) -> int:
        """Number of ductile columns of each coefficient."""
        return 2 if self.edge or self.power is not None else 1

    @abstractmethod
    def columns(self, limit: float) -> Floats:
        """Return the design matrix. (n, components, parameters).

        Its columns are, for the cutting coefficient, the ductile area, and the edge or the derivative with respect to
        the exponent; the same for the thrust; then, for both, the forces beyond the limit per width and per area.
        """

    @abstractmethod
    def transition(self, confidence: float) -> Transition | None:
        """Return the critical thickness with its interval; ``None`` if the forces show no transition."""

    def find_determined(self) -> tuple[str, ...]:
        """Return the coefficients that the measured components determine."""
        size = np.abs(self.columns(np.inf)).max(axis=(0, 1))
        return tuple(name for name, largest in zip(FORCE_NAMES, size, strict=True) if largest > 1e-9 * size.max())

    def groups(self, relative: Sequence[float] | Floats = ()) -> Iterator[tuple[Rows, Sequence[float] | Floats]]:
        """Return the rows that are fitted together, with the relative uncertainties of their components."""
        yield self, relative

    def place(self, beyond: bool = False) -> list[int]:
        """Return the column indices of the determined coefficients, and of their forces beyond the limit."""
        which = [list(FORCE_NAMES).index(name) for name in self.determined]
        ductile = [self.parts * k + i for k in which for i in range(self.parts)]
        return ductile + [2 * self.parts + 2 * k + i for k in which for i in (0, 1) if beyond]

    def design(self, used: Bools, split: Transition | None) -> tuple[Bools, Floats, int]:  # noqa: ARG002 - for rotating cutters
        """Return the rows and columns of the final fit, and the number of columns that belong to coefficients."""
        place = self.place()
        return used, self.columns(np.inf)[:, :, place], len(place)

    def unknown(self, answer: Floats, limit: float) -> Floats:  # noqa: ARG002 - for subclasses
        """Return columns of additional unknowns. (n, components, k)."""
        return np.zeros((*self.force.shape, 0))

    def synchronise(self, answer: Floats | None, limit: float) -> None:  # noqa: B027 - for rotating cutters
        """Estimate the angle of a rotating cutter from the forces; does nothing for a steady cut."""

    def find_warnings(self, split: Transition | None, ductile: Bools) -> list[str]:  # noqa: ARG002 - for subclasses
        """Return warnings about the result."""
        return []

    def surely_ductile(self, low: float) -> Bools:
        """Return the mask of rows that are ductile all along the edge for every limit of at least ``low``."""
        return np.asarray(self.thickest <= low)

    def surely_brittle(self, high: float) -> Bools:
        """Return the mask of rows that are brittle for every limit of at most ``high``."""
        return np.asarray(self.thickest > high)

    def line(self, which: int, answer: Floats, at: float) -> float:
        """Return the ductile force per width at a chip thickness."""
        thin = answer[self.parts * which :]
        if self.power is not None:
            ratio = at / self.reference
            return float(at * ratio ** -self.power[which] * (thin[0] - thin[1] * np.log(ratio)))
        return float(thin[0] * at + (thin[1] if self.edge else 0.0))

    def remaining(self, which: int, answer: Floats, at: float) -> float:
        """Return the force beyond the limit over the ductile force, at a chip thickness."""
        thick, line = answer[2 * self.parts + 2 * which :], self.line(which, answer, at)
        return float((thick[0] + thick[1] * at) / line) if line else np.inf

    def correlation(self, residual: Floats, rows: Bools) -> float:
        """Return the largest correlation time of the components of ``residual``, in rows. (n, components)."""
        inside = self.order[rows[self.order]]
        if not self.in_time or inside.size <= 16:
            return 1.0
        return max(correlation_time(column) for column in residual[inside].T)

    def part(self, component: int) -> Rows:
        """Return the rows with one force component, which determines the coefficient of the same index only."""
        single = copy.copy(self)
        single.force, single.weights = self.force[:, [component]], self.weights[:, [component]]
        single.components, single.determined = (self.components[component],), (tuple(FORCE_NAMES)[component],)
        return single


def _drift_columns(time: Floats | None, record: Floats, air: Bools, degree: int) -> Floats:
    """Return the design columns for the drift of each record. (n, records times (degree + 1))."""
    if time is None:
        raise InputError("a drift needs the times of the cuts, got none: state time, or leave drift out")
    degree = whole_number(degree, "the degree of the drift", 0, MAX_DRIFT_DEGREE)
    columns = []
    for number in np.unique(record):
        inside = record == number
        if np.count_nonzero(air & inside) <= degree + 1:
            raise InputError(
                f"a drift of degree {degree} needs more than {degree + 1} rows in air for each record, got "
                f"{np.count_nonzero(air & inside)}: record air before and after the cuts"
            )
        first, span = time[inside].min(), np.ptp(time[inside]) or 1.0
        columns.append(np.polynomial.legendre.legvander(2 * (time - first) / span - 1, degree) * inside[:, None])
    return np.asarray(np.hstack(columns), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Solution:
    """Parameters, standard uncertainties, half intervals (k,), and the contribution of each component (k, c)."""

    value: Floats
    sigma: Floats
    half: Floats
    by_component: Floats


class Fit:
    """Weighted least squares of rows; every component has its own drift."""

    def __init__(self, rows: Rows, used: Bools | None = None) -> None:
        """Take the rows with their current weights, and the mask of those used; all by default."""
        self.rows, self.used = rows, np.ones(rows.engaged.size, dtype=np.bool_) if used is None else used
        self.weight = rows.weights[self.used]
        self.force = rows.force[self.used] * self.weight
        self.drift = []
        for weight in self.weight.T:
            table = rows.drift[self.used] * weight[:, None]
            self.drift.append(np.linalg.qr(table[:, np.linalg.norm(table, axis=0) > 0])[0])
        self.free_force = self.without_drift(self.force[:, :, None])[:, :, 0]

    def without_drift(self, columns: Floats) -> Floats:
        """Project the drift out of columns. (n, components, k)."""
        free = np.empty_like(columns)
        for component, basis in enumerate(self.drift):
            free[:, component] = columns[:, component] - basis @ (basis.T @ columns[:, component])
        return free

    def table(self, columns: Floats) -> Floats:
        """Return the weighted columns of the used rows without drift. (n, components, k)."""
        return self.without_drift(columns[self.used] * self.weight[:, :, None])

    def solve(self, columns: Floats) -> tuple[Floats, float, Floats]:
        """Return the parameters (k,), the sum of squares, and the residuals (n, components)."""
        table = self.table(columns)
        size = np.maximum(np.sqrt((table**2).sum(axis=(0, 1))), TINY)
        flat = (table / size).reshape(-1, size.size)
        # The columns of the brittle side may be collinear: regularise.
        normal = flat.T @ flat + 1e-11 * np.eye(size.size)
        answer = np.linalg.solve(normal, flat.T @ self.free_force.reshape(-1))
        residual = self.free_force - (flat @ answer).reshape(self.force.shape)
        return answer / size, float((residual**2).sum()), residual

    def estimate(self, columns: Floats, confidence: float, count: int | None = None) -> Solution:
        """Return the first ``count`` parameters with their uncertainties; all by default."""
        from scipy.stats import t  # noqa: PLC0415 - costly to import

        rows, components = self.rows, self.force.shape[1]
        first = columns.shape[2] if count is None else count
        table = self.table(columns)
        size = np.sqrt((table**2).sum(axis=(0, 1)))
        # Columns without effect, such as the speed of a pass without ductile rows, are excluded.
        effective = size > 1e-12 * size.max()
        effective[:first] = size[:first] > 0
        scaled = table[:, :, effective] / size[effective]
        flat = scaled.reshape(-1, scaled.shape[2])
        if flat.shape[0] <= flat.shape[1] or not effective[:first].all() or np.linalg.cond(flat) > MAX_CONDITION:
            raise InputError(
                f"the {flat.shape[0]} ductile forces do not determine the {effective.size} coefficients, edge forces "
                "and drift: measure more thin chips, vary thickness, depth or feed, or measure one more component"
            )
        inverse = np.linalg.inv(flat.T @ flat)
        answer = np.linalg.lstsq(flat, self.free_force.reshape(-1), rcond=None)[0]
        residual = self.free_force - (flat @ answer).reshape(self.force.shape)
        all_residuals = np.zeros(rows.force.shape)
        all_residuals[self.used] = residual
        tau = max(rows.correlation(all_residuals, self.used & side) for side in (rows.engaged, ~rows.engaged))
        n, drifts = self.force.shape[0], sum(basis.shape[1] for basis in self.drift)
        free = max(flat.shape[0] / tau - flat.shape[1] - drifts, 1.0)
        if rows.in_time and n > MIN_ROBUST_ROWS:
            # Heteroscedasticity-consistent covariance: the noise differs between cut and air, and components of a row
            # may be correlated.
            leverage = np.einsum("rp,pq,rq->r", scaled[:, 0], inverse, scaled[:, 0]) + (self.drift[0] ** 2).sum(axis=1)
            corrected = residual * np.sqrt(n / max(n - flat.shape[1] - drifts, 1))
            corrected = residual / (1 - np.minimum(leverage, 0.9))[:, None] if components == 1 else corrected
            score = np.einsum("rcp,rc->rp", scaled, corrected)
            covariance = tau * inverse @ (score.T @ score) @ inverse
        else:
            # Stated uncertainties are never reduced by a good fit.
            scale = float((residual**2).sum()) / free * tau
            covariance = (max(scale, 1.0) if rows.stated else scale) * inverse
        size = size[effective][:first]
        sigma = np.sqrt(np.diag(covariance))[:first] / size
        by = [inverse @ scaled[:, c].T @ self.free_force[:, c] for c in range(components)]
        # Effective degrees of freedom of the noise of each component (Welch and Satterthwaite).
        parts = np.stack([np.diag(inverse @ (part.T @ part) @ inverse)[:first] for part in scaled.transpose(1, 0, 2)])
        ratio = parts / parts.sum(axis=0)
        component_free = np.maximum(n / tau - drifts / components - flat.shape[1] * ratio, 1.0)
        freedom = np.full(first, free) if rows.stated else 1 / (ratio**2 / component_free).sum(axis=0)
        half = t.ppf(0.5 + confidence / 2, freedom) * sigma
        return Solution(answer[:first] / size, sigma, half, np.stack(by, axis=1)[:first] / size[:, None])


def interval(
    squares: Callable[[float], float], grid: Floats, profile: Floats, exact: float, *, every: bool = False
) -> tuple[float, float, Callable[[float, tuple[float, float], int], tuple[float, float]]]:
    """Minimise a sum of squares over a grid and between its nodes, and return its likelihood interval.

    Parameters
    ----------
    squares
        Sum of squares over the parameter.
    grid, profile
        Ascending parameter values, and the sum of squares there. Each (n,)
    exact
        Tolerance of the minimum.
    every
        Whether the interval extends to the outermost value within reach, or ends at the first one beyond it.

    Returns
    -------
    tuple
        Parameter at the minimum, sum of squares there, and a function for the interval. Its arguments are the allowed
        excess of the sum of squares, the ends to use if the grid does not bound the interval, and the number of
        bisections for each end.
    """
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - costly to import

    at = int(np.argmin(profile))
    around = (float(grid[max(at - 1, 0)]), float(grid[min(at + 1, grid.size - 1)]))
    finer = minimize_scalar(squares, bounds=around, method="bounded", options={"xatol": exact})
    least, best = min((float(profile[at]), float(grid[at])), (float(finer.fun), float(finer.x)))

    def within(reach: float, open_ends: tuple[float, float], halved: int) -> tuple[float, float]:
        ends = []
        for beyond, end in zip((grid[grid < best][::-1], grid[grid > best]), open_ends, strict=True):
            near = profile[np.searchsorted(grid, beyond)] - least <= reach
            count = int(np.flatnonzero(near).max(initial=-1)) + 1 if every else int(np.argmin([*near, False]))
            if count == beyond.size:
                ends.append(end)
                continue
            inside, outside = float(beyond[count - 1]) if count else best, float(beyond[count])
            for _ in range(halved):
                middle = (inside + outside) / 2
                inside, outside = (middle, outside) if squares(middle) - least <= reach else (inside, middle)
            ends.append(outside)
        return ends[0], ends[1]

    return best, least, within


def hansen(confidence: float) -> float:
    """Return the critical value of the likelihood ratio for the position of a jump."""
    return float(-2 * np.log(1 - np.sqrt(confidence)))
