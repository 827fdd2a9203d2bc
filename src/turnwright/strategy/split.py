r"""The smoothest motion of a slow slide that keeps a fast tool within its limits.

With h(t) the height of both together over the angle t turned, in radians, the slow part Z is the spline that solves

.. math:: \min_Z \int (Z''')^2 + (Z - h)^2 \, dt \quad \text{so that} \quad
    \mathrm{low} \le h - Z \le \mathrm{high}, \;
    \omega\,|h' - Z'| \le \mathrm{speed}, \; \omega^2\,|h'' - Z''| \le \mathrm{acceleration}

This is a strictly convex quadratic program in the coefficients of a cubic spline over even cells. Its matrices have
three lower diagonals besides the main one, so a step of the interior-point method takes linear time.

Sources
-------
Predictor and corrector: Mehrotra's method, [Nocedal2006]_ ch. 16.6. Reference solution of the tests: SciPy's SLSQP.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright._kernels import split as kernel
from turnwright.errors import LimitError
from turnwright.machine import Axis
from turnwright.strategy.sampling import TURN

__all__ = ["find_smoothest"]

CELLS_PER_REV = (64, 256)
"""Cells of the spline per revolution; the second number is used only if the first cannot keep the limits."""

TRAVEL_MARGIN = 1e-3
"""Fraction of the stroke that is reserved at each end for the samples between those in the program."""

RATE_MARGIN = 1e-2
"""The same for speed and acceleration, whose peaks are measured as divided differences."""

MAX_STEPS = 80
"""Most steps of the interior-point method. 20 to 30 are usual; it does not converge if the limits cannot be kept."""

COST_TOL = 1e-6
"""Relative tolerance of the cost."""

MAX_ROUNDS = 8
"""Most rounds in which samples outside the limits are added to the program; one or two are usual."""


class _Limit(NamedTuple):
    """One limited quantity, over all samples."""

    order: int  # of the derivative
    at: Floats  # (n,) [rad]
    value: Floats  # of slide and tool together [mm/rad^order]
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class _Rows:
    """Inequalities low <= row . c <= high on four neighbouring coefficients each, scaled to a width of 2."""

    first: Ints
    row: Floats
    low: Floats
    high: Floats

    def of(self, c: Floats) -> Floats:
        """Return every row times the coefficients."""
        total: Floats = np.einsum("ia,ia->i", self.row, c[self.first[:, None] + np.arange(4)])
        return total

    def back(self, weight: Floats, size: int) -> Floats:
        """Return the sum of the weighted rows."""
        total = np.zeros(size)
        for a in range(4):
            total += np.bincount(self.first + a, self.row[:, a] * weight, size)
        return total

    def gram(self, weight: Floats, size: int) -> Floats:
        """Return the sum of the weighted products of the rows, as lower diagonals."""
        band = np.zeros((4, size))
        for a in range(4):
            for b in range(a + 1):
                band[a - b] += np.bincount(self.first + b, self.row[:, a] * self.row[:, b] * weight, size)
        return band


def find_smoothest(turned: Floats, height: Floats, fast: Axis, omega: float | None) -> tuple[Floats, Floats]:
    """Return the height of the slow slide [mm], and its derivative by the angle turned. Each (n,).

    ``turned`` ascends from 0 (n,) [rad]; ``height`` is that of slide and tool together (n,) [mm]. Without the spindle
    speed ``omega`` [rad/s] only the travel of the fast tool is limited.

    Raises
    ------
    LimitError
        If no motion of the slide keeps the limits.
    """
    low, high = float(fast.low), float(fast.high)  # type: ignore[arg-type]
    kinds = [_Limit(0, turned, height, low, high)]
    slope = np.diff(height) / np.diff(turned)
    if omega is not None and fast.speed is not None:
        most = fast.speed / omega
        kinds.append(_Limit(1, (turned[1:] + turned[:-1]) / 2, slope, -most, most))
    if omega is not None and fast.acceleration is not None:
        most = fast.acceleration / omega**2
        bend = 2 * np.diff(slope) / (turned[2:] - turned[:-2])
        kinds.append(_Limit(2, turned[1:-1], bend, -most, most))
    for per_turn in CELLS_PER_REV:
        step = TURN / per_turn
        cells = max(math.ceil(turned[-1] / step * (1 - 1e-12)), 1)
        c = _find_coefficients(kinds, step, cells)
        if c is not None:
            z, rate = np.empty(turned.size), np.empty(turned.size)
            kernel.values(turned, step, cells, 0, c, z)
            kernel.values(turned, step, cells, 1, c, rate)
            return z, rate
    limits = [f"{(high - low) * 1e3:.4g} um of travel"]
    for kind in kinds[1:]:
        unit = "mm/s" if kind.order == 1 else "mm/s^2"
        required = float(np.abs(kind.value).max()) * float(omega or 0.0) ** kind.order
        limits.append(f"{kind.high * float(omega or 0.0) ** kind.order:.4g} {unit} (the path has {required:.4g})")
    raise LimitError(
        f"no motion of the slow slide with {CELLS_PER_REV[-1]} cells a revolution keeps the fast tool within "
        f"{' and '.join(limits)}: use a lower spindle speed or a fast tool with larger limits, or split the motion "
        "by a base"
    )


def _find_coefficients(kinds: list[_Limit], step: float, cells: int) -> Floats | None:
    _, turned, height, low, high = kinds[0]
    size = cells + 3
    weight = np.gradient(turned)
    band, right = np.zeros((4, size)), np.zeros(size)
    # All heights are in units of half the stroke, about the mean height.
    unit, level = (high - low) / 2, float(height.mean())
    kernel.gram(turned, (height - (high + low) / 2 - level) / unit, weight, step, cells, band, right)
    jerk = np.array([1.0, -3.0, 3.0, -1.0])
    for a in range(4):
        for b in range(a + 1):
            band[a - b, b : b + cells] += jerk[a] * jerk[b] / step**5
    scale = float(band[0].max())
    band, right = band / scale, right / scale
    seen: list[list[Ints]] = [[] for _ in kinds]
    c = _solve_banded(band, right)
    for _ in range(MAX_ROUNDS):
        fresh = False
        for number, kind in enumerate(kinds):
            share = np.empty(kind.at.size)
            kernel.values(kind.at, step, cells, kind.order, c, share)
            share = kind.value - unit * share - (level if kind.order == 0 else 0.0)
            beyond = np.maximum(share - kind.high, kind.low - share) > 0
            if not beyond.any():
                continue
            fresh = True
            ends = np.empty((2, cells), dtype=np.int64)
            kernel.extremes(kind.at, step, cells, kind.value if not seen[number] else share, *ends)
            samples = np.unique(ends[ends >= 0])
            seen[number].append(samples if not seen[number] else samples[beyond[samples]])
        if not fresh:
            return unit * c + level
        solved = _solve_interior_point(band, right, _set_up_limits(kinds, seen, step, cells, unit, level), c)
        if solved is None:
            return None
        c = solved
    return None


def _set_up_limits(
    kinds: list[_Limit], seen: list[list[Ints]], step: float, cells: int, unit: float, level: float
) -> _Rows:
    parts: list[tuple[Ints, Floats, Floats, Floats]] = []
    for kind, chosen in zip(kinds, seen, strict=True):
        if not chosen:
            continue
        index = np.unique(np.concatenate(chosen))
        first, row = np.empty(index.size, dtype=np.int64), np.empty((index.size, 4))
        kernel.rows(kind.at[index], step, cells, kind.order, first, row)
        half, middle = (kind.high - kind.low) / 2, (kind.high + kind.low) / 2
        value = kind.value[index] - middle - (level if kind.order == 0 else 0.0)
        spare = 1 - (TRAVEL_MARGIN if kind.order == 0 else RATE_MARGIN)
        parts.append((first, row * (unit / half), value / half - spare, value / half + spare))
    first, row, low, high = (np.concatenate(part) for part in zip(*parts, strict=True))
    return _Rows(first, row, low, high)


def _solve_banded(band: Floats, right: Floats) -> Floats:
    from scipy.linalg import solveh_banded  # noqa: PLC0415 - costly to import

    solved: Floats = solveh_banded(band, right, lower=True, check_finite=False)
    return solved


def _multiply_banded(band: Floats, c: Floats) -> Floats:
    """Return the product of a vector and a symmetric matrix in lower diagonals."""
    out: Floats = band[0] * c
    for k in range(1, 4):
        out[k:] += band[k, :-k] * c[:-k]
        out[:-k] += band[k, :-k] * c[k:]
    return out


def _solve_interior_point(band: Floats, right: Floats, rows: _Rows, c: Floats) -> Floats | None:
    """Return the c that minimises c.Bc/2 - right.c within the rows, or ``None`` if there is none."""
    size = c.size
    across = rows.of(c)
    # Slack to both limits and their multipliers; a start outside the limits moves inside step by step.
    room = np.maximum(np.stack([across - rows.low, rows.high - across]), 0.1)
    force = np.full_like(room, 0.1 * max(float(np.abs(right).max()), 1e-12))
    for _ in range(MAX_STEPS):
        across = rows.of(c)
        missed = np.stack([across - rows.low, rows.high - across]) - room
        stress = _multiply_banded(band, c)
        pull = right - stress + rows.back(force[0] - force[1], size)
        gap = float((room * force).mean())
        # The sum of slack times multiplier bounds the difference from the least cost.
        if np.abs(missed).max() < 1e-7 and gap * room.size <= COST_TOL * max(float(c @ stress), abs(float(c @ right))):
            return c
        stiff = force / room
        matrix = band + rows.gram(stiff[0] + stiff[1], size)

        def step(target: Floats) -> tuple[Floats, Floats, Floats]:
            push = (target - force * missed) / room  # noqa: B023 - called within this iteration
            move = _solve_banded(matrix, pull + rows.back(push[0] - push[1], size))  # noqa: B023
            along = rows.of(move)
            grown = np.stack([along, -along]) + missed  # noqa: B023
            return move, grown, (target - force * grown) / room  # noqa: B023

        try:
            _, grown, pressed = step(-room * force)
            reach = min(_limit_step(room, grown), _limit_step(force, pressed))
            after = float(((room + reach * grown) * (force + reach * pressed)).mean())
            target = (after / gap) ** 3 * gap - room * force - grown * pressed
            move, grown, pressed = step(target)
        except np.linalg.LinAlgError:
            return None
        ahead, press = 0.995 * _limit_step(room, grown), 0.995 * _limit_step(force, pressed)
        ahead = press = min(ahead, press, 1.0)
        c, room, force = c + ahead * move, room + ahead * grown, force + press * pressed
        if not np.isfinite(c).all():
            return None
    return None


def _limit_step(value: Floats, change: Floats) -> float:
    """Return the largest fraction of a change for which positive values stay positive, at most 1.01."""
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(change < 0, -value / change, np.inf)
    return min(float(shares.min()), 1.01)
