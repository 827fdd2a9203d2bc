"""Overview of a measurement without a part: header, size, missing heights, Sq."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from turnwright._validate import one_of
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import area_rms
from turnwright.units import say_length

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

NM = 1e6

MAX_VALUE_CHARACTERS = 120


def level(heights: HeightMap, form: Form = "plane") -> HeightMap:
    """Return a map without its form. Maps of unknown pixel size are treated in pixels.

    Parameters
    ----------
    heights
        On a grid; or scattered points, from which only the mean or the plane is removed.
    form
        See `remove_form`.
    """
    if not heights.scattered:
        plain = remove_form(replace(heights, calibrated=True), form)
        return replace(plain, calibrated=heights.calibrated)
    one_of(form, "the form of scattered heights", ("none", "mean", "plane"))
    valid = np.isfinite(heights.z)
    x, y = heights.points()
    count = ("none", "mean", "", "plane").index(str(form))
    terms = np.column_stack([np.ones(x.size), x - x.mean(), y - y.mean()])[:, :count]
    return replace(heights, z=heights.z - terms @ np.linalg.lstsq(terms[valid], heights.z[valid], rcond=None)[0])


def overview(heights: HeightMap, form: Form = "plane") -> tuple[tuple[str, str], ...]:
    """Return header, size, missing heights, Sq and PV of a measured map, as names and values.

    Parameters
    ----------
    heights
        Of any kind.
    form
        Form removed before Sq and PV; see `remove_form`.

    >>> from turnwright.heightmap import HeightMap
    >>> x = 0.002 * np.arange(50)
    >>> wave = HeightMap(x=x, y=x, z=1e-5 * np.tile(np.cos(2 * np.pi * np.arange(50) / 25), (50, 1)))
    >>> dict(overview(wave, "mean"))["Sq"]
    '7.071 nm after the mean'
    """
    count, valid = heights.z.size, int(np.count_nonzero(np.isfinite(heights.z)))
    missing = count - valid
    rows = [("size", _size(heights)), ("missing", f"{missing:,} of {count:,} ({100 * missing / count:.3g} %)")]
    if valid:
        flat = level(heights, form)
        named = (
            "as it is" if form == "none" else f"after the {form}" if isinstance(form, str) else f"after degree {form}"
        )
        rows.append(("Sq", f"{area_rms(replace(flat, calibrated=True)) * NM:.4g} nm {named}"))
        rows.append(("PV", f"{float(np.nanmax(flat.z) - np.nanmin(flat.z)) * NM:.4g} nm"))
    rows += [(name, " ".join(text.split())[:MAX_VALUE_CHARACTERS]) for name, text in heights.metadata.items()]
    return tuple(rows)


def _size(heights: HeightMap) -> str:
    if heights.radius is not None and heights.angle is not None:
        low, high = (say_length(float(radius), 4) for radius in heights.radius[[0, -1]])
        return f"{heights.z.shape[0]} azimuths x {heights.z.shape[1]} radii from {low} to {high}"
    assert heights.x is not None  # noqa: S101 - a map that is not polar has x and y
    assert heights.y is not None  # noqa: S101
    x, y = heights.x, heights.y
    extent = f"{say_length(float(np.ptp(x)), 4)} x {say_length(float(np.ptp(y)), 4)}"
    if heights.scattered:
        return f"{heights.z.size:,} scattered points over {extent}"
    shape = f"{x.size} x {y.size}"
    if not heights.calibrated:
        return f"{shape} pixels of unknown size"
    steps = [float(np.ptp(axis)) / (axis.size - 1) for axis in (x, y) if axis.size > 1]
    return f"{shape} points, {' x '.join(say_length(step, 4) for step in steps)} apart, {extent}"
