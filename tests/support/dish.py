"""A concave sphere cut with a tool offset, and what an instrument shows of it."""

from dataclasses import replace

import numpy as np

import turnwright as tw
from turnwright.job import Job

OFFSET = 0.003
DISH = (
    ("part.radius", "2 mm"),
    ("part.surface", {"family": "sphere", "radius": "20 mm"}),
    ("strategy.points_per_rev", 120),
    ("strategy.spindle_speed", "60 rpm"),
    ("simulation.patches", []),
    ("machine.plausible", {"squareness": "5 urad"}),  # else the slide may be what the tool seems to be
    ("measurement.reach", "0.5 mm"),  # of the instrument that sees it
)


def seen(job, file, *, offset=OFFSET, **more):
    """Write what an instrument shows of a job that was cut with a tool offset, 5 nm of noise on it."""
    recipe = Job.load(job)
    part, tool, servo = recipe.part.aimed, recipe.tool, recipe.servo(recipe.passes[-1])
    motion = tw.drive(tw.place(servo.spiral(part, tool), part, tool), servo, recipe.machine)
    axis = np.linspace(-2.1, 2.1, 55)  # not a whole number of feeds apart
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) < 1.95
    z = np.full(x.shape, np.nan)
    z[inside] = tw.generate_points(motion, replace(tool, offset=(offset, 0.0, 0.0)), x=x[inside], y=y[inside])
    z += 5e-6 * np.random.default_rng(5).normal(size=z.shape)
    tw.write_map(tw.HeightMap(x=axis, y=axis, z=z, name="dish", **more), file)
    return file
