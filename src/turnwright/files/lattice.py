"""Detection of rectangular grids in lists of points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.files.base import MAX_POINTS

__all__ = ["Lattice", "even_places", "on_lattice"]

MAX_NODES_PER_POINT = 20
"""Nodes of a grid per point."""

MAX_OFFSET_STEPS = 0.05
"""Offset of a point from its node due to rounded decimals, in steps."""

MIN_FILLED_FRACTION = 0.5
"""Fraction of nodes with a point for uneven steps to be a grid."""


class Lattice(NamedTuple):
    """A grid, and the row and column of each point."""

    x: Floats
    y: Floats
    column: Ints
    row: Ints


def on_lattice(x: Floats, y: Floats) -> Lattice | None:
    """Return the grid of the points; ``None`` if there is none or two points share a node."""
    across, along = _steps(x), _steps(y)
    size = across[0].size * along[0].size
    if size > min(MAX_POINTS, MAX_NODES_PER_POINT * x.size) or (
        not (across[2] and along[2]) and MIN_FILLED_FRACTION * size > x.size
    ):
        # Filling gaps in even steps may have made it too large: without filling it can still be a grid.
        across, along = _steps(x, even=False), _steps(y, even=False)
        size = across[0].size * along[0].size
        if x.size > size or x.size < MIN_FILLED_FRACTION * size:
            return None
    place = along[1] * across[0].size + across[1]
    if np.bincount(place).max() > 1:
        return None
    return Lattice(across[0], along[0], across[1], along[1])


def even_places(at: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Return ascending, evenly spaced places, with nan heights in gaps; uneven places unchanged."""
    places, index, even = _steps(at)
    if not even or places.size > MAX_NODES_PER_POINT * at.size:
        return at, z
    heights = np.full(places.size, np.nan)
    heights[index] = z
    return places, heights


def _steps(values: Floats, *, even: bool = True) -> tuple[Floats, Ints, bool]:
    """Return the distinct places of one axis, the index of each value, and whether they are evenly spaced."""
    places, index = np.unique(values, return_inverse=True)
    index = index.astype(np.int64)
    if places.size < 2 or not even:
        return places, index, places.size < 2
    steps = np.diff(places)
    counts = np.concatenate([[0.0], np.cumsum(np.rint(steps / np.median(steps)))])
    if counts[-1] > MAX_POINTS or (np.diff(counts) < 1).any():
        return places, index, False
    pitch = (places[-1] - places[0]) / counts[-1]
    off = np.abs(places - places[0] - pitch * counts).max()
    if off > min(_rounding(places), MAX_OFFSET_STEPS * pitch) + 1e-9 * pitch:
        return places, index, False
    number = counts.astype(np.int64)
    return places[0] + pitch * np.arange(number[-1] + 1), number[index], True


def _rounding(places: Floats) -> float:
    """Return the last decimal of the places, which bounds their rounding error."""
    for decimals in range(16):
        if np.abs(places - np.round(places, decimals)).max() <= 1e-15 * np.abs(places).max():
            return 10.0**-decimals
    return 0.0
