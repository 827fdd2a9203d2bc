"""Area fraction of a cut surface without fracture, from its reflectance: fracture scatters light and looks dark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, frozen
from turnwright._validate import between, positive
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap

__all__ = ["IntactShare", "ri80"]

TILES_PER_SIDE = 8
"""The scatter over a grid of tiles gives the uncertainty."""

MIN_TILES = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntactShare:
    """Fraction of an area that reflects like a surface without fracture.

    Parameters
    ----------
    share
        Intact fraction of the area, 0 to 1. [1]
    uncertainty
        Standard uncertainty of ``share`` as an estimate for the whole part, from the scatter between tiles of the
        area; nan if there are fewer than 4 tiles. [1]
    least
        Intensity above which a point counts as intact. [the instrument's unit]
    intact
        Whether each point is intact; False where nothing was measured. (ny, nx)
    measured
        Fraction of the map that was measured. [1]
    """

    share: float
    uncertainty: float
    least: float
    intact: Bools
    measured: float


def ri80(intensity: ArrayLike | HeightMap, reference: ArrayLike | float, *, threshold: float = 0.8) -> IntactShare:
    """Compute the fraction of an area whose reflectance exceeds 80 % of a reference without fracture.

    Parameters
    ----------
    intensity
        Reflected intensity on an even grid, or a map whose values are intensities; nan where nothing was measured. On
        a polar map points are weighted by their area. (ny, nx) [the instrument's unit]
    reference
        Intensity of a surface of the same material without fracture under the same light: a number, or a map whose
        mean is used. [the same unit]
    threshold
        Threshold over reference intensity; RI80 is named after the default 0.8. [1]

    Raises
    ------
    InputError
        If nothing is measured, an intensity is infinite, or the reference is not positive.

    Sources
    -------
    [Troutman2016]_, RI80. Oracle: maps with a finite fraction.

    >>> ri80([[1.0, 0.9, 0.85], [0.5, 0.79, 0.81]], reference=1.0).share.__round__(4)
    0.6667
    """
    between(threshold, "threshold", 0.0, 1.0, "of the reference")
    values = frozen(intensity.z if isinstance(intensity, HeightMap) else intensity, "intensity", ndim=2, finite=False)
    level = np.asarray(reference.z if isinstance(reference, HeightMap) else reference, dtype=np.float64)
    finite = level[np.isfinite(level)]
    if not finite.size:
        raise InputError("the reference holds no finite intensity: state that of a surface without fracture")
    least = threshold * positive(float(finite.mean()), "the reference", "of intensity")
    valid = ~np.isnan(values)
    if np.isinf(values).any():
        raise InputError(
            f"intensity must be finite, got {np.count_nonzero(np.isinf(values))} infinite values: use nan where "
            "nothing was measured"
        )
    if not valid.any():
        raise InputError(f"intensity must have at least 1 measured value, got none in {values.size}")
    weight = np.ones(values.shape)
    if isinstance(intensity, HeightMap) and intensity.radius is not None:
        weight = np.broadcast_to(np.abs(intensity.radius), values.shape)
        if not (weight[valid] > 0).any():
            raise InputError("all measured points lie on the axis, where they have no area: measure farther out")
    intact = np.zeros(values.shape, dtype=np.bool_)
    intact[valid] = values[valid] > least
    counted = np.where(valid, weight, 0.0)
    share = float((counted * intact).sum() / counted.sum())
    return IntactShare(
        share=share,
        uncertainty=_tile_uncertainty(counted, intact, share),
        least=least,
        intact=intact,
        measured=float(valid.mean()),
    )


def _tile_uncertainty(counted: Floats, intact: Bools, share: float) -> float:
    """Return the standard uncertainty of a ratio of sums over tiles."""
    rows, columns = (np.minimum(np.arange(n) * min(TILES_PER_SIDE, n) // n, TILES_PER_SIDE - 1) for n in counted.shape)
    number = rows[:, None] * TILES_PER_SIDE + columns
    areas = np.bincount(number.ravel(), counted.ravel(), TILES_PER_SIDE * TILES_PER_SIDE)
    intact_areas = np.bincount(number.ravel(), (counted * intact).ravel(), TILES_PER_SIDE * TILES_PER_SIDE)
    filled = areas > 0
    count = int(np.count_nonzero(filled))
    if count < MIN_TILES:
        return float("nan")
    off = intact_areas[filled] - share * areas[filled]
    return float(np.sqrt(count / (count - 1) * (off**2).sum()) / areas.sum())
