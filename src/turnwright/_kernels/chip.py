"""The uncut chip thickness along a motion, in the plane of the rake face's edge through the axis. See cutting/chip.py.

Every *piece* is one earlier pass of the same edge through that plane: its tip (p, z) along the radial line and +1, or
-1 where it stands beyond the axis and is mirrored. Two pieces of a convex edge cross at most once, so the surface
they leave is a lower envelope built with a stack. The chip is the material that the edge removes below that envelope
and below the stock.
"""

import numpy as np

from turnwright._kernels import jit, jit_inline
from turnwright._kernels.edge import height, slope
from turnwright._kernels.generation import TURN, guess_index, locate

FAR = 1e300
EPSILON = 2.3e-16
# Most earlier passes of one motion that are considered, and most pieces of both motions in a plane.
MAX_OWN_PASSES = 64
MAX_PIECES = 2048
# The search stops after this many consecutive turns, each higher than the one after it.
MAX_HIGHER_TURNS = 12
# Cells of a window.
WINDOW_CELLS = 8
# Gauss-Legendre, three nodes.
NODES = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
# Columns of a result.
THICKEST, AREA, DEPTH, LOW, HIGH, WIDTH, FRACTURE, RADIAL, AXIAL, CUTTING, CUT_SHORT = range(11)
ROWS = 11


@jit
def _rise(edge, u):
    """Return the height of the edge in the plane, that of a leaning rake face foreshortened."""
    return edge.rake_cos * height(edge, u)


@jit
def _crossing(edge, p1, z1, m1, p2, z2, m2, low, high):
    """Return where the piece 1 (p1 < p2) stops being the lower one, within [low, high]."""
    if edge.pieces.shape[1] == 0 and edge.rake_cos == 1.0:
        radius = edge.base
        dp, dz = p2 - p1, z2 - z1
        square = dp * dp + dz * dz
        x = 0.5 * (p1 + p2)
        if square < 4.0 * radius * radius:
            x += dz * np.sqrt(radius * radius / square - 0.25)
            if (
                x - p1 > edge.low_u and x - p1 < edge.high_u and x - p2 > edge.low_u and x - p2 < edge.high_u
            ):  # the arc of a perfect nose is symmetric
                return min(max(x, low), high)
    a, b = low, high
    fa = z1 + _rise(edge, m1 * (a - p1)) - z2 - _rise(edge, m2 * (a - p2))
    if fa >= 0.0:
        return a
    fb = z1 + _rise(edge, m1 * (b - p1)) - z2 - _rise(edge, m2 * (b - p2))
    if fb <= 0.0:
        return b
    for _ in range(100):
        x = 0.5 * (a + b)
        f = z1 + _rise(edge, m1 * (x - p1)) - z2 - _rise(edge, m2 * (x - p2))
        if f < 0.0:
            a = x
        else:
            b = x
        if b - a <= EPSILON * (abs(a) + abs(b)):
            break
    return 0.5 * (a + b)


@jit
def _tip(c, x, z, sense, starts, t):
    """Return place and height of the tip at an angle along the motion."""
    t = min(max(t, sense * c[0]), sense * c[c.size - 1])
    i = locate(c, sense, t, guess_index(c, sense, t, starts))
    share = (t - sense * c[i]) / (sense * (c[i + 1] - c[i]))
    return x[i] + share * (x[i + 1] - x[i]), z[i] + share * (z[i + 1] - z[i])


@jit
def _earlier(c, x, z, sense, starts, t, tip, bottom, low, high, reach, edge, p, zs, mirror):
    """Fill in the turns of the same motion before ``t`` that can bound the chip; return how many, and low and high.

    The last turn bounds the chip where both edges cross. A turn before it that is higher there is so all through the
    chip, since two edges cross only once; when so many in a row are, and ever more so, no other is looked at. Turns
    from beyond the axis are all taken.
    """
    begin, count = sense * c[0] - 1e-9, 0
    at = t - TURN
    if at >= begin:
        p[0], zs[0] = _tip(c, x, z, sense, starts, at)
        mirror[0] = 1.0
        count = 1
        side = p[0] - tip
        if side > 0.0:
            high = min(high, _crossing(edge, tip, bottom, 1.0, p[0], zs[0], 1.0, low, max(low, high)))
        elif side < 0.0:
            low = max(low, _crossing(edge, p[0], zs[0], 1.0, tip, bottom, 1.0, min(low, high), high))
        end = high if side > 0.0 else low
        least = zs[0] + _rise(edge, end - p[0])
        above, before = 0, 0.0
        while at - TURN >= begin and count < MAX_OWN_PASSES:
            at -= TURN
            where, rise = _tip(c, x, z, sense, starts, at)
            if abs(where - tip) > reach:
                break
            over = rise + _rise(edge, end - where) - least
            if over < 0.0 or side == 0.0:
                p[count], zs[count], mirror[count] = where, rise, 1.0
                count += 1
                above = 0
            else:
                above = above + 1 if over >= before else 0
                if above == MAX_HIGHER_TURNS:
                    break
            before = over
    if tip - reach > 0.0:
        return count, low, high
    at, near, taken = t - 0.5 * TURN, FAR, 0
    while at >= begin and taken < MAX_OWN_PASSES:
        where, rise = _tip(c, x, z, sense, starts, at)
        at -= TURN
        away = abs(where + tip)
        if away <= reach:
            p[count], zs[count], mirror[count] = -where, rise, -1.0
            count += 1
            taken += 1
        elif away >= near:
            break
        near = away
    return count, low, high


@jit
def _all_of(c, x, z, sense, starts, t, tip, reach, p, zs, mirror):
    """Fill in the turns of another motion, at the azimuth ``t`` from its first turn on, within reach; return how many.

    From turn to turn its tip goes one way, so that those within reach are found by bisection.
    """
    count = 0
    last = sense * c[c.size - 1] + 1e-9
    for side in range(2):
        if side == 1 and tip - reach > 0.0:
            break
        sign = 1.0 - 2.0 * side
        start = t + (0.5 * TURN if side == 1 else 0.0)
        start -= TURN * np.floor((start - sense * c[0] + 1e-9) / TURN)
        turns = int(np.floor((last - start) / TURN)) + 1
        if turns < 1:
            continue
        begin, _ = _tip(c, x, z, sense, starts, start)
        end, _ = _tip(c, x, z, sense, starts, start + TURN * (turns - 1))
        way = sign if end >= begin else -sign  # of the pieces' places, turn by turn
        low, high = 0, turns
        while low < high:
            middle = (low + high) // 2
            where, _ = _tip(c, x, z, sense, starts, start + TURN * middle)
            if way * (sign * where - tip) < -reach:
                low = middle + 1
            else:
                high = middle
        while low < turns and count < p.size:
            where, rise = _tip(c, x, z, sense, starts, start + TURN * low)
            if way * (sign * where - tip) > reach:
                break
            p[count], zs[count], mirror[count] = sign * where, rise, sign
            count += 1
            low += 1
    return count


@jit
def _sort(p, z, mirror, count):
    """Sort pieces by their place; nearly sorted ones cost one look each."""
    for i in range(1, count):
        a, b, m = p[i], z[i], mirror[i]
        j = i - 1
        while j >= 0 and p[j] > a:
            p[j + 1], z[j + 1], mirror[j + 1] = p[j], z[j], mirror[j]
            j -= 1
        p[j + 1], z[j + 1], mirror[j + 1] = a, b, m


@jit
def _envelope(edge, p, z, mirror, count, low, high, which, begin):
    """Fill ``which`` piece is lowest from each ``begin`` on; return how many there are."""
    top = 0
    for b in range(count):
        start = low
        hidden = False
        while top > 0:
            a = which[top - 1]
            if p[b] - p[a] <= EPSILON * (abs(p[a]) + edge.base):
                if z[b] >= z[a]:
                    hidden = True
                    break
                top -= 1
                continue
            start = _crossing(edge, p[a], z[a], mirror[a], p[b], z[b], mirror[b], low, high)
            if start <= begin[top - 1]:
                top -= 1
                start = low
                continue
            break
        if hidden or (top > 0 and start >= high):
            continue
        which[top], begin[top] = b, start if top > 0 else low
        top += 1
    return top


@jit
def _stock(stock, row, first, step, x):
    """Return height and slope of the stock's table at ``x``: cubics that meet in height and slope."""
    cells = stock.shape[2] - 1
    s = (x - first) / step
    k = min(max(int(np.floor(s)), 0), cells - 1)
    s -= k
    a, b = stock[row, 0, k], stock[row, 0, k + 1]
    da, db = step * stock[row, 1, k], step * stock[row, 1, k + 1]
    square, cube = 3.0 * (b - a) - 2.0 * da - db, 2.0 * (a - b) + da + db
    return a + s * (da + s * (square + s * cube)), (da + s * (2.0 * square + s * 3.0 * cube)) / step


@jit_inline
def _foot(edge, u, w):
    """Return thickness, sine and cosine of the normal's angle, and curvature of the edge, below a point (u, w)."""
    if edge.pieces.shape[1] == 0 and edge.rake_cos == 1.0:
        radius = edge.base
        up = radius - w
        r = np.sqrt(u * u + up * up)
        if edge.low_u * r < u * radius and u * radius < edge.high_u * r:
            return radius - r, u / r, up / r, 1.0 / radius
        side = edge.low_u if u < 0.0 else edge.high_u
        sine = side / radius
        cosine = np.sqrt(1.0 - sine * sine)
        return radius - (u * sine + up * cosine), sine, cosine, 0.0
    at = u
    tilt = 1e-5 * edge.base
    d, bend = 0.0, 0.0
    for _ in range(8):
        d = edge.rake_cos * slope(edge, at)
        bend = edge.rake_cos * (slope(edge, at + tilt) - slope(edge, at - tilt)) / (2.0 * tilt)
        above = w - edge.rake_cos * height(edge, at)
        step = ((u - at) + above * d) / (1.0 + d * d - above * bend)
        at += step
        if abs(step) < 1e-13 * edge.base:
            break
    d = edge.rake_cos * slope(edge, at)
    long = np.sqrt(1.0 + d * d)
    above = w - edge.rake_cos * height(edge, at)
    sign = 1.0 if above >= 0.0 else -1.0
    return sign * np.sqrt((u - at) ** 2 + above * above), d / long, 1.0 / long, bend / (long * long * long)


@jit
def _coefficient(curve, first, step, thickness):
    """Return a cutting coefficient, straight over the logarithm of the thickness."""
    if curve.size == 1:
        return curve[0]
    s = (np.log(max(thickness, 1e-12)) - first) / step
    k = min(max(int(np.floor(s)), 0), curve.size - 2)
    s = min(max(s - k, 0.0), 1.0)
    return curve[k] + s * (curve[k + 1] - curve[k])


@jit
def chips(
    c, x, z, sense, starts, points, contact, left, right, edge,
    before_c, before_x, before_z, before_sense, before_starts, stock, stock_first, stock_step, rim,
    critical, safe, plateau, ratio, cutting, thrust, curve_first, curve_step, factor, out,
):  # fmt: skip
    """Fill ``out`` (n, ROWS) with the chip at ``points`` (n,) of a motion.

    ``contact`` (n,) is where the edge touches, ``left`` and ``right`` (n,) how far the window reaches to either side of
    it; ``stock`` (n, 2, m) heights and slopes of the blank on equal steps from ``stock_first`` (n,) on, or empty;
    ``before_*`` the motion of the pass before, or empty; ``critical`` (n,) or empty the thickest ductile chip, ``safe``
    the share of it that is ductile beyond doubt; ``cutting`` and ``thrust`` the coefficients over thickness, or empty,
    and ``factor`` (n, 2) what they are multiplied by.
    """
    p, zs, mirror = np.empty(MAX_PIECES), np.empty(MAX_PIECES), np.empty(MAX_PIECES)
    sp, sz, sm = (
        np.empty(MAX_PIECES - 2 * MAX_OWN_PASSES),
        np.empty(MAX_PIECES - 2 * MAX_OWN_PASSES),
        np.empty(MAX_PIECES - 2 * MAX_OWN_PASSES),
    )
    which, begin = np.empty(MAX_PIECES, dtype=np.int64), np.empty(MAX_PIECES)
    grid = np.empty(MAX_PIECES + 2 * WINDOW_CELLS + 8)
    whose = np.empty(MAX_PIECES + 2 * WINDOW_CELLS + 8, dtype=np.int64)
    for row in range(points.size):
        i = points[row]
        tip, bottom = x[i], z[i]
        centre, reach = contact[row], max(left[row], right[row])
        from_left, from_right = centre - left[row], centre + right[row]
        low, high = max(from_left, -rim), min(from_right, rim)
        for k in range(ROWS):
            out[row, k] = 0.0
        out[row, LOW] = np.nan
        out[row, HIGH] = np.nan
        if not high > low:
            continue
        far = 2.5 * reach + abs(centre - tip)
        # The stock: what the pass before left.
        stocked = 0
        if before_c.size > 0:
            stocked = _all_of(
                before_c, before_x, before_z, before_sense, before_starts, before_sense * c[i], tip,
                2.5 * reach + abs(centre - tip), sp, sz, sm,
            )  # fmt: skip
        # How high the stock stands over the contact.
        u = min(max(centre, -rim), rim)
        top = FAR
        if stock.shape[0] > 0:
            top, _ = _stock(stock, row, stock_first[row], stock_step[row], u)
        for k in range(stocked):
            top = min(top, sz[k] + _rise(edge, sm[k] * (u - sp[k])))
        if top < FAR:
            out[row, DEPTH] = max(top - bottom - _rise(edge, u - tip), 0.0)
        # What this pass itself has left so far.
        count, low, high = _earlier(
            c, x, z, sense, starts, sense * c[i], tip, bottom, low, high, far, edge, p, zs, mirror
        )
        advance = abs(p[0] - tip) if count > 0 else FAR
        if not high > low:
            continue
        for k in range(stocked):
            p[count], zs[count], mirror[count] = sp[k], sz[k], sm[k]
            count += 1
        _sort(p, zs, mirror, count)
        layers = _envelope(edge, p, zs, mirror, count, low, high, which, begin)
        # Forces bend where a plateau begins, if the chip comes near it: finer cells.
        limit = critical[row] if critical.size > 0 else FAR
        cells = 2 * WINDOW_CELLS if plateau.size > 0 and 1.5 * advance * reach > limit * edge.base else WINDOW_CELLS
        # Elementary intervals: equal cells, and where another pass begins to be lowest.
        size, layer = 0, 0
        for k in range(cells + 1):
            place = low + (high - low) * k / cells if k < cells else high
            while layer + 1 < layers and begin[layer + 1] <= place:
                layer += 1
                if size == 0 or begin[layer] > grid[size - 1]:
                    grid[size], whose[size] = begin[layer], which[layer]
                    size += 1
                else:
                    whose[size - 1] = which[layer]
            if size == 0 or place > grid[size - 1]:
                grid[size], whose[size] = place, which[layer] if layers > 0 else -1
                size += 1
        nearest_low, lowest, done = np.nan, FAR, np.nan
        last_sine, last_cosine = 0.0, 1.0
        for k in range(size - 1):
            a, b = grid[k], grid[k + 1]
            piece = whose[k]
            # Which of pass and blank is the lower one at both ends, and where they change places.
            turn_at = b
            from_stock, then_stock = False, False
            if stock.shape[0] > 0:
                if piece < 0:
                    from_stock = then_stock = True
                else:
                    sa, _ = _stock(stock, row, stock_first[row], stock_step[row], a)
                    sb, _ = _stock(stock, row, stock_first[row], stock_step[row], b)
                    ga = sa - zs[piece] - _rise(edge, mirror[piece] * (a - p[piece]))
                    gb = sb - zs[piece] - _rise(edge, mirror[piece] * (b - p[piece]))
                    from_stock, then_stock = ga < 0.0, gb < 0.0
                    if from_stock != then_stock:
                        one, other = a, b
                        for _ in range(60):
                            turn_at = 0.5 * (one + other)
                            s, _ = _stock(stock, row, stock_first[row], stock_step[row], turn_at)
                            g = s - zs[piece] - _rise(
                                edge, mirror[piece] * (turn_at - p[piece])
                            )  # fmt: skip
                            if (g < 0.0) == from_stock:
                                one = turn_at
                            else:
                                other = turn_at
                            if other - one <= EPSILON * (abs(one) + abs(other)):
                                break
            elif piece < 0:
                continue
            for half_of in range(2):
                first, last = (a, turn_at) if half_of == 0 else (turn_at, b)
                blank = from_stock if half_of == 0 else then_stock
                if not last > first:
                    continue
                # Where the edge is below.
                if blank:
                    sa, _ = _stock(stock, row, stock_first[row], stock_step[row], first)
                    sb, _ = _stock(stock, row, stock_first[row], stock_step[row], last)
                else:
                    sa = zs[piece] + _rise(edge, mirror[piece] * (first - p[piece]))
                    sb = zs[piece] + _rise(edge, mirror[piece] * (last - p[piece]))
                ga = sa - bottom - _rise(edge, first - tip)
                gb = sb - bottom - _rise(edge, last - tip)
                if ga <= 0.0 and gb <= 0.0:
                    continue
                if (ga < 0.0) != (gb < 0.0):
                    one, other = first, last
                    for _ in range(60):
                        middle = 0.5 * (one + other)
                        if blank:
                            s, _ = _stock(stock, row, stock_first[row], stock_step[row], middle)
                        else:
                            s = zs[piece] + _rise(edge, mirror[piece] * (middle - p[piece]))
                        if (s - bottom - _rise(edge, middle - tip) < 0.0) == (ga < 0.0):
                            one = middle
                        else:
                            other = middle
                        if other - one <= EPSILON * (abs(one) + abs(other)):
                            break
                    if ga < 0.0:
                        first = 0.5 * (one + other)
                    else:
                        last = 0.5 * (one + other)
                # An end that the interval before has looked at already is left out.
                for node in range(1 if first == done else 0, 5):
                    # The two ends, for the thickest place and the engaged arc; three nodes for the integrals.
                    weight = 0.0
                    if node == 0:
                        position = first
                    elif node == 4:
                        position = last
                    else:
                        position = first + NODES[node - 1] * (last - first)
                        weight = WEIGHTS[node - 1] * (last - first)
                    if blank:
                        s, rise = _stock(stock, row, stock_first[row], stock_step[row], position)
                    else:
                        away = mirror[piece] * (position - p[piece])
                        s = zs[piece] + _rise(edge, away)
                        rise = mirror[piece] * edge.rake_cos * slope(edge, away)
                    below = bottom + _rise(edge, position - tip)
                    thick, sine, cosine, bend = _foot(edge, position - tip, s - bottom)
                    out[row, THICKEST] = max(out[row, THICKEST], thick)
                    if node == 0 and np.isnan(nearest_low):
                        nearest_low = np.arctan2(sine, cosine)
                    last_sine, last_cosine = sine, cosine
                    if thick > safe * limit:
                        # How high the edge stands there above the tangent at the contact.
                        cu = centre - tip
                        lean = edge.rake_cos * slope(edge, cu)
                        fu, fw = position - tip + thick * sine, s - bottom - thick * cosine
                        over = fw - _rise(edge, cu) - lean * (fu - cu)
                        lowest = min(lowest, over / np.sqrt(1.0 + lean * lean))
                    if weight == 0.0:
                        continue
                    out[row, AREA] += weight * (s - below)
                    run = weight * (cosine + sine * rise) / (1.0 - thick * bend)
                    out[row, WIDTH] += run
                    if cutting.size > 0:
                        thin, cut_share, thrust_share = thick, 1.0, 1.0
                        if plateau.size > 0 and thick > limit:
                            thin = limit
                            cut_share, thrust_share = plateau[0] * limit / thick, plateau[1] * limit / thick
                        taken = run * thick * (1.0 - 0.5 * thick * bend)
                        normal = factor[row, 1] * _coefficient(thrust, curve_first, curve_step, thin) * taken
                        normal *= thrust_share
                        out[row, RADIAL] -= normal * sine
                        out[row, AXIAL] += normal * cosine
                        out[row, CUTTING] += (
                            cut_share * factor[row, 0] * _coefficient(cutting, curve_first, curve_step, thin) * taken
                        )  # fmt: skip
                # A chip at the window's end goes on beyond it.
                done = last
                if first <= from_left or last >= from_right:
                    out[row, CUT_SHORT] = 1.0
        if lowest < FAR:
            out[row, FRACTURE] = max(ratio * out[row, THICKEST] - lowest, 0.0)
        if not np.isnan(nearest_low):
            out[row, LOW] = nearest_low
            out[row, HIGH] = np.arctan2(last_sine, last_cosine)
