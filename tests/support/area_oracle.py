"""What a point of a polar map stands for, by Simpson's rule, which is exact for the products integrated here."""

import numpy as np


def ring_weights(radius):
    """Integrate r times the straight hat over each radius. (n,) [mm²]."""
    low, high = radius[:-1], radius[1:]
    centre, sixth = (low + high) / 2, (high - low) / 6
    inner = sixth * (1.0 * low + 4 * 0.5 * centre + 0.0 * high)
    outer = sixth * (0.0 * low + 4 * 0.5 * centre + 1.0 * high)
    return np.append(inner, 0.0) + np.append(0.0, outer)
