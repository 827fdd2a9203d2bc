"""Predict the surface after the finishing pass of a job."""

from __future__ import annotations

import numpy as np

from turnwright._arrays import Floats
from turnwright.generation import generate_points
from turnwright.job.pass_plan import PassPlan
from turnwright.job.schema import Job
from turnwright.path import Motion

__all__ = ["across_feed", "cut_by", "feed_of", "motion_of"]

PLACES_PER_FEED = 8
"""Points across a feed; the error of their mean is at most 0.4/64 of the cusp height."""


def feed_of(job: Job) -> float:
    """Return the feed that a job states for its finishing pass, or 0. [mm/rev]."""
    return job.passes[-1].feed or getattr(job.strategy.spiral_strategy, "feed", None) or 0.0


def motion_of(job: Job) -> Motion:
    """Return the motion of a job's finishing pass."""
    return PassPlan(job).planned


def cut_by(motion: Motion, real: Job, x: Floats, y: Floats) -> Floats:
    """Return the heights after a motion with the tool and machine of a job. (n,) [mm]."""
    return generate_points(motion, real.tool, x=x, y=y, machine=real.machine)


def across_feed(job: Job, x: Floats, y: Floats, places: int = PLACES_PER_FEED) -> tuple[Floats, Floats]:
    """Return points across a feed around each point, to average over cusps. Each (n, places) [mm]."""
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    feed = feed_of(job)
    inside = np.minimum(radius, job.part.radius - feed / 2)  # the surface may end at the rim
    across = np.abs(inside[:, None] + feed * ((np.arange(places) + 0.5) / places - 0.5))
    return across * np.cos(angle)[:, None], across * np.sin(angle)[:, None]
