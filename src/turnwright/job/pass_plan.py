"""The stages of one pass of a job, from the spiral to its motion, and the surface after the finishing pass."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property

import numpy as np

from turnwright._arrays import Floats
from turnwright.errors import InputError
from turnwright.generation import generate_points
from turnwright.job.lead_out import add_lead_out
from turnwright.job.schema import Job, PassTable
from turnwright.motion import drive
from turnwright.part import Part
from turnwright.path import Motion, Path, Spiral
from turnwright.placing import place
from turnwright.progress import Progress, StageProgress
from turnwright.strategy import Strategy
from turnwright.tracking import precorrect

__all__ = ["PassPlan", "Watch", "across_feed", "cut_heights", "feed_of", "motion_of"]

PLACES_PER_FEED = 8
"""Points across a feed; the error of their mean is at most 0.4/64 of the cusp height."""


class Watch:
    """Report the progress of each stage, and record its wall time."""

    def __init__(self, progress: StageProgress | None = None) -> None:
        self.progress = progress
        self.timings: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Time a stage and yield the function that reports its progress."""

        def update(done: int, total: int) -> None:
            if self.progress is not None:
                self.progress(name, done, total)

        update(0, 1)
        start = time.perf_counter()
        yield update
        self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - start
        update(1, 1)


class PassPlan:
    """The stages of a pass up to its axis motion, the finishing pass by default; each is computed on first access."""

    def __init__(self, job: Job, cut: PassTable | None = None, watch: Watch | None = None) -> None:
        self.cut = job.passes[-1] if cut is None else cut
        self.job = job.for_pass(self.cut)
        self._watch = watch or Watch()

    @cached_property
    def servo(self) -> Strategy:
        """The strategy of the pass, on the job's machine."""
        return self.job.servo(self.cut)

    @cached_property
    def target(self) -> Part:
        """The part that the tool is placed on."""
        return self.servo.target(self.job.part)

    @cached_property
    def spiral(self) -> Spiral:
        """The spiral of the tool tip in plan view."""
        with self._watch.stage("plan") as update:
            spiral = self.servo.spiral(self.target, self.job.tool, progress=update)
        if self.job.machine.controller.interpolation == "hermite":
            return spiral
        return replace(spiral, radius_rate=None, y_rate=None)  # only Hermite blocks use rates

    def require_steps(self) -> None:
        """Raise if C turns by 180 deg or more between two points, which leaves its direction ambiguous."""
        step = float(np.abs(np.diff(self.spiral.angle)).max(initial=0.0))
        if step >= np.pi:
            raise InputError(
                f"pass {self.cut.name}: C must turn by less than 180 deg from point to point, arc_length makes it "
                f'{np.degrees(step):.4g} deg near the axis: state max_step as well, such as max_step = "10 deg"'
            )

    @cached_property
    def feed(self) -> float:
        """Mean advance per revolution; in spindle mode along the path. [mm/rev]."""
        mode = self.servo.spindle_mode
        return self.spiral.feed if mode is None else mode.feed

    @cached_property
    def path(self) -> Path:
        """The path of the tool tip in contact with the part."""
        spiral = self.spiral
        with self._watch.stage("place") as update:
            return place(spiral, self.target, self.job.tool, along=self.servo.along, progress=update)

    @cached_property
    def planned(self) -> Motion:
        """The motion that the axes are to follow."""
        path, servo, height = self.path, self.servo, self.job.program.lead_out
        with self._watch.stage("drive"):
            motion = drive(path, servo, self.job.machine)
            if height is None or servo.spindle_mode is not None or self.target.leaves_air:
                return motion
            return add_lead_out(motion, self.target.aimed, self.job.tool, self.job.machine, height)

    @cached_property
    def commanded(self) -> Motion:
        """The motion of the program: the planned one, precorrected for the servos if the job says so."""
        planned = self.planned
        if not self.job.program.precorrect:
            return planned
        with self._watch.stage("drive") as update:
            return precorrect(planned, progress=update)

    def forget(self, *stages: str) -> None:
        """Free the results of some stages; the next access computes them again."""
        for name in stages:
            vars(self).pop(name, None)

    @property
    def nominal(self) -> Motion | None:
        """The planned motion, if the commanded one is precorrected for the servos; else ``None``."""
        return self.planned if self.job.program.precorrect else None


def feed_of(job: Job) -> float:
    """Return the feed that a job states for its finishing pass, or 0. [mm/rev]."""
    return job.passes[-1].feed or getattr(job.strategy.spiral_strategy, "feed", None) or 0.0


def motion_of(job: Job) -> Motion:
    """Return the motion of a job's finishing pass."""
    return PassPlan(job).planned


def cut_heights(motion: Motion, real: Job, x: Floats, y: Floats) -> Floats:
    """Return the heights after a motion with the tool and machine of a job. (n,) [mm]."""
    return generate_points(motion, real.tool, x=x, y=y, machine=real.machine)


def across_feed(job: Job, x: Floats, y: Floats, places: int = PLACES_PER_FEED) -> tuple[Floats, Floats]:
    """Return points across a feed around each point, to average over cusps. Each (n, places) [mm]."""
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    feed = feed_of(job)
    inside = np.minimum(radius, job.part.reach - feed / 2)  # the surface may end at the rim
    across = np.abs(inside[:, None] + feed * ((np.arange(places) + 0.5) / places - 0.5))
    return across * np.cos(angle)[:, None], across * np.sin(angle)[:, None]
