"""The kernels of the generation on a graphics card: the same functions, compiled for it by numba-cuda.

A group of 4 x 4 tiles has a thread that lists, for each of its tiles, the passes that can be lowest there; then each
point has a thread that tries those of its tile. Where the points of a tile share no list, a point tries all passes.

With NUMBA_ENABLE_CUDASIM=1 numba's simulator takes the place of the card.
"""

import math
import threading
from functools import cache
from types import FunctionType, ModuleType

import numpy as np
from numba import config, cuda
from numpy.lib.stride_tricks import sliding_window_view

from turnwright._kernels import Kernel, jit
from turnwright._kernels.generation import (
    FAR,
    TURN,
    extent,
    gather,
    height_alone,
    nearer,
    pass_at,
    polar_tile,
    rings_between,
    unwrap,
)

GROUP = 16
"""Tiles of a group."""

THREADS_LISTING, THREADS_LOWERING = 32, 128
"""Threads of a block that lists passes, and of one that computes points."""

BAND_POINTS = 2**25
"""Most points between two transfers to the computer, unless a row of groups has more: 256 MiB of heights."""

MAX_MEMORY = 0.5
"""Largest part of the free memory of the card that lists of passes take."""

BYTES_PER_PASS = 16 * (2 + GROUP) + 60
"""Memory of a group for each pass that may matter in it: place in its lists, and scratch."""

config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # a small map leaves most of a card idle, which cannot be helped


@jit
def surround(columns, rows, polar, sense, r, azimuth):
    """Fill ``r`` and ``azimuth`` (9,) with points that span those of a tile; say whether they are close together.

    They are its corners and where it is nearest to the lines through the axis.
    """
    across, down = cuda.local.array(3, np.float64), cuda.local.array(3, np.float64)
    across[0], across[2], down[0], down[2] = columns[0], columns[columns.size - 1], rows[0], rows[rows.size - 1]
    across[1], down[1] = min(max(0.0, across[0]), across[2]), min(max(0.0, down[0]), down[2])
    polar_tile(across, down, polar, sense, r, azimuth)
    return unwrap(r, azimuth)


@jit
def list_passes(motion, y, grid, lists):
    """List the passes that can be lowest in each tile of a group, one thread a group; see `Card`."""
    c, x, _, z, sense, starts, _, _, rings, useful, core, _, edge, _, bend, _ = motion
    columns, rows, polar, down, across, groups = grid
    numbers, shifts, work, tilts, chosen, counts, middles = lists
    g = cuda.grid(1)
    if g >= groups.size:
        return
    per_row = -(-columns.size // (4 * across))
    row, column = groups[g] // per_row * 4 * down, groups[g] % per_row * 4 * across
    r, azimuth = cuda.local.array(9, np.float64), cuda.local.array(9, np.float64)
    of_group = -1
    for k in range(GROUP + 1):
        # First the group, whose list its tiles shorten; without one they begin from all passes.
        j, i = (row, column) if k == 0 else (row + (k - 1) // 4 * down, column + (k - 1) % 4 * across)
        if j >= rows.size or i >= columns.size:
            continue
        tall, wide = (4 * down, 4 * across) if k == 0 else (down, across)
        together = surround(columns[i : i + wide], rows[j : j + tall], polar, sense, r, azimuth)
        (rc, hr), (ac, ha) = extent(r, 0, 9), extent(azimuth, 0, 9)
        if y is not None:
            for ring in range(*rings_between(rings, rc - hr, rc + hr)):
                together = together and not core[ring]
        n = -1
        if together:
            n, source = of_group, 1
            if of_group < 0:
                source = 0
                n = gather(
                    c, sense, starts, rings, useful, y is None, rc - hr, rc + hr, ac, ha, numbers[0, 0, :, g],
                    shifts[0, :, g], numbers[1, 0, :, g],
                )  # fmt: skip
            n = nearer(
                c, x, y, z, sense, edge, bend, (rc, hr, ac, ha), n, numbers[0, source, :, g], shifts[source, :, g],
                numbers[1, source, :, g], work[:, :, g], tilts[:, :, g], chosen[:, g], numbers[0, 1 + k, :, g],
                shifts[1 + k, :, g], numbers[1, 1 + k, :, g],
            )  # fmt: skip
        if k == 0:
            of_group = n
        else:
            counts[k - 1, g], middles[k - 1, g] = n, ac


@jit
def lower_point(motion, y, grid, lists, on_axis, first_row, out):
    """Compute the height of one point of a group, one thread a point; see `Card`."""
    c, x, _, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y = motion
    columns, rows, polar, down, across, groups = grid
    numbers, shifts, _, _, _, counts, middles = lists
    thread = cuda.grid(1)
    g, place = thread // (GROUP * down * across), thread % (GROUP * down * across)
    if g >= groups.size:
        return
    per_row = -(-columns.size // (4 * across))
    j, i = place // (4 * across), place % (4 * across)
    row, column = groups[g] // per_row * 4 * down + j, groups[g] % per_row * 4 * across + i
    if row >= rows.size or column >= columns.size:
        return
    if polar:
        r, azimuth = columns[column], sense * rows[row]
    else:
        r = np.sqrt(columns[column] * columns[column] + rows[row] * rows[row])
        azimuth = sense * np.arctan2(rows[row], columns[column])
    tile = j // down * 4 + i // across
    lowest = FAR
    if counts[tile, g] < 0:
        if r == 0.0 and y is None:
            lowest = on_axis
        else:
            pieces, line = cuda.local.array((64, 2), np.float64), cuda.local.array(6, np.float64)
            lowest = height_alone(
                c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y, r,
                azimuth, pieces, line,
            )  # fmt: skip
    else:
        # On the branch of the tile.
        azimuth -= TURN * np.floor((azimuth - middles[tile, g]) / TURN + 0.5)
        for k in range(counts[tile, g]):
            h, _, _, _, _ = pass_at(
                c, x, y, z, sense, edge, azimuth + shifts[2 + tile, k, g], r, numbers[0, 2 + tile, k, g],
                numbers[1, 2 + tile, k, g],
            )  # fmt: skip
            lowest = min(lowest, h)
    out[row - first_row, column] = lowest


def list_upright(motion, grid, lists):
    """List passes of an edge that moves in the plane through the axis."""
    list_passes(motion, None, grid, lists)


def list_lateral(motion, grid, lists):
    """List passes of any other edge."""
    list_passes(motion, motion[2], grid, lists)


def lower_upright(motion, grid, lists, on_axis, first_row, out):
    """Compute points under an edge that moves in the plane through the axis."""
    lower_point(motion, None, grid, lists, on_axis, first_row, out)


def lower_lateral(motion, grid, lists, on_axis, first_row, out):
    """Compute points under any other edge."""
    lower_point(motion, motion[2], grid, lists, on_axis, first_row, out)


def _numpy():
    """Return NumPy as the card has it: numba-cuda knows these roots and roundings by the names of `math` only."""
    if config.ENABLE_CUDASIM:
        return np
    module = ModuleType("numpy")
    vars(module).update(vars(np), sqrt=math.sqrt, floor=math.floor, ceil=math.ceil)
    return module


_NUMPY = _numpy()


@cache
def on_card(function, *, device=True):
    """Return a function, or a kernel with all that it calls, for the card; without ``device`` for launches."""
    plain = function._function if isinstance(function, Kernel) else function  # noqa: SLF001 - our own
    names = {"__builtins__": __builtins__, "__name__": plain.__module__}
    for name in plain.__code__.co_names:
        if name in plain.__globals__:
            value = plain.__globals__[name]
            names[name] = on_card(value) if isinstance(value, Kernel) else _NUMPY if value is np else value
    return cuda.jit(device=device)(FunctionType(plain.__code__, names, plain.__name__))


class Card:
    """A motion and an edge in the memory of the graphics card, ready to compute grids of heights.

    ``motion`` is what the kernels of the generation take first; ``y`` is an array also where they take None. The height
    ``on_axis`` is that of an upright edge.
    """

    def __init__(self, motion, y, on_axis):
        self._rings, self._useful, self._on_axis = motion[8], motion[9], on_axis
        self._motion = tuple(_to_card(one) for one in (*motion[:2], y, *motion[3:]))
        both = (list_upright, lower_upright) if motion[2] is None else (list_lateral, lower_lateral)
        self._list, self._lower = (on_card(one, device=False) for one in both)
        self._lock = threading.Lock()

    def fill_grid(self, columns, rows, polar, sides, wanted, z, progress):
        """Fill ``z`` (rows, columns) in the groups of 4 x 4 tiles of ``sides`` points that are ``wanted``.

        A point of ``z`` in another group is not defined afterwards. One thread at a time uses the card. It holds some
        rows of groups at a time, and lists of passes for as many groups as there is memory for.
        """
        down, across = sides
        tall = 4 * down * int(np.clip(BAND_POINTS // (4 * down * columns.size), 1, wanted.shape[0]))
        room = self._most_passes(4 * down, 4 * across, columns, rows, polar)
        with self._lock:
            out = cuda.device_array((min(tall, rows.size), columns.size))
            free, _ = cuda.current_context().get_memory_info()
            most = max(int(min(MAX_MEMORY * free / (room * BYTES_PER_PASS), tall // (4 * down) * wanted.shape[1])), 1)
            lists = (
                cuda.device_array((2, 2 + GROUP, room, most), np.int32), cuda.device_array((2 + GROUP, room, most)),
                cuda.device_array((3, room, most)), cuda.device_array((room, 4, most)),
                cuda.device_array((room, most), np.int32), cuda.device_array((GROUP, most), np.int32),
                cuda.device_array((GROUP, most)),
            )  # fmt: skip
            place = _to_card(columns), _to_card(rows), polar, down, across
            for first in range(0, rows.size, tall):
                band = slice(first, min(first + tall, rows.size))
                begin = first // (4 * down)
                groups = np.flatnonzero(wanted[begin : begin + tall // (4 * down)]) + begin * wanted.shape[1]
                for start in range(0, groups.size, most):
                    some = groups[start : start + most]
                    grid = (*place, _to_card(some))
                    self._list[-(-some.size // THREADS_LISTING), THREADS_LISTING](self._motion, grid, lists)
                    points = some.size * GROUP * down * across
                    self._lower[-(-points // THREADS_LOWERING), THREADS_LOWERING](
                        self._motion, grid, lists, self._on_axis, first, out
                    )
                if groups.size:
                    out[: band.stop - band.start].copy_to_host(z[band])
                if progress is not None:
                    progress(band.stop, rows.size)

    def _most_passes(self, tall, wide, columns, rows, polar):
        """Return the most passes that `gather` lists for any group of so many points along rows and columns."""
        spans = [n * float(np.diff(axis).max(initial=0.0)) for n, axis in ((tall, rows), (wide, columns))]
        span = spans[1] if polar else math.hypot(*spans)
        step = self._rings[1] - self._rings[0]
        window = int(min(span / step + 3, self._rings.size - 1))
        first = sliding_window_view(self._useful[..., 0], window, axis=0).min(axis=-1)
        last = sliding_window_view(self._useful[..., 1], window, axis=0).max(axis=-1)
        return int(np.maximum(last - first + 3, 0).sum(axis=1).max(initial=1))


def _to_card(value):
    """Copy arrays, also those in a named tuple, to the memory of the card."""
    if isinstance(value, tuple):
        return type(value)(*map(_to_card, value))
    return cuda.to_device(np.ascontiguousarray(value)) if isinstance(value, np.ndarray) else value
