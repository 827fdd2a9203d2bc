"""Least squares of forces, drift and coefficients together, and what numbers are uncertain by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats
    from turnwright.cutting.learning.rows import Rows

__all__ = ["CERTAIN", "TINY", "UNLIKELY", "Fit", "Solved", "hansen", "interval"]

CERTAIN = 0.01
"""A transition is reported if chance would make one as clear in less than this share of experiments."""

UNLIKELY = 0.999
"""A departure from proportion is reported outside this interval."""

MANY = 50
"""Rows in time from which on each brings its own noise."""

ALIKE = 1e8
"""Condition of the columns beyond which they cannot be told apart."""

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True)
class Solved:
    """Numbers, standard uncertainties, half intervals, and how the numbers hang on each component. (k,), (k, c)."""

    value: Floats
    sigma: Floats
    half: Floats
    by_component: Floats


class Fit:
    """Weighted least squares of some rows, every component with a drift of its own."""

    def __init__(self, rows: Rows, used: Bools | None = None) -> None:
        """Take the rows, as they are weighed now, and those of them that are used; all if not given."""
        self.rows, self.used = rows, np.ones(rows.engaged.size, dtype=np.bool_) if used is None else used
        self.weight = rows.weights[self.used]
        self.force = rows.force[self.used] * self.weight
        self.drift = []
        for weight in self.weight.T:
            table = rows.drift[self.used] * weight[:, None]
            self.drift.append(np.linalg.qr(table[:, np.linalg.norm(table, axis=0) > 0])[0])
        self.free_force = self.without_drift(self.force[:, :, None])[:, :, 0]

    def without_drift(self, columns: Floats) -> Floats:
        """Take out of columns what the drift explains. (n, components, k)."""
        free = np.empty_like(columns)
        for component, basis in enumerate(self.drift):
            free[:, component] = columns[:, component] - basis @ (basis.T @ columns[:, component])
        return free

    def table(self, columns: Floats) -> Floats:
        """Return the columns of the rows that are used, weighted and without drift. (n, components, k)."""
        return self.without_drift(columns[self.used] * self.weight[:, :, None])

    def solve(self, columns: Floats) -> tuple[Floats, float, Floats]:
        """Return the parameters, the residual squares, and the residual of each row. (k,), (n, components)."""
        table = self.table(columns)
        size = np.maximum(np.sqrt((table**2).sum(axis=(0, 1))), TINY)
        flat = (table / size).reshape(-1, size.size)
        # Columns of the brittle side may be one; a touch of the diagonal decides.
        normal = flat.T @ flat + 1e-11 * np.eye(size.size)
        answer = np.linalg.solve(normal, flat.T @ self.free_force.reshape(-1))
        left = self.free_force - (flat @ answer).reshape(self.force.shape)
        return answer / size, float((left**2).sum()), left

    def estimate(self, columns: Floats, confidence: float, told: int | None = None) -> Solved:
        """Return the first parameters with their uncertainties, all of them if ``told`` is not given."""
        from scipy.stats import t  # noqa: PLC0415 - costly to import

        rows, components = self.rows, self.force.shape[1]
        told = columns.shape[2] if told is None else told
        table = self.table(columns)
        size = np.sqrt((table**2).sum(axis=(0, 1)))
        # What says nothing here, such as the speed of a pass without ductile rows, is left out.
        kept = size > 1e-12 * size.max()
        kept[:told] = size[:told] > 0
        scaled = table[:, :, kept] / size[kept]
        flat = scaled.reshape(-1, scaled.shape[2])
        if flat.shape[0] <= flat.shape[1] or not kept[:told].all() or np.linalg.cond(flat) > ALIKE:
            raise InputError(
                f"the {flat.shape[0]} ductile forces do not tell the {kept.size} coefficients from each other, edge "
                "force and drift: measure more thin chips, vary thickness, depth or feed, measure one more component, "
                "or drop these"
            )
        inverse = np.linalg.inv(flat.T @ flat)
        answer = np.linalg.lstsq(flat, self.free_force.reshape(-1), rcond=None)[0]
        left = self.free_force - (flat @ answer).reshape(self.force.shape)
        residual = np.zeros(rows.force.shape)
        residual[self.used] = left
        tau = max(rows.together(residual, self.used & side) for side in (rows.engaged, ~rows.engaged))
        count, drifts = self.force.shape[0], sum(basis.shape[1] for basis in self.drift)
        free = max(flat.shape[0] / tau - flat.shape[1] - drifts, 1.0)
        if rows.in_time and count > MANY:
            # Noise in the cut and in air differ and components of a row may hang together: each row brings its own.
            leverage = np.einsum("rp,pq,rq->r", scaled[:, 0], inverse, scaled[:, 0]) + (self.drift[0] ** 2).sum(axis=1)
            own = left * np.sqrt(count / max(count - flat.shape[1] - drifts, 1))
            own = left / (1 - np.minimum(leverage, 0.9))[:, None] if components == 1 else own
            each = np.einsum("rcp,rc->rp", scaled, own)
            cover = tau * inverse @ (each.T @ each) @ inverse
        else:
            # Stated uncertainties are not made smaller by a lucky fit.
            scale = float((left**2).sum()) / free * tau
            cover = (max(scale, 1.0) if rows.stated else scale) * inverse
        size = size[kept][:told]
        sigma = np.sqrt(np.diag(cover))[:told] / size
        by = [inverse @ scaled[:, c].T @ self.free_force[:, c] for c in range(components)]
        # Few rows know the noise of each component only so well (Welch and Satterthwaite).
        parts = np.stack([np.diag(inverse @ (one.T @ one) @ inverse)[:told] for one in scaled.transpose(1, 0, 2)])
        ratio = parts / parts.sum(axis=0)
        each_free = np.maximum(count / tau - drifts / components - flat.shape[1] * ratio, 1.0)
        freedom = np.full(told, free) if rows.stated else 1 / (ratio**2 / each_free).sum(axis=0)
        half = t.ppf(0.5 + confidence / 2, freedom) * sigma
        return Solved(answer[:told] / size, sigma, half, np.stack(by, axis=1)[:told] / size[:, None])


def interval(
    squares: Callable[[float], float], grid: Floats, profile: Floats, exact: float, *, every: bool = False
) -> tuple[float, float, Callable[[float, tuple[float, float], int], tuple[float, float]]]:
    """Find the least of squares between the places of a grid, and what gives the interval about it.

    Parameters
    ----------
    squares
        What is left at some place.
    grid, profile
        Places that ascend and what is left there. Each (n,)
    exact
        Error that the place may have.
    every
        Whether the interval holds every place that leaves little enough, or ends at the first that leaves more.

    Returns
    -------
    tuple
        The place, what is left there, and a function that returns the interval. It takes by how much more may be left,
        the ends where the grid does not close it, and the number of bisections for each end.
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
            held = int(np.flatnonzero(near).max(initial=-1)) + 1 if every else int(np.argmin([*near, False]))
            if held == beyond.size:
                ends.append(end)
                continue
            inside, outside = float(beyond[held - 1]) if held else best, float(beyond[held])
            for _ in range(halved):
                middle = (inside + outside) / 2
                inside, outside = (middle, outside) if squares(middle) - least <= reach else (inside, middle)
            ends.append(outside)
        return ends[0], ends[1]

    return best, least, within


def hansen(confidence: float) -> float:
    """Return the limit of the likelihood ratio of the place of a jump."""
    return float(-2 * np.log(1 - np.sqrt(confidence)))
