"""The cubic spline through the points of an axis, and its values at even steps of time."""

import numpy as np

from turnwright._kernels import jit


@jit
def fill_slopes(time, value, out):
    """Fill ``out`` with the slopes of the spline at its points; at both ends those of parabolas. Each (n,), n > 1."""
    last = time.size - 1
    low = (value[1] - value[0]) / (time[1] - time[0])
    out[0] = out[last] = low
    if last == 1:
        return
    # Continuity of the second derivative is a diagonally dominant system of three diagonals.
    upper = np.zeros(last)
    for i in range(1, last):
        before, after = time[i] - time[i - 1], time[i + 1] - time[i]
        high = (value[i + 1] - value[i]) / after
        share = after / (before + after)
        mean = share * low + (1.0 - share) * high
        if i == 1:
            out[0] = 2.0 * low - mean
        if i == last - 1:
            out[last] = 2.0 * high - mean
        pivot = 2.0 - share * upper[i - 1]
        upper[i] = (1.0 - share) / pivot
        out[i] = (3.0 * mean - share * out[i - 1]) / pivot
        low = high
    for i in range(last - 1, 0, -1):
        out[i] -= upper[i] * out[i + 1]


@jit
def sample(time, value, slope, piece, begin, end, out):
    """Fill ``out`` with the spline at even steps from ``begin``, which is in ``piece``, to one before ``end``."""
    last = time.size - 2
    step = (end - begin) / out.size
    for i in range(out.size):
        t = begin + i * step
        while piece < last and time[piece + 1] <= t:
            piece += 1
        span = time[piece + 1] - time[piece]
        s = t - time[piece]
        mean = (value[piece + 1] - value[piece]) / span
        square = (3.0 * mean - 2.0 * slope[piece] - slope[piece + 1]) / span
        cube = (slope[piece] + slope[piece + 1] - 2.0 * mean) / (span * span)
        out[i] = value[piece] + s * (slope[piece] + s * (square + s * cube))
