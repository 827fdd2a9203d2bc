"""Filters point by point: local polynomials from their moments, robust weights, and the spline of a line."""

import numpy as np

from turnwright._kernels import jit

BLOCK = 256


@jit
def solve(products, moments, pairs, nominal, relative, absolute, out):
    """Write the constant term of a weighted local polynomial at every point, or nan where nothing determines it.

    ``products`` (p, n) hold the distinct sums of weight times two terms, ``moments`` (k, n) those of weight, term and
    height; ``pairs`` (k, k) says which product belongs to which two terms. The constant is the last term, so that
    elimination ends at it. A term that the weights do not determine, its pivot below ``relative`` times the weight or
    below ``absolute`` of ``nominal`` (k,), is left out.
    """
    terms, count = moments.shape
    matrix, right = np.empty((terms, terms, BLOCK)), np.empty((terms, BLOCK))
    inverse, factor = np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, count, BLOCK):
        size = min(BLOCK, count - start)
        for a in range(terms):
            for i in range(size):
                right[a, i] = moments[a, start + i]
            for b in range(a, terms):
                product = products[pairs[a, b]]
                for i in range(size):
                    matrix[a, b, i] = product[start + i]
        weight = products[pairs[terms - 1, terms - 1]]
        for pivot in range(terms - 1):
            for i in range(size):
                least = nominal[pivot] * max(relative * weight[start + i], absolute)
                value = matrix[pivot, pivot, i]
                inverse[i] = 1.0 / value if value > least else 0.0
            for a in range(pivot + 1, terms):
                for i in range(size):
                    factor[i] = matrix[pivot, a, i] * inverse[i]
                    right[a, i] -= factor[i] * right[pivot, i]
                for b in range(a, terms):
                    for i in range(size):
                        matrix[a, b, i] -= factor[i] * matrix[pivot, b, i]
        for i in range(size):
            value = matrix[terms - 1, terms - 1, i]
            least = max(relative * weight[start + i], absolute)
            out[start + i] = right[terms - 1, i] / value if value > least else np.nan


@jit
def biweight(z, wave, bound, weight):
    """Write Tukey's weight of the distance of ``z`` from ``wave``, lines (m, n), 0 beyond the ``bound`` of a line."""
    for row in range(z.shape[0]):
        for i in range(z.shape[1]):
            share = (z[row, i] - wave[row, i]) / bound[row]
            inner = 1.0 - share * share
            weight[row, i] = inner * inner if inner > 0.0 else 0.0  # nan falls to 0


@jit
def advance(z, new, bound, wave, distance, change):
    """Take over a new mean of lines (m, n) where it is not nan, write the distance of ``z`` from it, nan where z is.

    ``change`` (m,) is the sum of the squares by which the mean moved at the valid points, in bounds.
    """
    for row in range(z.shape[0]):
        total = 0.0
        for i in range(z.shape[1]):
            moved = new[row, i] - wave[row, i]
            if not np.isnan(moved):
                wave[row, i] = new[row, i]
                if not np.isnan(z[row, i]):
                    total += moved * moved
            distance[row, i] = abs(z[row, i] - wave[row, i])
        change[row] = total / (bound[row] * bound[row])


@jit
def spline(z, stiffness, out):
    """Write the smoothing spline of every line (m, n) through what is not nan; nan where a line has too few points.

    Minimises the sum of (z - w)² over the valid points and ``stiffness`` times that of the squared second differences
    of w. The banded factors lose digits where the spline is stiff, and two refinements win them back.
    """
    lines, n = z.shape
    diagonal, first, second = np.empty(n), np.empty(n), np.empty(n)
    bend, right = np.empty(n), np.empty(n)
    for line in range(lines):
        valid = 0
        for i in range(n):
            valid += not np.isnan(z[line, i])
        if valid < 2:
            out[line] = np.nan
            continue
        for i in range(n):
            diagonal[i] = 0.0 if np.isnan(z[line, i]) else 1.0
            first[i] = 0.0
            second[i] = 0.0
        for i in range(1, n - 1):
            diagonal[i - 1] += stiffness
            diagonal[i] += 4.0 * stiffness
            diagonal[i + 1] += stiffness
            first[i - 1] -= 2.0 * stiffness
            first[i] -= 2.0 * stiffness
            second[i - 1] += stiffness
        for i in range(n):
            low, lower = first[i], second[i]
            if i + 1 < n:
                first[i] = low / diagonal[i]
                diagonal[i + 1] -= first[i] * low
                if i + 2 < n:
                    first[i + 1] -= first[i] * lower
                    second[i] = lower / diagonal[i]
                    diagonal[i + 2] -= second[i] * lower
        wave = out[line]
        wave[:] = 0.0
        for _ in range(3):
            for i in range(1, n - 1):
                bend[i] = stiffness * (wave[i - 1] - 2.0 * wave[i] + wave[i + 1])
            bend[0] = 0.0
            bend[n - 1] = 0.0
            for i in range(n):
                value = z[line, i] - wave[i]
                if np.isnan(value):
                    value = 0.0
                value += 2.0 * bend[i]
                if i > 0:
                    value -= bend[i - 1]
                if i + 1 < n:
                    value -= bend[i + 1]
                right[i] = value
            for i in range(n):
                if i > 0:
                    right[i] -= first[i - 1] * right[i - 1]
                if i > 1:
                    right[i] -= second[i - 2] * right[i - 2]
            for i in range(n - 1, -1, -1):
                right[i] /= diagonal[i]
                if i + 1 < n:
                    right[i] -= first[i] * right[i + 1]
                if i + 2 < n:
                    right[i] -= second[i] * right[i + 2]
            for i in range(n):
                wave[i] += right[i]
