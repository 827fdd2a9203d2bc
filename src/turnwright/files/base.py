"""What all readers and writers of maps share: limits, grids, and the sentence when something is wrong."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import MapError
from turnwright.heightmap import HeightMap

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = [
    "DAMAGE",
    "LARGEST_FILE",
    "MOST_POINTS",
    "even_axes",
    "finite_or_missing",
    "grid_map",
    "inflated",
    "require_bytes",
    "require_heights",
    "require_points",
    "words",
]

LARGEST_FILE = 4 << 30
"""Bytes of the largest file that is opened."""

MOST_POINTS = 200_000_000
"""Points of the largest map: 1.6 GB of heights."""

HIGHEST = 1e6
"""Size of a height from which it is none of a part: 1 km. [mm]"""

DENSEST = 1032
"""Bytes that one byte of deflate can stand for."""

SMALL = 1 << 28
"""Bytes up to which anything may be packed as densely as can be: a plane packs well."""

DENSE = 100
"""Bytes that one packed byte may stand for in more than that; measured heights hardly pack at all."""

DAMAGE = (
    OSError,
    EOFError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    MemoryError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)
"""What a damaged file makes libraries raise; `MapError` is a ValueError, so catch that first."""


def require_points(path: Path, columns: int, rows: int) -> None:
    """Raise unless a grid has a size that can be."""
    if columns < 1 or rows < 1:
        raise MapError(
            f"{path} says that its heights have {columns} columns and {rows} rows, the limit is 1 of each: it holds no "
            "heights or is damaged, so export it again"
        )
    if columns * rows > MOST_POINTS:
        raise MapError(
            f"{path} says that it has {columns} x {rows} heights, the limit is {MOST_POINTS:,} in all: it is damaged, "
            "or crop it"
        )


def require_heights(path: Path, heights: Floats) -> None:
    """Raise if heights are out of the range of any part."""
    highest = float(np.nanmax(np.abs(heights), initial=0.0))
    if highest > HIGHEST:
        raise MapError(
            f"{path} has heights of up to {highest:.3g} mm, the limit is {HIGHEST:g} mm: it is damaged, or its unit is "
            "wrong"
        )


def require_bytes(path: Path, needed: int, there: int) -> None:
    """Raise unless as many bytes are there as the heights need."""
    if needed > there:
        raise MapError(
            f"{path} needs {needed:,} bytes for what its head says and has {there:,}: it is cut short or damaged, so "
            "export or copy it again"
        )


def inflated(path: Path, packed: int, claimed: int) -> None:
    """Raise if ``packed`` bytes of deflate cannot be as long as is claimed, or that is more than any map."""
    times = DENSEST if claimed <= SMALL else DENSE
    if claimed > 8 * MOST_POINTS or claimed > times * packed + 64:
        raise MapError(
            f"{path} claims {claimed:,} bytes unpacked from {packed:,}, the limits are {8 * MOST_POINTS:,} bytes and "
            f"{times} times as many: it is damaged, or made to do harm"
        )


def finite_or_missing(heights: Floats) -> Floats:
    """Return heights of which those that are not finite are missing: a format without nan marks them so."""
    return np.where(np.isfinite(heights), heights, np.nan)


def words(raw: bytes) -> str:
    """Return the text of a field that ends at its first zero byte, without what cannot be printed."""
    text = raw.split(b"\0", 1)[0].decode("latin-1")
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())


def grid_map(
    path: Path,
    heights: Floats,
    pixel: tuple[float, float] | None,
    *,
    start: tuple[float, float] = (0.0, 0.0),
    metadata: Mapping[str, str],
) -> HeightMap:
    """Return the map of a grid whose rows ascend in y.

    Parameters
    ----------
    path
        Of the file, which names the map.
    heights
        (ny, nx) [mm]
    pixel
        Its size along x and y, or nothing where the file does not say. [mm]
    start
        Where the first column and row stand. [mm]
    metadata
        Text of the file; what is empty is left out.
    """
    if pixel is not None:
        for size, name in zip(pixel, "xy", strict=True):
            if not (math.isfinite(size) and size > 0):
                raise MapError(
                    f"{path} says that its pixels are {size:g} mm wide along {name}, it must be finite and above 0 mm: "
                    "it is damaged, so export it again"
                )
        if not all(map(math.isfinite, start)):
            raise MapError(f"{path} says that it starts at {start} mm, it must be finite: it is damaged")
    rows, columns = heights.shape
    along_x, along_y = pixel or (1.0, 1.0)
    return HeightMap(
        z=finite_or_missing(heights),
        x=start[0] + along_x * np.arange(columns, dtype=np.float64),
        y=start[1] + along_y * np.arange(rows, dtype=np.float64),
        name=path.name,
        calibrated=pixel is not None,
        metadata={key: text for key, text in metadata.items() if text},
    )


def even_axes(one: HeightMap, kind: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return where the axes of a map start and the size of its pixels, x before y, or raise if a format cannot say it.

    A single row or column is given the pixel of the other axis.
    """
    if one.x is None or one.y is None or one.scattered:
        what = "scattered points" if one.scattered else "a polar grid"
        raise MapError(f"the map {one.name!r} has {what}, {kind} files hold rectangular grids only: write it as .npz")
    if not one.calibrated:
        raise MapError(
            f"the map {one.name!r} says nothing of the size of its pixels, {kind} files must: give it with "
            "HeightMap.scaled, or write it as .npz"
        )
    pixels = []
    for name, axis in (("x", one.x), ("y", one.y)):
        pixel = (axis[-1] - axis[0]) / (axis.size - 1) if axis.size > 1 else math.nan
        off = np.abs(axis - axis[0] - pixel * np.arange(axis.size)).max() / pixel if axis.size > 1 else 0.0
        if off > 1e-6 or pixel <= 0:
            raise MapError(
                f"the {name} of the map {one.name!r} is {off:.2g} of a step off even steps, {kind} files allow 1e-06: "
                "write it as .npz"
            )
        pixels.append(float(pixel))
    known = [pixel for pixel in pixels if not math.isnan(pixel)] or [1.0]
    along_x, along_y = (known[0] if math.isnan(pixel) else pixel for pixel in pixels)
    return (float(one.x[0]), float(one.y[0])), (along_x, along_y)
