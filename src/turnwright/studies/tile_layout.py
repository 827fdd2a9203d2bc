"""Layout of a large grid: its tiles and overviews."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Self

import numpy as np

from turnwright import _validate as validate
from turnwright._arrays import Bools, Floats
from turnwright._validate import positive
from turnwright.errors import InputError
from turnwright.generation import grid_distances

__all__ = ["DEFAULT_TILE_PIXELS", "MAX_TILE_PIXELS", "MIN_TILE_PIXELS", "TILE_LEVELS", "Layout", "Tile", "tile_sides"]

TILE_LEVELS = 3
"""Number of overviews computed with each tile; coarser ones are computed from these when all tiles are finished."""

MAX_OVERVIEW_PIXELS = 512
"""Largest number of pixels along the longer side of the coarsest overview."""

DEFAULT_TILE_PIXELS = 1024
"""Approximate number of pixels along a tile: its arrays need little memory, its file is written in milliseconds."""

MIN_TILE_PIXELS, MAX_TILE_PIXELS = 64, 1 << 15
"""Limits of the number of pixels along a tile."""


@dataclass(frozen=True, slots=True)
class Tile:
    """The tile in row ``j`` and column ``i`` of all tiles, and its pixels."""

    j: int
    i: int
    rows: slice
    columns: slice

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of pixels."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A grid of equal pixels in tiles."""

    pixel: tuple[float, float]  # pixel size along x and y. [mm]
    origin: tuple[float, float]  # position of the first column and row. [mm]
    shape: tuple[int, int]  # rows and columns
    tile: tuple[int, int]  # rows and columns of a tile
    radius: float | None  # semi-diameter within which there are heights; ``None`` for the whole grid. [mm]

    @classmethod
    def of(
        cls,
        pixel: float | tuple[float, float],
        *,
        radius: float | None,
        x: tuple[float, float] | None,
        y: tuple[float, float] | None,
    ) -> Self:
        """Make a grid of one tile over a disc, with a pixel on its axis, or a rectangle, with one on its corner."""
        both = pixel if isinstance(pixel, tuple | list) else (pixel, pixel)
        if len(both) != 2:
            raise InputError(
                f"the pixel is {both!r}, it must be one number, or one along x and one along y: give these"
            )
        steps = [
            positive(validate.number(one, f"the pixel along {name}"), f"the pixel along {name}", "mm")
            for one, name in zip(both, "xy", strict=True)
        ]
        if (x is None) != (y is None) or (x is None and radius is None):
            raise InputError(
                "the extent of the map is not stated: give a radius for a disc, or x and y as (first, last) in mm"
            )
        if radius is not None:
            radius = positive(validate.number(radius, "the radius of the map"), "the radius of the map", "mm")
        origin, counts = [], []
        for step, name, span in zip(steps, "xy", (x, y), strict=True):
            if span is None:
                assert radius is not None  # noqa: S101 - refused above
                half = math.floor(radius / step + 1e-9)
                origin.append(-half * step)
                counts.append(2 * half + 1)
            else:
                low, high = validate.span(span, f"the extent of the map along {name}")
                origin.append(low)
                counts.append(math.floor((high - low) / step + 1e-9) + 1)
        if min(counts) < 2:
            raise InputError(
                f"the map has {counts[0]} x {counts[1]} pixels, the least is 2 x 2: use a smaller pixel than "
                f"{max(steps):g} mm"
            )
        shape = counts[1], counts[0]
        return cls(pixel=(steps[0], steps[1]), origin=(origin[0], origin[1]), shape=shape, tile=shape, radius=radius)

    @classmethod
    def read(cls, data: dict[str, Any]) -> Self:
        """Return the layout of data from `plain`."""
        return cls(**{one.name: _to_tuples(data[one.name]) for one in fields(cls)})

    def in_tiles(self, tile: tuple[int, int]) -> Self:
        """Return the grid with another tile size in rows and columns."""
        return replace(self, tile=tile)

    def plain(self) -> dict[str, Any]:
        """Return the layout as JSON data."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @property
    def count(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return -(-self.shape[0] // self.tile[0]), -(-self.shape[1] // self.tile[1])

    @property
    def levels(self) -> int:
        """Number of levels: the map and its overviews."""
        longer = max(self.shape)
        return max(TILE_LEVELS + 1, 1 + math.ceil(math.log2(max(longer / MAX_OVERVIEW_PIXELS, 1))))

    def level_shape(self, level: int) -> tuple[int, int]:
        """Return rows and columns of an overview."""
        return -(-self.shape[0] // 2**level), -(-self.shape[1] // 2**level)

    def level_chunk(self, level: int) -> tuple[int, int]:
        """Return rows and columns of a file of an overview."""
        by = 2 ** min(level, TILE_LEVELS)
        return self.tile[0] // by, self.tile[1] // by

    def axes(self, level: int = 0) -> tuple[Floats, Floats]:
        """Return x and y of the pixel centres of an overview. (nx,), (ny,) [mm]."""
        rows, columns = self.level_shape(level)
        axes = []
        for step, first, count in zip(self.pixel, self.origin, (columns, rows), strict=True):
            axes.append(first + step * (2**level * np.arange(count) + (2**level - 1) / 2))
        return axes[0], axes[1]

    def at(self, j: int, i: int) -> Tile:
        """Return a tile by its row and column."""
        (tall, wide), (rows, columns) = self.tile, self.shape
        return Tile(
            j, i, slice(j * tall, min((j + 1) * tall, rows)), slice(i * wide, min((i + 1) * wide, columns))
        )  # fmt: skip

    def inside(self, x: Floats, y: Floats) -> Bools | None:
        """Return where a grid has heights; ``None`` if everywhere. (ny, nx)."""
        if self.radius is None:
            return None
        far = (x * x) + (y * y)[:, None] <= self.radius**2 * (1 + 1e-12)
        return None if far.all() else far

    def tiles(self) -> Iterator[Tile]:
        """Yield the tiles that have heights, row by row."""
        x, y = self.axes()
        for j in range(self.count[0]):
            for i in range(self.count[1]):
                tile = self.at(j, i)
                if self.radius is not None:
                    near_x, near_y = (
                        min(max(0.0, axis[span.start]), axis[span.stop - 1])
                        for axis, span in ((x, tile.columns), (y, tile.rows))
                    )
                    if near_x**2 + near_y**2 > self.radius**2 * (1 + 1e-12):
                        continue
                yield tile

    def distances(self) -> tuple[float, float]:
        """Return the least and the greatest distance of a pixel from the axis, as in a map of one piece. [mm]."""
        return grid_distances(*self.axes())


def tile_sides(requested: int, sides: tuple[int, int], shape: tuple[int, int]) -> tuple[int, int]:
    """Return rows and columns of a tile: near the requested size, in multiples of the tile groups of `generate`.

    Each point then has the same neighbours as in a map of one piece, so that its height is the same to the last bit,
    and the first three overviews of a tile end at its border.
    """
    rounded = []
    for side, size in zip(sides, shape, strict=True):
        group = math.lcm(4 * side, 2**TILE_LEVELS)
        rounded.append(group * max(1, round(min(requested, size + group) / group)))
    return rounded[0], rounded[1]


def _to_tuples(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
