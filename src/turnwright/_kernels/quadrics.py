"""Conics, tori and biconics with their derivatives, written so that they are exact near the vertex.

Every kernel adds to the 1, 3 or 6 rows of ``out``: z; zx, zy; zxx, zxy, zyy. Curvatures are 1/R, so a flat is 0.
Outside its domain a root is nan, and so are the rows.

One function computes a point and is inlined; results that a loop does not store are not computed. A loop over points
for each number of rows, because a condition inside may become masked stores beyond ``out``, which cost 100 ns each.
"""

from __future__ import annotations

import math

from turnwright._kernels import jit

__all__ = ["aspheric_toroid", "biconic", "conic", "secant", "toroid"]


def sum_points(name, point):
    """Return the kernel that adds the height and derivatives of ``point(x, y, *parameters)`` to ``out``."""

    def kernel(x, y, parameters, out):
        rows = out.shape[0]
        if rows == 1:
            for i in range(x.size):
                out[0, i] += point(x[i], y[i], *parameters)[0]
        elif rows == 3:
            for i in range(x.size):
                jet = point(x[i], y[i], *parameters)
                out[0, i] += jet[0]
                out[1, i] += jet[1]
                out[2, i] += jet[2]
        else:
            for i in range(x.size):
                jet = point(x[i], y[i], *parameters)
                out[0, i] += jet[0]
                out[1, i] += jet[1]
                out[2, i] += jet[2]
                out[3, i] += jet[3]
                out[4, i] += jet[4]
                out[5, i] += jet[5]

    kernel.__qualname__ = kernel.__name__ = name  # of its file in the cache
    return jit(kernel)


@jit
def conic_point(x, y, c, k):
    """Sag c s / (1 + root) with s = x^2 + y^2 and root = sqrt(1 - (1 + k) c^2 s), and derivatives."""
    e = (1.0 + k) * c * c
    s = x * x + y * y
    root = math.sqrt(1.0 - e * s)
    g = c / root
    h = e * g / (root * root)
    return c * s / (1.0 + root), x * g, y * g, g + x * x * h, x * y * h, g + y * y * h


conic = sum_points("conic", conic_point)


@jit
def secant_point(x, y, c, k):
    """Secant f of the conic's slope, sqrt((1 - k c^2 s) / (1 - (1 + k) c^2 s)), with 2 df/ds and 4 d2f/ds2."""
    d = k * c * c
    e = d + c * c
    s = x * x + y * y
    p = 1.0 / (1.0 - d * s)
    q = 1.0 / (1.0 - e * s)
    f = math.sqrt(q / p)
    a, b = e * q, d * p
    return f, f * (a - b), f * ((a - b) * (a - b) + 2.0 * (a * a - b * b))


@jit
def secant(x, y, c, k, out):
    """Multiply ``out`` by the secant of the conic's slope."""
    rows = out.shape[0]
    if rows == 1:
        for i in range(x.size):
            out[0, i] *= secant_point(x[i], y[i], c, k)[0]
    elif rows == 3:
        for i in range(x.size):
            f, g, _ = secant_point(x[i], y[i], c, k)
            z = out[0, i]
            out[0, i] = f * z
            out[1, i] = f * out[1, i] + x[i] * g * z
            out[2, i] = f * out[2, i] + y[i] * g * z
    else:
        for i in range(x.size):
            f, g, h = secant_point(x[i], y[i], c, k)
            z, zx, zy = out[0, i], out[1, i], out[2, i]
            fx, fy = x[i] * g, y[i] * g
            out[0, i] = f * z
            out[1, i] = f * zx + fx * z
            out[2, i] = f * zy + fy * z
            out[3, i] = f * out[3, i] + 2.0 * fx * zx + (g + x[i] * x[i] * h) * z
            out[4, i] = f * out[4, i] + fx * zy + fy * zx + x[i] * y[i] * h * z
            out[5, i] = f * out[5, i] + 2.0 * fy * zy + (g + y[i] * y[i] * h) * z


@jit
def turned_point(y, g, gx, gxx, cy):
    """Arc of height g(x), with its derivatives, turned about the line y = 0, z = 1/cy.

    On it z - cy z^2 / 2 = q with q = g - cy g^2 / 2 + cy y^2 / 2: q and z(q) need no difference of large numbers, and
    cy = 0 is a cylinder.
    """
    lean = 1.0 - cy * g
    drop = math.sqrt(lean * lean - cy * cy * y * y)
    z = (g + g * lean + cy * y * y) / (1.0 + drop)
    qx, qy = gx * lean, cy * y
    h = cy / (drop * drop * drop)
    zxx = (gxx * lean - cy * gx * gx) / drop + qx * qx * h
    return z, qx / drop, qy / drop, zxx, qx * qy * h, cy / drop + qy * qy * h


@jit
def toroid_point(x, y, cx, cy):
    """Arc of curvature ``cx`` in the xz plane, turned, and derivatives."""
    root = math.sqrt(1.0 - cx * cx * x * x)
    return turned_point(y, cx * x * x / (1.0 + root), cx * x / root, cx / (root * root * root), cy)


@jit
def aspheric_toroid_point(x, y, cx, cy, k, terms):
    """Conic with even powers terms[i] x^(2i) in the xz plane, turned, and derivatives."""
    s = x * x
    root = math.sqrt(1.0 - (1.0 + k) * cx * cx * s)
    a, b, c = 0.0, 0.0, 0.0  # the polynomial in s, its derivative, half the second one
    for i in range(terms.size - 1, -1, -1):
        c = c * s + b
        b = b * s + a
        a = a * s + terms[i]
    g = cx * s / (1.0 + root) + a
    return turned_point(y, g, cx * x / root + 2.0 * x * b, cx / (root * root * root) + 2.0 * b + 8.0 * s * c, cy)


toroid = sum_points("toroid", toroid_point)
aspheric_toroid = sum_points("aspheric_toroid", aspheric_toroid_point)


@jit
def biconic_point(x, y, cx, cy, kx, ky):
    """(cx x^2 + cy y^2) / (1 + root), root = sqrt(1 - (1 + kx) cx^2 x^2 - (1 + ky) cy^2 y^2), and derivatives."""
    a = (1.0 + kx) * cx * cx
    b = (1.0 + ky) * cy * cy
    root = math.sqrt(1.0 - a * x * x - b * y * y)
    share = 1.0 / (1.0 + root)
    z = (cx * x * x + cy * y * y) * share
    # Derivatives of z (1 + root) = numerator; wx and wy are those of -root.
    wx, wy = a * x / root, b * y / root
    zx = (2.0 * cx * x + z * wx) * share
    zy = (2.0 * cy * y + z * wy) * share
    zxx = (2.0 * cx + 2.0 * zx * wx + z * (a + wx * wx) / root) * share
    zxy = (zx * wy + zy * wx + z * wx * wy / root) * share
    zyy = (2.0 * cy + 2.0 * zy * wy + z * (b + wy * wy) / root) * share
    return z, zx, zy, zxx, zxy, zyy


biconic = sum_points("biconic", biconic_point)
