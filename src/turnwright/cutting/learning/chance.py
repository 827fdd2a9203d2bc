"""How often forces without a transition would show one as clear."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from turnwright._arrays import Floats, Ints
    from turnwright.cutting.learning.material_fit import _Rows

__all__ = ["chance_of"]

COMPONENTS = 2

FEWEST = 4
"""Rows that a part of the forces must have on either side."""

MORE = 2
"""Columns that a split adds: a force per width beyond it, and one that grows with the thickness."""

ROUNDING = 1e-18
"""Variance of exact forces, as a share of their mean square."""


def chance_of(rows: _Rows, whole: Sequence[float], left: Sequence[Floats] | Floats, thin: Ints) -> float:
    """Return an upper limit of the share of experiments without a transition that show one as clear somewhere.

    Of one component and one split, straight lines with normal noise gain as F of 2 columns does. What lines that meet
    between two rows gain is at most what the split there gains, since they are lines on either side. So the chances of
    all splits of both components, added up, limit those of both kinds of transition, however the components hang
    together (Bonferroni). The noise is that of the cuts: of all, or of the side where it is larger.

    Parameters
    ----------
    rows
        All rows.
    whole
        Squares that lines without a transition leave of each component. (2,)
    left
        What those with one leave. (2, n)
    thin
        Rows that are cuts below it.
    """
    from scipy.stats import f  # noqa: PLC0415 - costly to import

    engaged = np.flatnonzero(rows.engaged)
    ascending = np.sort(rows.thickness[engaged])
    after = np.flatnonzero(np.diff(ascending) > 0) + 1
    places = np.count_nonzero((after >= FEWEST) & (after <= ascending.size - FEWEST))
    below = np.zeros(rows.thickness.size, dtype=np.bool_)
    below[thin] = True
    sides = [side for side in (below, rows.engaged & ~below) if np.count_nonzero(side) >= 2 * FEWEST]
    chances = []
    for component, (one, rest) in enumerate(zip(whole, left, strict=True)):
        columns = rows.nuisance.shape[1] + rows.ductile_columns(component).shape[1] + MORE
        free = max(engaged.size - columns, 1)
        tau = max([rows.tau(rest, side) for side in sides] or [rows.tau(rest, rows.engaged)])
        squares = rest**2
        noise = max([squares[engaged].sum() / free, *(squares[side].sum() / np.count_nonzero(side) for side in sides)])
        force = rows.forces[component] * rows.weights[component]
        noise = tau * noise + ROUNDING * float((force**2).mean()) + np.finfo(np.float64).tiny
        gain = max(one - float(squares.sum()), 0.0) / noise / MORE
        chances.append(float(f.sf(gain, MORE, max(free / tau, 1.0))))
    return min(1.0, COMPONENTS * int(places) * min(chances))
