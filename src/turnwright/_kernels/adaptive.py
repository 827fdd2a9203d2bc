"""Feed as large as the scallop allows, and points as far apart as the chord allows. See strategy/adaptive.py.

A path is sampled as arrays over the angle turned t: height z, real radius x, their derivatives dz and dx by t, the
slope s of the height along the radius, and the allowed error ``lateral`` of the radius. Between two samples it is a
cubic. Each array is (n,), and ``path`` (7, n) holds t, z, dz, x, dx, s and lateral.
"""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.edge import height, slope

SEARCH_FACTOR = 2  # points are tried up to this many times the furthest step so far, plus some samples
SEARCH_MARGIN = 8
BISECTIONS = 6  # of the interval between the last sample that a step may reach and the next


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
def spline_at(f, df, position, value, rate):
    """Fill value and derivative of a spline on the knots 0, 1, 2 and so on, from its values and slopes there."""
    last = f.size - 2
    for i in range(position.size):
        k = min(max(int(position[i]), 0), last)
        value[i], rate[i] = hermite(f[k], f[k + 1], df[k], df[k + 1], position[i] - k)


@jit
def refine(path, parts, out):
    """Fill ``out`` (7, m) with the samples of a path and those between, ``parts`` (n - 1,) pieces to each interval."""
    t, z, dz, x, dx, s, lateral = path
    m = 0
    for k in range(parts.size):
        for i in range(parts[k]):
            share = i / parts[k]
            at = t[k] + share * (t[k + 1] - t[k])
            out[0, m] = at
            out[1, m], out[2, m] = cubic(t, z, dz, k, at)
            out[3, m], out[4, m] = cubic(t, x, dx, k, at)
            out[5, m] = s[k] + share * (s[k + 1] - s[k])
            out[6, m] = lateral[k] + share * (lateral[k + 1] - lateral[k])
            m += 1
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
def on_path(path, begin, stop, slack, bend, widest, hermite, out):
    """Choose nodes on a path, each the furthest that the controller's curve reaches; return how many.

    The first node stands at ``begin``, within the first interval. Nodes follow
    until one is at ``stop`` or behind, or the samples end before a step does. ``out`` (n + 1,) takes their t.
    """
    t = path[0]
    n = t.size
    k = 0  # the sample at or before the last node
    last = node(path, 0, begin)
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
def cone(path, first, last, a, b, slack, bend, bounds):
    """Narrow ``bounds`` to the slopes of straight lines from node a that pass all samples before b; return if any.

    See `fits`; b itself must be within ``slack`` of its own height.
    """
    t, z, x, s, lateral = path[0], path[1], path[3], path[5], path[6]
    along = (b[3] - a[3]) / (b[0] - a[0])
    h = 1.0 / (b[0] - a[0])
    low, high = (b[1] - slack - a[1]) * h, (b[1] + slack - a[1]) * h
    for n in range(last - first + 1):
        j = last - n
        h = t[j] - a[0]
        off = a[3] + along * h - x[j]
        if abs(off) > lateral[j]:
            return False
        rise = z[j] + s[j] * off - a[1]
        room = slack - bend * off * off
        low, high = max(low, (rise - room) / h), min(high, (rise + room) / h)
        if low > high:
            return False
    bounds[0], bounds[1] = low, high
    return True


@jit
def off_path(path, begin, start, stop, slack, bend, widest, out, lift):
    """Choose nodes up to ``slack`` off a path, each the furthest that a straight line reaches; return how many.

    A line from the last node fits while its slope lies in a cone, which only narrows: the furthest node is the last
    for which it is not empty. See `on_path`; the first node is ``start`` above the path, and ``lift`` (n + 1,) receives
    the height of each above the path.
    """
    t = path[0]
    n = t.size
    bounds = np.empty(2)
    k = 0
    last = node(path, 0, begin)
    last = (last[0], last[1] + start, last[2], last[3], last[4])
    out[0], lift[0] = begin, start
    count = 1
    stride = 1
    while last[0] < stop:
        first = k + 1
        # From about where the last step ended, down to what fits and up to what does not.
        j = min(k + max(stride - 2, 1), n - 1)
        while j > first and (
            t[j] - last[0] > widest or not cone(path, first, j - 1, last, node(path, j - 1, t[j]), slack, bend, bounds)
        ):
            j = first + (j - first) * 3 // 4
        best = max(j, first)
        j = best + 1
        while (
            j < n
            and t[j] - last[0] <= widest
            and cone(path, first, j - 1, last, node(path, j - 1, t[j]), slack, bend, bounds)
        ):
            best = j
            j += 1
        if j >= n:
            break
        stride = best - k
        new = node(path, best - 1, t[best])
        cone(path, first, best - 1, last, new, slack, bend, bounds)
        low, high = t[best], min(t[best + 1], last[0] + widest)
        for _ in range(BISECTIONS):
            at = 0.5 * (low + high)
            if not low < at < high:
                break
            tried = node(path, best, at)
            if cone(path, first, best, last, tried, slack, bend, bounds):
                low, new = at, tried
            else:
                high = at
        # Within the cone, the node nearest to the path is chosen.
        h = new[0] - last[0]
        way = min(max((new[1] - last[1]) / h, bounds[0]), bounds[1])
        up = last[1] + way * h
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
