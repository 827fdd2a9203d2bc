"""Saturated channels: an amplifier or converter stands at the end of its range while the force goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import robust_scatter
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright._arrays import Floats, Ints

__all__ = ["rail", "require_unsaturated", "saturated"]

MIN_RUN = 5
"""Neighbouring values that stand exactly at one end of a range before it counts as saturated."""

EXACT = 1e-9
"""Scatter over the force below which forces are exact but for rounding."""

MIN_LEVELS = 6
"""Different values below which a channel is too coarse to judge."""

LOOKED = 400
"""Numbers of values, of those that may stand at the end of a range, that are looked at."""

LEVEL = 1e-6
"""Chance below which noise like that of the other values would keep so many of them so close together."""

SOLID = 0.9
"""Share of the values from the first to the last at the end of a range that stand there, if that is the range."""

LONGER = 2
"""Times that values must stand at the end longer than anywhere else; forces without noise stand still everywhere."""


def saturated(values: Floats) -> Ints:
    """Return which values stand at the largest or the smallest of all because their channel is saturated. (k,).

    Noise parts neighbours: where some stand at an extreme, exactly and for longer than at any other value, that is the
    end of the range. A value of 0 is no such end.
    """
    borders = np.concatenate(([0], np.flatnonzero(np.diff(values)) + 1, [values.size]))
    length, level = np.diff(borders), values[borders[:-1]]
    for end in (values.max(initial=0.0), values.min(initial=0.0)):
        inside = level == end
        if end == 0 or inside.all() or not inside.any():
            continue
        longest = int(length[inside].max())
        if longest < MIN_RUN or longest <= LONGER * int(length[~inside].max()):
            continue
        if np.unique(level).size >= MIN_LEVELS:
            return np.flatnonzero(values == end)
    return np.zeros(0, dtype=np.int64)


def rail(load: Floats, values: Floats) -> Ints:
    """Return which averages stand at the end of the range of their channel while the load goes on. (k,).

    They are the largest of all, those of the largest loads, and closer together than the noise of the others lets them
    be: some k of n neighbours lie within w standard deviations by a chance of n k (w / sqrt(2 pi))^(k - 1) at most.
    Forces that stay the same beyond a transition keep their noise.
    """
    if values.size < 2 * MIN_RUN:
        return np.zeros(0, dtype=np.int64)
    from scipy.special import gammaln  # noqa: PLC0415 - costly to import

    order = np.argsort(load, kind="stable")
    load, forces = load[order], values[order] * (1.0 if np.median(values) >= 0 else -1.0)
    down = np.lexsort((-np.arange(forces.size), -forces))  # of equal ones the last comes first
    first, last = np.minimum.accumulate(down), np.maximum.accumulate(down)
    found, least = 0, np.log(LEVEL)
    for k in np.unique(np.geomspace(MIN_RUN, values.size - MIN_RUN, LOOKED).astype(np.int64)):
        span = int(last[k - 1] - first[k - 1]) + 1
        if k < SOLID * span or last[k - 1] < SOLID * values.size:
            continue
        noise = _noise(load, forces, int(first[k - 1]))
        if noise <= EXACT * abs(forces[down[0]]):
            continue
        near = max(forces[down[0]] - forces[down[k - 1]], _step(forces[: first[k - 1]]), EXACT * noise) / noise
        ways = gammaln(span + 1) - gammaln(k + 1) - gammaln(span - k + 1)
        chance = np.log(values.size * k) + ways + (k - 1) * np.log(near / np.sqrt(2 * np.pi))
        if chance < least:
            found, least = int(k), chance
    return np.sort(order[down[:found]])


def _step(values: Floats) -> float:
    """Return the step of the converter that values show, which repeat if it is coarse; else 0."""
    levels = np.unique(values)
    return float(np.diff(levels).min(initial=np.inf)) if levels.size < values.size else 0.0


def _noise(load: Floats, forces: Floats, before: int) -> float:
    """Return the scatter of forces about the lines between their neighbours, below some row."""
    load, forces = load[:before], forces[:before]
    if before < MIN_RUN + 1:
        return 0.0
    span = load[2:] - load[:-2]
    part = np.divide(load[1:-1] - load[:-2], span, out=np.full(span.size, 0.5), where=span > 0)
    off = forces[1:-1] - (1 - part) * forces[:-2] - part * forces[2:]
    off = np.abs(off) / np.sqrt(1 + part**2 + (1 - part) ** 2)
    return robust_scatter(off) or float(np.sqrt((off**2).mean()))


def require_unsaturated(label: str, channel: str, values: Floats, at: Ints, rate_hz: float) -> None:
    """Raise if samples of a channel of a record are saturated."""
    if at.size:
        raise InputError(
            f"{label} is saturated: {at.size} of {values.size} samples of channel {channel!r} stand at "
            f"{values[at[0]]:.6g} N, between {at[0] / rate_hz:.4g} and {at[-1] / rate_hz:.4g} s: record with a larger "
            "range, or leave that part out"
        )
