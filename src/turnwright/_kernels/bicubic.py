"""A bicubic spline from its heights, slopes and twists at the nodes."""

from turnwright._kernels import jit
from turnwright._kernels.ordered import interval


@jit
def cubic(z0, z1, d0, d1, h, s):
    """Return the cubic with heights z0, z1 and slopes d0, d1 at both ends of h, and its derivatives, at s in [0, 1]."""
    rise = (z1 - z0) / h
    r = 1.0 - s
    value = z0 + h * s * (rise * s * (3.0 - 2.0 * s) + r * (d0 * r - d1 * s))
    slope = 6.0 * rise * s * r + d0 * r * (1.0 - 3.0 * s) + d1 * s * (3.0 * s - 2.0)
    bend = (6.0 * rise * (1.0 - 2.0 * s) + d0 * (6.0 * s - 4.0) + d1 * (6.0 * s - 2.0)) / h
    return value, slope, bend


@jit
def bicubic(x, y, columns, rows, nodes, order, out):
    """Fill ``out`` (1, 3 or 6, n) with height and derivatives of the spline.

    ``nodes`` (rows, columns, 4) holds z, zx, zy, zxy.
    """
    for i in range(x.size):
        c, r = interval(columns, x[i]), interval(rows, y[i])
        h, k = columns[c + 1] - columns[c], rows[r + 1] - rows[r]
        s, t = (x[i] - columns[c]) / h, (y[i] - rows[r]) / k
        a, b = nodes[r, c], nodes[r, c + 1]
        z0, zx0, zxx0 = cubic(a[0], b[0], a[1], b[1], h, s)
        n0, nx0, nxx0 = cubic(a[2], b[2], a[3], b[3], h, s)
        a, b = nodes[r + 1, c], nodes[r + 1, c + 1]
        z1, zx1, zxx1 = cubic(a[0], b[0], a[1], b[1], h, s)
        n1, nx1, nxx1 = cubic(a[2], b[2], a[3], b[3], h, s)
        z, zy, zyy = cubic(z0, z1, n0, n1, k, t)
        out[0, i] = z
        if order > 0:
            zx, zxy, _ = cubic(zx0, zx1, nx0, nx1, k, t)
            out[1, i] = zx
            out[2, i] = zy
            if order > 1:
                zxx, _, _ = cubic(zxx0, zxx1, nxx0, nxx1, k, t)
                out[3, i] = zxx
                out[4, i] = zxy
                out[5, i] = zyy
