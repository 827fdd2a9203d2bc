"""The surface a motion leaves: the lowest of all passes of the edge.

A *pass* is one crossing of an azimuth by the tool. On the line through the axis at azimuth a, passes come from both
sides: from azimuth a the tip stands at +X, from azimuth a + pi at -X with the edge mirrored. Angles here are *along*
the motion: multiplied by its sense, so that they always grow.

For a convex edge two passes cross at most once, so the lowest of all of them along a line is a lower envelope built
with a stack in linear time. For everything else (points off a common line, an edge out of the radial plane, an edge
that is not convex) small tiles of neighbouring points share one list of passes that can be lowest anywhere in the tile.

``y`` is None where the whole edge moves in the plane through the axis; all else is then not even compiled.
"""

import numpy as np

from turnwright._kernels import jit, jit_inline
from turnwright._kernels.edge import height, slope
from turnwright._kernels.ordered import interval, span
from turnwright._kernels.trig import sincos, small_arctan

TURN = 2.0 * np.pi
FAR = 1e300
# Angles this close to an end of the motion count as the end: spindle angles of thousands of turns round at 4e-12 rad.
ROUNDING = 1e-9
EPSILON = 2.3e-16
# Lines of a motion, from point to point, that share bounds; blocks that share bounds, and as many of these again.
BLOCK = 8
RUN = 16
# Turns of a motion that share bounds.
HEAP = 32
# Most kinks of a pass within a tile whose points are computed in one loop for each of them.
MAX_KINKS = 12
# Most lines of a motion that are listed for the points of a group.
MAX_LINES = 400


@jit
def turn_starts(c, sense, starts):
    """Fill ``starts`` (turns + 1,) with the first index at or after each whole turn from the beginning."""
    low = 0
    for m in range(starts.size):
        goal = sense * c[0] + TURN * m
        high = c.size - 1
        while low < high:
            middle = (low + high) // 2
            if sense * c[middle] < goal:
                low = middle + 1
            else:
                high = middle
        starts[m] = low


@jit
def turn_bounds(c, x, y, z, sense, starts, dx, begin, end, out):
    """Fill ``out`` (7, turns) with bounds over each turn, from one turn to before another.

    Least and greatest tip position, least and greatest height, most that the tip, its height and Y move per radian.
    """
    n = x.size
    for m in range(begin, end):
        first, last = max(starts[m] - 1, 0), min(starts[m + 1] + 1, n)
        low, high, bottom, top = FAR, -FAR, FAR, -FAR
        for i in range(first, last):
            low, high = min(low, x[i]), max(high, x[i])
            bottom, top = min(bottom, z[i]), max(top, z[i])
        out[0, m], out[1, m], out[2, m], out[3, m] = low + dx, high + dx, bottom, top
        out[4:, m] = 0.0
        for i in range(first, last - 1):
            step = sense * (c[i + 1] - c[i])
            out[4, m] = max(out[4, m], abs(x[i + 1] - x[i]) / step)
            out[5, m] = max(out[5, m], abs(z[i + 1] - z[i]) / step)
            if y.size > 0:
                out[6, m] = max(out[6, m], abs(y[i + 1] - y[i]) / step)


@jit
def locate(c, sense, t, guess):
    """Return i with c[i] <= t < c[i + 1] along the motion, whatever the guess; ``t`` lies within it."""
    i = min(max(guess, 0), c.size - 2)
    while i > 0 and sense * c[i] > t:
        i -= 1
    while i < c.size - 2 and sense * c[i + 1] <= t:
        i += 1
    return i


@jit
def guess_index(c, sense, t, starts):
    """Return a starting index for `locate`: as if the points of a turn were evenly spaced."""
    along = (t - sense * c[0]) / TURN
    m = min(max(int(along), 0), starts.size - 2)
    share = min(max(along - m, 0.0), 1.0)
    return starts[m] + int(share * (starts[m + 1] - starts[m]))


@jit
def useful_turns(bounds, mirrored, low, high, edge, keep):
    """Mark the turns that can be lowest somewhere in [low, high] of a radial line; for a convex edge.

    A turn further out than some pass P that lies above P at the outer end lies above it all the way in, and likewise
    inward. P is taken from the turn nearest each end; bounds over the whole turn serve every azimuth at once.
    """
    turns = bounds.shape[1]
    for end in range(2):
        r = high if end == 0 else low
        best, ceiling = -1, FAR
        for m in range(turns - 1):  # the last may be a part of a turn, which not every azimuth has
            reach = max(abs(r - bounds[0, m]), abs(r - bounds[1, m]))
            if reach < edge.high_u and reach < -edge.low_u:
                top = bounds[3, m] + max(height(edge, reach), height(edge, -reach))
                if top < ceiling:
                    best, ceiling = m, top
        for m in range(turns):
            if end == 0:
                keep[m] = True
            if best < 0 or not keep[m]:
                continue
            first = -bounds[1, m] if mirrored else bounds[0, m]
            last = -bounds[0, m] if mirrored else bounds[1, m]
            if end == 0 and first >= bounds[1, best] and first > r:
                distance = r - first
            elif end == 1 and last <= bounds[0, best] and last < r:
                distance = r - last
            else:
                continue
            if bounds[2, m] + height(edge, -distance if mirrored else distance) > ceiling:
                keep[m] = False


@jit
def crossing(p1, z1, p2, z2, low, high, mirrored, edge):
    """Return where pass 2 (further in, p2 < p1) stops and pass 1 begins to be lowest, within [low, high]."""
    radius = edge.base
    dp, dz = p1 - p2, z1 - z2
    square = dp * dp + dz * dz
    x = 0.5 * (p1 + p2)
    if square < 4.0 * radius * radius:
        x += dz * np.sqrt(radius * radius / square - 0.25)
        inside = (
            x - p1 > edge.low_u and x - p1 < edge.high_u and x - p2 > edge.low_u and x - p2 < edge.high_u
        )  # of a symmetric arc when there is no table
        if inside and edge.pieces.shape[1] == 0:
            return min(max(x, low), high)
    # Anything else: the difference falls monotonically with x for a convex edge; safeguarded Newton on it.
    s = -1.0 if mirrored else 1.0
    a, b = low, high
    if z1 + height(edge, s * (a - p1)) <= z2 + height(edge, s * (a - p2)):
        return a
    if z1 + height(edge, s * (b - p1)) >= z2 + height(edge, s * (b - p2)):
        return b
    if not a < x < b:
        x = 0.5 * (a + b)
    for _ in range(80):
        difference = dz + height(edge, s * (x - p1)) - height(edge, s * (x - p2))
        if difference > 0.0:
            a = x
        else:
            b = x
        rate = s * (slope(edge, s * (x - p1)) - slope(edge, s * (x - p2)))
        following = x - difference / rate if rate < 0.0 else 0.5 * (a + b)
        if not a < following < b:
            following = 0.5 * (a + b)
        # A Newton step so short is the last by far; a shorter one would be rounding.
        if abs(following - x) < 2e-13 * radius + 4.0 * EPSILON * (abs(low) + abs(high)):
            break
        x = following
    return x


@jit
def heights(winner, plain, mirrored, first, edge, radius, out):
    """Set (with ``first``) or lower ``out`` to the pass that ``winner`` (2, n) names by position and level."""
    base = edge.base
    square = base * base
    if plain and first:
        for k in range(radius.size):
            u = radius[k] - winner[0, k]
            out[k] = (winner[1, k] + base) - np.sqrt(square - u * u)
        return
    side = -1.0 if mirrored else 1.0
    for k in range(radius.size):
        h = winner[1, k] + height(edge, side * (radius[k] - winner[0, k]))
        out[k] = h if first else min(out[k], h)


@jit
def stacked(position, level, count, mirrored, edge, low, high, stack, limit):
    """Fill ``stack`` with the passes that are lowest somewhere, from outside in, and ``limit`` with where each begins.

    Return how many they are. On a turned part nearly every pass is lowest somewhere: if the crossings of neighbours are
    in order that proves it, and they come from one loop that vectorises.
    """
    radius = edge.base
    ordered = edge.pieces.shape[1] == 0
    if ordered:
        for i in range(1, count):
            dp, dz = position[i - 1] - position[i], level[i - 1] - level[i]
            quotient = radius * radius / (dp * dp + dz * dz) - 0.25
            limit[i] = 0.5 * (position[i - 1] + position[i]) + dz * np.sqrt(quotient)
        reach = edge.high_u
        for i in range(1, count):
            # Also false for nan: equal passes, or so far apart that the circles do not meet.
            ordered = ordered and abs(limit[i] - position[i - 1]) < reach and abs(limit[i] - position[i]) < reach
        for i in range(2, count):
            ordered = ordered and limit[i] < limit[i - 1]
    if ordered:
        begin = 0
        while begin + 1 < count and limit[begin + 1] >= high:
            begin += 1
        depth = 0
        for i in range(begin, count):
            if depth > 0 and limit[i] <= low:
                break
            stack[depth], limit[depth] = i, limit[i]
            depth += 1
        return depth
    if low == high:  # one sample: crossings on either side of it cannot be distinguished
        lowest, least, side = -1, FAR, -1.0 if mirrored else 1.0
        for i in range(count):
            z = level[i] + height(edge, side * (low - position[i]))
            if z < least:
                lowest, least = i, z
        if lowest < 0:
            return 0
        stack[0], limit[0] = lowest, high
        return 1
    depth = 0
    for i in range(count):
        dropped = False
        bound = high
        while depth > 0:
            top = stack[depth - 1]
            if position[top] == position[i]:
                x = high if level[i] < level[top] else low
            else:
                x = crossing(position[top], level[top], position[i], level[i], low, high, mirrored, edge)
            if x >= limit[depth - 1] and x > low:
                depth -= 1
                continue
            dropped = x <= low
            bound = x
            break
        if not dropped:
            stack[depth] = i
            limit[depth] = high if depth == 0 else bound
            depth += 1
    return depth


@jit
def envelope(position, level, count, mirrored, first, edge, radius, out, stack, limit, winner):
    """Lower ``out`` (n_radius,) to the lowest of ``count`` passes; with ``first`` set it instead of lowering it."""
    low, high = radius[0], radius[radius.size - 1]
    if count > 1 and position[0] < position[count - 1]:
        for i in range(count // 2):
            j = count - 1 - i
            position[i], position[j] = position[j], position[i]
            level[i], level[j] = level[j], level[i]
    # From outside in; a spiral's passes are nearly in order, so insertion sorts them in linear time.
    for i in range(1, count):
        p, z = position[i], level[i]
        j = i - 1
        while j >= 0 and position[j] < p:
            position[j + 1], level[j + 1] = position[j], level[j]
            j -= 1
        position[j + 1], level[j + 1] = p, z
    depth = stacked(position, level, count, mirrored, edge, low, high, stack, limit)
    # Who is lowest at each sample, then all heights in one loop that vectorises however short the intervals are.
    # From inside out, eight samples at a time: what is written too far the next pass overwrites.
    plain = edge.pieces.shape[1] == 0  # nothing but arcs of one circle
    per_sample = (radius.size - 1) / (high - low) if high > low else 0.0
    i = 0
    for d in range(depth - 1, -1, -1):
        p, z = position[stack[d]], level[stack[d]]
        j = radius.size
        if d > 0:
            # Guess the last sample as if they were evenly spaced, then correct.
            up = limit[d]
            j = min(int((up - low) * per_sample), radius.size)
            while j > 0 and radius[j - 1] > up:
                j -= 1
            while j < radius.size and radius[j] <= up:
                j += 1
        if i < j:
            for k in range(i, j, 8):
                for q in range(8):
                    winner[0, k + q] = p
                for q in range(8):
                    winner[1, k + q] = z
            plain = plain and radius[i] - p >= edge.low_u and radius[j - 1] - p <= edge.high_u
            i = j
    if depth > 0:
        heights(winner, plain, mirrored, first, edge, radius, out)
    if first and depth == 0:
        for k in range(radius.size):
            out[k] = FAR


@jit
def polar_block(c, x, z, sense, starts, bounds, edge, radius, angle, out):
    """Fill ``out`` (n_angle, n_radius): the surface along neighbouring azimuths ``angle``; convex, upright edge."""
    turns = starts.size - 1
    rows = angle.size
    keep = np.empty((2, turns), np.bool_)
    for side in range(2):
        low, high = radius[0], radius[radius.size - 1]
        useful_turns(bounds, side == 1, low, high, edge, keep[side])
    begin, end = sense * c[0], sense * c[c.size - 1]
    symmetric = edge.pieces.shape[1] == 0
    position = np.empty((rows, 2 * turns + 2))
    level = np.empty((rows, 2 * turns + 2))
    count = np.zeros(rows, np.int64)
    split = np.zeros(rows, np.int64)
    stack = np.empty(2 * turns + 2, np.int64)
    limit = np.empty(2 * turns + 2)
    winner = np.empty((2, radius.size + 8))
    start = np.empty(rows)
    for side in range(2):
        for row in range(rows):
            along = sense * angle[row] + (np.pi if side == 1 else 0.0)
            start[row] = along + TURN * np.ceil((begin - along - ROUNDING) / TURN)
        # Whole turns that end on the azimuth they began on pass it once more than there are turns.
        for m in range(turns + 1):
            if not keep[side, min(m, turns - 1)]:
                continue
            hint = -1
            for row in range(rows):
                t = start[row] + TURN * m
                if t > end + ROUNDING:
                    continue
                t = min(max(t, begin), end)
                i = locate(c, sense, t, guess_index(c, sense, t, starts) if hint < 0 else hint)
                hint = i
                ci = sense * c[i]
                share = (t - ci) / (sense * c[i + 1] - ci)
                p = x[i] + share * (x[i + 1] - x[i]) + edge.dx
                k = count[row]
                position[row, k] = p if side == 0 else -p
                level[row, k] = z[i] + share * (z[i + 1] - z[i]) + edge.dz
                count[row] = k + 1
        if side == 0:
            for row in range(rows):
                split[row] = count[row]
    for row in range(rows):
        # A symmetric edge is the same from both sides, so that all passes make one envelope.
        ends = (0, count[row], count[row]) if symmetric else (0, split[row], count[row])
        for side in range(2):
            n = ends[side + 1] - ends[side]
            if side == 0 or n > 0:
                some = slice(ends[side], ends[side + 1])
                envelope(
                    position[row, some], level[row, some], n, side == 1, side == 0, edge, radius, out[row],
                    stack, limit, winner,
                )  # fmt: skip
        if out[row, 0] == FAR:  # no pass at all: the motion is shorter than a turn
            out[row] = np.nan


@jit_inline
def stand(c, x, y, z, sense, edge, at, along, hint):
    """Place the tool at ``at``, where a point lies ``along`` from the axis within its plane.

    Return (height of the edge over the point, lateral distance of the edge from the plane, place on the edge, index).
    The tool passes over the point where the point has the same lateral distance.
    """
    i = locate(c, sense, at, hint)
    ci = sense * c[i]
    share = (at - ci) / (sense * c[i + 1] - ci)
    u = along - (x[i] + share * (x[i + 1] - x[i]) + edge.dx)
    w = height(edge, u)
    across = edge.dy + edge.rake_sin * w
    if y.size > 0:
        across += y[i] + share * (y[i + 1] - y[i])
    return z[i] + share * (z[i + 1] - z[i]) + edge.dz + edge.rake_cos * w, across, u, i


@jit_inline
def pass_at(c, x, y, z, sense, edge, t, r, side, hint):
    """Return (height, index, u, at, lateral) of a pass over a point at distance ``r``, azimuth ``t`` along the motion.

    An edge out of the radial plane by v passes over the point not at ``t`` but where the lateral distance of the point
    is v: r sin(azimuth of the point - azimuth of the tool) = v(u). This is solved by a fixed-point iteration, which
    contracts to half or less outside the core (see `useful_lateral`): when the steps no longer shrink, they are
    rounding. The height is FAR where the tool does not pass over the point, or where the pass cannot be the lowest.
    """
    begin, end = sense * c[0], sense * c[c.size - 1]
    sign = 1.0 if side == 0 else -1.0
    if y is None:
        if t < begin - ROUNDING or t > end + ROUNDING:
            return FAR, hint, 0.0, t, 0.0
        # As `stand`, without lateral distances: faster by a third.
        at = min(max(t, begin), end)
        i = locate(c, sense, at, hint)
        ci = sense * c[i]
        share = (at - ci) / (sense * c[i + 1] - ci)
        u = sign * r - (x[i] + share * (x[i + 1] - x[i]) + edge.dx)
        return z[i] + share * (z[i + 1] - z[i]) + edge.dz + height(edge, u), i, u, at, 0.0
    lateral, i, before = 0.0, hint, FAR
    while abs(lateral) <= r:
        at = t - sign * sense * np.arcsin(lateral / r)
        held = min(max(at, begin), end)
        along = sign * np.sqrt(r * r - lateral * lateral)
        h, across, u, i = stand(c, x, y, z, sense, edge, held, along, i)
        step = abs(across - lateral)
        if step == 0.0 or step > 0.75 * before:
            # The spindle angle has a rounding error in proportion to its size; the lateral error is at most half of it.
            rounding = 8.0 * EPSILON * (r * (1.0 + abs(t)) + abs(across) + abs(along) + abs(u) + edge.base)
            reached = step <= rounding and abs(at - held) <= ROUNDING
            return (h if reached else FAR), i, u, held, across
        lateral, before = across, step
    return FAR, i, 0.0, t, 0.0


@jit_inline
def block_ends(lines):
    """Return where the bounds of blocks end, of runs of blocks, and of runs of these, for a number of lines."""
    blocks = (lines + BLOCK - 1) // BLOCK
    runs = (blocks + RUN - 1) // RUN
    return blocks, blocks + runs, blocks + runs + (runs + RUN - 1) // RUN


@jit
def block_bounds(c, x, y, z, sense, dx, out):
    """Fill ``out`` (rows, 8) with bounds of the lines of each block, run, and run of runs, see `block_ends`.

    They are the least and the greatest tip position and Y, the least height, and where the lines begin and end along
    the motion.
    """
    lines = c.size - 1
    blocks, runs, ends = block_ends(lines)
    for k in range(blocks):
        low, high, back, front, bottom = FAR, -FAR, 0.0, 0.0, FAR
        first, last = BLOCK * k, min(BLOCK * (k + 1), lines)
        for i in range(first, last + 1):
            low, high, bottom = min(low, x[i]), max(high, x[i]), min(bottom, z[i])
            if y.size > 0:
                back, front = y[i] if i == first else min(back, y[i]), y[i] if i == first else max(front, y[i])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = low + dx, high + dx, back, front, bottom
        out[k, 5], out[k, 6] = sense * c[first], sense * c[last]
    for k in range(blocks, ends):
        begin, end = (0, blocks) if k < runs else (blocks, runs)
        first = begin + RUN * (k - end)
        last = min(first + RUN, end)
        for column in (0, 2, 4, 5):
            out[k, column] = out[first:last, column].min()
        for column in (1, 3, 6):
            out[k, column] = out[first:last, column].max()


@jit_inline
def least_between(edge, gap, low, high):
    """Return a lower bound of the edge height between the places ``low`` and ``high`` from its tip."""
    return height(edge, low if low > 0.0 else min(high, 0.0)) - gap


@jit_inline
def over(line, edge, sense, r, phase, s):
    """Place the tool at ``s`` along one line of its motion, see `lowest_on_line`.

    Return (height of the edge over the point, lateral distance of the point from the edge, place on the edge, sine and
    cosine of the angle from the point to the tool).
    """
    sine, cosine = sincos(phase + s)
    u = r * cosine - (line[0] + line[3] * s + edge.dx)
    w = height(edge, u)
    lateral = -sense * r * sine - (line[1] + line[4] * s) - edge.dy - edge.rake_sin * w
    return line[2] + line[5] * s + edge.dz + edge.rake_cos * w, lateral, u, sine, cosine


@jit_inline
def lowest_on_line(line, edge, bend, sense, r, phase, first, last, pieces, lowest):
    """Return ``lowest``, or less if the edge passes lower over a point while the tool is on one line of its motion.

    ``line`` holds X, Y, Z where it begins and how much they change per radian, ``phase`` the angle there from the point
    to the tool, ``first`` and ``last`` the range along it. Within a piece of it, F is the lateral distance of the point
    from the edge. Pieces that bounds of F and of the height exclude are dropped; one in which F is monotonic holds at
    most one root; others are halved. ``pieces`` (64, 2) is scratch.
    """
    size = r + abs(line[0]) + abs(line[1]) + abs(edge.dx) + abs(edge.dy) + edge.base
    tiny = 4.0 * EPSILON * (size + (abs(line[3]) + abs(line[4])) * max(abs(first), abs(last)))
    pieces[0, 0], pieces[0, 1] = first, last
    depth = 1
    while depth > 0:
        depth -= 1
        a, b = pieces[depth, 0], pieces[depth, 1]
        s, half = 0.5 * (a + b), 0.5 * (b - a)
        h, lateral, u, sine, cosine = over(line, edge, sense, r, phase, s)
        # The edge goes over the point at ``pace``, and F changes at ``rate``, give or take what Taylor's theorem says.
        rate, doubt = -sense * r * cosine - line[4], r * half * (abs(sine) + 0.5 * half)
        if edge.rake_sin == 0.0 and abs(lateral) > (abs(rate) + doubt) * half + tiny:
            continue
        pace, loose = -r * sine - line[3], r * half * (abs(cosine) + 0.5 * half)
        du = (abs(pace) + loose) * half
        flat, steep = slope(edge, u - du) - bend, slope(edge, u + du) + bend
        if h - abs(line[5]) * half - edge.rake_cos * max(abs(flat), abs(steep)) * du > lowest - tiny:
            continue
        if abs(lateral) <= tiny:
            lowest = min(lowest, h)
        if edge.rake_sin != 0.0:
            rate -= edge.rake_sin * 0.5 * (flat + steep) * pace
            doubt += abs(edge.rake_sin) * (0.5 * (steep - flat) * (abs(pace) + loose) + 0.5 * abs(flat + steep) * loose)
            if abs(lateral) > (abs(rate) + doubt) * half + tiny:
                continue
        # Two roots within a microradian, that no change of sign betrays: 1e-13 r further in there are none.
        if abs(rate) <= doubt and half > 5e-7:
            pieces[depth, 0], pieces[depth, 1] = a, s
            pieces[depth + 1, 0], pieces[depth + 1, 1] = s, b
            depth += 2
            continue
        h_a, aside_a, _, _, _ = over(line, edge, sense, r, phase, a)
        h_b, aside_b, _, _, _ = over(line, edge, sense, r, phase, b)
        # A root on an end belongs to two pieces, whose rounding must not lose it between them.
        if abs(aside_a) <= tiny:
            lowest = min(lowest, h_a)
        if abs(aside_b) <= tiny:
            lowest = min(lowest, h_b)
        if (aside_a > 0.0) == (aside_b > 0.0):
            continue
        for _ in range(80):
            if (lateral > 0.0) == (aside_a > 0.0):
                a = s
            else:
                b = s
            rate = -sense * r * cosine - line[4]
            if edge.rake_sin != 0.0:
                rate += edge.rake_sin * slope(edge, u) * (r * sine + line[3])
            if abs(lateral) <= 2e-15 * abs(rate) or b - a < 1e-15:
                break
            following = s - lateral / rate if rate != 0.0 else a
            s = following if a < following < b else 0.5 * (a + b)
            h, lateral, u, sine, cosine = over(line, edge, sense, r, phase, s)
        lowest = min(lowest, h)
    return lowest


@jit_inline
def misses(blocks, k, edge, gap, lean, dip, sense, r, base, spread, ceiling):
    """Return whether the edge passes over no point within ``spread`` of one, below ``ceiling``, on lines of a block.

    The tool is at the azimuth of the point at ``base`` along the motion; ``lean`` and ``dip`` are of `core_height`.
    """
    sine, cosine = sincos(0.5 * (blocks[k, 5] + blocks[k, 6]) - base)
    half = 0.5 * (blocks[k, 6] - blocks[k, 5]) + ROUNDING
    along = r * half * (abs(sine) + 0.5 * half) + spread
    across = r * half * (abs(cosine) + 0.5 * half) + spread
    rise = (ceiling - blocks[k, 4] - edge.dz) / edge.rake_cos
    across += 0.5 * (blocks[k, 3] - blocks[k, 2]) + ROUNDING * (1.0 + r)
    excess = abs(-sense * r * sine - edge.dy - 0.5 * (blocks[k, 2] + blocks[k, 3])) - across
    if excess > lean * max(rise, dip):  # most blocks, so it comes first
        return True
    low, high = r * cosine - along - blocks[k, 1], r * cosine + along - blocks[k, 0]
    if least_between(edge, gap, low, high) > rise:
        return True
    rise = min(rise, max(height(edge, low), height(edge, high)) + gap)
    return excess > lean * max(rise, dip)


@jit
def after_runs(blocks, ends, block, fresh, wide, edge, gap, lean, dip, sense, r, base, spread, ceiling):
    """Return ``block`` unless `misses` holds for a run that begins with it, and else the block after that run.

    ``fresh`` if the runs that it is in were not looked at yet. A run that turns by more than ``wide``, half of the
    search, is not worth a look. ``ends`` are those of `block_ends`.
    """
    size, row = RUN * RUN, ends[1]
    for _ in range(2):
        k = row + block // size
        if (
            (fresh or block % size == 0)
            and blocks[k, 6] - blocks[k, 5] < wide
            and misses(blocks, k, edge, gap, lean, dip, sense, r, base, spread, ceiling)
        ):
            return size * (block // size + 1)
        size, row = RUN, ends[0]
    return block


@jit_inline
def next_block(blocks, ends, block, fresh, last, wide, edge, gap, lean, dip, sense, r, base, spread, ceiling):
    """Return the first block from ``block`` on for which `misses` does not hold; none that begins after ``last``.

    If there is none, that is the number of blocks. Runs are looked at first, see `after_runs`.
    """
    while block < ends[0] and blocks[block, 5] <= last:
        following, run = block, ends[0] + block // RUN
        if (fresh or block % RUN == 0) and blocks[run, 6] - blocks[run, 5] < wide:
            following = after_runs(
                blocks, ends, block, fresh, wide, edge, gap, lean, dip, sense, r, base, spread, ceiling
            )  # fmt: skip
            fresh = False
        if following == block:
            if not misses(blocks, block, edge, gap, lean, dip, sense, r, base, spread, ceiling):
                return block
            following = block + 1
        block = following
    return ends[0]


@jit
def core_height(
    c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, r, azimuth, useful, ceiling, pieces, line,
):  # fmt: skip
    """Return the height at one point that a turn may pass over at any number of moments.

    Such a point is close to the axis, or Y moves about as fast as the part. From either side the edge can pass over the
    point only while the lateral distance of the point from the plane through the axis is at most that of the edge:
    within a quarter turn, or much less. Each such stretch of each turn of ``useful`` (2, 2), see `useful_lateral`, is
    searched block by block (see `block_bounds`) and line by line, those likely to be lowest first. The height is not
    above ``ceiling``, so passes that are need not be found. ``pieces`` (64, 2) and ``line`` (6,) are scratch.
    """
    begin, end = sense * c[0], sense * c[c.size - 1]
    turns, lines, ends = bounds.shape[1], c.size - 1, block_ends(c.size - 1)
    off, lean = abs(edge.dy) + most_y, abs(edge.rake_sin)
    dip = max(gap - height(edge, 0.0), 0.0)  # the most that the edge is below the tip
    size = r + edge.base + abs(edge.dx) + abs(edge.dy) + most_y + max(abs(bounds[1, 0]), abs(bounds[0, turns - 1]))
    if edge.rake_sin * edge.dy >= 0.0 and r + 64.0 * EPSILON * size < abs(edge.dy) - lean * dip - most_y:
        return FAR  # the lateral distance of the edge from the axis is always larger
    lowest = FAR
    level = min(ceiling + ROUNDING * (1.0 + abs(ceiling)), FAR)  # a pass above it does not matter
    for which in range(2):
        side = -1.0 if which == 1 else 1.0
        first, last = useful[which, 0], useful[which, 1]
        near = first
        for m in range(first, last + 1):
            if abs(bounds[0, m] - side * r) < abs(bounds[0, near] - side * r):
                near = m
        behind = np.pi if which == 1 else 0.0
        start = azimuth + behind + TURN * np.ceil((begin - azimuth - behind) / TURN)
        # From the nearest outward; a stretch reaches into the turn before or after its own.
        for step in range(2 * (last - first + 2)):
            m = near + (step + 1) // 2 if step % 2 == 1 else near - step // 2
            t = start + TURN * m
            if m < first - 1 or m > last + 1 or t - 2.0 > end or t + 2.0 < begin:
                continue
            before = min(max(int((t - 0.5 * np.pi - begin) / TURN), 0), turns - 1)
            after = min(max(int((t + 0.5 * np.pi - begin) / TURN), 0), turns - 1)
            bottom = min(bounds[2, before], bounds[2, after]) + edge.dz
            low, high = min(bounds[0, before], bounds[0, after]), max(bounds[1, before], bounds[1, after])
            lateral = off + lean * max((level - bottom) / edge.rake_cos, dip)
            share = min(lateral / r * (1.0 + 1e-12), 1.0) if r > 0.0 else 1.0
            wide, inner = np.arcsin(share) + ROUNDING, r * np.sqrt(1.0 - share * share)
            if which == 0:
                least = least_between(edge, gap, inner - high, r - low)
            else:
                least = least_between(edge, gap, -r - high, -inner - low)
            if bottom + edge.rake_cos * least > level or t - wide > end + ROUNDING or t + wide < begin - ROUNDING:
                continue
            base = t - behind
            at = min(max(t - wide, begin), end)
            block, fresh = locate(c, sense, at, guess_index(c, sense, at, starts)) // BLOCK, True
            while True:
                block = next_block(
                    blocks, ends, block, fresh, t + wide, wide, edge, gap, lean, dip, sense, r, base, 0.0, level
                )  # fmt: skip
                if block == ends[0]:
                    break
                i, stop = BLOCK * block, min(BLOCK * (block + 1), lines)
                block, fresh = block + 1, False
                phase = sense * c[i] - base
                for j in range(i, stop):
                    ahead = sense * c[j + 1] - base
                    length = ahead - phase
                    line[0], line[2], line[3], line[5] = (
                        x[j],
                        z[j],
                        (x[j + 1] - x[j]) / length,
                        (z[j + 1] - z[j]) / length,
                    )
                    line[1], line[4] = (y[j], (y[j + 1] - y[j]) / length) if y.size > 0 else (0.0, 0.0)
                    h = lowest_on_line(
                        line, edge, bend, sense, r, phase, -ROUNDING if j == 0 else 0.0,
                        length + ROUNDING if j == lines - 1 else length, pieces, level,
                    )  # fmt: skip
                    if h < level:
                        lowest, level = h, h
                    phase = ahead
    return lowest


@jit
def axis_height(x, z, starts, bounds, edge, gap):
    """Return the height on the axis, which an upright tool passes at every moment: the least of all heights.

    Turns with bounds above the lowest height so far are skipped; the turn with the least bound is evaluated first.
    """
    turns = starts.size - 1
    floor = np.empty(turns)
    for m in range(turns):
        floor[m] = bounds[2, m] + edge.dz + least_between(edge, gap, -bounds[1, m], -bounds[0, m])
    best = 0
    for m in range(1, turns):
        best = m if floor[m] < floor[best] else best
    lowest = FAR
    for step in range(turns):
        # The most promising one first, and the one that it has changed places with in its stead.
        m = best if step == 0 else (0 if step == best else step)
        if floor[m] > lowest:
            continue
        for i in range(max(starts[m] - 1, 0), min(starts[m + 1] + 1, x.size - 1)):
            first, last = -(x[i] + edge.dx), -(x[i + 1] + edge.dx)
            bottom = min(z[i], z[i + 1]) + edge.dz
            if bottom + least_between(edge, gap, min(first, last), max(first, last)) > lowest:
                continue
            drift, climb = x[i + 1] - x[i], z[i + 1] - z[i]
            # The height of the edge over the axis is convex in time; of one with waves, between nodes of its profile.
            parts, begin, end = 1, 0.0, 1.0
            if not edge.convex and drift != 0.0:
                one, two = (first - edge.low_u) / drift, (first - edge.high_u) / drift
                begin, end = min(max(min(one, two), 0.0), 1.0), min(max(one, two, 0.0), 1.0)
                nodes = (end - begin) * abs(drift) * edge.pieces_per_x / edge.base
                parts = max(int(np.ceil(nodes)), 1)
            for part in range(-1, parts + 1):
                a = 0.0 if part < 0 else begin + (end - begin) * part / parts
                b = begin if part < 0 else begin + (end - begin) * (part + 1) / parts if part < parts else 1.0
                while b - a > 1e-12:
                    middle = 0.5 * (a + b)
                    if climb - slope(edge, first - middle * drift) * drift > 0.0:
                        b = middle
                    else:
                        a = middle
                share = 0.5 * (a + b)
                lowest = min(lowest, z[i] + share * climb + edge.dz + height(edge, first - share * drift))
            for share in (0.0, 1.0):
                lowest = min(lowest, z[i] + share * climb + edge.dz + height(edge, first - share * drift))
    return lowest


@jit
def useful_by_ring(bounds, edge, rings, out):
    """Fill ``out`` (rings - 1, 2, 2): first and last turn of either side useful between neighbouring ``rings``."""
    turns = bounds.shape[1]
    keep = np.empty(turns, np.bool_)
    for ring in range(rings.size - 1):
        for which in range(2):
            useful_turns(bounds, which == 1, rings[ring], rings[ring + 1], edge, keep)
            out[ring, which, 0], out[ring, which, 1] = turns, -1
            for m in range(turns):
                if keep[m]:
                    out[ring, which, 0] = min(out[ring, which, 0], m)
                    out[ring, which, 1] = m


@jit
def nearest_use(begin, end, which, lateral, low, high):
    """Return the place on the edge nearest the tip, toward its side, that can be over a ring within ``lateral``.

    The tip stands between ``begin`` and ``end`` along its own side; the ring lies between ``low`` and ``high``.
    """
    inner = np.sqrt(max(low * low - lateral * lateral, 0.0)) if lateral < low else 0.0
    first = -end if which == 1 else begin
    last = -begin if which == 1 else end
    return high - first if first > high else max(inner - last, 0.0)


@jit
def useful_lateral(bounds, edge, gap, bend, most_y, rings, out, core, ceilings):
    """Fill ``out`` like `useful_by_ring`, for any edge; mark in ``core`` the rings that need `core_height`.

    Some pass is over every point of the ring, which gives a ceiling to the surface, kept in ``ceilings``. A pass under
    the ceiling has its edge at most W above the tip, so at most the lateral distance A, and is between sqrt(r^2 - A^2)
    and r from the axis in its own plane. There the lateral distance of the edge changes by a fraction of that of the
    point. Where the fraction is at most a half, up to 2 A, a fixed-point iteration finds the pass, and it is the only
    one of its side.
    ``gap`` is the largest drop of the edge on its way out from the tip, ``bend`` the largest decrease of its slope.
    """
    turns = bounds.shape[1]
    lean, off = abs(edge.rake_sin), abs(edge.dy) + most_y
    dip = max(gap - height(edge, 0.0), 0.0)  # the most that the edge is below the tip
    ranges = np.empty((2, 2, turns))  # of the tip, mirrored for the other side; of its own and its neighbouring turns
    tops = np.empty(turns)
    for m in range(turns):
        before, after = max(m - 1, 0), min(m + 2, turns)
        low, high = span(bounds[0], before, after)[0], span(bounds[1], before, after)[1]
        ranges[0, 0, m], ranges[0, 1, m] = low, high
        ranges[1, 0, m], ranges[1, 1, m] = -high, -low
        tops[m] = span(bounds[3], before, after)[1]
    # What bounds of many turns at once exclude no turn of them need be asked about.
    heaps = -(-turns // HEAP)
    heap = np.empty((6, heaps))  # tip from and to, those of the neighbours too, least of the highest and the lowest
    for k in range(heaps):
        start, stop = HEAP * k, min(HEAP * (k + 1), turns)
        heap[0, k], heap[1, k] = span(bounds[0], start, stop)[0], span(bounds[1], start, stop)[1]
        heap[2, k], heap[3, k] = span(ranges[0, 0], start, stop)[0], span(ranges[0, 1], start, stop)[1]
        heap[4, k], heap[5, k] = span(tops, start, stop)[0], span(bounds[2], start, stop)[0]
    nearest = 0
    for ring in range(rings.size - 1):
        low, high = rings[ring], rings[ring + 1]
        ceiling = FAR
        lowest = nearest
        # The heap that held the least one for the ring before comes first.
        for which in range(2):
            for step in range(heaps + 1):
                k = lowest if step == 0 else step - 1
                first = -heap[3, k] if which == 1 else heap[2, k]
                last = -heap[2, k] if which == 1 else heap[3, k]
                reach = max(first - high, high - last, 0.0)
                least = max(height(edge, reach), height(edge, -reach))
                if (step > 0 and k == lowest) or heap[4, k] + edge.dz + edge.rake_cos * least >= ceiling:
                    continue
                for m in range(max(HEAP * k, 1), min(HEAP * (k + 1), turns - 2)):
                    first, last = ranges[which, 0, m], ranges[which, 1, m]
                    reach = max(abs(low - last), abs(high - first))
                    most = max(height(edge, reach), height(edge, -reach)) + gap
                    lateral = 2.0 * (off + lean * max(most, dip))
                    if lateral > low:
                        continue
                    reach = max(abs(np.sqrt(low * low - lateral * lateral) - last), abs(high - first))
                    most = max(height(edge, reach), height(edge, -reach)) + gap
                    if off + lean * max(most, dip) <= lateral and tops[m] + edge.dz + edge.rake_cos * most < ceiling:
                        ceiling = tops[m] + edge.dz + edge.rake_cos * most
                        nearest = k
        ceilings[ring] = ceiling
        most = 0.0
        for which in range(2):
            side = -1.0 if which == 1 else 1.0
            out[ring, which, 0], out[ring, which, 1] = turns, -1
            for k in range(heaps):
                rise = (ceiling - heap[5, k] - edge.dz) / edge.rake_cos
                lateral = off + lean * max(rise, dip)
                u = nearest_use(heap[0, k], heap[1, k], which, lateral, low, high)
                if height(edge, side * u) - 2.0 * gap > rise:
                    continue
                for m in range(HEAP * k, min(HEAP * (k + 1), turns)):
                    rise = (ceiling - bounds[2, m] - edge.dz) / edge.rake_cos
                    lateral = off + lean * max(rise, dip)
                    u = nearest_use(bounds[0, m], bounds[1, m], which, lateral, low, high)
                    if height(edge, side * u) - gap <= rise:
                        out[ring, which, 0] = min(out[ring, which, 0], m)
                        out[ring, which, 1] = m
                        most = max(most, lateral)
        core[ring] = 2.0 * most >= low
        if core[ring]:
            continue
        inner = np.sqrt(low * low - 4.0 * most * most)
        for which in range(2):
            side = -1.0 if which == 1 else 1.0
            for m in range(max(out[ring, which, 0] - 1, 0), min(out[ring, which, 1] + 2, turns)):
                near = slope(edge, side * (inner - ranges[which, 1, m]))
                far = slope(edge, side * (high - ranges[which, 0, m]))
                g = lean * (max(abs(near), abs(far)) + bend)
                core[ring] = core[ring] or g * (2.0 * most + bounds[4, m]) + bounds[6, m] > 0.5 * inner


@jit
def rings_between(rings, low, high):
    """Return the first ring between the distances ``low`` and ``high`` from the axis, and the one after the last.

    Points outside of all rings, which a tile may hold next to those that are asked for, count to the nearest.
    """
    inner, last = interval(rings, low), interval(rings, high)
    return inner, max(last + 1 if rings[last] < high else last, inner + 1)


@jit
def turns_near(c, sense, starts, rings, useful, upright, low, high, middle, half, which):
    """Return (behind, turned, first, last) of the turns whose passes from one side may matter, see `gather`.

    Turn m passes over the azimuth a at a + ``behind`` + TURN (``turned`` + m).
    """
    turns = starts.size - 1
    begin = sense * c[0]
    behind = np.pi if which == 1 else 0.0
    along = middle + behind
    turned = np.ceil((begin - along - ROUNDING) / TURN)
    start = along + TURN * turned
    first, last = turns, -1
    for ring in range(*rings_between(rings, low, high)):
        first, last = min(first, useful[ring, which, 0]), max(last, useful[ring, which, 1])
    # At either end of the motion a pass more, which may cover some azimuths of a tile and not others; everywhere
    # for a tool that passes over an azimuth up to a quarter turn early or late, and where some azimuths lie before
    # the one at which the turns begin and some after it, so that they count their turns differently.
    across = start - begin <= half + ROUNDING or start + half + ROUNDING >= begin + TURN
    before = 1 if first == 0 or not upright or across else 0
    after = 1 if last == turns - 1 or not upright or across else 0
    return behind, turned, max(first - before, -1), min(last + after, turns)


@jit
def gather(c, sense, starts, rings, useful, upright, low, high, middle, half, side, shift, hint):
    """List every pass that may matter between the distances ``low`` and ``high`` from the axis, near one azimuth.

    Pass k comes from ``side`` k and passes over the azimuth a (along the motion) at a + ``shift`` k, for azimuths
    within ``half`` of the ``middle``; ``hint`` k is where in the motion to look. ``useful`` is of `useful_by_ring` or
    `useful_lateral`. Return how many there are.
    """
    count = 0
    for which in range(2):
        behind, turned, first, last = turns_near(
            c, sense, starts, rings, useful, upright, low, high, middle, half, which
        )
        for m in range(first, last + 1):
            # The same number whatever the middle, so that heights do not depend on how points are grouped.
            side[count], shift[count] = which, behind + TURN * (turned + m)
            hint[count] = guess_index(c, sense, middle + shift[count], starts)
            count += 1
    return count


@jit
def height_alone(
    c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y, r, azimuth,
    pieces, line,
):  # fmt: skip
    """Return the height at one point off the axis, by all passes that may matter there.

    ``pieces`` and ``line`` are scratch for `core_height`.
    """
    if y is not None:
        ring, _ = rings_between(rings, r, r)
        if core[ring]:
            return core_height(
                c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, r, azimuth, useful[ring],
                ceilings[ring], pieces, line,
            )  # fmt: skip
    lowest = FAR
    for which in range(2):
        behind, turned, first, last = turns_near(
            c, sense, starts, rings, useful, y is None, r, r, azimuth, 0.0, which
        )  # fmt: skip
        for m in range(first, last + 1):
            t = azimuth + (behind + TURN * (turned + m))
            h, _, _, _, _ = pass_at(c, x, y, z, sense, edge, t, r, which, guess_index(c, sense, t, starts))
            lowest = min(lowest, h)
    return lowest


@jit
def choose(work, count, chosen):
    """Choose the passes that can be lowest: work[0] high, give or take work[2], FAR where that is unknown."""
    ceiling = FAR
    for k in range(count):
        if work[2, k] < FAR:
            ceiling = min(ceiling, work[0, k] + work[2, k])
    number = 0
    for k in range(count):
        if work[2, k] == FAR or work[0, k] - work[2, k] <= ceiling:
            chosen[number] = k
            number += 1
    return number


@jit
def shorten(c, x, z, sense, edge, bend, rc, ac, hr, ha, count, side, shift, hint, work, chosen):
    """Choose the passes of an upright edge that can be lowest within (hr, ha) of the place (rc, ac); return how many.

    A pass can if its height in the middle, less the most that its slope can differ within reach from the slope of the
    pass that is lowest in the middle, comes below the lowest. ``bend`` is the most that the slope of the edge falls
    back on its way toward +X. ``work`` (3, count) is scratch.
    """
    begin, end = sense * c[0], sense * c[c.size - 1]
    lowest, best = FAR, -1
    for k in range(count):
        h, i, u, _, _ = pass_at(c, x, None, z, sense, edge, ac + shift[k], rc, side[k], hint[k])
        hint[k], work[0, k], work[1, k] = i, h, u
        if h < lowest:
            lowest, best = h, k
    steer_r, steer_a = 0.0, 0.0
    if best >= 0:
        i = hint[best]
        step = sense * (c[i + 1] - c[i])
        g = edge.rake_cos * slope(edge, work[1, best])
        steer_r = g if side[best] == 0 else -g
        steer_a = ((z[i + 1] - z[i]) - g * (x[i + 1] - x[i])) / step
    for k in range(count):
        t, u = ac + shift[k], work[1, k]
        if t + ha < begin - ROUNDING or t - ha > end + ROUNDING:
            work[0, k], work[2, k] = FAR, 0.0  # nowhere within reach
            continue
        # Where the motion begins or ends within reach a pass covers a part of it: it stays on the list, to be tried.
        if work[0, k] == FAR or t - ha < begin or t + ha > end:
            work[2, k] = FAR
            continue
        first = locate(c, sense, t - ha, hint[k])
        last = locate(c, sense, t + ha, hint[k])
        drift, rise, fall = 0.0, -FAR, FAR
        for i in range(first, last + 1):
            step = sense * (c[i + 1] - c[i])
            drift = max(drift, abs(x[i + 1] - x[i]) / step)
            rate = (z[i + 1] - z[i]) / step
            rise, fall = max(rise, rate), min(fall, rate)
        du = hr + drift * ha
        g1, g2 = edge.rake_cos * slope(edge, u - du), edge.rake_cos * slope(edge, u + du)
        sign = 1.0 if side[k] == 0 else -1.0
        dev_r = max(abs(sign * g1 - steer_r), abs(sign * g2 - steer_r)) + edge.rake_cos * bend
        dev_a = max(abs(rise - steer_a), abs(fall - steer_a)) + (max(abs(g1), abs(g2)) + edge.rake_cos * bend) * drift
        work[2, k] = hr * dev_r + ha * dev_a + 1e-13
    return choose(work, count, chosen)


@jit
def product(a, b, p, q):
    """Return the least and the greatest product of a number from a to b and one from p to q."""
    one, two, three, four = a * p, a * q, b * p, b * q
    return min(one, two, three, four), max(one, two, three, four)


@jit
def quotient(a, b, p, q):
    """Return the least and the greatest quotient of a number from a to b and a positive one from p to q."""
    return (a / q if a >= 0.0 else a / p), (b / p if b >= 0.0 else b / q)


@jit
def rates_between(c, values, sense, first, last):
    """Return the least and the greatest change per radian of ``values`` on some lines of the motion."""
    low, high = FAR, -FAR
    for i in range(first, last + 1):
        rate = (values[i + 1] - values[i]) / (sense * (c[i + 1] - c[i]))
        low, high = min(low, rate), max(high, rate)
    return low, high


@jit
def gradients(c, x, y, z, sense, edge, bend, rc, hr, ha, at, i, u, across, side, out):
    """Fill ``out`` (4,) with bounds of the gradient of one pass within (hr, ha) of a point at distance ``rc``.

    They are the least and the greatest change of its height per distance from the axis and per azimuth. With A along
    and B across the plane of the tool, D = A + Y' + v' (B - X') for the pass that the tool makes with growing angle,
    both follow from r sin(azimuth of the point - azimuth of the tool) = v(u) + Y, differentiated. Return False where no
    bounds hold: the pass does not cover all of it, or D may vanish.
    """
    lean, rise, sign = edge.rake_sin, edge.rake_cos, (1.0 if side == 0 else -1.0)
    lateral_offset = sense * across
    away = rc * rc - lateral_offset * lateral_offset
    if not away > 0.0 or hr >= rc:
        return False
    reach = 3.0 * (ha + hr * (abs(lateral_offset) / rc + abs(lean * slope(edge, u))) / np.sqrt(away))
    if at - reach < sense * c[0] or at + reach > sense * c[c.size - 1]:
        return False
    first, last = locate(c, sense, at - reach, i), locate(c, sense, at + reach, i)
    x_low, x_high = rates_between(c, x, sense, first, last)
    z_low, z_high = rates_between(c, z, sense, first, last)
    y_low, y_high = rates_between(c, y, sense, first, last) if y.size > 0 else (0.0, 0.0)
    drift, sway = max(abs(x_low), abs(x_high)), max(abs(y_low), abs(y_high))
    du = 2.0 * hr + drift * reach + 2.0 * abs(lateral_offset) * (ha + reach)
    g_low, g_high = slope(edge, u - du) - bend, slope(edge, u + du) + bend
    p_low, p_high = product(lean, lean, g_low, g_high)
    wander = sway * reach + max(abs(p_low), abs(p_high)) * du
    b_low, b_high = lateral_offset - wander, lateral_offset + wander
    most, near, far = abs(lateral_offset) + wander, rc - hr, rc + hr
    if most >= near:
        return False
    a_low, a_high = np.sqrt(near * near - most * most), far  # of A without its sign
    # D with the sign of A, and the share by which the tool turns otherwise than the azimuth of the point does.
    same = sense * sign
    q_low, q_high = product(p_low, p_high, b_low - x_high, b_high - x_low)
    d_low, d_high = product(same, same, y_low + q_low, y_high + q_high)
    d_low, d_high = d_low + a_low, d_high + a_high
    if d_low < 0.25 * a_low:
        return False
    e_low, e_high = product(p_low, p_high, x_low, x_high)
    e_low, e_high = product(same, same, y_low - e_high, y_high - e_low)
    e_low, e_high = quotient(e_low, e_high, d_low, d_high)
    # How the tool turns with the distance of the point.
    t_low, t_high = product(p_low, p_high, a_low, a_high)
    t_low, t_high = product(sense, sense, t_low, t_high)
    s_low, s_high = product(sign, sign, b_low, b_high)
    t_low, t_high = quotient(s_low - t_high, s_high - t_low, near * d_low, far * d_high)
    # How the place on the edge changes with the distance and with the azimuth.
    r_low, r_high = product(b_low - x_high, b_high - x_low, t_low, t_high)
    cos_low, cos_high = product(sign, sign, a_low / far, min(a_high / near, 1.0))
    r_low, r_high = r_low + cos_low, r_high + cos_high
    m_low, m_high = product(b_low, b_high, e_low, e_high)
    n_low, n_high = product(x_low, x_high, 1.0 - e_high, 1.0 - e_low)
    m_low, m_high = -m_high - n_high, -m_low - n_low
    if max(abs(1.0 - e_low), abs(1.0 - e_high)) * ha + max(abs(t_low), abs(t_high)) * hr > reach:
        return False
    if max(abs(r_low), abs(r_high)) * hr + max(abs(m_low), abs(m_high)) * ha > du:
        return False
    g_low, g_high = rise * g_low, rise * g_high
    h_low, h_high = product(z_low, z_high, t_low, t_high)
    s_low, s_high = product(g_low, g_high, r_low, r_high)
    out[0], out[1] = h_low + s_low, h_high + s_high
    h_low, h_high = product(z_low, z_high, 1.0 - e_high, 1.0 - e_low)
    s_low, s_high = product(g_low, g_high, m_low, m_high)
    out[2], out[3] = h_low + s_low, h_high + s_high
    return True


@jit
def shorten_lateral(
    c, x, y, z, sense, edge, bend, rc, ac, hr, ha, count, side, shift, hint, work, bounds, chosen
):  # fmt: skip
    """Choose passes like `shorten`, of an edge at a lateral distance from the plane through the axis.

    Each pass is bounded by a plane of one tilt for all, give or take what its gradients differ from that; a pass
    without bounds stays on the list. ``bounds`` (count, 4) is scratch too.
    """
    begin, end = sense * c[0], sense * c[c.size - 1]
    lateral = 0.5 * np.pi  # largest azimuth between a tool and a point that it passes over
    lowest, best = FAR, -1
    for k in range(count):
        t = ac + shift[k]
        if t + ha + lateral < begin - ROUNDING or t - ha - lateral > end + ROUNDING:
            work[0, k], work[2, k] = FAR, 0.0  # nowhere within reach
            continue
        h, i, u, at, across = pass_at(c, x, y, z, sense, edge, t, rc, side[k], hint[k])
        hint[k], work[0, k], work[2, k] = i, h, FAR
        if h < FAR and gradients(
            c, x, y, z, sense, edge, bend, rc, hr, ha, at, i, u, across, side[k], bounds[k]
        ):  # fmt: skip
            work[2, k] = 0.0
            if h < lowest:
                lowest, best = h, k
    for k in range(count):
        if best >= 0 and work[0, k] < FAR and work[2, k] < FAR:
            dev_r = max(bounds[k, 1] - bounds[best, 0], bounds[best, 1] - bounds[k, 0])
            dev_a = max(bounds[k, 3] - bounds[best, 2], bounds[best, 3] - bounds[k, 2])
            work[2, k] = hr * dev_r + ha * dev_a + 1e-13
    return choose(work, count, chosen)


@jit
def extent(values, start, stop):
    """Return the middle and half of the range of ``values``."""
    low, high = span(values, start, stop)
    return 0.5 * (low + high), 0.5 * (high - low)


@jit
def lower_each(c, x, y, z, sense, edge, turn, which, hint, r, azimuth, out):
    """Lower ``out`` to one pass over the points (r, azimuth)."""
    i = hint
    for k in range(out.size):
        h, i, _, _, _ = pass_at(c, x, y, z, sense, edge, azimuth[k] + turn, r[k], which, i)
        out[k] = min(out[k], h)


@jit
def lower(c, x, z, sense, edge, turn, which, hint, r, azimuth, rc, hr, ac, ha, tip, level, out):
    """Lower ``out`` to one pass of an upright edge over the points of a tile, which lie within (hr, ha) of (rc, ac).

    The tool moves over a tile along a few lines of its motion: its position is linear in the azimuth with a few kinks,
    which takes loops that vectorise. ``tip`` and ``level`` are scratch, for one number each point.
    """
    count = out.size
    t = ac + turn
    i, last = hint, hint + MAX_KINKS + 1
    if t - ha > sense * c[0] and t + ha < sense * c[c.size - 1]:
        i = locate(c, sense, t - ha, hint)
        last = locate(c, sense, t + ha, i)
    if last - i > MAX_KINKS:
        lower_each(c, x, None, z, sense, edge, turn, which, hint, r, azimuth, out)
        return
    ci = sense * c[i]
    step = sense * c[i + 1] - ci
    drift, rise = (x[i + 1] - x[i]) / step, (z[i + 1] - z[i]) / step
    p = x[i] + (t - ci) * drift + edge.dx
    q = z[i] + (t - ci) * rise + edge.dz
    widest = abs(drift)
    for k in range(count):
        away = azimuth[k] - ac
        tip[k], level[k] = p + away * drift, q + away * rise
    for j in range(i + 1, last + 1):
        kink = sense * c[j]
        step = sense * c[j + 1] - kink
        more, higher = (x[j + 1] - x[j]) / step - drift, (z[j + 1] - z[j]) / step - rise
        drift, rise = drift + more, rise + higher
        widest = max(widest, abs(drift))
        kink -= t
        for k in range(count):
            past = azimuth[k] - ac - kink
            past = past if past > 0.0 else 0.0
            tip[k] += past * more
            level[k] += past * higher
    side = 1.0 if which == 0 else -1.0
    u = side * rc - p
    reach = (hr + widest * ha) * (1.0 + 1e-9) + 1e-9 * edge.base
    if edge.pieces.shape[1] == 0 and u - reach > edge.low_u and u + reach < edge.high_u:
        base = edge.base
        square = base * base
        for k in range(count):
            v = side * r[k] - tip[k]
            h = (level[k] + base) - np.sqrt(square - v * v)
            out[k] = h if h < out[k] else out[k]
        return
    for k in range(count):
        h = level[k] + height(edge, side * r[k] - tip[k])
        out[k] = h if h < out[k] else out[k]


@jit
def unwrap(r, azimuth):
    """Put azimuths on one branch. Return whether the points are close together as seen from the axis."""
    close = r[0] > 0.0
    for k in range(1, r.size):
        if azimuth[k] - azimuth[0] > np.pi:
            azimuth[k] -= TURN
        elif azimuth[k] - azimuth[0] < -np.pi:
            azimuth[k] += TURN
        close = close and r[k] > 0.0 and abs(azimuth[k] - azimuth[0]) < 0.5
    return close


@jit
def close_together(r, azimuth):
    """Say whether points are close together as seen from the axis, with azimuths on one branch."""
    _, half = extent(azimuth, 0, azimuth.size)
    return half < 0.25 and span(r, 0, r.size)[0] > 0.0


@jit
def nearer(
    c, x, y, z, sense, edge, bend, place, count, side, shift, hint, work, tilts, chosen, new_side, new_shift, new_hint,
):  # fmt: skip
    """Copy the passes of a list that can be lowest around a ``place``, (rc, hr, ac, ha); return how many they are."""
    rc, hr, ac, ha = place
    if y is None:
        n = shorten(c, x, z, sense, edge, bend, rc, ac, hr, ha, count, side, shift, hint, work, chosen)
    else:
        n = shorten_lateral(
            c, x, y, z, sense, edge, bend, rc, ac, hr, ha, count, side, shift, hint, work, tilts, chosen
        )  # fmt: skip
    for k in range(n):
        new_side[k], new_shift[k], new_hint[k] = side[chosen[k]], shift[chosen[k]], hint[chosen[k]]
    return n


@jit
def floor_of_line(line, edge, bend, sense, r, azimuth, spread):
    """Return a lower bound of the edge over all points within ``spread`` of one, FAR where it passes over none.

    ``line`` is one line of the motion, see `lowest_on_line`, with its phase at azimuth 0 and its range.
    """
    a, b = line[7], line[8]
    s, half = 0.5 * (a + b), 0.5 * (b - a)
    h, lateral, u, sine, cosine = over(line, edge, sense, r, line[6] - azimuth, s)
    rate, doubt = -sense * r * cosine - line[4], r * half * (abs(sine) + 0.5 * half)
    # The largest lateral distance that counts without rake, which is quick to compute.
    if edge.rake_sin == 0.0 and abs(lateral) > (abs(rate) + doubt) * half + 1.001 * spread:
        return FAR
    pace, loose = -r * sine - line[3], r * half * (abs(cosine) + 0.5 * half)
    du = (abs(pace) + loose) * half + spread
    flat, steep = slope(edge, u - du) - bend, slope(edge, u + du) + bend
    most = max(abs(flat), abs(steep))
    if edge.rake_sin != 0.0:
        rate -= edge.rake_sin * 0.5 * (flat + steep) * pace
        doubt += abs(edge.rake_sin) * (0.5 * (steep - flat) * (abs(pace) + loose) + 0.5 * abs(flat + steep) * loose)
    rounding = 8.0 * EPSILON * (r + abs(line[0]) + abs(line[1]) + edge.base + abs(edge.dy))
    if abs(lateral) > (abs(rate) + doubt) * half + spread * (1.0 + abs(edge.rake_sin) * most) + rounding:
        return FAR
    return h - abs(line[5]) * half - edge.rake_cos * most * du - rounding


@jit
def lines_near(
    c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, r, azimuth, spread, useful, ceiling, lines,
    floor,
):  # fmt: skip
    """List the lines of the motion during which the edge passes over a point within ``spread`` below ``ceiling``.

    As `core_height`, for all points near (r, azimuth). Fill ``lines`` (n, 9) as `floor_of_line` takes them, and their
    ``floor`` (n,). Return how many they are, -1 if they are too many.
    """
    begin, end = sense * c[0], sense * c[c.size - 1]
    turns, ends, count = bounds.shape[1], block_ends(c.size - 1), 0
    off, lean = abs(edge.dy) + most_y, abs(edge.rake_sin)
    dip = max(gap - height(edge, 0.0), 0.0)  # the most that the edge is below the tip
    near, far = r - spread, r + spread
    early = 0.5 * np.pi + np.arcsin(spread / r) + ROUNDING
    for which in range(2):
        first, last = useful[which, 0], useful[which, 1]
        behind = np.pi if which == 1 else 0.0
        start = azimuth + behind + TURN * np.ceil((begin - azimuth - behind) / TURN)
        for m in range(first - 1, last + 2):
            t = start + TURN * m
            if t - 2.0 > end or t + 2.0 < begin:
                continue
            before = min(max(int((t - early - begin) / TURN), 0), turns - 1)
            after = min(max(int((t + early - begin) / TURN), 0), turns - 1)
            bottom = min(bounds[2, before], bounds[2, after]) + edge.dz
            low, high = min(bounds[0, before], bounds[0, after]), max(bounds[1, before], bounds[1, after])
            lateral = off + lean * max((ceiling - bottom) / edge.rake_cos, dip)
            share = min(lateral / near * (1.0 + 1e-12), 1.0)
            wide = np.arcsin(share) + np.arcsin(spread / r) + ROUNDING
            inner = near * np.sqrt(1.0 - share * share)
            if which == 0:
                least = least_between(edge, gap, inner - high, far - low)
            else:
                least = least_between(edge, gap, -far - high, -inner - low)
            if bottom + edge.rake_cos * least > ceiling or t - wide > end + ROUNDING or t + wide < begin - ROUNDING:
                continue
            base = t - behind
            at = min(max(t - wide, begin), end)
            block, fresh = locate(c, sense, at, guess_index(c, sense, at, starts)) // BLOCK, True
            while True:
                block = next_block(
                    blocks, ends, block, fresh, t + wide, wide, edge, gap, lean, dip, sense, r, base, spread, ceiling
                )  # fmt: skip
                if block == ends[0]:
                    break
                i, stop = BLOCK * block, min(BLOCK * (block + 1), c.size - 1)
                block, fresh = block + 1, False
                for j in range(i, stop):
                    if count == floor.size:
                        return -1
                    length = sense * (c[j + 1] - c[j])
                    line = lines[count]
                    line[0], line[2], line[1], line[4] = x[j], z[j], 0.0, 0.0
                    line[3], line[5] = (x[j + 1] - x[j]) / length, (z[j + 1] - z[j]) / length
                    if y.size > 0:
                        line[1], line[4] = y[j], (y[j + 1] - y[j]) / length
                    line[6] = sense * c[j] - (base - azimuth)
                    line[7] = -ROUNDING if j == 0 else 0.0
                    line[8] = length + ROUNDING if j == c.size - 2 else length
                    floor[count] = floor_of_line(line, edge, bend, sense, r, azimuth, spread)
                    if floor[count] <= ceiling:
                        count += 1
    return count


@jit
def fill_by_lines(
    c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, rings, useful, ceilings, r, azimuth, tiles,
    work, lines, floor, out,
):  # fmt: skip
    """Fill ``out`` at the points (r, azimuth) of some tiles, of which tile k holds tiles[k] to tiles[k + 1].

    The lines that may be lowest over any of the points are listed once, and for each tile those that may be over it,
    with a lower bound of their heights. A point tries them from the lowest bound on. The ceiling of the list is an
    estimate: a point above it is computed alone, and so is each where the list would be too long.
    """
    rc, hr = extent(r, 0, r.size)
    ac, ha = extent(azimuth, 0, r.size)
    spread = hr + (rc + hr) * ha + ROUNDING * rc
    inner, outer = rings_between(rings, rc - hr, rc + hr)
    range_of = useful[inner].copy()
    pieces, scratch = np.empty((64, 2)), np.empty(6)
    for ring in range(inner + 1, outer):
        for which in range(2):
            range_of[which, 0] = min(range_of[which, 0], useful[ring, which, 0])
            range_of[which, 1] = max(range_of[which, 1], useful[ring, which, 1])
    count = -1
    ceiling = -FAR
    if spread < 0.25 * rc:
        lowest, highest = FAR, -FAR
        for k in (0, r.size - 1):
            ring, _ = rings_between(rings, r[k], r[k])
            h = core_height(
                c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, r[k], azimuth[k], range_of,
                ceilings[ring], pieces, scratch,
            )  # fmt: skip
            lowest, highest = min(lowest, h), max(highest, h)
        if highest < FAR:
            ceiling = highest + 0.5 * (highest - lowest) + spread * spread / edge.base
            count = lines_near(
                c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, rc, ac, spread, range_of, ceiling,
                lines, floor,
            )  # fmt: skip
    near = np.empty(max(count, 1), np.int64)
    for tile in range(tiles.size - 1):
        part = slice(tiles[tile], tiles[tile + 1])
        if count >= 0:
            rc, hr = extent(r, part.start, part.stop)
            ac, ha = extent(azimuth, part.start, part.stop)
            spread = hr + (rc + hr) * ha + ROUNDING * rc
            few = 0
            for k in range(count):
                h = floor_of_line(lines[k], edge, bend, sense, rc, ac, spread)
                if h <= ceiling:
                    # From the lowest bound on, by insertion.
                    place = few
                    while place > 0 and work[place - 1] > h:
                        work[place], near[place] = work[place - 1], near[place - 1]
                        place -= 1
                    work[place], near[place] = h, k
                    few += 1
        for i in range(part.start, part.stop):
            lowest = FAR
            if count >= 0:
                for k in range(few):
                    if work[k] > lowest:
                        break
                    line = lines[near[k]]
                    lowest = lowest_on_line(
                        line, edge, bend, sense, r[i], line[6] - azimuth[i], line[7], line[8], pieces, lowest
                    )
            if lowest > ceiling:
                ring, _ = rings_between(rings, r[i], r[i])
                lowest = core_height(
                    c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, r[i], azimuth[i], useful[ring],
                    ceilings[ring], pieces, scratch,
                )  # fmt: skip
            out[i] = lowest


@jit
def fill_groups(
    c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y, r, azimuth,
    offsets, groups, shared, out,
):  # fmt: skip
    """Fill ``out`` at the points (r, azimuth) of some groups, azimuths along the motion.

    Group g holds the tiles groups[g] to groups[g + 1], tile k the points offsets[k] to offsets[k + 1], counted so that
    the first point of the first group is that of r, azimuth and out. A group shortens the list of all passes once for
    its tiles, and each tile again for its points; with ``shared`` all groups first shorten it together.
    """
    room = 2 * (starts.size + 2)
    lists = np.empty((4, 2, room), np.int64)  # side and hint of the passes of all, of a block, a group and a tile
    shifts = np.empty((4, room))
    chosen = np.empty(room, np.int64)
    work, tilts = np.empty((3, room)), np.empty((room, 4))
    number = groups.size - 1
    first_point = offsets[groups[0]]
    most = 1
    for tile in range(groups[0], groups[number]):
        most = max(most, offsets[tile + 1] - offsets[tile])
    tip, level = np.empty(most), np.empty(most)
    pieces, line = np.empty((64, 2)), np.empty(6)
    upright = y is None
    if y is not None:
        lines, floor, floors = np.empty((MAX_LINES, 9)), np.empty(MAX_LINES), np.empty(MAX_LINES)
    in_block = -1
    if shared and number > 1 and close_together(r, azimuth):
        rc, hr = extent(r, 0, r.size)
        ac, ha = extent(azimuth, 0, r.size)
        free = True
        for ring in range(*rings_between(rings, rc - hr, rc + hr)):
            free = free and (upright or not core[ring])
        if free:
            n = gather(
                c, sense, starts, rings, useful, upright, rc - hr, rc + hr, ac, ha, lists[0, 0], shifts[0], lists[0, 1]
            )  # fmt: skip
            in_block = nearer(
                c, x, y, z, sense, edge, bend, (rc, hr, ac, ha), n, lists[0, 0], shifts[0], lists[0, 1],
                work, tilts, chosen, lists[1, 0], shifts[1], lists[1, 1],
            )  # fmt: skip
    for g in range(number):
        origin, end = offsets[groups[g]] - first_point, offsets[groups[g + 1]] - first_point
        # A group around the axis spans all azimuths: its points share nothing, so each goes alone.
        close = unwrap(r[origin:end], azimuth[origin:end]) and end - origin > 1
        together = close
        rc, hr = extent(r, origin, end)
        ac, ha = extent(azimuth, origin, end)
        if not upright:
            for ring in range(*rings_between(rings, rc - hr, rc + hr)):
                together = together and not core[ring]
        if y is not None:  # noqa: SIM102 - alone, so that numba leaves out what follows
            if close and not together:
                fill_by_lines(
                    c, x, y, z, sense, starts, bounds, blocks, edge, gap, bend, most_y, rings, useful, ceilings,
                    r[origin:end], azimuth[origin:end], offsets[groups[g] : groups[g + 1] + 1] - (origin + first_point),
                    floors, lines, floor, out[origin:end],
                )  # fmt: skip
                continue
        if not together:
            for i in range(origin, end):
                if y is None:  # noqa: SIM102 - alone, so that numba leaves out what follows
                    if r[i] == 0.0:
                        out[i] = axis_height(x, z, starts, bounds, edge, gap)
                        continue
                out[i] = height_alone(
                    c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y,
                    r[i], azimuth[i], pieces, line,
                )  # fmt: skip
            continue
        n, source = in_block, 1
        if in_block < 0:
            source = 0
            n = gather(
                c, sense, starts, rings, useful, upright, rc - hr, rc + hr, ac, ha, lists[0, 0], shifts[0], lists[0, 1]
            )  # fmt: skip
        n = nearer(
            c, x, y, z, sense, edge, bend, (rc, hr, ac, ha), n, lists[source, 0], shifts[source], lists[source, 1],
            work, tilts, chosen, lists[2, 0], shifts[2], lists[2, 1],
        )  # fmt: skip
        for tile in range(groups[g], groups[g + 1]):
            part = slice(offsets[tile] - first_point, offsets[tile + 1] - first_point)
            rc, hr = extent(r, part.start, part.stop)
            ac, ha = extent(azimuth, part.start, part.stop)
            few = nearer(
                c, x, y, z, sense, edge, bend, (rc, hr, ac, ha), n, lists[2, 0], shifts[2], lists[2, 1],
                work, tilts, chosen, lists[3, 0], shifts[3], lists[3, 1],
            )  # fmt: skip
            out[part] = FAR
            for k in range(few):
                if y is None:
                    lower(
                        c, x, z, sense, edge, shifts[3, k], lists[3, 0, k], lists[3, 1, k], r[part], azimuth[part],
                        rc, hr, ac, ha, tip, level, out[part],
                    )  # fmt: skip
                else:
                    lower_each(
                        c, x, y, z, sense, edge, shifts[3, k], lists[3, 0, k], lists[3, 1, k], r[part], azimuth[part],
                        out[part],
                    )  # fmt: skip


@jit
def scattered(
    c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y, px, py,
    offsets, groups, shared, start, stop, out,
):  # fmt: skip
    """Fill ``out`` at the points (px, py) of groups ``start`` to ``stop``, each alone, see `fill_groups`."""
    first, last = offsets[groups[start]], offsets[groups[stop]]
    r, azimuth = np.empty(last - first), np.empty(last - first)
    for i in range(first, last):
        r[i - first] = np.sqrt(px[i] * px[i] + py[i] * py[i])
        azimuth[i - first] = sense * np.arctan2(py[i], px[i])
    fill_groups(
        c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y, r, azimuth,
        offsets, groups[start : stop + 1], shared, out[first:last],
    )  # fmt: skip


@jit
def polar_tile(columns, rows, polar, sense, r, azimuth):
    """Fill ``r`` and ``azimuth`` with distance and azimuth, along the motion, of the points of a tile, row by row.

    Columns and rows are x and y or, with ``polar``, distances from the axis and azimuths. The azimuth of a tile that
    is narrow as seen from the axis is that of its first point and a polynomial, in a loop that vectorises.
    """
    wide = columns.size
    if polar:
        for j in range(rows.size):
            for i in range(wide):
                r[j * wide + i], azimuth[j * wide + i] = columns[i], sense * rows[j]
        return
    for j in range(rows.size):
        square = rows[j] * rows[j]
        for i in range(wide):
            r[j * wide + i] = np.sqrt(columns[i] * columns[i] + square)
    x0, y0 = columns[0], rows[0]
    narrow = r[0] > 0.0
    if narrow:
        cosine, sine = x0 / r[0], y0 / r[0]
        for x in (columns[0], columns[wide - 1]):
            for y in (rows[0], rows[rows.size - 1]):
                ahead, across = x * cosine + y * sine, y * cosine - x * sine
                narrow = narrow and abs(across) < 0.4 * ahead
    if not narrow:
        for j in range(rows.size):
            for i in range(wide):
                azimuth[j * wide + i] = sense * np.arctan2(rows[j], columns[i])
        return
    origin = np.arctan2(y0, x0)
    for j in range(rows.size):
        for i in range(wide):
            ahead, across = columns[i] * cosine + rows[j] * sine, rows[j] * cosine - columns[i] * sine
            azimuth[j * wide + i] = sense * (origin + small_arctan(across / ahead))


@jit
def grid(
    c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y, columns, rows,
    polar, sides, wanted, several, shared, start, stop, out,
):  # fmt: skip
    """Fill ``out`` (rows, columns) block by block from ``start`` to ``stop``, blocks counted row by row.

    A tile is of ``sides`` points, along rows and columns, a group of 4 x 4 tiles, a block of ``several`` x ``several``
    groups. ``wanted`` says of each group whether it is filled.
    """
    down, across = sides
    tall, wide = 4 * several * down, 4 * several * across
    per_row = -(-columns.size // wide)
    r, azimuth, heights_of = np.empty(tall * wide), np.empty(tall * wide), np.empty(tall * wide)
    offsets, groups = np.empty(16 * several * several + 1, np.int64), np.empty(several * several + 1, np.int64)
    corner = np.empty((16 * several * several, 2), np.int64)
    for block in range(start, stop):
        row, column = (block // per_row) * tall, (block % per_row) * wide
        number, tile, offsets[0], groups[0] = 0, 0, 0, 0
        for g in range(several * several):
            j0, i0 = row + (g // several) * 4 * down, column + (g % several) * 4 * across
            if j0 >= rows.size or i0 >= columns.size or not wanted[j0 // (4 * down), i0 // (4 * across)]:
                continue
            for k in range(16):
                j, i = j0 + (k // 4) * down, i0 + (k % 4) * across
                if j >= rows.size or i >= columns.size:
                    continue
                y_part, x_part = rows[j : j + down], columns[i : i + across]
                first, last = offsets[tile], offsets[tile] + y_part.size * x_part.size
                polar_tile(x_part, y_part, polar, sense, r[first:last], azimuth[first:last])
                corner[tile, 0], corner[tile, 1] = j, i
                tile += 1
                offsets[tile] = last
            number += 1
            groups[number] = tile
        if number == 0:
            continue
        points = offsets[tile]
        fill_groups(
            c, x, y, z, sense, starts, bounds, blocks, rings, useful, core, ceilings, edge, gap, bend, most_y,
            r[:points], azimuth[:points], offsets, groups[: number + 1], shared, heights_of[:points],
        )  # fmt: skip
        for k in range(tile):
            j, i = corner[k]
            n = min(across, columns.size - i)
            for line in range(min(down, rows.size - j)):
                first = offsets[k] + line * n
                for place in range(n):
                    out[j + line, i + place] = heights_of[first + place]
