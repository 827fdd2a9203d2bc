"""The nearest point of a closed polygon, and whether a point is inside."""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit

__all__ = ["nearest"]


@jit
def nearest(corner_x, corner_y, x, y, near_x, near_y, inside):
    """Fill the nearest point of the border for each point, and whether an odd number of edges is to its right."""
    corners = corner_x.size
    for i in range(x.size):
        best = np.inf
        odd = False
        for k in range(corners):
            j = k - 1 if k > 0 else corners - 1
            ax, ay, bx, by = corner_x[j], corner_y[j], corner_x[k], corner_y[k]
            dx, dy = bx - ax, by - ay
            t = ((x[i] - ax) * dx + (y[i] - ay) * dy) / (dx * dx + dy * dy)
            t = min(max(t, 0.0), 1.0)
            px, py = ax + t * dx, ay + t * dy
            square = (x[i] - px) ** 2 + (y[i] - py) ** 2
            if square < best:
                best, near_x[i], near_y[i] = square, px, py
            if (ay > y[i]) != (by > y[i]) and x[i] < ax + (y[i] - ay) / dy * dx:
                odd = not odd
        inside[i] = odd
