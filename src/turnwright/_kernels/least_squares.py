"""Normal equations of least squares for a few dozen parameters, and Zernike polynomials as their terms.

BLAS splits products of this shape between its threads, which takes more time than it saves if other threads are busy.
"""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit, jit_sums

__all__ = ["gram", "zernike_terms"]

BLOCK = 256  # points at a time: 40 terms and their weighted copies then stay in the second-level cache


@jit_sums
def gram(terms, weight, values, parameters, normal, right, whole):
    """Take terms^T parameters off ``values`` (n,), and add sum w t values to ``right`` (k,).

    With ``whole`` also add sum w t t^T to the lower triangle of ``normal`` (k, k); what is written above the diagonal
    means nothing. ``terms`` is (k, n) with k a multiple of 4, if need be with rows of zeros. Two rows against four at a
    time: each number that is loaded is used in two or four products.
    """
    k, n = terms.shape
    block, scaled = np.empty((k, BLOCK)), np.empty((k, BLOCK))
    for start in range(0, n, BLOCK):
        m = min(BLOCK, n - start)
        for i in range(k):
            for p in range(m):
                block[i, p] = terms[i, start + p]
                scaled[i, p] = weight[start + p] * terms[i, start + p]
        for i in range(k):
            for p in range(m):
                values[start + p] -= parameters[i] * block[i, p]
        for i in range(k):
            total = 0.0
            for p in range(m):
                total += scaled[i, p] * values[start + p]
            right[i] += total
        if not whole:
            continue
        for i in range(0, k, 2):
            for j in range(0, i + 2, 4):
                a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = 0.0
                for p in range(m):
                    u, v = scaled[i, p], scaled[i + 1, p]
                    t0, t1, t2, t3 = block[j, p], block[j + 1, p], block[j + 2, p], block[j + 3, p]
                    a0 += u * t0
                    a1 += u * t1
                    a2 += u * t2
                    a3 += u * t3
                    b0 += v * t0
                    b1 += v * t1
                    b2 += v * t2
                    b3 += v * t3
                normal[i, j] += a0
                normal[i, j + 1] += a1
                normal[i, j + 2] += a2
                normal[i, j + 3] += a3
                normal[i + 1, j] += b0
                normal[i + 1, j + 1] += b1
                normal[i + 1, j + 2] += b2
                normal[i + 1, j + 3] += b3


@jit
def zernike_terms(x, y, scale, recurrence, place, factor, out):
    """Write Zernike polynomials at points into rows of ``out`` (k, n).

    P_0 = 1, P_{j+1} = (A_j + B_j s) P_j - C_j P_{j-1} with s = |w|^2, w = scale (x + iy), ``recurrence`` being
    (A, B, C)[m, j]. ``place[0 or 1, m, j]`` is the row of Re or Im w^m P_j, or -1; ``factor`` multiplies the rows.
    """
    orders, count = place.shape[1], place.shape[2]
    w = np.empty((8, BLOCK))  # w, s, w^m (real and imaginary), three polynomials by turns
    for start in range(0, x.size, BLOCK):
        n = min(BLOCK, x.size - start)
        for p in range(n):
            w[0, p] = scale * x[start + p]
            w[1, p] = scale * y[start + p]
            w[2, p] = w[0, p] * w[0, p] + w[1, p] * w[1, p]
            w[3, p] = 1.0
            w[4, p] = 0.0
        for m in range(orders):
            last = -1
            for j in range(count):
                if place[0, m, j] >= 0 or place[1, m, j] >= 0:
                    last = j
            w[5] = 0.0
            w[6] = 1.0
            old, now, new = 5, 6, 7
            for j in range(last + 1):
                for part in range(2):
                    row = place[part, m, j]
                    if row >= 0:
                        f = factor[row]
                        for p in range(n):
                            out[row, start + p] = f * w[3 + part, p] * w[now, p]
                if j < last:
                    a, b, c = recurrence[0, m, j], recurrence[1, m, j], recurrence[2, m, j]
                    for p in range(n):
                        w[new, p] = (a + b * w[2, p]) * w[now, p] - c * w[old, p]
                    old, now, new = now, new, old
            for p in range(n):
                a, b = w[3, p], w[4, p]
                w[3, p] = a * w[0, p] - b * w[1, p]
                w[4, p] = a * w[1, p] + b * w[0, p]
