"""Writing maps; the suffix selects the format."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from turnwright._io import write_atomic
from turnwright.errors import MapError
from turnwright.files import arrays, grid_sag, x3p
from turnwright.heightmap import HeightMap

__all__ = ["write_map"]

WRITERS = {".x3p": x3p.pack, ".npz": arrays.pack, ".dat": grid_sag.pack, ".grd": grid_sag.pack}


def write_map(map: HeightMap, file: str | PathLike[str]) -> None:  # noqa: A002 - the field's word
    """Write a map in the format of the file's suffix; an existing file is replaced.

    ``.npz`` stores every map exactly. ``.x3p`` (ISO 25178-72, revision "ISO5436 - 2000") and ``.dat`` or ``.grd``
    (Zemax grid sag) store evenly spaced rectangular grids, to rounding.

    Parameters
    ----------
    map
        The map to write.
    file
        Path with the suffix ``.npz``, ``.x3p``, ``.dat`` or ``.grd``.

    Raises
    ------
    MapError
        If the suffix is unknown, the format cannot hold the map, or the file cannot be written.

    Sources
    -------
    Oracle: x3pio and SurfaceTopography read the x3p back.
    """
    path = Path(file)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise MapError(
            f"{path} has the suffix {path.suffix!r}, maps are written as {', '.join(WRITERS)}: choose one of these"
        )
    data = writer(map)
    try:
        write_atomic(path, data)
    except OSError as error:
        raise MapError(f"{path} cannot be written ({error.strerror}): check its folder and permissions") from error
