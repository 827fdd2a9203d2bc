"""Detection of saturated channels: an amplifier or converter at the end of its measuring range."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import robust_scatter
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright._arrays import Floats, Ints

__all__ = ["find_clipped", "find_saturated", "require_unsaturated"]

MIN_RUN = 5
"""Length of a run of equal extreme values that counts as saturated."""

NOISELESS_TOL = 1e-9
"""Scatter over force below which forces have no noise except rounding."""

MIN_LEVELS = 6
"""Number of different values that a channel needs to be judged."""

TRIAL_COUNTS = 400
"""Number of trial sizes of a saturated group."""

SIGNIFICANCE = 1e-6
"""Probability below which a group of close extreme values is not explained by noise."""

MIN_FILL = 0.9
"""Fraction of the values between the first and the last saturated one that must be saturated."""

MIN_RUN_RATIO = 2
"""Ratio of the longest run at the extreme to the longest elsewhere; forces without noise have long runs everywhere."""


def find_saturated(values: Floats) -> Ints:
    """Return the indices of saturated values: long runs of exactly the largest or the smallest value. (k,).

    Noise makes neighbours differ, so a run at an extreme that is longer than any other run is the end of the range.
    The value 0 is not taken as an end.
    """
    borders = np.concatenate(([0], np.flatnonzero(np.diff(values)) + 1, [values.size]))
    length, level = np.diff(borders), values[borders[:-1]]
    for end in (values.max(initial=0.0), values.min(initial=0.0)):
        inside = level == end
        if end == 0 or inside.all() or not inside.any():
            continue
        longest = int(length[inside].max())
        if longest < MIN_RUN or longest <= MIN_RUN_RATIO * int(length[~inside].max()):
            continue
        if np.unique(level).size >= MIN_LEVELS:
            return np.flatnonzero(values == end)
    return np.zeros(0, dtype=np.int64)


def find_clipped(load: Floats, values: Floats) -> Ints:
    """Return the indices of averages at the end of the measuring range while the load still increases. (k,).

    They are the largest averages, have the largest loads, and are closer together than noise allows: the probability
    that k of n values lie within w standard deviations is at most n k (w / sqrt(2 pi))^(k - 1). Forces that are
    constant beyond a transition keep their noise and are not taken.
    """
    if values.size < 2 * MIN_RUN:
        return np.zeros(0, dtype=np.int64)
    from scipy.special import gammaln  # noqa: PLC0415 - costly to import

    order = np.argsort(load, kind="stable")
    load, forces = load[order], values[order] * (1.0 if np.median(values) >= 0 else -1.0)
    down = np.lexsort((-np.arange(forces.size), -forces))  # of equal values the last comes first
    first, last = np.minimum.accumulate(down), np.maximum.accumulate(down)
    count, least = 0, np.log(SIGNIFICANCE)
    for k in np.unique(np.geomspace(MIN_RUN, values.size - MIN_RUN, TRIAL_COUNTS).astype(np.int64)):
        span = int(last[k - 1] - first[k - 1]) + 1
        if k < MIN_FILL * span or last[k - 1] < MIN_FILL * values.size:
            continue
        noise = _noise(load, forces, int(first[k - 1]))
        if noise <= NOISELESS_TOL * abs(forces[down[0]]):
            continue
        near = max(forces[down[0]] - forces[down[k - 1]], _step(forces[: first[k - 1]]), NOISELESS_TOL * noise) / noise
        ways = gammaln(span + 1) - gammaln(k + 1) - gammaln(span - k + 1)
        chance = np.log(values.size * k) + ways + (k - 1) * np.log(near / np.sqrt(2 * np.pi))
        if chance < least:
            count, least = int(k), chance
    return np.sort(order[down[:count]])


def _step(values: Floats) -> float:
    """Return the quantisation step if values repeat, else 0."""
    levels = np.unique(values)
    return float(np.diff(levels).min(initial=np.inf)) if levels.size < values.size else 0.0


def _noise(load: Floats, forces: Floats, before: int) -> float:
    """Return the scatter of forces about linear interpolation of their neighbours, before a row."""
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
            f"{label} is saturated: {at.size} of {values.size} samples of channel {channel!r} are at "
            f"{values[at[0]]:.6g} N, between {at[0] / rate_hz:.4g} and {at[-1] / rate_hz:.4g} s: record with a larger "
            "range, or remove that part"
        )
