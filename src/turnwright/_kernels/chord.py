"""The fewest points of a sampled curve that a polyline through them needs."""

import numpy as np

from turnwright._kernels import jit


@jit
def doubts(z, first, doubt, bend):
    """Fill, for each interval of even samples, the first of four to interpolate from, their doubt, and the bend.

    The doubt is the greater of two neighbouring fourth differences, of samples around the interval, before or behind
    it, whichever is least. The bend is the lesser second difference of both ends: next to a slope discontinuity it is
    that of the smooth side. Each (n - 1,)
    """
    n = z.size
    for k in range(n - 1):
        first[k], doubt[k] = 0, np.inf
        for i, j in ((k - 1, k - 2), (k - 2, k - 4), (k, k)):
            if 0 <= j < n - 5:
                pair = max(abs(fourth(z, j)), abs(fourth(z, j + 1)))
                if pair < doubt[k]:
                    first[k], doubt[k] = i, pair
        i, j = max(k - 1, 0), min(k + 2, n - 1)
        bend[k] = min(abs(z[i] - 2.0 * z[k] + z[k + 1]), abs(z[k] - 2.0 * z[k + 1] + z[j]))


@jit
def fourth(z, i):
    """Return the fourth difference of the samples from i on."""
    return z[i] - 4.0 * z[i + 1] + 6.0 * z[i + 2] - 4.0 * z[i + 3] + z[i + 4]


@jit
def interpolate(z, low, first, fine):
    """Fill ``fine`` (m, most) with the samples from ``low`` on, and those of the cubics between; see `doubts`."""
    most = fine.shape[1]
    for k in range(fine.shape[0]):
        i = first[low + k]
        a, b, c, d = z[i] / 6.0, z[i + 1] / 2.0, z[i + 2] / 2.0, z[i + 3] / 6.0
        fine[k, 0] = z[low + k]
        for j in range(1, most):
            t = j / most + (low + k - i)
            u, v, w = t - 1.0, t - 2.0, t - 3.0
            fine[k, j] = u * v * (d * t - a * w) + t * w * (b * v - c * u)


@jit
def bulges(t, z, tolerance, bulge):
    """Fill the bound of the bulge of each interval (n - 1,); return the greatest over the lesser tolerance of its ends.

    It is half the step times the change of slope to either neighbour, at the ends to the only one.
    """
    most = 0.0
    last = bulge.size - 1
    before = 0.0  # the change of slope at the sample
    slope = (z[1] - z[0]) / (t[1] - t[0])
    for k in range(bulge.size):
        after, following = 0.0, slope
        if k < last:
            following = (z[k + 2] - z[k + 1]) / (t[k + 2] - t[k + 1])
            after = abs(following - slope)
        bulge[k] = (t[k + 1] - t[k]) * max(before, after) * (1.0 if k in (0, last) else 0.5)
        most = max(most, bulge[k] / min(tolerance[k], tolerance[k + 1]))
        before, slope = after, following
    return most


@jit
def lessen(slack, bulge, doubt):
    """Lessen the slack at each sample by a doubt and the larger bulge next to it."""
    last = bulge.size - 1
    for k in range(slack.size):
        slack[k] -= doubt + max(bulge[max(k - 1, 0)], bulge[min(k, last)])


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
