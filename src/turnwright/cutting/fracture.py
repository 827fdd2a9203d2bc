"""How much of a cut surface is whole: fracture scatters light, so that what is broken looks dark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, frozen
from turnwright._validate import between, positive
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap

__all__ = ["IntactShare", "ri80"]

TILES = 8
"""The area is split into so many by so many tiles, whose scatter tells the uncertainty."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntactShare:
    """The share of an area that reflects as a surface without fracture does.

    Parameters
    ----------
    share
        Of the area, 0 to 1.
    uncertainty
        Standard uncertainty of the share as one of the whole part, from how tiles of the area differ; nan where there
        are fewer than 4 tiles.
    least
        Intensity from which a place counts as whole. [the instrument's unit]
    intact
        Which places do; False too where nothing was measured. (ny, nx)
    measured
        Share of the map that was measured.
    """

    share: float
    uncertainty: float
    least: float
    intact: Bools
    measured: float


def ri80(intensity: ArrayLike | HeightMap, reference: ArrayLike | float, *, threshold: float = 0.8) -> IntactShare:
    """Return the share of an area whose reflectance exceeds 80 % of a reference without fracture.

    Parameters
    ----------
    intensity
        Reflected intensity at even steps, or a map whose values are intensities; nan where nothing was measured. On a
        polar map every place counts by its area. (ny, nx) [the instrument's unit]
    reference
        Intensity of a surface of the same material without fracture under the same light: one number, or a map whose
        mean is taken. [the same unit]
    threshold
        What is to be exceeded, as a share of the reference; 0.8 is the one that gives the measure its name.

    Raises
    ------
    InputError
        If nothing is measured, an intensity is infinite, or the reference is not positive.

    Sources
    -------
    [Troutman2016]_, RI80. Oracle: maps whose share is made.

    >>> ri80([[1.0, 0.9, 0.85], [0.5, 0.79, 0.81]], reference=1.0).share.__round__(4)
    0.6667
    """
    between(threshold, "threshold", 0.0, 1.0, "of the reference")
    values = frozen(intensity.z if isinstance(intensity, HeightMap) else intensity, "intensity", ndim=2, finite=False)
    level = np.asarray(reference.z if isinstance(reference, HeightMap) else reference, dtype=np.float64)
    known = level[np.isfinite(level)]
    if not known.size:
        raise InputError("the reference holds no finite intensity: give that of a surface without fracture")
    least = threshold * positive(float(known.mean()), "the reference", "of intensity")
    valid = ~np.isnan(values)
    if np.isinf(values).any():
        raise InputError(
            f"{np.count_nonzero(np.isinf(values))} places have an infinite intensity, the limit is 0: put nan where "
            "nothing was measured"
        )
    if not valid.any():
        raise InputError(f"none of {values.size} places has an intensity, at least 1 is needed: give a measured map")
    weight = np.ones(values.shape)
    if isinstance(intensity, HeightMap) and intensity.radius is not None:
        weight = np.broadcast_to(np.abs(intensity.radius), values.shape)
        if not (weight[valid] > 0).any():
            raise InputError("all measured places lie on the axis, where they have no area: measure farther out")
    intact = np.zeros(values.shape, dtype=np.bool_)
    intact[valid] = values[valid] > least
    counted = np.where(valid, weight, 0.0)
    share = float((counted * intact).sum() / counted.sum())
    return IntactShare(
        share=share,
        uncertainty=_of_tiles(counted, intact, share),
        least=least,
        intact=intact,
        measured=float(valid.mean()),
    )


def _of_tiles(counted: Floats, intact: Bools, share: float) -> float:
    """Return the uncertainty of a ratio of sums over tiles."""
    rows, columns = (np.minimum(np.arange(n) * min(TILES, n) // n, TILES - 1) for n in counted.shape)
    number = rows[:, None] * TILES + columns
    areas = np.bincount(number.ravel(), counted.ravel(), TILES * TILES)
    wholes = np.bincount(number.ravel(), (counted * intact).ravel(), TILES * TILES)
    filled = areas > 0
    count = int(np.count_nonzero(filled))
    if count < 4:
        return float("nan")
    off = wholes[filled] - share * areas[filled]
    return float(np.sqrt(count / (count - 1) * (off**2).sum()) / areas.sum())
