"""Estimate the steps of a run and the time of each, before it starts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from turnwright.errors import TurnwrightError
from turnwright.job.comparison import strategies_of
from turnwright.job.contributions import has_servos
from turnwright.job.planning import stage_of
from turnwright.job.predicting import needs_lines
from turnwright.job.schema import Job, PassTable
from turnwright.part import Part
from turnwright.progress import Step

__all__ = [
    "steps_of_comparison", "steps_of_correction", "steps_of_diagnosis", "steps_of_measurement", "steps_of_plan",
    "steps_of_prediction", "steps_of_preview", "steps_of_run",
]  # fmt: skip

MILLION = 1e6
ACCESS_S, DEPTH_S, APPROACH_S, OPTICS_S, REPORT_S = 0.6, 0.2, 0.3, 0.5, 2.0
PLAN_S, DRIVE_S, LIMITS_S, CHIPS_S, WRITE_S, READ_S = 0.12, 0.3, 0.06, 0.15, 0.18, 0.18
"""First row: per step. Second row: per million points of a pass. [s]"""

PLACE_S, PLACE_PIECES_S = 0.25, 0.7
"""Per million points on a smooth surface, and on one in pieces. [s]"""

SERVOS_S, EXTREMES_S = 0.5, 0.4
"""Per million points of the finishing pass. [s]"""

HEIGHTS_S, MEASURED_S, DIAGNOSED_S = 1.0, 1.5, 10.0
"""Per million heights: prediction, registration and diagnosis. [s]"""

PROOFS = 2.5
RADII, ANGLES = 24, 72
"""Samples of the curvature of a surface along the spiral."""

USUAL_POINTS = 360
FEWEST_POINTS = 36


def steps_of_run(job: Job) -> tuple[Step, ...]:
    """Return the steps of `run`, and of its report."""
    steps = [Step(stage="access", work=ACCESS_S), Step(stage="depth of cut", work=DEPTH_S)]
    stock = job.part.stock
    material = job.part.substance
    program_points = 0.0
    for cut in job.passes:
        points, times = _points(job, cut), len(cut.names(stock))
        steps += _motion_steps(job, points)
        for _ in range(times):
            steps.append(Step(stage="limits", work=LIMITS_S * points))
            if material is not None:
                steps.append(Step(stage="chips", work=CHIPS_S * points))
        program_points += times * points
        stock = cut.allowance
    points = _points(job, job.passes[-1])
    steps += [
        Step(stage="approach", work=APPROACH_S),
        Step(stage="write program", work=WRITE_S * program_points),
        Step(stage="read program", work=READ_S * program_points),
        Step(stage="compare", work=0.2),
    ]
    steps += steps_of_prediction(job)
    steps.append(Step(stage="check moves", work=0.2))
    if job.optics is not None:
        steps.append(Step(stage="optics", work=OPTICS_S))
    return (*steps, Step(stage="report", work=REPORT_S))


def steps_of_prediction(job: Job, *, tracking: bool | None = None) -> tuple[Step, ...]:
    """Return the steps of `predict`, with servo tracking as the job states if not given."""
    points = _points(job, job.passes[-1])
    follows = job.simulation.tracking if tracking is None else tracking
    steps = [Step(stage="track", work=SERVOS_S * points)] if follows else []
    if job.actual_machine.controller.interpolation != "linear":
        steps.append(Step(stage="interpolate", work=SERVOS_S * points))
    grid = job.simulation.whole_part
    places = {"whole part": grid.radii * grid.angles}
    places |= {one.name: math.prod(axis.size for axis in one.axes) for one in job.simulation.patches}
    for name, heights in places.items():
        work = 0.05 + HEIGHTS_S * heights / MILLION
        steps.append(Step(stage=f"simulate {name}", work=work))
        if follows:
            steps.append(Step(stage=f"simulate {name} with servos", work=work))
        steps.append(Step(stage="roughness", work=0.1 + heights / MILLION))
        if name == "whole part":
            steps.append(Step(stage="highest and lowest point", work=1.5 + EXTREMES_S * points))
            if needs_lines(job):
                steps.append(Step(stage="lines across revolutions", work=0.5))
    return tuple(steps)


def steps_of_preview(job: Job) -> tuple[Step, ...]:
    """Return the steps of `preview`."""
    passes = (Step(stage="plan", work=0.2 + PLAN_S * _points(job, cut)) for cut in job.passes)
    return (Step(stage="access", work=ACCESS_S), *passes, Step(stage="depth of cut", work=DEPTH_S))


def steps_of_plan(job: Job) -> tuple[Step, ...]:
    """Return the steps of `plan`: one for each interpolation that it tries."""
    points = _points(job, job.passes[-1])
    one = sum(step.work for step in _motion_steps(job, points)) + (WRITE_S + READ_S + EXTREMES_S) * points
    work = PROOFS * (one + sum(step.work for step in steps_of_prediction(job, tracking=has_servos(job.actual_machine))))
    controller = job.machine.controller
    tried = (controller.interpolation, *controller.other_interpolations)
    return tuple(Step(stage=stage_of(name), work=work) for name in tried)


def steps_of_comparison(job: Job) -> tuple[Step, ...]:
    """Return the steps of `compare`, and of its report."""
    points = _points(job, job.passes[-1])
    one = sum(step.work for step in _motion_steps(job, points)) + (WRITE_S + READ_S + SERVOS_S) * points + 1.0
    return (
        Step(stage="what the job asks for", work=one / 2),
        *(Step(stage=name, work=one) for name in strategies_of(job)),
        Step(stage="report", work=REPORT_S),
    )


def steps_of_measurement(heights: Sequence[float]) -> tuple[Step, ...]:
    """Return the steps of `measure`, and of its report, for maps of about so many heights each."""
    steps = []
    for count in heights:
        work = 0.2 + MEASURED_S * count / MILLION
        steps += [Step(stage=stage, work=work) for stage in ("register", "clean", "register all points", "judge")]
    return (*steps, Step(stage="report", work=REPORT_S))


def steps_of_diagnosis(heights: Sequence[float]) -> tuple[Step, ...]:
    """Return the steps of `diagnose`, with the measurement of the parts and the report."""
    *steps, report = steps_of_measurement(heights)
    explained = 2.0 + DIAGNOSED_S * min(sum(heights) / MILLION, 1.0)
    return (*steps, Step(stage="diagnose", work=explained), report)


def steps_of_correction(heights: Sequence[float]) -> tuple[Step, ...]:
    """Return the steps of `correct`, with measurement, diagnosis and the report."""
    *steps, report = steps_of_diagnosis(heights)
    return (*steps, Step(stage="verify the correction", work=8.0), Step(stage="simulate", work=3.0), report)


def _motion_steps(job: Job, points: float) -> Iterator[Step]:
    """Yield the steps that make the motion of a pass of so many million points."""
    place = PLACE_PIECES_S if job.part.aimed.surface.in_pieces else PLACE_S
    for stage, work in (("plan", PLAN_S), ("place", place), ("drive", DRIVE_S)):
        yield Step(stage=stage, work=0.1 + work * points)


def _points(job: Job, cut: PassTable) -> float:
    """Return the approximate number of points of a pass, before placing. [million]."""
    part, tool = job.part.aimed, job.tool_of(cut)
    try:
        servo = job.servo(cut)
    except TurnwrightError:  # the run reports it
        return USUAL_POINTS * part.reach / 0.01 / MILLION
    spiral: Any = servo.spiral_strategy
    feed = getattr(spiral, "feed", None) or math.sqrt(8 * tool.actual_radius * spiral.scallop)
    return part.reach / feed * _points_per_rev(spiral, part) / MILLION


def _points_per_rev(spiral: object, part: Part) -> float:
    """Return the approximate number of points per revolution, averaged over the radius."""
    count, arc, chord = (getattr(spiral, name, None) for name in ("points_per_rev", "arc_length", "chord"))
    if count is not None:
        return float(count)
    if arc is not None:
        return float(max(math.pi * part.reach / arc, FEWEST_POINTS))
    if chord is None:
        return USUAL_POINTS
    radius = part.reach * (np.arange(RADII) + 0.5) / RADII
    angle = np.linspace(0, 2 * np.pi, ANGLES, endpoint=False)[:, None]
    cosine, sine = np.cos(angle), np.sin(angle)
    try:
        with np.errstate(all="ignore"):
            zx, zy = part.continuation.gradient(radius * cosine, radius * sine)
            zxx, zxy, zyy = part.continuation.hessian(radius * cosine, radius * sine)
            bend = radius**2 * (zxx * sine**2 - 2 * zxy * sine * cosine + zyy * cosine**2)
            bend -= radius * (zx * cosine + zy * sine)
            mean = 2 * math.pi * float(np.mean(np.sqrt(np.abs(bend) / (8 * chord))))
    except TurnwrightError:  # the surface ends within the part, which the run reports
        return USUAL_POINTS
    return max(mean, FEWEST_POINTS) if math.isfinite(mean) else USUAL_POINTS
