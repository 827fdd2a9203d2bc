"""ISO 25178-72 ``.x3p``, a zip archive of XML and binary heights in metres, read and written by x3pio.

Rows ascend in y, as in the standard. The shift of a surface is applied; its rotation is kept as text, as registration
determines the part pose. Written files have the revision "ISO5436 - 2000", which every reader accepts.

Sources
-------
Oracles: files of MountainsMap, openGPS and the standard, on which x3pio, SurfaceTopography and surfalize agree.
"""

from __future__ import annotations

import io
import zipfile
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.errors import MapError
from turnwright.files.base import check_inflated_size, even_axes, grid_map, require_points
from turnwright.heightmap import HeightMap

if TYPE_CHECKING:
    import x3pio

__all__ = ["pack", "read"]

MAX_XML_BYTES = 64 << 20
"""Bytes of XML; in memory it takes many times as many."""

RECORD_KEYS = ("creator", "comment", "manufacturer", "model", "serial", "version", "date")
"""Metadata with a field of their own in the file."""


def read(path: Path, data: bytes) -> HeightMap:
    """Read an x3p file."""
    import x3pio  # noqa: PLC0415 - needed by few

    _require_honest(path, data)
    file = x3pio.X3pFile.loads(data)
    if len(file.layers) != 1:
        raise MapError(f"{path} holds {len(file.layers)} layers, only 1 is allowed: export a single layer")
    layer = file.layers[0]
    rotation, offset = layer.placement.rotation, layer.placement.offset * 1e3
    is_rotated = bool(np.abs(rotation - np.eye(3)).max() > 1e-12)
    metadata = {"format": "ISO 25178-72 .x3p", **_metadata(file)}
    if is_rotated:
        metadata["placement"] = f"rotation {rotation.tolist()}, offset {offset.tolist()} mm, not applied"
        offset = np.zeros(3)
    heights = layer.z * 1e3
    if offset[2] != 0:
        heights += offset[2]
    if not layer.is_regular_grid:
        points = layer.points(coordinate_system=x3pio.CoordinateSystem.VIEW).reshape(-1, 3) * 1e3 + offset
        measured = np.isfinite(points).all(axis=1)
        x, y, z = points[measured].T
        return HeightMap(x=x, y=y, z=z, name=path.name, metadata=metadata)
    heights = np.atleast_2d(heights)
    require_points(path, heights.shape[1], heights.shape[0])
    header = layer.header
    pixel = (header.x.increment * 1e3, (header.x if heights.shape[0] == 1 else header.y).increment * 1e3)
    return grid_map(path, heights, pixel, start=(float(offset[0]), float(offset[1])), metadata=metadata)


def _require_honest(path: Path, data: bytes) -> None:
    """Raise if the archive states more than any map needs; `zipfile` unpacks no more than is stated."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            check_inflated_size(path, member.compress_size, member.file_size)
            if member.filename.lower().endswith(".xml") and member.file_size > MAX_XML_BYTES:
                raise MapError(
                    f"{path} has {member.file_size:,} bytes of XML, the limit is {MAX_XML_BYTES:,}: export it with "
                    "binary heights"
                )


def _metadata(file: x3pio.X3pFile) -> dict[str, str]:
    record = file.metadata
    if record is None:
        return {}
    return {
        "creator": record.creator or "",
        "date": record.date.isoformat() if record.date else "",
        "manufacturer": record.instrument.manufacturer,
        "model": record.instrument.model,
        "serial": record.instrument.serial,
        "version": record.instrument.version,
        "probing system": record.probing_system.identification,
        "calibration date": record.calibration_date.isoformat() if record.calibration_date else "",
        "comment": record.comment or "",
    }


def pack(heights: HeightMap) -> bytes:
    """Return the bytes of an x3p file of a map on an even grid."""
    import x3pio  # noqa: PLC0415

    start, pixel = even_axes(heights, ".x3p")
    file = x3pio.Surface.from_array(
        heights.z * 1e-3,
        x_scale=pixel[0] * 1e-3,
        y_scale=pixel[1] * 1e-3,
        placement=x3pio.Placement.translation(start[0] * 1e-3, start[1] * 1e-3, 0.0),
        coordinate_system=x3pio.CoordinateSystem.VIEW,
        metadata=_record(heights),
        revision=x3pio.Revision.ISO5436_2000,
    )
    data: bytes = file.dumps()
    return data


def _plain(text: str) -> str:
    """Return a text without characters that XML does not allow."""
    return "".join(letter if letter.isprintable() or letter == "\n" else " " for letter in text)


def _record(heights: HeightMap) -> Any:
    """Return the metadata of a map as an x3p record; entries without a field go into the comment."""
    import x3pio  # noqa: PLC0415

    texts = {key: _plain(heights.metadata.get(key, "")) for key in RECORD_KEYS}
    others = [_plain(f"{key}: {text}") for key, text in heights.metadata.items() if key not in {*RECORD_KEYS, "format"}]
    try:
        date = datetime.fromisoformat(texts["date"])
    except ValueError:
        date = None
    record = x3pio.Metadata.for_software("Turnwright", version("turnwright"), date=date)
    instrument = record.instrument
    if texts["manufacturer"] or texts["model"]:
        instrument = x3pio.Instrument(texts["manufacturer"], texts["model"], texts["serial"], texts["version"])
    comment = "\n".join(line for line in (texts["comment"], *others) if line)
    return x3pio.Metadata(
        date=record.date,
        creator=texts["creator"] or None,
        instrument=instrument,
        calibration_date=None,
        probing_system=record.probing_system,
        comment=comment or _plain(heights.name) or None,
    )
