"""Transition without a drop: beyond the critical thickness the forces grow more slowly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright.cutting.learning.fit import MAX_CHANCE, TINY, Fit, interval
from turnwright.cutting.learning.rows import MIN_ROWS
from turnwright.cutting.learning.uniform_rows import COMPONENTS

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.cutting.learning.uniform_rows import UniformRows

__all__ = ["ROUNDING_VARIANCE", "SlopeChange", "bound_chance", "find_slope_change"]

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


@dataclass(frozen=True, slots=True)
class SlopeChange:
    """Slope discontinuity of the forces over the chip thickness.

    Parameters
    ----------
    value, low, high
        Thickness of the discontinuity, and its interval. [mm]
    squares
        Residual sum of squares of each component. (2,)
    chance
        Upper bound of the probability that forces without a discontinuity show one as clear.
    smooth
        Residual sum of squares of each component with an edge force or a size effect instead. (2,)
    straight
        Whether an edge force or a size effect fits as well.
    falls
        Whether the cutting force grows more slowly beyond.
    """

    value: float
    low: float
    high: float
    squares: Floats
    chance: float
    smooth: Floats
    straight: bool
    falls: bool


def find_slope_change(rows: UniformRows, confidence: float) -> SlopeChange | None:
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
    return SlopeChange(
        value=best,
        low=ends[0],
        high=ends[1],
        squares=np.array([solution[1] for solution in solutions]),
        chance=bound_chance(rows, residual, best),
        smooth=smooth,
        straight=rows.engaged.size * float(f.sf(gain, 1, rows.free)) > MAX_CHANCE,
        falls=bool(answer[-1] < below),
    )


def _fit_bent(rows: UniformRows, fits: list[Fit], component: int, limit: float) -> tuple[Floats, float, Floats]:
    """Return the fit of a ductile line with a different slope beyond a thickness."""
    beyond = rows.widths[:, component] * np.maximum(rows.thickest - limit, 0.0)
    return fits[component].solve(np.column_stack((rows.ductile(component, limit), beyond))[:, None])


def _fit_smooth(rows: UniformRows, fits: list[Fit], component: int) -> float:
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


def _largest_variance(rows: UniformRows, residual: Floats, limit: float) -> float:
    """Return the larger long-run variance of both sides; the components of a row may be correlated."""
    variances = []
    for side in (rows.thickest <= limit, rows.thickest > limit):
        inside = rows.engaged & side
        count = int(np.count_nonzero(inside))
        if count >= 2 * MIN_ROWS:
            covariance = residual[inside].T @ residual[inside] / (count - 1)
            variances.append(rows.correlation(residual, inside) * float(np.linalg.eigvalsh(covariance).max()))
    return max([MIN_NOISE, *variances] if variances else [float(COMPONENTS)])


def bound_chance(rows: UniformRows, residual: Floats, limit: float) -> float:
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
