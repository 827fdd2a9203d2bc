"""The pipeline of a job: its stages in order, each computed on first access and cached."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from os import PathLike
from pathlib import Path as File

import numpy as np

from turnwright.access import Access, AccessFinding, check_access, check_depths
from turnwright.cutting import ChipMap
from turnwright.errors import InputError
from turnwright.job.approach import Entry, entries_of
from turnwright.job.contributions import ErrorBreakdown, break_down_error
from turnwright.job.cut_range import cut_range, trim
from turnwright.job.cutting import PassChips, chips_of
from turnwright.job.links import read_and_check
from turnwright.job.optics import OpticalPerformance, predict_optics
from turnwright.job.pass_plan import PassPlan, Watch
from turnwright.job.predicting import predict
from turnwright.job.prediction import Prediction
from turnwright.job.programs import write_programs
from turnwright.job.result import Pass
from turnwright.job.schema import Job, PassTable
from turnwright.job.verdict import WHOLE
from turnwright.job.window import can_predict_window, predict_window
from turnwright.motion import Limits, check_limits
from turnwright.path import Motion, Path, Spiral
from turnwright.post import ProgramFiles
from turnwright.progress import StageProgress
from turnwright.strategy import Strategy
from turnwright.tool import Tool

__all__ = ["Cut", "Pipeline", "describe_gouge"]

GOUGE = 1e-9
"""Depth below the surface up to which a negative clearance is rounding. [mm]"""


_check_access = lru_cache(maxsize=8)(check_access)
"""Check the access of a tool; jobs that differ only in feed and speed share the result."""


@dataclass(frozen=True, eq=False)
class Cut:
    """One cut of a pass, the pass itself or each of its repetitions.

    Depth, remaining allowance, and the height of the cusps before it where another tool has left them [mm]; its motion
    and that of the cut before with the same tool.
    """

    plan: PassPlan
    name: str
    depth: float
    allowance: float
    motion: Motion
    before: Motion | None
    cusps: float
    watch: Watch

    @cached_property
    def limits(self) -> Limits:
        """Speed, acceleration and jerk of the axes against the limits of the machine."""
        with self.watch.stage("limits"):
            return check_limits(self.motion, self.plan.job.machine)

    @cached_property
    def chips(self) -> tuple[PassChips, ChipMap] | str:
        """Uncut chip thickness along the cut, or the reason why it is not computed."""
        with self.watch.stage("chips") as update:
            return chips_of(self.plan.job, self.motion, self.before, self.allowance, self.depth + self.cusps, update)

    def as_pass(self, chips: PassChips | None = None) -> Pass:
        """Return the cut as an entry of `Result.passes`."""
        limits = self.limits
        return Pass(
            name=self.name, allowance=self.allowance, depth=self.depth, feed=self.plan.feed,
            spindle_rpm=limits.spindle_rpm, points=limits.points, limits=limits, chips=chips,
        )  # fmt: skip


class Pipeline:
    """The stages of a job, each computed on first access and cached.

    `run`, `compare`, studies and the workbench are built on it. It raises no error for a finding that a job can accept:
    those are listed in `refused`. A patch is predicted from the part of the finishing pass that cuts it, where that
    gives the same surface (a spiral placed along z, linear interpolation, no servos). The roughness of a patch then
    costs a small fraction of the whole path.

    Parameters
    ----------
    out
        Folder of the program; if not given, a temporary one that is deleted with the pipeline.

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
        return self._access_of(self.job.tool, self.job.strategy)

    @cached_property
    def findings(self) -> tuple[AccessFinding, ...]:
        """The findings of the tool, then those of the tools of roughing passes, which name their pass."""
        findings = list(self.access.findings)
        for cut in self.job.passes:
            if cut.tool is not None:
                access = self._access_of(cut.tool, self.job.servo(cut))
                findings += [replace(one, sentence=f"pass {cut.name}: {one.sentence}") for one in access.findings]
        return tuple(findings)

    def _access_of(self, tool: Tool, strategy: Strategy) -> Access:
        """Return whether a tool reaches the part where a strategy moves it."""
        part, sense, lead_in = self.job.part.aimed, strategy.sense, getattr(strategy, "lead_in", None) or 0.0
        with self.watch.stage("access") as update:
            if self.watch.progress is None:
                return _check_access(part, tool, sense=sense, lead_in=lead_in)
            return check_access(part, tool, sense=sense, lead_in=lead_in, progress=update)

    @cached_property
    def depths(self) -> tuple[AccessFinding, ...]:
        """Whether the depth of cut of each pass stays within the cutting edge."""
        job, stock = self.job, self.job.part.stock
        by_tool: dict[Tool, dict[str, float]] = {}
        for cut in job.passes:
            depths = by_tool.setdefault(job.tool_of(cut), {})
            depths[cut.name] = (stock - cut.allowance) / cut.repeats(stock)
            stock = cut.allowance
        with self.watch.stage("depth of cut") as update:
            checked = [
                check_depths(
                    job.part.aimed, tool, depths, inside_out=job.strategy.inside_out, sense=job.strategy.sense,
                    progress=update,
                )
                for tool, depths in by_tool.items()
            ]  # fmt: skip
        return tuple(finding for findings in checked for finding in findings)

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
        """The spiral of the finishing pass in plan view."""
        return self.finishing.spiral

    @property
    def path(self) -> Path:
        """The path of the tool tip in the finishing pass."""
        return self.finishing.path

    @property
    def motion(self) -> Motion:
        """The commanded motion of the axes in the finishing pass."""
        return self.finishing.commanded

    def cuts(self) -> Iterator[Cut]:
        """Yield every cut of every pass in the order of cutting; plans are freed as soon as possible."""
        stock, before, last, cusps = self.job.part.stock, None, None, 0.0
        for one in self.job.passes:
            plan = self.finishing if one is self.job.passes[-1] else PassPlan(self.job, one, self.watch)
            if last is not None and last.job.tool != plan.job.tool:  # its chips are those of the stock that is left
                before, cusps = None, last.feed**2 / (8 * last.job.tool.actual_radius)
            last = plan
            plan.require_steps()
            for name, depth, allowance, repeated in _repeat(one, plan.commanded, stock):
                between = cut_range(self.job.part.aimed, plan.job.tool, allowance)
                motion: Motion | None = repeated
                if one is not self.job.passes[-1]:
                    motion = None if between is None else trim(repeated, between)
                if motion is None:  # the blank is nowhere above this cut
                    continue
                if before is not None and np.ptp(before.axes["X"]) < np.ptp(motion.axes["X"]):
                    before = None  # it reaches beyond the cut before, where the material is that of the blank
                yield Cut(plan, name, depth, allowance, motion, before, cusps, self.watch)
                before, cusps = motion, 0.0
            stock = one.allowance

    @cached_property
    def passes(self) -> tuple[Pass, ...]:
        """All passes in the order of cutting with their limits, without chips; those are in `chips`."""
        return tuple(cut.as_pass() for cut in self.cuts())

    @property
    def limits(self) -> Limits:
        """Speed, acceleration and jerk of the axes in the finishing pass against the limits of the machine."""
        return self.passes[-1].limits

    @property
    def minutes(self) -> float:
        """Cycle time of all passes. [min]."""
        return sum(one.limits.cycle_time_s for one in self.passes) / 60

    @cached_property
    def chips(self) -> tuple[PassChips, ...]:
        """Uncut chip thickness and forces of every pass, in the order of cutting.

        Raises
        ------
        InputError
            If the job names no material with data, or the part states no stock for the first pass.
        """
        material = self.job.part.substance
        if material is None or (material.critical is None and material.cutting is None):
            raise InputError(
                "chip thickness and forces need a material, the job names none with data: state part.material, a name "
                "of `turnwright material list` or a material file"
            )
        all_chips: list[PassChips] = []
        for cut in self.cuts():
            if isinstance(cut.chips, str):
                raise InputError(cut.chips)
            all_chips.append(cut.chips[0])
        return tuple(all_chips)

    def entries(self, motions: Mapping[str, Motion]) -> dict[str, Entry]:
        """Plan how the tool enters the material in every pass, given the motions by pass name."""
        with self.watch.stage("approach"):
            return entries_of(self.job, motions)

    def write(self, motions: dict[str, Motion], entries: Mapping[str, Entry] | None = None) -> ProgramFiles:
        """Write a program into the folder of the pipeline, from the motions by the names of their cuts, in order."""
        entries = self.entries(motions) if entries is None else entries
        if self._out is None:
            self._out = File(tempfile.mkdtemp(prefix="turnwright-"))
            weakref.finalize(self, shutil.rmtree, self._out, ignore_errors=True)
        with self.watch.stage("write program") as update:
            self._out.mkdir(parents=True, exist_ok=True)
            self.program = write_programs(self.job, motions, self._out, update, entries)
        return self.program

    @cached_property
    def program(self) -> ProgramFiles:
        """The program of all passes, in the folder of the pipeline."""
        return self.write({cut.name: cut.motion for cut in self.cuts()})

    @property
    def program_motion(self) -> Motion:
        """The motion of the finishing pass, read back from the program on disk."""
        return self._program_read[0]

    @cached_property
    def _program_read(self) -> tuple[Motion, Callable[[], str]]:
        file, name = self.program.files[0], self.job.passes[-1].names(self._stock)[-1]
        with self.watch.stage("read program") as update:
            return read_and_check(self.job, file, name, update)

    def find_wrong_move(self) -> str:
        """Return a sentence on the first wrong move of the program on disk, see `turnwright.job.find_wrong_move`."""
        find = self._program_read[1]
        with self.watch.stage("check moves"):
            return find()

    @property
    def _stock(self) -> float:
        """Stock above the finished surface before the finishing pass. [mm]."""
        return self.job.passes[-2].allowance if len(self.job.passes) > 1 else self.job.part.stock

    @cached_property
    def predictions(self) -> tuple[Prediction, ...]:
        """Predicted surface of the program read back, for the whole part and every patch."""
        return predict(self.job, self.program_motion, nominal=self.finishing.nominal, watch=self.watch)

    @cached_property
    def optics(self) -> OpticalPerformance:
        """Optical performance of the surface: of the program read back where it is written, else of the motion.

        Raises
        ------
        InputError
            If the job does not state ``optics``.
        """
        written = "program" in vars(self)
        patches = (
            self.predictions if written else tuple(self.prediction(one.name) for one in self.job.simulation.patches)
        )
        return predict_optics(
            self.job, self.program_motion if written else self.motion, nominal=self.finishing.nominal,
            predictions=patches, watch=self.watch,
        )  # fmt: skip

    @cached_property
    def breakdown(self) -> ErrorBreakdown:
        """Error contributions to the form error of the program read back."""
        part, tool, plan = self.job.part.aimed, self.job.tool, self.finishing
        with self.watch.stage("shares") as update:
            return break_down_error(
                part, tool, plan.spiral, plan.commanded, program_motion=self.program_motion, nominal=plan.nominal,
                progress=update,
            )  # fmt: skip

    def prediction(self, name: str) -> Prediction:
        """Predict a patch by its name, or the "whole part", from the motion in memory."""
        if name not in self._predictions:
            self._predictions[name] = self._predict(name)
        return self._predictions[name]

    @cached_property
    def form_pv_nm(self) -> float:
        """Form error PV of the whole part, from its highest to its lowest point."""
        whole_part = self._predictions.get(WHOLE)
        if whole_part is None or whole_part.form is None:
            _ = self.motion  # points between the azimuths of the map count too, which needs the whole motion
            self._predictions[WHOLE] = whole_part = self._predict(WHOLE)
        return whole_part.pv_nm

    def _predict(self, name: str) -> Prediction:
        names = self.job.map_names
        if name not in names:
            raise InputError(f"patch must be one of {', '.join(names)}, got {name!r}")
        if "commanded" not in vars(self.finishing) and can_predict_window(self.job):
            prediction = predict_window(self.job, name)
            if prediction is not None:
                return prediction
        return predict(self.job, self.motion, nominal=self.finishing.nominal, only=(name,))[0]

    @property
    def refused(self) -> tuple[str, ...]:
        """Why `run` would refuse the job, a sentence each: from access, and from the stages computed so far.

        Findings that the job accepts are left out.
        """
        accepted, reasons = self.job.accept, []
        reasons += [one.sentence for one in self.findings if not one.ok and one.name not in accepted]
        if not reasons:
            reasons += [one.sentence for one in self.depths if not one.ok]
        if "path" in vars(self.finishing) and "gouge" not in accepted:
            reasons += filter(None, [describe_gouge(self.job, self.path)])
        if "passes" in vars(self) and "limits" not in accepted:
            reasons += [f"pass {one.name}: {finding}" for one in self.passes for finding in one.limits.findings]
        return tuple(reasons)


def describe_gouge(job: Job, path: Path) -> str:
    """Return how far the edge cuts below the surface on a path, in words; empty if it does not."""
    least = float(path.clearance.min())
    if least >= -GOUGE:
        return ""
    cut = f"placed along the {job.strategy.along}, the edge cuts {-least * 1e6:.3g} nm below the surface"
    return f'{cut}, the limit is 0 nm: place it along "z"'


def _repeat(cut: PassTable, motion: Motion, stock: float) -> Iterator[tuple[str, float, float, Motion]]:
    """Yield the name, depth of cut, allowance [mm] and motion of each repetition of a pass."""
    names = cut.names(stock)
    depth = (stock - cut.allowance) / len(names)
    for name in names:
        stock -= depth
        allowance = max(stock, 0.0)
        if name == names[-1] and not cut.allowance:
            yield name, depth, allowance, motion
        else:
            yield name, depth, allowance, replace(motion, axes={**motion.axes, "Z": motion.axes["Z"] + allowance})
