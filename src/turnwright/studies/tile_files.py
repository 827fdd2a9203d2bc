"""A tiled map as a zarr group.

``level_0`` holds the map, ``level_1`` and higher its overviews, each with ``z`` in files of one tile (uncompressed:
the last digits of heights are noise), and ``x`` and ``y``. ``tiles`` holds one record for each tile, which is written
last; a tile without a record is unfinished. In a folder and in an object store every file appears complete or not at
all.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from turnwright import _validate as validate
from turnwright._arrays import Bools, Floats
from turnwright.errors import InputError, StudyError
from turnwright.studies.store import DISK_FULL
from turnwright.studies.tile_layout import Layout

if TYPE_CHECKING:
    import zarr

__all__ = [
    "EDGE_START",
    "MOTION_FOLDER",
    "PART_PIXELS",
    "PLANE_SUMS",
    "Files",
    "bytes_needed",
    "remove_motion",
    "require_room",
    "require_same_map",
    "resolve_place",
    "translate_disk_errors",
]

FORMAT = 1
MOTION_FOLDER = ".motion"
"""Folder of the arrays of the motion while workers need them."""

PLANE_SUMS = 12
"""Number of sums of a tile by `plane_sums`."""

PART_PIXELS = PLANE_SUMS
"""Index in a record of the number of pixels of the part in the tile."""

EDGE_START = PLANE_SUMS + 1
"""Index in a record of the first row of heights, followed by the first column."""


@dataclass(frozen=True, slots=True)
class Files:
    """The arrays of a tiled map."""

    place: str  # folder or URL
    about: dict[str, Any]  # attributes of the group
    layout: Layout  # grid of the map
    levels: tuple[zarr.Array[Any], ...]  # heights of the map and of its overviews
    records: zarr.Array[Any]  # numbers of each tile. (tile rows, tile columns, numbers)

    @classmethod
    def open(cls, place: str, *, write: bool = False) -> Self:
        """Open a map, complete or not."""
        group = _group(place, mode="r+" if write else "r")
        about = _read_attributes(group)
        if group is None or about is None or about.get("format") != FORMAT:
            raise InputError(f"{place!r} holds no tiled map of format {FORMAT}: name a store that generate_tiled made")
        layout = Layout.read(about["layout"])
        return cls(
            place,
            about,
            layout,
            tuple(_array(group, f"level_{level}/z") for level in range(layout.levels)),
            _array(group, "tiles"),
        )

    @classmethod
    def begin(cls, place: str, layout: Layout, about: dict[str, Any]) -> Self:
        """Create the arrays of a map, or open an incomplete one."""
        import zarr  # noqa: PLC0415 - costly, and only for whole parts

        require_same_map(place, layout)
        group = _group(place, mode="r+")
        about_stored = _read_attributes(group)
        if about_stored is None:
            attributes = {**about, "format": FORMAT, "layout": layout.plain(), "complete": False}
            group = zarr.open_group(place, mode="w-", attributes={"turnwright": attributes})
        elif about_stored.get("key") != about["key"]:
            raise _other_map_error(place)
        assert group is not None  # noqa: S101 - opened or made
        for level in range(layout.levels):
            _create_level(group, layout, level)
        if "tiles" not in group:
            numbers = EDGE_START + sum(layout.tile)
            group.create_array(
                "tiles", shape=(*layout.count, numbers), chunks=(1, 1, numbers), dtype="float64", compressors=None,
                fill_value=np.nan,
            )  # fmt: skip
        return cls.open(place, write=True)

    def finished(self) -> Bools:
        """Return which tiles are finished. (tile rows, tile columns)."""
        return np.asarray(~np.isnan(self.read_records()[:, :, 0]))

    def read_records(self) -> Floats:
        """Return the records, nan for unfinished tiles. (tile rows, tile columns, numbers)."""
        return np.asarray(self.records[:], dtype=np.float64)

    def complete(self) -> None:
        """Mark the map as complete."""
        group = _group(self.place, mode="r+")
        assert group is not None  # noqa: S101 - it was opened before
        group.attrs["turnwright"] = {**self.about, "complete": True}


def require_same_map(place: str, layout: Layout) -> None:
    """Raise if a place holds anything but a map on the same grid, with any tile size."""
    if "://" not in place and not os.path.lexists(place):
        return
    group = _group(place)
    about = _read_attributes(group)
    if about is None:
        if group is not None or ("://" not in place and any(Path(place).iterdir())):
            raise InputError(f"{place!r} already exists and holds other files: choose another folder")
    elif about.get("format") != FORMAT or Layout.read(about["layout"]).in_tiles(layout.tile) != layout:
        raise _other_map_error(place)


def _other_map_error(place: str) -> InputError:
    return InputError(
        f"{place!r} holds the map of another motion, tool, surface or grid, or one of another version: name another "
        "place, or delete it"
    )


def resolve_place(store: str | os.PathLike[str]) -> str:
    """Return the absolute path of a folder, or a URL unchanged."""
    place = validate.path(store, "the store").removeprefix("file://")
    return place if "://" in place else str(Path(place).expanduser().absolute())


def _group(place: str, mode: str = "r") -> zarr.Group | None:
    import zarr  # noqa: PLC0415 - costly, and only for whole parts

    try:
        return zarr.open_group(place, mode=mode)  # type: ignore[arg-type]
    except (FileNotFoundError, zarr.errors.GroupNotFoundError):
        return None
    except ImportError:
        raise InputError(
            f"a map at {place!r} needs fsspec, which is not installed: pip install 'turnwright[cluster]', or name a "
            "folder"
        ) from None
    except (ValueError, KeyError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{place!r} cannot be used as a store ({reason}): name a folder, or see fsspec") from None


def _read_attributes(group: zarr.Group | None) -> dict[str, Any] | None:
    about = None if group is None else group.attrs.asdict().get("turnwright")
    return dict(about) if isinstance(about, dict) else None


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    import zarr  # noqa: PLC0415

    array = group.get(name)
    if not isinstance(array, zarr.Array):
        raise InputError(f"the map {str(group.store)!r} lacks {name}: generate it again")
    return array


def _create_level(group: zarr.Group, layout: Layout, level: int) -> None:
    within = group.require_group(f"level_{level}")
    for name, axis in zip("xy", layout.axes(level), strict=True):
        if name not in within:
            one = within.create_array(
                name, shape=axis.shape, chunks=axis.shape, dtype="float64", compressors=None,
                dimension_names=(name,), attributes={"units": "mm"},
            )  # fmt: skip
            one[:] = axis
    if "z" not in within:
        within.create_array(
            "z", shape=layout.level_shape(level), chunks=layout.level_chunk(level), dtype="float64", compressors=None,
            fill_value=np.nan, dimension_names=("y", "x"), attributes={"units": "mm"},
        )  # fmt: skip


def bytes_needed(layout: Layout) -> int:
    """Return the size of a map with its overviews and records. [byte]."""
    tiles = sum(1 for _ in layout.tiles())
    pixels = layout.tile[0] * layout.tile[1]
    overviews = sum(4.0**-level for level in range(layout.levels))
    return int(8 * tiles * (pixels * overviews + EDGE_START + sum(layout.tile)))


def remove_motion(place: str) -> None:
    """Remove the arrays of the motion."""
    if "://" not in place:
        shutil.rmtree(Path(place) / MOTION_FOLDER, ignore_errors=True)
        return
    from fsspec.core import url_to_fs  # noqa: PLC0415 - of an extra

    files, root = url_to_fs(place)
    with suppress(FileNotFoundError):
        files.rm(f"{root}/{MOTION_FOLDER}", recursive=True)


def require_room(place: str, layout: Layout) -> None:
    """Raise if the disk has too little space for a new map."""
    if "://" in place or (Path(place) / "zarr.json").exists():
        return
    folder = Path(place).absolute()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    # An estimate first: a grid that is far too fine has too many tiles to list.
    needed = 32 / 3 * layout.shape[0] * layout.shape[1] * (1.0 if layout.radius is None else math.pi / 4)
    if needed < free:
        needed = bytes_needed(layout)
    if needed > free:
        raise InputError(
            f"the map of {layout.shape[1]} x {layout.shape[0]} pixels needs {needed / 1e9:.3g} GB, the disk of "
            f"{str(folder)!r} has {free / 1e9:.3g} GB: free some space, name another disk, or use a larger pixel"
        )


@contextmanager
def translate_disk_errors(place: str, done: int, total: int) -> Iterator[None]:
    """Translate an error of the file system into a `StudyError`."""
    try:
        yield
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise StudyError(
                f"{place!r} cannot be used ({error.strerror or error}), {done} of {total} tiles are finished and "
                "kept: check its name and permissions"
            ) from error
        raise StudyError(
            f"the disk of {place!r} is full with {done} of {total} tiles finished and kept: free some space and "
            "start again"
        ) from error
