"""Polynomial surfaces with their derivatives, a block of points at a time so that the inner loops vectorise.

Every kernel adds to the 1, 3 or 6 rows of ``out``: z; zx, zy; zxx, zxy, zyy. Horner's scheme carries half the second
derivative, which saves a factor 2 in each step.
"""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit

__all__ = ["disc", "even", "slope_integral", "xy"]

BLOCK = 128  # 21 rows of scratch then stay in the first-level cache


@jit
def xy(x, y, table, sizes, out):
    """Horner in x over Horner in y: sum of table[i, j] x^i y^j, row i having its first ``sizes[i]`` (even) entries.

    Two powers of y at a time halve the traffic with the cache.
    """
    rows = out.shape[0]
    w = np.empty((9, BLOCK))  # rows 0 to 2: the polynomial in y, its derivative, half the second; 3 to 8: the sum
    for start in range(0, x.size, BLOCK):
        n = min(BLOCK, x.size - start)
        px, py = x[start : start + n], y[start : start + n]
        w[3:] = 0.0
        for i in range(table.shape[0] - 1, -1, -1):
            w[:3] = 0.0
            for j in range(sizes[i] - 2, -1, -2):
                a, b = table[i, j + 1], table[i, j]
                if rows == 1:
                    for p in range(n):
                        w[0, p] = (w[0, p] * py[p] + a) * py[p] + b
                elif rows == 3:
                    for p in range(n):
                        v = w[0, p] * py[p] + a
                        w[1, p] = (w[1, p] * py[p] + w[0, p]) * py[p] + v
                        w[0, p] = v * py[p] + b
                else:
                    for p in range(n):
                        v = w[0, p] * py[p] + a
                        d = w[1, p] * py[p] + w[0, p]
                        w[2, p] = (w[2, p] * py[p] + w[1, p]) * py[p] + d
                        w[1, p] = d * py[p] + v
                        w[0, p] = v * py[p] + b
            if rows == 6:
                for p in range(n):
                    w[6, p] = w[6, p] * px[p] + 2.0 * w[4, p]
                    w[7, p] = w[7, p] * px[p] + w[5, p]
                    w[8, p] = w[8, p] * px[p] + 2.0 * w[2, p]
            if rows >= 3:
                for p in range(n):
                    w[4, p] = w[4, p] * px[p] + w[3, p]
                    w[5, p] = w[5, p] * px[p] + w[1, p]
            for p in range(n):
                w[3, p] = w[3, p] * px[p] + w[0, p]
        for r in range(rows):
            for p in range(n):
                out[r, start + p] += w[3 + r, p]


@jit
def disc(x, y, scale, recurrence, coefficients, sizes, out):
    """Sum of F_m(s) Re w^m + G_m(s) Im w^m with w = scale (x + iy), s = |w|^2, F and G sums of polynomials P_k(s).

    P_0 = 1, P_{k+1} = (A_k + B_k s) P_k - C_k P_{k-1}, ``recurrence`` being (A, B, C)[m, k]; ``coefficients`` are those
    of F and of G, (2, m, k), of which the first ``sizes[0 or 1, m]`` are looked at.

    F and G come from Clenshaw's scheme, and the sum from Horner's scheme in w of H(w, s) = sum (F_m - i G_m) w^m, whose
    real part is the sum. Its derivatives by w and s give those by x and y without a division, so also at the origin.
    """
    rows = out.shape[0]
    w = np.empty((21, BLOCK))
    for start in range(0, x.size, BLOCK):
        n = min(BLOCK, x.size - start)
        for p in range(n):
            w[0, p] = scale * x[start + p]
            w[1, p] = scale * y[start + p]
            w[2, p] = w[0, p] * w[0, p] + w[1, p] * w[1, p]
        w[9:] = 0.0
        for m in range(sizes.shape[1] - 1, -1, -1):
            # H, H_w, H_s, H_ww/2, H_ws, H_ss/2 times w: rows 9 to 20, real and imaginary by turns.
            if rows == 6:
                for p in range(n):
                    a, b = w[15, p], w[16, p]
                    w[15, p] = a * w[0, p] - b * w[1, p] + w[11, p]
                    w[16, p] = a * w[1, p] + b * w[0, p] + w[12, p]
                    a, b = w[17, p], w[18, p]
                    w[17, p] = a * w[0, p] - b * w[1, p] + w[13, p]
                    w[18, p] = a * w[1, p] + b * w[0, p] + w[14, p]
                    a, b = w[19, p], w[20, p]
                    w[19, p] = a * w[0, p] - b * w[1, p]
                    w[20, p] = a * w[1, p] + b * w[0, p]
            if rows >= 3:
                for p in range(n):
                    a, b = w[11, p], w[12, p]
                    w[11, p] = a * w[0, p] - b * w[1, p] + w[9, p]
                    w[12, p] = a * w[1, p] + b * w[0, p] + w[10, p]
                    a, b = w[13, p], w[14, p]
                    w[13, p] = a * w[0, p] - b * w[1, p]
                    w[14, p] = a * w[1, p] + b * w[0, p]
            for p in range(n):
                a, b = w[9, p], w[10, p]
                w[9, p] = a * w[0, p] - b * w[1, p]
                w[10, p] = a * w[1, p] + b * w[0, p]
            for part in range(2):
                if sizes[part, m] == 0:
                    continue
                # Clenshaw: rows 3 and 4 the sum, 5 and 6 its derivative by s, 7 and 8 half the second one.
                w[3:9] = 0.0
                new, old = 3, 4
                for k in range(sizes[part, m] - 1, -1, -1):
                    c = coefficients[part, m, k]
                    a, b, g = recurrence[0, m, k], recurrence[1, m, k], recurrence[2, m, k + 1]
                    new, old = old, new
                    if rows == 6:
                        for p in range(n):
                            w[new + 4, p] = (a + b * w[2, p]) * w[old + 4, p] + b * w[old + 2, p] - g * w[new + 4, p]
                    if rows >= 3:
                        for p in range(n):
                            w[new + 2, p] = (a + b * w[2, p]) * w[old + 2, p] + b * w[old, p] - g * w[new + 2, p]
                    for p in range(n):
                        w[new, p] = (a + b * w[2, p]) * w[old, p] + c - g * w[new, p]
                sign = 1.0 - 2.0 * part
                for p in range(n):
                    w[9 + part, p] += sign * w[new, p]
                if rows >= 3:
                    for p in range(n):
                        w[13 + part, p] += sign * w[new + 2, p]
                if rows == 6:
                    for p in range(n):
                        w[19 + part, p] += sign * w[new + 4, p]
        for p in range(n):
            out[0, start + p] += w[9, p]
        if rows >= 3:
            for p in range(n):
                out[1, start + p] += scale * (w[11, p] + 2.0 * w[0, p] * w[13, p])
                out[2, start + p] += scale * (-w[12, p] + 2.0 * w[1, p] * w[13, p])
        if rows == 6:
            c = 2.0 * scale * scale
            for p in range(n):
                a, b = w[0, p], w[1, p]
                out[3, start + p] += c * (w[15, p] + 2.0 * a * w[17, p] + 4.0 * a * a * w[19, p] + w[13, p])
                out[4, start + p] += c * (-w[16, p] + b * w[17, p] - a * w[18, p] + 4.0 * a * b * w[19, p])
                out[5, start + p] += c * (-w[15, p] - 2.0 * b * w[18, p] + 4.0 * b * b * w[19, p] + w[13, p])


@jit
def even_sums(w, n, coefficients, rows):
    """Fill w[1:] (3, n) with the sum of coefficients[k] s^k, its derivative by s and half the second one; s is w[0].

    For 1 row, see `turnwright._kernels.quadrics`, derivatives are zero; for 3 the second one is.
    """
    for p in range(n):
        w[1, p], w[2, p], w[3, p] = 0.0, 0.0, 0.0
    for k in range(coefficients.size - 1, -1, -1):
        a = coefficients[k]
        if rows == 6:
            for p in range(n):
                w[3, p] = w[3, p] * w[0, p] + w[2, p]
        if rows >= 3:
            for p in range(n):
                w[2, p] = w[2, p] * w[0, p] + w[1, p]
        for p in range(n):
            w[1, p] = w[1, p] * w[0, p] + a


@jit
def even(x, y, coefficients, out):
    """Sum of coefficients[k] s^k with s = x^2 + y^2."""
    rows = out.shape[0]
    w = np.empty((4, BLOCK))
    for start in range(0, x.size, BLOCK):
        n = min(BLOCK, x.size - start)
        px, py = x[start : start + n], y[start : start + n]
        for p in range(n):
            w[0, p] = px[p] * px[p] + py[p] * py[p]
        even_sums(w, n, coefficients, rows)
        for p in range(n):
            out[0, start + p] += w[1, p]
        if rows >= 3:
            for p in range(n):
                out[1, start + p] += 2.0 * px[p] * w[2, p]
                out[2, start + p] += 2.0 * py[p] * w[2, p]
        if rows == 6:
            for p in range(n):
                out[3, start + p] += 2.0 * w[2, p] + 8.0 * px[p] * px[p] * w[3, p]
                out[4, start + p] += 8.0 * px[p] * py[p] * w[3, p]
                out[5, start + p] += 2.0 * w[2, p] + 8.0 * py[p] * py[p] * w[3, p]


@jit
def slope_integral(x, y, tables, out):
    """J(b) = sum of b_k I_k, I_k being the integral of (x^2 + y^2)^k over x from 0; ``tables`` holds b, b', b''.

    By parts, (2k + 1) I_k = x s^k + 2k y^2 I_{k-1}, so J = x S where T_k = b_k + (2k + 2)/(2k + 3) y^2 T_{k+1} and
    S = sum of s^k T_k / (2k + 1). Its derivatives are of the same kind: with b'_k = 2 (k + 1) b_{k+1} that by x is
    sum b_k s^k, that by y is y J(b'), and so on.
    """
    rows = out.shape[0]
    w = np.empty((10, BLOCK))  # s, y^2, then T and S for each table, then sum b_k s^k and sum b'_k s^k
    for start in range(0, x.size, BLOCK):
        n = min(BLOCK, x.size - start)
        px, py = x[start : start + n], y[start : start + n]
        for p in range(n):
            w[1, p] = py[p] * py[p]
            w[0, p] = px[p] * px[p] + w[1, p]
        w[2:] = 0.0
        for k in range(tables.shape[1] - 1, -1, -1):
            share = 1.0 / (2.0 * k + 1.0)
            carry = (2.0 * k + 2.0) / (2.0 * k + 3.0)
            a, b, c = tables[0, k], tables[1, k], tables[2, k]
            for p in range(n):
                w[2, p] = carry * w[1, p] * w[2, p] + a
                w[3, p] = w[3, p] * w[0, p] + share * w[2, p]
            if rows >= 3:
                for p in range(n):
                    w[4, p] = carry * w[1, p] * w[4, p] + b
                    w[5, p] = w[5, p] * w[0, p] + share * w[4, p]
                    w[8, p] = w[8, p] * w[0, p] + a
            if rows == 6:
                for p in range(n):
                    w[6, p] = carry * w[1, p] * w[6, p] + c
                    w[7, p] = w[7, p] * w[0, p] + share * w[6, p]
                    w[9, p] = w[9, p] * w[0, p] + b
        for p in range(n):
            out[0, start + p] += px[p] * w[3, p]
        if rows >= 3:
            for p in range(n):
                out[1, start + p] += w[8, p]
                out[2, start + p] += px[p] * py[p] * w[5, p]
        if rows == 6:
            for p in range(n):
                out[3, start + p] += px[p] * w[9, p]
                out[4, start + p] += py[p] * w[9, p]
                out[5, start + p] += px[p] * (w[5, p] + w[1, p] * w[7, p])
