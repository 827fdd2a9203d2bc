"""Profiles across cusps, by a brute-force minimum over every pass of a nose on a paraboloid. No kernel of ours."""

import numpy as np

from turnwright.profile import Profile

NOSE = 0.2
CONTACT = np.linspace(-0.05, 0.05, 20_001)
"""Places on the nose at which a pass may touch the design."""


def as_profile(at, z):
    return Profile(distance=at, z=z, x=at, y=np.zeros(at.size))


def edge_height(u, nose=NOSE):
    return nose - np.sqrt(nose**2 - u**2)


def cut(tips, at, *, bend=0.0, wave=lambda u: 0.0 * u):
    """Heights over the design z = bend / 2 r² that passes at ``tips`` leave on both sides of the axis. (n,) [mm]"""
    lowest = np.full(at.size, np.inf)
    reach = min(CONTACT[-1] + 3 * np.abs(np.diff(tips)).max(), 0.9 * NOSE)
    for tip in tips:
        z = np.max(bend / 2 * (tip + CONTACT) ** 2 - edge_height(CONTACT))  # the nominal nose touches the design
        for side in (-1, 1):
            u = side * at - tip
            near = np.abs(u) < reach
            lowest[near] = np.minimum(lowest[near], z + edge_height(u[near]) + wave(u[near]))
    return lowest - bend / 2 * at * at
