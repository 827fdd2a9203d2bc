"""Jobs for artefacts: plain shapes cut before the part, whose errors say what is wrong with tool and machine."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from turnwright.access import check_access
from turnwright.errors import JobError
from turnwright.job.pass_plan import PassPlan
from turnwright.job.schema import SimulationTable, Tolerances
from turnwright.motion import check_limits
from turnwright.strategy import HybridToolServo
from turnwright.surface import Plane, Sphere, Surface

if TYPE_CHECKING:
    from turnwright.job.schema import Job
    from turnwright.progress import StageProgress

__all__ = ["Artefact", "artefact"]

Artefact: TypeAlias = Literal["tilted flat", "concave sphere"]

LEAST = np.deg2rad(3.0)
"""Slope of an artefact for a part that is nearly flat; [Troutman2016]_ ch. 6 tilts its flat by this. [rad]"""

STEEPEST = np.deg2rad(45.0)
"""A tilt or rim steeper than this is no artefact that an interferometer sees. [rad]"""


def artefact(
    job: Job,
    kind: Artefact,
    *,
    radius: float | None = None,
    slope: float | None = None,
    progress: StageProgress | None = None,
) -> Job:
    r"""Return the job of an artefact, cut as the part will be: same tool, machine, servo, feed, points and speed.

    On a flat tilted by :math:`\tau` the contact sweeps the nose between :math:`-\tau` and :math:`\tau` in every turn;
    on a concave sphere of radius :math:`a / \sin\varphi` it goes from the tip at the axis to :math:`\varphi` at the rim
    a. Unless stated, the slope covers what the part needs of the nose, to the next tenth of a degree, and is at least 3
    degrees.

    Parameters
    ----------
    job
        That of the part.
    kind
        "tilted flat" or "concave sphere".
    radius
        Clear radius of the artefact; that of the part if not given. [mm]
    slope
        Tilt of the flat, or slope of the sphere at its rim. [rad]
    progress
        Called with (stage, done, total).

    Raises
    ------
    JobError
        If there is no such artefact, or its slope or radius does not suit the tool.

    Sources
    -------
    [Troutman2016]_ ch. 6.
    """
    if kind not in ("tilted flat", "concave sphere"):
        raise JobError(f'artefact is {kind!r}, it must be "tilted flat" or "concave sphere": name one of them')
    part, tool = job.part, job.tool
    sweep = check_access(part, tool, sense=job.strategy.sense).sweep
    if slope is None:
        slope = np.deg2rad(math.ceil(np.rad2deg(max(-sweep[0], sweep[1], LEAST)) * 10 - 1e-6) / 10)
    if not 0 < slope <= STEEPEST:
        raise JobError(
            f"the artefact has a slope of {np.rad2deg(slope):.4g} deg, the limits are 0 to {np.rad2deg(STEEPEST):g} "
            "deg: state a slope within them"
        )
    radius = part.radius if radius is None else radius
    if kind == "tilted flat":
        surface: Surface = Plane(slope=(math.tan(slope), 0.0))
        name = f"flat tilted by {np.rad2deg(slope):.4g} deg"
    else:
        curve = float(f"{radius / math.sin(slope):.4g}")
        if curve <= tool.actual_radius:
            raise JobError(
                f"a sphere of {radius:g} mm with {np.rad2deg(slope):.4g} deg at its rim has a radius of {curve:.4g} "
                f"mm, the nose has {tool.actual_radius:g} mm: state a larger radius or less slope"
            )
        surface = Sphere(radius=curve)
        name = f"concave sphere R {curve:.4g} mm"
    strategy = job.strategy
    if isinstance(strategy, HybridToolServo):
        strategy = replace(strategy, base=None)  # the share of the slide belongs to the part
    if strategy.spindle_rpm is None and strategy.spindle_speeds is None:
        strategy = strategy.stating(spindle_rpm=_speed(job, progress))
    flat = replace(part, surface=surface, radius=radius, name=f"{name}, artefact", correction=None, blank=None)
    return replace(job, part=flat, strategy=strategy, simulation=SimulationTable(), tolerances=Tolerances())


def _speed(job: Job, progress: StageProgress | None) -> float:
    """Return the speed that the finishing pass of a part comes to. [rev/min]."""
    told = progress or (lambda _stage, _done, _total: None)
    told("speed of the part", 0, 1)
    rpm = check_limits(PassPlan(job).planned, job.machine).spindle_rpm
    told("speed of the part", 1, 1)
    # Not a digit faster than the machine's limits let the part go.
    return math.floor(rpm * 1000) / 1000
