"""Derivatives of a tip in contact along its spiral, point by point. See placing.contact for the method."""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.dilation import under_edge
from turnwright._kernels.edge import outlines
from turnwright._kernels.trig import sincos

GOLDEN = 0.6180339887498949  # the golden ratio less 1: its multiples, without their whole parts, leave no large gap


@jit
def rates(
    edge, angle, x, y, sweep, fx, fy, fxx, fxy, fyy, outward, upward, near,
    rate, across, along, rise, tangent,
):  # fmt: skip
    """Fill ``rate`` with the derivative of the tip's height by the angle.

    The place on the edge is less accurate than the height there, so the slope is evaluated after one more Newton step,
    if that is below ``near``: then ``tangent`` is set. Fill ``across`` (2, n) with the derivative of the contact point
    by the angle, ``along`` (2, n) and ``rise`` with those of the contact point and of the edge height by the sweep.
    """
    place = outlines(edge, sweep)
    for i in range(angle.size):
        sine, cosine = sincos(angle[i])
        du, dw, ddu, ddw = place[2, i], place[3, i], place[4, i], place[5, i]
        dx = du * cosine - edge.rake_sin * dw * sine
        dy = du * sine + edge.rake_sin * dw * cosine
        ddx = ddu * cosine - edge.rake_sin * ddw * sine
        ddy = ddu * sine + edge.rake_sin * ddw * cosine
        bent_x, bent_y = fxx[i] * dx + fxy[i] * dy, fxy[i] * dx + fyy[i] * dy
        second = bent_x * dx + bent_y * dy + fx[i] * ddx + fy[i] * ddy - edge.rake_cos * ddw
        step = (edge.rake_cos * dw - fx[i] * dx - fy[i] * dy) / second if second < 0.0 else np.nan
        tangent[i] = abs(step) < near
        if not tangent[i]:
            step = 0.0
        out_x = outward[i] * cosine - upward[i] * sine - y[i]
        out_y = outward[i] * sine + upward[i] * cosine + x[i]
        rate[i] = (fx[i] + bent_x * step) * out_x + (fy[i] + bent_y * step) * out_y
        across[0, i], across[1, i] = out_x, out_y
        along[0, i], along[1, i], rise[i] = dx, dy, edge.rake_cos * dw


@jit
def normal_rates(edge, angle, x, y, sweep, fx, fy, fxx, fxy, fyy, outward, upward, radius_rate, z_rate):
    """Fill the derivatives by the angle of a tip whose edge lies in the tangent plane at a contact that moves.

    The contact moves ``outward`` along the rake plane; ``upward`` is how the height of the tip above centre changes.
    The sweep follows so that the edge stays in the tangent plane; the tip follows the contact and the sweep.
    """
    place = outlines(edge, sweep)
    for i in range(angle.size):
        sine, cosine = sincos(angle[i])
        du, dw, ddu, ddw = place[2, i], place[3, i], place[4, i], place[5, i]
        # Derivatives of the contact by the angle at a fixed sweep, and by the sweep: rake moves it laterally.
        turned_x = outward[i] * cosine - upward[i] * sine - y[i]
        turned_y = outward[i] * sine + upward[i] * cosine + x[i]
        swept_x, swept_y = -edge.rake_sin * dw * sine, edge.rake_sin * dw * cosine
        along, across = fx[i] * cosine + fy[i] * sine, fy[i] * cosine - fx[i] * sine
        bent_x, bent_y = fxx[i] * turned_x + fxy[i] * turned_y, fxy[i] * turned_x + fyy[i] * turned_y
        along_turned = bent_x * cosine + bent_y * sine + across
        across_turned = bent_y * cosine - bent_x * sine - along
        bent_x, bent_y = fxx[i] * swept_x + fxy[i] * swept_y, fxy[i] * swept_x + fyy[i] * swept_y
        along_swept = bent_x * cosine + bent_y * sine
        across_swept = bent_y * cosine - bent_x * sine
        rolls = (
            (edge.rake_cos - across * edge.rake_sin) * ddw
            - along * ddu
            - edge.rake_sin * dw * across_swept
            - du * along_swept
        )
        rate = (edge.rake_sin * dw * across_turned + du * along_turned) / rolls
        radius_rate[i] = outward[i] - du * rate
        z_rate[i] = (
            fx[i] * (turned_x + swept_x * rate) + fy[i] * (turned_y + swept_y * rate) - edge.rake_cos * dw * rate
        )


@jit
def spread(edge, angle, radius, lateral, first, step, below, above, x, y, e):
    """Fill ``x``, ``y`` with the position on the part of one place of each edge, and ``e`` with its height there.

    The places follow each other by the golden ratio: half of them on the arc; the others on the flanks, closer together
    at its ends, as far as ``below`` and ``above`` reach. [rad]
    """
    low, high = edge.low, edge.high
    sweep = np.empty(angle.size)
    for i in range(angle.size):
        at = (first + step * i) * GOLDEN
        at = 2.0 * (at - np.floor(at)) - 1.0
        if at < -0.5:
            sweep[i] = low - below * (2.0 * at + 1.0) ** 2
        elif at > 0.5:
            sweep[i] = high + above * (2.0 * at - 1.0) ** 2
        else:
            sweep[i] = 0.5 * (low + high) + (high - low) * at
    under_edge(edge, angle, radius, lateral, sweep, x, y, e)


@jit
def lower_to_gap(z, e, f, x, y, axis, rim, least):
    """Lower ``least`` to the height of the edge above the surface, at places off the axis and inside the rim."""
    for i in range(z.size):
        square = x[i] * x[i] + y[i] * y[i]
        gap = z[i] + e[i] - f[i]
        if axis * axis < square <= rim * rim and gap < least[i]:
            least[i] = gap
