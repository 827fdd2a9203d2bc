"""Predict the surface that a motion cuts: the maps of a job, with controller interpolation and servo response."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from turnwright._arrays import Floats
from turnwright.chuck import Chuck
from turnwright.errors import InputError
from turnwright.generation import generate, generate_polar
from turnwright.heightmap import HeightMap
from turnwright.job.contributions import finish_nm, lines, require_servos, without_servos
from turnwright.job.cusps import Feeds, cusp_light
from turnwright.job.extremes import find_extremes
from turnwright.job.interpolation import chord_error, interpolate_motion
from turnwright.job.pass_plan import Watch
from turnwright.job.prediction import Prediction
from turnwright.job.schema import Job
from turnwright.job.verdict import WHOLE, form_values
from turnwright.metrology import roughness
from turnwright.part import Part
from turnwright.path import Motion
from turnwright.progress import Progress, StageProgress

__all__ = ["follow_motion", "needs_lines", "predict"]

FORM_POINTS = 4_000_000
"""Most points that a form error is split on; every n-th line and radius of more of them."""

PART_PIXELS = 240
"""Pixels along the longer side of the map of one part of a chuck."""


def predict(
    job: Job,
    motion: Motion,
    *,
    tracking: bool | None = None,
    nominal: Motion | None = None,
    only: Collection[str] | None = None,
    extremes: bool = True,
    watch: Watch | None = None,
    progress: StageProgress | None = None,
) -> tuple[Prediction, ...]:
    """Predict the surface that a motion cuts, on the grids of the job and with its actual tool and machine.

    The interpolation of the controller between points is always included, the response of the servos on request.

    Parameters
    ----------
    job
        The job, with the design and the grids.
    motion
        A motion read back from a program, of this job or any other.
    tracking
        Whether to include the servo response, and to report its contribution; as the job says if not given.
    nominal
        Nominal motion of the axes, if ``motion`` is precorrected for the servos; servo errors are counted from it.
    only
        Names of the maps to predict: patches, "whole part" and the parts of a chuck; all of them if not given.
    extremes
        Whether to find the highest and the lowest point of the whole part; a motion over some azimuths has none.
    watch, progress
        Records the wall time of each stage; or is called with (stage, done, total).

    Raises
    ------
    InputError
        If tracking is requested of a machine without servo data, or no point of a map is cut.
    """
    watch = watch or Watch(progress)
    part, tool, machine = job.part, job.actual_tool, job.actual_machine
    motion, real = follow_motion(job, motion, job.simulation.tracking if tracking is None else tracking, nominal, watch)
    straight = machine.controller.is_straight
    off = 0.0 if straight else max(chord_error(one) for one in (motion, real) if one is not None)

    def make(
        name: str, form: int | str, simulate: Callable[[Motion, Progress], HeightMap], part: Part = part
    ) -> Prediction:
        with watch.stage(f"simulate {name}") as update:
            error = replace(part.form_error(simulate(motion, update)), name=name)
        added = None
        if real is not None:
            with watch.stage(f"simulate {name} with servos") as update:
                planned, error = error, replace(part.form_error(simulate(real, update)), name=name)
            added = replace(error, z=error.z - planned.z, name=f"{name}: servos")
        if np.isnan(error.z).all():
            raise InputError(
                f"none of the {error.z.size:,} points of {name} is cut, the motion has "
                f"{np.ptp(motion.axes['C']) / (2 * np.pi):.4g} rev: check that the program is complete"
            )
        above = int(np.count_nonzero(error.z > part.stock)) if part.stock > 0 else 0
        with watch.stage("roughness"):
            finish = roughness(error, form=form)
        outside = 0 if part.outline is None else int(np.count_nonzero(~part.covers(*error.points())))
        return Prediction(
            name=name, error=error, roughness=finish, tracking=added, above_stock=above, chord_error=off,
            outside=outside,
        )  # fmt: skip

    grid = job.simulation.whole_part
    radius, angle = (
        np.linspace(part.nearest, part.reach, grid.radii),
        np.linspace(0, 2 * np.pi, grid.angles, endpoint=False),
    )

    def whole_part(one: Motion, update: Progress) -> HeightMap:
        return generate_polar(one, tool, radius=radius, angle=angle, machine=machine, progress=update)

    def is_requested(name: str) -> bool:
        return only is None or name in only

    predictions = [make(WHOLE, "none", whole_part)] if is_requested(WHOLE) else []
    if extremes and predictions:
        predictions = [_with_extremes(job, predictions[0], real or motion, watch)]
    for name, form, axes, one_part in filter(lambda one: is_requested(one[0]), _rectangles(job)):

        def rectangle(one: Motion, update: Progress, axes: tuple[Floats, Floats] = axes) -> HeightMap:
            return generate(one, tool, x=axes[0], y=axes[1], machine=machine, progress=update)

        predictions.append(make(name, form, rectangle, one_part))
    return tuple(predictions)


def _rectangles(job: Job) -> Iterator[tuple[str, int | str, tuple[Floats, Floats], Part]]:
    """Yield name, form removal, axes and part of each rectangular map: of the parts of a chuck, and the patches."""
    if isinstance(job.part.surface, Chuck):
        for one in job.part.apart:
            yield one.name, "none", _part_axes(one), one
    for patch in job.simulation.patches:
        yield patch.name, job.roughness.form, patch.axes, job.part


def _part_axes(part: Part) -> tuple[Floats, Floats]:
    """Return columns and rows of the map of one part of a chuck, of square pixels. Each (n,) [mm]."""
    x_low, x_high, low, high = part.border.box
    pixel = max(x_high - x_low, high - low) / PART_PIXELS
    return (
        np.linspace(x_low, x_high, max(round((x_high - x_low) / pixel), 2) + 1),
        np.linspace(low, high, max(round((high - low) / pixel), 2) + 1),
    )


def _with_extremes(job: Job, whole: Prediction, motion: Motion, watch: Watch) -> Prediction:
    """Return the whole part with its highest and lowest point, and with the finish of a job without patches."""
    tool, part, machine = job.actual_tool, job.part, job.actual_machine
    with watch.stage("highest and lowest point") as update:
        form = find_extremes(motion, tool, part, machine=machine, known=whole.error, progress=update)
    ring, values = None, None
    if needs_lines(job):
        with watch.stage("lines across revolutions"):
            radius, angle = lines(part, motion.feed, motion.axes["C"])
            across = part.form_error(generate_polar(motion, tool, radius=radius, angle=angle, machine=machine))
            if _needs_ring(job):
                ring = finish_nm(across, motion.feed)
            if _needs_form(job):
                with suppress(InputError):  # the verdict repeats it and states why
                    values = form_values(part, across.thinned(FORM_POINTS), form)
    limit, order = job.tolerances.cusp_order, None
    if limit is not None:
        with suppress(InputError):  # a part that is curved more than the nose has no cusps there
            order = cusp_light(job, Feeds.of_motion(motion), limit.light).brightest
    return replace(whole, form=form, finish_nm=ring, form_values=values, cusp_order=order)


def needs_lines(job: Job) -> bool:
    """Whether tolerances are judged on lines across all revolutions: finish without a patch, or form call-outs.

    On the grid of the whole part cusps alias to waves of form.
    """
    return _needs_ring(job) or _needs_form(job)


def _needs_form(job: Job) -> bool:
    return any(one.standard == "ISO 10110-5" for one in job.tolerances.call_outs)


def _needs_ring(job: Job) -> bool:
    return job.tolerances.sq is not None and not job.simulation.patches


def follow_motion(
    job: Job, motion: Motion, tracking: bool, nominal: Motion | None, watch: Watch
) -> tuple[Motion, Motion | None]:
    """Return a motion as the controller interpolates it, and as the servos follow it, ``None`` without tracking."""
    machine = job.actual_machine
    real = None
    if tracking:
        require_servos(machine)
        with watch.stage("track") as update:
            real = interpolate_motion(motion, machine, update)
        motion = nominal or motion
    ideal = without_servos(machine, corrected=nominal is not None)
    if ideal.controller.interpolation != "linear":
        with watch.stage("interpolate") as update:
            motion = interpolate_motion(motion, ideal, update)
    return motion, real
