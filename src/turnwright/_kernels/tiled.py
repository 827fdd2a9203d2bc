"""Statistics of one tile of a large map: sums that merge, and the map at half its resolution.

Sums run over a row each and are then added with compensation, so that they are as good as the longest row is short.
"""

import numpy as np

from turnwright._kernels import jit

SUMS = 11
"""How many sums `residual_sums` makes; the lowest and the highest follow them."""


@jit
def add(totals, lost, k, value):
    """Add ``value`` to total k, and keep in ``lost`` what rounding takes (Neumaier)."""
    total = totals[k] + value
    if abs(totals[k]) >= abs(value):
        lost[k] += (totals[k] - total) + value
    else:
        lost[k] += (value - total) + totals[k]
    totals[k] = total


@jit
def plane_sums(z, out):
    """Fill ``out`` (12,) with the sums for a plane fit of the heights, rows and columns counted from the tile's corner.

    Count, lowest, highest, a height z0 among them, and the sums of i, j, ii, ij, jj, z - z0, i (z - z0), j (z - z0)
    over the columns i and rows j that have a height.
    """
    totals, lost = np.zeros(12), np.zeros(12)
    low, high, first = np.inf, -np.inf, np.nan
    for j in range(z.shape[0]):
        n, si, sii, sz, siz = 0, 0, 0, 0.0, 0.0
        for i in range(z.shape[1]):
            h = z[j, i]
            if np.isnan(h):
                continue
            if np.isnan(first):
                first = h
            low, high = min(low, h), max(high, h)
            n += 1
            si += i
            sii += i * i
            sz += h - first
            siz += i * (h - first)
        row = (
            float(n), 0.0, 0.0, 0.0, float(si), float(j * n), float(sii), float(j * si), float(j * j * n), sz, siz,
            j * sz,
        )  # fmt: skip
        for k in range(12):
            add(totals, lost, k, row[k])
    for k in range(12):
        out[k] = totals[k] + lost[k]
    out[1], out[2], out[3] = low, high, first


@jit
def residual_sums(z, rows, columns, level, along_x, along_y, dx, dy, out):
    """Fill ``out`` (13,) with the sums of the residual of a tile from a plane, its differences and its area.

    ``z`` has ``rows`` and ``columns`` of its own and one more of its neighbours, nan where there are none. The plane is
    ``level`` at the corner and rises by ``along_x`` and ``along_y`` a step. Sums: |r|, r², r³, r⁴, their count; squared
    slopes along x, count; along y, count; excess area of the cells with four corners, by both diagonals twice, count.
    Last the lowest and the highest r.
    """
    totals, lost = np.zeros(SUMS), np.zeros(SUMS)
    low, high = np.inf, -np.inf
    above, below = np.empty(columns + 1), np.empty(columns + 1)
    for i in range(columns + 1):
        below[i] = z[0, i] - (level + along_x * i)
    for j in range(rows):
        above, below = below, above
        for i in range(columns + 1):
            below[i] = z[j + 1, i] - (level + along_x * i + along_y * (j + 1))
        n, first, second, third, fourth = 0, 0.0, 0.0, 0.0, 0.0
        n_across, across, n_down, down, n_cells, cells = 0, 0.0, 0, 0.0, 0, 0.0
        left_slope = (below[0] - above[0]) / dy
        left_slope *= left_slope
        for i in range(columns):
            r = above[i]
            right = (below[i + 1] - above[i + 1]) / dy
            right *= right
            if not np.isnan(r):
                low, high = min(low, r), max(high, r)
                n += 1
                square = r * r
                first += abs(r)
                second += square
                third += square * r
                fourth += square * square
                if not np.isnan(left_slope):
                    n_down += 1
                    down += left_slope
                upper = (above[i + 1] - r) / dx
                upper *= upper
                if not np.isnan(upper):
                    n_across += 1
                    across += upper
                    lower = (below[i + 1] - below[i]) / dx
                    lower *= lower
                    if not np.isnan(lower):
                        n_cells += 1
                        for steep in (upper + left_slope, upper + right, lower + left_slope, lower + right):
                            cells += steep / (1.0 + np.sqrt(1.0 + steep))
            left_slope = right
        row = (
            first, second, third, fourth, float(n), across, float(n_across), down, float(n_down), cells, float(n_cells),
        )  # fmt: skip
        for k in range(SUMS):
            add(totals, lost, k, row[k])
    for k in range(SUMS):
        out[k] = totals[k] + lost[k]
    out[SUMS], out[SUMS + 1] = low, high


@jit
def halved(z, out):
    """Fill ``out`` with the means of 2 x 2 heights, those missing left out; what is beyond the border is missing."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            total, count = 0.0, 0
            for row in range(2 * j, min(2 * j + 2, z.shape[0])):
                for column in range(2 * i, min(2 * i + 2, z.shape[1])):
                    if not np.isnan(z[row, column]):
                        total += z[row, column]
                        count += 1
            out[j, i] = total / count if count > 0 else np.nan
