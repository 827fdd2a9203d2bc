r"""Zygo MetroPro ``.dat``: a big-endian head of 834 or 4096 bytes, the camera's intensities, then the phase.

A height is :math:`p S O W / R` for a phase of p counts, with the scale factor S of the interferometer, the obliquity
factor O, the wavelength W, and R counts per fringe. The first row is the top of the camera's picture.

A file with the sign field set is refused: two programs then invert the heights, and two do not.

Sources
-------
The layout is the one on which [Gwyddion]_, prysm and SurfaceTopography agree. Oracles: a file of prysm's test set, on
which the three agree, and files packed field by field.
"""

from __future__ import annotations

import math
import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from turnwright.errors import MapError
from turnwright.files.base import damaged, grid_map, require_bytes, require_points, square_pixel, words
from turnwright.heightmap import HeightMap

__all__ = ["COUNTS", "MISSING", "SIGNATURES", "fringe_scale", "pack", "read"]

SIGNATURES = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")

COUNTS = {0: 4096, 1: 32768, 2: 131072}
"""Counts per fringe, by phase resolution."""

MISSING = 2147483640
"""Phases from this value on are missing."""

WRITTEN_WAVELENGTH_M = 632.8e-9
"""Helium-neon, the usual one; with the scale factor 0.5 it only sets the height of a count."""

MIN_HEADER_BYTES = 834
MAX_COLUMNS = 65535
PLACES = {
    "header size": (6, ">I"),
    "software date": (12, "30s"),
    "intensity columns": (52, ">H"),
    "intensity rows": (54, ">H"),
    "intensity buckets": (56, ">H"),
    "intensity bytes": (60, ">I"),
    "columns": (68, ">H"),
    "rows": (70, ">H"),
    "timestamp": (76, ">i"),
    "comment": (80, "82s"),
    "scale factor": (164, ">f"),
    "wavelength": (168, ">f"),
    "numerical aperture": (172, ">f"),
    "obliquity factor": (176, ">f"),
    "magnification": (180, ">f"),
    "pixel size": (184, ">f"),
    "phase resolution": (218, ">h"),
    "sign": (232, ">h"),
    "objective": (246, "12s"),
    "part": (258, "40s"),
    "part serial number": (320, "40s"),
}
"""Offset and format of the fields that are read."""


class Fringes(NamedTuple):
    """Factors that convert phase counts into heights."""

    scale: float
    wavelength: float  # [m]
    obliquity: float
    resolution: int

    @property
    def metadata(self) -> dict[str, str]:
        return {
            "wavelength": f"{self.wavelength * 1e9:.6g} nm",
            "scale factor": f"{self.scale:g}",
            "obliquity factor": f"{self.obliquity:g}",
        }


def fringe_scale(path: Path, fringes: Fringes) -> float:
    """Return the height of one count [mm]."""
    if fringes.resolution not in COUNTS:
        raise damaged(path, f"has the phase resolution {fringes.resolution}, it must be 0, 1 or 2")
    value = fringes.scale * fringes.obliquity * fringes.wavelength
    if not (math.isfinite(value) and value > 0):
        raise damaged(
            path,
            f"has scale factor {fringes.scale:g}, wavelength {fringes.wavelength:g} m, obliquity "
            f"{fringes.obliquity:g}, they must be finite and above 0",
        )
    return value * 1e3 / COUNTS[fringes.resolution]


def read(path: Path, data: bytes) -> HeightMap:
    """Read a MetroPro file."""
    require_bytes(path, MIN_HEADER_BYTES, len(data))
    field = {name: struct.unpack_from(form, data, place)[0] for name, (place, form) in PLACES.items()}
    if field["sign"]:
        raise MapError(
            f"{path} marks its heights as inverted (sign {field['sign']}), on which programs disagree by the sign of "
            "z: export it with data sign normal"
        )
    columns, rows = field["columns"], field["rows"]
    require_points(path, columns, rows)
    begin = field["header size"] + _intensity_bytes(path, field)
    require_bytes(path, begin + 4 * columns * rows, len(data))
    counts = np.frombuffer(data, ">i4", columns * rows, begin).reshape(rows, columns)[::-1]
    fringes = Fringes(field["scale factor"], field["wavelength"], field["obliquity factor"], field["phase resolution"])
    heights = counts * fringe_scale(path, fringes)
    heights[counts >= MISSING] = np.nan
    size = 1e3 * field["pixel size"]
    return grid_map(
        path,
        heights,
        (size, size) if size != 0 else None,
        metadata={
            "format": "Zygo MetroPro .dat",
            **fringes.metadata,
            **{name: f"{field[name]:g}" for name in ("magnification", "numerical aperture")},
            "timestamp": datetime.fromtimestamp(field["timestamp"], UTC).isoformat() if field["timestamp"] > 0 else "",
            **{
                name: words(field[name])
                for name in ("comment", "objective", "part", "part serial number", "software date")
            },
        },
    )


def _intensity_bytes(path: Path, field: dict[str, int]) -> int:
    picture = 2 * field["intensity columns"] * field["intensity rows"]
    # Some files state 0 buckets and hold one.
    for buckets in (field["intensity buckets"], 1):
        if field["intensity bytes"] == picture * buckets:
            return picture * buckets
    raise damaged(
        path,
        f"states {field['intensity bytes']} bytes of intensity for {field['intensity buckets']} pictures "
        f"of {picture} bytes, they must agree",
    )


def pack(heights: HeightMap) -> bytes:
    """Return the bytes of a MetroPro file without intensities, in counts of 2.4 pm, or 9.7 pm above 5 mm."""
    size = square_pixel(heights, "Zygo")
    rows, columns = heights.z.shape
    if max(rows, columns) > MAX_COLUMNS:
        raise MapError(
            f"the map {heights.name!r} has {rows} rows and {columns} columns, Zygo files hold up to {MAX_COLUMNS} of "
            "each: crop it, or write it as .npz"
        )
    head = bytearray(MIN_HEADER_BYTES)
    wavelength = struct.unpack(">f", struct.pack(">f", WRITTEN_WAVELENGTH_M))[0]
    highest = float(np.nanmax(np.abs(heights.z), initial=0.0))
    for resolution in (2, 1):
        count = fringe_scale(Path(heights.name), Fringes(0.5, wavelength, 1.0, resolution))
        if highest / count < MISSING:
            break
    else:
        raise MapError(
            f"the map {heights.name!r} has heights of up to {highest:.4g} mm, Zygo files hold up to "
            f"{MISSING * count:.4g} mm: subtract the design (base), or write it as .npz"
        )
    for name, value in {
        "header size": MIN_HEADER_BYTES,
        "columns": columns,
        "rows": rows,
        "comment": heights.name.encode("ascii", "replace")[:81],
        "scale factor": 0.5,
        "wavelength": wavelength,
        "obliquity factor": 1.0,
        "pixel size": size * 1e-3,
        "phase resolution": resolution,
    }.items():
        place, form = PLACES[name]
        struct.pack_into(form, head, place, value)
    struct.pack_into(">4sH", head, 0, SIGNATURES[0], 1)
    struct.pack_into(">I", head, 72, 4 * rows * columns)
    counts = np.where(np.isnan(heights.z), MISSING, np.rint(heights.z / count))
    return bytes(head) + counts[::-1].astype(">i4").tobytes()
