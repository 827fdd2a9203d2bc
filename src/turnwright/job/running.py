"""A job carried out whole: checked, cut in memory, written, read back, predicted and judged."""

from __future__ import annotations

import math
import sys
from bisect import bisect_right
from dataclasses import fields, replace
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from turnwright.access import largest_depth, odd_sizes
from turnwright.errors import GougeError, LimitError
from turnwright.job.contributions import has_servos
from turnwright.job.cutting import PassChips, predicted_chips
from turnwright.job.gouge import find_gouge
from turnwright.job.pass_plan import PassPlan
from turnwright.job.pipeline import GOUGE, Cut, Pipeline
from turnwright.job.programs import predicted_motion, rounding
from turnwright.job.result import Pass, Prediction, Preview, Result
from turnwright.job.shape import part_shape
from turnwright.job.verdict import judge
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.strategy import SlowToolServo
from turnwright.units import say_length

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

    from turnwright._arrays import Floats
    from turnwright.access import Access
    from turnwright.cutting import ChipMap
    from turnwright.job.approach import Entry
    from turnwright.job.schema import Job
    from turnwright.path import Motion, Path
    from turnwright.progress import StageProgress
    from turnwright.strategy import Strategy

__all__ = ["finishing_motion", "preview", "run"]

PICTURE = 20_000
"""Points that a picture of a path needs."""


def run(job: Job, *, progress: StageProgress | None = None, out: str | PathLike[str] | None = None) -> Result:
    """Carry out a job: check, plan, place, drive, write the program, read it back and predict what it will leave.

    Parameters
    ----------
    job
        What is asked for.
    progress
        Called with (stage, done, total).
    out
        Folder for the files of the program, which is made if there is none; what else the command line leaves,
        ``turnwright.report`` writes. If not given, the program is written, read back and thrown away, and the result
        names none.

    Raises
    ------
    GougeError
        If the tool does not reach the part, or cuts into it, and the job does not accept that; so also if the surface
        predicted from the program lies below the design by more than the plan allows, and no program is kept then.
    LimitError
        If the machine cannot do what is asked and the job does not accept that.
    TurnwrightError
        Whatever a stage raises.
    """
    if out is None:
        with TemporaryDirectory(prefix="turnwright-") as folder:
            result = run(job, progress=progress, out=folder)
        return replace(result, program=replace(result.program, files=()))
    line = Pipeline(job, progress=progress, out=out)
    warnings = _accepted_access(job, line.access) + list(odd_sizes(job.part.aimed, job.tool))
    for finding in line.depths:
        if not finding.ok:  # no job can accept that
            raise GougeError(finding.sentence)

    motions: dict[str, Motion] = {}
    passes: list[Pass] = []
    chips: dict[str, ChipMap] = {}
    for cut in line.cuts():
        warnings += _accepted_gouge(job, cut.plan.path)
        if not cut.limits.ok:
            warnings += _accepted(job, "limits", LimitError(f"pass {cut.name}: {cut.limits.findings[0]}"))
        motions[cut.name] = cut.motion
        passes.append(cut.told(_judged_chips(cut, chips, warnings)))
    pictured, least = _thin(line.path), float(line.path.clearance.min())
    shown, turns = _part_of(line.motion, _few(line.motion.time.size)), _turns(line.motion)
    del cut
    line.finishing.forget("spiral", "path")

    entries = _accepted_entries(job, line.entries(motions), warnings)
    program = line.write(motions, entries)
    motions.clear()
    again = line.read_back
    with line.watch.stage("compare"):
        apart, limit = rounding(job, line.motion, again)
    if not job.program.precorrect:
        line.finishing.forget("commanded", "wanted")
    predictions = line.predictions
    warnings += _accepted_program(line, limit)
    warnings += _walls(job, passes, entries) + _assumed(job, passes) + _judged(job, predictions)
    if apart > limit:
        warnings.append(
            f"the program on disk leaves a surface {apart:.3g} nm from that of the motion in memory, its decimals "
            f"allow {limit:.3g} nm: do not cut with it before the cause is known"
        )
    return Result(
        job=job, part=job.part, tool=job.tool, machine=job.machine,
        actual_tool=job.actual_tool, actual_machine=job.actual_machine, access=line.access,
        passes=tuple(passes), path=pictured, motion=shown, turns=turns, least_clearance=least,
        program=program, predictions=predictions, rounding_nm=apart, rounding_limit_nm=limit,
        chips=chips, entries=entries, warnings=tuple(dict.fromkeys(warnings)), timings=line.watch.timings,
        peak_memory_gb=_peak_memory(),
    )  # fmt: skip


def _judged_chips(cut: Cut, chips: dict[str, ChipMap], warnings: list[str]) -> PassChips | None:
    """Keep the chips of a cut and warn of what the material does not bear; ``None`` where nothing is known of it."""
    part = cut.plan.job.part
    known = part.substance
    # A metal without stock is left alone: there is nothing to warn of but that its forces are not found.
    if known is None or (known.critical is None and (known.cutting is None or not part.stock > 0)):
        return None
    if isinstance(cut.chips, str):
        warnings.append(f"pass {cut.name}: {cut.chips}")
        return None
    told, chips[cut.name] = cut.chips
    caution = known.caution(told.typical)
    if caution:
        told = replace(told, sentence=f"{told.sentence}; {caution}")
    if not told.ok:
        warnings.append(f"pass {cut.name} is {told.sentence}")
    return told


def _accepted_entries(job: Job, entries: dict[str, Entry], warnings: list[str]) -> dict[str, Entry]:
    """Return how the tool enters every pass; warn of accepted travel beyond a limit."""
    for entry in entries.values():
        if entry.beyond_travel:
            warnings += _accepted(job, "limits", LimitError(entry.beyond_travel))
    return entries


def _walls(job: Job, passes: list[Pass], entries: Mapping[str, Entry]) -> list[str]:
    """Warn of passes that plunge beside a wall of the blank that is higher than the edge cuts."""
    plunging = [one for one in passes if entries[one.name].depth is not None]
    if not plunging:
        return []
    found, part = [], job.part.aimed
    limit, _ = largest_depth(part, job.tool, side=1, sense=job.strategy.sense, nearest=part.radius)
    for one in plunging:
        wall = job.part.stock - one.allowance
        if wall > limit * (1 + 1e-9):
            found.append(
                f"pass {one.name} plunges beside a wall of {say_length(wall)} that the passes leave outside, the edge "
                f"cuts up to {say_length(limit)}: state part.blank and a lead_in with which the passes begin beside it"
            )
    return found


def preview(job: Job, *, progress: StageProgress | None = None) -> Preview:
    """Check a job: whether the tool reaches the part, how many points each pass has, and how long it takes at least.

    Parameters
    ----------
    job
        What is asked for.
    progress
        Called with (stage, done, total).
    """
    line = Pipeline(job, progress=progress)
    watch, access = line.watch, line.access
    part, tool, machine = job.part.aimed, job.tool, job.machine
    refused = tuple(
        _or_accept(one.sentence, one.name) for one in access.findings if not one.ok and one.name not in job.accept
    )
    points, shortest, chips = {}, {}, {}
    stock = part.stock
    # As in a run nothing is planned for a tool that does not reach the part: where that is a slip of a unit, a path
    # over walls takes points without end.
    for cut in () if refused else job.passes:
        servo = job.servo(cut)
        with watch.stage("plan") as tell:
            # A job is checked while somebody types, so not all points are made that are counted.
            size, spiral = servo.extent(part, tool, progress=tell)
            if _widens(servo):
                PassPlan(job, cut).require_steps()
            place(_outermost(spiral), part, tool, along=job.strategy.along)  # raises where the surface has an end
        profile, stated = servo.spindle_speeds, servo.spindle_rpm
        if stated is not None and stated > machine.spindle_rpm:
            sentence = (
                f"pass {cut.name}: spindle_speed is {stated:g} rpm, the limit of {machine.name} is "
                f"{machine.spindle_rpm:g} rpm: turn slower, or state none to have the highest speed found"
            )
            refused = (sentence,)
            break
        speed = stated or machine.spindle_rpm if profile is None else float(profile.spindle_rpm.max())
        times = cut.repeats(stock)
        points[cut.name] = times * size
        # The points of a fast tool stand in its own table.
        blocks = 0 if job.program.fast_tool else size - 1
        shortest[cut.name] = times * max(spiral.turns * 60 / speed, blocks / machine.block_rate_hz)
        expected = predicted_chips(job, access, cut, spiral.feed, stock)
        if expected:
            chips[cut.name] = expected
        stock = cut.allowance
    if not refused:  # else the finished surface may be none that an edge can touch
        refused = tuple(one.sentence for one in line.depths if not one.ok)
    return Preview(
        access=access, points=points, shortest_s=shortest, refused=refused, chips=chips,
        remarks=job.part.surface.remarks, warnings=odd_sizes(part, tool), shape=part_shape(job.part),
    )  # fmt: skip


def finishing_motion(job: Job, *, progress: StageProgress | None = None) -> tuple[Motion, Result]:
    """Carry out a job, and return how the axes move in its finishing pass: what its predictions are made from.

    Parameters
    ----------
    job
        What is asked for.
    progress
        Called with (stage, done, total).

    Returns
    -------
    tuple
        The motion of the program read back, with what the controller's interpolation makes of it, and the servos if the
        job says so; and the result of the run. Its program is not kept.

    Raises
    ------
    TurnwrightError
        Whatever `run` raises.
    """
    with TemporaryDirectory(prefix="turnwright-") as folder:
        result = run(job, progress=progress, out=folder)
        motion = predicted_motion(job, result.program.files[0], result.passes[-1].name, progress=progress)
    return motion, result


def _accepted(job: Job, what: str, error: GougeError | LimitError) -> list[str]:
    """Return a finding as a warning if the job accepts it, else raise it."""
    if what not in job.accept:
        raise type(error)(_or_accept(str(error), what))
    return [str(error)]


def _or_accept(sentence: str, what: str) -> str:
    """Add how a job accepts a finding."""
    return f'{sentence} (or accept it in the job: accept = ["{what}"])'


def _accepted_access(job: Job, access: Access) -> list[str]:
    warnings = []
    for finding in access.findings:
        if not finding.ok:
            warnings += _accepted(job, finding.name, GougeError(finding.sentence))
    return warnings


def _accepted_program(line: Pipeline, limit: float) -> list[str]:
    """Warn of an accepted gouge of the program; without leave there is no program either."""
    gouge = find_gouge(line.job, line.predictions[0], line.read_back, limit)
    if gouge is None:
        return []
    if "gouge" not in line.job.accept:
        for file in line.program.files:
            file.unlink()
    return _accepted(line.job, "gouge", GougeError(gouge.sentence))


def _accepted_gouge(job: Job, path: Path) -> list[str]:
    least = float(path.clearance.min())
    if least >= -GOUGE:
        return []
    cut = f"placed along the {job.strategy.along}, the edge cuts {-least * 1e6:.3g} nm below the surface"
    return _accepted(job, "gouge", GougeError(f'{cut}, the limit is 0 nm: place it along "z"'))


def _widens(servo: Strategy) -> bool:
    """Whether steps along a spiral grow without bound towards the axis."""
    plan = servo.lays_out
    return isinstance(plan, SlowToolServo) and plan.arc_length is not None and plan.max_step is None


def _outermost(spiral: Spiral) -> Spiral:
    """Return the turn that is farthest from the axis."""
    angle, size = spiral.angle, spiral.angle.size
    inwards = spiral.radius[0] > spiral.radius[-1]
    # The angle runs one way, so a few looks find where the turn ends: a job is checked while somebody types.
    away = range(size) if inwards else range(size - 1, -1, -1)
    count = bisect_right(away, 2 * np.pi, key=lambda at: abs(float(angle[at] - angle[away[0]])))
    turn = slice(0, count) if inwards else slice(size - count, size)
    return Spiral(angle=spiral.angle[turn], radius=spiral.radius[turn], y=None if spiral.y is None else spiral.y[turn])


def _thin(path: Path) -> Path:
    """Return a path with few enough points for a picture."""
    at = _few(path.angle.size)
    stated = [one.name for one in fields(path) if one.init and getattr(path, one.name) is not None]
    return replace(path, **{name: getattr(path, name)[at] for name in stated})


def _part_of(motion: Motion, at: slice) -> Motion:
    """Return some points of a motion, free of the rest."""

    def some(values: Mapping[str, Floats]) -> dict[str, Floats]:
        return {letter: one[at].copy() for letter, one in values.items()}

    velocity = None if motion.velocity is None else some(motion.velocity)
    return replace(motion, time=motion.time[at].copy(), axes=some(motion.axes), velocity=velocity, stated_blocks=None)


def _few(size: int) -> slice:
    return slice(None, None, max(1, math.ceil(size / PICTURE)))


def _turns(motion: Motion) -> tuple[Motion, ...]:
    """Return single turns at the beginning, in the middle and at the end."""
    angle = np.abs(motion.axes["C"] - motion.axes["C"][0])
    whole = max(float(angle[-1]) - 2 * np.pi, 0.0)
    turns = []
    for start in (0.0, whole / 2, whole):
        first, last = np.searchsorted(angle, (start, start + 2 * np.pi + 1e-9))
        turns.append(_part_of(motion, slice(max(int(first) - 1, 0), int(last) + 1)))
    return tuple(turns)


def _assumed(job: Job, passes: list[Pass]) -> list[str]:
    """Say which binding limits nobody has published, and whether known servos are left out."""
    sources, found = job.machine.sources, []
    if has_servos(job.actual_machine) and not job.simulation.tracking:
        found.append(
            f"{job.actual_machine.name} states how its axes answer, the prediction takes them to go where they are "
            "sent: set tracking = true in [simulation]"
        )
    for binding in dict.fromkeys(cut.limits.binding for cut in passes):
        letter, _, kind = binding.partition(" ")
        fact = {"block rate": "block_rate_hz", "spindle speed": "spindle_rpm"}.get(binding, f"axes.{letter}.{kind}")
        if sources.get(fact, "").startswith("assumed"):
            found.append(
                f"the limit that binds, {binding}, is assumed for {job.machine.name}, nobody states it: "
                "check it on the machine"
            )
    return found


def _judged(job: Job, predictions: tuple[Prediction, ...]) -> list[str]:
    """Say what is not cut, and which tolerances are not kept or not judged."""
    found = [sentence for one in predictions for sentence in one.remarks]
    return found + [one.sentence for one in judge(job, predictions) if not one.kept]


def _peak_memory() -> float:
    """Return the largest resident memory of this process so far. [GB]."""
    try:
        import resource  # noqa: PLC0415 - there is none on Windows
    except ImportError:
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e9
