"""Feed as large as the scallop allows, and points as far apart as the chord allows. See strategy/adaptive.py.

A path is sampled as arrays over the angle turned t: height z, real radius x, their derivatives dz and dx by t, the
slope s of the height along the radius, and the allowed error ``lateral`` of the radius. Between two samples it is a
cubic. Each array is (n,), and ``path`` (7, n) holds t, z, dz, x, dx, s and lateral.
"""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.edge import height, slope
from turnwright._kernels.ordered import interval
from turnwright._kernels.trig import sincos

TURN = 2.0 * np.pi
SEARCH_FACTOR = 2  # points are tried up to this many times the furthest step so far, plus some samples
SEARCH_MARGIN = 8
BISECTIONS = 6  # of the interval between the last sample that a step may reach and the next
SECANTS = 6  # at most, for the end of a step within that interval, to this fraction of the step
SECANT_TOL = 3e-4


@jit
def hermite(begin, end, first, last, u):
    """Return value and derivative, ``u`` from 0 to 1 on the way, of a cubic from its values and slopes at the ends."""
    rise = end - begin
    c = first + last - 2.0 * rise
    b = rise - first - c
    return begin + u * (first + u * (b + u * c)), first + u * (2.0 * b + u * 3.0 * c)


@jit
def cubic(t, f, df, k, at):
    """Return value and derivative at ``at`` of the cubic between samples k and k + 1."""
    h = t[k + 1] - t[k]
    value, rate = hermite(f[k], f[k + 1], h * df[k], h * df[k + 1], (at - t[k]) / h)
    return value, rate / h


@jit
def spline(f, df, position):
    """Return value and derivative of a spline on the knots 0, 1, 2 and so on, from its values and slopes there."""
    k = min(max(int(position), 0), f.size - 2)
    return hermite(f[k], f[k + 1], df[k], df[k + 1], position - k)


@jit
def spline_at(f, df, density, t, value, rate):
    """Fill value and derivative at ``t`` of a spline with ``density`` knots per unit."""
    for i in range(t.size):
        value[i], slope = spline(f, df, t[i] * density)
        rate[i] = slope * density


@jit
def lateral_tolerance(f, df, density, idle, usual, fraction, idle_fraction, t, tolerance):
    """Fill the largest error of the controller's radius that is allowed at ``t``, the radius being a spline."""
    turn, last = TURN * density, f.size - 1
    for i in range(t.size):
        position = t[i] * density
        radius, _ = spline(f, df, position)
        # The lesser of the steps to both neighbouring revolutions, except where a spoke comes to rest.
        step = np.inf
        if position >= turn:
            step = radius - spline(f, df, position - turn)[0]
        if position + turn <= last:
            step = min(step, spline(f, df, position + turn)[0] - radius)
        # Places next to a knot that cuts count as cutting.
        k = min(int(position), idle.size - 2)
        tolerance[i] = fraction * max(step, usual / 2) + idle_fraction * usual * min(idle[k], idle[k + 1])


@jit
def middle_error(before, after, first, last, span, share, at):
    """Return how far a cubic over ``span``, from values and slopes at its ends, passes ``at`` at a share of the way."""
    return abs(hermite(before, after, span * first, span * last, share)[0] - at)


@jit
def sampling_error(path, doubt):
    """Fill, for each interval, the error of cubics over it and a neighbour at the sample between them. (n - 1,)."""
    t, z, dz, x, dx, s, _ = path
    doubt[:] = 0.0
    for k in range(1, t.size - 1):
        i, j = k - 1, k + 1
        span = t[j] - t[i]
        share = (t[k] - t[i]) / span
        error = middle_error(z[i], z[j], dz[i], dz[j], span, share, z[k])
        error += abs(s[k]) * middle_error(x[i], x[j], dx[i], dx[j], span, share, x[k])
        doubt[i], doubt[k] = max(doubt[i], error), error


@jit
def second_derivative(rise, first, last):
    """Return the largest second derivative of a cubic over a unit interval, from its rise and the slopes at its ends.

    It is largest at one of the ends.
    """
    return max(abs(6.0 * rise - 4.0 * first - 2.0 * last), abs(2.0 * first + 4.0 * last - 6.0 * rise))


@jit
def bulge(path, out):
    """Fill the bulge of straight lines: second derivative times the squared interval. (n - 1,)."""
    t, z, dz, x, dx, s, _ = path
    for k in range(out.size):
        h = t[k + 1] - t[k]
        out[k] = second_derivative(z[k + 1] - z[k], h * dz[k], h * dz[k + 1])
        out[k] += abs(s[k]) * second_derivative(x[k + 1] - x[k], h * dx[k], h * dx[k + 1])


@jit
def refine(path, parts, out):
    """Fill ``out`` (7, m) with the samples of a path and those between, ``parts`` (n - 1,) pieces to each interval."""
    t, z, dz, x, dx, s, lateral = path
    m = 0
    for k in range(parts.size):
        h = t[k + 1] - t[k]
        for i in range(parts[k]):
            share = i / parts[k]
            out[0, m + i] = t[k] + share * h
            out[1, m + i], up = hermite(z[k], z[k + 1], h * dz[k], h * dz[k + 1], share)
            out[3, m + i], along = hermite(x[k], x[k + 1], h * dx[k], h * dx[k + 1], share)
            out[2, m + i], out[4, m + i] = up / h, along / h
            out[5, m + i] = s[k] + share * (s[k + 1] - s[k])
            out[6, m + i] = lateral[k] + share * (lateral[k + 1] - lateral[k])
        m += parts[k]
    for row in range(out.shape[0]):
        out[row, m] = path[row, parts.size]


@jit
def fits(path, first, last, a, b, hermite, slack, bend):
    """Return whether the controller's curve between nodes a and b passes samples first to last within ``slack``.

    A node is (t, z, dz, x, dx). Where the controller's radius differs from the sampled one, the exact height differs by
    the slope along the radius times the difference, and by at most ``bend`` times its square.
    """
    t, z, x, s, lateral = path[0], path[1], path[3], path[5], path[6]
    h = b[0] - a[0]
    rise, along = b[1] - a[1], b[3] - a[3]
    p, q, v, w = rise, 0.0, along, 0.0
    if hermite:
        p, v = h * a[2], h * a[4]
        q, w = h * b[2], h * b[4]
    middle = (first + last) // 2
    for n in range(first, last + 1):
        # From the middle on, where the error mostly is, then the first half.
        j = n + middle - first
        if j > last:
            j -= last - first + 1
        u = (t[j] - a[0]) / h
        if hermite:
            c, d = p + q - 2.0 * rise, v + w - 2.0 * along
            up = a[1] + u * (p + u * (rise - p - c + u * c))
            out = a[3] + u * (v + u * (along - v - d + u * d))
        else:
            up, out = a[1] + u * p, a[3] + u * v
        off = out - x[j]
        if not (abs(up - z[j] - s[j] * off) <= slack - bend * off * off and abs(off) <= lateral[j]):
            return False
    return True


@jit
def node(path, k, at):
    """Return the node (t, z, dz, x, dx) at ``at``, between samples k and k + 1."""
    z, dz = cubic(path[0], path[1], path[2], k, at)
    x, dx = cubic(path[0], path[3], path[4], k, at)
    return at, z, dz, x, dx


@jit
def sample(path, j):
    """Return the node (t, z, dz, x, dx) at sample j."""
    return path[0, j], path[1, j], path[2, j], path[3, j], path[4, j]


@jit
def on_path(path, begin, stop, slack, bend, widest, hermite, out):
    """Choose nodes on a path, each the furthest that the controller's curve reaches; return how many.

    The first node stands at ``begin``, after the first sample. Nodes follow until one is at ``stop`` or behind, or the
    samples end before a step does. ``out`` (n + 1,) takes their t.
    """
    t = path[0]
    n = t.size
    k = interval(t, begin)  # the sample at or before the last node
    last = node(path, k, begin)
    out[0] = begin
    count = 1
    while last[0] < stop:
        first = k + 1
        best = first
        new = node(path, k, t[first])
        j = first + 1
        while j < n and j <= k + SEARCH_FACTOR * (best - k) + SEARCH_MARGIN and t[j] - last[0] <= widest:
            tried = node(path, j - 1, t[j])
            if fits(path, first, j - 1, last, tried, hermite, slack, bend):
                best, new = j, tried
            j += 1
        if j == n:
            break
        low, high = t[best], min(t[best + 1], last[0] + widest)
        for _ in range(BISECTIONS):
            at = 0.5 * (low + high)
            if not low < at < high:
                break
            tried = node(path, best, at)
            if fits(path, first, best, last, tried, hermite, slack, bend):
                low, new = at, tried
            else:
                high = at
        k, last = best, new
        out[count] = last[0]
        count += 1
    return count


@jit
def look_ahead(path, first, a, begin, end, ahead):
    """Fill columns ``begin`` to ``end`` of ``ahead`` (6, n) with the samples from ``first`` on as seen from node a.

    The rows are the distance in t, its inverse, height and radius from the node, slope, and allowed radius error.
    """
    for i in range(begin, end):
        h = path[0, first + i] - a[0]
        ahead[0, i], ahead[1, i] = h, 1.0 / h
        ahead[2, i], ahead[3, i] = path[1, first + i] - a[1], path[3, first + i] - a[3]
        ahead[4, i], ahead[5, i] = path[5, first + i], path[6, first + i]


@jit
def cone(ahead, count, a, b, slack, bend):
    """Return the least and the greatest slope of straight lines from node a to node b that pass ``count`` samples.

    See `fits`; b itself must be within ``slack`` of its own height. There is no such line if the least slope is above
    the greatest.
    """
    h, inverse, up, out, s, lateral = ahead
    per = 1.0 / (b[0] - a[0])
    along = (b[3] - a[3]) * per
    low, high = (b[1] - slack - a[1]) * per, (b[1] + slack - a[1]) * per
    within = True
    for i in range(count):
        off = along * h[i] - out[i]
        rise = up[i] + s[i] * off
        room = slack - bend * off * off
        least, most = (rise - room) * inverse[i], (rise + room) * inverse[i]
        low = least if least > low else low
        high = most if most < high else high
        within &= abs(off) <= lateral[i]
    return (low, high) if within else (np.inf, -np.inf)


@jit
def off_path(path, begin, start, stop, slack, bend, widest, out, lift):
    """Choose nodes up to ``slack`` off a path, each the furthest that a straight line reaches; return how many.

    A line from the last node fits while its slope lies in a cone, which only narrows: the furthest node is the last
    for which it is not empty. See `on_path`; the first node is ``start`` above the path, and ``lift`` (n + 1,) receives
    the height of each above the path.
    """
    t = path[0]
    n = t.size
    ahead = np.empty((6, n))
    k = interval(t, begin)
    last = node(path, k, begin)
    last = (last[0], last[1] + start, last[2], last[3], last[4])
    out[0], lift[0] = begin, start
    count = 1
    stride = 1
    while last[0] < stop:
        first = k + 1
        # From about where the last step ended, down to what fits and up to what does not.
        j = min(k + max(stride - 1, 1), n - 1)
        seen = j - first
        look_ahead(path, first, last, 0, seen, ahead)
        new = sample(path, j)
        least, most = cone(ahead, j - first, last, new, slack, bend)
        while j > first and (t[j] - last[0] > widest or least > most):
            j = first + (j - first) * 3 // 4
            new = sample(path, j)
            least, most = cone(ahead, j - first, last, new, slack, bend)
        best = j
        while best + 1 < n:
            passed = best + 1 - first
            look_ahead(path, first, last, min(seen, passed), passed, ahead)
            seen = max(seen, passed)
            tried = sample(path, best + 1)
            low, high = cone(ahead, passed, last, tried, slack, bend)
            if tried[0] - last[0] > widest or low > high:
                break
            best, new, least, most = best + 1, tried, low, high
        if best + 1 == n:
            break
        stride = best - k
        near, far = t[best], tried[0]
        if far - last[0] > widest:
            far = last[0] + widest
            tried = node(path, best, far)
            low, high = cone(ahead, passed, last, tried, slack, bend)
            if low <= high:
                near, new, least, most = far, tried, low, high
        # The width of the cone falls to 0 where the step ends: the secant finds it, or bisection where it has a limit
        # of the radius error.
        width = high - low
        for _ in range(SECANTS):
            share = (most - least) / (most - least - width) if width > -np.inf else 0.5
            at = near + share * (far - near) - SECANT_TOL * (near - last[0])
            if not at > near:
                break
            tried = node(path, best, at)
            low, high = cone(ahead, passed, last, tried, slack, bend)
            if low <= high:
                near, new, least, most = at, tried, low, high
            else:
                far, width = at, high - low
        # Within the cone, the node nearest to the path is chosen.
        h = new[0] - last[0]
        up = last[1] + min(max((new[1] - last[1]) / h, least), most) * h
        k = best
        last = (new[0], up, new[2], new[3], new[4])
        out[count], lift[count] = new[0], up - new[1]
        count += 1
    return count


@jit
def tips_at(first, step, z, rate, row, radius, tip, along):
    """Fill height and slope of the tip at ``radius`` (m,), one on each spoke, from a table of rings.

    Ring k of ``z`` and its derivative ``rate``, each (rings, m), stands at (first + k) · step; ``row`` (m,) says which
    spoke.
    """
    for i in range(radius.size):
        place = radius[i] / step - first
        k = min(max(int(np.floor(place)), 0), z.shape[0] - 2)
        j = row[i]
        tip[i], slope = hermite(z[k, j], z[k + 1, j], step * rate[k, j], step * rate[k + 1, j], place - k)
        along[i] = slope / step


@jit
def tip_slopes(edge, angle, radius, x, y, fx, fy, around, outward):
    """Fill the derivatives of a tip's height by the angle at constant radius, and by the radius, from its contact.

    Without rake the derivative by the radius is the slope of the edge, also on a ridge, where the surface has no slope.
    """
    for i in range(angle.size):
        sine, cosine = sincos(angle[i])
        around[i] = fy[i] * x[i] - fx[i] * y[i]
        if edge.rake_sin == 0.0:
            outward[i] = edge.rake_cos * slope(edge, x[i] * cosine + y[i] * sine - radius[i])
        else:
            outward[i] = fx[i] * cosine + fy[i] * sine


@jit
def under(edge, cosine, sine, radius, at, x, y):
    """Fill the plan position of the edge of a tip at ``radius`` over ``at``, both distances along the rake plane."""
    for i in range(radius.size):
        across = edge.dy + edge.rake_sin * height(edge, at[i] - radius[i])
        x[i] = at[i] * cosine[i] - across * sine[i]
        y[i] = at[i] * sine[i] + across * cosine[i]


@jit
def crest_step(edge, cosine, sine, scallop, radius, tip, f, fx, fy, at, low, high):
    """Take a Newton step towards the place outside the contact where the edge is ``scallop`` above the surface.

    ``at`` is the place, [low, high] its bracket; return the largest step taken.
    """
    most = 0.0
    for i in range(at.size):
        u = at[i] - radius[i]
        steep = slope(edge, u)
        over = tip[i] + edge.dz + edge.rake_cos * height(edge, u) - f[i] - scallop
        rise = (
            edge.rake_cos * steep
            - (fx[i] * cosine[i] + fy[i] * sine[i])
            - edge.rake_sin * steep * (fy[i] * cosine[i] - fx[i] * sine[i])
        )
        if over < 0.0:
            low[i] = max(low[i], at[i])
        else:
            high[i] = min(high[i], at[i])
        new = at[i] - over / rise
        if not low[i] <= new <= high[i]:
            new = 0.5 * (low[i] + high[i])
        most = max(most, abs(new - at[i]))
        at[i] = new
    return most


@jit
def next_step(edge, goal, at, tip, along, radius, low, high):
    """Take a Newton step towards the radius outside from which the edge passes the crest ``goal`` at ``at``.

    As a function of the radius its height there is convex and reaches the goal twice; the outer radius counts.
    """
    most = 0.0
    for i in range(at.size):
        u = at[i] - radius[i]
        over = tip[i] + edge.dz + edge.rake_cos * height(edge, u) - goal[i]
        rise = along[i] - edge.rake_cos * slope(edge, u)
        if over < 0.0 or rise <= 0.0:
            low[i] = max(low[i], radius[i])
        else:
            high[i] = min(high[i], radius[i])
        new = radius[i] - over / rise
        if rise <= 0.0 or not low[i] <= new <= high[i]:
            new = 0.5 * (low[i] + high[i])
        most = max(most, abs(new - radius[i]))
        radius[i] = new
    return most
