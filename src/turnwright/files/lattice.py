"""Whether points stand on a rectangular grid, and where on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from turnwright._arrays import Floats, Ints
from turnwright.files.base import MOST_POINTS

__all__ = ["Lattice", "even_places", "on_lattice"]

SPARSEST = 20
"""Places of a lattice for each of its points, at most."""

LOOSEST = 0.05
"""Share of a step by which rounded decimals may put a place off its grid."""

FULL = 0.5
"""Share of places that have a point, at least, for uneven steps to be a grid."""


class Lattice(NamedTuple):
    """A grid, and the row and column of each point."""

    x: Floats
    y: Floats
    column: Ints
    row: Ints


def on_lattice(x: Floats, y: Floats) -> Lattice | None:
    """Return the grid on which points stand, or nothing if there is none or two points share a place."""
    across, along = _steps(x), _steps(y)
    size = across[0].size * along[0].size
    if size > min(MOST_POINTS, SPARSEST * x.size) or (not (across[2] and along[2]) and FULL * size > x.size):
        # Gaps in even steps may be what made it too wide: without them it can still be a grid.
        across, along = _steps(x, even=False), _steps(y, even=False)
        size = across[0].size * along[0].size
        if x.size > size or x.size < FULL * size:
            return None
    place = along[1] * across[0].size + across[1]
    if np.bincount(place).max() > 1:
        return None
    return Lattice(across[0], along[0], across[1], along[1])


def even_places(at: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Return ascending places on their even steps, with nan where one is left out; uneven ones as they are."""
    places, index, even = _steps(at)
    if not even or places.size > SPARSEST * at.size:
        return at, z
    heights = np.full(places.size, np.nan)
    heights[index] = z
    return places, heights


def _steps(values: Floats, *, even: bool = True) -> tuple[Floats, Ints, bool]:
    """Return the places of one axis, which of them each value has, and whether they are evenly spaced."""
    places, index = np.unique(values, return_inverse=True)
    index = index.astype(np.int64)
    if places.size < 2 or not even:
        return places, index, places.size < 2
    steps = np.diff(places)
    counts = np.concatenate([[0.0], np.cumsum(np.rint(steps / np.median(steps)))])
    if counts[-1] > MOST_POINTS or (np.diff(counts) < 1).any():
        return places, index, False
    pitch = (places[-1] - places[0]) / counts[-1]
    off = np.abs(places - places[0] - pitch * counts).max()
    if off > min(_rounding(places), LOOSEST * pitch) + 1e-9 * pitch:
        return places, index, False
    whole = counts.astype(np.int64)
    return places[0] + pitch * np.arange(whole[-1] + 1), whole[index], True


def _rounding(places: Floats) -> float:
    """Return how far decimals as short as these put a place off the straight line between two others."""
    for decimals in range(16):
        if np.abs(places - np.round(places, decimals)).max() <= 1e-15 * np.abs(places).max():
            return 10.0**-decimals
    return 0.0
