"""The one place that knows the order of the stages."""

from __future__ import annotations

import math
import sys
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path as File
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.access import check_access, check_depths, largest_depth, odd_sizes
from turnwright.errors import GougeError, InputError, LimitError
from turnwright.generation import generate, generate_polar
from turnwright.job.approach import Entry, entries_of
from turnwright.job.contributions import (
    Shares,
    clear_azimuths,
    finish_nm,
    has_servos,
    lines,
    require_servos,
    shares,
    without_servos,
)
from turnwright.job.cutting import PassChips, chips_of, foretold
from turnwright.job.extremes import find_extremes
from turnwright.job.gouge import find_gouge
from turnwright.job.interpolated import interpolated, off_curves
from turnwright.job.pass_plan import Watch, plan_pass
from turnwright.job.result import Pass, Prediction, Preview, Result
from turnwright.job.shape import part_shape
from turnwright.job.verdict import judge
from turnwright.metrology import roughness
from turnwright.motion import check_limits
from turnwright.path import Spiral
from turnwright.placing import place
from turnwright.post import ProgramFiles, ProgramHeader, dialect_of, read_fast_tool, read_nc, write_fast_tool, write_nc
from turnwright.strategy import SlowToolServo
from turnwright.units import say_length

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from os import PathLike

    from turnwright._arrays import Floats
    from turnwright.access import Access, AccessFinding
    from turnwright.cutting import ChipMap
    from turnwright.heightmap import HeightMap
    from turnwright.job.schema import Job, PassTable
    from turnwright.part import Part
    from turnwright.path import Motion, Path
    from turnwright.progress import Progress, StageProgress
    from turnwright.strategy import Strategy
    from turnwright.tool import Tool

__all__ = [
    "WHOLE",
    "depths_of",
    "predict",
    "preview",
    "read_back",
    "repeated",
    "run",
    "written",
]

PICTURE = 20_000
"""Points that a picture of a path needs."""

WHOLE = "whole part"
"""What the map of the whole part is called."""

GOUGE = 1e-9
"""Clearance below zero that is rounding. [mm]"""


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
    watch = Watch(progress)
    part, tool, machine = job.part.aimed, job.tool, job.machine
    with watch.stage("access") as tell:
        access = check_access(part, tool, sense=job.strategy.sense, progress=tell)
    warnings = _accepted_access(job, access) + list(odd_sizes(part, tool))
    with watch.stage("depth of cut") as tell:
        require_depths(job, progress=tell)

    motions: dict[str, Motion] = {}
    passes: list[Pass] = []
    chips: dict[str, ChipMap] = {}
    stock, before = part.stock, None
    for cut in job.passes:
        _require_sense(cut, job.servo(cut), part, tool)
        feed, path, motion, meant = plan_pass(job, cut, watch)
        warnings += _accepted_gouge(job, path)
        for name, depth, left, lifted in repeated(cut, motion, stock):
            with watch.stage("limits"):
                limits = check_limits(lifted, machine)
            if not limits.ok:
                warnings += _accepted(job, "limits", LimitError(f"pass {name}: {limits.findings[0]}"))
            motions[name] = lifted
            told, before = _judged_chips(job, name, lifted, before, left, watch, chips, warnings), lifted
            passes.append(
                Pass(
                    name=name, allowance=left, depth=depth, feed=feed,
                    spindle_rpm=limits.spindle_rpm, points=limits.points, limits=limits, chips=told,
                )
            )  # fmt: skip
        stock = cut.allowance
    pictured, least = _thin(path), float(path.clearance.min())
    shown, turns = _part_of(motion, _few(motion.time.size)), _turns(motion)
    del path, lifted, before

    with watch.stage("approach"):
        entries = _entered(job, motions, warnings)
    with watch.stage("write program") as tell:
        File(out).mkdir(parents=True, exist_ok=True)
        program = written(job, motions, File(out), tell, entries)
    motions.clear()
    with watch.stage("read program") as tell:
        again = read_back(job, program.files[0], passes[-1].name, tell)
    with watch.stage("compare"):
        rounding, limit = _rounding(job, motion, again)
    del motion
    predictions = predict(job, again, meant=meant, watch=watch)
    gouge = find_gouge(job, predictions[0], again, limit)
    if gouge is not None:
        if "gouge" not in job.accept:
            for file in program.files:
                file.unlink()
        warnings += _accepted(job, "gouge", GougeError(gouge.sentence))
    del again

    warnings += _walls(job, passes, entries) + _assumed(job, passes) + _judged(job, predictions)
    if rounding > limit:
        warnings.append(
            f"the program on disk leaves a surface {rounding:.3g} nm from that of the motion in memory, its decimals "
            f"allow {limit:.3g} nm: do not cut with it before the cause is known"
        )
    return Result(
        job=job, part=job.part, tool=tool, machine=machine,
        actual_tool=job.actual_tool, actual_machine=job.actual_machine, access=access,
        passes=tuple(passes), path=pictured, motion=shown, turns=turns, least_clearance=least,
        program=program, predictions=predictions, rounding_nm=rounding, rounding_limit_nm=limit,
        chips=chips, entries=entries, warnings=tuple(dict.fromkeys(warnings)), timings=watch.timings,
        peak_memory_gb=_peak_memory(),
    )  # fmt: skip


def depths_of(job: Job) -> dict[str, float]:
    """Return how much each pass takes off at a time, by its name. [mm]."""
    depths, stock = {}, job.part.stock
    for cut in job.passes:
        depths[cut.name] = (stock - cut.allowance) / cut.repeats(stock)
        stock = cut.allowance
    return depths


def judge_depths(job: Job, *, progress: Progress | None = None) -> tuple[AccessFinding, ...]:
    """Return whether the chip of each pass stays on the edge."""
    plan = job.strategy
    return check_depths(
        job.part.aimed, job.tool, depths_of(job), inside_out=plan.inside_out, sense=plan.sense, progress=progress
    )  # fmt: skip


def require_depths(job: Job, *, progress: Progress | None = None) -> None:
    """Raise if a pass takes off more than the edge can cut; no job can accept that."""
    for finding in judge_depths(job, progress=progress):
        if not finding.ok:
            raise GougeError(finding.sentence)


def _entered(job: Job, motions: Mapping[str, Motion], warnings: list[str]) -> dict[str, Entry]:
    """Return how the tool enters every pass; warn of accepted travel beyond a limit."""
    entries = entries_of(job, motions)
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


def repeated(cut: PassTable, motion: Motion, stock: float) -> Iterator[tuple[str, float, float, Motion]]:
    """Yield the name of each repetition of a pass, how much it takes off, how much it leaves [mm], and its motion."""
    names = cut.names(stock)
    depth = (stock - cut.allowance) / len(names)
    for name in names:
        stock -= depth
        left = max(stock, 0.0)
        yield name, depth, left, motion if name == names[-1] and not cut.allowance else _lifted(motion, left)


def _judged_chips(
    job: Job,
    name: str,
    motion: Motion,
    before: Motion | None,
    allowance: float,
    watch: Watch,
    chips: dict[str, ChipMap],
    warnings: list[str],
) -> PassChips | None:
    """Keep the chips of a pass and warn of what the material does not bear; ``None`` where nothing is known of it."""
    known = job.part.substance
    if known is None:
        return None
    # A metal without stock is left alone: there is nothing to warn of but that its forces are not found.
    if known.critical is None and (known.cutting is None or not job.part.stock > 0):
        return None
    with watch.stage("chips") as tell:
        found = chips_of(job, motion, before, allowance, tell)
    if isinstance(found, str):
        warnings.append(f"pass {name}: {found}")
        return None
    told, chips[name] = found
    caution = known.caution(told.typical)
    if caution:
        told = replace(told, sentence=f"{told.sentence}; {caution}")
    if not told.ok:
        warnings.append(f"pass {name} is {told.sentence}")
    return told


def written(
    job: Job,
    motions: dict[str, Motion],
    out: File,
    tell: Progress | None = None,
    entries: Mapping[str, Entry] | None = None,
) -> ProgramFiles:
    """Write the program of all passes, with the table of a fast tool beside it if there is one."""
    entries = entries_of(job, motions) if entries is None else entries
    part, machine, file = job.part, job.machine, out / f"{job.program.name}.nc"
    stated = ", ".join(one for one in (part.material_name, part.material_note) if one)
    notes = f"material {stated}" if stated else ""
    header = ProgramHeader(design=part.name, tool=job.tool.name, notes=notes)
    shared: dict[str, Any] = {
        "header": header, "clearance": max(one.clearance for one in entries.values()), "progress": tell,
        "depth": {name: one.depth for name, one in entries.items()}, "plunge_feed": job.program.plunge_feed,
        "entry_heights": {name: one.heights for name, one in entries.items()},
    }  # fmt: skip
    by = job.program.fast_tool
    if by is None:
        return write_nc(motions, machine, file, max_lines=job.program.max_lines, **shared)
    (motion,) = motions.values()
    for each in ("depth", "entry_heights"):
        (shared[each],) = shared[each].values()  # its program has one pass, with a name of its own
    both = write_fast_tool(motion, machine, file, by=by, rate_hz=job.program.fast_tool_rate, **shared)
    size = both.program.bytes + both.table.stat().st_size
    return replace(both.program, files=(*both.program.files, both.table), bytes=size)


def read_back(job: Job, file: File, name: str, tell: Progress | None = None) -> Motion:
    """Read the finishing pass, and the table of a fast tool if there is one."""
    machine = job.machine
    if job.program.fast_tool is not None:
        return read_fast_tool(file, machine, progress=tell)
    return read_nc(file, machine, name=name, progress=tell)


def preview(job: Job, *, progress: StageProgress | None = None) -> Preview:
    """Check a job: whether the tool reaches the part, how many points each pass has, and how long it takes at least.

    Parameters
    ----------
    job
        What is asked for.
    progress
        Called with (stage, done, total).
    """
    watch = Watch(progress)
    part, tool, machine = job.part.aimed, job.tool, job.machine
    with watch.stage("access") as tell:
        access = check_access(part, tool, sense=job.strategy.sense, progress=tell)
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
            _require_sense(cut, servo, part, tool)
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
        expected = foretold(job, access, cut, spiral.feed, stock)
        if expected:
            chips[cut.name] = expected
        stock = cut.allowance
    if not refused:  # else the finished surface may be none that an edge can touch
        with watch.stage("depth of cut") as tell:
            refused = tuple(one.sentence for one in judge_depths(job, progress=tell) if not one.ok)
    return Preview(
        access=access, points=points, shortest_s=shortest, refused=refused, chips=chips,
        remarks=job.part.surface.remarks, warnings=odd_sizes(part, tool), shape=part_shape(job.part),
    )  # fmt: skip


def predict(
    job: Job,
    motion: Motion,
    *,
    tracking: bool | None = None,
    meant: Motion | None = None,
    only: Collection[str] | None = None,
    extremes: bool = True,
    watch: Watch | None = None,
    progress: StageProgress | None = None,
) -> tuple[Prediction, ...]:
    """Predict what a motion leaves of the job's part, on the job's grids and with its actual tool and machine.

    What the controller makes of the motion between its points always counts, how the servos answer only if asked.

    Parameters
    ----------
    job
        Says what was designed and where to look.
    motion
        From a program read back, the job's own or anybody's.
    tracking
        Whether the axes move as the machine's servos let them, and what that adds is told; as the job says if not
        given.
    meant
        Where the axes shall really pass, if ``motion`` is corrected for the servos: what these add is against that.
    only
        Names of the places to predict, of the patches and "whole part"; all of them if not given.
    extremes
        Whether the highest and the lowest place of the whole part are found; a motion of some azimuths has none.
    watch, progress
        Who keeps the time, or who is told (stage, done, total).

    Raises
    ------
    InputError
        If tracking is asked of a machine that does not state how any axis answers, or a place is not cut at all.
    """
    watch = watch or Watch(progress)
    part, tool, machine = job.part, job.actual_tool, job.actual_machine
    motion, real = _followed(job, motion, job.simulation.tracking if tracking is None else tracking, meant, watch)
    straight = machine.controller.interpolation == "linear"
    off = 0.0 if straight else max(off_curves(one) for one in (motion, real) if one is not None)

    def predicted(name: str, form: int | str, made: Callable[[Motion, Progress], HeightMap]) -> Prediction:
        with watch.stage(f"simulate {name}") as tell:
            error = replace(made(motion, tell).minus(part.surface), name=name)
        added = None
        if real is not None:
            with watch.stage(f"simulate {name} with servos") as tell:
                planned, error = error, replace(made(real, tell).minus(part.surface), name=name)
            added = replace(error, z=error.z - planned.z, name=f"{name}: servos")
        if np.isnan(error.z).all():
            raise InputError(
                f"none of the {error.z.size:,} points of {name} is cut, so it has no finish: the motion turns by "
                f"{np.ptp(motion.axes['C']) / (2 * np.pi):.4g} rev, look whether the program is complete"
            )
        above = int(np.count_nonzero(error.z > part.stock)) if part.stock > 0 else 0
        with watch.stage("roughness"):
            finish = roughness(error, form=form)
        return Prediction(name=name, error=error, roughness=finish, tracking=added, above_stock=above, off_curves=off)

    grid = job.simulation.whole_part
    radius, angle = np.linspace(0, part.radius, grid.radii), np.linspace(0, 2 * np.pi, grid.angles, endpoint=False)

    def whole(one: Motion, tell: Progress) -> HeightMap:
        return generate_polar(one, tool, radius=radius, angle=angle, machine=machine, progress=tell)

    def wanted(name: str) -> bool:
        return only is None or name in only

    predictions = [predicted(WHOLE, "none", whole)] if wanted(WHOLE) else []
    if extremes and predictions:
        predictions = [_with_extremes(job, predictions[0], real or motion, watch)]
    for patch in filter(lambda one: wanted(one.name), job.simulation.patches):

        def rectangle(one: Motion, tell: Progress, axes: tuple[Floats, Floats] = patch.axes) -> HeightMap:
            return generate(one, tool, x=axes[0], y=axes[1], machine=machine, progress=tell)

        predictions.append(predicted(patch.name, job.roughness.form, rectangle))
    return tuple(predictions)


def _with_extremes(job: Job, whole: Prediction, motion: Motion, watch: Watch) -> Prediction:
    """Return the whole part with its highest and lowest place, and the finish where no patch shows it."""
    tool, part, machine = job.actual_tool, job.part, job.actual_machine
    with watch.stage("highest and lowest place") as tell:
        form = find_extremes(motion, tool, part, machine=machine, known=whole.error, progress=tell)
    ring = None
    if job.tolerances.sq is not None and not job.simulation.patches:
        with watch.stage("roughest ring"):
            ring = _ring_sq_nm(job, motion)
    return replace(whole, form=form, finish_nm=ring)


def _ring_sq_nm(job: Job, motion: Motion) -> float:
    """Return the Sq of the roughest ring of the whole part."""
    part = job.part
    radius, angle = lines(part, motion.feed, motion.axes["C"])
    made = generate_polar(motion, job.actual_tool, radius=radius, angle=angle, machine=job.actual_machine)
    return finish_nm(made.minus(part.surface), motion.feed)


def _followed(
    job: Job, motion: Motion, tracking: bool, meant: Motion | None, watch: Watch
) -> tuple[Motion, Motion | None]:
    """Return what the controller makes of a motion, and what the servos make of it if that is asked."""
    machine = job.actual_machine
    real = None
    if tracking:
        require_servos(machine)
        with watch.stage("track") as tell:
            real = interpolated(motion, machine, tell)
        motion = meant or motion
    ideal = without_servos(machine, corrected=meant is not None)
    if ideal.controller.interpolation != "linear":
        with watch.stage("interpolate") as tell:
            motion = interpolated(motion, ideal, tell)
    return motion, real


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


def predicted_motion(job: Job, file: File, name: str, *, progress: StageProgress | None = None) -> Motion:
    """Return how the axes move in the finishing pass of a program on disk: what its predictions are made from.

    Parameters
    ----------
    job, file, name
        See `program_shares`.
    progress
        Called with (stage, done, total).
    """
    watch = Watch(progress)
    with watch.stage("read program") as tell:
        motion = read_back(job, file, name, tell)
    ideal, real = _followed(job, motion, job.simulation.tracking, None, watch)
    return real or ideal


def program_shares(job: Job, file: File, name: str) -> Shares:
    """Return what each cause adds to the form error of the finishing pass of a program on disk.

    With the tool and the machine as planned, as `compare` does it. Where the job does not correct for the servos the
    motion is that of the program, so that the share of its decimals is in that of the chords.

    Parameters
    ----------
    job
        What the program was written for.
    file
        The main program.
    name
        Of the finishing pass.
    """
    part, tool, cut = job.part.aimed, job.tool, job.passes[-1]
    again = read_back(job, file, name)
    spiral = job.servo(cut).spiral(part, tool)
    if not job.program.precorrect:
        return shares(part, tool, spiral, again)
    plan = plan_pass(job, cut)
    motion, meant = plan.commanded, plan.meant
    return shares(part, tool, spiral, motion, again=again, meant=meant)


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


def _accepted_gouge(job: Job, path: Path) -> list[str]:
    least = float(path.clearance.min())
    if least >= -GOUGE:
        return []
    cut = f"placed along the {job.strategy.along}, the edge cuts {-least * 1e6:.3g} nm below the surface"
    return _accepted(job, "gouge", GougeError(f'{cut}, the limit is 0 nm: place it along "z"'))


def _require_sense(cut: PassTable, servo: Strategy, part: Part, tool: Tool) -> None:
    """Raise where C turns by half a turn or more from point to point: no program tells which way."""
    plan = servo.lays_out
    if not isinstance(plan, SlowToolServo) or plan.arc_length is None or plan.max_step is not None:
        return
    step = float(np.abs(np.diff(plan.spiral(part, tool).angle)).max(initial=0.0))
    if step >= np.pi:
        raise InputError(
            f"arc_length turns C by {np.degrees(step):.4g} deg from point to point near the axis in the pass "
            f'{cut.name}, the limit is below 180 deg: state max_step as well, such as max_step = "10 deg"'
        )


def _outermost(spiral: Spiral) -> Spiral:
    """Return the turn that is farthest from the axis."""
    angle, size = spiral.angle, spiral.angle.size
    inwards = spiral.radius[0] > spiral.radius[-1]
    # The angle runs one way, so a few looks find where the turn ends: a job is checked while somebody types.
    away = range(size) if inwards else range(size - 1, -1, -1)
    count = bisect_right(away, 2 * np.pi, key=lambda at: abs(float(angle[at] - angle[away[0]])))
    turn = slice(0, count) if inwards else slice(size - count, size)
    return Spiral(angle=spiral.angle[turn], radius=spiral.radius[turn], y=None if spiral.y is None else spiral.y[turn])


def _lifted(motion: Motion, height: float) -> Motion:
    """Return a motion that leaves an allowance."""
    return replace(motion, axes={**motion.axes, "Z": motion.axes["Z"] + height})


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


def _rounding(job: Job, motion: Motion, again: Motion) -> tuple[float, float]:
    """Return how far the surfaces of the motion and of the program are apart, and how far they may be. [nm].

    A program's numbers are wrong by up to half of their last decimal. The surface follows Z itself, X by its slope
    along the radius (that of the cusps, half a feed over the nose radius, included) and C by its slope around the axis
    times the distance, Y by that slope alone. Where the actual tool stands elsewhere than planned it meets other
    slopes, so what a motion leaves that is moved by as much counts where it is more. The heights of a fast tool count
    as they were read, with what straight lines between those of a stream leave out.
    """
    part, tool, machine = job.part, job.actual_tool, job.actual_machine
    radius, angle = part.radius * (np.arange(96) + 0.5) / 96, clear_azimuths(36, motion.axes["C"])
    decimals = dialect_of(machine).decimals
    c, x, z = (0.5 * 10.0 ** -decimals[letter] for letter in "CXZ")
    c = np.deg2rad(c)

    def made(one: Motion, **moved: float) -> Floats:
        axes = {**one.axes, **{letter: one.axes[letter] + by for letter, by in moved.items()}}
        return generate_polar(replace(one, axes=axes), tool, radius=radius, angle=angle, machine=machine).z

    here = made(motion)
    apart, by_x, by_c = (
        float(np.nanmax(np.abs(other - here))) for other in (made(again), made(motion, X=x), made(motion, C=c))
    )
    dense = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    cosine, sine = np.cos(dense)[:, None], np.sin(dense)[:, None]
    zx, zy = part.surface.gradient(radius * cosine, radius * sine)
    along = np.abs(zx * cosine + zy * sine).max() + motion.feed / (2 * tool.actual_radius)
    around = np.abs(zy * cosine - zx * sine)
    limit = z + max(x * along, by_x) + max(c * (around * radius).max(), by_c)
    if "Y" in motion.axes:
        limit += 0.5 * 10.0 ** -decimals["Y"] * around.max()
    if "W" in motion.axes:
        limit += np.abs(np.interp(motion.time, again.time, again.axes["W"]) - motion.axes["W"]).max()
    return apart * 1e6, float(limit) * 1e6


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
