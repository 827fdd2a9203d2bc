"""Dilation of the surface by the edge, point by point. See placing.search for the method."""

import numpy as np

from turnwright._kernels import jit, jit_inline
from turnwright._kernels.edge import height, outline, outlines, slope
from turnwright._kernels.trig import sincos

FULL, COARSE, OUTSIDE = -1, -2, -3  # return values of `candidates` without a result
# After a small step, see `Contact.step_tol`, to a top this little higher [mm], the parabola's top is the maximum.
RISE_TOL_MM = 1e-9
CLOSE_RATIO = 1e-3  # of the step: a break less far from a sample may be higher than it by rounding alone


@jit
def under_edge(edge, angle, radius, lateral, sweep, x, y, e):
    """Fill ``x``, ``y`` with the position of the edge on the part at ``sweep``, the tip at (radius, ``lateral``).

    Fill ``e`` with its height above the commanded tip.
    """
    place = outlines(edge, sweep)
    for i in range(angle.size):
        sine, cosine = sincos(angle[i])
        u, w = place[0, i], place[1, i]
        along = radius[i] + edge.dx + u
        across = lateral[i] + edge.dy + edge.rake_sin * w
        x[i] = along * cosine - across * sine
        y[i] = along * sine + across * cosine
        e[i] = edge.rake_cos * w + edge.dz


@jit
def newton_step(edge, angle, sweep, f, fx, fy, fxx, fxy, fyy, value, first, top, step, bend):
    """Take one Newton step towards the place on the nose where f - e is greatest.

    Fill ``value`` with f - e and ``first`` with its derivative, ``top`` with the maximum as the local parabola gives
    it, ``step`` with the change of sweep towards it (heights of the commanded tip) and ``bend`` with the curvature of
    the surface under the edge, per distance along it. [1/mm]
    A step of nan means that the parabola opens upward: no maximum is near.
    """
    place = outlines(edge, sweep)
    for i in range(angle.size):
        sine, cosine = sincos(angle[i])
        w, du, dw, ddu, ddw = place[1, i], place[2, i], place[3, i], place[4, i], place[5, i]
        dx = du * cosine - edge.rake_sin * dw * sine
        dy = du * sine + edge.rake_sin * dw * cosine
        ddx = ddu * cosine - edge.rake_sin * ddw * sine
        ddy = ddu * sine + edge.rake_sin * ddw * cosine
        rise = fx[i] * dx + fy[i] * dy
        curve = fxx[i] * dx * dx + 2.0 * fxy[i] * dx * dy + fyy[i] * dy * dy + fx[i] * ddx + fy[i] * ddy
        first[i] = rise - edge.rake_cos * dw
        second = curve - edge.rake_cos * ddw
        bend[i] = (curve - rise * ddu / du) / (du * du)
        value[i] = f[i] - edge.rake_cos * w - edge.dz
        step[i] = -first[i] / second if second < 0.0 else np.nan
        top[i] = value[i] + 0.5 * first[i] * step[i]


@jit
def round_start(edge, angle, radius, lateral, cosine, sine, x, y):
    """Fill ``x`` and ``y`` with the tips, and the direction of each azimuth."""
    for i in range(angle.size):
        s, c = sincos(angle[i])
        sine[i], cosine[i] = s, c
        along, across = radius[i] + edge.dx, lateral[i] + edge.dy
        x[i] = along * c - across * s
        y[i] = along * s + across * c


@jit
def round_step(edge, limit, step_tol, cosine, sine, radius, lateral, u, f, fx, fy, fxx, fxy, fyy, z, x, y):
    """Take one Newton step in the distance ``u`` from the tip of a perfect nose, and move (x, y) along.

    Fill ``z`` with the commanded tip height that the local parabola gives. Return how many steps were not small and how
    many places curve up by ``limit`` or more. [1/mm]
    """
    far, doubtful = 0, 0
    nose, square, lean = edge.radius, edge.radius * edge.radius, edge.rake_sin
    farthest, small = 0.98 * nose, step_tol * nose
    for i in range(u.size):
        c, s = cosine[i], sine[i]
        q = np.sqrt(square - u[i] * u[i])
        climb, bend = u[i] / q, square / (q * q * q)
        dx, dy = c - lean * climb * s, s + lean * climb * c
        first = fx[i] * dx + fy[i] * dy - edge.rake_cos * climb
        curve = fxx[i] * dx * dx + 2.0 * fxy[i] * dx * dy + fyy[i] * dy * dy + lean * bend * (fy[i] * c - fx[i] * s)
        step = -first / (curve - edge.rake_cos * bend)
        rise = 0.5 * first * step
        z[i] = f[i] - edge.rake_cos * (nose - q) - edge.dz + rise
        reach = u[i] + step
        reach = farthest if reach > farthest else -farthest if reach < -farthest else reach
        u[i] = reach
        along = radius[i] + edge.dx + reach
        across = lateral[i] + edge.dy + lean * (nose - np.sqrt(square - reach * reach))
        x[i] = along * c - across * s
        y[i] = along * s + across * c
        # Written so that nan counts as doubtful.
        doubtful += 0 if curve < limit else 1
        far += 1 if abs(step) > small or abs(rise) > RISE_TOL_MM else 0
    return far, doubtful


@jit
def places(edge, angle, radius, lateral, u, x, y):
    """Fill ``x`` and ``y`` (rows, n) with the position of the edge on the part at distances ``u`` (rows, n)."""
    for i in range(u.shape[0]):
        sine, cosine = sincos(angle[i])
        for j in range(u.shape[1]):
            along = radius[i] + edge.dx + u[i, j]
            across = lateral[i] + edge.dy
            if edge.rake_sin != 0.0:
                across += edge.rake_sin * height(edge, u[i, j])
            x[i, j] = along * cosine - across * sine
            y[i, j] = along * sine + across * cosine


@jit
def tangents_meet(edge, angle, radius, lateral, a, b, x, y):
    """Fill ``x`` and ``y`` with where the tangents of a raked edge meet, in plan, at distances ``a`` and ``b``."""
    for i in range(a.size):
        sine, cosine = sincos(angle[i])
        first, last = edge.rake_sin * slope(edge, a[i]), edge.rake_sin * slope(edge, b[i])
        start, end = edge.rake_sin * height(edge, a[i]), edge.rake_sin * height(edge, b[i])
        u = 0.5 * (a[i] + b[i])
        if abs(last - first) > 1e-9:
            u = (start - end + last * b[i] - first * a[i]) / (last - first)
            u = max(a[i], min(b[i], u))
        along = radius[i] + edge.dx + u
        across = lateral[i] + edge.dy + start + first * (u - a[i])
        x[i] = along * cosine - across * sine
        y[i] = along * sine + across * cosine


@jit
def slopes_along(edge, angle, u, fx, fy, out):
    """Fill ``out`` with the slope of the surface along the track of the edge, per distance ``u`` from the tip."""
    for i in range(u.size):
        sine, cosine = sincos(angle[i])
        lean = edge.rake_sin * slope(edge, u[i]) if edge.rake_sin != 0.0 else 0.0
        out[i] = fx[i] * (cosine - lean * sine) + fy[i] * (sine + lean * cosine)


@jit_inline
def edge_height(edge, u):
    """Return the height of the edge above its tip at distance ``u``; for a circle without a call, which costs more."""
    if edge.pieces.shape[1] == 0 and edge.low_u <= u <= edge.high_u:
        return edge.rake_cos * (edge.base - np.sqrt(edge.base * edge.base - u * u))
    return edge.rake_cos * height(edge, u)


@jit_inline
def lower_edge(edge, heights, origin, step, p, begin, end, out):
    """Fill ``out`` with f - e over the samples begin to end, the tip at ``p`` along the line."""
    base, low, high = edge.base, origin + step * begin - p, origin + step * end - p
    if edge.pieces.shape[1] == 0 and low >= edge.low_u and high <= edge.high_u:
        for j in range(begin, end + 1):
            u = origin + step * j - p
            out[j] = heights[j] - edge.rake_cos * (base - np.sqrt(base * base - u * u))
    else:
        for j in range(begin, end + 1):
            out[j] = heights[j] - edge.rake_cos * height(edge, origin + step * j - p)


@jit
def distance_at_slope(edge, goal, low, high, close):
    """Return two places, ``close`` to each other, between which the edge slopes by ``goal``; for a convex edge."""
    while high - low > close:
        middle = 0.5 * (low + high)
        if slope(edge, middle) < goal:
            low = middle
        else:
            high = middle
    return low, high


@jit
def greatest_rise(edge, low, high, step):
    """Return how much the edge can rise between samples from ``low`` to ``high`` over the line that joins them."""
    most = 0.0
    for k in range(9):
        u = low + 0.125 * k * (high - low)
        most = max(most, abs(height(edge, u - step) - 2.0 * height(edge, u) + height(edge, u + step)))
    return edge.rake_cos * most


@jit
def sampled_slopes(f, step, broken, break_height, break_slope, first_break, last_break):
    """Return how much a line can rise between samples of one piece, its range of slopes, and its highest place.

    Steps are steep slopes, also those of a piece that is narrower than a sample; close to the end of its domain a
    surface may be steeper than between any two samples.
    """
    bend, steepest, falling, summit = 0.0, -np.inf, np.inf, -np.inf
    for j in range(f.size):
        summit = max(summit, f[j])
    for j in range(1, f.size):
        rate = (f[j] - f[j - 1]) / step
        if abs(rate) < np.inf:
            steepest, falling = max(steepest, rate), min(falling, rate)
        if j > 1 and broken[j - 1] < 0 and broken[j - 2] < 0:
            second = abs(f[j - 2] - 2.0 * f[j - 1] + f[j])
            if second < np.inf:
                bend = max(bend, second)
    for b in range(first_break, last_break):
        rate = (break_height[1, b] - break_height[0, b]) / step
        if abs(rate) < np.inf:
            steepest, falling = max(steepest, rate), min(falling, rate)
            summit = max(summit, break_height[0, b], break_height[1, b])
        for side in range(2):
            rate = break_slope[side, b]
            if break_height[side, b] > -np.inf == break_height[1 - side, b] and abs(rate) < np.inf:
                steepest, falling = max(steepest, rate), min(falling, rate)
                summit = max(summit, break_height[side, b])
    return bend, steepest, falling, summit


@jit
def facing(f, origin, step, b, side, first, last, break_after, break_at, break_height):
    """Return where the smooth piece on one side of break b ends or is next sampled, and its height there.

    That is a sample, or the facing side of the next break in the same interval, of the breaks first to last.
    """
    neighbour = b - 1 if side == 0 else b + 1
    if neighbour >= first and neighbour <= last and break_after[neighbour] == break_after[b]:
        return break_at[neighbour], break_height[1 - side, neighbour]
    j = break_after[b] + side
    return origin + step * j, f[j]


@jit
def upward_curvature(
    f, origin, step, broken, break_after, break_at, break_height, break_slope, first_break, last_break
):
    """Return the greatest upward curvature of a line within its pieces; infinite where it is not finite. [1/mm]."""
    most = -np.inf
    for j in range(2, f.size):
        if broken[j - 1] < 0 and broken[j - 2] < 0:
            second = f[j - 2] - 2.0 * f[j - 1] + f[j]
            if second < np.inf:
                most = max(most, second / (step * step))
    for b in range(first_break, last_break):
        for side in range(2):
            if break_height[side, b] > -np.inf:
                at, height_at = facing(
                    f, origin, step, b, side, first_break, last_break - 1, break_after, break_at, break_height
                )
                along = at - break_at[b]
                mean = (height_at - break_height[side, b]) / along
                bend = 2.0 * (mean - break_slope[side, b]) / along
                most = max(most, bend) if bend < np.inf else np.inf
    return most


@jit_inline
def highest_sample(edge, f, origin, step, p, low, high, j, g):
    """Return which of the samples low to high of f - e is the highest, where they rise and then fall.

    The search begins at ``j``. Fill ``g`` with f - e there and at its neighbours.
    """
    first, last, stride = low, high, 1
    rose, fell = False, False
    g[low] = f[low] - edge_height(edge, origin + step * low - p)
    while first < last:
        j = (first + last) // 2 if rose and fell else max(first, min(j, last - 1))
        g[j] = f[j] - edge_height(edge, origin + step * j - p)
        g[j + 1] = f[j + 1] - edge_height(edge, origin + step * (j + 1) - p)
        if g[j + 1] > g[j]:
            first, rose, j = j + 1, True, j + stride
        else:
            last, fell, j = j, True, j - stride
        stride *= 2
    return first


@jit_inline
def highest_samples(edge, f, origin, step, p, begin, end, likely, b, last_break, break_after, g, seen):
    """Fill ``seen`` with the highest sample of f - e of each piece from begin to end; return how many there are.

    The breaks from ``b`` on divide the samples. See `highest_sample`; ``likely`` is where it begins.
    """
    low, number = begin, 0
    while low <= end:
        while b < last_break and break_after[b] < low:
            b += 1
        high = min(break_after[b], end) if b < last_break else end
        if f[low] > -np.inf:
            seen[number] = highest_sample(edge, f, origin, step, p, low, high, likely, g)
            number += 1
        low = high + 1
    return number


@jit_inline
def sampled_maxima(
    f, g, origin, step, p, k, begin, end, seen, number, threshold, broken, last_break, break_after, break_at,
    break_height, edge, point, start, stop, guess, count,
):  # fmt: skip
    """Append the samples of f - e = ``g`` that are no lower than their neighbours; return the count.

    The samples are the first ``number`` of ``seen``, from begin to end.

    The neighbour is the next sample, or the near side of a break or step before it; where that is at the sample,
    rounding alone decides which is higher, and the sample counts. Between three samples of one piece the first guess is
    where the edge is as steep as the parabola through the surface's heights.
    """
    close = CLOSE_RATIO * step
    for i in range(number):
        j = seen[i]
        # A last step, shorter than the others, may hide more than the samples say.
        at_end = j < end and broken[j] >= 0 and break_height[1, broken[j]] == -np.inf
        at_end |= j > begin and broken[j - 1] >= 0 and f[j - 1] == -np.inf
        if g[j] == -np.inf or (g[j] < threshold and not at_end):
            continue
        at = origin + step * j - p
        before, left_value = at, g[j]
        if j > begin:
            before, left_value = at - step, g[j - 1]
            if broken[j - 1] >= 0:
                b = broken[j - 1]
                while b + 1 < last_break and break_after[b + 1] == j - 1:
                    b += 1
                before = break_at[b] - p
                left_value = break_height[1, b] - edge_height(edge, before)
        after, right = at, g[j]
        if j < end:
            after, right = at + step, g[j + 1]
            if broken[j] >= 0:
                after = break_at[broken[j]] - p
                right = break_height[0, broken[j]] - edge_height(edge, after)
        if (g[j] >= left_value or at - before < close) and (g[j] >= right or after - at < close):
            point[count], start[count], stop[count] = k, before, after
            guess[count] = at
            if before == at - step and after == at + step and left_value > -np.inf and right > -np.inf:
                second = left_value - 2.0 * g[j] + right
                if second < 0.0:
                    shift = 0.5 * (left_value - right) / second
                    rise = 0.5 * (f[j + 1] - f[j - 1]) + shift * (f[j - 1] - 2.0 * f[j] + f[j + 1])
                    shift -= (rise - step * edge.rake_cos * slope(edge, at + shift * step)) / second
                    guess[count] = at + step * max(-1.0, min(1.0, shift))
            count += 1
    return count


@jit
def break_maxima(
    f, origin, step, p, k, first, last, threshold, break_after, break_at, break_height, break_slope,
    edge, point, start, stop, guess, count, direct, direct_at, ended,
):  # fmt: skip
    """Append the maxima between the breaks first to last and their neighbours, see `facing`; return the count.

    The highest side of a break goes into ``direct``.
    """
    for b in range(first, last + 1):
        at = break_at[b] - p
        e, rate = edge_height(edge, at), edge.rake_cos * slope(edge, at)
        for side in range(2):
            value = break_height[side, b] - e
            at_end = break_height[1 - side, b] == -np.inf
            if value == -np.inf or (value < threshold and not at_end):
                continue
            next_at, following = facing(f, origin, step, b, side, first, last, break_after, break_at, break_height)
            next_at -= p
            following -= edge_height(edge, next_at)
            inward = (break_slope[side, b] - rate) * (1.0 if side == 1 else -1.0)
            if value > direct[k]:
                direct[k], direct_at[k], ended[k] = value, at, at_end
            # It rises into the smooth piece, and is no higher at the other end: a maximum in between.
            if inward > 0.0 and value >= following:
                point[count] = k
                start[count], stop[count] = min(at, next_at), max(at, next_at)
                guess[count] = 0.5 * (at + next_at)
                count += 1
    return count


@jit
def candidates(
    heights, origin, step, offsets, position,
    break_offsets, break_after, break_at, break_height, break_slope,
    edge, low, high, elsewhere, whole, curvature, point, start, stop, guess, direct, direct_at, ended, narrow,
):  # fmt: skip
    """Find where f - e may be greatest: on each row a sampled line, and on it one or more tool positions.

    Parameters
    ----------
    heights
        Surface heights, -inf where there is none, at origin + step * j. (rows, m)
    offsets, position
        Row i holds the tip positions offsets[i] to offsets[i + 1] of ``position``. [mm]
    break_offsets, break_after, break_at, break_height, break_slope
        Kinks, steps and ends of the domain, row by row and ascending: the sample before, where exactly, and heights
        and slopes (2, n) of the line just before and just after; beyond an end the height is -inf.
    low, high
        Window of the edge to look at, from its tip. [mm]
    elsewhere, whole
        Height that the surface reaches beyond the samples, -inf where it is less steep than the flanks; and whether
        the window is all that counts. [mm]
    curvature
        Upward curvature from which on a smooth piece may have two maxima between samples. [1/mm]
    point, start, stop, guess
        Filled: tip position, ends of a short smooth interval and a first guess in it, from the tip. A sampled maximum
        within the sampling error of the greatest counts too, so that exact heights decide between several tangents.
    direct, direct_at, ended, narrow
        Filled for each tip position: the greatest f - e of those that stand exactly on a break, where, and whether the
        domain ends there; and whether the edge may touch beyond the window, so that nothing else is filled.

    Returns
    -------
    int
        Number of intervals; or `FULL` if they do not fit; or `COARSE` if a line curves up by ``curvature`` or more; or
        `OUTSIDE` - k if there is no surface under the edge at position k.
    """
    rows, m = heights.shape
    g = np.empty(m)
    domain_end = np.empty(break_at.size)
    seen = np.empty(m, np.int64)  # samples of f - e that may be the highest of their neighbours
    single = curvature < np.inf  # f - e has one maximum in each piece
    broken = np.empty(m, np.int64)  # number of the first break after a sample, or -1
    count = 0
    for row in range(rows):
        f = heights[row]
        first_break, last_break = break_offsets[row], break_offsets[row + 1]
        for j in range(m):
            broken[j] = -1
        for b in range(last_break - 1, first_break - 1, -1):
            broken[break_after[b]] = b
        if curvature < np.inf and not curvature > upward_curvature(
            f, origin, step, broken, break_after, break_at, break_height, break_slope, first_break, last_break
        ):
            return COARSE
        bend, steepest, falling, summit = sampled_slopes(
            f, step, broken, break_height, break_slope, first_break, last_break
        )
        # Where the surface is steeper than the edge at an end of the window it may touch beyond it, up to the summit.
        above = np.inf
        if steepest > edge.rake_cos * slope(edge, high):
            above = edge.rake_cos * height(edge, high)
        if falling < edge.rake_cos * slope(edge, low):
            above = min(above, edge.rake_cos * height(edge, low))
        if elsewhere > -np.inf:
            above = edge.rake_cos * min(height(edge, low), height(edge, high))
            summit = max(summit, elsewhere)
        if whole:
            above = np.inf
        near, far = low, high
        if edge.convex and steepest >= falling:
            near = max(low, distance_at_slope(edge, falling / edge.rake_cos, low, high, step)[0] - step)
            far = min(high, distance_at_slope(edge, steepest / edge.rake_cos, low, high, step)[1] + step)
        curve = greatest_rise(edge, max(near, edge.low_u), min(far, edge.high_u), step)
        ends = 0
        for b in range(first_break, last_break):
            if min(break_height[0, b], break_height[1, b]) == -np.inf:
                domain_end[ends] = break_at[b]
                ends += 1
        leaning = 0.0  # where the edge of the tip before touched, from its tip
        after = first_break  # the first break that is not before the window; tips that follow each other share most
        for k in range(offsets[row], offsets[row + 1]):
            p = position[k]
            # An end of the domain is touched whatever its slope.
            left_end, right_end = p + near, p + far
            for i in range(ends):
                if p + low <= domain_end[i] <= p + high:
                    left_end, right_end = min(left_end, domain_end[i]), max(right_end, domain_end[i])
            # Outward to the next sample, so that the window is covered.
            begin = max(int(np.floor((left_end - origin) / step)), 0)
            end = min(int(np.ceil((right_end - origin) / step)), m - 1)
            while after > first_break and break_after[after - 1] >= begin:
                after -= 1
            while after < last_break and break_after[after] < begin:
                after += 1
            if single:
                likely = int((p + leaning - origin) / step)
                number = highest_samples(
                    edge, f, origin, step, p, begin, end, likely, after, last_break, break_after, g, seen
                )  # fmt: skip
            else:
                lower_edge(edge, f, origin, step, p, begin, end, g)
                number = end - begin + 1
                for i in range(number):
                    seen[i] = begin + i
            greatest, where = -np.inf, -1
            for i in range(number):
                if g[seen[i]] > greatest:
                    greatest, where = g[seen[i]], seen[i]
            if where < 0:
                return OUTSIDE - k
            leaning = origin + step * where - p
            direct[k], ended[k], narrow[k] = -np.inf, False, False
            top = greatest
            first, last = -1, -1
            for b in range(after, last_break):
                if break_after[b] >= end:
                    break
                first, last = after, b
                e = edge_height(edge, break_at[b] - p)
                top = max(top, max(break_height[0, b], break_height[1, b]) - e)
            if summit - above > top or (top == greatest and (where == begin or where == end)):
                narrow[k] = True
                continue
            threshold = top - bend - curve
            if count + (end - begin) + 2 * (last_break - first_break) + 4 > point.size:
                return FULL
            count = sampled_maxima(
                f, g, origin, step, p, k, begin, end, seen, number, threshold, broken, last_break, break_after,
                break_at, break_height, edge, point, start, stop, guess, count,
            )  # fmt: skip
            if first >= 0:
                count = break_maxima(
                    f, origin, step, p, k, first, last, threshold, break_after, break_at, break_height, break_slope,
                    edge, point, start, stop, guess, count, direct, direct_at, ended,
                )  # fmt: skip
    return count


@jit
def bracket(step_tol, begin, end, low, high, sweep, value, first, top, step, best, place, done):
    """Take one safeguarded Newton step towards each maximum: one point of `placing.search`, in place.

    [low, high] brackets the maximum, by the sign of the derivative ``first`` at its ends; [begin, end] is the interval
    itself, at whose ends the maximum may be. ``best`` and ``place`` keep the greatest height seen.
    """
    for i in range(sweep.size):
        s = sweep[i]
        # At an end of the domain, rounded, there may be no slope any more: then the maximum is farther in.
        blind = not abs(first[i]) < np.inf
        rising = s <= begin[i] if blind else first[i] > 0.0
        if rising:
            low[i] = s
        else:
            high[i] = s
        following = s + step[i]
        inside = following > low[i] and following < high[i]
        small = abs(step[i]) <= step_tol and abs(top[i] - value[i]) <= RISE_TOL_MM
        height_at, at = (top[i], following) if small and inside else (value[i], s)
        if height_at > best[i]:
            best[i], place[i] = height_at, at
        at_end = s >= end[i] if rising else s <= begin[i]
        done[i] = (small and inside) or at_end or high[i] - low[i] <= 1e-15
        done[i] |= blind and begin[i] < s < end[i]
        if not inside:
            # Beyond an end: try the end itself, once. No parabola, or an end of the bracket tried before: halve.
            if following >= high[i] and high[i] == end[i]:
                following = end[i]
            elif following <= low[i] and low[i] == begin[i]:
                following = begin[i]
            else:
                following = 0.5 * (low[i] + high[i])
        sweep[i] = following


@jit
def keep_highest(point, top, sweep, z, best, ended):
    """Raise ``z`` and ``best`` of each point to its highest candidate, which is at no end of the domain."""
    for i in range(point.size):
        if top[i] > z[point[i]]:
            z[point[i]] = top[i]
            best[point[i]] = sweep[i]
            ended[point[i]] = False


@jit
def tangent_sweep(edge, slope_along, slope_across, sweep):
    """Improve ``sweep`` until the edge's tangent lies in the surface's tangent plane; nan beyond the arc."""
    for i in range(sweep.size):
        low, high = edge.low, edge.high
        s = min(max(sweep[i], low), high)
        # How fast the edge rises over the tangent plane; it grows along a convex edge.
        for _ in range(100):
            _, _, du, dw, ddu, ddw = outline(edge, s)
            lift = edge.rake_cos - slope_across[i] * edge.rake_sin
            rise = lift * dw - slope_along[i] * du
            if rise > 0.0:
                high = s
            else:
                low = s
            following = s - rise / (lift * ddw - slope_along[i] * ddu)
            if not low <= following <= high:
                following = 0.5 * (low + high)
            step = following - s
            s = following
            if abs(step) < 1e-15:
                break
        _, _, du, dw, _, _ = outline(edge, s)
        residual = (edge.rake_cos - slope_across[i] * edge.rake_sin) * dw - slope_along[i] * du
        sweep[i] = s if abs(residual) < 1e-10 * edge.radius else np.nan
