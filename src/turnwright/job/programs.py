"""The program of a job: written, read back, and what its surface has of each cause."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from turnwright.generation import generate_polar
from turnwright.job.approach import Entry, entries_of
from turnwright.job.contributions import ErrorBreakdown, break_down_error, clear_azimuths
from turnwright.job.pass_plan import PassPlan, Watch
from turnwright.job.predicting import followed
from turnwright.post import ProgramFiles, ProgramHeader, dialect_of, read_fast_tool, read_nc, write_fast_tool, write_nc

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path as File

    from turnwright._arrays import Floats
    from turnwright.job.schema import Job
    from turnwright.path import Motion
    from turnwright.progress import Progress, StageProgress

__all__ = ["predicted_motion", "program_shares", "read_back", "rounding", "written"]


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
    ideal, real = followed(job, motion, job.simulation.tracking, None, watch)
    return real or ideal


def program_shares(job: Job, file: File, name: str) -> ErrorBreakdown:
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
    part, tool, plan = job.part.aimed, job.tool, PassPlan(job)
    again = read_back(job, file, name)
    if not job.program.precorrect:
        return break_down_error(part, tool, plan.spiral, again)
    return break_down_error(part, tool, plan.spiral, plan.commanded, again=again, meant=plan.meant)


def rounding(job: Job, motion: Motion, again: Motion) -> tuple[float, float]:
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
