"""Misfit of points to a table of heights at each of many poses, and the best fit from there."""

from __future__ import annotations

import numpy as np

from turnwright._kernels import jit

__all__ = ["bend", "misfit", "settle"]


@jit
def _turned(a, b, turn, out):
    """Fill ``out`` (3, 3) with a turn about z, then about the axis (a, b, 0) by its length."""
    c, s = np.cos(turn), np.sin(turn)
    angle = np.sqrt(a * a + b * b)
    p, q, k, h = 0.0, 0.0, 1.0, 0.0
    if angle > 0.0:
        p, q = a / angle, b / angle
        k, h = np.cos(angle), np.sin(angle)
    # Rodrigues' formula for an axis in the plane.
    w00, w01, w02 = k + p * p * (1.0 - k), p * q * (1.0 - k), q * h
    w10, w11, w12 = p * q * (1.0 - k), k + q * q * (1.0 - k), -p * h
    w20, w21, w22 = -q * h, p * h, k
    out[0, 0], out[0, 1], out[0, 2] = w00 * c + w01 * s, w01 * c - w00 * s, w02
    out[1, 0], out[1, 1], out[1, 2] = w10 * c + w11 * s, w11 * c - w10 * s, w12
    out[2, 0], out[2, 1], out[2, 2] = w20 * c + w21 * s, w21 * c - w20 * s, w22


@jit
def _gather(x, y, z, at, turn, table, low, step, limit, normal, right, sizes):
    """Add up the normal equations of shift (x, y, z) and turns about x, y, z; return points on the table and squares.

    ``at`` (3,) is where the pivot lies, ``turn`` (3, 3) turns the points about it. A residual beyond the limit counts
    with the limit, and does not pull. ``sizes`` (n,) begins with the magnitudes of the residuals afterwards.
    """
    last = table.shape[0] - 1.0
    normal[:] = 0.0
    right[:] = 0.0
    n = square = 0.0
    for i in range(x.size):
        p = turn[0, 0] * x[i] + turn[0, 1] * y[i] + turn[0, 2] * z[i]
        q = turn[1, 0] * x[i] + turn[1, 1] * y[i] + turn[1, 2] * z[i]
        u, v = (at[0] + p - low) / step, (at[1] + q - low) / step
        if not (u >= 0.0 and v >= 0.0 and u < last and v < last):
            continue
        a, b = int(u), int(v)
        fu, fv = u - a, v - b
        t00, t01, t10, t11 = table[b, a], table[b, a + 1], table[b + 1, a], table[b + 1, a + 1]
        height = (1.0 - fv) * ((1.0 - fu) * t00 + fu * t01) + fv * ((1.0 - fu) * t10 + fu * t11)
        if not np.isfinite(height):
            continue
        w = turn[2, 0] * x[i] + turn[2, 1] * y[i] + turn[2, 2] * z[i]
        zx = ((1.0 - fv) * (t01 - t00) + fv * (t11 - t10)) / step
        zy = ((1.0 - fu) * (t10 - t00) + fu * (t11 - t01)) / step
        r = at[2] + w - height
        sizes[int(n)] = abs(r)
        n += 1.0
        if abs(r) > limit:
            square += limit * limit
            continue
        c = (-zx, -zy, 1.0, q + w * zy, -w * zx - p, q * zx - p * zy)
        square += r * r
        for j in range(6):
            right[j] += c[j] * r
            for k in range(j + 1):
                normal[j, k] += c[j] * c[k]
    return n, square


@jit
def _step(normal, right, damping, free, out):
    """Solve the damped normal equations of the free numbers by Cholesky; return how much the squares fall."""
    factor = np.zeros((6, 6))
    size = np.zeros(6)
    for j in range(6):
        size[j] = np.sqrt(normal[j, j]) if free[j] and normal[j, j] > 0.0 else 0.0
    for j in range(6):
        out[j] = 0.0
        if size[j] == 0.0:
            continue
        for i in range(j, 6):
            if size[i] == 0.0:
                continue
            value = normal[i, j] / (size[i] * size[j])
            if i == j:
                value += damping
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            if i == j:
                factor[j, j] = np.sqrt(value) if value > 1e-13 else 0.0
            elif factor[j, j] > 0.0:
                factor[i, j] = value / factor[j, j]
    fall = 0.0
    for j in range(6):
        if size[j] == 0.0 or factor[j, j] == 0.0:
            continue
        value = right[j] / size[j]
        for k in range(j):
            value -= factor[j, k] * out[k]
        out[j] = value / factor[j, j]
        fall += out[j] * out[j]
    for j in range(5, -1, -1):
        if size[j] == 0.0 or factor[j, j] == 0.0:
            out[j] = 0.0
            continue
        value = out[j]
        for k in range(j + 1, 6):
            value -= factor[k, j] * out[k]
        out[j] = value / factor[j, j]
    for j in range(6):
        if size[j] > 0.0:
            out[j] /= size[j]
    return fall


@jit
def misfit(x, y, z, places, height, table, low, step, free, passes, out):
    """Fill ``out`` (5, m) with points on the table, their mean square from it when levelled, and what levels them.

    A place (px, py, turn) puts the points about their pivot at (px, py, height), turned about z. There height and the
    tilts that are ``free`` (6,) are fitted in so many passes. The square ``table`` starts at ``low`` in x and y and is
    nan where there is no surface; a place with fewer than four points on it fits infinitely badly.
    """
    level = free.copy()
    level[0] = level[1] = level[5] = False
    normal, right, change = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    turn, at, sizes = np.zeros((3, 3)), np.zeros(3), np.zeros(x.size)
    for k in range(places.shape[0]):
        at[0], at[1], at[2] = places[k, 0], places[k, 1], height
        a = b = n = mean_square = 0.0
        for _ in range(passes):
            _turned(a, b, places[k, 2], turn)
            n, square = _gather(x, y, z, at, turn, table, low, step, np.inf, normal, right, sizes)
            mean_square = np.inf
            if n < 4.0:
                break
            mean_square = max(square - _step(normal, right, 0.0, level, change), 0.0) / n
            at[2] -= change[2]
            a -= change[3]
            b -= change[4]
        out[0, k], out[1, k], out[2, k], out[3, k], out[4, k] = n, mean_square, at[2], a, b


@jit
def bend(at, about, bends, out):
    """Fill ``out`` (3,) with what a turn moves a point beyond the first order, about the design's centres of curvature.

    ``at`` (3,) is the point, ``about`` (3,) the turn. ``bends`` (6,) holds the direction (cos, sin) of one principal
    curvature, then for it and for the one across it where the centre lies along it and in height; nan for none.
    """
    out[:] = 0.0
    for k in range(2):
        # Along e the turn about the axis across it moves a point; the sense of that axis changes with k.
        c, s = (bends[0], bends[1]) if k == 0 else (-bends[1], bends[0])
        angle = about[1] * c - about[0] * s
        if not np.isfinite(bends[3 + 2 * k]):
            continue
        along, up = at[0] * c + at[1] * s - bends[2 + 2 * k], at[2] - bends[3 + 2 * k]
        second, third = np.cos(angle) - 1.0, np.sin(angle) - angle
        out[0] += c * (along * second + up * third)
        out[1] += s * (along * second + up * third)
        out[2] += up * second - along * third


@jit
def settle(x, y, z, starts, bends, table, low, step, free, most, width, out):
    """Refine each start to the nearest minimum of the table: fill ``out`` (m, 14) with points, mean square and motion.

    A start holds px, py, turn as in `misfit`, then height and the axis (a, b) of what levels it there; the motion is
    where the pivot lies (3,), then the matrix (9,) that turns the points about it. Steps follow the valleys of
    ``bends``, see `bend`: a shift hardly differs from a tilt. Residuals beyond ``width`` times their median do not
    pull; inf is least squares.
    """
    normal, right, change = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    trial_normal, trial_right = np.zeros((6, 6)), np.zeros(6)
    turn, tilted, trial_turn = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    at, trial_at, more, sizes = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(x.size)
    for k in range(starts.shape[0]):
        at[0], at[1], at[2] = starts[k, 0], starts[k, 1], starts[k, 3]
        _turned(starts[k, 4], starts[k, 5], starts[k, 2], turn)
        limit, damping = np.inf, 1e-6
        n, square = _gather(x, y, z, at, turn, table, low, step, limit, normal, right, sizes)
        first, begun = n, square / max(n, 1.0)
        for _ in range(most):
            if n < 8.0:
                break
            if width < np.inf:
                limit = min(limit, width * np.median(sizes[: int(n)]))
                n, square = _gather(x, y, z, at, turn, table, low, step, limit, normal, right, sizes)
            _step(normal, right, damping, free, change)
            trial_at[:] = at - change[:3]
            _turned(-change[3], -change[4], -change[5], tilted)
            bend(at, -change[3:], bends, more)
            trial_at += more
            for i in range(3):
                for j in range(3):
                    trial_turn[i, j] = tilted[i, 0] * turn[0, j] + tilted[i, 1] * turn[1, j] + tilted[i, 2] * turn[2, j]
            m, trial_square = 0.0, np.inf
            if trial_turn[2, 2] > 0.3:
                m, trial_square = _gather(
                    x, y, z, trial_at, trial_turn, table, low, step, limit, trial_normal, trial_right, sizes
                )
            # A step must not be paid for by points that it moves off the part: each costs what one cost at first.
            better = m >= 0.5 * first and m >= 8.0 and trial_square / m <= square / n
            if m < 0.98 * first and trial_square - begun * m > square - begun * n:
                better = False
            if better:
                done = trial_square / m > (1.0 - 1e-5) * square / n
                at[:], turn[:], normal[:], right[:] = trial_at, trial_turn, trial_normal, trial_right
                n, square, damping = m, trial_square, max(damping / 10.0, 1e-9)
                if done:
                    break
            else:
                if width < np.inf:
                    n, square = _gather(x, y, z, at, turn, table, low, step, limit, normal, right, sizes)
                damping = max(damping * 10.0, 1e-6)
                if damping > 1e4:
                    break
        out[k, 0], out[k, 1] = n, square / n if n > 0.0 else np.inf
        out[k, 2:5] = at
        for i in range(3):
            for j in range(3):
                out[k, 5 + 3 * i + j] = turn[i, j]
