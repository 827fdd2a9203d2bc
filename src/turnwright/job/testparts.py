"""Jobs for test parts: simple shapes cut before the part, to diagnose tool and machine by their form errors."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from turnwright.access import check_access
from turnwright.errors import JobError
from turnwright.job.pass_plan import PassPlan, Watch
from turnwright.job.schema import Job, SimulationTable, Tolerances
from turnwright.motion import check_limits
from turnwright.progress import StageProgress
from turnwright.strategy import HybridToolServo
from turnwright.surface import Plane, Sphere, Surface

__all__ = ["TestPartKind", "make_test_part"]

TestPartKind: TypeAlias = Literal["tilted flat", "concave sphere"]

MIN_SLOPE_RAD = np.deg2rad(3.0)
"""Least slope of a test part, for a nearly flat part; [Troutman2016]_ ch. 6 tilts its flat by this. [rad]"""

MAX_SLOPE_RAD = np.deg2rad(45.0)
"""Largest tilt or rim slope that an interferometer measures. [rad]"""


def make_test_part(
    job: Job,
    kind: TestPartKind,
    *,
    radius: float | None = None,
    slope: float | None = None,
    progress: StageProgress | None = None,
) -> Job:
    r"""Return the job of a test part, cut like the part: same tool, machine, servo, feed, points and speed.

    On a flat tilted by :math:`\tau` the contact moves along the nose between :math:`-\tau` and :math:`\tau` in every
    revolution; on a concave sphere of radius :math:`a / \sin\varphi` it moves from the tip at the axis to
    :math:`\varphi` at the rim a. The default slope covers the angles of the nose that the part uses, to the next tenth
    of a degree, and is at least 3 degrees.

    Parameters
    ----------
    job
        The job of the part.
    kind
        "tilted flat" or "concave sphere".
    radius
        Clear semi-diameter of the test part; that of the part if not given. [mm]
    slope
        Tilt of the flat, or slope of the sphere at its rim. [rad]
    progress
        Called with (stage, done, total).

    Raises
    ------
    JobError
        If the kind is unknown, or slope or radius are out of the range of the tool.

    Sources
    -------
    [Troutman2016]_ ch. 6.
    """
    if kind not in ("tilted flat", "concave sphere"):
        raise JobError(f'test part must be "tilted flat" or "concave sphere", got {kind!r}')
    part, tool = job.part, job.tool
    sweep = check_access(part, tool, sense=job.strategy.sense).sweep
    if slope is None:
        slope = np.deg2rad(math.ceil(np.rad2deg(max(-sweep[0], sweep[1], MIN_SLOPE_RAD)) * 10 - 1e-6) / 10)
    if not 0 < slope <= MAX_SLOPE_RAD:
        raise JobError(
            f"the test part has a slope of {np.rad2deg(slope):.4g} deg, above 0 and up to "
            f"{np.rad2deg(MAX_SLOPE_RAD):g} deg is allowed"
        )
    radius = part.reach if radius is None else radius
    if kind == "tilted flat":
        surface: Surface = Plane(slope=(math.tan(slope), 0.0))
        name = f"flat tilted by {np.rad2deg(slope):.4g} deg"
    else:
        curve = float(f"{radius / math.sin(slope):.4g}")
        if curve <= tool.actual_radius:
            raise JobError(
                f"a sphere of {radius:g} mm semi-diameter with {np.rad2deg(slope):.4g} deg at its rim has a radius of "
                f"{curve:.4g} mm, it must exceed the nose radius of {tool.actual_radius:g} mm: state a larger "
                "semi-diameter or less slope"
            )
        surface = Sphere(radius=curve)
        name = f"concave sphere R {curve:.4g} mm"
    strategy = job.strategy
    if isinstance(strategy, HybridToolServo):
        strategy = replace(strategy, base=None)  # the motion of the slide is specific to the part
    if strategy.spindle_rpm is None and strategy.spindle_speeds is None:
        strategy = strategy.with_fields(spindle_rpm=_find_speed(job, progress))
    flat = replace(part, surface=surface, radius=radius, name=f"{name}, test part", correction=None, blank=None)
    return replace(job, part=flat, strategy=strategy, simulation=SimulationTable(), tolerances=Tolerances())


def _find_speed(job: Job, progress: StageProgress | None) -> float:
    """Return the spindle speed of the finishing pass of a part. [rev/min]."""
    with Watch(progress).stage("speed of the part"):
        rpm = check_limits(PassPlan(job).planned, job.machine).spindle_rpm
    # Rounded down, so that the part stays within the limits of the machine.
    return math.floor(rpm * 1000) / 1000
