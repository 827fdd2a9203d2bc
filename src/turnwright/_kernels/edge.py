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
def sweeps_at(row, breaks, coefficients, u, sweep):
    """Fill ``sweep`` with where the edge stands at the distances ``u`` from its tip."""
    for i in range(u.size):
        sweep[i] = sweep_at(row, breaks, coefficients, u[i])


@jit
def trace(row, breaks, coefficients, sweep, out):
    """Fill ``out`` (4, n) with (u, w, u', w') along the edge."""
    for i in range(sweep.size):
        out[0, i], out[1, i], out[2, i], out[3, i], _, _ = edge(row, breaks, coefficients, sweep[i])


@jit
def height(profile, table, u):
    """Return the height w of the edge above the tip at distance ``u``, see tool.EdgeProfile."""
    if u < profile[1]:
        return profile[2] + (u - profile[1]) * profile[3]
    if u > profile[4]:
        return profile[5] + (u - profile[4]) * profile[6]
    if table.shape[1] == 0:
        return profile[0] - np.sqrt(profile[0] * profile[0] - u * u)
    i, t, _ = piece(profile, table, u)
    return table[i, 0] + t * (table[i, 1] + t * (table[i, 2] + t * table[i, 3]))


@jit
def slope(profile, table, u):
    """Return dw/du."""
    if u < profile[1]:
        return profile[3]
    if u > profile[4]:
        return profile[6]
    if table.shape[1] == 0:
        return u / np.sqrt(profile[0] * profile[0] - u * u)
    i, t, q = piece(profile, table, u)
    rate = table[i, 1] + t * (2.0 * table[i, 2] + 3.0 * t * table[i, 3])
    return rate * profile[7] * profile[0] / (q * (profile[0] + q))


@jit
def piece(profile, table, u):
    """Return (which cubic of the arc stands at ``u``, place within it from 0 to 1, height of the centre above u)."""
    p = u - profile[9]
    q = np.sqrt(profile[0] * profile[0] - p * p)
    t = (p / (profile[0] + q) - profile[8]) * profile[7]
    i = min(int(t), table.shape[0] - 1)
    return i, t - i, q
