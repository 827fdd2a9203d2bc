"""Noise of a map estimated from the map: white from neighbours, correlated from the residual of smooth terms."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from turnwright._arrays import robust_scatter
from turnwright.metrology.grid import polynomial_terms
from turnwright.metrology.rigid import MIN_SCATTER_MM, Problem, residuals, rows, turns

if TYPE_CHECKING:
    from turnwright._arrays import Bools, Floats, Ints
    from turnwright.heightmap import HeightMap

RUN_LENGTH = 4
"""Points of a third difference, which is free of height, slope and curvature."""

MAX_RUNS = 4000

THIRD_DIFFERENCE_VARIANCE = 20.0
"""Variance of the third difference of independent heights, relative to that of a height."""

MIN_ALONG_COSINE = 0.9
"""Least cosine between a run and the cutting direction for the run to cross no cusps."""

MIN_RUNS_ALONG = 300
"""Runs along the cutting direction from which the other runs are ignored."""

PLANE_POINTS = 6
"""Neighbouring scattered points to which a plane is fitted."""

POINTS_PER_CELL = 10

CHI2_3_MEDIAN = 2.365974
"""Median of chi-square with three degrees of freedom, as for the residuals of six points about a plane."""

SMOOTH_DEGREE = 6
"""Degree of the smooth terms that are form, not noise."""

OUTLIER_SIGMA = 6.0
"""Robust standard deviations beyond which a residual is not noise."""

MIN_CORRELATION_POINTS = 400

MIN_NOISE_SHARE = 0.3
"""Lower bound of the share of the correlated noise that remains after the smooth terms are removed."""

CELL_POINTS, MAX_CELLS = 4, 64


class MapNoise(NamedTuple):
    """White and correlated noise of a map.

    ``white`` and ``correlated`` are standard deviations [mm], ``length`` is the correlation radius [mm], and ``area``
    the area of an independent cell of the correlated noise relative to that of a point.
    """

    white: float
    correlated: float
    length: float
    area: float

    @property
    def effective(self) -> float:
        """Standard deviation of independent noise with the same effect on a pose. [mm]."""
        return float(np.sqrt(self.white**2 + self.correlated**2 * max(self.area, 1.0)))


def map_noise(problem: Problem, some: Problem, state: Floats, heights: HeightMap, which: Ints) -> MapNoise:
    """Return the noise of a map about a pose so close that the residual is smooth between neighbours.

    ``some`` is the sample for the correlation; ``which`` is the index of each point in the map.
    """
    scatter = (
        _scatter_in_cells(problem, state) if heights.scattered else _scatter_along_cut(problem, state, heights, which)
    )
    return _add_correlated_noise(some, state, max(scatter, MIN_SCATTER_MM), problem.points.shape[1])


def _scatter_along_cut(problem: Problem, state: Floats, heights: HeightMap, which: Ints) -> float:
    """Return the scatter of third differences over a grid, along the cutting direction if possible. [mm]."""
    measured = np.zeros(heights.z.shape, dtype=np.bool_)
    measured.ravel()[which] = True
    place = np.cumsum(measured.ravel()) - 1
    random = np.random.default_rng(0)
    run_lengths: list[Ints] = []
    for axis in (0, 1):
        begin = _run_starts(measured, axis)
        if begin.size > MAX_RUNS:
            begin = np.sort(random.choice(begin, MAX_RUNS, replace=False))
        stride = heights.z.shape[1] if axis == 0 else 1
        run_lengths.append(place[begin + stride * np.arange(RUN_LENGTH)[:, None]])
    runs = np.concatenate(run_lengths, axis=1)
    if runs.size == 0:
        return 0.0
    few = problem.only(runs.ravel())
    residual = residuals(few, state).reshape(runs.shape)
    difference = np.abs(residual[3] - 3 * residual[2] + 3 * residual[1] - residual[0]) / np.sqrt(
        THIRD_DIFFERENCE_VARIANCE
    )
    at = _lateral(few, state)
    first, last = (at[:, k * runs.shape[1] : (k + 1) * runs.shape[1]] for k in (0, RUN_LENGTH - 1))
    way, middle = last - first, (last + first) / 2
    across = np.abs(way[0] * middle[1] - way[1] * middle[0])  # of the tangent, which is (-y, x) there
    size = np.hypot(*way) * np.hypot(*middle)
    along = across >= MIN_ALONG_COSINE * size
    good = np.isfinite(difference)
    if np.count_nonzero(good & along) >= MIN_RUNS_ALONG:
        good &= along
    return _scatter(difference[good])


def _lateral(problem: Problem, state: Floats) -> Floats:
    """Return the lateral positions of the points on the part. (2, n) [mm]."""
    return np.asarray(turns(state)[0][:2] @ problem.points + state[:2, None])


def _run_starts(known: Bools, axis: int) -> Ints:
    """Return the flat index of the first of every run of valid neighbours along an axis."""
    if known.shape[axis] < RUN_LENGTH:
        return np.empty(0, dtype=np.int64)
    complete = sliding_window_view(known, RUN_LENGTH, axis=axis).all(axis=-1)
    return np.ravel_multi_index(np.nonzero(complete), known.shape)


def _scatter(size: Floats) -> float:
    """Return the robust standard deviation of magnitudes; their rms where most are zero."""
    return robust_scatter(size) or (float(np.sqrt(np.mean(size**2))) if size.size else 0.0)


def _scatter_in_cells(problem: Problem, state: Floats) -> float:
    """Return the scatter of scattered points about the planes of their neighbours. [mm]."""
    at = _lateral(problem, state)
    low, high = at.min(axis=1), at.max(axis=1)
    width, height = np.maximum(high - low, 1e-300)
    side = np.sqrt(width * height * POINTS_PER_CELL / at.shape[1])
    columns = int(width / side) + 1
    cell = ((at[1] - low[1]) / side).astype(np.int64) * columns + ((at[0] - low[0]) / side).astype(np.int64)
    order = np.argsort(cell, kind="stable")
    first = np.flatnonzero(np.diff(cell[order], prepend=-1))
    size = np.diff(first, append=cell.size)
    first = first[size >= PLANE_POINTS]
    if first.size == 0:
        return 0.0
    if first.size > MAX_RUNS:
        first = np.random.default_rng(0).choice(first, MAX_RUNS, replace=False)
    chosen = order[first[:, None] + np.arange(PLANE_POINTS)]
    few = problem.only(chosen.ravel())
    residual = residuals(few, state).reshape(chosen.shape)
    x, y = (one.reshape(chosen.shape) for one in _lateral(few, state))
    good = np.isfinite(residual).all(axis=1)
    plane = np.stack([np.ones_like(x), x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)], axis=-1)
    base, _ = np.linalg.qr(plane[good])
    off = residual[good]
    off = off - np.einsum("mij,mj->mi", base, np.einsum("mij,mi->mj", base, off))
    square = (off * off).sum(axis=1)
    if square.size == 0:
        return 0.0
    return float(np.sqrt(np.median(square) / CHI2_3_MEDIAN)) or float(np.sqrt(np.mean(square) / (PLANE_POINTS - 3)))


def _add_correlated_noise(some: Problem, state: Floats, white: float, count: int) -> MapNoise:
    """Add the correlated noise: its variance, and its power at long wavelengths from means over cells."""
    sample = rows(some, state, slice(0, some.points.shape[1]))
    if sample.residual.size < MIN_CORRELATION_POINTS:
        return MapNoise(white, 0.0, 0.0, 0.0)
    x, y, residual = sample.at[0], sample.at[1], sample.residual
    low, high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
    u, v = 2 * (x - low[0]) / max(high[0] - low[0], 1e-300) - 1, 2 * (y - low[1]) / max(high[1] - low[1], 1e-300) - 1
    terms = polynomial_terms(u, v, SMOOTH_DEGREE)
    keep = np.ones(residual.size, dtype=np.bool_)
    for _ in range(2):
        solved = np.linalg.lstsq(terms[keep], residual[keep], rcond=1e-12)[0]
        noise = residual - terms @ solved
        keep = np.abs(noise) <= OUTLIER_SIGMA * max(robust_scatter(noise), MIN_SCATTER_MM)
    x, y, noise = x[keep], y[keep], noise[keep]
    excess = float(np.mean(noise**2)) * residual.size / (residual.size - terms.shape[1]) - white**2
    cells = int(np.clip(np.sqrt(noise.size / CELL_POINTS), 4, MAX_CELLS))
    side = float((high - low).max()) / cells * (1 + 1e-9)
    number = ((y - low[1]) / side).astype(np.int64) * cells + ((x - low[0]) / side).astype(np.int64)
    points = np.bincount(number, minlength=cells * cells).reshape(cells, cells)
    there = points > 0
    mean = np.bincount(number, weights=noise, minlength=cells * cells).reshape(cells, cells) / np.maximum(points, 1)
    both = [np.fft.rfft2(one, s=(2 * cells, 2 * cells)) for one in (mean * there, there.astype(np.float64))]
    products, pairs = (np.fft.irfft2(np.abs(one) ** 2, s=(2 * cells, 2 * cells)) for one in both)
    lag = np.minimum(np.arange(2 * cells), 2 * cells - np.arange(2 * cells))
    ring = np.rint(np.hypot(lag, lag[:, None])).astype(np.int64).ravel()
    valid = pairs.ravel() > 0.5
    sums = np.bincount(ring[valid], weights=products.ravel()[valid])
    weight = np.bincount(ring[valid], weights=pairs.ravel()[valid])
    counts = np.bincount(ring[valid])
    correlation = sums / np.maximum(weight, 1.0)
    correlation[0] -= white**2 * float(np.mean(1 / points[there]))
    # Up to the first change of sign; beyond are residual form and chance.
    below = correlation <= 0
    end = int(np.argmax(below)) if below.any() else correlation.size
    power = float((correlation[:end] * counts[:end]).sum()) * side * side
    if excess <= 0 or power <= 0:
        return MapNoise(white, 0.0, 0.0, 0.0)
    covered = float(np.count_nonzero(there)) * side * side
    # The smooth terms have removed as many independent cells as there are terms.
    share = max(1 - terms.shape[1] * power / excess / covered, MIN_NOISE_SHARE)
    excess, power = excess / share, power / share
    per_point = covered / count * some.points.shape[1] / residual.size
    return MapNoise(white, float(np.sqrt(excess)), float(np.sqrt(power / excess / np.pi)), power / excess / per_point)
