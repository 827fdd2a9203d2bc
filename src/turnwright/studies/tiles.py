"""Simulate the surface of a whole part, tile by tile, into a store."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, is_dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright import _validate as validate
from turnwright._arrays import Floats, only_read
from turnwright._kernels import tiled as kernel
from turnwright.errors import InputError, StudyError
from turnwright.generation import Prepared, require_device
from turnwright.heightmap import HeightMap
from turnwright.machine import Machine
from turnwright.path import Motion
from turnwright.progress import Progress, cores
from turnwright.studies.cases import iter_finished, join_lines, program_version
from turnwright.studies.digests import digest_of
from turnwright.studies.executors import require_reach
from turnwright.studies.store import Store
from turnwright.studies.tile_files import (
    EDGE_START,
    MOTION_FOLDER,
    PART_PIXELS,
    PLANE_SUMS,
    Files,
    remove_motion,
    require_room,
    require_same_map,
    resolve_place,
    translate_disk_errors,
)
from turnwright.studies.tile_layout import (
    DEFAULT_TILE_PIXELS,
    MAX_TILE_PIXELS,
    MIN_TILE_PIXELS,
    TILE_LEVELS,
    Layout,
    Tile,
    tile_sides,
)
from turnwright.studies.tiled_map import TiledMap
from turnwright.tool import Tool

if TYPE_CHECKING:
    from turnwright.surface import Surface

__all__ = ["generate_tiled", "plan_tiles"]


@dataclass(frozen=True, slots=True)
class _TileWriter:
    """Prepared input of all tiles, shared by the threads of a process."""

    ready: Prepared
    files: Files
    minus: Surface | None
    sides: tuple[int, int]
    axes: tuple[Floats, Floats]

    @classmethod
    def of(
        cls, motion: Motion, tool: Tool, machine: Machine | None, minus: Surface | None, files: Files, device: str
    ) -> _TileWriter:
        layout = files.layout
        ready = _ready(motion, tool, machine, layout, device)
        return cls(ready, files, minus, ready.sides(layout.pixel[::-1]), layout.axes())

    def heights(self, tile: Tile) -> tuple[Floats, int]:
        """Return the heights of a tile [mm], nan where missing, and its number of pixels of the part."""
        x, y = self.axes[0][tile.columns], self.axes[1][tile.rows]
        inside = self.files.layout.inside(x, y)
        z = self.ready.fill_grid(x, y, sides=self.sides, inside=inside, threads=1)
        pixels = z.size if inside is None else int(np.count_nonzero(inside))
        return (z if self.minus is None else HeightMap(x=x, y=y, z=z).minus(self.minus).z), pixels

    def paint(self, tile: Tile) -> None:
        """Compute a tile and its overviews, and write them and then the record of the tile to the store."""
        z, pixels = self.heights(tile)
        record = np.zeros(self.files.records.shape[2])
        kernel.plane_sums(only_read(z), record[:PLANE_SUMS])
        wide = self.files.layout.tile[1]
        record[PART_PIXELS] = pixels
        record[EDGE_START : EDGE_START + z.shape[1]] = z[0]
        record[EDGE_START + wide : EDGE_START + wide + z.shape[0]] = z[:, 0]
        rows, columns = tile.rows.start, tile.columns.start
        for level in range(TILE_LEVELS + 1):
            if level > 0:
                finer, z = z, np.empty((-(-z.shape[0] // 2), -(-z.shape[1] // 2)))
                kernel.halved(only_read(finer), z)
            row, column = rows >> level, columns >> level
            self.files.levels[level][row : row + z.shape[0], column : column + z.shape[1]] = z
        self.files.records[tile.j, tile.i] = record


def _ready(motion: Motion, tool: Tool, machine: Machine | None, layout: Layout, device: str) -> Prepared:
    return Prepared.of(
        motion, tool, machine, distances=layout.distances(), most_rings=layout.shape[0] * layout.shape[1], device=device
    )  # fmt: skip


def generate_tiled(
    motion: Motion,
    tool: Tool,
    *,
    pixel: float | tuple[float, float],
    store: str | os.PathLike[str],
    radius: float | None = None,
    x: tuple[float, float] | None = None,
    y: tuple[float, float] | None = None,
    minus: Surface | None = None,
    tile: int = DEFAULT_TILE_PIXELS,
    machine: Machine | None = None,
    device: str = "cpu",
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> TiledMap:
    r"""Return the surface that a motion generates, of any size, computed tile by tile into a store on disk.

    The heights are those of `generate` on the same grid, on processors to the last bit. Memory holds a few tiles at a
    time. Finished tiles are kept: after a stop, a crash or a full disk, a call with the same motion, tool and grid
    computes only the missing ones. The store is a zarr group (version 3, uncompressed) that any program can read. It
    also holds overviews, each with half the pixels of the one before along each axis: means of 2 x 2 heights without
    missing ones.

    Parameters
    ----------
    motion, tool, machine, device
        See `generate`. A map begun on one device may be continued on another.
    pixel
        Pixel size along x and y, or one for both. [mm]
    store
        A folder, or a URL that fsspec supports.
    radius
        Semi-diameter of the map; a pixel is on the axis, unless ``x`` and ``y`` state where they begin. [mm]
    x, y
        First and last column and row of a rectangle. [mm]
    minus
        Surface to subtract: the map is then the form error, cut minus nominal surface.
    tile
        Approximate number of pixels along a tile; it is rounded to a multiple of the groups of the generation.
    executor
        Executor of the tiles; by default threads of this process. An executor reads the motion from the store, which
        all its workers must reach; with ``device="cuda"`` each needs a graphics card.
    progress
        Called with (tiles done, all tiles).

    Returns
    -------
    TiledMap
        The map, with its roughness, spectra and windows.

    Raises
    ------
    InputError
        If the grid is invalid, the disk has too little space, the store holds something else, or ``device`` is "cuda"
        and there is no card.
    DomainError
        If ``minus`` is undefined somewhere.
    StudyError
        If the disk becomes full, or the executor breaks; finished tiles are kept.

    Sources
    -------
    Oracle: `generate` in one piece.
    """
    validate.instance_of(motion, Motion, "the motion")
    validate.instance_of(tool, Tool, "the tool")
    if machine is not None:
        validate.instance_of(machine, Machine, "the machine")
    if executor is not None:
        validate.instance_of(executor, Executor, "the executor")
    else:
        require_device(device)
    validate.listener(progress)
    if minus is not None and not callable(getattr(minus, "sag", None)):
        raise InputError(f"the argument minus is a {type(minus).__name__}, it must be a surface: give one")
    place = resolve_place(store)
    layout = plan_tiles(place, pixel, radius=radius, x=x, y=y, tile=tile)
    if executor is not None:
        require_reach(place, executor, arrays=True)
    ready = _ready(motion, tool, machine, layout, device if executor is None else "cpu")
    sides = ready.sides(layout.pixel[::-1])
    layout = layout.in_tiles(tile_sides(tile, sides, layout.shape))
    key = _key(ready, layout, minus)
    tiles = list(layout.tiles())
    with translate_disk_errors(place, 0, len(tiles)):
        files = Files.begin(place, layout, {"key": key, "error": minus is not None})
    if files.about["complete"]:
        return TiledMap(files)
    there = files.finished()
    missing = [one for one in tiles if not there[one.j, one.i]]
    painter = _TileWriter(ready, files, minus, sides, layout.axes())
    if executor is None:
        # One thread more than cores: while one waits for the disk, the others compute.
        with ThreadPoolExecutor(cores() + 1) as pool:
            _run_tiles(lambda one: pool.submit(painter.paint, one), missing, pool, place, len(tiles), progress)
    else:
        task, workers = _Task.of(place, key, motion, tool, machine, minus, device), executor
        _run_tiles(
            lambda one: workers.submit(_paint, task, one.j, one.i), missing, workers, place, len(tiles), progress
        )
    with translate_disk_errors(place, len(tiles), len(tiles)):
        _write_overviews(files)
        files.complete()
        if executor is not None:
            remove_motion(place)
    return TiledMap(Files.open(place))


def plan_tiles(
    store: str | os.PathLike[str],
    pixel: float | tuple[float, float],
    *,
    radius: float | None = None,
    x: tuple[float, float] | None = None,
    y: tuple[float, float] | None = None,
    tile: int = DEFAULT_TILE_PIXELS,
) -> Layout:
    """Return the grid of a map, after a check that it can be started or continued there; see `generate_tiled`."""
    layout = Layout.of(pixel, radius=radius, x=x, y=y)
    validate.whole_number(tile, "the width of a tile in pixels", MIN_TILE_PIXELS, MAX_TILE_PIXELS)
    place = resolve_place(store)
    with translate_disk_errors(place, 0, 0):
        require_same_map(place, layout)
        require_room(place, layout.in_tiles((DEFAULT_TILE_PIXELS, DEFAULT_TILE_PIXELS)))
    return layout


def _run_tiles(
    submit: Callable[[Tile], Future[None]],
    missing: Sequence[Tile],
    executor: Executor,
    place: str,
    total: int,
    progress: Progress | None,
) -> None:
    update = progress or (lambda _done, _total: None)
    done = total - len(missing)

    def lost(error: BaseException) -> StudyError:
        return StudyError(
            f"the executor failed with {done} of {total} tiles finished ({join_lines(error)}), which are kept: start "
            "again with a new one"
        )

    update(done, total)
    with closing(iter_finished(submit, missing, executor, lost=lost)) as made:
        for tile, future, deaths in made:
            if deaths:
                raise StudyError(
                    f"the tile in row {tile.j + 1}, column {tile.i + 1} ended its worker {deaths} times "
                    f"({future.exception()}), finished tiles are kept: use fewer workers or smaller tiles, and start "
                    "again"
                )
            with translate_disk_errors(place, done, total):
                future.result()
            done += 1
            update(done, total)


@dataclass(frozen=True, slots=True)
class _Task:
    """Input of a worker: paths, names, tool and machines, but no array of the motion."""

    place: str
    key: str
    arrays: Store
    names: dict[str, str]
    tool: Tool
    machine: Machine
    planned_for: Machine
    minus: Surface | None
    device: str

    @classmethod
    def of(
        cls, place: str, key: str, motion: Motion, tool: Tool, machine: Machine | None, minus: Surface | None,
        device: str,
    ) -> _Task:  # fmt: skip
        arrays = Store.open(f"{place}/{MOTION_FOLDER}")
        columns = {"time": motion.time, **motion.axes}
        names = {letter: arrays.put_array(letter, values) for letter, values in columns.items()}
        return cls(
            place, key, arrays, names, tool, machine or motion.machine, motion.machine, minus, device
        )  # fmt: skip

    def painter(self) -> _TileWriter:
        axes = {letter: self.arrays.array(name) for letter, name in self.names.items()}
        motion = Motion(time=axes.pop("time"), axes=axes, machine=self.planned_for)
        return _TileWriter.of(
            motion, self.tool, self.machine, self.minus, Files.open(self.place, write=True), self.device
        )


_latest: dict[str, _TileWriter] = {}
"""Input that this worker prepared last."""


def _paint(task: _Task, j: int, i: int) -> None:
    at = f"{task.place} {task.key}"
    if at not in _latest:
        painter = task.painter()
        _latest.clear()
        _latest[at] = painter
    painter = _latest[at]
    painter.paint(painter.files.layout.at(j, i))


def _write_overviews(files: Files) -> None:
    """Compute the overviews beyond those of the tiles, each from the one before, a band of rows at a time."""
    layout = files.layout
    for level in range(TILE_LEVELS + 1, layout.levels):
        finer, coarse = files.levels[level - 1], files.levels[level]
        tall = layout.level_chunk(level)[0]
        rows, columns = layout.level_shape(level)
        for row in range(0, rows, tall):
            band = np.asarray(finer[2 * row : 2 * (row + tall)], dtype=np.float64)
            out = np.empty((min(tall, rows - row), columns))
            kernel.halved(only_read(band), out)
            coarse[row : row + tall] = out


def _key(ready: Prepared, layout: Layout, minus: Surface | None) -> str:
    heights = None
    if minus is not None:  # samples of the heights identify also a user's own surface
        x, y = (axis[:: max(1, axis.size // 64)] for axis in layout.axes())
        x, y = (one.ravel() for one in np.meshgrid(x, y))
        inside = np.ones(x.shape, dtype=bool) if layout.radius is None else np.hypot(x, y) <= layout.radius
        heights = minus.sag(x[inside], y[inside])
    surface = minus if is_dataclass(minus) else type(minus)
    return digest_of([program_version(), ready.cut, layout, surface, heights])
