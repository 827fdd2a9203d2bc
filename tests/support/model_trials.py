"""Small maps of parts cut with known errors, by the model that the simulator confirmed, and what they show."""

from dataclasses import replace

import numpy as np

import turnwright as tw
from turnwright.diagnosis.model import Deviations, Sweeps, Swept

MACHINE = tw.Machine.load("generic")
TOOL = tw.Tool(nose_radius=1.5, included=np.deg2rad(120), clearance=np.deg2rad(15))
SPHERE = tw.Part(surface=tw.Sphere(radius=10.0), radius=5.0)
FLAT = tw.Part(surface=tw.Plane(slope=(np.tan(np.deg2rad(3)), 0.0)), radius=5.0)
AXIS = np.linspace(-4.95, 4.95, 41)
RIM = 4.94
"""Next to no point of the grid: twelve are 4.95 mm away, on one side of that or the other as a machine rounds. [mm]"""
POWERS = [(3, 4, 5), (1, 2, 3)]

NARROW = [2e-3, 3e-3, 8e-3, 1e-4]
"""Usual widths of the intervals of both offsets, radius error and squareness are less, with powers from the third on.

A drift of Z looks like squareness, an axial motion of the spindle once in a turn like an offset on the flat.
"""

BLUR = 0.25
AS_ONE = 4 * np.pi * (BLUR / (AXIS[1] - AXIS[0])) ** 2
"""Blurred by a normal curve of sigma, 4 pi sigma^2 points count as one."""


def model_maps(parts):
    """Maker of maps of parts cut with any errors."""
    u, v = np.meshgrid(AXIS, AXIS)
    on = (np.hypot(u, v) < RIM) & (np.hypot(u, v) > 0.11)
    swept = [Swept(surface=part.surface, tool=TOOL, sense=1, rim=5.0) for part in parts]
    starts = [one.start(u[on], v[on]) for one in swept]

    def made(errors, rng, noise):
        maps = []
        for one, start in zip(swept, starts, strict=True):
            z = np.full(u.shape, np.nan)
            z[on] = one.heights(u[on], v[on], Sweeps(*(part.copy() for part in start)), errors).z
            maps.append(tw.HeightMap(x=AXIS, y=AXIS, z=z + rng.normal(0, noise, z.shape)))
        return maps

    return made


def sources(powers, trials, first=0):
    """Return how often each source lies in its interval (n,), their widths (trials, n) and what is left (trials,)."""
    parts = [FLAT, SPHERE]
    made = model_maps(parts)
    names = ["offset x", "offset y", "radius error", "squareness", *(f"waviness c{k}" for k in powers)]
    hits, widths, left = np.zeros(len(names)), np.zeros((trials, len(names))), np.zeros(trials)
    for trial in range(trials):
        rng = np.random.default_rng(first + trial)
        truth = [*rng.uniform(-0.005, 0.005, 3), rng.uniform(-5e-5, 5e-5), *rng.uniform(-1e-3, 1e-3, 3)]
        errors = Deviations(
            offset=(truth[0], truth[1], 0.0), radius=truth[2], squareness=truth[3], powers=powers,
            waviness=np.array(truth[4:]),
        )  # fmt: skip
        found = tw.diagnose(made(errors, rng, 2e-5), parts, TOOL, MACHINE, waviness=powers)
        for k, (name, value) in enumerate(zip(names, truth, strict=True)):
            low, high = found[name].interval
            hits[k] += low <= value <= high
            widths[trial, k] = high - low
        left[trial] = found.unexplained_rms_nm
    return hits, widths, left


def neighbours(trials, first=0):
    """Return how often an offset lies in its interval where noise hangs together, and how many points count as one."""
    made = model_maps([SPHERE])
    blur = np.exp(-0.5 * ((AXIS[:, None] - AXIS) / BLUR) ** 2)
    hits, together = 0, []
    for trial in range(trials):
        rng = np.random.default_rng(first + trial)
        (heights,) = made(Deviations(offset=(0.001, 0.0, 0.0)), rng, 0.0)
        rough = blur @ rng.normal(0, 1, (41, 41)) @ blur.T
        heights = replace(heights, z=heights.z + 2e-5 * rough / rough.std())
        found = tw.diagnose(heights, SPHERE, TOOL, MACHINE, error_sources=("offset x", "astigmatism"))
        low, high = found["offset x"].interval
        hits += low <= 0.001 <= high
        together += found.correlated_points
    return hits, np.array(together)
