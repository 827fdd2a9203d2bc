"""Outliers of a grid: deviations of points from their neighbours."""

import numpy as np

from turnwright._kernels import jit

CENTRAL = 1.5**-0.5
"""Deviation of noise over that of a point minus the mean of its two neighbours."""

ONE_SIDED = 6.0**-0.5
"""The same for a point minus the line through the next two on one side."""


@jit
def second_differences(z, first, last, across, along):
    """Write the second differences of rows ``first`` to ``last`` of a grid (m, n), nan where a neighbour is missing."""
    m, n = z.shape
    for i in range(first, last):
        for j in range(n):
            across[i, j] = z[i, j - 1] - 2.0 * z[i, j] + z[i, j + 1] if 0 < j < n - 1 else np.nan
            along[i, j] = z[i - 1, j] - 2.0 * z[i, j] + z[i + 1, j] if 0 < i < m - 1 else np.nan


@jit
def neighbour(z, piece, i, j, row, column, closed):
    """Return the height at (row, column) if it is of the same piece as that at (i, j), else nan."""
    m, n = z.shape
    if closed:
        row %= m
    if row < 0 or row >= m or column < 0 or column >= n or piece[row, column] != piece[i, j]:
        return np.nan
    return z[row, column]


@jit
def stand_out(z, piece, closed, ways, least, index, out):
    """Write the deviation of points from their neighbours, the least over some directions, for noise of 1.

    The ways are the row, the column and, if there are four, both diagonals. A point that stands out to different sides
    stands out by 0; one with fewer than ``least`` ways that can be judged is nan. ``index`` (k,) are flat places.
    """
    n = z.shape[1]
    for k in range(index.size):
        i, j = index[k] // n, index[k] % n
        lowest, highest, judged = np.inf, -np.inf, 0
        for way in range(ways):
            di = 0 if way == 0 else 1
            dj = 0 if way == 1 else (-1 if way == 3 else 1)
            after = neighbour(z, piece, i, j, i + di, j + dj, closed)
            before = neighbour(z, piece, i, j, i - di, j - dj, closed)
            value = (z[i, j] - 0.5 * (after + before)) * CENTRAL
            if np.isnan(value):
                value = (z[i, j] - 2 * after + neighbour(z, piece, i, j, i + 2 * di, j + 2 * dj, closed)) * ONE_SIDED
            if np.isnan(value):
                value = (z[i, j] - 2 * before + neighbour(z, piece, i, j, i - 2 * di, j - 2 * dj, closed)) * ONE_SIDED
            if not np.isnan(value):
                judged += 1
                lowest = min(lowest, value)
                highest = max(highest, value)
        if judged < least:
            out[i, j] = np.nan
        elif lowest > 0.0:
            out[i, j] = lowest
        else:
            out[i, j] = min(highest, 0.0)


@jit
def prominent(amount, closed, bound, index, chosen):
    """Fill which places (k,) exceed the median around them by more than the bound, and by more than their neighbours.

    The median is over 5 x 5 points, so that the curvature of a surface is no outlier.
    """
    m, n = amount.shape
    around = np.empty(24)
    for k in range(index.size):
        i, j = index[k] // n, index[k] % n
        deviation, count, largest = amount[i, j], 0, True
        for di in range(-2, 3):
            for dj in range(-2, 3):
                row, column = i + di, j + dj
                if closed:
                    row %= m
                if (di == 0 and dj == 0) or row < 0 or row >= m or column < 0 or column >= n:
                    continue
                value = amount[row, column]
                if np.isnan(value):
                    continue
                around[count] = value
                count += 1
                if abs(di) < 2 and abs(dj) < 2 and abs(value) > abs(deviation):
                    largest = False
        if count > 0:
            deviation -= np.median(around[:count])
        chosen[k] = largest and abs(deviation) > bound
