"""A transition without a drop: beyond the critical thickness the forces go on, but grow more slowly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright.cutting.learning.fit import CERTAIN, TINY, Fit, interval
from turnwright.cutting.learning.rows import FEWEST

if TYPE_CHECKING:
    from turnwright._arrays import Floats
    from turnwright.cutting.learning.straight import StraightRows

__all__ = ["COMPONENTS", "ROUNDING", "SlopeChange", "chance_of", "slope_change"]

COMPONENTS = 2
"""Cutting force and thrust."""

ROUNDING = 1e-18
"""Variance of exact forces, as a share of their mean square."""

MORE = 2
"""Columns that a transition adds: a force per width beyond it, and one that grows with the thickness."""

LOOKED = 60
"""Thicknesses at which a change of slope is looked for, before the best is found between them."""

HALVED = 16
"""Bisections for each end of its interval."""

STEEPEST = 0.7
"""Power of a size effect up to which it might explain bent forces as well; those of metals are 0.1 to 0.5."""

LEAST_NOISE = 0.5
"""Variance of the noisier side over that of all rows; where it is below, forces are exact but for rounding."""


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


def slope_change(rows: StraightRows, confidence: float) -> SlopeChange | None:
    """Find the thickness at which the forces change their slope; ``None`` where there are too few rows to look."""
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    low, high = float(ascending[FEWEST - 1]), float(ascending[-FEWEST])
    if ascending.size < 2 * FEWEST or not low < high * (1 - 1e-9):
        return None
    fits = [Fit(rows.part(component)) for component in range(COMPONENTS)]
    # Half of the places by the number of rows below, half evenly: cuts may stand together, or far apart.
    grid = np.unique(
        np.concatenate((np.linspace(low, high, LOOKED), np.quantile(ascending, np.linspace(0, 1, LOOKED))))
    )
    grid = grid[(grid >= low) & (grid <= high)]
    table = np.array([[_bent(rows, fits, c, one)[1] for c in range(COMPONENTS)] for one in grid])
    tiny = np.array([1e-14 * float((one.free_force**2).sum()) + TINY for one in fits])
    at = int(np.argmin((table / np.maximum(table.min(axis=0), tiny)).sum(axis=1)))
    variance = np.maximum(table[at], tiny) / rows.free

    def squares(limit: float) -> float:
        return float(sum(_bent(rows, fits, c, limit)[1] / variance[c] for c in range(COMPONENTS)))

    best, least, within = interval(squares, grid, (table / variance).sum(axis=1), 1e-6 * high)
    found = [_bent(rows, fits, c, best) for c in range(COMPONENTS)]
    left = np.column_stack([one[2] for one in found])
    noise = _noise(rows, left / np.sqrt(variance), best)
    reach = float(f.ppf(confidence, 1, max(rows.free / noise, 1.0))) * noise
    ends = within(reach, (0.0, float(ascending[-1])), HALVED)
    smooth = np.array([_smooth(rows, fits, c) for c in range(COMPONENTS)])
    better = float((smooth / variance).sum() - least) / noise
    answer = found[0][0]
    below = (rows.line(0, answer, best) - rows.line(0, answer, 0.99 * best)) / (0.01 * best)
    return SlopeChange(
        value=best,
        low=ends[0],
        high=ends[1],
        squares=np.array([one[1] for one in found]),
        chance=chance_of(rows, left, best),
        smooth=smooth,
        straight=rows.engaged.size * float(f.sf(better, 1, rows.free)) > CERTAIN,
        falls=bool(answer[-1] < below),
    )


def _bent(rows: StraightRows, fits: list[Fit], component: int, limit: float) -> tuple[Floats, float, Floats]:
    """Return the fit of a ductile line that goes on with another slope beyond a thickness."""
    beyond = rows.widths[:, component] * np.maximum(rows.thickest - limit, 0.0)
    return fits[component].solve(np.column_stack((rows.ductile(component, limit), beyond))[:, None])


def _smooth(rows: StraightRows, fits: list[Fit], component: int) -> float:
    """Return the least squares that an edge force, or a size effect, leaves of lines without a transition."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - costly to import

    if rows.power is not None:
        return np.inf
    whole = rows.ductile(component)
    chip = np.where(rows.engaged, rows.thickest / rows.reference, 1.0)

    def falling(power: float) -> float:
        return fits[component].solve(np.column_stack((whole[:, 0] * chip**-power, whole[:, 1:]))[:, None])[1]

    found = minimize_scalar(falling, bounds=(0.0, STEEPEST), method="bounded", options={"xatol": 1e-5})
    if rows.edge:
        return float(found.fun)
    columns = np.column_stack((whole, rows.widths[:, component]))
    (slope, edge), squares, _ = fits[component].solve(columns[:, None])
    # A cutting force that hardly grows at all is that of brittle chips, not of an edge.
    plausible = component > 0 or edge <= slope * rows.thickest.max()
    return min(float(found.fun), squares if plausible else np.inf)


def _noise(rows: StraightRows, left: Floats, limit: float) -> float:
    """Return the larger long-run variance of both sides, where components of a row may hang together."""
    found = []
    for side in (rows.thickest <= limit, rows.thickest > limit):
        inside = rows.engaged & side
        count = int(np.count_nonzero(inside))
        if count >= 2 * FEWEST:
            cover = left[inside].T @ left[inside] / (count - 1)
            found.append(rows.together(left, inside) * float(np.linalg.eigvalsh(cover).max()))
    return max([LEAST_NOISE, *found] if found else [float(COMPONENTS)])


def chance_of(rows: StraightRows, left: Floats, limit: float) -> float:
    """Return an upper limit of the share of experiments without a transition that show one as clear somewhere.

    Of one component and one split, straight lines with normal noise gain as F of 2 columns does. What lines that meet
    between two rows gain is at most what the split there gains, since they are lines on either side. So the chances of
    all splits of both components, added up, limit those of both kinds of transition, however the components hang
    together (Bonferroni). The noise is that of the cuts: of all, or of the side where it is larger.

    Parameters
    ----------
    rows
        All rows.
    left
        What lines with a transition leave. (n, 2)
    limit
        Where that is. [mm]
    """
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    ascending = np.sort(rows.thickest[rows.engaged])
    after = np.flatnonzero(np.diff(ascending) > 0) + 1
    places = np.count_nonzero((after >= FEWEST) & (after <= ascending.size - FEWEST))
    thin = rows.engaged & (rows.thickest <= limit)
    sides = [side for side in (thin, rows.engaged & ~thin) if np.count_nonzero(side) >= 2 * FEWEST]
    chances = []
    for component in range(COMPONENTS):
        part, rest = rows.part(component), left[:, [component]]
        one = Fit(part).solve(rows.ductile(component)[:, None])[1]
        free = max(ascending.size - rows.drift.shape[1] - rows.parts - MORE, 1)
        tau = max(part.together(rest, side) for side in sides or [rows.engaged])
        squares = rest[:, 0] ** 2
        noise = tau * max([squares[rows.engaged].sum() / free, *(squares[side].mean() for side in sides)])
        noise += ROUNDING * float(((part.force * part.weights) ** 2).mean()) + TINY
        gain = max(one - float(squares.sum()), 0.0) / noise / MORE
        chances.append(float(f.sf(gain, MORE, max(free / tau, 1.0))))
    return min(1.0, COMPONENTS * int(places) * min(chances))
