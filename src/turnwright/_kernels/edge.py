"""The tool edge, pointwise. A row holds (radius, low, high, rake_cos, rake_sin, dx, dy, dz), see tool.EdgeTable."""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.trig import sincos

# Places in a row: radius [mm], sweep at the ends of the arc [rad], cosine and sine of the rake, offset of the tip [mm].
RADIUS, LOW, HIGH, RAKE_COS, RAKE_SIN, DX, DY, DZ = range(8)
# Places in a profile: radius of the circle that its table stands on; distance, height and slope at the ends of the arc;
# pieces per x, least x, and the distance of the circle's centre.
BASE, LOW_U, LOW_W, LOW_SLOPE, HIGH_U, HIGH_W, HIGH_SLOPE, PIECES_PER_X, LEAST_X, MIDDLE_U = range(10)


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
    r = row[RADIUS] + d
    u = r * sine
    w = 2.0 * row[RADIUS] * half_sine * half_sine - d * cosine
    du = d1 * sine + r * cosine
    dw = r * sine - d1 * cosine
    ddu = d2 * sine + 2.0 * d1 * cosine - r * sine
    ddw = r * cosine + 2.0 * d1 * sine - d2 * cosine
    return u, w, du, dw, ddu, ddw


@jit
def edge(row, breaks, coefficients, s):
    """Return (u, w, u', w', u'', w'') on the arc or, beyond it, on the flank that is tangent to its end."""
    if s < row[LOW] or s > row[HIGH]:
        end = row[LOW] if s < row[LOW] else row[HIGH]
        u, w, du, dw, _, _ = arc(row, breaks, coefficients, end)
        return u + (s - end) * du, w + (s - end) * dw, du, dw, 0.0, 0.0
    return arc(row, breaks, coefficients, s)


@jit
def edge_points(row, breaks, coefficients, sweep, out):
    """Fill ``out`` (3, n) with (u, v, e) from the commanded tip."""
    for i in range(sweep.size):
        u, w, _, _, _, _ = edge(row, breaks, coefficients, sweep[i])
        out[0, i] = row[DX] + u
        out[1, i] = row[DY] + row[RAKE_SIN] * w
        out[2, i] = row[DZ] + row[RAKE_COS] * w


@jit
def sweep_at(row, breaks, coefficients, u):
    """Return the sweep at which the edge stands at distance ``u`` from the nominal tip."""
    s = np.arcsin(max(-1.0, min(1.0, u / row[RADIUS])))
    s = max(row[LOW], min(row[HIGH], s))
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
    if u < profile[LOW_U]:
        return profile[LOW_W] + (u - profile[LOW_U]) * profile[LOW_SLOPE]
    if u > profile[HIGH_U]:
        return profile[HIGH_W] + (u - profile[HIGH_U]) * profile[HIGH_SLOPE]
    if table.shape[1] == 0:
        return profile[BASE] - np.sqrt(profile[BASE] * profile[BASE] - u * u)
    i, t, _ = piece(profile, table, u)
    return table[i, 0] + t * (table[i, 1] + t * (table[i, 2] + t * table[i, 3]))


@jit
def slope(profile, table, u):
    """Return dw/du."""
    if u < profile[LOW_U]:
        return profile[LOW_SLOPE]
    if u > profile[HIGH_U]:
        return profile[HIGH_SLOPE]
    if table.shape[1] == 0:
        return u / np.sqrt(profile[BASE] * profile[BASE] - u * u)
    i, t, q = piece(profile, table, u)
    rate = table[i, 1] + t * (2.0 * table[i, 2] + 3.0 * t * table[i, 3])
    return rate * profile[PIECES_PER_X] * profile[BASE] / (q * (profile[BASE] + q))


@jit
def piece(profile, table, u):
    """Return (which cubic of the arc stands at ``u``, place within it from 0 to 1, height of the centre above u)."""
    p = u - profile[MIDDLE_U]
    q = np.sqrt(profile[BASE] * profile[BASE] - p * p)
    t = (p / (profile[BASE] + q) - profile[LEAST_X]) * profile[PIECES_PER_X]
    i = min(int(t), table.shape[0] - 1)
    return i, t - i, q
