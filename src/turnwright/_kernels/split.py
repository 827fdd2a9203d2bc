"""Cubic splines over even cells: their Gram matrix over samples, their values, and extremes cell by cell."""

import numpy as np

from turnwright._kernels import jit


@jit
def basis(u, step, order, row):
    """Write the four B-splines of a cell, or their first or second derivative, at ``u`` of its width ``step``."""
    if order == 0:
        row[0] = (1.0 - u) ** 3 / 6.0
        row[1] = ((3.0 * u - 6.0) * u * u + 4.0) / 6.0
        row[2] = (((-3.0 * u + 3.0) * u + 3.0) * u + 1.0) / 6.0
        row[3] = u**3 / 6.0
    elif order == 1:
        row[0] = -((1.0 - u) ** 2) / (2.0 * step)
        row[1] = (3.0 * u - 4.0) * u / (2.0 * step)
        row[2] = ((-3.0 * u + 2.0) * u + 1.0) / (2.0 * step)
        row[3] = u * u / (2.0 * step)
    else:
        row[0] = (1.0 - u) / step**2
        row[1] = (3.0 * u - 2.0) / step**2
        row[2] = (1.0 - 3.0 * u) / step**2
        row[3] = u / step**2


@jit
def cell_of(at, step, cells):
    """Return the cell of a place, the last one up to its end."""
    return min(max(int(at / step), 0), cells - 1)


@jit
def rows(at, step, cells, order, first, row):
    """Write the basis at some places (n,): cells ``first`` (n,) int64, values ``row`` (n, 4)."""
    for i in range(at.size):
        first[i] = cell_of(at[i], step, cells)
        basis(at[i] / step - first[i], step, order, row[i])


@jit
def gram(at, value, weight, step, cells, band, right):
    """Add the weighted products of the basis over samples to ``band`` (4, m), lower diagonals, and ``right`` (m,)."""
    row = np.empty(4)
    for i in range(at.size):
        first = cell_of(at[i], step, cells)
        basis(at[i] / step - first, step, 0, row)
        for a in range(4):
            right[first + a] += weight[i] * row[a] * value[i]
            for b in range(a + 1):
                band[a - b, first + b] += weight[i] * row[a] * row[b]


@jit
def values(at, step, cells, order, coefficients, out):
    """Write the spline or its derivative at some places (n,)."""
    row = np.empty(4)
    for i in range(at.size):
        first = cell_of(at[i], step, cells)
        basis(at[i] / step - first, step, order, row)
        total = 0.0
        for a in range(4):
            total += row[a] * coefficients[first + a]
        out[i] = total


@jit
def extremes(at, step, cells, value, lowest, highest):
    """Write the number of the lowest and of the highest value in every cell (cells,) int64, -1 in an empty one."""
    lowest[:] = -1
    highest[:] = -1
    for i in range(at.size):
        cell = cell_of(at[i], step, cells)
        if lowest[cell] < 0 or value[i] < value[lowest[cell]]:
            lowest[cell] = i
        if highest[cell] < 0 or value[i] > value[highest[cell]]:
            highest[cell] = i
