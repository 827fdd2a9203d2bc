"""The tool edge, pointwise. Kernels take all of it as one value, see `turnwright.edge.Edge`."""

import numpy as np

from turnwright._kernels import jit, jit_inline
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
def arc(radius, d, d1, d2, s):
    """Return (u, w, u', w', u'', w'') on the arc: position in the rake plane from the nominal tip, w up.

    ``d`` is the radial deviation at the sweep ``s``, with its two derivatives.
    """
    sine, cosine = sincos(s)
    r = radius + d
    u = r * sine
    w = radius * sine * sine / (1.0 + cosine) - d * cosine  # without cancellation
    du = d1 * sine + r * cosine
    dw = r * sine - d1 * cosine
    ddu = d2 * sine + 2.0 * d1 * cosine - r * sine
    ddw = r * cosine + 2.0 * d1 * sine - d2 * cosine
    return u, w, du, dw, ddu, ddw


@jit_inline
def outline(edge, s):
    """Return (u, w, u', w', u'', w'') on the arc or, beyond it, on the flank that is tangent to its end."""
    if s < edge.low or s > edge.high:
        end = edge.low if s < edge.low else edge.high
        d, d1, d2 = waviness(edge.breaks, edge.coefficients, end)
        u, w, du, dw, _, _ = arc(edge.radius, d, d1, d2, end)
        return u + (s - end) * du, w + (s - end) * dw, du, dw, 0.0, 0.0
    d, d1, d2 = waviness(edge.breaks, edge.coefficients, s)
    return arc(edge.radius, d, d1, d2, s)


@jit_inline
def is_circle(edge):
    """Return whether the arc is one of a circle with the radius of the edge."""
    return edge.coefficients.size == 1 and edge.coefficients[0, 0] == 0.0


@jit
def outlines(edge, sweep):
    """Return what `outline` returns at each ``sweep`` (6, n); for a circle from a loop that vectorises."""
    out = np.empty((6, sweep.size))
    low, high = edge.low, edge.high
    if is_circle(edge):
        for i in range(sweep.size):
            s = sweep[i]
            held = low if s < low else high if s > high else s
            beyond = s - held
            u, w, du, dw, ddu, ddw = arc(edge.radius, 0.0, 0.0, 0.0, held)
            out[0, i], out[1, i], out[2, i], out[3, i] = u + beyond * du, w + beyond * dw, du, dw
            out[4, i], out[5, i] = (ddu, ddw) if held == s else (0.0, 0.0)
        return out
    for i in range(sweep.size):
        out[0, i], out[1, i], out[2, i], out[3, i], out[4, i], out[5, i] = outline(edge, sweep[i])
    return out


@jit
def points(edge, sweep, out):
    """Fill ``out`` (3, n) with (u, v, e) from the commanded tip."""
    place = outlines(edge, sweep)
    for i in range(sweep.size):
        out[0, i] = edge.dx + place[0, i]
        out[1, i] = edge.dy + edge.rake_sin * place[1, i]
        out[2, i] = edge.dz + edge.rake_cos * place[1, i]


@jit
def sweeps_at(edge, u, sweep):
    """Fill ``sweep`` with where the edge stands at the distances ``u`` from its nominal tip."""
    circle = is_circle(edge)
    for i in range(u.size):
        if u[i] < edge.low_u or u[i] > edge.high_u:  # a flank is straight
            end = edge.low if u[i] < edge.low_u else edge.high
            at, _, du, _, _, _ = outline(edge, end)
            sweep[i] = end + (u[i] - at) / du
            continue
        s = np.arcsin(max(-1.0, min(1.0, u[i] / edge.radius)))
        s = max(edge.low, min(edge.high, s))
        if not (circle and edge.low < s < edge.high):
            for _ in range(60):
                at, _, du, _, _, _ = outline(edge, s)
                step = (u[i] - at) / du
                s += max(-0.2, min(0.2, step))
                if abs(step) < 1e-15:
                    break
        sweep[i] = s


@jit
def trace(edge, sweep, out):
    """Fill ``out`` (4, n) with (u, w, u', w') along the edge."""
    place = outlines(edge, sweep)
    for k in range(4):
        for i in range(sweep.size):
            out[k, i] = place[k, i]


@jit
def height(edge, u):
    """Return the height w of the edge above the tip at distance ``u``."""
    if u < edge.low_u:
        return edge.low_w + (u - edge.low_u) * edge.low_slope
    if u > edge.high_u:
        return edge.high_w + (u - edge.high_u) * edge.high_slope
    if edge.pieces.shape[1] == 0:
        return edge.base - np.sqrt(edge.base * edge.base - u * u)
    i, t, _ = piece(edge, u)
    return edge.pieces[i, 0] + t * (edge.pieces[i, 1] + t * (edge.pieces[i, 2] + t * edge.pieces[i, 3]))


@jit
def slope(edge, u):
    """Return dw/du."""
    if u < edge.low_u:
        return edge.low_slope
    if u > edge.high_u:
        return edge.high_slope
    if edge.pieces.shape[1] == 0:
        return u / np.sqrt(edge.base * edge.base - u * u)
    i, t, q = piece(edge, u)
    rate = edge.pieces[i, 1] + t * (2.0 * edge.pieces[i, 2] + 3.0 * t * edge.pieces[i, 3])
    return rate * edge.pieces_per_x * edge.base / (q * (edge.base + q))


@jit
def profile(edge, u, out):
    """Fill ``out`` (2, n) with height and slope of the edge at the distances ``u`` from its tip."""
    for i in range(u.size):
        out[0, i], out[1, i] = height(edge, u[i]), slope(edge, u[i])


@jit
def piece(edge, u):
    """Return (which cubic of the arc stands at ``u``, place within it from 0 to 1, height of the centre above u)."""
    p = u - edge.middle_u
    q = np.sqrt(edge.base * edge.base - p * p)
    t = (p / (edge.base + q) - edge.least_x) * edge.pieces_per_x
    i = min(int(t), edge.pieces.shape[0] - 1)
    return i, t - i, q
