"""How well levelled points fit a table of heights at each of many lateral places."""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit

__all__ = ["misfit"]


@jit
def misfit(x, y, z, places, table, low, step, out):
    """Fill ``out`` (2, m) with how many points lie on the table, and their mean square from it, less its best plane.

    A place (px, py, turn) puts the points at (px, py) + Rz(turn) (x, y). The square ``table`` starts at ``low`` in x
    and y and is nan where there is no surface; a place with fewer than four points on it fits infinitely badly.
    """
    last = table.shape[0] - 1.0
    for k in range(places.shape[0]):
        c, s = np.cos(places[k, 2]), np.sin(places[k, 2])
        n = sx = sy = sxx = sxy = syy = sr = srx = sry = srr = 0.0
        for i in range(x.size):
            u = (places[k, 0] + c * x[i] - s * y[i] - low) / step
            v = (places[k, 1] + s * x[i] + c * y[i] - low) / step
            if not (u >= 0.0 and v >= 0.0 and u < last and v < last):
                continue
            a, b = int(u), int(v)
            fu, fv = u - a, v - b
            height = (1.0 - fv) * ((1.0 - fu) * table[b, a] + fu * table[b, a + 1]) + fv * (
                (1.0 - fu) * table[b + 1, a] + fu * table[b + 1, a + 1]
            )
            r = z[i] - height
            if not np.isfinite(r):
                continue
            n += 1.0
            sx += x[i]
            sy += y[i]
            sxx += x[i] * x[i]
            sxy += x[i] * y[i]
            syy += y[i] * y[i]
            sr += r
            srx += r * x[i]
            sry += r * y[i]
            srr += r * r
        out[0, k] = n
        if n < 4.0:
            out[1, k] = np.inf
            continue
        # About the middle of the points that count, the plane is a mean and two slopes.
        sxx -= sx * sx / n
        sxy -= sx * sy / n
        syy -= sy * sy / n
        srx -= sr * sx / n
        sry -= sr * sy / n
        srr -= sr * sr / n
        det = sxx * syy - sxy * sxy
        if det > 1e-12 * sxx * syy:
            srr -= (syy * srx * srx - 2.0 * sxy * srx * sry + sxx * sry * sry) / det
        out[1, k] = max(srr, 0.0) / n
