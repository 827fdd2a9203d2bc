"""Writing maps: the format is stated, or follows from the suffix."""

from __future__ import annotations

import math
from os import PathLike
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from turnwright._arrays import Floats
from turnwright._validate import check_index, check_wavelength, one_of
from turnwright.errors import InputError, MapError
from turnwright.files import arrays, codev, grid_sag, metropro, x3p
from turnwright.files.base import is_front, too_high, write_file
from turnwright.heightmap import HeightMap
from turnwright.surface import Surface

__all__ = ["Face", "MapFormat", "write_grid_sag", "write_map"]

MapFormat: TypeAlias = Literal["npz", "x3p", "grid sag", "grid phase", "zygo", "codev"]
Face: TypeAlias = Literal["front", "back"]

WRITERS = {
    "npz": arrays.pack,
    "x3p": x3p.pack,
    "grid sag": grid_sag.pack,
    "grid phase": grid_sag.pack,
    "zygo": metropro.pack,
    "codev": codev.pack,
}
SUFFIXES = {".npz": "npz", ".x3p": "x3p", ".grd": "grid sag", ".int": "codev"}


def write_map(
    map: HeightMap,  # noqa: A002 - the field's word
    file: str | PathLike[str],
    *,
    format: MapFormat | None = None,  # noqa: A002 - the field's word
    base: Surface | None = None,
    face: Face | None = None,
    wavelength: float | None = None,
    index: float | None = None,
) -> None:
    r"""Write a map in a file format; an existing file is replaced.

    "npz" stores every map exactly. "x3p" (ISO 25178-72, revision "ISO5436 - 2000"), "grid sag" and "grid phase" (Zemax)
    store evenly spaced rectangular grids, to rounding; "zygo" (MetroPro) and "codev" (interferogram) those with square
    points, in counts. Zygo and CODE V files do not keep the position of the grid, CODE V files not its size.

    Grid sag and grid phase have the slopes of the bicubic spline through the heights; see `write_grid_sag` for those of
    a surface. The phase is :math:`2\pi(n-1)z/\lambda`, where z is along the outward normal of the material and n its
    index, and :math:`-4\pi z/\lambda` of a mirror: positive where the path of the light is longer, at normal incidence
    in air.

    Parameters
    ----------
    map
        The map to write.
    file
        Path. The suffix ``.npz``, ``.x3p``, ``.grd`` (grid sag) or ``.int`` (CODE V) states the format; ``.dat`` does
        not.
    format
        "npz", "x3p", "grid sag", "grid phase", "zygo" or "codev"; by default that of the suffix.
    base
        Surface to subtract first, in the part frame: the file then holds the departure, for a lens program that has the
        base itself.
    face
        "front" for the face of a lens file with its material on the +z side: the map is turned half a turn about the y
        axis (`HeightMap.turned_over`). "back", with the material on the -z side as in the part frame, and the default
        leave it.
    wavelength
        Of a grid phase, required there. [mm]
    index
        Of refraction of the part for a grid phase; ``None`` for a mirror.

    Raises
    ------
    MapError
        If the suffix does not state a format, the format cannot hold the map, or the file cannot be written.
    InputError
        If an option is not one of those allowed, or a wavelength is missing, or without use like an index.

    Sources
    -------
    [Zemax]_ for grid sag and grid phase. Oracles: x3pio and SurfaceTopography read the x3p back, prysm the Zygo and
    CODE V files; mpmath the slopes.
    """
    path = Path(file)
    front = is_front(face)
    if format is not None:
        one_of(format, "format", tuple(WRITERS))
    kind = format or SUFFIXES.get(path.suffix.lower())
    if kind is None:
        raise MapError(
            f"{path} has the suffix {path.suffix!r}, formats by suffix are {', '.join(SUFFIXES)}: choose one of these, "
            f"or state the format, {', '.join(WRITERS)}"
        )
    phase = _phase_per_height(kind, wavelength, index)
    heights = map if base is None else map.minus(base)
    if front:
        # The phase is a number at a point of the face, so that turning moves it but keeps its sign.
        heights, phase = heights.turned_over(), -phase
    _require_heights(heights)
    write_file(path, grid_sag.pack(heights, phase) if kind == "grid phase" else WRITERS[kind](heights))


def write_grid_sag(
    surface: Surface,
    file: str | PathLike[str],
    *,
    x: Floats,
    y: Floats,
    base: Surface | None = None,
    face: Face | None = None,
) -> None:
    """Write a surface, or its departure from a base, as Zemax grid sag with exact slopes; replaces an existing file.

    Where the surface or the base is not defined, the point is marked as missing.

    Parameters
    ----------
    surface, base
        In the part frame. A base that Zemax has itself leaves less to its bicubic interpolation.
    file
        Path, usually ``.dat``.
    x, y
        Evenly spaced columns (nx,) and rows (ny,) of the grid, in the part frame. [mm]
    face
        See `write_map`.

    Raises
    ------
    MapError
        If the axes are not even or too short, or the file cannot be written.

    Sources
    -------
    [Zemax]_. Oracle: mpmath.
    """
    front = is_front(face)
    at_x, at_y = np.meshgrid(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    nodes = np.zeros((6, *at_x.shape))
    for sign, part in ((1.0, surface), (-1.0, base)):
        if part is not None:
            inside = part.inside(at_x, at_y)
            with np.errstate(invalid="ignore"):  # outside the domain
                nodes += sign * np.stack(part.evaluate(at_x, at_y, 2))
            nodes[0] = nodes[0] if inside is None else np.where(inside, nodes[0], np.nan)
    heights = HeightMap(x=x, y=y, z=nodes[0], name=Path(file).name)
    slopes = (nodes[1], nodes[2], nodes[4])
    if front:
        heights = heights.turned_over()
        slopes = (slopes[0][:, ::-1], -slopes[1][:, ::-1], slopes[2][:, ::-1])
    _require_heights(heights)
    write_file(Path(file), grid_sag.pack_slopes(heights, slopes))


def _require_heights(heights: HeightMap) -> None:
    """Raise if `read_map` would refuse the heights."""
    if fault := too_high(heights.z):
        raise MapError(f"the map {heights.name!r} {fault}: check its unit")


def _phase_per_height(kind: str, wavelength: float | None, index: float | None) -> float:
    """Return the phase of one mm of height above the material [rad/mm]; nan for a format of heights."""
    if kind != "grid phase":
        if wavelength is not None or index is not None:
            raise InputError(f"wavelength and index apply to the format grid phase only, not to {kind}: omit them")
        return math.nan
    if wavelength is None:
        raise InputError("a grid phase needs the wavelength, and the index of the part unless it is a mirror: give it")
    gain = -2.0 if index is None else check_index(index) - 1
    return 2 * math.pi * gain / check_wavelength(wavelength)
