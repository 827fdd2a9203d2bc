"""A round nose on spheres side by side, in closed form. See placing.spheres for the method."""

import numpy as np

from turnwright._kernels import jit
from turnwright._kernels.quadrics import conic_point


@jit
def touch(
    edge, cosine, sine, along, offsets, position,
    segment_offsets, start, stop, piece, vertices, curvature, ratio, top, at,
):  # fmt: skip
    """Bring a round nose down on lines that cross spheres.

    Parameters
    ----------
    cosine, sine, along
        Azimuth of each row, and where its distances begin along it. (rows,)
    offsets, position
        Row i holds the tip positions offsets[i] to offsets[i + 1] of ``position``. [mm]
    segment_offsets, start, stop, piece
        Row i holds the segments segment_offsets[i] to segment_offsets[i + 1], each on the sphere of this number; of a
        negative number there is none.
    vertices, curvature
        Of all spheres. (n, 3) [mm, 1/mm]
    ratio
        Greatest curvature of a section over that of the nose.
    top, at
        Filled: the greatest height over the edge, and where, as distance from the tip. (n,) [mm]

    Returns
    -------
    bool
        Whether all is certain: the nose touches each sphere at one place, and no sphere is steeper than the edge.
    """
    nose = edge.radius
    most = 0
    for row in range(along.size):
        most = max(most, segment_offsets[row + 1] - segment_offsets[row])
    middle, distance, scale = np.empty(most), np.empty(most), np.empty(most)
    for row in range(along.size):
        first, last = segment_offsets[row], segment_offsets[row + 1] - 1
        for s in range(first, last + 1):
            if piece[s] < 0:
                continue
            x, y = vertices[piece[s], 0], vertices[piece[s], 1]
            across = y * cosine[row] - x * sine[row]
            root = np.sqrt(1.0 - curvature * curvature * across * across)  # of the section, over that of the sphere
            if not nose * curvature < ratio * root:
                return False
            # The centres of section and nose are in line with the contact.
            centre = x * cosine[row] + y * sine[row] - along[row]
            middle[s - first], distance[s - first] = centre, across
            scale[s - first] = root / (root - nose * curvature)
            # A sphere is steepest at the ends of a segment; where it is steeper than the edge a flank may touch it.
            for end in (start[s] - centre, stop[s] - centre):
                if not edge.low_slope < conic_point(end, across, curvature, 0.0)[1] < edge.high_slope:
                    return False
        s = first
        for k in range(offsets[row], offsets[row + 1]):
            p = position[k]
            low, high = p + edge.low_u, p + edge.high_u
            while s > first and start[s] > low:
                s -= 1
            while s < last and stop[s] < low:
                s += 1
            best, place, on_arc = -np.inf, 0.0, False
            i = s
            while i <= last and start[i] < high:
                if piece[i] >= 0:
                    centre = middle[i - first]
                    u = centre + (p - centre) * scale[i - first]
                    u = max(min(u, stop[i], high), start[i], low)
                    sag, x = conic_point(u - centre, distance[i - first], curvature, 0.0)[0], u - p
                    value = vertices[piece[i], 2] + sag - x * x / (nose + np.sqrt(nose * nose - x * x))
                    if value > best:
                        best, place, on_arc = value, x, low < u < high
                i += 1
            if not on_arc:
                return False
            top[k], at[k] = best, place
    return True
