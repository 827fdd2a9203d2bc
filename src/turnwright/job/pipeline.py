"""The one pipeline of a job: its stages in their order, each carried out when it is first asked for, and kept."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path as File
from typing import TYPE_CHECKING

from turnwright.access import check_access, check_depths
from turnwright.errors import InputError
from turnwright.job.approach import Entry, entries_of
from turnwright.job.contributions import ErrorBreakdown, break_down_error
from turnwright.job.cutting import chips_of
from turnwright.job.pass_plan import PassPlan, Watch
from turnwright.job.predicting import WHOLE, predict
from turnwright.job.programs import read_back, written
from turnwright.job.result import Pass
from turnwright.job.window import can_predict_window, predict_window
from turnwright.motion import check_limits

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from os import PathLike

    from turnwright.access import Access, AccessFinding
    from turnwright.cutting import ChipMap
    from turnwright.job.cutting import PassChips
    from turnwright.job.result import Prediction
    from turnwright.job.schema import Job, PassTable
    from turnwright.motion import Limits
    from turnwright.part import Part
    from turnwright.path import Motion, Path, Spiral
    from turnwright.post import ProgramFiles
    from turnwright.progress import StageProgress
    from turnwright.tool import Tool

__all__ = ["GOUGE", "Cut", "Pipeline"]

GOUGE = 1e-9
"""Clearance below zero that is rounding. [mm]"""


@lru_cache(maxsize=8)
def _access(part: Part, tool: Tool, sense: int) -> Access:
    """Return the access of a tool; cases that differ in feed and speed share it."""
    return check_access(part, tool, sense=sense)


class Cut:
    """One cut of a pass: the pass itself, or each of its repetitions.

    Parameters
    ----------
    plan
        Of its pass.
    name
        Of the cut.
    depth, left
        How much it takes off, and how much it leaves above the finished surface. [mm]
    motion
        What it commands the axes.
    before
        The motion of the cut before, if there is one.
    watch
        Who is told.
    """

    def __init__(
        self, plan: PassPlan, name: str, depth: float, left: float, motion: Motion, before: Motion | None, watch: Watch
    ) -> None:
        self.plan, self.name, self.depth, self.left = plan, name, depth, left
        self.motion, self._before, self._watch = motion, before, watch

    @cached_property
    def limits(self) -> Limits:
        """What it asks of the axes."""
        with self._watch.stage("limits"):
            return check_limits(self.motion, self.plan.job.machine)

    @cached_property
    def chips(self) -> tuple[PassChips, ChipMap] | str:
        """Its chips, or why they are not found."""
        with self._watch.stage("chips") as tell:
            return chips_of(self.plan.job, self.motion, self._before, self.left, tell)

    def told(self, chips: PassChips | None = None) -> Pass:
        """Return the cut as a result tells it."""
        limits = self.limits
        return Pass(
            name=self.name, allowance=self.left, depth=self.depth, feed=self.plan.feed,
            spindle_rpm=limits.spindle_rpm, points=limits.points, limits=limits, chips=chips,
        )  # fmt: skip


class Pipeline:
    """What becomes of a job, stage by stage: each is carried out when it is first asked for, and kept.

    `run`, `compare`, studies and the workbench stand on it. It refuses nothing that a job can accept: that is in
    `refused`. A place on the part is predicted from its own share of the finishing pass where that leaves the same
    surface (a spiral placed along z, straight lines between its points, no servos), so that the roughness of a patch
    costs a small part of a whole path.

    Parameters
    ----------
    job
        What is asked for.
    progress
        Called with (stage, done, total).
    out
        Folder of the program; one that is thrown away with the pipeline if not given.

    Examples
    --------
    >>> from turnwright.job import Job
    >>> job = Job.read({
    ...     "part": {"surface": {"family": "plane"}, "radius": "2 mm"},
    ...     "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    ...     "machine": {"name": "generic"},
    ...     "strategy": {
    ...         "kind": "slow tool servo", "feed": "10 um/rev", "points_per_rev": 360, "spindle_speed": "100 rpm",
    ...     },
    ...     "simulation": {
    ...         "patches": [
    ...             {"name": "rim", "centre": ["1 mm", "0 mm"], "size": ["0.1 mm", "0.1 mm"], "pixel": "0.37 um"},
    ...         ],
    ...     },
    ... })
    >>> stages = Pipeline(job)
    >>> f"{stages.prediction('rim').roughness.sq_nm:.2f} nm in {stages.minutes:.1f} minutes"
    '7.48 nm in 2.0 minutes'
    """

    def __init__(
        self, job: Job, *, progress: StageProgress | None = None, out: str | PathLike[str] | None = None
    ) -> None:
        self.job, self.watch = job, Watch(progress)
        self._out = None if out is None else File(out)
        self._predictions: dict[str, Prediction] = {}

    @cached_property
    def access(self) -> Access:
        """Whether the tool reaches the part."""
        part, tool, sense = self.job.part.aimed, self.job.tool, self.job.strategy.sense
        with self.watch.stage("access") as tell:
            if self.watch.progress is None:
                return _access(part, tool, sense)
            return check_access(part, tool, sense=sense, progress=tell)

    @cached_property
    def depths(self) -> tuple[AccessFinding, ...]:
        """Whether the chip of each pass stays on the edge."""
        job, depths, stock = self.job, {}, self.job.part.stock
        for cut in job.passes:
            depths[cut.name] = (stock - cut.allowance) / cut.repeats(stock)
            stock = cut.allowance
        with self.watch.stage("depth of cut") as tell:
            return check_depths(
                job.part.aimed, job.tool, depths, inside_out=job.strategy.inside_out, sense=job.strategy.sense,
                progress=tell,
            )  # fmt: skip

    @cached_property
    def finishing(self) -> PassPlan:
        """The plan of the finishing pass."""
        return PassPlan(self.job, watch=self.watch)

    @property
    def feed(self) -> float:
        """Mean advance per revolution of the finishing pass. [mm/rev]."""
        return self.finishing.feed

    @property
    def spiral(self) -> Spiral:
        """Where the tool is sent in the finishing pass, in plan view."""
        return self.finishing.spiral

    @property
    def path(self) -> Path:
        """Where the tool stands in the finishing pass."""
        return self.finishing.path

    @property
    def motion(self) -> Motion:
        """What the finishing pass commands the axes."""
        return self.finishing.commanded

    def cuts(self) -> Iterator[Cut]:
        """Yield every cut of every pass in the order of cutting; a plan of which nothing more is asked is let go."""
        stock, before = self.job.part.stock, None
        for one in self.job.passes:
            plan = self.finishing if one is self.job.passes[-1] else PassPlan(self.job, one, self.watch)
            plan.require_steps()
            for name, depth, left, motion in _repeated(one, plan.commanded, stock):
                yield Cut(plan, name, depth, left, motion, before, self.watch)
                before = motion
            stock = one.allowance

    @cached_property
    def passes(self) -> tuple[Pass, ...]:
        """All passes in the order of cutting, with what they ask of the axes; their chips are in `chips`."""
        return tuple(cut.told() for cut in self.cuts())

    @property
    def limits(self) -> Limits:
        """What the finishing pass asks of the axes."""
        return self.passes[-1].limits

    @property
    def minutes(self) -> float:
        """Time of all passes. [min]."""
        return sum(one.limits.cycle_time_s for one in self.passes) / 60

    @cached_property
    def chips(self) -> tuple[PassChips, ...]:
        """The chips of every pass, in the order of cutting.

        Raises
        ------
        InputError
            If nothing is known of the material, or it is not known what the first pass cuts.
        """
        known = self.job.part.substance
        if known is None or (known.critical is None and known.cutting is None):
            raise InputError(
                "the job names no material, so its chips and forces are not found: state part.material, one of "
                "turnwright material list or the file of one"
            )
        found: list[PassChips] = []
        for cut in self.cuts():
            if isinstance(cut.chips, str):
                raise InputError(cut.chips)
            found.append(cut.chips[0])
        return tuple(found)

    def entries(self, motions: Mapping[str, Motion]) -> dict[str, Entry]:
        """Return how the tool enters every pass, from the motion of each by its name."""
        with self.watch.stage("approach"):
            return entries_of(self.job, motions)

    def write(self, motions: dict[str, Motion], entries: Mapping[str, Entry] | None = None) -> ProgramFiles:
        """Return the program of some motions by the names of their cuts, written into the folder of the pipeline.

        Parameters
        ----------
        motions
            The finishing pass last.
        entries
            How the tool enters each; worked out if not given.
        """
        entries = self.entries(motions) if entries is None else entries
        if self._out is None:
            self._out = File(tempfile.mkdtemp(prefix="turnwright-"))
            weakref.finalize(self, shutil.rmtree, self._out, ignore_errors=True)
        with self.watch.stage("write program") as tell:
            self._out.mkdir(parents=True, exist_ok=True)
            self.program = written(self.job, motions, self._out, tell, entries)
        return self.program

    @cached_property
    def program(self) -> ProgramFiles:
        """The program of all passes, in the folder of the pipeline."""
        return self.write({cut.name: cut.motion for cut in self.cuts()})

    @cached_property
    def read_back(self) -> Motion:
        """The finishing pass of the program, as it is read back."""
        file, name = self.program.files[0], self.job.passes[-1].names(self._stock)[-1]
        with self.watch.stage("read program") as tell:
            return read_back(self.job, file, name, tell)

    @property
    def _stock(self) -> float:
        """What the finishing pass finds above the surface. [mm]."""
        return self.job.passes[-2].allowance if len(self.job.passes) > 1 else self.job.part.stock

    @cached_property
    def predictions(self) -> tuple[Prediction, ...]:
        """What the program read back leaves, the whole part and every patch."""
        return predict(self.job, self.read_back, meant=self.finishing.meant, watch=self.watch)

    @cached_property
    def shares(self) -> ErrorBreakdown:
        """Where the form error of the program read back comes from."""
        part, tool, plan = self.job.part.aimed, self.job.tool, self.finishing
        with self.watch.stage("shares") as tell:
            return break_down_error(
                part, tool, plan.spiral, plan.commanded, again=self.read_back, meant=plan.meant, progress=tell
            )

    def prediction(self, name: str) -> Prediction:
        """Predict what a patch, or the "whole part", will look like, of the motion in memory.

        Parameters
        ----------
        name
            Of the patch, or "whole part".
        """
        if name not in self._predictions:
            self._predictions[name] = self._predicted(name)
        return self._predictions[name]

    @cached_property
    def form_pv_nm(self) -> float:
        """Form error of the whole part, from its highest to its lowest place."""
        known = self._predictions.get(WHOLE)
        if known is None or known.form is None:
            _ = self.motion  # the places between the azimuths of the map count too
            self._predictions[WHOLE] = known = self._predicted(WHOLE)
        return known.pv_nm

    def _predicted(self, name: str) -> Prediction:
        known = [WHOLE, *(patch.name for patch in self.job.simulation.patches)]
        if name not in known:
            raise InputError(f"the job has no patch {name!r}, it predicts {', '.join(known)}: name one of them")
        if "commanded" not in vars(self.finishing) and can_predict_window(self.job):
            found = predict_window(self.job, name)
            if found is not None:
                return found
        return predict(self.job, self.motion, meant=self.finishing.meant, only=(name,))[0]

    @property
    def refused(self) -> tuple[str, ...]:
        """Why `run` would refuse the job, a sentence each; of the stages that were carried out, and of access.

        What the job accepts is not among it.
        """
        accepted, found = self.job.accept, []
        found += [one.sentence for one in self.access.findings if not one.ok and one.name not in accepted]
        if not found:
            found += [one.sentence for one in self.depths if not one.ok]
        if "path" in vars(self.finishing) and "gouge" not in accepted:
            least = float(self.path.clearance.min())
            if least < -GOUGE:
                found.append(
                    f"placed along the {self.job.strategy.along}, the edge cuts {-least * 1e6:.3g} nm below the surface"
                )
        if "passes" in self.__dict__ and "limits" not in accepted:
            found += [f"pass {one.name}: {said}" for one in self.passes for said in one.limits.findings]
        return tuple(found)


def _repeated(cut: PassTable, motion: Motion, stock: float) -> Iterator[tuple[str, float, float, Motion]]:
    """Yield the name of each repetition of a pass, how much it takes off, how much it leaves [mm], and its motion."""
    names = cut.names(stock)
    depth = (stock - cut.allowance) / len(names)
    for name in names:
        stock -= depth
        left = max(stock, 0.0)
        if name == names[-1] and not cut.allowance:
            yield name, depth, left, motion
        else:
            yield name, depth, left, replace(motion, axes={**motion.axes, "Z": motion.axes["Z"] + left})
