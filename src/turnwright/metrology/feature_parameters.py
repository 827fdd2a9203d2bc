r"""Feature parameters of a surface: its hills and dales, and the direction of its texture.

Every point belongs to the hill on which the steepest ascent from it ends (watershed). A hill whose peak is less than
5 % of Sz above its highest saddle is merged with the hill beyond that saddle, the lowest first (Wolf pruning). Dales
are the hills of the inverted surface.

Holes of a few missing points are filled first. Hills that reach the border of the map or a larger hole are left out, as
their peak may lie beyond. The area of hills at the border counts; hills next to a hole are assumed to be as dense as
the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright._arrays import Bools, Floats, Ints
from turnwright._validate import between
from turnwright.metrology.clean import fill_holes
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.grid import even_rectangle, valid_points
from turnwright.progress import cores

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap

NM = 1e6

AVERAGED_SUMMITS = 5
"""Number of peaks, and of pits, averaged by the height parameters."""

SECTOR_WIDTH_RAD = np.deg2rad(1.0)
"""Width of the sectors of the angular spectrum."""

DIRECTION_HALF_WIDTH_RAD = np.deg2rad(8.0)
"""Half the width of the sector over which the strongest direction is averaged."""

MAX_HOLE_POINTS = 5
"""Largest extent of a hole that is filled. [points]"""

MIN_COMPLETE_SHARE = 0.5
"""Least area of the hills that reach no hole, relative to that of all hills away from the border."""

NEIGHBOUR_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Half of the eight neighbours of a point; the others are opposite."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """Feature parameters and texture direction of ISO 25178-2:2021. Undefined ones are nan; see ``notes``.

    Parameters
    ----------
    s10z_nm, s5p_nm, s5v_nm
        Mean height of the five highest significant peaks over the mean plane, mean depth of the five deepest
        significant pits below it, and their sum. [nm]
    spd, svd
        Significant peaks, and pits, per area. [1/mm²]
    spc, svc
        Mean curvature of these peaks, and of these pits (negative). [1/mm]
    std
        Direction of the wave vector of the texture, from +x toward +y, in [0, π); the lay is perpendicular to it. [rad]
    peaks, pits
        Number of significant peaks and pits.
    pruning
        Share of Sz below which a hill or a dale is merged.
    form
        Form removed first.
    notes
        Parameters that are nan or rest on fewer than five peaks; filled holes; areas left out at large holes.
    """

    s10z_nm: float
    s5p_nm: float
    s5v_nm: float
    spd: float
    svd: float
    spc: float
    svc: float
    std: float
    peaks: int
    pits: int
    pruning: float
    form: Form
    notes: tuple[str, ...] = ()


def features(heights: HeightMap, *, form: Form = "plane", pruning: float = 0.05, border: bool = False) -> Features:
    """Return the feature parameters of a map after its form is removed, and the direction of its texture.

    Parameters
    ----------
    heights
        On a rectangular grid in even steps.
    form
        See `remove_form`.
    pruning
        Least height of a peak above its highest saddle, as a share of Sz.
    border
        Whether hills and dales that reach the border of the measured area, or a hole, count, although their peak may
        lie beyond. The grooves of turning always reach it.

    Notes
    -----
    Holes of up to five points across are filled with the plate of least bending. Hills and dales next to larger
    holes are left out with their area; where these cover more than the complete ones, the parameters are nan.

    Raises
    ------
    InputError
        If the grid is polar or uneven, or the map has too few valid heights.

    Sources
    -------
    ISO 25178-2:2021, 4.3.4 and 5, as implemented in surfalize; not checked against the text. Oracles: surfalize, grids
    of bumps in closed form, a brute-force flooding.

    >>> from turnwright.heightmap import HeightMap
    >>> x = 0.001 * np.arange(121)
    >>> bumps = 1e-4 * (np.cos(2 * np.pi * x / 0.020) + np.cos(2 * np.pi * x[:, None] / 0.020))
    >>> found = features(HeightMap(x=x, y=x, z=bumps), form="mean")
    >>> found.peaks, round(found.s10z_nm, 1)   # 7 x 7 less those at the border; from -200 to 200 nm
    (25, 400.0)
    """
    between(pruning, "the pruning", 0.0, 1.0, "")
    valid_points(heights, 9, "feature parameters")
    dx, dy = even_rectangle(heights, "feature parameters", 3)
    flat = remove_form(heights, form)
    mean, least = float(np.nanmean(flat.z)), pruning * float(np.nanmax(flat.z) - np.nanmin(flat.z))
    filling = fill_holes(flat, MAX_HOLE_POINTS * max(dx, dy))
    z = filling.heights.z - mean
    valid = ~np.isnan(z)
    notes = []
    if filling.holes:
        notes.append(
            f"{np.count_nonzero(filling.filled)} missing points in {filling.holes} holes of at most "
            f"{MAX_HOLE_POINTS} points across are filled"
        )
    area = int(np.count_nonzero(valid)) * dx * dy
    features = {}
    for name, side in (("peaks", 1.0), ("pits", -1.0)):
        rows, columns, complete, cut_off = _summits(side * z, valid, least, border=border)
        size = rows.size
        stated = size > 0 and complete >= MIN_COMPLETE_SHARE * (complete + cut_off)
        if cut_off:
            notes.append(
                f"{name} of {100 * cut_off / np.count_nonzero(valid):.2g} % of the area are left out, as their hills "
                f"reach a hole of more than {MAX_HOLE_POINTS} points across"
            )
        if not stated:
            share = "all" if size == 0 else "most"
            where = "" if border else f": {share} reach the border or a hole (border=True counts them)"
            notes.append(f"no significant {name}{where}")
        elif size < AVERAGED_SUMMITS:
            notes.append(f"{size} significant {name}, the mean is of these")
        top = np.sort(side * z[rows, columns])[::-1][:AVERAGED_SUMMITS]
        bend = _curvatures(z, rows, columns, dx, dy)
        features[name] = (
            size,
            size / (area * complete / (complete + cut_off)) if stated else float("nan"),
            float(top.mean()) * NM if stated else float("nan"),
            float(bend.mean()) if stated and bend.size else float("nan"),
        )
    (peaks, spd, s5p, spc), (pits, svd, s5v, svc) = features["peaks"], features["pits"]
    return Features(
        s10z_nm=s5p + s5v,
        s5p_nm=s5p,
        s5v_nm=s5v,
        spd=spd,
        svd=svd,
        spc=spc,
        svc=svc,
        std=_direction(z, valid, dx, dy),
        peaks=peaks,
        pits=pits,
        pruning=pruning,
        form=form,
        notes=tuple(notes),
    )


def _summits(z: Floats, valid: Bools, least: float, *, border: bool) -> tuple[Ints, Ints, int, int]:
    """Return rows and columns of the peaks more than ``least`` above their highest saddle.

    The other values are the numbers of points of their hills, and of hills that reach a hole but not the border.
    """
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    z = np.where(valid, z, -np.inf)
    label, count = _basins(z, valid)
    flat = label.ravel()
    inside = np.flatnonzero(flat)
    order = inside[np.argsort(z.ravel()[inside], kind="stable")]
    summit = np.zeros(count + 1, dtype=np.int64)
    summit[flat[order]] = order  # the last one written is the highest
    hill = _prune_hills(z.ravel()[summit], _saddles(z, label, count), count, least)
    alive = np.flatnonzero(hill == np.arange(count + 1))[1:]
    # A merged hill may have had the higher peak.
    best = summit.copy()
    for one in np.flatnonzero(hill != np.arange(count + 1)):
        if z.ravel()[summit[one]] > z.ravel()[best[hill[one]]]:
            best[hill[one]] = summit[one]
    at_hole = np.zeros(0, dtype=np.int64)
    if not border:
        measured = ndimage.binary_fill_holes(valid, structure=np.ones((3, 3), dtype=np.bool_))
        assert measured is not None  # noqa: S101 - it returns an array where none is given
        open_sides = _neighbours_of(~measured)
        open_sides[[0, -1]] = open_sides[:, [0, -1]] = True
        at_border = np.unique(hill[label[open_sides & valid]])
        at_hole = np.setdiff1d(hill[label[_neighbours_of(measured & ~valid) & valid]], at_border)
        alive = np.setdiff1d(alive, np.concatenate([at_border, at_hole]))
    covered = np.bincount(hill[label[valid]], minlength=count + 1)
    rows, columns = np.unravel_index(best[alive], z.shape)
    complete, cut_off = (int(covered[some].sum()) for some in (alive, at_hole))
    return rows.astype(np.int64), columns.astype(np.int64), complete, cut_off


def _pairs(values: np.ndarray, step: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return views of all points that have a neighbour at a step, and of these neighbours."""
    down, across = step
    rows, columns = values.shape
    low, high = max(0, -across), columns - max(0, across)
    return values[: rows - down, low:high], values[down:, low + across : high + across]


def _neighbours_of(there: Bools) -> Bools:
    """Return the points with at least one of the eight neighbours in a set."""
    near = np.zeros(there.shape, dtype=bool)
    for step in NEIGHBOUR_STEPS:
        one, other = _pairs(near, step)
        first, second = _pairs(there, step)
        one |= second
        other |= first
    return near


def _basins(z: Floats, valid: Bools) -> tuple[Ints, int]:
    """Return the number of the hill of each point by steepest ascent, 0 at invalid points, and the number of hills."""
    from scipy import ndimage  # noqa: PLC0415 - only this needs it

    index = np.arange(z.size, dtype=np.int64).reshape(z.shape)
    highest, upward = np.full(z.shape, -np.inf), index.copy()
    for step in NEIGHBOUR_STEPS:
        for back in (False, True):
            first, there = (1, 0) if back else (0, 1)
            best, way = _pairs(highest, step)[first], _pairs(upward, step)[first]
            target, other = _pairs(index, step)[there], _pairs(z, step)[there]
            higher = other > best
            best[higher] = other[higher]
            way[higher] = target[higher]
    top = ~(highest > z) & valid
    pointer = np.where(top, index, upward).ravel()
    while True:  # each pass doubles the length of the path
        further = pointer[pointer]
        if np.array_equal(further, pointer):
            break
        pointer = further
    seeds, count = ndimage.label(top, structure=np.ones((3, 3)))
    label = np.where(valid, seeds.ravel()[pointer].reshape(z.shape), 0)
    return label.astype(np.int64), int(count)


def _saddles(z: Floats, label: Ints, count: int) -> tuple[Ints, Ints, Floats]:
    """Return all pairs of adjacent hills and their highest saddle, in descending order."""
    keys, heights = [], []
    for step in NEIGHBOUR_STEPS:
        (one, other), (near_height, there) = _pairs(label, step), _pairs(z, step)
        across = (one != other) & (one > 0) & (other > 0)
        low, high = np.minimum(one[across], other[across]), np.maximum(one[across], other[across])
        keys.append(low * (count + 1) + high)
        heights.append(np.minimum(near_height[across], there[across]))
    key, height = np.concatenate(keys), np.concatenate(heights)
    order = np.argsort(-height, kind="stable")
    _, first = np.unique(key[order], return_index=True)
    chosen = order[np.sort(first)]
    return key[chosen] // (count + 1), key[chosen] % (count + 1), height[chosen]


def _prune_hills(peak: Floats, saddles: tuple[Ints, Ints, Floats], count: int, least: float) -> Ints:
    """Return the significant hill that each hill belongs to."""
    joined = list(range(count + 1))  # sets of hills connected above the saddle
    hill = list(range(count + 1))
    tallest = peak.tolist()

    def root(of: list[int], one: int) -> int:
        while of[one] != one:
            of[one] = of[of[one]]
            one = of[one]
        return one

    for one, other, height in zip(*(part.tolist() for part in saddles), strict=True):
        first, second = root(joined, one), root(joined, other)
        if first == second:
            continue
        lower, beyond = one, other
        if tallest[first] > tallest[second]:
            first, second, lower, beyond = second, first, other, one
        if tallest[first] - height < least:
            hill[root(hill, lower)] = root(hill, beyond)
        joined[first] = second
    return np.array([root(hill, one) for one in range(count + 1)])


def _curvatures(z: Floats, rows: Ints, columns: Ints, dx: float, dy: float) -> Floats:
    """Return minus half the Laplacian at points whose neighbours are valid. [1/mm]."""
    inside = (rows > 0) & (rows < z.shape[0] - 1) & (columns > 0) & (columns < z.shape[1] - 1)
    i, j = rows[inside], columns[inside]
    across = (z[i, j - 1] - 2 * z[i, j] + z[i, j + 1]) / dx**2
    along = (z[i - 1, j] - 2 * z[i, j] + z[i + 1, j]) / dy**2
    bend = -(across + along) / 2
    return np.asarray(bend[~np.isnan(bend)])


def _direction(z: Floats, valid: Bools, dx: float, dy: float) -> float:
    """Return the direction of the strongest waves: where the angular spectrum is largest. [rad]."""
    from scipy import fft  # noqa: PLC0415 - only this needs it

    window = np.multiply.outer(*(np.hanning(size + 2)[1:-1] for size in z.shape)) * valid
    mean = float((window * np.where(valid, z, 0.0)).sum() / window.sum())
    waves = np.abs(fft.fft2(window * np.where(valid, z - mean, 0.0), workers=cores()))
    along_y, along_x = fft.fftfreq(z.shape[0], dy)[:, None], fft.fftfreq(z.shape[1], dx)
    reach = min(0.5 / dx, 0.5 / dy)
    size = np.hypot(along_x, along_y)
    # Within the circle that both axes sample, without the main lobe of the window.
    counted = (size <= reach) & (
        (np.abs(along_x) > 1.5 / (z.shape[1] * dx)) | (np.abs(along_y) > 1.5 / (z.shape[0] * dy))
    )
    power = np.where(counted, waves * waves, 0.0)
    if not power.any():
        return float("nan")
    angle = np.arctan2(along_y, along_x) % np.pi
    count = round(np.pi / SECTOR_WIDTH_RAD)
    sector = np.minimum((angle / SECTOR_WIDTH_RAD).astype(np.int64), count - 1)
    density = np.bincount(sector.ravel(), weights=power.ravel(), minlength=count)
    smooth = density + np.roll(density, 1) + np.roll(density, -1)
    strongest = (float(np.argmax(smooth)) + 0.5) * SECTOR_WIDTH_RAD
    off = (angle - strongest + np.pi / 2) % np.pi - np.pi / 2
    near = np.abs(off) <= DIRECTION_HALF_WIDTH_RAD
    return float((strongest + (power[near] @ off[near]) / power[near].sum()) % np.pi)
