"""From what is wrong to a job that comes out right: the same pipeline with better inputs."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as File
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from turnwright._whole import write_whole
from turnwright.errors import InputError
from turnwright.files import write_map
from turnwright.heightmap import HeightMap
from turnwright.job._finish import finished
from turnwright.job._measure import Measured, cutoff_of, same_part
from turnwright.job._schema import Job
from turnwright.job._shares import pv_nm_of, rms_nm_of
from turnwright.job._text import edited
from turnwright.job._verdict import Verdict, judge_form
from turnwright.part import correction_of
from turnwright.tool import WavinessTable
from turnwright.units import write

if TYPE_CHECKING:
    from os import PathLike

    from turnwright._arrays import Floats, Ints
    from turnwright.diagnosis import Diagnosis
    from turnwright.machine import Machine
    from turnwright.part import Part
    from turnwright.progress import StageProgress
    from turnwright.tool import Tool

__all__ = ["Correction", "correct"]

SHOWN = 40_000
"""Points at which the corrected part is predicted."""

PLANNED = frozenset({"offset x", "offset y", "offset z", "radius error", "waviness", "squareness", "straightness"})
"""Causes that planning with the real tool and machine takes care of."""

MOUNT = frozenset({"astigmatism", "trefoil"})
"""Causes that are not in the cut."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correction:
    """A better job, and what it should leave.

    Parameters
    ----------
    job
        With the tool and the machine as they were found, aiming at the part without what repeats besides.
    file
        Where it is written; the files that it names stand beside it.
    cutoff
        Wavelength from which the part itself is corrected, or ``None`` if nothing but noise is left there. [mm]
    measured
        Cut minus design as it was measured, at some points; ``None`` if the part itself was not. [mm]
    predicted
        The same after the correction, if all that was found repeats: what the corrected job leaves by simulation, and
        what of the measurement no correction reaches, its noise among it. [mm]
    simulated
        Cut minus design of the corrected job by simulation, if the causes are as found. [mm]
    """

    job: Job
    file: File
    cutoff: float | None
    measured: HeightMap | None
    predicted: HeightMap | None
    simulated: HeightMap

    @property
    def numbers_nm(self) -> dict[str, tuple[float, float]]:
        """Peak to valley and root mean square of each map that there is. [nm]."""
        maps = {"measured": self.measured, "predicted": self.predicted, "simulated": self.simulated}
        return {name: (pv_nm_of(one.z), rms_nm_of(one)) for name, one in maps.items() if one is not None}

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Which stated tolerances the corrected part should keep, at the places that it is predicted at."""
        pv_nm, _ = self.numbers_nm["simulated" if self.predicted is None else "predicted"]
        return judge_form(self.job, pv_nm, sq_reason="a correction predicts the form, run the job")


def correct(
    job: Job,
    found: Diagnosis,
    measured: Measured | Sequence[Measured] | None = None,
    *,
    out: str | PathLike[str],
    source: str | PathLike[str] | None = None,
    progress: StageProgress | None = None,
) -> Correction:
    """Write the job that takes what was found into account, and predict what it leaves.

    Tool and machine become what they were found to be, as far as that is worth correcting. What is left of the measured
    part, if it repeats from one half of the points to the other, is taken off the surface that is aimed at; the design
    stays what everything is judged by. What a mount does to the part while it is measured or held is not corrected.

    Parameters
    ----------
    job
        To be corrected: that of the measured part, or of another that is cut with this tool on this machine.
    found
        Why measured parts were off, see `explain`.
    measured
        What was explained, if the part that the job has cut was among it and was the first; the part as earlier jobs
        have cut it counts with it. Without it only tool and machine are corrected.
    out
        Folder for ``job.toml`` and the files that it names; it is made if there is none.
    source
        The file that the job was read from: its text is kept but for what changes. Without it all is written anew.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InputError
        If the job was not planned with the tool and machine of the measured parts.
    """
    report = progress or (lambda _stage, _done, _total: None)
    _check(job, found)
    text, beside = ("", File()) if source is None else (File(source).read_bytes().decode(), File(source).parent)
    out = File(out).resolve()  # the job names its files beside itself, wherever it is read from
    out.mkdir(parents=True, exist_ok=True)
    part = job.part.part
    table = tomllib.loads(job.to_toml())
    _put_tool(table["tool"], found.tool, job.tool.tool, out)
    _put_machine(table["machine"], found.machine, job.machine.machine, out)
    table.pop("actual", None)  # the correction is its prediction now
    cutoff, left = None, None
    report("correct the part", 0, 1)
    every = [measured] if isinstance(measured, Measured) else list(measured or ())
    if every:
        left = _left(found, [same_part(one.job, job) for one in every])
        cutoff = _put_correction(table["part"], job, part, left, out)
    report("correct the part", 1, 1)
    better = Job.read(table, folder=out)
    file = out / "job.toml"
    write_whole(file, edited(text, job, better, folder=beside, into=out))
    report("simulate", 0, 1)
    x, y = _places(job.part.part, left)
    simulated = _simulated(better, x, y)
    report("simulate", 1, 1)
    if left is None:
        return Correction(job=better, file=file, cutoff=cutoff, measured=None, predicted=None, simulated=simulated)
    # What is left was measured beside what was added already, which the simulation of the new aim has in it.
    again = 0.0 if job.part.added is None else job.part.added.evaluate(x, y, 0)[0]
    predicted = replace(simulated, z=simulated.z + left.z[:: _step(left)] - again, name="predicted error")
    error = every[0].error
    step = _step(error)
    x, y = error.points()
    before = HeightMap(x=x[::step], y=y[::step], z=error.z[::step], name="measured error")
    return Correction(job=better, file=file, cutoff=cutoff, measured=before, predicted=predicted, simulated=simulated)


def _check(job: Job, found: Diagnosis) -> None:
    """Raise unless the job cuts with the tool on the machine that were diagnosed, whatever their deviations."""
    tool, machine = job.tool.tool, job.machine.machine
    if (tool.nose_radius, tool.included, tool.rake) != (found.tool.nose_radius, found.tool.included, found.tool.rake):
        raise InputError(
            f"the job cuts with a nose radius {tool.nose_radius:g} mm, the measured parts were cut with "
            f"{found.tool.nose_radius:g} mm or another edge: correct a job of the tool that was measured"
        )
    if machine.name != found.machine.name:
        raise InputError(
            f"the job is for the machine {machine.name!r}, the measured parts were cut on {found.machine.name!r}: "
            "correct a job of the machine that was measured"
        )


def _left(found: Diagnosis, own: Sequence[bool]) -> HeightMap:
    """Return what neither tool nor machine takes care of, but repeats, in those maps that are of the part. [mm]."""
    also = [
        finding.name
        for finding in found
        if finding.verdict == "correct" and finding.cause not in PLANNED and finding.cause not in MOUNT
    ]
    points = []
    for residual, signatures, counts in zip(found.residuals, found.signatures, own, strict=True):
        if not counts:
            continue
        z, x, y = (one.ravel() for one in (residual.z, *residual.points()))
        if also:
            # The marks are known at some of the points.
            marks = [signatures[name] for name in also]
            at = _among(marks[0], residual)
            z, x, y = z[at] + sum(mark.z.ravel() for mark in marks), x[at], y[at]
        known = ~np.isnan(z)
        points.append((x[known], y[known], z[known]))
    x, y, z = (np.concatenate(one) for one in zip(*points, strict=True))
    return HeightMap(x=x, y=y, z=z, name="left to correct")


def _step(many: HeightMap) -> int:
    """Return which so-manieth of many points are shown."""
    return -(-many.z.size // SHOWN)


def _among(few: HeightMap, many: HeightMap) -> Ints:
    """Return which points of a map those of a part of it are, in order of rows on a grid. (n,)."""
    if many.scattered:
        return _found(*(x + 1j * y for x, y in (few.points(), many.points())))
    rows, columns = (
        _found(getattr(few, name), getattr(many, name)) for name in (("angle", "radius") if many.polar else ("y", "x"))
    )
    return np.asarray((rows[:, None] * many.z.shape[1] + columns).ravel())


def _found(few: NDArray[Any], many: NDArray[Any]) -> Ints:
    """Return where values stand among others, which hold each of them. (n,)."""
    order = np.argsort(many, kind="stable")
    return np.asarray(order[np.searchsorted(many, few, sorter=order)])


def _put_tool(table: dict[str, Any], tool: Tool, planned: Tool, out: File) -> None:
    """State the tool as it was found."""
    if (tool.radius_error, tool.offset) != (planned.radius_error, planned.offset):
        table["radius_error"] = write(tool.radius_error, "mm")
        table["offset"] = [write(one, "mm") for one in tool.offset]
    if isinstance(tool.waviness, WavinessTable) and tool.waviness is not planned.waviness:
        table.pop("waviness", None)
        table["waviness_file"] = str(
            _columns(out / "waviness.csv", "sweep [rad],deviation [mm]", tool.waviness.sweep, tool.waviness.deviation)
        )


def _put_machine(table: dict[str, Any], machine: Machine, planned: Machine, out: File) -> None:
    """State the machine as it was found."""
    if machine.squareness != planned.squareness:
        table["squareness"] = write(machine.squareness, "rad")
    if machine.straightness is not None and machine.straightness is not planned.straightness:
        table["straightness_file"] = str(_columns(out / "straightness.csv", "x [mm],error [mm]", *machine.straightness))


def _columns(file: File, head: str, one: Floats, other: Floats) -> File:
    """Write two columns with every digit."""
    rows = (f"{a!r},{b!r}" for a, b in zip(one.tolist(), other.tolist(), strict=True))
    write_whole(file, "\n".join([head, *rows]) + "\n")
    return file


def _put_correction(table: dict[str, Any], job: Job, part: Part, left: HeightMap, out: File) -> float | None:
    """Aim at the part without what repeats; return the wavelength from which it is corrected now, or ``None``."""
    strategy, last = job.strategy, job.passes[-1]

    def stated(name: str) -> float:
        return getattr(last, name, None) or getattr(strategy, name, None) or 0.0

    cutoff = cutoff_of(job)
    tool = job.tool.tool
    half = np.pi / 2 if tool.included is None else tool.included / 2
    beyond = stated("lead_in") + stated("overrun") + tool.actual_radius * float(np.sin(half))
    smooth = correction_of(part, left, cutoff=cutoff, beyond=beyond, before=job.part.added)
    if smooth.cutoff is None:
        return None
    new = smooth.table
    file = out / "correction.npz"
    write_map(HeightMap(x=new.x, y=new.y, z=new.z, name="correction"), file)
    table["correction"] = str(file)
    return smooth.cutoff


def _places(part: Part, left: HeightMap | None) -> tuple[Floats, Floats]:
    """Return where the corrected part is predicted: some of the measured points, or evenly over the part."""
    if left is not None:
        x, y = left.points()
        return x[:: _step(left)], y[:: _step(left)]
    # Sunflower seeds: as many to every area.
    count = np.arange(SHOWN) + 0.5
    radius, angle = part.radius * np.sqrt(count / SHOWN), np.pi * (1 + np.sqrt(5)) * count
    return radius * np.cos(angle), radius * np.sin(angle)


def _simulated(job: Job, x: Floats, y: Floats) -> HeightMap:
    """Return what the finishing pass leaves, cut minus design."""
    z = finished(job, job, x, y)
    return HeightMap(x=x, y=y, z=z - job.part.part.surface.sag(x, y), name="simulated error")
