"""NumPy files: ``.npz`` holds a complete map, ``.npy`` a grid of heights only.

Both are in mm, and rows ascend in y. An ``.npz`` has arrays ``z`` and ``x``, ``y`` or ``radius``, ``angle``, and may
have ``name``, ``calibrated`` and ``metadata`` (text of a JSON object); x and y may be meshes, and may descend. An
``.npy`` has no pixel size.
"""

from __future__ import annotations

import io
import json
import math
import re
import struct
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import MapError, quote
from turnwright.files.base import (
    MAX_POINTS,
    check_inflated_size,
    damaged,
    finite_or_missing,
    grid_map,
    require_bytes,
    require_points,
)
from turnwright.heightmap import HeightMap

__all__ = ["SIGNATURE", "pack", "read_bare", "read_named"]

SIGNATURE = b"\x93NUMPY"
HEAD = re.compile(
    rb"\{'descr': '(?P<kind>[<>|=](?:b1|[iu][1248]|f[248]|f16|U\d{1,7}))', 'fortran_order': (?P<columns>True|False), "
    rb"'shape': \((?P<shape>(?:\d{1,18}+(?:, ?|(?=\))))*+)\),? ?\}\s*+"
)
"""Header of an array, as NumPy writes it; matched by a pattern, as it is Python source."""

MAX_HEAD_BYTES = 1 << 16
MAX_LISTED_NAMES = 8
"""Names of arrays in a message."""

AXES = (("x", "y"), ("radius", "angle"))


def read_bare(path: Path, data: bytes) -> HeightMap:
    """Read a table of heights."""
    heights = _numbers(path, "heights", _array(path, io.BytesIO(data), len(data)))
    if heights.ndim != 2 or heights.shape[1] == 3:
        raise MapError(
            f"{path} holds an array of shape {heights.shape}, which may be points or a grid of heights: save it as "
            ".npz with x, y and z"
        )
    require_points(path, heights.shape[1], heights.shape[0])
    return grid_map(path, heights, None, metadata={"format": "NumPy .npy"})


def read_named(path: Path, data: bytes) -> HeightMap:
    """Read named arrays."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        names = next((pair for pair in AXES if {"z", *pair} <= members.keys()), None)
        if names is None:
            listed = [quote(name) for name in sorted(members)]
            more = f" and {len(listed) - MAX_LISTED_NAMES} more" if len(listed) > MAX_LISTED_NAMES else ""
            raise MapError(
                f"{path} holds the arrays {', '.join(listed[:MAX_LISTED_NAMES])}{more}, it needs z with x and y, or z "
                "with radius and angle: save it with these names"
            )
        loaded = {
            name: _member(path, archive, members[name])
            for name in ("z", *names, "name", "calibrated", "metadata")
            if name in members
        }
    z, column, row = (_numbers(path, name, loaded[name]) for name in ("z", *names))
    z = finite_or_missing(z)
    if column.ndim == row.ndim == z.ndim == 2:
        z, column, row = _from_meshes(path, z, column, row)
    if z.ndim == 2:
        z, column, row = _sort_axes(path, names, z, column, row)
    calibrated = loaded.get("calibrated")
    return HeightMap(
        z=z,
        **{names[0]: column, names[1]: row},
        name=str(loaded["name"]) if "name" in loaded else path.name,
        calibrated=calibrated is None or bool(calibrated.all()),
        metadata=_metadata(path, loaded.get("metadata")),
    )


def _member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray[Any, Any]:
    check_inflated_size(path, member.compress_size, member.file_size)
    with archive.open(member) as stream:
        return _array(path, stream, member.file_size)


def _array(path: Path, stream: IO[bytes], size: int) -> np.ndarray[Any, Any]:
    """Return the array in a stream of ``size`` bytes: numbers, Booleans or text, never Python objects."""
    start = stream.read(8)
    length = struct.Struct("<H" if start[6:7] == b"\1" else "<I")
    raw = stream.read(length.size)
    if not start.startswith(SIGNATURE) or len(raw) < length.size:
        raise damaged(path, "holds an array without the signature of NumPy")
    head = HEAD.fullmatch(stream.read(min(length.unpack(raw)[0], MAX_HEAD_BYTES)))
    if head is None:
        raise MapError(
            f"{path} holds an array that is not of real numbers, or its header is damaged: save it as float64"
        )
    dtype = np.dtype(head["kind"].decode())
    shape = tuple(int(count) for count in head["shape"].split(b",") if count.strip())
    count = math.prod(shape)
    if count > MAX_POINTS:
        raise MapError(f"{path} has an array of shape {shape}, the limit is {MAX_POINTS:,} values: crop it")
    require_bytes(path, count * dtype.itemsize, size)
    raw = stream.read(count * dtype.itemsize)
    require_bytes(path, count * dtype.itemsize, len(raw))
    return np.frombuffer(raw, dtype, count).reshape(shape, order="F" if head["columns"] == b"True" else "C")


def _numbers(path: Path, name: str, array: np.ndarray[Any, Any]) -> Floats:
    if array.dtype.kind not in "iuf" or not 1 <= array.ndim <= 2 or not array.size:
        raise MapError(
            f"{path} holds {name} as {array.dtype} of shape {array.shape}, it must be numbers in 1 or 2 dimensions"
        )
    return np.array(array, dtype=np.float64)


def _from_meshes(path: Path, z: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Return a grid, or scattered points where the meshes are not rectangular."""
    if not x.shape == y.shape == z.shape:
        raise MapError(f"{path} holds x {x.shape}, y {y.shape} and z {z.shape}: give all three the same shape")
    if (x == x[0]).all() and (y == y[:, :1]).all():
        return z, x[0], y[:, 0]
    return z.ravel(), x.ravel(), y.ravel()


def _sort_axes(
    path: Path, names: tuple[str, str], z: Floats, column: Floats, row: Floats
) -> tuple[Floats, Floats, Floats]:
    if column.ndim != 1 or row.ndim != 1 or z.shape != (row.size, column.size):
        raise MapError(
            f"{path} holds z of shape {z.shape} with {names[0]} {column.shape} and {names[1]} {row.shape}: rows of z "
            f"are {names[1]}, columns {names[0]}"
        )
    require_points(path, column.size, row.size)
    if column.size > 1 and (np.diff(column) < 0).all():
        column, z = column[::-1], z[:, ::-1]
    if row.size > 1 and (np.diff(row) < 0).all():
        row, z = row[::-1], z[::-1]
    for name, axis in zip(names, (column, row), strict=True):
        if not (np.diff(axis) > 0).all():
            raise MapError(
                f"{path} has an axis {name} that does not ascend or has nan: sort it and remove repeated values"
            )
    return z, column, row


def _metadata(path: Path, stored: np.ndarray[Any, Any] | None) -> dict[str, str]:
    if stored is None:
        return {"format": "NumPy .npz"}
    entries = json.loads(str(stored))
    if not isinstance(entries, dict):
        raise MapError(f"{path} holds metadata that are not a JSON object: save them as one")
    return {str(key): str(text) for key, text in entries.items()}


def pack(heights: HeightMap) -> bytes:
    """Return the bytes of an ``.npz`` with a complete map."""
    names = AXES[heights.polar]
    buffer = io.BytesIO()
    np.savez(
        buffer,
        z=heights.z,
        **{name: getattr(heights, name) for name in names},
        name=np.array(heights.name),
        calibrated=np.array(heights.calibrated),
        metadata=np.array(json.dumps(dict(heights.metadata), ensure_ascii=False)),
    )
    return buffer.getvalue()
