"""One door for writing maps: the suffix says which format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from turnwright._io import write_whole
from turnwright.errors import MapError
from turnwright.files import arrays, grid_sag, x3p

if TYPE_CHECKING:
    from os import PathLike

    from turnwright.heightmap import HeightMap

__all__ = ["write_map"]

WRITERS = {".x3p": x3p.packed, ".npz": arrays.packed, ".dat": grid_sag.packed, ".grd": grid_sag.packed}


def write_map(map: HeightMap, file: str | PathLike[str]) -> None:  # noqa: A002 - the field's word
    """Write a map, in the format that the suffix of the file says; what stood there before is replaced.

    ``.npz`` keeps every map whole, bit by bit. ``.x3p`` (ISO 25178-72, revision "ISO5436 - 2000") and ``.dat`` or
    ``.grd`` (Zemax grid sag) hold rectangular grids with even steps, and give them back to rounding.

    Parameters
    ----------
    map
        What to write.
    file
        Its name ends in ``.npz``, ``.x3p``, ``.dat`` or ``.grd``.

    Raises
    ------
    MapError
        If the suffix is another one, the format cannot hold the map, or the file cannot be written.

    Sources
    -------
    Oracle: x3pio and SurfaceTopography read the x3p back.
    """
    path = Path(file)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise MapError(
            f"{path} ends in {path.suffix!r}, maps are written as {', '.join(WRITERS)}: choose one of these endings"
        )
    data = writer(map)
    try:
        write_whole(path, data)
    except OSError as error:
        raise MapError(f"{path} cannot be written ({error.strerror}): check its folder and your rights") from error
