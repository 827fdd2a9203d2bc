"""The tool edge, pointwise. A row holds (radius, low, high, rake_cos, rake_sin, dx, dy, dz), see tool.EdgeTable."""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.trig import sincos


@jit
def waviness(breaks, coefficients, s):
    """Return radial deviation and its two derivatives at sweep ``s``; one piece is a polynomial valid everywhere."""
    pieces = coefficients.shape[1]
    piece = 0
    if pieces > 1:
        if s <= breaks[0] or s >= breaks[pieces]:
            # A certificate is held constant beyond its ends.
            piece = 0 if s <= breaks[0] else pieces - 1
            t = (breaks[0] if s <= breaks[0] else breaks[pieces]) - breaks[piece]
            d = 0.0
            for k in range(coefficients.shape[0]):
                d = d * t + coefficients[k, piece]
            return d, 0.0, 0.0
        low, high = 0, pieces
        while high - low > 1:
            middle = (low + high) // 2
            if breaks[middle] <= s:
                low = middle
            else:
                high = middle
        piece = low
    t = s - breaks[piece]
    d, d1, d2 = 0.0, 0.0, 0.0
    for k in range(coefficients.shape[0]):
        d2 = d2 * t + 2.0 * d1
        d1 = d1 * t + d
        d = d * t + coefficients[k, piece]
    return d, d1, d2


@jit
def arc(row, breaks, coefficients, s):
    """Return (u, w, u', w', u'', w'') on the arc: position in the rake plane from the nominal tip, w up."""
    d, d1, d2 = waviness(breaks, coefficients, s)
    sine, cosine = sincos(s)
    half_sine, _ = sincos(0.5 * s)
    r = row[0] + d
    u = r * sine
    w = 2.0 * row[0] * half_sine * half_sine - d * cosine
    du = d1 * sine + r * cosine
    dw = r * sine - d1 * cosine
    ddu = d2 * sine + 2.0 * d1 * cosine - r * sine
    ddw = r * cosine + 2.0 * d1 * sine - d2 * cosine
    return u, w, du, dw, ddu, ddw


@jit
def edge(row, breaks, coefficients, s):
    """Return (u, w, u', w', u'', w'') on the arc or, beyond it, on the flank that is tangent to its end."""
    if s < row[1] or s > row[2]:
        end = row[1] if s < row[1] else row[2]
        u, w, du, dw, _, _ = arc(row, breaks, coefficients, end)
        return u + (s - end) * du, w + (s - end) * dw, du, dw, 0.0, 0.0
    return arc(row, breaks, coefficients, s)


@jit
def edge_points(row, breaks, coefficients, sweep, out):
    """Fill ``out`` (3, n) with (u, v, e) from the commanded tip."""
    for i in range(sweep.size):
        u, w, _, _, _, _ = edge(row, breaks, coefficients, sweep[i])
        out[0, i] = row[5] + u
        out[1, i] = row[6] + row[4] * w
        out[2, i] = row[7] + row[3] * w


@jit
def sweep_at(row, breaks, coefficients, u):
    """Return the sweep at which the edge stands at distance ``u`` from the nominal tip."""
    s = np.arcsin(max(-1.0, min(1.0, u / row[0])))
    s = max(row[1], min(row[2], s))
    for _ in range(60):
        at, _, du, _, _, _ = edge(row, breaks, coefficients, s)
        step = (u - at) / du
        s += max(-0.2, min(0.2, step))
        if abs(step) < 1e-15:
            break
    return s


@jit
def profile_table(row, breaks, coefficients, base, u, out):
    """Fill ``out`` (2, n) with the height of the edge above the circle of radius ``base``, and its slope, at ``u``."""
    for i in range(u.size):
        s = sweep_at(row, breaks, coefficients, u[i])
        _, w, du, dw, _, _ = edge(row, breaks, coefficients, s)
        root = np.sqrt(base * base - u[i] * u[i])
        out[0, i] = w - (base - root)
        out[1, i] = dw / du - u[i] / root


@jit
def height(profile, table, u):
    """Return the height w of the edge above the tip at distance ``u``, see tool.Profile."""
    if u < profile[1]:
        return profile[2] + (u - profile[1]) * profile[3]
    if u > profile[4]:
        return profile[5] + (u - profile[4]) * profile[6]
    w = profile[0] - np.sqrt(profile[0] * profile[0] - u * u)
    if table.shape[1] > 0:
        w += hermite(profile, table, u)
    return w


@jit
def slope(profile, table, u):
    """Return dw/du."""
    if u < profile[1]:
        return profile[3]
    if u > profile[4]:
        return profile[6]
    g = u / np.sqrt(profile[0] * profile[0] - u * u)
    if table.shape[1] > 0:
        t = (u - profile[1]) * profile[7]
        i = min(int(t), table.shape[1] - 2)
        t -= i
        a, b = table[0, i], table[0, i + 1]
        c, d = table[1, i] / profile[7], table[1, i + 1] / profile[7]
        g += profile[7] * (c + t * (2.0 * (3.0 * (b - a) - 2.0 * c - d) + 3.0 * t * (2.0 * (a - b) + c + d)))
    return g


@jit
def hermite(profile, table, u):
    """Return the tabulated departure from the circle at ``u`` inside the arc."""
    t = (u - profile[1]) * profile[7]
    i = min(int(t), table.shape[1] - 2)
    t -= i
    a, b = table[0, i], table[0, i + 1]
    c, d = table[1, i] / profile[7], table[1, i + 1] / profile[7]
    return a + t * (c + t * (3.0 * (b - a) - 2.0 * c - d + t * (2.0 * (a - b) + c + d)))
