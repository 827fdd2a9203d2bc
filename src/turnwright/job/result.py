"""The result of a run: the report, the archive and `result.json` are written from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright.job.contributions import pv_nm_of, rms_nm_of
from turnwright.job.interpolated import CHORD_TOL
from turnwright.job.verdict import judge, missed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turnwright.access import Access
    from turnwright.cutting import ChipMap
    from turnwright.heightmap import HeightMap
    from turnwright.job.approach import Entry
    from turnwright.job.cutting import PassChips
    from turnwright.job.extremes import Extremes
    from turnwright.job.schema import Job
    from turnwright.job.shape import PartShape
    from turnwright.job.verdict import Verdict
    from turnwright.machine import Machine
    from turnwright.metrology import Roughness
    from turnwright.motion import Limits
    from turnwright.part import Part
    from turnwright.path import Motion, Path
    from turnwright.post import ProgramFiles
    from turnwright.tool import Tool

__all__ = ["Pass", "Prediction", "Preview", "Result"]

CHORD_REPORT_RATIO = 1.01
"""Ratio to `CHORD_TOL` above which the distance from the curves is reported; second differences resolve it to 1 %."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Preview:
    """What is known of a job without computing its tool path beyond the outermost revolution.

    Parameters
    ----------
    access
        Whether the tool reaches the part.
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
class Prediction:
    """Predicted surface of the whole part or of a patch, from the program read back from disk.

    Parameters
    ----------
    name
        Name of the patch; "whole part" is the polar map.
    error
        Predicted surface minus the design. [mm]
    roughness
        After form removal; for the whole part without form removal, on a grid too coarse to show every cusp.
    tracking
        Contribution of the servos: error with them minus error without; ``None`` if they were not simulated. [mm]
    above_stock
        Number of points where the deepest pass stays above the stated stock, so that nothing is cut.
    off_curves
        Distance between the simulated linear segments and the controller's curves. [mm]
    form
        Highest and lowest point of the whole part, which a grid hits only by chance; ``None`` for a patch.
    finish_nm
        Sq of the roughest ring of the whole part, where the job states a tolerance and has no patch; else ``None``.
    """

    name: str
    error: HeightMap
    roughness: Roughness
    tracking: HeightMap | None = None
    above_stock: int = 0
    off_curves: float = 0.0
    form: Extremes | None = None
    finish_nm: float | None = None

    @property
    def uncut(self) -> int:
        """Number of points that no pass cuts."""
        return int(np.count_nonzero(np.isnan(self.error.z))) + self.above_stock

    @property
    def remarks(self) -> tuple[str, ...]:
        """Limitations of the map, a sentence each."""
        remarks = []
        if self.uncut:
            why = "no pass reaches them" + (", or only above the stock" if self.above_stock else "")
            remarks.append(f"{self.name}: {self.uncut:,} of {self.error.z.size:,} points are not cut: {why}")
        if self.off_curves > CHORD_REPORT_RATIO * CHORD_TOL:
            remarks.append(
                f"{self.name}: simulated in linear segments within {self.off_curves * 1e6:.2g} nm of the curves of the "
                "controller, memory allows no more segments"
            )
        return tuple(remarks)

    @property
    def pv_nm(self) -> float:
        """Peak to valley: of the whole part from its highest to its lowest point, of a patch on its grid."""
        return self.roughness.pv_nm if self.form is None else self.form.pv_nm

    @property
    def tracking_nm(self) -> tuple[float, float] | None:
        """Peak to valley and rms over the area of the contribution of the servos, or ``None``."""
        if self.tracking is None:
            return None
        return pv_nm_of(self.tracking.z), rms_nm_of(self.tracking)


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
    passes
        In the order of cutting; the last one is the finishing pass.
    path, motion
        The finishing pass, thinned to a few ten thousand points for plots.
    turns
        Single revolutions of the finishing pass with all their points: at the rim, half-way and near the axis.
    least_clearance
        Smallest height of the edge above the surface over the finishing path: 0 in contact. [mm]
    program
        The files written, with their sizes and hashes.
    predictions
        Maps of the predicted surface minus the design, from the program read back from disk.
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
    passes: tuple[Pass, ...]
    path: Path
    motion: Motion
    turns: tuple[Motion, ...]
    least_clearance: float
    program: ProgramFiles
    predictions: tuple[Prediction, ...]
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
        return not missed(self.verdicts)
