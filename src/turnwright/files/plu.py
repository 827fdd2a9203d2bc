"""Sensofar ``.plu``: a header of 500 bytes, then layers of heights in µm, each followed by pictures.

The first row is the top of the picture. The first layer is read. The format has no signature, so its suffix selects it.

Sources
-------
[Gwyddion]_ and SurfaceTopography give the layout. Oracles: files packed field by field, SurfaceTopography.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from turnwright.errors import MapError
from turnwright.files.base import grid_map, require_bytes, require_points, words
from turnwright.heightmap import HeightMap

__all__ = ["SUFFIX", "read"]

SUFFIX = ".plu"
HEAD = 508
"""Bytes before the heights, with the size of the first layer."""

PLACES = {
    "date": (0, "128s"),
    "comment": (132, "256s"),
    "pixel x": (404, "<f"),
    "pixel y": (408, "<f"),
    "type": (428, "<I"),
    "layers": (489, "<B"),
    "rows": (500, "<I"),
    "columns": (504, "<I"),
}
"""Offset and format of the fields that are read."""

TOPOGRAPHY = 3
MISSING = 1000001
RANGE_BYTES = 8
"""Bytes of the lowest and the highest height, after the heights."""


def read(path: Path, data: bytes) -> HeightMap:
    """Read the first layer of a Sensofar file."""
    require_bytes(path, HEAD, len(data))
    field = {name: struct.unpack_from(form, data, place)[0] for name, (place, form) in PLACES.items()}
    if field["type"] != TOPOGRAPHY or not field["layers"]:
        raise MapError(
            f"{path} has type {field['type']} and {field['layers']} layers, it must have type {TOPOGRAPHY} "
            "(topography) and at least 1: export it as .x3p"
        )
    columns, rows = field["columns"], field["rows"]
    require_points(path, columns, rows)
    require_bytes(path, HEAD + 4 * columns * rows + RANGE_BYTES, len(data))
    stored = np.frombuffer(data, "<f4", columns * rows, HEAD).reshape(rows, columns)[::-1]
    heights = np.multiply(stored, 1e-3, dtype=np.float64)
    heights[stored == MISSING] = np.nan
    return grid_map(
        path,
        heights,
        (field["pixel x"] * 1e-3, field["pixel y"] * 1e-3),
        metadata={"format": "Sensofar .plu", "date": words(field["date"]), "comment": words(field["comment"])},
    )
