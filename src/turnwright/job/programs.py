"""Write the program of a job, read it back, and compute the error contributions to its surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path as File
from typing import Any

import numpy as np

from turnwright.errors import LimitError
from turnwright.generation import generate_polar
from turnwright.heightmap import HeightMap
from turnwright.job.approach import Entry, entries_of
from turnwright.job.contributions import ErrorBreakdown, break_down_error, clear_azimuths
from turnwright.job.pass_plan import PassPlan, Watch
from turnwright.job.predicting import follow_motion
from turnwright.job.schema import Job
from turnwright.path import Motion
from turnwright.post import (
    ProgramFiles,
    ProgramHeader,
    ToolChange,
    dialect_of,
    read_fast_tool,
    read_nc,
    write_fast_tool,
    write_nc,
)
from turnwright.progress import Progress, StageProgress

__all__ = ["predicted_motion", "program_shares", "read_back", "rounding_effect", "write_programs"]


def write_programs(
    job: Job,
    motions: dict[str, Motion],
    out: File,
    update: Progress | None = None,
    entries: Mapping[str, Entry] | None = None,
) -> ProgramFiles:
    """Write the program of all passes, and the table of a fast tool if there is one."""
    entries = entries_of(job, motions) if entries is None else entries
    part, machine, file = job.part, job.machine, out / f"{job.program.name}.nc"
    stated = ", ".join(one for one in (part.material_name, part.material_note) if one)
    notes = f"material {stated}" if stated else ""
    first = job.for_pass(job.passes[0])
    header = ProgramHeader(design=part.name, tool=first.tool.name, notes=notes)
    start = replace(job.program.start, tool_call=job.passes[0].tool_call or job.program.tool_call)
    shared: dict[str, Any] = {
        "header": header, "start": start, "progress": update,
        "clearance": max(one.clearance for one in entries.values()),
        "depth": {name: one.depth for name, one in entries.items()}, "plunge_feed": job.program.plunge_feed,
        "entry_heights": {name: one.heights for name, one in entries.items()},
        "changes": tool_changes(job, list(motions), entries),
    }  # fmt: skip
    by = job.program.fast_tool
    if by is None:
        done = write_nc(motions, machine, file, max_lines=job.program.max_lines, **shared)
        return done if job.program.dry_run is None else _add_dry_run(job, motions, file, done, shared)
    (motion,) = motions.values()
    del shared["changes"]
    for each in ("depth", "entry_heights"):
        (shared[each],) = shared[each].values()  # the program of a fast tool has one pass, named by `write_fast_tool`
    both = write_fast_tool(motion, machine, file, by=by, rate_hz=job.program.fast_tool_rate, **shared)
    size = both.program.bytes + both.table.stat().st_size
    return replace(both.program, files=(*both.program.files, both.table), bytes=size)


def tool_changes(job: Job, names: Sequence[str], entries: Mapping[str, Entry]) -> dict[str, ToolChange]:
    """Return the changes of tool of a program before its cuts, by their names.

    Raises `LimitError` where the height of a change is beyond the travel of Z.
    """
    changes: dict[str, ToolChange] = {}
    cuts, height, before = job.cuts, job.program.change_height, None
    top = job.machine.axes["Z"].high
    for name in names:
        cut = cuts.get(name, job.passes[-1])
        tool, call = (cut.tool, cut.tool_call) if cut.tool is not None else (job.tool, job.program.tool_call)
        if height is not None and before not in (None, call):
            up = max(one.approach.clear for one in entries.values()) + height
            if top is not None and up > top:
                raise LimitError(
                    f"pass {name}: the tool is changed at Z {up:.4g} mm, the travel of {job.machine.name} ends at "
                    f"{top:g} mm: reduce program.change_height"
                )
            changes[name] = ToolChange(call=call, tool=tool.name, height=height)
        before = call
    return changes


def _add_dry_run(
    job: Job, motions: dict[str, Motion], file: File, done: ProgramFiles, shared: dict[str, Any]
) -> ProgramFiles:
    """Write the same program higher; return the files of both."""
    height = job.program.dry_run or 0.0
    higher = {name: replace(one, axes={**one.axes, "Z": one.axes["Z"] + height}) for name, one in motions.items()}
    notes = f"dry run, {height:g} mm above the cut"
    shared = shared | {"header": replace(shared["header"], notes=notes), "progress": None}
    dry = write_nc(higher, job.machine, file.with_stem(f"{file.stem}-dry"), max_lines=job.program.max_lines, **shared)
    return replace(done, files=(*done.files, *dry.files), bytes=done.bytes + dry.bytes)


def read_back(job: Job, file: File, name: str, update: Progress | None = None) -> Motion:
    """Read the finishing pass of a program, and the table of a fast tool if there is one."""
    machine = job.machine
    if job.program.fast_tool is not None:
        return read_fast_tool(file, machine, progress=update)
    return read_nc(file, machine, name=name, progress=update)


def predicted_motion(job: Job, file: File, name: str, *, progress: StageProgress | None = None) -> Motion:
    """Return the motion of the finishing pass of a program on disk, from which its surface is predicted."""
    watch = Watch(progress)
    with watch.stage("read program") as update:
        motion = read_back(job, file, name, update)
    ideal, real = follow_motion(job, motion, job.simulation.tracking, None, watch)
    return real or ideal


def program_shares(job: Job, file: File, name: str) -> ErrorBreakdown:
    """Return the error contributions to the form error of the finishing pass of a program on disk, by its name.

    Tool and machine are the nominal ones, as in `compare`. Without precorrection the motion is that of the program, so
    that the chord contribution includes that of its decimals.
    """
    part, tool, plan = job.part.aimed, job.tool, PassPlan(job)
    motion = read_back(job, file, name)
    if not job.program.precorrect:
        return break_down_error(part, tool, plan.spiral, motion)
    return break_down_error(part, tool, plan.spiral, plan.commanded, program_motion=motion, nominal=plan.nominal)


def rounding_effect(job: Job, motion: Motion, again: Motion) -> tuple[float, float]:
    """Return the largest difference between the surfaces of the motion and of the program read back, and its limit.

    Both are in nm. The numbers of a program have errors of up to half of their last decimal. An error of Z appears on
    the surface as it is. One of X is multiplied by the radial slope, including that of the cusps (half a feed over the
    nose radius). One of C is multiplied by the slope around the axis and by the radius, one of Y by that slope alone.
    An actual tool that is off its nominal position meets other slopes, so the surface of a motion shifted by these
    errors is used where it differs by more. For a fast tool, the difference of its heights as read is added, including
    the error of linear interpolation in a table by time.
    """
    part, tool, machine = job.part, job.actual_tool, job.actual_machine
    radius = part.nearest + (part.reach - part.nearest) * (np.arange(96) + 0.5) / 96
    angle = clear_azimuths(36, motion.axes["C"])
    decimals = dialect_of(machine).decimals
    c, x, z = (0.5 * 10.0 ** -decimals[letter] for letter in "CXZ")
    c = np.deg2rad(c)
    if motion.spindle_mode is not None:  # decimals of feed and path add up to a difference in revolutions
        c = float(np.abs(again.axes["C"][-1] - motion.axes["C"][-1])) + 1e-9

    def surface(one: Motion, turned: float = 0.0) -> HeightMap:
        return generate_polar(one, tool, radius=radius, angle=angle - turned, machine=machine)

    nominal = part.crop(surface(motion)).z
    shifted = replace(motion, axes={**motion.axes, "X": motion.axes["X"] + x})
    difference, by_x, by_c = (
        float(np.nanmax(np.abs(other.z - nominal))) for other in (surface(again), surface(shifted), surface(motion, c))
    )
    dense = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    cosine, sine = np.cos(dense)[:, None], np.sin(dense)[:, None]
    zx, zy = part.continuation.gradient(radius * cosine, radius * sine)
    along = np.abs(zx * cosine + zy * sine).max() + motion.feed / (2 * tool.actual_radius)
    around = np.abs(zy * cosine - zx * sine)
    limit = z + max(x * along, by_x) + max(c * (around * radius).max(), by_c)
    if "Y" in motion.axes:
        limit += 0.5 * 10.0 ** -decimals["Y"] * around.max()
    if "W" in motion.axes:
        limit += np.abs(np.interp(motion.time, again.time, again.axes["W"]) - motion.axes["W"]).max()
    return difference * 1e6, float(limit) * 1e6
