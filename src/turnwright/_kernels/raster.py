"""A polar map seen on a rectangular grid."""

import math

import numpy as np

from turnwright._kernels import jit


@jit
def over_grid(x, y, z, angle, radius, step, before, after, out):
    """Fill ``out`` (ny, nx) with a polar map at columns ``x`` and rows ``y``, nan where it has nothing.

    Each place has the mean of the heights of the nearest ray, from ``before`` rings below the nearest ring up to
    ``after`` above it (not itself), those that are nan left out.

    z (n_angle, n_radius); its first ray is at ``angle`` [rad], the rays evenly about the whole turn, and its first ring
    at ``radius``, the others ``step`` apart [mm].
    """
    rays, rings = z.shape
    per_ray = rays / (2.0 * math.pi)
    rim = radius + (rings - 1) * step
    rim = rim * rim * (1.0 + 2e-12)
    for row in range(y.size):
        for column in range(x.size):
            square = x[column] * x[column] + y[row] * y[row]
            if square > rim:
                out[row, column] = np.nan
                continue
            ray = round((math.atan2(y[row], x[column]) - angle) * per_ray) % rays
            ring = round((math.sqrt(square) - radius) / step)
            total, count = 0.0, 0
            for k in range(max(ring - before, 0), min(ring + after, rings)):
                if not math.isnan(z[ray, k]):
                    total += z[ray, k]
                    count += 1
            out[row, column] = total / count if count > 0 else np.nan
