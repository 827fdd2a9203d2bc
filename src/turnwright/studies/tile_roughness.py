r"""Surface parameters of a map in tiles: sums that merge exactly.

With a reference plane fixed beforehand, every parameter is a sum over points, pairs of neighbours or cells of four. The
plane comes from the sums of the tiles about their own means, merged as

.. math:: S_{xz} = \sum_k S_{xz,k} + \sum_k n_k (\bar x_k - \bar x)(\bar z_k - \bar z)
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Floats
from turnwright._kernels import tiled as kernel
from turnwright.errors import InputError
from turnwright.metrology import Roughness
from turnwright.studies.bands import map_in_order
from turnwright.studies.tile_files import EDGE_START, PLANE_SUMS

if TYPE_CHECKING:
    from collections.abc import Callable

    from turnwright.progress import Progress
    from turnwright.studies.tile_files import Files
    from turnwright.studies.tile_layout import Tile

__all__ = ["tiled_roughness"]

NM = 1e6


def tiled_roughness(files: Files, form: str, progress: Progress | None) -> Roughness:
    """Return the surface parameters of a map in tiles."""
    if not isinstance(form, str) or form not in ("none", "mean", "plane"):
        raise InputError(
            f'the form is {form!r}, a map in tiles takes "none", "mean" or "plane": choose one of them, or subtract a '
            "surface when the map is generated"
        )
    layout, records = files.layout, files.read_records()
    tiles = [tile for tile in layout.tiles() if records[tile.j, tile.i, 0] > 0]
    if sum(records[tile.j, tile.i, 0] for tile in tiles) < 3:
        raise InputError("the map has fewer than 3 valid heights, roughness needs 3: map more of the part")
    level = _fit_reference(records, tiles, form)
    dx, dy = layout.pixel

    def sums(tile: Tile) -> Floats:
        z = _read_extended(files, records, tile)
        sums_of_tile = np.empty(kernel.SUMS + 2)
        base, along_x, along_y = level(tile)
        kernel.residual_sums(z, *tile.shape, base, along_x, along_y, dx, dy, sums_of_tile)
        return sums_of_tile

    results = []
    for number, one in enumerate(map_in_order(sums, tiles), 1):
        results.append(one)
        if progress is not None:
            progress(number, len(tiles))
    every = np.array(results)
    size, square, cube, fourth, count, across, n_across, down, n_down, excess, n_cells = (
        math.fsum(every[:, k]) for k in range(kernel.SUMS)
    )
    low, high = float(every[:, kernel.SUMS].min()), float(every[:, kernel.SUMS + 1].max())
    notes = ["Sal and Str cannot be stated: they need the map in one piece, evaluate a window"]
    sq = math.sqrt(square / count)
    ssk = sku = sdq = sdr = math.nan
    if sq > 0:
        ssk, sku = cube / count / sq**3, fourth / count / sq**4
    else:
        notes.insert(0, "ssk and sku are nan: the map is perfectly flat")
    if n_cells > 0:
        sdq, sdr = math.sqrt(across / n_across + down / n_down), 25 * excess / n_cells
    else:
        notes.insert(0, "sdq and sdr are nan where no neighbouring points are valid in both directions")
    return Roughness(
        sa_nm=size / count * NM, sq_nm=sq * NM, sp_nm=high * NM, sv_nm=-low * NM, sz_nm=(high - low) * NM,
        pv_nm=(high - low) * NM, ssk=ssk, sku=sku, sdq=sdq, sdr=sdr, sal=math.nan, str=math.nan, valid=int(count),
        missing=layout.shape[0] * layout.shape[1] - int(count), form=form, notes=tuple(notes),
    )  # fmt: skip


def _read_extended(files: Files, records: Floats, tile: Tile) -> Floats:
    """Return the heights of a tile, extended by the first row and column of its neighbours."""
    rows, columns = tile.shape
    wide = files.layout.tile[1]
    z = np.full((rows + 1, columns + 1), np.nan)
    z[:-1, :-1] = files.levels[0][tile.rows, tile.columns]
    below, right = tile.j + 1 < records.shape[0], tile.i + 1 < records.shape[1]
    # A tile beyond the part has no record, which gives nan.
    if right:
        z[:-1, -1] = records[tile.j, tile.i + 1, EDGE_START + wide : EDGE_START + wide + rows]
    if below:
        z[-1, :-1] = records[tile.j + 1, tile.i, EDGE_START : EDGE_START + columns]
    if below and right:
        z[-1, -1] = records[tile.j + 1, tile.i + 1, EDGE_START]
    return z


def _fit_reference(records: Floats, tiles: list[Tile], form: str) -> Callable[[Tile], tuple[float, float, float]]:
    """Return a function of a tile: height of the reference at its corner, and slope per column and row."""
    if form == "none":
        return lambda _: (0.0, 0.0, 0.0)
    some = np.array([records[tile.j, tile.i, :PLANE_SUMS] for tile in tiles])
    n, _, _, first, si, sj, sii, sij, sjj, sz, siz, sjz = some.T
    corner_i = np.array([tile.columns.start for tile in tiles], dtype=np.float64)
    corner_j = np.array([tile.rows.start for tile in tiles], dtype=np.float64)
    total = math.fsum(n)
    # Means of each tile, and of all.
    mean_i, mean_j, mean_z = corner_i + si / n, corner_j + sj / n, first + sz / n
    middle_i, middle_j, level = (math.fsum(n * one) / total for one in (mean_i, mean_j, mean_z))
    if form == "mean":
        return lambda _: (level, 0.0, 0.0)

    def merged(own: Floats, a: Floats, b: Floats) -> float:
        return math.fsum([*own, *(n * a * b)])

    off_i, off_j, off_z = mean_i - middle_i, mean_j - middle_j, mean_z - level
    normal = np.array(
        [
            [merged(sii - si * si / n, off_i, off_i), merged(sij - si * sj / n, off_i, off_j)],
            [merged(sij - si * sj / n, off_i, off_j), merged(sjj - sj * sj / n, off_j, off_j)],
        ]
    )
    right = np.array([merged(siz - si * sz / n, off_i, off_z), merged(sjz - sj * sz / n, off_j, off_z)])
    along_x, along_y = (float(one) for one in np.linalg.lstsq(normal, right, rcond=1e-13)[0])

    def corner(tile: Tile) -> tuple[float, float, float]:
        rise = along_x * (tile.columns.start - middle_i) + along_y * (tile.rows.start - middle_j)
        return level + rise, along_x, along_y

    return corner
