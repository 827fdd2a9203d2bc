"""One pass of a job: its spiral placed, driven and, where the job says so, corrected for the servos."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from turnwright.motion import drive
from turnwright.placing import place
from turnwright.tracking import precorrect

if TYPE_CHECKING:
    from collections.abc import Iterator

    from turnwright.job.schema import Job, PassTable
    from turnwright.path import Motion, Path
    from turnwright.progress import Progress, StageProgress

__all__ = ["PassPlan", "Watch", "plan_pass"]


class Watch:
    """Reports the progress of each stage and keeps its time."""

    def __init__(self, progress: StageProgress | None) -> None:
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


class PassPlan(NamedTuple):
    """What becomes of a pass up to its motion."""

    feed: float  # [mm/rev]
    path: Path
    commanded: Motion
    meant: Motion | None  # where the axes are to pass, if what is commanded is corrected for the servos

    @property
    def wanted(self) -> Motion:
        """Where the axes are to pass."""
        return self.commanded if self.meant is None else self.meant


def plan_pass(job: Job, cut: PassTable, watch: Watch | None = None) -> PassPlan:
    """Plan a pass of a job with its tool, on its machine, at the part that it aims at."""
    watch = watch or Watch(None)
    part, tool, machine = job.part.aimed, job.tool, job.machine
    servo = job.servo(cut)
    with watch.stage("plan") as tell:
        spiral = servo.spiral(part, tool, progress=tell)
        if machine.controller.interpolation != "hermite":  # no other asks for rates, so nobody computes the tip's
            spiral = replace(spiral, radius_rate=None, y_rate=None)
    with watch.stage("place") as tell:
        path = place(spiral, part, tool, along=job.strategy.along, progress=tell)
    feed = spiral.feed
    del spiral
    with watch.stage("drive") as tell:
        motion = drive(path, servo, machine)
        if job.program.precorrect:
            return PassPlan(feed, path, precorrect(motion, progress=tell), motion)
    return PassPlan(feed, path, motion, None)
