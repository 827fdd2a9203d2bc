"""One pass of a job, stage by stage: its spiral, placed, driven and, if the job says so, corrected for the servos."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from turnwright.errors import InputError
from turnwright.motion import drive
from turnwright.placing import place
from turnwright.tracking import precorrect

if TYPE_CHECKING:
    from collections.abc import Iterator

    from turnwright.job.schema import Job, PassTable
    from turnwright.path import Motion, Path, Spiral
    from turnwright.progress import Progress, StageProgress
    from turnwright.strategy import Strategy

__all__ = ["PassPlan", "Watch"]


class Watch:
    """Reports the progress of each stage and keeps its time."""

    def __init__(self, progress: StageProgress | None = None) -> None:
        self.progress = progress
        self.timings: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Run a stage; what it yields is its own progress."""

        def tell(done: int, total: int) -> None:
            if self.progress is not None:
                self.progress(name, done, total)

        tell(0, 1)
        start = time.perf_counter()
        yield tell
        self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - start
        tell(1, 1)


class PassPlan:
    """What becomes of a pass up to its motion; each stage is carried out when it is first asked for, and kept.

    Parameters
    ----------
    job
        What is asked for.
    cut
        One of its passes; the finishing pass if not given.
    watch
        Who is told, and keeps the time.
    """

    def __init__(self, job: Job, cut: PassTable | None = None, watch: Watch | None = None) -> None:
        self.job, self.cut = job, job.passes[-1] if cut is None else cut
        self._watch = watch or Watch()

    @cached_property
    def servo(self) -> Strategy:
        """The strategy of the pass, on the job's machine."""
        return self.job.servo(self.cut)

    @cached_property
    def spiral(self) -> Spiral:
        """Where the tool is sent, in plan view."""
        with self._watch.stage("plan") as tell:
            spiral = self.servo.spiral(self.job.part.aimed, self.job.tool, progress=tell)
        if self.job.machine.controller.interpolation == "hermite":
            return spiral
        return replace(spiral, radius_rate=None, y_rate=None)  # nobody asks for rates, so that of the tip is not found

    def require_steps(self) -> None:
        """Raise where C turns by half a turn or more from point to point: no program tells which way."""
        step = float(np.abs(np.diff(self.spiral.angle)).max(initial=0.0))
        if step >= np.pi:
            raise InputError(
                f"arc_length turns C by {np.degrees(step):.4g} deg from point to point near the axis in the pass "
                f'{self.cut.name}, the limit is below 180 deg: state max_step as well, such as max_step = "10 deg"'
            )

    @cached_property
    def feed(self) -> float:
        """Mean advance per revolution. [mm/rev]."""
        return self.spiral.feed

    @cached_property
    def path(self) -> Path:
        """Where the tool stands."""
        spiral = self.spiral
        with self._watch.stage("place") as tell:
            return place(spiral, self.job.part.aimed, self.job.tool, along=self.servo.along, progress=tell)

    @cached_property
    def wanted(self) -> Motion:
        """Where the axes are to pass."""
        path = self.path
        with self._watch.stage("drive"):
            return drive(path, self.servo, self.job.machine)

    @cached_property
    def commanded(self) -> Motion:
        """What the program says: what is wanted, corrected for the servos if the job says so."""
        wanted = self.wanted
        if not self.job.program.precorrect:
            return wanted
        with self._watch.stage("drive") as tell:
            return precorrect(wanted, progress=tell)

    def forget(self, *stages: str) -> None:
        """Let go of what some stages have made, to save memory; asked again they are carried out anew."""
        for name in stages:
            vars(self).pop(name, None)

    @property
    def meant(self) -> Motion | None:
        """Where the axes are to pass, if what is commanded is corrected for the servos."""
        return self.wanted if self.job.program.precorrect else None
