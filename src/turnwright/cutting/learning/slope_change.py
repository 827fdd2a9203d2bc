"""A transition without a drop: beyond the critical thickness the forces go on, but grow more slowly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright.cutting.learning.chance import chance_of

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.cutting.learning.material_fit import _Rows

__all__ = ["SlopeChange", "slope_change"]

COMPONENTS = 2

LOOKED = 60
"""Thicknesses at which a change of slope is looked for, before the best is found between them."""

HALVED = 16
"""Bisections for each end of an interval."""

STEEPEST = 0.7
"""Power of a size effect up to which it might explain bent forces as well; those of metals are 0.1 to 0.5."""

CERTAIN = 0.01
"""A change of slope needs that chance explains forces as well in less than this share of experiments."""

LEAST_NOISE = 0.5
"""Variance of the noisier side over that of all rows; where it is below, forces are exact but for rounding."""

FEWEST = 4
"""Rows that a part of the forces must have on either side."""


@dataclass(frozen=True, slots=True)
class SlopeChange:
    """Where the forces bend, and how clearly.

    Parameters
    ----------
    value, low, high
        Thickness at which they do, and its interval. [mm]
    squares
        What the bent lines leave, for each component. (2,)
    chance
        At most this share of experiments with straight lines would show one as clear.
    smooth
        What an edge force, or a size effect, leaves of each component without a transition. (2,)
    straight
        Whether these fit as well.
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


class _Model:
    """The squares that are left by columns, drift and noise weights taken into account."""

    def __init__(self, rows: _Rows) -> None:
        self.rows = rows
        self.base, self.force = [], []
        for component in range(COMPONENTS):
            weight = rows.weights[component]
            nuisance = rows.nuisance * weight[:, None]
            basis = np.linalg.qr(nuisance)[0] if nuisance.shape[1] else nuisance
            force = rows.forces[component] * weight
            self.base.append(basis)
            self.force.append(force - basis @ (basis.T @ force))

    def fit(self, component: int, columns: Floats) -> tuple[float, Floats, Floats]:
        """Return the squares left, the residuals and the factors of columns. (n,), (k,)."""
        basis, force = self.base[component], self.force[component]
        table = columns * self.rows.weights[component][:, None]
        table = table - basis @ (basis.T @ table)
        size = np.maximum(np.linalg.norm(table, axis=0), np.finfo(np.float64).tiny)
        table = table / size
        answer = np.linalg.lstsq(table.T @ table, table.T @ force, rcond=1e-13)[0]
        left = force - table @ answer
        return float(left @ left), left, answer / size

    def bent(self, component: int, limit: float) -> Floats:
        """Return the columns of a ductile line that goes on with another slope beyond a thickness."""
        rows = self.rows
        beyond = rows.per_thickness(component) * np.maximum(rows.thickness - limit, 0.0)
        return np.column_stack((rows.ductile_columns(component, limit), beyond))

    def smooth(self, component: int) -> float:
        """Return the least squares that an edge force, or a size effect, leaves of lines without a transition."""
        from scipy.optimize import minimize_scalar  # noqa: PLC0415 - costly to import

        rows = self.rows
        if rows.power is not None:
            return np.inf
        whole = rows.ductile_columns(component)
        chip = np.where(rows.engaged, rows.thickness / rows.reference, 1.0)

        def falling(power: float) -> float:
            return self.fit(component, np.column_stack((whole[:, 0] * chip**-power, whole[:, 1:])))[0]

        found = minimize_scalar(falling, bounds=(0.0, STEEPEST), method="bounded", options={"xatol": 1e-5})
        if rows.edge:
            return float(found.fun)
        squares, _, (slope, edge) = self.fit(component, np.column_stack((whole, rows.per_thickness(component))))
        # A cutting force that hardly grows at all is that of brittle chips, not of an edge.
        plausible = component > 0 or edge <= slope * rows.thickness.max()
        return min(float(found.fun), squares if plausible else np.inf)


def slope_change(rows: _Rows, confidence: float) -> SlopeChange | None:
    """Find the thickness at which the forces change their slope; ``None`` where there are too few rows to look."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - costly to import
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickness[rows.engaged])
    low, high = float(ascending[FEWEST - 1]), float(ascending[-FEWEST])
    if ascending.size < 2 * FEWEST or not low < high * (1 - 1e-9):
        return None
    model = _Model(rows)
    # Half of the places by the number of rows below, half evenly: cuts may stand together, or far apart.
    grid = np.unique(
        np.concatenate((np.linspace(low, high, LOOKED), np.quantile(ascending, np.linspace(0, 1, LOOKED))))
    )
    grid = grid[(grid >= low) & (grid <= high)]
    table = np.array([[model.fit(c, model.bent(c, one))[0] for c in range(COMPONENTS)] for one in grid])
    n = rows.thickness.size
    free = max(n - rows.nuisance.shape[1] - 3, 1)
    tiny = np.array([1e-14 * float(force @ force) + np.finfo(np.float64).tiny for force in model.force])
    variance = np.maximum(table[int(np.argmin((table / np.maximum(table.min(axis=0), tiny)).sum(axis=1)))], tiny) / free

    def squares(limit: float) -> float:
        return float(sum(model.fit(c, model.bent(c, limit))[0] / variance[c] for c in range(COMPONENTS)))

    profile = (table / variance).sum(axis=1)
    at = int(np.argmin(profile))
    around = (float(grid[max(at - 1, 0)]), float(grid[min(at + 1, grid.size - 1)]))
    finer = minimize_scalar(squares, bounds=around, method="bounded", options={"xatol": 1e-6 * high})
    best, least = (
        (float(finer.x), float(finer.fun)) if finer.fun < profile[at] else (float(grid[at]), float(profile[at]))
    )
    fits = [model.fit(c, model.bent(c, best)) for c in range(COMPONENTS)]
    noise = _noise(rows, np.array([left for _, left, _ in fits]) / np.sqrt(variance)[:, None], best)
    reach = float(f.ppf(confidence, 1, max(free / noise, 1.0))) * noise
    ends = []
    for step in (-1, 1):
        beyond = np.flatnonzero(grid < best)[::-1] if step < 0 else np.flatnonzero(grid > best)
        outer = beyond[profile[beyond] - least > reach]
        if not outer.size:
            ends.append(0.0 if step < 0 else float(ascending[-1]))
            continue
        first = int(outer[0])
        outside, inner = float(grid[first]), float(grid[first - step]) if 0 <= first - step < grid.size else best
        inside = inner if step * (inner - best) > 0 else best
        for _ in range(HALVED):
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if squares(middle) - least <= reach else (inside, middle)
        ends.append(outside)
    whole = [model.fit(c, rows.ductile_columns(c))[0] for c in range(COMPONENTS)]
    thin = rows.thickness <= best
    smooth = np.array([model.smooth(c) for c in range(COMPONENTS)])
    better = float((smooth / variance).sum() - least) / noise
    answer = fits[0][2]
    below = (rows.line(0, answer[:-1], best) - rows.line(0, answer[:-1], 0.99 * best)) / (0.01 * best)
    return SlopeChange(
        value=best,
        low=ends[0],
        high=ends[1],
        squares=np.array([one for one, _, _ in fits]),
        chance=chance_of(rows, whole, [left for _, left, _ in fits], np.flatnonzero(rows.engaged & thin)),
        smooth=smooth,
        straight=n * float(f.sf(better, 1, free)) > CERTAIN,
        falls=bool(answer[-1] < below),
    )


def _noise(rows: _Rows, left: Floats, limit: float) -> float:
    """Return the larger long-run variance of both sides, where components of a row may hang together."""
    found = []
    for side in (rows.thickness <= limit, rows.thickness > limit):
        inside = rows.engaged & side
        count = int(np.count_nonzero(inside))
        if count >= 2 * FEWEST:
            tau = max(rows.tau(one, inside) for one in left)
            found.append(tau * float(np.linalg.eigvalsh(left[:, inside] @ left[:, inside].T / (count - 1)).max()))
    return max([LEAST_NOISE, *found] if found else [float(COMPONENTS)])
