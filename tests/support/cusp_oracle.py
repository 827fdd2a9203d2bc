"""Cusps of a program by brute force: what the controller makes of its blocks, and where the edges of passes meet.

NumPy alone on formulas for the surfaces: no planner, no placing and no generation of ours. The heights of cusps are
measured as the adaptive servo defines its scallop: along z, from the designed surface up to where the edges of two
neighbouring turns cross, in the plane of an azimuth. Tools are round and upright: e(u) = R - sqrt(R² - u²).
"""

import numpy as np

TURN = 2 * np.pi
BISECTIONS = 52


def bisected(low, high, rising):
    """Return where a rising function has its zero, between ends that bracket it. (...)."""
    low, high = np.array(np.broadcast_arrays(low, high), dtype=np.float64)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        over = rising(middle) > 0
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return (low + high) / 2


def edge(u, nose):
    """Height of a round edge, infinite outside it. (...) [mm]."""
    return nose - np.sqrt(np.where(np.abs(u) < nose, nose * nose - u * u, -np.inf))


def tips(sag, nose, angle, radius, samples=65):
    """Exact heights of tips: the greatest f - e along the edge, from dense samples and the slope between two. (...)."""
    angle, radius = np.broadcast_arrays(angle, radius)
    cosine, sine = np.cos(angle), np.sin(angle)

    def gap(u):
        return sag((radius + u) * cosine, (radius + u) * sine) - nose + np.sqrt(nose * nose - u * u)

    grid = np.sin(np.linspace(-1.0, 1.0, samples) * (np.pi / 3)) * nose
    best, where = np.full(radius.shape, -np.inf), np.zeros(radius.shape, dtype=np.int64)
    for k, u in enumerate(grid):
        here = gap(u)
        where[here > best] = k
        best = np.maximum(best, here)
    low, high = grid[np.maximum(where - 1, 0)], grid[np.minimum(where + 1, samples - 1)]
    # Golden sections until the parabola takes over: the height at a maximum is sure to the square of its place.
    share = (np.sqrt(5.0) - 1) / 2
    a, b = high - share * (high - low), low + share * (high - low)
    at_a, at_b = gap(a), gap(b)
    for _ in range(28):
        left = at_a > at_b
        low, high = np.where(left, low, a), np.where(left, b, high)
        new = np.where(left, high - share * (high - low), low + share * (high - low))
        at_new = gap(new)
        a, b, at_a, at_b = (
            np.where(left, new, b),
            np.where(left, a, new),
            np.where(left, at_new, at_b),
            np.where(left, at_a, at_new),
        )
    return np.maximum(np.maximum(at_a, at_b), best)


def followed(motion, angle):
    """Radius and height of the tip where the controller has turned to an angle; as in a program with velocities or not.

    Straight lines in the axes, or the cubics through positions and velocities, of C too. (n,) [mm], (n,) [mm]
    """
    sense = np.sign(motion.axes["C"][-1] - motion.axes["C"][0])
    turned = sense * motion.axes["C"]
    k = np.clip(np.searchsorted(turned, sense * angle, side="right") - 1, 0, turned.size - 2)
    span = motion.time[k + 1] - motion.time[k]

    def along(letter, u):
        p, q = motion.axes[letter][k], motion.axes[letter][k + 1]
        if motion.velocity is None:
            return p + u * (q - p)
        a, b = span * motion.velocity[letter][k], span * motion.velocity[letter][k + 1]
        return p + u * (a + u * (3 * (q - p) - 2 * a - b + u * (a + b - 2 * (q - p))))

    u = bisected(np.zeros(k.size), np.ones(k.size), lambda u: sense * (along("C", u) - angle))
    return along("X", u), along("Z", u)


def cusps(sag, nose, inner, outer, angle):
    """Radius and height above the surface of the crossings of two passes, each (radius, height of the tip). (...)."""
    (near, near_z), (far, far_z) = inner, outer
    # Rising all along: the far edge comes down while the near one goes up.
    at = bisected(
        far - 0.999 * nose,
        near + 0.999 * nose,
        lambda r: (near_z + edge(r - near, nose)) - (far_z + edge(r - far, nose)),
    )
    return at, near_z + edge(at - near, nose) - sag(at * np.cos(angle), at * np.sin(angle))
