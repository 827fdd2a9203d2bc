"""Digital Surf ``.sur``: a header of 512 bytes, two notes, then integers, plain or deflated.

The first row is the top of the picture. A file with inverted heights is refused: two programs then invert them back,
and two do not. An offset of all heights in the header is kept as text.

Sources
-------
[Gwyddion]_ and surfalize give the layout. Oracles: a file on which SurfaceTopography and surfalize agree; files packed
field by field.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from turnwright.errors import MapError
from turnwright.files.base import check_inflated_size, damaged, grid_map, require_bytes, require_points, to_mm, words
from turnwright.heightmap import HeightMap

__all__ = ["SIGNATURES", "read"]

PLAIN, DEFLATED = b"DIGITAL SURF", b"DSCOMPRESSED"
SIGNATURES = (PLAIN, DEFLATED)
HEAD = 512
PLACES = {
    "format": (12, "<h"),
    "objects": (14, "<h"),
    "kind": (18, "<h"),
    "object": (20, "30s"),
    "operator": (50, "30s"),
    "not measured": (86, "<h"),
    "bits": (98, "<h"),
    "lowest": (100, "<i"),
    "columns": (108, "<i"),
    "rows": (112, "<i"),
    "points": (116, "<i"),
    "step x": (120, "<f"),
    "step y": (124, "<f"),
    "step z": (128, "<f"),
    "unit x": (180, "16s"),
    "unit y": (196, "16s"),
    "unit z": (212, "16s"),
    "inverted": (290, "<h"),
    "packed bytes": (324, "<I"),
    "comment bytes": (334, "<h"),
    "private bytes": (336, "<h"),
    "offset z": (474, "<f"),
}
"""Offset and format of the fields that are read."""

TIME_OFFSET = 306
"""Offset of the six numbers of the time."""

SURFACES = frozenset({1, 2})
"""Kinds of profiles and surfaces; Gwyddion writes surfaces as profiles."""


def read(path: Path, data: bytes) -> HeightMap:
    """Read a Digital Surf file with one surface or profile."""
    require_bytes(path, HEAD, len(data))
    field = {name: struct.unpack_from(form, data, place)[0] for name, (place, form) in PLACES.items()}
    for name, allowed, remedy in (
        ("format", {0}, "save it on a PC"),
        ("objects", {0, 1}, "save the surface alone"),
        ("kind", SURFACES, "save the surface alone"),
        ("inverted", {0}, "programs disagree on the sign of inverted heights, so save it without"),
        ("bits", {16, 32}, "it is damaged"),
    ):
        if field[name] not in allowed:
            raise MapError(f"{path} has {name} {field[name]}, it must be one of {sorted(allowed)}: {remedy}")
    columns, rows = field["columns"], field["rows"]
    require_points(path, columns, rows)
    if field["points"] != columns * rows:
        raise damaged(path, f"has {field['points']} points for {columns} x {rows}")
    if min(field["comment bytes"], field["private bytes"]) < 0:
        raise damaged(path, "has notes of negative length")
    begin = HEAD + field["comment bytes"] + field["private bytes"]
    needed = columns * rows * field["bits"] // 8
    raw = data[begin:] if data.startswith(PLAIN) else _inflate(path, data[begin:], needed)
    require_bytes(path, needed, len(raw))
    stored = np.frombuffer(raw, f"<i{field['bits'] // 8}", columns * rows).reshape(rows, columns)[::-1]
    step = field["step z"] * to_mm(_unit(field["unit z"]), f"{path} states its heights in")
    if not (math.isfinite(step) and step != 0):
        raise damaged(path, f"has a height step of {step:g} mm, it must be finite and not 0")
    heights = stored * step
    if field["not measured"] == 1:
        heights[stored == field["lowest"] - 2] = np.nan
    second, minute, hour, day, month, year = struct.unpack_from("<6h", data, TIME_OFFSET)
    return grid_map(
        path,
        heights,
        (_pixel(path, field, "x"), _pixel(path, field, "y")),
        metadata={
            "format": "Digital Surf .sur",
            "object": words(field["object"]),
            "operator": words(field["operator"]),
            "date": f"{year:04d}-{month:02d}-{day:02d}T{hour:02d}:{minute:02d}:{second:02d}" if year > 0 else "",
            "comment": words(data[HEAD : HEAD + field["comment bytes"]]),
            "offset z": f"{field['offset z']:g}, not added" if field["offset z"] else "",
        },
    )


def _unit(raw: bytes) -> str:
    """Return the name of a unit; old files write the micro sign of MS-DOS, some programs that of UTF-8."""
    return words(raw).replace("\xe6", "u").replace("\xc2\xb5", "u")


def _pixel(path: Path, field: dict[str, Any], axis: str) -> float:
    unit = _unit(field[f"unit {axis}"])
    size: float = field[f"step {axis}"] * to_mm(unit, f"{path} states its {axis} in")
    return size


def _inflate(path: Path, data: bytes, needed: int) -> bytes:
    """Return the heights from deflated streams, no more than needed."""
    require_bytes(path, 4, len(data))
    (streams,) = struct.unpack_from("<I", data)
    require_bytes(path, 4 + 8 * streams, len(data))
    check_inflated_size(path, len(data), needed)
    begin = 4 + 8 * streams
    parts: list[bytes] = []
    for plain, packed in struct.iter_unpack("<II", data[4:begin]):
        require_bytes(path, begin + packed, len(data))
        missing = needed - sum(len(part) for part in parts)
        if plain > missing:
            break
        part = zlib.decompressobj().decompress(data[begin : begin + packed], plain + 1)
        if len(part) != plain:
            raise damaged(path, f"has a stream of {len(part)} bytes that states {plain}")
        parts.append(part)
        begin += packed
    return b"".join(parts)
