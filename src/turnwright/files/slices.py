"""Reading profiles: slices in text files, and map files with one line."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import whole_number
from turnwright.errors import MapError
from turnwright.files.base import read_contents, require_heights
from turnwright.files.lattice import even_places
from turnwright.files.numbers import text_of
from turnwright.files.points import read_slice
from turnwright.files.read import read_map
from turnwright.profile import Profile

__all__ = ["read_profile"]


def read_profile(
    file: str | PathLike[str],
    *,
    distance: str | None = None,
    height: str | None = None,
    unit: str | None = None,
    lateral_unit: str | None = None,
    number: int | None = None,
) -> Profile:
    """Read a measured profile: a slice in a text file, or a map file with one line, such as ``.sdf``.

    In a text file each row has a distance and a height, in two numeric columns or in the columns requested. They are
    identified by their names in any order: X, distance or position, and Z or height; a column named Y may be either.
    Columns with other names are taken in the order distance, height. Columns of text, such as the name of the slice,
    are ignored. Where the distances begin again, another slice begins. Rows with falling distances are sorted.
    Distances that are evenly spaced to their last decimal are made exactly even, with nan where a row is missing.

    Parameters
    ----------
    file
        The instrument's file.
    distance, height
        Names of their columns, with or without the unit, in any case; or their numbers from 1.
    unit
        Unit of distances and heights where the text has none, such as "um".
    lateral_unit
        Unit of the distances, where ``unit`` is that of the heights.
    number
        Number of the slice, from 1, for a file with several.

    Returns
    -------
    Profile
        In mm; x is the distance, y is 0.

    Raises
    ------
    MapError
        If the file cannot be read, lacks the columns or a unit, holds a map, or holds several slices and no number is
        given.
    """
    path = Path(file)
    text = text_of(read_contents(path))
    if text is None or path.suffix.lower() in {".sdf", ".x3p"}:
        if (distance, height, unit, lateral_unit) != (None,) * 4:
            raise MapError(f"{path} is not text and defines its own axes: do not give columns or units")
        return _only_line(path)
    at, z, description = read_slice(path, text, (distance, height), unit, lateral_unit)
    require_heights(path, z)
    at, z = _one_slice(path, at, z, number)
    at, z = even_places(at, z)
    if at.size < 2:
        raise MapError(f"{path} has {at.size} points in its slice, a profile needs 2: export it again")
    metadata = {"format": "text", "description": description}
    return Profile(distance=at, z=z, x=at, y=np.zeros_like(at), name=path.name, metadata=metadata)


def _only_line(path: Path) -> Profile:
    heights = read_map(path)
    heights.require_calibrated()
    if heights.x is None or heights.z.ndim != 2 or 1 not in heights.z.shape:
        raise MapError(
            f"{path} holds a map, not a profile: show it without --profile, or extract a line (line_profile)"
        )
    at = heights.x if heights.z.shape[0] == 1 else heights.y
    assert at is not None  # noqa: S101 - a rectangular grid has x and y
    return Profile(
        distance=at, z=heights.z.ravel(), x=at, y=np.zeros_like(at), name=path.name, metadata=heights.metadata
    )


def _one_slice(path: Path, at: Floats, z: Floats, number: int | None) -> tuple[Floats, Floats]:
    step = np.diff(at)
    falling = bool(step.size and (step < 0).mean() > 0.5)
    begins = np.flatnonzero((step >= 0) if falling else (step <= 0)) + 1
    count = begins.size + 1
    if number is None and count > 1:
        raise MapError(f"{path} holds {count} slices, a profile is one: give its number (number=1, ...)")
    chosen = whole_number(1 if number is None else number, "the number of the slice", 1, count) - 1
    ends = [0, *begins.tolist(), at.size]
    rows = np.arange(ends[chosen], ends[chosen + 1])[:: -1 if falling else 1]
    return at[rows], z[rows]
