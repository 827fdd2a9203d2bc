"""The result of a run: the report, the archive and `result.json` are written from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from turnwright.access import Access, AccessFinding
from turnwright.cutting import ChipMap
from turnwright.job.approach import Entry
from turnwright.job.cutting import PassChips
from turnwright.job.optics import OpticalPerformance
from turnwright.job.prediction import Prediction
from turnwright.job.schema import Job
from turnwright.job.shape import PartShape
from turnwright.job.verdict import Verdict, any_missed, judge
from turnwright.machine import Machine
from turnwright.motion import Limits
from turnwright.part import Part
from turnwright.path import Motion, Path
from turnwright.post import ProgramFiles
from turnwright.tool import Tool

__all__ = ["Pass", "Preview", "Result"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Preview:
    """What is known of a job without computing its tool path beyond the outermost revolution.

    Parameters
    ----------
    access
        Whether the tool reaches the part.
    findings
        Its findings, then those of the tools of roughing passes.
    points
        Number of program points by pass; none where it would be refused.
    shortest_s
        Shortest cycle time that block rate and spindle speed allow, by pass; the slides may need longer. [s]
    refused
        Why `run` would refuse it, a sentence each.
    chips
        Predicted chip thickness and regime of each pass in words, by name, where the material is known.
    remarks
        Values computed for the surface that the job does not state, a sentence each.
    warnings
        Implausible sizes, a sentence each.
    shape
        Sag, slope and curvature of the surface over the clear aperture.
    """

    access: Access
    findings: tuple[AccessFinding, ...]
    points: Mapping[str, int]
    shortest_s: Mapping[str, float]
    refused: tuple[str, ...]
    chips: Mapping[str, str]
    remarks: tuple[str, ...]
    warnings: tuple[str, ...]
    shape: PartShape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pass:
    """One pass over the part, as it was programmed.

    Parameters
    ----------
    name
        Name in the job; a pass cut in several depths has one numbered entry per depth.
    allowance
        Material left above the finished surface after the pass. [mm]
    depth
        Depth of cut. [mm]
    feed
        Mean feed. [mm/rev]
    spindle_rpm
        Spindle speed, the highest within all limits where the job states none. [rev/min]
    points
        Number of program points.
    limits
        Speed, acceleration and jerk of the axes against the limits of the machine.
    chips
        Uncut chip thickness; ``None`` for a material without data.
    """

    name: str
    allowance: float
    depth: float
    feed: float
    spindle_rpm: float
    points: int
    limits: Limits
    chips: PassChips | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """The result of a run.

    Parameters
    ----------
    job, part, tool, machine
        The job, and the nominal part, tool and machine that the passes are planned with.
    actual_tool, actual_machine
        Tool and machine of the simulation; the same objects where the job states no deviations.
    access
        Whether the tool reaches the part.
    findings
        Its findings, then those of the tools of roughing passes.
    passes
        In the order of cutting; the last one is the finishing pass.
    path, motion
        The finishing pass, thinned to a few ten thousand points for plots.
    revolutions
        Single revolutions of the finishing pass with all their points: at the rim, half-way and near the axis.
    least_clearance
        Smallest height of the edge above the surface over the finishing path: 0 in contact. [mm]
    program
        The files written, with their sizes and hashes.
    predictions
        Maps of the predicted surface minus the design, from the program read back from disk.
    optics
        Optical performance; ``None`` unless the job states ``optics``.
    rounding_nm
        Largest difference between the surfaces of the program on disk and of the motion in memory.
    rounding_limit_nm
        Limit of that difference from the decimals of the program.
    chips
        Chips of each pass at up to 20,000 points, by name, where the material is known.
    entries
        How the tool enters the material in each pass, by name.
    warnings
        One sentence each.
    timings
        Wall time of each stage. [s]
    peak_memory_gb
        Peak resident memory of the process. [GB]
    """

    job: Job
    part: Part
    tool: Tool
    machine: Machine
    actual_tool: Tool
    actual_machine: Machine
    access: Access
    findings: tuple[AccessFinding, ...]
    passes: tuple[Pass, ...]
    path: Path
    motion: Motion
    revolutions: tuple[Motion, ...]
    least_clearance: float
    program: ProgramFiles
    predictions: tuple[Prediction, ...]
    optics: OpticalPerformance | None
    rounding_nm: float
    rounding_limit_nm: float
    chips: Mapping[str, ChipMap]
    entries: Mapping[str, Entry]
    warnings: tuple[str, ...]
    timings: Mapping[str, float]
    peak_memory_gb: float

    @property
    def limits(self) -> Limits:
        """Speed, acceleration and jerk of the axes in the finishing pass against the limits of the machine."""
        return self.passes[-1].limits

    @property
    def ok(self) -> bool:
        """Whether the tool reaches the part and every pass stays within the limits of the machine."""
        return bool(self.access.ok and all(cut.limits.ok for cut in self.passes))

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdict on each stated tolerance of the predicted surface."""
        return judge(self.job, self.predictions)

    @property
    def keeps_tolerances(self) -> bool:
        """Whether no stated tolerance is missed."""
        return not any_missed(self.verdicts)
