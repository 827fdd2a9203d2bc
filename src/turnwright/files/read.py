"""One door for reading maps: the bytes say which format, and where they do not, the suffix."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from turnwright.errors import MapError
from turnwright.files import (
    arrays,
    datx,
    digital_surf,
    grid_sag,
    isolated,
    metropro,
    other,
    points,
    sdf,
    x3p,
    zygo_text,
)
from turnwright.files.base import DAMAGE, LARGEST_FILE, require_heights
from turnwright.files.numbers import text_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from os import PathLike

    from turnwright.heightmap import HeightMap

__all__ = ["contents", "read_map"]


def read_map(
    file: str | PathLike[str],
    *,
    pixel_size: float | tuple[float, float] | None = None,
    unit: str | None = None,
    lateral_unit: str | None = None,
) -> HeightMap:
    """Read a measured map, whatever instrument wrote it.

    The first bytes tell the format, and where they do not, the suffix: Zygo ``.dat``, ``.datx``, ASCII and XYZ;
    ISO 25178-72 ``.x3p``; ISO 25178-71 ``.sdf``; Digital Surf ``.sur``; Zemax grid sag; NumPy ``.npz`` and ``.npy``;
    text and CSV of x, y and z, or with x in the first row and y in the first column; and with the extra ``formats``
    those that SurfaceTopography reads, such as ``.opd``, ``.plu`` and ``.al3d``.

    Parameters
    ----------
    file
        The instrument's file.
    pixel_size
        Along x and y, or one size for both, for a file that does not say. Without it such a map counts pixels, and is
        not `calibrated`. [mm]
    unit
        Of the numbers in a text file that states none, such as "um".
    lateral_unit
        The same of x and y alone, where ``unit`` is that of the heights; empty where only the file may state it.

    Returns
    -------
    HeightMap
        In mm, rows ascending in y, nan where nothing was measured; points that stand on no grid are scattered. Its
        ``metadata`` are what the file says beside the heights.

    Raises
    ------
    MapError
        If the file cannot be read, is damaged, or leaves open what its numbers mean; if a pixel size or unit is given
        for a file that states its own.
    """
    path = Path(file)
    data = contents(path)
    reader, kind = _reader_of(path, data)
    if reader is not _read_text and (unit or lateral_unit):
        raise MapError(f"{path} is {kind} and states its own units: do not give {_given(unit, lateral_unit)}")
    try:
        # Numbers that overflow are no heights: they end as missing points.
        with np.errstate(over="ignore", invalid="ignore"):
            texts = {"unit": unit, "lateral_unit": lateral_unit} if reader is _read_text else {}
            found = reader(path, data, **texts)
    except MapError:
        raise
    except DAMAGE as error:
        said = str(error).split("\n")[0].rstrip(".")[:200] or type(error).__name__
        raise MapError(
            f"{path} cannot be read as {kind} ({said}): it is damaged, so export or copy it again"
        ) from error
    require_heights(path, found.z)
    if pixel_size is None:
        return found
    if found.calibrated:
        raise MapError(f"{path} states the size of its pixels: do not give pixel_size={pixel_size}")
    sizes = tuple(np.ravel(pixel_size).tolist())
    if len(sizes) > 2:
        raise MapError(f"{path} is given {len(sizes)} pixel sizes, the limit is 2: give one, or one along x and y each")
    return found.scaled(sizes if len(sizes) == 2 else sizes[0])


def _given(unit: str | None, lateral_unit: str | None) -> str:
    return f"unit={unit!r}" if unit else f"lateral_unit={lateral_unit!r}"


def contents(path: Path) -> bytes:
    """Return the bytes of a file that can be a map."""
    try:
        size = path.stat().st_size if path.is_file() or not path.exists() else -1
        data = path.read_bytes() if 0 < size <= LARGEST_FILE else b""
    except (OSError, MemoryError, ValueError) as error:
        said = getattr(error, "strerror", None) or error
        raise MapError(f"{path} cannot be read ({said}): check its name and place") from error
    if size < 0:
        raise MapError(f"{path} is no file: name the instrument's file itself")
    if not data:
        raise MapError(f"{path} has {size:,} bytes, the limits are 1 and {LARGEST_FILE:,}: export it again, or crop it")
    return data


def _reader_of(path: Path, data: bytes) -> tuple[Callable[[Path, bytes], HeightMap], str]:
    """Return what reads a file and what the file is."""
    suffix = path.suffix.lower()
    for begins, reader, kind in SIGNATURES:
        if data.startswith(begins):
            return reader, kind
    if sdf.SIGNATURE.match(data):
        return sdf.read, "SDF"
    if suffix in other.SUFFIXES:
        return other.read, f"an instrument's file ({suffix})"
    if data.startswith(b"PK\x03\x04"):
        return _reader_of_archive(path, data)
    return (other.refuse, "an instrument's file") if suffix == other.DISPUTED else (_read_text, "text")


def _reader_of_archive(path: Path, data: bytes) -> tuple[Callable[[Path, bytes], HeightMap], str]:
    """Return what reads a zip archive, by what is in it."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
    except DAMAGE as error:
        raise MapError(
            f"{path} is an archive that cannot be opened: it is cut short or damaged, so copy it again"
        ) from error
    if any(name.endswith("main.xml") for name in names):
        return x3p.read, "x3p"
    if any(name.endswith(".npy") for name in names):
        return arrays.read_named, "NumPy .npz"
    raise MapError(f"{path} is an archive of {len(names)} files, neither an .x3p nor an .npz: unpack or export the map")


def _read_text(path: Path, data: bytes, unit: str | None = None, lateral_unit: str | None = None) -> HeightMap:
    """Read a text, of whatever kind it is; the units are for numbers that it gives none."""
    text = text_of(data)
    if text is None:
        raise MapError(
            f"{path} is of no known format: maps are .dat, .datx, .asc, .xyz, .x3p, .sdf, .sur, .npz, .npy, .csv or, "
            "with the extra 'formats', .opd, .plu, .al3d and others"
        )
    own = zygo_text.read if text.startswith((zygo_text.PHASES, zygo_text.POINTS)) else None
    own = grid_sag.read if grid_sag.is_grid_sag(text) else own
    if own is None:
        return points.read(path, text, unit, lateral_unit)
    if unit or lateral_unit:
        raise MapError(f"{path} states its own units: do not give {_given(unit, lateral_unit)}")
    return own(path, text)


SIGNATURES = (
    (metropro.SIGNATURES, metropro.read, "Zygo MetroPro"),
    (datx.SIGNATURE, isolated.read_datx, "Zygo .datx"),
    (digital_surf.SIGNATURES, digital_surf.read, "Digital Surf"),
    (arrays.SIGNATURE, arrays.read_bare, "NumPy .npy"),
)
"""What files begin with, what reads them, and what they are."""
