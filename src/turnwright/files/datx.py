"""Zygo ``.datx``: HDF5 with one surface under ``Data/Surface`` and its calibration in attributes.

Heights are stored in a unit of length, or in fringes, times scale factor, wavelength and obliquity. The first row is
the top of the camera's picture.

Sources
-------
Oracles: a file of a Fizeau interferometer on which prysm and an independent reader agree; files made with h5py.
"""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright._arrays import Floats
from turnwright._io import read_isolated
from turnwright.errors import MapError
from turnwright.files import arrays
from turnwright.files.base import check_inflated_size, damaged, grid_map, require_points, to_mm
from turnwright.heightmap import HeightMap

if TYPE_CHECKING:
    import h5py

__all__ = ["SIGNATURE", "read"]

SIGNATURE = b"\x89HDF\r\n\x1a\n"
PREFIX = "Data Context.Data Attributes."
LARGE_MARK = 1e30
"""Marks of missing points from this value are compared by >=, as they are stored with few digits."""

MAX_TEXT_CHARACTERS = 500
"""Characters of an attribute in the metadata."""


def read(path: Path, data: bytes) -> HeightMap:
    """Read a datx file in a separate process."""
    return arrays.read_named(path, read_isolated(_read, path, data, refusal=MapError))


def _read(path: Path, data: bytes) -> bytes:
    import h5py  # noqa: PLC0415 - costly to import

    with h5py.File(io.BytesIO(data), "r") as file:
        surface = _surface(path, file)
        rows, columns = surface.shape
        require_points(path, columns, rows)
        check_inflated_size(path, len(data), surface.id.get_storage_size())
        check_inflated_size(path, len(data), rows * columns * surface.dtype.itemsize)
        scale = _height_unit(path, surface)
        stored = np.asarray(surface[()][::-1], dtype=np.float64)
        missing = ~np.isfinite(stored)
        no_data = surface.attrs.get("No Data")
        if no_data is not None:
            mark = float(np.ravel(no_data)[0])
            missing |= stored >= mark if mark > LARGE_MARK else stored == mark
        heights: Floats = np.where(missing, np.nan, stored * np.where(missing, 0.0, scale))
        metadata = {"format": "Zygo .datx", **_metadata(file), "stored in": _unit(surface)}
        return arrays.pack(grid_map(path, heights, _pixel(path, surface), metadata=metadata))


def _surface(path: Path, file: h5py.File) -> h5py.Dataset:
    import h5py  # noqa: PLC0415

    group = file.get("Data/Surface")
    if not isinstance(group, h5py.Group):
        raise MapError(f"{path} is HDF5 without a group Data/Surface, where .datx files keep heights: export it again")
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        dataset = group[name]
        if not isinstance(dataset, h5py.Dataset) or dataset.external is not None or dataset.is_virtual:
            continue  # stored in other files
        if len(dataset.shape) == 2 and dataset.dtype.kind in "fiu":
            return dataset
    raise MapError(f"{path} has no table of heights in its group Data/Surface: export it again with its surface")


def _text(value: Any) -> str:
    entry = np.ravel(np.asarray(value, dtype=object))[0]
    return (entry.decode("utf-8", "replace") if isinstance(entry, bytes) else str(entry))[:MAX_TEXT_CHARACTERS]


def _unit(surface: h5py.Dataset) -> str:
    unit = surface.attrs.get("Unit")
    return "" if unit is None else _text(unit)


def _converter(surface: h5py.Dataset, name: str) -> tuple[str, str, Floats] | None:
    """Return category, unit and parameters of a converter."""
    attribute = surface.attrs.get(name)
    if attribute is None:
        return None
    category, unit, parameters = np.ravel(attribute)[0]
    return _text(category), _text(unit), np.asarray(parameters, dtype=np.float64)


def _height_unit(path: Path, surface: h5py.Dataset) -> float:
    unit = _unit(surface)
    converter = _converter(surface, "Z Converter")
    if not unit and converter is not None:
        unit = converter[1]
    if unit.lower() != "fringes":
        return to_mm(unit, f"{path} states its heights in")
    names = ("Wavelength", "Interferometric Scale Factor", "Obliquity Factor")
    attributes = [surface.attrs.get(name) for name in names]
    if any(attribute is None for attribute in attributes) and converter is not None and converter[2].size >= 4:
        attributes = list(converter[2][1:4])
    values = [math.nan if attribute is None else float(np.ravel(attribute)[0]) for attribute in attributes]
    if not all(math.isfinite(value) and value > 0 for value in values):
        listed = ", ".join(f"{name} {value:g}" for name, value in zip(names, values, strict=True))
        raise damaged(path, f"has heights in fringes with {listed}, all must be finite and above 0")
    return math.prod(values) * 1e3


def _pixel(path: Path, surface: h5py.Dataset) -> tuple[float, float] | None:
    """Return the pixel size; ``None`` for a camera that was not calibrated [mm]."""
    sizes = []
    for name in ("X Converter", "Y Converter"):
        converter = _converter(surface, name)
        if converter is None:
            return None
        category, unit, parameters = converter
        if category != "LateralCat" or unit != "Pixels" or parameters.size < 2:
            raise MapError(
                f"{path} has the {name} {category} in {unit} with {parameters.size} numbers, it must be LateralCat in "
                "Pixels with at least 2: export it from the instrument's software again"
            )
        sizes.append(float(parameters[1]) * 1e3)
    return None if sizes == [0.0, 0.0] else (sizes[0], sizes[1])


def _metadata(file: h5py.File) -> dict[str, str]:
    import h5py  # noqa: PLC0415

    metadata: dict[str, str] = {}
    groups = file.get("Attributes")
    if not isinstance(groups, h5py.Group):
        return metadata
    for name in groups:
        if not isinstance(groups.get(name, getlink=True), h5py.HardLink):
            continue
        entries = groups[name].attrs
        for key in entries:
            label = key.removeprefix(PREFIX)
            if not key.startswith(PREFIX) or label.startswith("attr.") or label.endswith(":Unit"):
                continue
            value = entries[key]
            unit = entries.get(f"{key.removesuffix(':Value')}:Unit") if key.endswith(":Value") else None
            if np.asarray(value).dtype.kind in "fiuOSU" and np.asarray(value).size == 1:
                text = f"{_text(value)} {'' if unit is None else _text(unit)}".strip()
                metadata[label.removesuffix(":Value").lower()] = text
    return metadata
