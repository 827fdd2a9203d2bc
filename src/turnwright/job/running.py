"""Run a whole job: check, plan, write the program, read it back, predict the surface and check the tolerances."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, replace
from functools import lru_cache
from os import PathLike
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from turnwright._arrays import Ints
from turnwright.access import check_bodies, largest_depth, odd_sizes
from turnwright.cutting import ChipMap
from turnwright.errors import GougeError, InputError, LimitError
from turnwright.job.approach import Entry
from turnwright.job.contributions import has_servos
from turnwright.job.cut_range import cut_range
from turnwright.job.cutting import PassChips, predicted_chips
from turnwright.job.gouge import find_gouge
from turnwright.job.optics import OpticalPerformance
from turnwright.job.pass_plan import PassPlan
from turnwright.job.pipeline import Cut, Pipeline, describe_gouge
from turnwright.job.programs import predicted_motion, rounding_effect
from turnwright.job.result import Pass, Preview, Result
from turnwright.job.schema import Job, PassTable
from turnwright.job.shape import part_shape
from turnwright.job.verdict import judge
from turnwright.path import Motion, Path, Spiral
from turnwright.placing import place
from turnwright.progress import StageProgress
from turnwright.strategy import SlowToolServo, Strategy
from turnwright.units import say_length

__all__ = ["finishing_motion", "preview", "run"]

PLOT_POINTS = 20_000


def run(
    job: Job,
    *,
    progress: StageProgress | None = None,
    out: str | PathLike[str] | None = None,
    ready: Callable[[str, Any], None] | None = None,
) -> Result:
    """Run a job: check, plan, place, drive, write the program, read it back and predict the surface.

    Parameters
    ----------
    job
        The job.
    progress
        Called with (stage, done, total).
    out
        Folder for the files of the program, created if it does not exist; the other files of the command line are
        written by ``turnwright.report``. If not given, the program is written, read back and deleted, and the result
        lists no files.
    ready
        Called with the name and the value of a field of the result as soon as it is computed, so that it can be shown
        during the rest of the run: ``access``, then ``passes``, ``chips``, ``path``, ``motion`` and ``revolutions``,
        ``entries``, and ``predictions``.

    Raises
    ------
    GougeError
        If the tool does not reach the part, or gouges it, and the job does not accept that. Also if the surface
        predicted from the program lies below the design by more than the plan allows; the program is then deleted.
    LimitError
        If a limit of the machine is exceeded and the job does not accept that.
    TurnwrightError
        Any error of a stage.
    """
    if out is None:
        with TemporaryDirectory(prefix="turnwright-") as folder:
            result = run(job, progress=progress, out=folder, ready=ready)
        return replace(result, program=replace(result.program, files=()))
    ready = ready or _show_nothing
    line = Pipeline(job, progress=progress, out=out)
    warnings = _accept_findings(job, GougeError, ((one.name, one.sentence) for one in line.findings if not one.ok))
    ready("access", line.access)
    warnings += odd_sizes(job.part.aimed, job.tool)
    for finding in line.depths:
        if not finding.ok:  # no job can accept that
            raise GougeError(finding.sentence)
    motions: dict[str, Motion] = {}
    passes: list[Pass] = []
    chips: dict[str, ChipMap] = {}
    for cut in line.cuts():
        warnings += _accept_findings(job, GougeError, [("gouge", describe_gouge(job, cut.plan.path))])
        if job.part.leaves_air and cut.plan.job.tool.bodies:
            near = check_bodies(job.part.aimed, cut.plan.job.tool, cut.motion)
            warnings += _accept_findings(job, GougeError, near)
        exceeded = [("limits", f"pass {cut.name}: {one}") for one in cut.limits.findings[:1]]
        warnings += _accept_findings(job, LimitError, exceeded)
        motions[cut.name] = cut.motion
        passes.append(cut.as_pass(_check_chips(cut, chips, warnings)))
    plotted_path, least = _thin(line.path), float(line.path.clearance.min())
    plotted_motion, turns = line.motion.select(_every_nth(line.motion.time.size)), line.motion.sample_revolutions()
    del cut
    plotted = {"path": plotted_path, "motion": plotted_motion, "revolutions": turns}
    for field, value in {"passes": passes, "chips": chips, **plotted}.items():
        ready(field, value)
    line.finishing.forget("spiral", "path")
    entries = line.entries(motions)
    ready("entries", entries)
    warnings += _accept_findings(job, LimitError, (("limits", one.beyond_travel) for one in entries.values()))
    program = line.write(motions, entries)
    motions.clear()
    program_motion = line.program_motion
    with line.watch.stage("compare"):
        difference, limit = rounding_effect(job, line.motion, program_motion)
    if not job.program.precorrect:
        line.finishing.forget("commanded", "planned")
    predictions = line.predictions
    ready("predictions", predictions)
    warnings += _accepted_program(line, limit)
    warnings += _wall_warnings(job, passes, entries) + _assumption_warnings(job, passes)
    warnings += [sentence for one in predictions for sentence in one.remarks]
    warnings += [one.sentence for one in judge(job, predictions) if not one.is_kept]
    if difference > limit:
        warnings.append(
            f"the surface of the program on disk differs by {difference:.3g} nm from that of the motion in memory, its "
            f"decimals allow {limit:.3g} nm: find the reason before you cut"
        )
    return Result(
        job=job, part=job.part, tool=job.tool, machine=job.machine,
        actual_tool=job.actual_tool, actual_machine=job.actual_machine, access=line.access, findings=line.findings,
        passes=tuple(passes), path=plotted_path, motion=plotted_motion, revolutions=turns, least_clearance=least,
        program=program, predictions=predictions,
        optics=_optics(line, warnings), rounding_nm=difference, rounding_limit_nm=limit,
        chips=chips, entries=entries, warnings=tuple(dict.fromkeys(warnings)), timings=line.watch.timings,
        peak_memory_gb=_peak_memory(),
    )  # fmt: skip


def _show_nothing(_field: str, _value: Any) -> None:
    pass


def _optics(line: Pipeline, warnings: list[str]) -> OpticalPerformance | None:
    """Return the optical performance of a job that states its light; warn where it cannot be computed."""
    if line.job.optics is None:
        return None
    try:
        return line.optics
    except InputError as error:
        warnings.append(f"optics: {error}")
        return None


def _check_chips(cut: Cut, chips: dict[str, ChipMap], warnings: list[str]) -> PassChips | None:
    """Store the chips of a cut and warn if it is not ductile; return ``None`` for a material without data."""
    part = cut.plan.job.part
    material = part.substance
    # A metal without stock gives no warning: only its forces are missing.
    if material is None or (material.critical is None and (material.cutting is None or not part.stock > 0)):
        return None
    if isinstance(cut.chips, str):
        warnings.append(f"pass {cut.name}: {cut.chips}")
        return None
    report, chips[cut.name] = cut.chips
    caution = material.caution(report.typical)
    if caution:
        report = replace(report, sentence=f"{report.sentence}; {caution}")
    if not report.ok:
        warnings.append(f"pass {cut.name} is {report.sentence}")
    return report


def _wall_warnings(job: Job, passes: list[Pass], entries: Mapping[str, Entry]) -> list[str]:
    """Warn of passes that plunge next to a wall of the blank that is higher than the cutting edge."""
    plunging = [one for one in passes if entries[one.name].depth is not None]
    if not plunging:
        return []
    warnings, part = [], job.part.aimed
    cuts = job.cuts
    for one in plunging:
        tool, wall = job.for_pass(cuts[one.name]).tool, part.rim_stock - one.allowance
        limit, _ = _largest_depth(part, tool, side=1, sense=job.strategy.sense, nearest=part.reach)
        if wall > limit * (1 + 1e-9):
            warnings.append(
                f"pass {one.name} plunges next to an uncut wall {say_length(wall)} high, the edge cuts up to "
                f"{say_length(limit)}: state part.blank, and a lead_in with which the pass begins outside the blank"
            )
    return warnings


SLOWED = 0.97
"""Share of the stated spindle speed below which a controller that blends its blocks is reported."""

_largest_depth = lru_cache(maxsize=8)(largest_depth)


def preview(job: Job, *, progress: StageProgress | None = None) -> Preview:
    """Check a job quickly: tool access, number of points and shortest cycle time of each pass.

    Parameters
    ----------
    job
        The job.
    progress
        Called with (stage, done, total).
    """
    line = Pipeline(job, progress=progress)
    watch, access = line.watch, line.access
    part, tool, machine = job.part.aimed, job.tool, job.machine
    refused = tuple(
        _or_accept(one.sentence, one.name) for one in line.findings if not one.ok and one.name not in job.accept
    )
    points, shortest, chips = {}, {}, {}
    stock = part.stock
    # As in a run, no pass is planned for a tool that does not reach the part. Where the reason is a wrong unit, a path
    # over walls would take too many points.
    for cut in () if refused else job.passes:
        servo = job.servo(cut)
        with watch.stage("plan") as update:
            # A job is checked while it is typed, so points are counted without computing all of them.
            target = servo.target(job.part)
            tool = job.tool_of(cut)
            size, spiral = servo.extent(target, tool, progress=update)
            if _widens(servo):
                PassPlan(job, cut).require_steps()
            place(spiral, target, tool, along=servo.along)  # raises where the surface ends
        profile, stated = servo.spindle_speeds, servo.spindle_rpm
        most = (machine if servo.spindle_mode is None else machine.in_spindle_mode()).spindle_rpm
        if stated is not None and stated > most:
            sentence = (
                f"pass {cut.name}: spindle_speed is {stated:g} rpm, the limit of {machine.name} is "
                f"{most:g} rpm: reduce it, or leave it out to use the highest possible speed"
            )
            refused = (sentence,)
            break
        speed = stated or most if profile is None else float(profile.spindle_rpm.max())
        # Air is crossed faster and with few points.
        times = _times(job, cut, stock, spiral) * (1.0 if servo.spindle_mode is not None else job.part.turned_share)
        points[cut.name] = round(times * size)
        # The points of a fast tool are in its own table.
        blocks = 0 if job.program.fast_tool else size - 1
        shortest[cut.name] = times * max(spiral.turns * 60 / speed, blocks / machine.block_rate_hz)
        expected = predicted_chips(job, access, cut, spiral.feed, stock)
        if expected:
            chips[cut.name] = expected
        stock = cut.allowance
    if not refused:  # otherwise the edge may not reach the finished surface
        refused = tuple(one.sentence for one in line.depths if not one.ok)
    return Preview(
        access=access, findings=line.findings, points=points, shortest_s=shortest, refused=refused, chips=chips,
        remarks=job.part.surface.remarks, warnings=odd_sizes(part, tool), shape=part_shape(job.part),
    )  # fmt: skip


def _times(job: Job, cut: PassTable, stock: float, spiral: Spiral) -> float:
    """Return how often a pass is cut, a cut where the blank reaches up to some radii only as a share."""
    repeats, part, tool = cut.repeats(stock), job.part.aimed, job.tool_of(cut)
    if cut is job.passes[-1] or part.shaped_blank is None:
        return float(repeats)
    depth, total = (stock - cut.allowance) / repeats, 0.0
    outermost = float(spiral.radius.max())
    for number in range(1, repeats + 1):
        between = cut_range(part, tool, stock - number * depth)
        if between is not None:
            low, high = np.clip(between, part.nearest, outermost)
            total += float(high - low) / (outermost - part.nearest)
    return total


def finishing_motion(job: Job, *, progress: StageProgress | None = None) -> tuple[Motion, Result]:
    """Run a job, and return the motion of the axes in its finishing pass, from which its surface is predicted.

    It is that of the program read back, with the interpolation of the controller, and with the servos if the job says
    so. The program is deleted. Raises any error of `run`.
    """
    with TemporaryDirectory(prefix="turnwright-") as folder:
        result = run(job, progress=progress, out=folder)
        motion = predicted_motion(job, result.program.files[0], result.passes[-1].name, progress=progress)
    return motion, result


def _accept_findings(job: Job, kind: type[InputError], findings: Iterable[tuple[str, str]]) -> list[str]:
    """Return the sentences of findings that a job accepts by name; raise the first that it does not accept."""
    sentences = [(what, sentence) for what, sentence in findings if sentence]
    for what, sentence in sentences:
        if what not in job.accept:
            raise kind(_or_accept(sentence, what))
    return [sentence for _, sentence in sentences]


def _or_accept(sentence: str, what: str) -> str:
    return f'{sentence} (or accept it in the job: accept = ["{what}"])'


def _accepted_program(line: Pipeline, limit: float) -> list[str]:
    """Warn of a gouge or a wrong move of the program if the job accepts it; else delete the program and raise."""
    gouge = find_gouge(line.job, line.predictions[0], line.program_motion, limit)
    sentences = [one for one in (gouge.sentence if gouge else "", line.find_wrong_move()) if one]
    if sentences and "gouge" not in line.job.accept:
        for file in line.program.files:
            file.unlink()
    return _accept_findings(line.job, GougeError, [("gouge", one) for one in sentences])


def _widens(servo: Strategy) -> bool:
    """Whether the angle between points of a spiral grows without bound towards the axis."""
    plan = servo.spiral_strategy
    return isinstance(plan, SlowToolServo) and plan.arc_length is not None and plan.max_step is None


def _thin(path: Path) -> Path:
    at = _every_nth(path.angle.size)
    stated = [one.name for one in fields(path) if one.init and getattr(path, one.name) is not None]
    return replace(path, **{name: getattr(path, name)[at] for name in stated})


def _every_nth(size: int) -> Ints:
    return np.arange(0, size, max(1, math.ceil(size / PLOT_POINTS)))


def _assumption_warnings(job: Job, passes: list[Pass]) -> list[str]:
    """Warn of limiting axis data without a published source, and of servos that the simulation ignores."""
    sources, warnings = job.machine.sources, []
    blends = job.machine.controller.interpolation == "linuxcnc" and job.strategy.spindle_mode is None
    if has_servos(job.actual_machine) and not job.simulation.tracking:
        warnings.append(
            f"{job.actual_machine.name} states the response of its servos, the prediction ignores it: set tracking = "
            "true in [simulation]"
        )
    cuts = job.cuts
    for cut in passes if blends else ():
        stated = job.servo(cuts[cut.name]).spindle_rpm
        if stated is not None and cut.limits.spindle_rpm < SLOWED * stated:
            warnings.append(
                f"pass {cut.name}: LinuxCNC blends its blocks and turns C at {cut.limits.spindle_rpm:.4g} rpm, the job "
                f"states {stated:g} rpm: use fewer points per revolution, or accept the time"
            )
    for binding in dict.fromkeys(cut.limits.binding for cut in passes):
        letter, _, kind = binding.partition(" ")
        speed = "spindle_rpm" if job.strategy.spindle_mode is None else "spindle_mode_rpm"
        fact = {"block rate": "block_rate_hz", "spindle speed": speed}.get(binding, f"axes.{letter}.{kind}")
        if sources.get(fact, "").startswith("assumed"):
            warnings.append(
                f"the tightest limit of {job.machine.name}, {binding}, has an assumed value: check it on the machine"
            )
    return warnings


def _peak_memory() -> float:
    """Return the peak resident memory of this process. [GB]."""
    try:
        import resource  # noqa: PLC0415 - there is none on Windows
    except ImportError:
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e9
