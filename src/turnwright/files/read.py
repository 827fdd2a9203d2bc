"""Reading maps of any format, detected by signature or suffix."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from os import PathLike
from pathlib import Path

import numpy as np

from turnwright.errors import MapError
from turnwright.files import (
    arrays,
    codev,
    datx,
    digital_surf,
    grid_sag,
    metropro,
    other,
    plu,
    points,
    sdf,
    x3p,
    zygo_text,
)
from turnwright.files.base import DAMAGE, damaged, read_contents, require_heights
from turnwright.files.numbers import text_of
from turnwright.heightmap import HeightMap

__all__ = ["read_map"]


def read_map(
    file: str | PathLike[str],
    *,
    pixel_size: float | tuple[float, float] | None = None,
    unit: str | None = None,
    lateral_unit: str | None = None,
) -> HeightMap:
    """Read a measured map from the file of an instrument.

    The format is detected by the first bytes, otherwise by the suffix; the page on map formats lists them.

    Parameters
    ----------
    file
        The instrument's file.
    pixel_size
        Pixel size along x and y, or one size for both, for a file without one. Otherwise such a map is in pixels and
        not `calibrated`. [mm]
    unit
        Unit of the numbers in a text file without units, such as "um".
    lateral_unit
        Unit of x and y, where ``unit`` is that of the heights; empty to accept only a unit in the file.

    Returns
    -------
    HeightMap
        In mm, rows ascending in y, nan where nothing was measured; points that are not on a grid are scattered. Its
        ``metadata`` are further entries of the file.

    Raises
    ------
    MapError
        If the file cannot be read, is damaged or ambiguous, or a pixel size or unit is given for a file that has its
        own.
    """
    path = Path(file)
    data = read_contents(path)
    reader, kind = _reader_of(path, data)
    if reader is not _read_text and (unit or lateral_unit):
        raise MapError(f"{path} is {kind} and states its own units: do not give {_unit_option(unit, lateral_unit)}")
    try:
        # Numbers that overflow become missing points.
        with np.errstate(over="ignore", invalid="ignore"):
            units = {"unit": unit, "lateral_unit": lateral_unit} if reader is _read_text else {}
            heights = reader(path, data, **units)
    except MapError:
        raise
    except DAMAGE as error:
        reason = str(error).split("\n")[0].rstrip(".")[:200] or type(error).__name__
        raise damaged(path, f"cannot be read as {kind} ({reason})") from error
    require_heights(path, heights.z)
    if pixel_size is None:
        return heights
    if heights.calibrated:
        raise MapError(f"{path} states its pixel size: do not give pixel_size={pixel_size}")
    sizes = tuple(np.ravel(pixel_size).tolist())
    if len(sizes) > 2:
        raise MapError(
            f"pixel_size has {len(sizes)} values for {path}, it must be one, or one each for x and y: correct it"
        )
    return heights.scaled(sizes if len(sizes) == 2 else sizes[0])


def _unit_option(unit: str | None, lateral_unit: str | None) -> str:
    return f"unit={unit!r}" if unit else f"lateral_unit={lateral_unit!r}"


def _reader_of(path: Path, data: bytes) -> tuple[Callable[[Path, bytes], HeightMap], str]:
    suffix = path.suffix.lower()
    for begins, reader, kind in SIGNATURES:
        if data.startswith(begins):
            return reader, kind
    if sdf.SIGNATURE.match(data):
        return sdf.read, "SDF"
    if suffix == plu.SUFFIX:
        return plu.read, "Sensofar .plu"
    if suffix in other.SUFFIXES:
        return other.read, f"an instrument's file ({suffix})"
    if data.startswith(b"PK\x03\x04"):
        return _reader_of_archive(path, data)
    return (other.refuse, "an instrument's file") if suffix == other.DISPUTED else (_read_text, "text")


def _reader_of_archive(path: Path, data: bytes) -> tuple[Callable[[Path, bytes], HeightMap], str]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
    except DAMAGE as error:
        raise damaged(path, "is an archive that cannot be opened") from error
    if any(name.endswith("main.xml") for name in names):
        return x3p.read, "x3p"
    if any(name.endswith(".npy") for name in names):
        return arrays.read_named, "NumPy .npz"
    raise MapError(f"{path} is an archive of {len(names)} files, neither an .x3p nor an .npz: unpack or export the map")


def _read_text(path: Path, data: bytes, unit: str | None = None, lateral_unit: str | None = None) -> HeightMap:
    """Read a text file of any format; the units are for numbers without a unit in the text."""
    text = text_of(data)
    if text is None:
        raise MapError(
            f"{path} has an unknown format: maps are .dat, .datx, .asc, .xyz, .int, .x3p, .sdf, .sur, .plu, .npz, "
            ".npy, .csv or, with the extra 'formats', .opd, .al3d and others"
        )
    reader = zygo_text.read if text.startswith((zygo_text.PHASES, zygo_text.POINTS)) else None
    reader = grid_sag.read if grid_sag.is_grid_sag(text) else reader
    reader = codev.read if codev.is_interferogram(text) else reader
    if reader is None:
        return points.read(path, text, unit, lateral_unit)
    if unit or lateral_unit:
        raise MapError(f"{path} states its own units: do not give {_unit_option(unit, lateral_unit)}")
    return reader(path, text)


SIGNATURES = (
    (metropro.SIGNATURES, metropro.read, "Zygo MetroPro"),
    (datx.SIGNATURE, datx.read, "Zygo .datx"),
    (digital_surf.SIGNATURES, digital_surf.read, "Digital Surf"),
    (arrays.SIGNATURE, arrays.read_bare, "NumPy .npy"),
)
"""Signatures, readers and names of formats."""
