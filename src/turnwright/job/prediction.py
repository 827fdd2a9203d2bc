"""The predicted surface of the whole part, or of a patch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from turnwright.heightmap import HeightMap
from turnwright.job.contributions import pv_nm_of, rms_nm_of
from turnwright.job.extremes import Extremes
from turnwright.job.interpolation import CHORD_TOL
from turnwright.metrology import Roughness

__all__ = ["Prediction"]

CHORD_REPORT_RATIO = 1.01
"""Ratio to `CHORD_TOL` above which the distance from the curves is reported; second differences resolve it to 1 %."""


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
    chord_error
        Distance between the simulated linear segments and the controller's curves. [mm]
    form
        Highest and lowest point of the whole part, which a grid hits only by chance; ``None`` for a patch.
    finish_nm
        Sq of the roughest ring of the whole part, where the job states a tolerance and has no patch; else ``None``.
    form_values
        Quantities of ISO 10110-5 by symbol, from radial lines that cross every revolution, where the job states a
        call-out of form; else ``None``. [mm]
    cusp_order
        Largest share of the light in one diffraction order of the cusps, where the job states a tolerance; else
        ``None``.
    outside
        Number of points of the map outside the outline of the part, which have no height.
    """

    name: str
    error: HeightMap
    roughness: Roughness
    tracking: HeightMap | None = None
    above_stock: int = 0
    chord_error: float = 0.0
    form: Extremes | None = None
    finish_nm: float | None = None
    form_values: Mapping[str, float] | None = None
    cusp_order: float | None = None
    outside: int = 0

    @property
    def uncut(self) -> int:
        """Number of points that no pass cuts."""
        return int(np.count_nonzero(np.isnan(self.error.z))) - self.outside + self.above_stock

    @property
    def remarks(self) -> tuple[str, ...]:
        """Limitations of the map, a sentence each."""
        remarks = []
        if self.uncut:
            why = "no pass reaches them" + (", or only above the stock" if self.above_stock else "")
            remarks.append(f"{self.name}: {self.uncut:,} of {self.error.z.size:,} points are not cut: {why}")
        if self.chord_error > CHORD_REPORT_RATIO * CHORD_TOL:
            remarks.append(
                f"{self.name}: simulated in linear segments within {self.chord_error * 1e6:.2g} nm of the curves of "
                "the controller, memory allows no more segments"
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
