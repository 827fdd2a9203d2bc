"""Saturated channels: an amplifier or converter stands at the end of its range while the force goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright._arrays import Floats, Ints

__all__ = ["require_unsaturated", "saturated"]

MIN_RUN = 5
"""Neighbouring values that stand exactly at one end of a range before it counts as saturated."""

MIN_LEVELS = 6
"""Different values below which a channel is too coarse to judge."""

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


def require_unsaturated(label: str, channel: str, values: Floats, at: Ints, rate_hz: float) -> None:
    """Raise if samples of a channel of a record are saturated."""
    if at.size:
        raise InputError(
            f"{label} is saturated: {at.size} of {values.size} samples of channel {channel!r} stand at "
            f"{values[at[0]]:.6g} N, between {at[0] / rate_hz:.4g} and {at[-1] / rate_hz:.4g} s: record with a larger "
            "range, or leave that part out"
        )
