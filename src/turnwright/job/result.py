"""What a run found out: one frozen value that the report, the archive and `result.json` are written from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from turnwright.job.contributions import pv_nm_of, rms_nm_of
from turnwright.job.interpolated import UNSEEN
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

SHOWN = 1.01
"""Share of `UNSEEN` from which on it is stated: second differences see it no better."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Preview:
    """What can be said of a job without placing the tool beyond its outermost turn.

    Parameters
    ----------
    access
        Whether the tool reaches the part.
    points
        Number of program points by pass; none where it would be refused.
    shortest_s
        The shortest time that block rate and spindle allow, by pass; the slides may need longer. [s]
    refused
        Why `run` would refuse it, a sentence each.
    chips
        What the material will make of each pass, by name, where it is known.
    remarks
        What was worked out for the surface and the job does not state, a sentence each.
    warnings
        Sizes that are hardly meant, a sentence each.
    shape
        What the surface looks like over the clear aperture.
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
        What the job calls it; a pass cut in several depths has one entry per depth, numbered.
    allowance
        Material left above the finished surface when it is done. [mm]
    depth
        Thickness that it takes off. [mm]
    feed
        [mm/rev]
    spindle_rpm
        Speed of the spindle, the highest within all limits where the job states none. [rev/min]
    points
        Number of program points.
    limits
        What it asks of the axes.
    chips
        What its chips are like; ``None`` where nothing is known of the material.
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
    """A place on the part as the program read back from disk will leave it.

    Parameters
    ----------
    name
        What the job calls it; "whole part" is the polar map.
    error
        Cut minus design. [mm]
    roughness
        After form removal; of the whole part without any, on a grid that is too coarse to show every cusp.
    tracking
        What of the error the servos add: with them minus without them; ``None`` if they were not asked. [mm]
    above_stock
        Number of points that the lowest pass leaves higher than the stated stock, so that it cuts nothing there.
    off_curves
        How far the straight pieces that were simulated are from the controller's curves. [mm]
    form
        Highest and lowest place of the whole part, which a grid meets by chance; ``None`` for a patch.
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
        """Number of points that no pass comes to, or only above the stock."""
        return int(np.count_nonzero(np.isnan(self.error.z))) + self.above_stock

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the map does not show, a sentence each."""
        found = []
        if self.uncut:
            why = "no pass comes there" + (", or only above the stock" if self.above_stock else "")
            found.append(f"{self.name}: {self.uncut:,} of {self.error.z.size:,} points are not cut: {why}")
        if self.off_curves > SHOWN * UNSEEN:
            found.append(
                f"{self.name}: simulated in straight pieces within {self.off_curves * 1e6:.2g} nm of the curves of the "
                "controller, memory allows no more pieces"
            )
        return tuple(found)

    @property
    def pv_nm(self) -> float:
        """Peak to valley: of the whole part from its highest to its lowest place, of a patch as its grid shows it."""
        return self.roughness.pv_nm if self.form is None else self.form.pv_nm

    @property
    def tracking_nm(self) -> tuple[float, float] | None:
        """Peak to valley and root mean square over the area of what the servos add, or ``None``."""
        if self.tracking is None:
            return None
        return pv_nm_of(self.tracking.z), rms_nm_of(self.tracking)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """What a run found out.

    Parameters
    ----------
    job, part, tool, machine
        What was asked for, as planned with.
    actual_tool, actual_machine
        What was simulated with; the same objects where the job states no deviations.
    access
        Whether the tool reaches the part.
    passes
        In the order of cutting, the last one finishes.
    path, motion
        The finishing pass, thinned to a few ten thousand points for pictures.
    turns
        Single turns of the finishing pass with all their points: at the rim, half-way and near the axis.
    least_clearance
        Least height of the whole edge above the surface over the whole finishing path: 0 in contact. [mm]
    program
        The files written, their size and hashes.
    predictions
        Maps of the surface that the program read back from disk will leave, minus the design.
    rounding_nm
        Largest difference between the back-plots of the program on disk and of the motion in memory.
    rounding_limit_nm
        What the program's decimals allow that difference to be.
    chips
        The chips of each pass at up to 20,000 points, by name, where the material is known.
    entries
        How the tool enters the material of each pass, by its name.
    warnings
        One sentence each.
    timings
        Wall time of each stage. [s]
    peak_memory_gb
        Largest resident memory of the process so far. [GB]
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
        """What the finishing pass asks of the axes."""
        return self.passes[-1].limits

    @property
    def ok(self) -> bool:
        """Whether the tool reaches the part and the machine keeps all its limits."""
        return bool(self.access.ok and all(cut.limits.ok for cut in self.passes))

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Which stated tolerances the predicted surface keeps."""
        return judge(self.job, self.predictions)

    @property
    def keeps_tolerances(self) -> bool:
        """Whether no stated tolerance is missed."""
        return not missed(self.verdicts)
