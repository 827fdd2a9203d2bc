"""Places and ranges of values. NumPy's own functions for them make numba import SciPy's linear algebra."""

import numpy as np

from turnwright._kernels import jit


@jit
def interval(nodes, at):
    """Return the number of the interval of ascending ``nodes`` that holds ``at``, the first or last beyond them."""
    last = nodes.size - 2
    guess = (at - nodes[0]) / (nodes[last + 1] - nodes[0]) * (last + 1)
    if not guess > 0.0:
        return 0
    k = last if guess > last else np.int64(guess)
    if nodes[k] <= at < nodes[k + 1]:
        return k
    low, high = 0, last + 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= at:
            low = middle
        else:
            high = middle
    return low


@jit
def span(values, start, stop):
    """Return the lowest and the highest of some ``values``."""
    low, high = values[start], values[start]
    for k in range(start + 1, stop):
        low, high = min(low, values[k]), max(high, values[k])
    return low, high
