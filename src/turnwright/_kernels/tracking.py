"""An axis between its program points, and its exact response as a linear system, in one pass.

Between two knots the command is a polynomial of the third degree or less, so each mode of the axis, x' = p x + u, has a
closed form there. Nothing is sampled or discretised.
"""

import numpy as np

from turnwright._kernels import jit

LINEAR, CUBIC, QUADRATIC_SPLINE, CUBIC_SPLINE = range(4)

INVERSE_FACTORIALS = 1.0 / np.cumprod(np.concatenate((np.ones(1), np.arange(1.0, 24.0))))
NEAR = 1.0  # below this |z| the series of phi_4 converges to rounding within the terms above


@jit
def ahead(time, k):
    """Return time k, carried on evenly beyond both ends."""
    last = time.size - 1
    if k < 0:
        return time[0] + k * (time[1] - time[0])
    if k > last:
        return time[last] + (k - last) * (time[last] - time[last - 1])
    return time[k]


@jit
def knot(kind, time, k):
    """Return knot k of a command: piece k runs from knot k to knot k + 1.

    A quadratic spline has its knots half way between the points, all others at the points.
    """
    if kind == QUADRATIC_SPLINE:
        return 0.5 * (ahead(time, k - 1) + ahead(time, k))
    return ahead(time, k)


@jit
def blossom(kind, time, value, k, t, out):
    """Fill ``out`` with the derivatives 0 to 3 over factorials, at t, of piece k of a spline with control ``value``."""
    degree = 2 if kind == QUADRATIC_SPLINE else 3
    # De Boor's triangle on the control values, differentiated as it is built: row j holds a polynomial in s = t' - t.
    work = np.zeros((4, 4))
    for j in range(degree + 1):
        work[j, 0] = ahead(value, k + j - 1)
    for level in range(1, degree + 1):
        for j in range(degree, level - 1, -1):
            low = knot(kind, time, k + j - degree)
            high = knot(kind, time, k + j + 1 - level)
            share, slope = (t - low) / (high - low), 1.0 / (high - low)
            for power in range(level, -1, -1):
                mixed = (1.0 - share) * work[j - 1, power] + share * work[j, power]
                if power > 0:
                    mixed += slope * (work[j, power - 1] - work[j - 1, power - 1])
                work[j, power] = mixed
    for power in range(4):
        out[power] = work[degree, power]


@jit
def piece(kind, time, value, rate, k, out):
    """Fill ``out`` (4,) with the polynomial of piece k in the time since its knot.

    Beyond both ends the axis continues in a straight line.
    """
    last = time.size - 1
    out[:] = 0.0
    if kind == QUADRATIC_SPLINE or kind == CUBIC_SPLINE:
        blossom(kind, time, value, k, knot(kind, time, k), out)
        return
    i = min(max(k, 0), last - 1)
    span = time[i + 1] - time[i]
    mean = (value[i + 1] - value[i]) / span
    out[0], out[1] = ahead(value, k), mean
    if kind == CUBIC and 0 <= k < last:
        out[1] = rate[i]
        out[2] = (3.0 * mean - 2.0 * rate[i] - rate[i + 1]) / span
        out[3] = (rate[i] + rate[i + 1] - 2.0 * mean) / (span * span)
    elif kind == CUBIC:
        out[0] = value[0] if k < 0 else value[last]
        out[1] = rate[0] if k < 0 else rate[last]
        if k < 0:
            out[0] += rate[0] * (ahead(time, k) - time[0])
        else:
            out[0] += rate[last] * (ahead(time, k) - time[last])


@jit
def find_piece(kind, time, t, k):
    """Return the piece that holds t, from a guess k near or below it."""
    while knot(kind, time, k + 1) <= t:
        k += 1
    while knot(kind, time, k) > t:
        k -= 1
    return k


@jit
def rates(time, value, out):
    """Fill ``out`` with the slopes at the points of the parabolas through three neighbours each."""
    last = time.size - 1
    if last == 1:
        out[:] = (value[1] - value[0]) / (time[1] - time[0])
        return
    for i in range(1, last):
        before, after = time[i] - time[i - 1], time[i + 1] - time[i]
        low, high = (value[i] - value[i - 1]) / before, (value[i + 1] - value[i]) / after
        out[i] = (low * after + high * before) / (before + after)
        if i == 1:
            out[0] = 2.0 * low - out[1]
        if i == last - 1:
            out[last] = 2.0 * high - out[i]


@jit
def command(kind, time, value, rate, delay, at, out):
    """Fill ``out`` with the position commanded ``delay`` before each of the ascending times ``at``."""
    part = np.empty(4)
    k = find_piece(kind, time, at[0] - delay, 0)
    piece(kind, time, value, rate, k, part)
    for i in range(at.size):
        t = at[i] - delay
        new_piece = find_piece(kind, time, t, k)
        if new_piece != k:
            k = new_piece
            piece(kind, time, value, rate, k, part)
        s = t - knot(kind, time, k)
        out[i] = part[0] + s * (part[1] + s * (part[2] + s * part[3]))


@jit
def weights(pole, span, phi):
    """Fill ``phi`` (5,) complex: exp(z), then span^(j+1) j! phi_(j+1)(z) for j = 0 to 3, with z = pole * span.

    These integrate exp(pole * (span - s)) * s^j over s from 0 to span.
    """
    z = pole * span
    if abs(z) < NEAR:
        series = 0.0 + 0.0j
        for k in range(19, -1, -1):
            series = series * z + INVERSE_FACTORIALS[k + 4]
        four = series
        three = four * z + INVERSE_FACTORIALS[3]
        two = three * z + INVERSE_FACTORIALS[2]
        one = two * z + 1.0
        exponential = one * z + 1.0
    else:
        exponential = np.exp(z)
        one = (exponential - 1.0) / z
        two = (one - 1.0) / z
        three = (two - INVERSE_FACTORIALS[2]) / z
        four = (three - INVERSE_FACTORIALS[3]) / z
    phi[0] = exponential
    phi[1] = span * one
    phi[2] = span * span * two
    phi[3] = 2.0 * span**3 * three
    phi[4] = 6.0 * span**4 * four


@jit
def respond(kind, time, value, rate, delay, poles, residues, direct, at, out):
    """Fill ``out`` with the position of an axis at the ascending times ``at``.

    Before the command the axis has always moved as straight as the command begins. Its response is ``direct`` + sum of
    ``residues`` / (s - ``poles``), taken twice the real part for each pole, so that conjugate ones are given once and
    real ones with half their residue.
    """
    part, local = np.empty(4), np.empty(4)
    states = np.empty(poles.size, dtype=np.complex128)
    phi = np.empty((poles.size, 5), dtype=np.complex128)
    weights_span = -1.0  # the span that phi is for
    # Start in the steady state of the straight line: x = -(u + u'/p) / p.
    start = min(at[0] - delay, time[0])
    k = find_piece(kind, time, start, 0)
    piece(kind, time, value, rate, k, part)
    s = start - knot(kind, time, k)
    u = part[0] + s * (part[1] + s * (part[2] + s * part[3]))
    slope = part[1] + s * (2.0 * part[2] + 3.0 * s * part[3])
    for m in range(poles.size):
        states[m] = -(u + slope / poles[m]) / poles[m]
    now = start
    for i in range(at.size):
        goal = at[i] - delay
        while now < goal:
            end = knot(kind, time, k + 1)
            stop = min(goal, end)
            span = stop - now
            s = now - knot(kind, time, k)
            local[0] = part[0] + s * (part[1] + s * (part[2] + s * part[3]))
            local[1] = part[1] + s * (2.0 * part[2] + 3.0 * s * part[3])
            local[2] = part[2] + 3.0 * s * part[3]
            local[3] = part[3]
            # Equal blocks differ by the rounding of their times, which is ignored.
            if abs(span - weights_span) > 4.5e-16 * abs(stop):
                for m in range(poles.size):
                    weights(poles[m], span, phi[m])
                weights_span = span
            for m in range(poles.size):
                states[m] = (
                    phi[m, 0] * states[m] + phi[m, 1] * local[0] + phi[m, 2] * local[1] + phi[m, 3] * local[2]
                    + phi[m, 4] * local[3]
                )  # fmt: skip
            now = stop
            if stop == end:
                k = find_piece(kind, time, stop, k)
                piece(kind, time, value, rate, k, part)
        s = goal - knot(kind, time, k)
        total = direct * (part[0] + s * (part[1] + s * (part[2] + s * part[3])))
        for m in range(poles.size):
            total += 2.0 * (residues[m] * states[m]).real
        out[i] = total


@jit
def stretch(time, position, blocks, acceleration, factor):
    """Raise ``factor`` (n - 1,) where an axis could not stop within the next ``blocks`` blocks.

    It may go as fast as it can brake over the way that these blocks are long.
    """
    last = time.size - 1
    way = 0.0
    for j in range(min(blocks, last)):
        way += abs(position[j + 1] - position[j])
    for i in range(last):
        speed = abs(position[i + 1] - position[i]) / (time[i + 1] - time[i])
        allowed = np.sqrt(2.0 * acceleration * max(way, 0.0))
        if speed > allowed * factor[i]:
            factor[i] = speed / allowed
        way -= abs(position[i + 1] - position[i])
        j = i + blocks
        # Beyond the end of the program the axis may go on as it went.
        step = position[j + 1] - position[j] if j < last else position[last] - position[last - 1]
        way += abs(step)


@jit
def bulge(time, position):
    """Return the largest distance between a smooth curve and its chords, as neighbouring chords show it."""
    most = 0.0
    for i in range(1, time.size - 1):
        before, after = time[i] - time[i - 1], time[i + 1] - time[i]
        bend = (position[i + 1] - position[i]) / after - (position[i] - position[i - 1]) / before
        longer = max(before, after)
        most = max(most, abs(bend) * longer * longer / (before + after))
    return 0.25 * most
