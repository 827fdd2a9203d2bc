"""The backplotter of Troutman 2016 (UNC Charlotte, ch. 8), its idea in plain NumPy: a peer to compare with.

A polar grid; for every azimuth of it, for every pass of the tool over that azimuth, the edge is taken from a table that
is linear between its points, put where the tool stands, and the lower of it and the map so far is kept.
"""

import numpy as np


def tool_table(nose_radius, half_angle, step):
    """Distances from the tip and heights of a round edge above it, at most ``step`` apart. (n,), (n,) [mm]."""
    width = nose_radius * np.sin(half_angle)
    u = np.linspace(-width, width, 2 * int(np.ceil(width / step)) + 1)
    return u, nose_radius - np.sqrt(nose_radius**2 - u**2)


def backplot(axes, table, radius, angle):
    """Return the heights left by the axes C, X and Z at ``angle`` and ``radius``. (n_angle, n_radius) [mm].

    Passes from beyond the axis are not looked at, so it holds for radii that those do not reach.
    """
    c, x, z = (axes[letter] for letter in "CXZ")
    u, edge = table
    surface = np.full((angle.size, radius.size), np.inf)
    for row, azimuth in zip(surface, angle, strict=True):
        first = np.ceil((c[0] - azimuth) / (2 * np.pi) - 1e-9)
        last = np.floor((c[-1] - azimuth) / (2 * np.pi) + 1e-9)
        crossings = azimuth + 2 * np.pi * np.arange(first, last + 1)
        tips, levels = np.interp(crossings, c, x), np.interp(crossings, c, z)
        begins = np.searchsorted(radius, tips + u[0])
        ends = np.searchsorted(radius, tips + u[-1], side="right")
        for tip, level, begin, end in zip(tips, levels, begins, ends, strict=True):
            here = slice(begin, end)
            np.minimum(row[here], level + np.interp(radius[here] - tip, u, edge), out=row[here])
    return surface
