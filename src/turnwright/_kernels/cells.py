"""The nearest of many centres, by looking only at those that can be nearest anywhere in a bin of the plane."""

import numpy as np

from turnwright._kernels import jit


@jit
def nearest(x, y, centres, near, corner, step, counts, first, candidates, index, u, v):
    """Fill ``index`` (n,) with the centre nearest to each point, the lowest of several, and ``u, v`` from there.

    Beyond the bins the index is -1. Return how many points are there.

    Points that follow each other mostly have the same centre: it is that of any point within ``near``, below half the
    distance of the closest two. Bins are squares of ``step`` from ``corner``, ``counts`` of them along x and y, row
    after row. The candidates of bin b, ascending, are ``candidates[first[b]:first[b + 1]]``.
    """
    columns, rows = counts
    centre, square_near, beyond = 0, near * near, 0
    for i in range(x.size):
        near_u = x[i] - centres[centre, 0]
        near_v = y[i] - centres[centre, 1]
        if near_u * near_u + near_v * near_v < square_near:
            index[i], u[i], v[i] = centre, near_u, near_v
            continue
        across = (x[i] - corner[0]) / step
        along = (y[i] - corner[1]) / step
        if not (across >= 0.0 and along >= 0.0 and across < columns and along < rows):
            index[i] = -1
            beyond += 1
            continue
        b = np.int64(along) * columns + np.int64(across)
        centre = candidates[first[b]]
        near_u = x[i] - centres[centre, 0]
        near_v = y[i] - centres[centre, 1]
        best = near_u * near_u + near_v * near_v
        for j in range(first[b] + 1, first[b + 1]):
            other_u = x[i] - centres[candidates[j], 0]
            other_v = y[i] - centres[candidates[j], 1]
            square = other_u * other_u + other_v * other_v
            if square < best:
                best = square
                centre = candidates[j]
                near_u = other_u
                near_v = other_v
        index[i] = centre
        u[i] = near_u
        v[i] = near_v
    return beyond


@jit
def border(first, second, x, y, centres, square, out):
    """Fill ``out`` with how much nearer each point is to one centre than to another, as a difference of squares.

    A number as large as that of the centres is what lies around all, with ``square``; below 0 there is none: nan.
    """
    count = centres.shape[0]
    for i in range(x.size):
        squares = 0.0
        for piece, sign in ((first[i], -1.0), (second[i], 1.0)):
            if piece < 0:
                squares = np.nan
            elif piece == count:
                squares += sign * square
            else:
                u, v = x[i] - centres[piece, 0], y[i] - centres[piece, 1]
                squares += sign * (u * u + v * v)
        out[i] = squares
