"""Limits that every spiral and every sampled path keep, and the sample points of a preview."""

from __future__ import annotations

import math

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import InputError, LimitError

__all__ = ["REFINEMENT_RATIO", "TURN", "WIDEST_STEP", "check_count", "check_interval", "check_samples", "sample_turns"]

TURN = 2 * math.pi

MAX_POINTS = 300_000_000
"""Most points of a spiral. More are a wrong unit: no controller takes such a program, and no memory holds it."""

MAX_SAMPLES = 1 << 24
"""Most samples of a block of a path; a rougher path does not fit into memory."""

WIDEST_STEP = TURN / 12
"""Largest angle between two points, so that the direction of each move of C is unambiguous. [rad]"""

REFINEMENT_RATIO = 8
"""If more than one in this many intervals of a path needs refinement, the whole path is sampled more closely."""

MIN_INTERVAL_RAD = 1e-9
"""A path that needs shorter intervals has a jump. [rad]"""


def check_count(count: float, lengths: str) -> None:
    """Raise if a spiral has more points than any controller takes."""
    if count > MAX_POINTS:
        raise LimitError(
            f"the spiral has {count:.3g} points, the limit is {MAX_POINTS:.0e}: check the units of {lengths}"
        )


def check_samples(count: int, chord: float) -> None:
    """Raise if the samples of a rough path do not fit into memory."""
    if count > MAX_SAMPLES:
        raise LimitError(
            f"a block of the path takes {count:.3g} samples for a chord of {chord:g} mm, the limit is "
            f"{MAX_SAMPLES:.3g}: allow a larger chord, or plan with points_per_rev or arc_length"
        )


def check_interval(step: Floats, turned: Floats, chord: float) -> None:
    """Raise if intervals at some angles turned are so short that the path must jump there. Each (n,) [rad]."""
    if step.min() < MIN_INTERVAL_RAD:
        raise InputError(
            f"the path jumps {turned[np.argmin(step)] / TURN:.3f} revolutions from the inner end, so no points "
            f"meet the chord tolerance of {chord:g} mm: plan with points_per_rev or arc_length, or use a tool with a "
            "smaller included angle"
        )


def sample_turns(turned: float, turns: int, per_turn: int) -> Floats:
    """Return sample points of single revolutions, evenly over a cut, as revolutions from its first point. (n,)."""
    last_start = max(turned - 1, 0.0)
    first = np.round(np.linspace(0, last_start, max(min(turns, int(last_start) + 1), 1)))
    at = first[:, None] + np.arange(per_turn + 1) / per_turn
    return np.unique(np.append(at[at < turned], turned))
