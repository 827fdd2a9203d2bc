"""Common code of the readers and writers of maps: limits, grids and error messages."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats
from turnwright._io import write_atomic
from turnwright._validate import has_finite_sum, one_of
from turnwright.errors import MapError
from turnwright.heightmap import HeightMap
from turnwright.units import convert

__all__ = [
    "DAMAGE",
    "MAX_FILE_BYTES",
    "MAX_POINTS",
    "SPELLINGS",
    "check_inflated_size",
    "damaged",
    "even_axes",
    "finite_or_missing",
    "grid_map",
    "is_front",
    "read_contents",
    "require_bytes",
    "require_heights",
    "require_points",
    "square_pixel",
    "to_mm",
    "too_high",
    "words",
    "write_file",
]

MAX_FILE_BYTES = 4 << 30

MAX_POINTS = 200_000_000
"""Points of a map: 1.6 GB of heights."""

MAX_HEIGHT_MM = 1e6

MAX_DEFLATE_RATIO = 1032
"""Largest compression ratio of deflate."""

SMALL_BYTES = 1 << 28
"""Uncompressed size up to which any compression ratio is allowed, as a plane compresses well."""

MAX_LARGE_RATIO = 100
"""Compression ratio allowed above that size; measured heights hardly compress."""

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
"""Exceptions of libraries for damaged files; `MapError` is a ValueError, so catch it first."""

SQUARE_TOL = 1e-6
"""Difference of the sides of a square pixel, relative to one."""

SPELLINGS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetres"), "cm"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers", "micrometres"), "um"),
    **dict.fromkeys(("nm", "nanometer", "nanometers", "nanometre", "nanometres"), "nm"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
}
"""Unit by its spelling in lower case."""


def damaged(path: Path, fault: str) -> MapError:
    """Return the error for a file that cannot be as its instrument wrote it."""
    return MapError(f"{path} {fault}: it is truncated or damaged, so export or copy it again")


def require_points(path: Path, columns: int, rows: int) -> None:
    """Raise unless a grid has a possible size."""
    if columns < 1 or rows < 1:
        raise damaged(path, f"has {columns} columns and {rows} rows of heights, it needs at least 1 of each")
    if columns * rows > MAX_POINTS:
        raise MapError(f"{path} has {columns} x {rows} heights, the limit is {MAX_POINTS:,} in all: crop it")


def require_heights(path: Path, heights: Floats) -> None:
    """Raise if heights that were read are too large for any part."""
    if fault := too_high(heights):
        raise damaged(path, f"{fault} (check its unit)")


def too_high(heights: Floats) -> str:
    """Return what is wrong with heights that are too large for any part; empty if nothing is."""
    ends = (np.fmax.reduce(heights, axis=None, initial=0.0), -np.fmin.reduce(heights, axis=None, initial=0.0))
    highest = float(max(ends))
    return f"has heights of up to {highest:.3g} mm, the limit is {MAX_HEIGHT_MM:g} mm" * (highest > MAX_HEIGHT_MM)


def require_bytes(path: Path, needed: int, there: int) -> None:
    """Raise unless a file is long enough for its heights."""
    if needed > there:
        raise damaged(path, f"needs {needed:,} bytes by its header and has {there:,}")


def check_inflated_size(path: Path, packed: int, claimed: int) -> None:
    """Raise if ``claimed`` bytes are more than ``packed`` bytes of deflate can hold, or than any map has."""
    ratio = MAX_DEFLATE_RATIO if claimed <= SMALL_BYTES else MAX_LARGE_RATIO
    if claimed > 8 * MAX_POINTS or claimed > ratio * packed + 64:
        raise MapError(
            f"{path} states {claimed:,} bytes unpacked from {packed:,}, the limits are {8 * MAX_POINTS:,} bytes and a "
            f"ratio of {ratio}: it is damaged or malicious"
        )


def finite_or_missing(heights: Floats) -> Floats:
    """Return heights with infinite values replaced by nan."""
    heights = np.asarray(heights, dtype=np.float64)
    if has_finite_sum(heights):
        return heights
    infinite = np.isinf(heights)
    return np.where(infinite, np.nan, heights) if infinite.any() else heights


def words(raw: bytes) -> str:
    """Return the text of a field up to its first zero byte, without unprintable characters."""
    text = raw.split(b"\0", 1)[0].decode("latin-1")
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())


def to_mm(unit: str, where: str) -> float:
    """Return one ``unit`` in mm; the message of a unit that is not a length begins with ``where``."""
    symbol = SPELLINGS.get(unit.strip().lower())
    # A capital M means mega, not milli.
    if symbol is None or unit.strip() in {"M", "Mm"}:
        raise MapError(f"{where} {unit.strip()!r}, the known units are m, cm, mm, um, nm and in: export it in one")
    return convert(1.0, symbol, "mm")


def grid_map(
    path: Path,
    heights: Floats,
    pixel: tuple[float, float] | None,
    *,
    start: tuple[float, float] = (0.0, 0.0),
    metadata: Mapping[str, str],
) -> HeightMap:
    """Return the map of a grid of heights whose rows ascend in y. (ny, nx) [mm].

    ``pixel`` is the pixel size along x and y, ``None`` if the file has none; ``start`` the position of the first column
    and row [mm]. Empty entries of ``metadata`` are dropped.
    """
    if pixel is not None:
        for size, name in zip(pixel, "xy", strict=True):
            if not (math.isfinite(size) and size > 0):
                raise damaged(path, f"has a pixel size of {size:g} mm along {name}, it must be finite and above 0 mm")
        if not all(map(math.isfinite, start)):
            raise damaged(path, f"starts at {start} mm, it must be finite")
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


def even_axes(heights: HeightMap, kind: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the start of the axes of a map and its pixel size, each for x and y; raise if a format cannot hold them.

    A single row or column gets the pixel size of the other axis.
    """
    if heights.x is None or heights.y is None or heights.scattered:
        what = "scattered points" if heights.scattered else "a polar grid"
        raise MapError(
            f"the map {heights.name!r} has {what}, {kind} files hold rectangular grids only: write it as .npz"
        )
    if not heights.calibrated:
        raise MapError(
            f"the map {heights.name!r} has no pixel size, {kind} files need one: read it with "
            "pixel_size=..., or write it as .npz"
        )
    pixels = []
    for name, axis in (("x", heights.x), ("y", heights.y)):
        pixel = (axis[-1] - axis[0]) / (axis.size - 1) if axis.size > 1 else math.nan
        off = np.abs(axis - axis[0] - pixel * np.arange(axis.size)).max() / pixel if axis.size > 1 else 0.0
        if off > 1e-6 or pixel <= 0:
            raise MapError(
                f"{name} of the map {heights.name!r} deviates from even steps by {off:.2g} of a step, {kind} files "
                "allow 1e-06: write it as .npz"
            )
        pixels.append(float(pixel))
    sizes = [pixel for pixel in pixels if not math.isnan(pixel)] or [1.0]
    along_x, along_y = (sizes[0] if math.isnan(pixel) else pixel for pixel in pixels)
    return (float(heights.x[0]), float(heights.y[0])), (along_x, along_y)


def square_pixel(heights: HeightMap, kind: str) -> float:
    """Return the one pixel size of a map; raise if a format with square pixels cannot hold it. [mm]."""
    _, (along_x, along_y) = even_axes(heights, kind)
    if abs(along_x - along_y) > SQUARE_TOL * along_x:
        raise MapError(
            f"the map {heights.name!r} has pixels of {along_x:.6g} x {along_y:.6g} mm, {kind} files hold square ones: "
            "resample it, or write it as .npz"
        )
    return along_x


def is_front(face: str | None) -> bool:
    """Whether the face of a lens file has its material on the +z side, so that a map must be turned over for it."""
    if face is not None:
        one_of(face, "face", ("front", "back"))
    return face == "front"


def write_file(path: Path, data: bytes) -> None:
    """Write a complete file, or raise and leave what was there."""
    try:
        write_atomic(path, data)
    except OSError as error:
        raise MapError(f"{path} cannot be written ({error.strerror}): check its folder and permissions") from error


def read_contents(path: Path, limit: int = MAX_FILE_BYTES) -> bytes:
    """Return the bytes of a file, or raise if it is missing, empty or too large."""
    try:
        size = path.stat().st_size if path.is_file() or not path.exists() else -1
        data = path.read_bytes() if 0 < size <= limit else b""
    except (OSError, MemoryError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"{path} cannot be read ({reason}): check its name and folder") from error
    if size < 0:
        raise MapError(f"{path} is not a file: name a file")
    if not data:
        raise MapError(f"{path} has {size:,} bytes, the limits are 1 and {limit:,}: export it again, or crop it")
    return data
