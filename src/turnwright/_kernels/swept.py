"""The surface cut by a tool and a machine that differ from the plan, point by point. See diagnosis/model.py.

A state holds, for each point, the sweep at which the planned edge would touch and the one at which the real edge cuts.
"""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.edge import arc, waviness
from turnwright._kernels.trig import sincos


@jit
def rotate_derivatives(angle, fx, fy, fxx, fxy, fyy):
    """Return slopes and curvatures along the direction of an azimuth and across it: fr, ft, frr, frt, ftt."""
    sine, cosine = sincos(angle)
    fr, ft = fx * cosine + fy * sine, fy * cosine - fx * sine
    frr = fxx * cosine * cosine + 2.0 * fxy * sine * cosine + fyy * sine * sine
    ftt = fxx * sine * sine - 2.0 * fxy * sine * cosine + fyy * cosine * cosine
    frt = (fyy - fxx) * sine * cosine + fxy * (cosine * cosine - sine * sine)
    return fr, ft, frr, frt, ftt


@jit
def places(radius, azimuth, planned, real, more, late, touch, cut, rho, psi, x, y):
    """Fill the tip position (``rho``, azimuth ``psi``) that cut each point, and the planned contact (x, y).

    ``more`` (3, n) is the deviation of the real edge from the planned waviness, with two derivatives by the sweep;
    ``late`` is the lag of Z, in azimuth.
    """
    for i in range(radius.size):
        d, d1, d2 = waviness(planned.breaks, planned.coefficients, cut[i])
        u, w, _, _, _, _ = arc(real.radius, d + more[0, i], d1 + more[1, i], d2 + more[2, i], cut[i])
        v = real.dy + real.rake_sin * w
        out = radius[i] * radius[i] - v * v
        rho[i] = (np.sqrt(out) if out > 0.0 else np.nan) - real.dx - u
        psi[i] = azimuth[i] - (np.arcsin(v / radius[i]) if out > 0.0 else np.nan)
        d, d1, d2 = waviness(planned.breaks, planned.coefficients, touch[i])
        u, w, _, _, _, _ = arc(planned.radius, d, d1, d2, touch[i])
        along, across = rho[i] + planned.dx + u, planned.dy + planned.rake_sin * w
        sine, cosine = sincos(psi[i] - late)
        x[i] = along * cosine - across * sine
        y[i] = along * sine + across * cosine


@jit
def step(
    radius, planned, real, more, late, slide_slope, rho, psi, fx, fy, fxx, fxy, fyy, touch, cut,
):  # fmt: skip
    """Improve both sweeps by one step of Newton's method; return the longest step. [rad]."""
    longest = 0.0
    for i in range(radius.size):
        fr, ft, frr, frt, ftt = rotate_derivatives(psi[i] - late, fx[i], fy[i], fxx[i], fxy[i], fyy[i])
        d, d1, d2 = waviness(planned.breaks, planned.coefficients, touch[i])
        u, w, du, dw, ddu, ddw = arc(planned.radius, d, d1, d2, touch[i])
        along, across = rho[i] + planned.dx + u, planned.dy + planned.rake_sin * w
        dv, ddv = planned.rake_sin * dw, planned.rake_sin * ddw
        d, d1, d2 = waviness(planned.breaks, planned.coefficients, cut[i])
        _, wa, dua, dwa, ddua, ddwa = arc(real.radius, d + more[0, i], d1 + more[1, i], d2 + more[2, i], cut[i])
        va, dva, ddva = real.dy + real.rake_sin * wa, real.rake_sin * dwa, real.rake_sin * ddwa
        out = np.sqrt(radius[i] * radius[i] - va * va)
        # How the tip's place changes with the sweep of the cut.
        d_rho = -va * dva / out - dua
        dd_rho = -(dva * dva + va * ddva) / out - (va * dva) ** 2 / out**3 - ddua
        d_psi = -dva / out
        dd_psi = -ddva / out - va * dva * dva / out**3
        # How the height of the tip does: g is its slope along rho and psi.
        g_rho, g_psi = fr + slide_slope[i], ft * along - fr * across
        first = fr * du + ft * dv - planned.rake_cos * dw
        second = g_rho * d_rho + g_psi * d_psi + real.rake_cos * dwa
        h_r, h_t = frr * du + frt * dv, frt * du + ftt * dv
        h_11 = h_r * du + h_t * dv + fr * ddu + ft * ddv - planned.rake_cos * ddw
        h_12 = h_r * (d_rho - d_psi * across) + h_t * d_psi * along + d_psi * (ft * du - fr * dv)
        g_rp = -frr * across + frt * along + ft
        g_pp = frr * across * across - 2.0 * frt * across * along + ftt * along * along - fr * along - ft * across
        h_22 = frr * d_rho * d_rho + 2.0 * g_rp * d_rho * d_psi + g_pp * d_psi * d_psi
        h_22 += g_rho * dd_rho + g_psi * dd_psi + real.rake_cos * ddwa
        det = h_11 * h_22 - h_12 * h_12
        # The planned edge touches at a maximum, the real one cuts at a minimum: the product is below 0.
        if not det < 0.0:
            touch[i], cut[i] = np.nan, np.nan
            continue
        one = (h_22 * first - h_12 * second) / det
        other = (h_11 * second - h_12 * first) / det
        touch[i] -= max(-0.2, min(0.2, one))
        cut[i] -= max(-0.2, min(0.2, other))
        longest = max(longest, abs(one), abs(other))
    return longest


@jit
def heights(
    radius, azimuth, planned, real, more, late, slide, slide_slope, rho, psi,
    f, fx, fy, fxx, fxy, fyy, touch, cut, out,
):  # fmt: skip
    """Fill ``out`` (14, n) with the height and its derivatives, for given sweeps of touch and cut.

    Rows: height; its slopes along x and y; its derivatives by dx, dy, dz of the tip, by the radius, by a deviation of
    the edge where it cuts, by the azimuth (Z early); the second derivative of Z by the azimuth; the curvature of the
    passes against each other, which makes the cusps; and its derivatives by a deviation and by its two derivatives.
    """
    for i in range(radius.size):
        fr, ft, frr, frt, ftt = rotate_derivatives(psi[i] - late, fx[i], fy[i], fxx[i], fxy[i], fyy[i])
        d, d1, d2 = waviness(planned.breaks, planned.coefficients, touch[i])
        u, w, du, dw, ddu, ddw = arc(planned.radius, d, d1, d2, touch[i])
        along, across = rho[i] + planned.dx + u, planned.dy + planned.rake_sin * w
        dv, ddv = planned.rake_sin * dw, planned.rake_sin * ddw
        lowest = f[i] - planned.dz - planned.rake_cos * w
        d, d1, d2 = waviness(planned.breaks, planned.coefficients, cut[i])
        _, wa, dua, dwa, ddua, ddwa = arc(real.radius, d + more[0, i], d1 + more[1, i], d2 + more[2, i], cut[i])
        va = real.dy + real.rake_sin * wa
        in_plane = np.sqrt(radius[i] * radius[i] - va * va)
        g_rho, g_psi = fr + slide_slope[i], ft * along - fr * across
        g_v = -(g_rho * va + g_psi) / in_plane
        out[0, i] = lowest + real.dz + real.rake_cos * wa + slide[i]
        g_r = g_rho * radius[i] / in_plane + g_psi * va / (radius[i] * in_plane)
        sine, cosine = sincos(azimuth[i])
        out[1, i] = g_r * cosine - g_psi * sine / radius[i]
        out[2, i] = g_r * sine + g_psi * cosine / radius[i]
        sine, cosine = sincos(cut[i])
        out[3, i] = -g_rho
        out[4, i] = g_v
        out[5, i] = 1.0
        out[6, i] = (real.rake_sin * g_v + real.rake_cos) * (1.0 - cosine) - g_rho * sine
        out[7, i] = -(real.rake_sin * g_v + real.rake_cos) * cosine - g_rho * sine
        out[8, i] = g_psi
        h_r, h_t = frr * du + frt * dv, frt * du + ftt * dv
        h_11 = h_r * du + h_t * dv + fr * ddu + ft * ddv - planned.rake_cos * ddw
        turned = -h_r * across + h_t * along + ft * du - fr * dv
        g_pp = frr * across * across - 2.0 * frt * across * along + ftt * along * along - fr * along - ft * across
        out[9, i] = g_pp - turned * turned / h_11
        # Along rho, of Z and of the edge upside down; a leaning edge counts as if it were upright.
        bent = (ddwa - dwa * ddua / dua) / (dua * dua)
        out[10, i] = frr - h_r * h_r / h_11 + real.rake_cos * bent
        # By what u', w', u'' and w'' change with the deviation and its derivatives.
        cubed = dua * dua * dua
        out[11, i] = real.rake_cos * (
            (cosine * dua + ddwa * cosine - sine * ddua + dwa * sine) / cubed - 3.0 * bent * cosine / dua
        )
        out[12, i] = real.rake_cos * (
            (2.0 * sine * dua + ddwa * sine + cosine * ddua - 2.0 * dwa * cosine) / cubed - 3.0 * bent * sine / dua
        )
        out[13, i] = -real.rake_cos * (cosine * dua + dwa * sine) / cubed
