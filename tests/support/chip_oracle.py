"""Chips by brute force: every earlier pass of the edge over a dense line through the axis, in plain NumPy.

Heights of the edge come from the circle, or from `Tool.edge` by a spline over a dense sweep; nothing of
`turnwright.cutting` is used.
"""

import numpy as np
from scipy.interpolate import CubicSpline


def passes(motion, angle, until=None):
    """Tips (place on the line at azimuth ``angle``, height, side) in order of time, up to and with time ``until``."""
    along = motion.sense * motion.axes["C"]
    found = []
    for side in (1, -1):
        first = motion.sense * angle + (np.pi if side < 0 else 0.0)
        first -= 2 * np.pi * np.floor((first - along[0] + 1e-9) / (2 * np.pi))
        at = np.arange(first, along[-1] + 1e-9, 2 * np.pi)
        at = np.clip(at, along[0], along[-1])
        x, z = np.interp(at, along, motion.axes["X"]), np.interp(at, along, motion.axes["Z"])
        found += [(t, side * px, pz, side) for t, px, pz in zip(at, x, z, strict=True)]
    found.sort()
    return [one for one in found if until is None or one[0] <= until + 1e-9]


def edge_of(tool):
    """The height of the edge over the distance from its tip, as seen along the cutting direction."""
    if tool.waviness == () and tool.rake == 0:
        radius = tool.actual_radius
        return lambda u: radius - np.sqrt(radius**2 - np.clip(u, -0.999 * radius, 0.999 * radius) ** 2)
    u, _, e = tool.edge(np.linspace(-0.87, 0.87, 20_001))
    return CubicSpline(u, e)


def layer(tips, edge, line):
    """The lowest of some passes along the line."""
    lowest = np.full(line.size, np.inf)
    for _, p, z, side in tips:
        lowest = np.minimum(lowest, z + edge(side * (line - p)))
    return lowest


def brute(motion, tool, line, angle, time, stock):
    """Area and thickest place of the chip of the pass at ``time``; stock is the height over the line before it all."""
    edge = edge_of(tool)
    tips = passes(motion, angle, time)
    _, p, z, side = tips[-1]
    assert side == 1
    before = np.minimum(stock, layer(tips[:-1], edge, line))
    over = np.maximum(before - z - edge(line - p), 0.0)
    area = np.trapezoid(over, line)
    chip = over > 0
    if not chip.any():
        return 0.0, 0.0
    u, _, e = tool.edge(np.linspace(-0.6, 0.6, 10_001))
    thickest = 0.0
    for k in np.flatnonzero(chip)[:: max(1, np.count_nonzero(chip) // 500)]:
        d = np.hypot(u + p - line[k], e + z - before[k])
        near = int(np.argmin(d))
        # Distance to the polyline on both sides of the nearest point.
        best = d[near]
        for j in (near - 1, near):
            ax, ay, bx, by = u[j] + p, e[j] + z, u[j + 1] + p, e[j + 1] + z
            s = ((line[k] - ax) * (bx - ax) + (before[k] - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
            s = min(max(s, 0), 1)
            best = min(best, np.hypot(ax + s * (bx - ax) - line[k], ay + s * (by - ay) - before[k]))
        thickest = max(thickest, best)
    return area, thickest
