"""Every pass of an edge over a point, from the definition: nothing of Turnwright's own generation or edges is used.

Each straight piece of a motion is sampled until the point cannot be passed twice between two samples, the place of the
edge over the plane of the point changes sign at a pass, and bisection finds it.
"""

import numpy as np
from scipy.interpolate import CubicSpline

STEP = 0.02  # rad of the spindle between two samples
FINER = 64  # samples between two of them where the point is nearly touched
HALVINGS = 60


class Edge:
    """Arc with radial deviation, and straight flanks tangent to its ends; lean and offsets as `Tool` defines them."""

    def __init__(self, tool, sense):
        self.radius = tool.nose_radius + tool.radius_error
        half = tool.included / 2
        self.ends = np.array([-half, half])
        table = getattr(tool.waviness, "sweep", None)
        if table is not None:
            spline = CubicSpline(table, tool.waviness.deviation)
            self.deviation = lambda s: spline(np.clip(s, table[0], table[-1]))
            self.rate = lambda s: np.where((s >= table[0]) & (s <= table[-1]), spline(s, 1), 0.0)
        else:
            powers = [*reversed(tool.waviness), 0.0]
            self.deviation = lambda s: np.polyval(powers, s)
            self.rate = lambda s: np.polyval(np.polyder(powers), s)
        self.perfect = table is None and not any(tool.waviness)
        self.rise, self.lean = np.cos(tool.rake), -sense * np.sin(tool.rake)
        self.dx, self.dy, self.dz = tool.offset
        self.u, self.w = self.arc(self.ends)
        d, rate = self.deviation(self.ends), self.rate(self.ends)
        du = rate * np.sin(self.ends) + (self.radius + d) * np.cos(self.ends)
        dw = (self.radius + d) * np.sin(self.ends) - rate * np.cos(self.ends)
        self.slope = dw / du

    def arc(self, s):
        r = self.radius + self.deviation(s)
        return r * np.sin(s), self.radius - r * np.cos(s)

    def height(self, u):
        """Height of the edge over its tip, in the rake plane."""
        inside = np.clip(u, *self.u)
        if self.perfect:
            w = self.radius - np.sqrt(self.radius**2 - inside**2)
        else:
            s = np.clip(np.arcsin(np.clip(inside / self.radius, -1, 1)), *self.ends)
            for _ in range(8):  # Newton's method; the deviation is small, so that it starts close
                d = self.deviation(s)
                slope = self.rate(s) * np.sin(s) + (self.radius + d) * np.cos(s)
                s = np.clip(s - ((self.radius + d) * np.sin(s) - inside) / slope, *self.ends)
            w = self.arc(s)[1]
        beyond = u - inside
        return w + np.where(beyond < 0, self.slope[0], self.slope[1]) * beyond


class Passes:
    """All passes of a tool that a motion moves along straight lines in the axes of the machine."""

    def __init__(self, motion, tool, squareness=0.0):
        axes = motion.axes
        self.edge = Edge(tool, motion.sense)
        z = axes["Z"] + squareness * axes["X"] + axes.get("W", 0.0)
        x = axes["X"] + axes.get("U", 0.0)
        y = axes.get("Y", np.zeros(x.size))
        self.axes = np.stack([axes["C"], x, y, z])
        turned = np.abs(np.diff(axes["C"]))
        parts = np.ceil(turned / STEP).astype(int)
        line = np.repeat(np.arange(parts.size), parts)
        share = (np.arange(line.size) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[line]
        self.line = np.append(line, parts.size - 1)
        self.share = np.append(share, 1.0)
        self.longest = (turned / parts).max()
        # Samples at each end of each interval on the line of the interval itself.
        self.stop = np.where(np.append(np.diff(self.line) > 0, False)[:-1], 1.0, self.share[1:])
        c, self.x, self.y, self.z = self.stands(self.line, self.share)
        self.cosine, self.sine = np.cos(c), np.sin(c)

    def stands(self, line, share):
        first, last = self.axes[:, line], self.axes[:, line + 1]
        return first + share * (last - first)

    def over(self, px, py, line, share):
        """Lateral distance of the point from the edge, and the height of the edge."""
        c, x, y, z = self.stands(line, share)
        return self.beside(px * np.cos(c) + py * np.sin(c), py * np.cos(c) - px * np.sin(c), x, y, z)

    def beside(self, along, across, x, y, z):
        edge = self.edge
        w = edge.height(along - x - edge.dx)
        return across - y - edge.dy - edge.lean * w, z + edge.dz + edge.rise * w

    def roots(self, px, py, line, low, high):
        """Height of the edge at each change of sign, by bisection."""
        begins = self.over(px, py, line, low)[0] > 0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            same = (self.over(px, py, line, middle)[0] > 0) == begins
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return self.over(px, py, line, (low + high) / 2)[1]

    def lowest(self, px, py):
        """Return the height at one point; inf where the edge never passes over it."""
        aside, height = self.beside(
            px * self.cosine + py * self.sine, py * self.cosine - px * self.sine, self.x, self.y, self.z
        )
        line, low, high = self.line[:-1], self.share[:-1], self.stop
        f, g = aside[:-1], aside[1:]
        crossed = np.flatnonzero((f > 0) != (g > 0))
        best = np.inf
        if crossed.size:
            # The lowest few by the lower end, and then all that could be lower yet.
            floor = np.minimum(height[:-1], height[1:])[crossed]
            few = crossed[np.argsort(floor)[:20]]
            best = self.roots(px, py, line[few], low[few], high[few]).min()
            swing = np.abs(np.diff(height))[crossed]
            rest = crossed[floor - swing <= best]
            best = min(best, self.roots(px, py, line[rest], low[rest], high[rest]).min(initial=np.inf))
        # Twice between two samples: only where both are as near as the second difference, doubled, may be off.
        bend = np.abs(np.diff(aside, 2))
        bend = np.maximum(np.append(bend, bend[-1:]), np.append(bend[:1], bend))
        reach = np.hypot(px, py) * self.longest**2 / 8
        near = ((f > 0) == (g > 0)) & (np.minimum(np.abs(f), np.abs(g)) <= bend + 2 * reach)
        near &= np.minimum(height[:-1], height[1:]) - 2 * np.abs(np.diff(height)) <= best
        for i in np.flatnonzero(near):
            best = min(best, self.touching(px, py, line[i], low[i], high[i]))
        return best

    def touching(self, px, py, line, low, high):
        """Return the lowest pass of an interval at whose ends the point stands on the same side of the edge."""
        share = np.linspace(low, high, FINER + 1)
        lines = np.full(FINER + 1, line)
        aside, _ = self.over(px, py, lines, share)
        side = 1.0 if aside[0] > 0 else -1.0
        if side * aside.min(initial=np.inf) > 0 if side > 0 else aside.max() < 0:
            # The extreme may lie between two of the finer samples.
            k = int(np.argmin(side * aside))
            a, b = share[max(k - 1, 0)], share[min(k + 1, FINER)]
            for _ in range(HALVINGS):
                one, other = a + (b - a) / 3, b - (b - a) / 3
                f = side * self.over(px, py, np.full(2, line), np.array([one, other]))[0]
                a, b = (a, other) if f[0] < f[1] else (one, b)
                if f.min() <= 0:
                    break
            share = np.sort(np.append(share, [one, other]))
            lines = np.full(share.size, line)
            aside, _ = self.over(px, py, lines, share)
        crossed = np.flatnonzero((aside[1:] > 0) != (aside[:-1] > 0))
        if crossed.size == 0:
            return np.inf
        return self.roots(px, py, lines[crossed], share[crossed], share[crossed + 1]).min()
