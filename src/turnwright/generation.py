r"""The surface a motion leaves: an independent witness that knows the motion and the edge, and nothing of the plan.

Every point of the surface is as high as the lowest pass of the edge over it, over *every* pass that can reach, those
from beyond the axis included:

.. math:: h(x, y) = \min_t \; [\\, Z(t) + e(u) \\,]

Sources
-------
[Li2018]_ takes three passes, which at R sin(slope) > 1.5 feed is wrong by tens of nanometres; [Troutman2016]_ ch. 8
backplots on a polar grid with a linear tool table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from turnwright._arrays import Bools, Floats, Ints, frozen, only_read, same_length
from turnwright._kernels import generation as kernel
from turnwright._validate import check_azimuths, one_of
from turnwright.edge import Edge
from turnwright.errors import InputError
from turnwright.heightmap import HeightMap
from turnwright.machine import Machine
from turnwright.path import Motion
from turnwright.progress import Progress, cores, run_chunks
from turnwright.tool import Tool

__all__ = ["generate", "generate_points", "generate_polar"]

RINGS = 200
"""How many rings settle beforehand which turns can matter, where two passes cross at most once; tenfold elsewhere."""


CHORDS_PER_TILE, MIN_SIDE, MAX_SIDE = 4.0, 4, 16
"""Width of a tile, and its least and greatest number of points along a side; the fastest of those measured."""
SWINGING_SIDES = 3, 8
"""Least and greatest number of points along a side where Y moves; so are these."""

GROUPS_PER_CORE = 8
"""Fewest blocks of 16 groups for each core of which a grid is computed."""

MIN_BOUNDED_POINTS = 65_536
"""Points of the turns, about, whose bounds a thread finds at once."""


@dataclass(frozen=True, slots=True)
class _Cut:
    c: Floats
    x: Floats
    y: Floats
    z: Floats
    sense: int
    starts: Ints
    bounds: Floats
    edge: Edge
    gap: float  # the most that the edge sinks back on its way out from the tip [mm]
    bend: float  # the most that its slope falls back on its way toward +X

    @property
    def feed(self) -> float:
        """Mean advance per turn. [mm]."""
        return float((self.bounds[1].max() - self.bounds[0].min()) / (self.starts.size - 1))

    @property
    def upright(self) -> bool:
        """Whether the whole edge moves in the plane through the axis."""
        return bool(self.edge.upright and self.y.size == 0)


def _cut(motion: Motion, tool: Tool, machine: Machine | None) -> _Cut:
    machine = machine or motion.machine
    c, x, z = (motion.axes[letter] for letter in "CXZ")
    error = machine.z_error(x) if machine.squareness or machine.straightness is not None else None
    if "U" in motion.axes:
        x = x + motion.axes["U"]
    if "W" in motion.axes:
        z = z + motion.axes["W"]
    if error is not None:
        z = z + error
    y = motion.axes.get("Y", np.empty(0))
    if not y.any():
        y = np.empty(0)
    c, x, y, z = (only_read(one) for one in (c, x, y, z))
    turns = max(int(np.ceil(abs(c[-1] - c[0]) / (2 * np.pi) - 1e-12)), 1)
    starts = np.empty(turns + 1, dtype=np.int64)
    kernel.turn_starts(c, motion.sense, starts)
    bounds = np.empty((7, turns))
    edge = tool.cutting_edge(motion.sense)
    run_chunks(
        lambda first, last: kernel.turn_bounds(c, x, y, z, motion.sense, starts, edge.dx, first, last, bounds),
        turns,
        max(math.ceil(MIN_BOUNDED_POINTS * turns / c.size), 1),
    )
    gap, bend = (0.0, 0.0) if edge.perfect else _measure_drops(edge)
    return _Cut(c, x, y, z, motion.sense, starts, bounds, edge, gap, bend)


def _measure_drops(edge: Edge) -> tuple[float, float]:
    """Return the most that a wavy edge sinks back on its way out, and that its slope falls back toward +X."""
    if edge.low_slope > 0 or edge.high_slope < 0:
        return kernel.FAR, kernel.FAR
    gap, bend = 0.0, 0.0
    for end in (edge.low_u, edge.high_u):
        u = np.linspace(0.0, end, 20_001)
        w, slope = edge.profile(u)
        # Between two samples it is off their chord by a fourth of what its slope changes.
        gap = max(gap, float((np.maximum.accumulate(w) - w).max() + abs(u[1] * np.diff(slope)).max() / 2))
        slope = slope if end > 0 else slope[::-1]
        bend = max(bend, float((np.maximum.accumulate(slope) - slope).max()))
    return gap, 0.0 if edge.convex else 2 * bend


def _check_ascending(values: ArrayLike, name: str) -> Floats:
    array = frozen(values, name)
    if array.size < 1 or not (np.diff(array) > 0).all():
        raise InputError(f"{name} must ascend strictly and hold at least 1 value, it has {array.size}: sort it")
    return array


def _finish(z: Floats) -> Floats:
    """Mark points that no pass covers, which happens next to the axis with the tool off centre."""
    z[z >= 1e299] = np.nan
    return z


def generate_points(
    motion: Motion,
    tool: Tool,
    *,
    x: ArrayLike,
    y: ArrayLike,
    machine: Machine | None = None,
    progress: Progress | None = None,
) -> Floats:
    """Return the height of the surface left at single points.

    Parameters
    ----------
    motion, tool, machine, progress
        See `generate`.
    x, y
        Points in the part frame. (n,) [mm]

    Returns
    -------
    ndarray
        Heights; nan where no pass covers the point, as `generate` has it. (n,) [mm]
    """
    x, y = frozen(x, "x"), frozen(y, "y")
    same_length([("x", x), ("y", y)])
    away, out, tiles = np.hypot(x, y), np.empty(x.size), Tiles.of_points(x.size)
    high = float(away.max(initial=0.0))
    ready = _prepare(_cut(motion, tool, machine), float(away.min(initial=high)), high, x.size)
    chunk = max(1, min(256, x.size // 16))
    run_chunks(lambda start, stop: ready.fill(x, y, tiles, (start, stop), out), x.size, chunk, progress)
    return _finish(out)


class Tiles(NamedTuple):
    """Neighbouring points in tiles, and neighbouring tiles in groups."""

    offsets: Ints  # where each tile begins among the points
    groups: Ints  # where each group begins among the tiles

    @classmethod
    def of_points(cls, count: int) -> Tiles:
        """Return every point alone."""
        each = np.arange(count + 1)
        return cls(each, each)


@dataclass(frozen=True, slots=True)
class Prepared:
    """A motion and an edge made ready for any points within a range of distances from the axis.

    Whatever is as long as the motion is done once, however many tiles of a part are then made of it.
    """

    cut: _Cut
    blocks: Floats
    rings: Floats
    useful: Ints
    core: Bools
    ceilings: Floats  # that the surface is below on each ring, for an edge out of the plane through the axis [mm]
    most_y: float
    card: Any = None  # the `Card` that computes the grids, if the processors do not

    @classmethod
    def of(
        cls, motion: Motion, tool: Tool, machine: Machine | None, *, distances: tuple[float, float], most_rings: int,
        device: str = "cpu",
    ) -> Prepared:  # fmt: skip
        """Prepare for the points between two ``distances`` from the axis [mm], with so many rings at most."""
        require_device(device)
        return _prepare(_cut(motion, tool, machine), *distances, most_rings, device)

    @property
    def device(self) -> str:
        """What computes the grids, "cpu" or "cuda"."""
        return "cpu" if self.card is None else "cuda"

    def narrowed(self, distances: tuple[float, float], most_rings: int) -> Prepared:
        """Prepare what is prepared already for a smaller range of distances [mm], at a small part of the cost."""
        return _prepare(self.cut, *distances, most_rings, self.device)

    def polar(self, radius: Floats, angle: Floats) -> HeightMap:
        """Return the heights over a polar grid at any distances from the axis, see `generate_polar`."""
        z = np.empty((angle.size, radius.size))
        _fill_polar(self.cut, radius, angle, z, self.device)
        return HeightMap(z=z, radius=radius, angle=angle, name="generated")

    def sides(self, steps: tuple[float, float]) -> tuple[int, int]:
        """Return how many points of a grid with such steps [mm] go in one tile, along rows and columns."""
        return _tile_sides(self.cut, steps)

    def fill(self, x: Floats, y: Floats, tiles: Tiles, span: tuple[int, int], out: Floats) -> None:
        """Fill ``out`` at the points (x, y) of the groups of ``span``, on this thread. Each (n,) [mm]."""
        kernel.scattered(*self._arguments, only_read(x), only_read(y), tiles.offsets, tiles.groups, False, *span, out)

    def fill_grid(
        self, columns: Floats, rows: Floats, *, polar: bool = False, sides: tuple[int, int] | None = None,
        inside: Bools | None = None, threads: int | None = None, progress: Progress | None = None,
    ) -> Floats:  # fmt: skip
        """Return the heights of a grid. (rows, columns) [mm].

        Columns and rows are x and y or, with ``polar``, distances from the axis and azimuths. A height depends, to the
        last bit, on the tile of ``sides`` points that it is in, counted from the first point. Where no pass covers a
        point, or it is not ``inside``, the height is nan.
        """
        if sides is None:
            sides = self.sides((_mean_step(rows) * (float(columns[-1]) if polar else 1.0), _mean_step(columns)))
        wanted = _any_of(inside, 4 * sides[0], 4 * sides[1], (rows.size, columns.size))
        z = np.empty((rows.size, columns.size)) if inside is None else np.full((rows.size, columns.size), np.nan)
        if self.card is None:
            self._fill_grid(columns, rows, polar, sides, wanted, threads, z, progress)
        else:
            self.card.fill_grid(columns, rows, polar, sides, wanted, z, progress)
        if inside is not None:
            z[~inside] = np.nan
        return _finish(z)

    def _fill_grid(
        self, columns: Floats, rows: Floats, polar: bool, sides: tuple[int, int], wanted: Bools, threads: int | None,
        z: Floats, progress: Progress | None,
    ) -> None:  # fmt: skip
        # The list of passes is shortened for several groups at once, where the grid has enough of them for all cores.
        several = 4 if wanted.size >= 16 * GROUPS_PER_CORE * cores() else 1
        blocks = -(-wanted.shape[0] // several) * -(-wanted.shape[1] // several)
        columns, rows = only_read(columns), only_read(rows)

        def work(start: int, stop: int) -> None:
            kernel.grid(*self._arguments, columns, rows, polar, sides, wanted, several, True, start, stop, z)

        run_chunks(work, blocks, int(np.clip(blocks // 32, 1, 64)), progress, threads=threads)

    @property
    def _arguments(self) -> tuple[Any, ...]:
        cut = self.cut
        return (
            cut.c, cut.x, None if cut.upright else cut.y, cut.z, cut.sense, cut.starts, cut.bounds, self.blocks,
            self.rings, self.useful, self.core, self.ceilings, cut.edge, cut.gap, cut.bend, self.most_y,
        )  # fmt: skip


def _any_of(inside: Bools | None, tall: int, wide: int, shape: tuple[int, int]) -> Bools:
    """Return which of the groups of so many rows and columns have a point inside."""
    starts = [np.arange(0, n, step) for n, step in zip(shape, (tall, wide), strict=True)]
    if inside is None:
        return np.ones((starts[0].size, starts[1].size), dtype=np.bool_)
    return np.logical_or.reduceat(np.logical_or.reduceat(inside, starts[0], axis=0), starts[1], axis=1)


def _prepare(cut: _Cut, low: float, high: float, most_rings: int, device: str = "cpu") -> Prepared:
    """Settle once for each of some hundred rings which turns can matter at all."""
    high = high * (1 + 1e-9) + 1e-9
    low = min(low, high) * (1 - 1e-9)
    most = RINGS if cut.upright and cut.edge.convex else 10 * RINGS
    count = int(np.clip(2 * (high - low) / max(cut.feed, 1e-9), 1, max(min(most, most_rings), 1)))
    rings = np.linspace(low, high, count + 1)
    useful, core = np.empty((count, 2, 2), dtype=np.int64), np.zeros(count, dtype=np.bool_)
    ceilings = np.full(count, kernel.FAR)
    most_y = float(np.abs(cut.y).max(initial=0.0))
    blocks = np.empty((0 if cut.upright else kernel.block_ends(cut.c.size - 1)[2], 8))
    if not cut.upright:
        kernel.block_bounds(cut.c, cut.x, cut.y, cut.z, cut.sense, cut.edge.dx, blocks)
    if cut.upright and cut.edge.convex:
        kernel.useful_by_ring(cut.bounds, cut.edge, rings, useful)
    else:
        kernel.useful_lateral(cut.bounds, cut.edge, cut.gap, cut.bend, most_y, rings, useful, core, ceilings)
    ready = Prepared(cut, blocks, rings, useful, core, ceilings, most_y)
    return ready if device == "cpu" else replace(ready, card=_on_card(ready))


def _on_card(ready: Prepared) -> Any:
    """Return what is prepared in the memory of the graphics card."""
    from turnwright._kernels.cuda import Card  # noqa: PLC0415 - numba is costly to import

    cut, on_axis = ready.cut, kernel.FAR
    if cut.upright:
        on_axis = kernel.axis_height(cut.x, cut.z, cut.starts, cut.bounds, cut.edge, cut.gap)
    return Card(ready._arguments, cut.y, on_axis)  # noqa: SLF001 - of this module


def _tile_sides(cut: _Cut, steps: tuple[float, float]) -> tuple[int, int]:
    """Return how many points a tile should be wide: some chords, so that a pass has few kinks in a tile.

    For a tool out of the radial plane it is as round as the steps allow. Where Y moves, fewer fine points have their
    lines in common, and coarse ones are computed alone, so that large groups are tried less often.
    """
    chord = float(np.abs(cut.x).mean()) * abs(cut.c[-1] - cut.c[0]) / (cut.c.size - 1)
    if cut.upright:
        down, across = (CHORDS_PER_TILE * chord / step if step > 0 else 0 for step in steps)
        return int(np.clip(down, MIN_SIDE, MAX_SIDE)), int(np.clip(across, MIN_SIDE, MAX_SIDE))
    ratio = steps[0] / steps[1] if steps[1] > 0 else 1.0
    if ratio > MIN_SIDE or ratio * MIN_SIDE < 1:
        return (1, MAX_SIDE) if ratio > 1 else (MAX_SIDE, 1)
    if not cut.y.size or chord == 0:
        return MIN_SIDE, MIN_SIDE
    least, most = SWINGING_SIDES
    side = int(np.clip(least + 2 * max(steps) / chord, least, most))
    return side, side


def require_device(device: str) -> None:
    """Raise unless ``device`` names what can compute here: "cpu", or "cuda" for a graphics card of NVIDIA."""
    one_of(device, "device", ("cpu", "cuda"))
    if device == "cpu":
        return
    if find_spec("numba_cuda") is None:
        raise InputError(
            "device is \"cuda\", which needs numba-cuda, which is not installed: pip install 'turnwright[cuda]'"
        )
    from numba import cuda  # noqa: PLC0415 - costly to import

    if not cuda.is_available():
        raise InputError(
            'device is "cuda", and no graphics card of NVIDIA is usable: install its driver and '
            "pip install 'turnwright[cuda]', or choose \"cpu\""
        )


def generate(
    motion: Motion,
    tool: Tool,
    *,
    x: ArrayLike,
    y: ArrayLike,
    machine: Machine | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
) -> HeightMap:
    """Return the surface that a motion leaves, over a rectangular grid.

    Parameters
    ----------
    motion
        Commanded axes, linear between the points.
    tool
        The *actual* tool; ``dataclasses.replace`` makes one that deviates from the planned one.
    x, y
        Ascending columns (nx,) and rows (ny,). [mm]
    machine
        The *actual* machine; by default the one the motion was made for, whose errors it corrects.
    device
        "cpu" for all processors, or "cuda" for a graphics card of NVIDIA, whose heights are equal within 1e-12 mm and
        which needs ``pip install 'turnwright[cuda]'``.
    progress
        Called with (done, total).

    Returns
    -------
    HeightMap
        Heights in the part frame; nan where no pass covers the point, which happens next to the axis when the tip
        stands above or below centre, and where a motion ends within its first turn. The flanks of the edge have no
        end, so what lies inside or outside of all turns is as high as the flank of the nearest. (ny, nx) [mm]

    Raises
    ------
    InputError
        If a grid axis does not ascend, or ``device`` is "cuda" and there is no card.
    """
    x, y = _check_ascending(x, "x"), _check_ascending(y, "y")
    ready = Prepared.of(
        motion, tool, machine, distances=grid_distances(x, y), most_rings=x.size * y.size, device=device
    )  # fmt: skip
    return HeightMap(z=ready.fill_grid(x, y, progress=progress), x=x, y=y, name="generated")


def grid_distances(x: Floats, y: Floats) -> tuple[float, float]:
    """Return the least and the greatest distance of the points of a grid from the axis. [mm]."""
    return float(np.hypot(abs(x).min(), abs(y).min())), float(np.hypot(abs(x).max(), abs(y).max()))


def _mean_step(axis: Floats) -> float:
    return float(np.diff(axis).mean()) if axis.size > 1 else 0.0


def generate_polar(
    motion: Motion,
    tool: Tool,
    *,
    radius: ArrayLike,
    angle: ArrayLike,
    machine: Machine | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
    out: Floats | None = None,
) -> HeightMap:
    """Return the surface that a motion leaves, over a polar grid.

    Along each azimuth it is one lower envelope, found in time proportional to passes plus samples however many passes
    the tool reaches; an edge out of the radial plane or not convex is taken as scattered points.

    Parameters
    ----------
    motion, tool, machine, device, progress
        See `generate`.
    radius
        Ascending distances from the axis, at least 0. (n_radius,) [mm]
    angle
        Ascending azimuths. (n_angle,) [rad]
    out
        Where to put the heights, for callers that make many maps: fresh memory costs more than the heights in it.
        (n_angle, n_radius), contiguous [mm]

    Returns
    -------
    HeightMap
        Heights; nan where no pass covers the point, as `generate` has it. (n_angle, n_radius) [mm]

    Raises
    ------
    InputError
        If a grid axis does not ascend, a radius is negative, ``out`` has another shape, or ``device`` is "cuda" and
        there is no card.
    """
    radius, angle = _check_ascending(radius, "radius"), _check_ascending(angle, "angle")
    check_azimuths(angle, "angle")
    if radius[0] < 0:
        raise InputError(f"radius begins at {radius[0]:g} mm, the limit is 0 mm: use the azimuth for the other side")
    shape = (angle.size, radius.size)
    z = np.empty(shape) if out is None else out
    if z.shape != shape or z.dtype != np.float64 or not z.flags.c_contiguous:
        raise InputError(f"out is {z.shape} of {z.dtype}, it must be contiguous, {shape} of float64: correct it")
    require_device(device)
    _fill_polar(_cut(motion, tool, machine), radius, angle, z, device, progress)
    return HeightMap(z=z, radius=radius, angle=angle, name="generated")


def _fill_polar(
    cut: _Cut, radius: Floats, angle: Floats, z: Floats, device: str, progress: Progress | None = None
) -> None:
    if cut.upright and cut.edge.convex and device == "cpu":
        _envelopes(cut, radius, angle, z, progress)
    else:
        ready = _prepare(cut, float(radius[0]), float(radius[-1]), z.size, device)
        # The axis is one point, whichever azimuth it is approached along; it takes as long as a thousand others.
        first = 1 if radius[0] == 0 else 0
        if first:
            z[:, 0] = ready.fill_grid(radius[:1], angle[:1], polar=True)[0]
        if radius.size > first:
            z[:, first:] = ready.fill_grid(radius[first:], angle, polar=True, progress=progress)


def _envelopes(cut: _Cut, radius: Floats, angle: Floats, z: Floats, progress: Progress | None) -> None:
    radius, angle = only_read(radius), only_read(angle)

    def work(start: int, stop: int) -> None:
        kernel.polar_block(
            cut.c, cut.x, cut.z, cut.sense, cut.starts, cut.bounds, cut.edge,
            radius, angle[start:stop], z[start:stop],
        )  # fmt: skip

    # Neighbouring azimuths read the same cache lines of the program, so that many of them share a chunk.
    run_chunks(work, angle.size, int(np.clip(angle.size // 32, 16, 128)), progress)
    if radius[0] == 0:
        # The axis is one point, whichever azimuth it is approached along.
        z[:, 0] = kernel.axis_height(cut.x, cut.z, cut.starts, cut.bounds, cut.edge, cut.gap)
