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


KINDS = ("flat", "wavy flat", "curved", "curved and wavy", "curved unevenly")


def random_cut(random, kind):
    """Return nose radius, a profile cut by a wavy edge into a part with form or waviness, and the edge over its circle.

    The height of each pass comes from a brute-force search for where its nominal nose touches the part.
    """
    nose, feed = float(random.choice([0.2, 0.5])), random.uniform(0.008, 0.025)
    size, period, phase = random.uniform(2e-6, 10e-6), random.uniform(0.008, 0.05), random.uniform(0, 6)
    bend = random.uniform(0.05, 0.4) if kind.startswith("curved") else 0.0
    uneven = random.uniform(-0.1, 0.1) if kind == "curved unevenly" else 0.0
    waves = random.uniform(20e-6, 100e-6) if "wavy" in kind else 0.0
    length, shift = random.uniform(0.15, 0.6), random.uniform(0, 6)

    def wave(u):
        return size * np.sin(2 * np.pi * u / period + phase)

    def part(r):
        return bend / 2 * r**2 + uneven * r**3 + waves * np.sin(2 * np.pi * r / length + shift)

    at = np.arange(0.02, 0.82, 0.25e-3)
    contact = np.linspace(-0.45 * nose, 0.45 * nose, 1501)
    z = np.full(at.size, np.inf)
    for tip in np.arange(-0.1, 1.0, feed) + random.random() * feed:
        near = np.abs(at - tip) < 0.75 * nose
        u = at[near] - tip
        height = np.max(part(tip + contact) - edge_height(contact, nose))
        z[near] = np.minimum(z[near], height + edge_height(u, nose) - wave(u))
    return nose, as_profile(at, z + 1e-6 * random.standard_normal(at.size)), wave


def off_edge(found, wave, nose):
    """Return how far the waviness of an edge is off, without height and tilt. (n,) [mm]."""
    u = nose * np.sin(found.sweep)
    gauge = np.column_stack([np.ones(u.size), u])
    off = found.deviation - wave(u)
    return off - gauge @ np.linalg.lstsq(gauge, off, rcond=None)[0]
