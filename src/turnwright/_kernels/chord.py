"""The fewest points of a sampled curve that a polyline through them needs."""

import numpy as np

from turnwright._kernels import jit


@jit
def fits(t, z, slack, first, last):
    """Return whether a straight line between two samples passes all between within their slack."""
    slope = (z[last] - z[first]) / (t[last] - t[first])
    fit = True
    for j in range(first + 1, last):
        fit &= abs(z[j] - z[first] - slope * (t[j] - t[first])) <= slack[j]
    return fit


@jit
def fewest(t, z, slack, widest, keep):
    """Choose samples, each as far from the last as a straight line still fits; return how many.

    A line from the last point fits while its slope lies in a cone: the intersection of the slopes that pass each
    sample between within its ``slack``. The cone only narrows, so the search ends soon after the furthest fit.

    t, z, slack (n,); ``widest`` the longest step in t; ``keep`` (n,) int64 takes the numbers of the samples, with
    the first and the last among them.
    """
    n = t.size
    keep[0] = 0
    count = 1
    anchor = 0
    while anchor < n - 1:
        low, high = -np.inf, np.inf
        best = anchor + 1
        for j in range(anchor + 1, n):
            dt = t[j] - t[anchor]
            if dt > widest * (1.0 + 1e-9):
                break
            rise = z[j] - z[anchor]
            slope = rise / dt
            if low <= slope <= high:
                best = j
            low = max(low, (rise - slack[j]) / dt)
            high = min(high, (rise + slack[j]) / dt)
            if low > high:
                break
        anchor = best
        keep[count] = anchor
        count += 1
    if count > 2:
        # What is left over may be a short last step, which would have to pass in no time: share the last two evenly.
        anchor, middle = keep[count - 3], keep[count - 2]
        while t[middle] - t[anchor] > t[n - 1] - t[middle]:
            middle -= 1
        if fits(t, z, slack, anchor, middle) and fits(t, z, slack, middle, n - 1):
            keep[count - 2] = middle
    return count
