"""Conics, tori and biconics with their derivatives, written so that they are exact near the vertex.

Every kernel adds to the 1, 3 or 6 rows of ``out``: z; zx, zy; zxx, zxy, zyy. Curvatures are 1/R, so a flat is 0.
Outside its domain a root is nan, and so are the rows.
"""

from __future__ import annotations

import math

from turnwright._kernels import jit

__all__ = ["biconic", "conic", "secant", "toroid"]


@jit
def conic(x, y, c, k, out):
    """Rotational conic, sag c s / (1 + root) with s = x^2 + y^2 and root = sqrt(1 - (1 + k) c^2 s)."""
    rows = out.shape[0]
    e = (1.0 + k) * c * c
    for i in range(x.size):
        s = x[i] * x[i] + y[i] * y[i]
        root = math.sqrt(1.0 - e * s)
        out[0, i] += c * s / (1.0 + root)
        if rows > 1:
            g = c / root
            out[1, i] += x[i] * g
            out[2, i] += y[i] * g
            if rows == 6:
                h = e * g / (root * root)
                out[3, i] += g + x[i] * x[i] * h
                out[4, i] += x[i] * y[i] * h
                out[5, i] += g + y[i] * y[i] * h


@jit
def secant(x, y, c, k, out):
    """Multiply ``out`` by the secant of the conic's slope, sqrt((1 - k c^2 s) / (1 - (1 + k) c^2 s))."""
    rows = out.shape[0]
    d = k * c * c
    e = d + c * c
    for i in range(x.size):
        s = x[i] * x[i] + y[i] * y[i]
        p = 1.0 / (1.0 - d * s)
        q = 1.0 / (1.0 - e * s)
        f = math.sqrt(q / p)
        z = out[0, i]
        out[0, i] = f * z
        if rows > 1:
            # g and h are 2 df/ds and 4 d2f/ds2.
            g = f * (e * q - d * p)
            fx, fy = x[i] * g, y[i] * g
            zx, zy = out[1, i], out[2, i]
            out[1, i] = f * zx + fx * z
            out[2, i] = f * zy + fy * z
            if rows == 6:
                a, b = e * q, d * p
                h = f * ((a - b) * (a - b) + 2.0 * (a * a - b * b))
                out[3, i] = f * out[3, i] + 2.0 * fx * zx + (g + x[i] * x[i] * h) * z
                out[4, i] = f * out[4, i] + fx * zy + fy * zx + x[i] * y[i] * h * z
                out[5, i] = f * out[5, i] + 2.0 * fy * zy + (g + y[i] * y[i] * h) * z


@jit
def toroid(x, y, cx, cy, out):
    """Arc of curvature ``cx`` in the xz plane, turned about the line y = 0, z = 1/cy.

    On it z - cy z^2 / 2 = q with q = g - cy g^2 / 2 + cy y^2 / 2, g(x) being the arc: q and z(q) need no difference of
    large numbers, and cy = 0 is a cylinder.
    """
    rows = out.shape[0]
    for i in range(x.size):
        root = math.sqrt(1.0 - cx * cx * x[i] * x[i])
        g = cx * x[i] * x[i] / (1.0 + root)
        lean = 1.0 - cy * g
        q = 0.5 * (g + g * lean + cy * y[i] * y[i])
        drop = math.sqrt(lean * lean - cy * cy * y[i] * y[i])
        out[0, i] += 2.0 * q / (1.0 + drop)
        if rows > 1:
            gx = cx * x[i] / root
            qx = gx * lean
            qy = cy * y[i]
            out[1, i] += qx / drop
            out[2, i] += qy / drop
            if rows == 6:
                h = cy / (drop * drop * drop)
                gxx = cx / (root * root * root)
                out[3, i] += (gxx * lean - cy * gx * gx) / drop + qx * qx * h
                out[4, i] += qx * qy * h
                out[5, i] += cy / drop + qy * qy * h


@jit
def biconic(x, y, cx, cy, kx, ky, out):
    """(cx x^2 + cy y^2) / (1 + root), root = sqrt(1 - (1 + kx) cx^2 x^2 - (1 + ky) cy^2 y^2)."""
    rows = out.shape[0]
    a = (1.0 + kx) * cx * cx
    b = (1.0 + ky) * cy * cy
    for i in range(x.size):
        root = math.sqrt(1.0 - a * x[i] * x[i] - b * y[i] * y[i])
        share = 1.0 / (1.0 + root)
        z = (cx * x[i] * x[i] + cy * y[i] * y[i]) * share
        out[0, i] += z
        if rows > 1:
            # Derivatives of z (1 + root) = numerator; wx and wy are those of -root.
            wx, wy = a * x[i] / root, b * y[i] / root
            zx = (2.0 * cx * x[i] + z * wx) * share
            zy = (2.0 * cy * y[i] + z * wy) * share
            out[1, i] += zx
            out[2, i] += zy
            if rows == 6:
                out[3, i] += (2.0 * cx + 2.0 * zx * wx + z * (a + wx * wx) / root) * share
                out[4, i] += (zx * wy + zy * wx + z * wx * wy / root) * share
                out[5, i] += (2.0 * cy + 2.0 * zy * wy + z * (b + wy * wy) / root) * share
