"""A round nose on lenslets side by side. See placing.lenslets for the method."""

import numpy as np

from turnwright._kernels import jit, jit_inline
from turnwright._kernels.polynomials import even_sums
from turnwright._kernels.quadrics import conic_point

MAX_STEPS, STEP_TOL = 12, 1e-6
"""Most Newton steps to a contact. The last is at most this, over the radius of the nose or the size of a feature where
that is less: the parabola that gives the height then errs by the third power of it."""
MAX_SLOPE = 10.0
"""Steeper lenslets are searched: close to the wall of a half circle a parabola is no measure of the edge."""
MARGIN = 1e-6
"""Share by which the searched part of the edge is wider than its slopes require."""


@jit
def touch(
    edge, cosine, sine, along, offsets, position, segment_offsets, start, stop, piece,
    vertices, curvature, conic, coefficients, ratio, feature, top, at,
):  # fmt: skip
    """Bring a round nose down on lines that cross lenslets.

    Parameters
    ----------
    cosine, sine, along
        Azimuth of each row, and where its distances begin along it. (rows,)
    offsets, position
        Row i holds the tip positions offsets[i] to offsets[i + 1] of ``position``. [mm]
    segment_offsets, start, stop, piece
        Row i holds the segments segment_offsets[i] to segment_offsets[i + 1], each on the lenslet of this number; of a
        negative number there is none.
    vertices
        Of all lenslets. (n, 3) [mm]
    curvature, conic, coefficients
        Of each: vertex curvature [1/mm], conic constant, and coefficients of the even powers 0, 2, ... of the distance
        from its axis.
    ratio, feature
        Greatest curvature of a section over that of the nose, and the size of the smallest feature. [mm]
    top, at
        Filled: the greatest height over the edge, and where, as distance from the tip. (n,) [mm]

    Returns
    -------
    bool
        Whether all is certain: the nose touches each lenslet at one place, no lenslet is steeper than the edge, and the
        positions of each row are in order.
    """
    most = 0
    for row in range(along.size):
        most = max(most, offsets[row + 1] - offsets[row])
    # Rows of one array would not be known to be contiguous, and no loop would vectorise.
    p, u, value, best, place = np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    sums, small = np.zeros((4, most)), STEP_TOL * min(edge.radius, feature)
    for row in range(along.size):
        begin, count = offsets[row], offsets[row + 1] - offsets[row]
        nearest, way = begin, 1
        if count > 1 and position[begin] > position[begin + count - 1]:
            nearest, way = begin + count - 1, -1
        for k in range(count):
            p[k] = position[nearest + way * k]
            best[k], place[k] = -np.inf, np.nan
        for k in range(1, count):
            if p[k] < p[k - 1]:
                return False
        slope, bend = steepest(
            along[row], cosine[row], sine[row], start, stop, piece, segment_offsets[row], segment_offsets[row + 1],
            vertices, curvature, conic, coefficients,
        )  # fmt: skip
        if not (slope < min(-edge.low_slope, edge.high_slope, MAX_SLOPE) and edge.radius * bend < ratio):
            return False
        # The edge touches where it is no steeper than the lenslets, in their valleys and on their ridges too.
        reach = edge.radius * ((1.0 + MARGIN) * slope / np.sqrt(1.0 + slope * slope) + MARGIN)
        low, high = max(edge.low_u, -reach), min(edge.high_u, reach)
        first, last = 0, 0  # tips whose edge is over a segment
        for s in range(segment_offsets[row], segment_offsets[row + 1]):
            if piece[s] < 0:
                continue
            while first < count and p[first] + high <= start[s]:
                first += 1
            while last < count and p[last] + low < stop[s]:
                last += 1
            if first >= last:
                continue
            centre, across, z = in_plane(vertices[piece[s]], along[row], cosine[row], sine[row])
            if not climb(
                p[first:last], edge.radius, low, high, start[s], stop[s], centre, across, curvature, conic,
                coefficients, small, u, value, sums,
            ):  # fmt: skip
                return False
            for k in range(first, last):
                if value[k - first] + z > best[k]:
                    best[k], place[k] = value[k - first] + z, u[k - first] - p[k]
        for k in range(count):
            if not low < place[k] < high:
                return False
            top[nearest + way * k], at[nearest + way * k] = best[k], place[k]
    return True


@jit_inline
def in_plane(vertex, along, cosine, sine):
    """Return where a vertex is along a line, its distance from the plane of the line, and its height."""
    return vertex[0] * cosine + vertex[1] * sine - along, vertex[1] * cosine - vertex[0] * sine, vertex[2]


@jit
def steepest(
    along, cosine, sine, start, stop, piece, first, last, vertices, curvature, conic, coefficients
):  # fmt: skip
    """Return bounds of slope and upward bend of the segments first to last; nan beyond the equator of a lenslet.

    The bend is the second derivative along any direction, greatest at the vertex or farthest from it, term by term:
    where it is less than that of the nose, height over the edge is concave. A section of a sphere is a circle, and its
    curvature is sufficient: the edge can only touch where both are as steep, and there it is a maximum. Powers, added
    to the sphere, move the place where they are as steep.
    """
    distant, across_most = 0.0, 0.0
    for s in range(first, last):
        if piece[s] < 0:
            continue
        centre, across, _ = in_plane(vertices[piece[s]], along, cosine, sine)
        for end in (start[s] - centre, stop[s] - centre):
            distant = max(distant, end * end + across * across)
        across_most = max(across_most, across * across)
    r = np.sqrt(distant)
    jet = conic_point(r, 0.0, curvature, conic)
    slope, bend = abs(jet[1]), max(curvature, jet[3])
    if conic == 0.0 and coefficients.size == 1:
        bend = curvature / np.sqrt(1.0 - curvature * curvature * across_most)
    power, added = 1.0, 0.0  # r^(2k - 2), and the curvature of the powers
    for k in range(1, coefficients.size):
        a = coefficients[k]
        slope += 2 * k * abs(a) * r * power
        added += 2 * k * (2 * k - 1) * (a if k == 1 else max(a, 0.0)) * power
        power *= distant
    return slope, bend + added


@jit
def climb(
    p, nose, low, high, start, stop, centre, across, curvature, conic, coefficients, small, u, value, sums
):  # fmt: skip
    """Find the greatest height of one lenslet over the nose at tips ``p``, from start to stop and low to high.

    Fills ``u`` (n,) with where it is, and ``value`` (n,). ``sums`` (4, n) is for `even_sums`, and zeros without powers.
    Newton's method begins where the centre of the nose, the contact and the centre of the vertex sphere are in line,
    and ends with a step of less than ``small``. Return whether it converges.
    """
    n = p.size
    vertex = curvature + (2.0 * coefficients[1] if coefficients.size > 1 else 0.0)
    root = np.sqrt(max(1.0 - vertex * vertex * across * across, 0.0))
    scale = root / (root - nose * vertex)
    for i in range(n):
        u[i] = max(min(centre + (p[i] - centre) * scale, stop, p[i] + high), start, p[i] + low)
    least = 1e-3 / nose
    for _ in range(MAX_STEPS):
        if coefficients.size > 1:
            for i in range(n):
                sums[0, i] = (u[i] - centre) * (u[i] - centre) + across * across
            even_sums(sums, n, coefficients, 6)
        far = 0
        for i in range(n):
            t, x = u[i] - centre, u[i] - p[i]
            sag, slope, _, bend, _, _ = conic_point(t, across, curvature, conic)
            drop = np.sqrt(nose * nose - x * x)
            sag += sums[1, i] - x * x / (nose + drop)
            slope += 2.0 * t * sums[2, i] - x / drop
            bend += 2.0 * sums[2, i] + 8.0 * t * t * sums[3, i] - nose * nose / (drop * drop * drop)
            # At an end of the segment a sphere may curve up more than the nose.
            step = u[i] - slope / min(bend, -least)
            move = max(min(step, stop, p[i] + high), start, p[i] + low) - u[i]
            value[i] = sag + move * (slope + 0.5 * move * bend)
            u[i] += move
            far += not abs(move) <= small
        if far == 0:
            return True
    return False
