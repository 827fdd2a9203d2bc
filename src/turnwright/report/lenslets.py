"""The picture of a lens array: where every lenslet stands, as it is and without what the array does as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright.report.figures import INK, LINE, SERIES, Picture, _canvas

if TYPE_CHECKING:
    from turnwright.metrology import Lenslets

__all__ = ["dislocation_map"]

UM = 1e3


def dislocation_map(found: Lenslets) -> Picture:
    """Draw the dislocations with their mean removed, and beside them what shift, rotation and scale leave.

    Both have arrows of one length for their own root mean square, which the title says. A cross is a lenslet that
    could not be fitted.
    """
    design, seen = found.design, found.measured
    reach = float(np.ptp(design, axis=0).max()) or 1.0
    panels = [("mean removed", found.centred)]
    if found.alignment is not None:
        turned, grown = found.alignment.rotation * 1e6, found.alignment.scale * 1e6
        panels.append((f"without rotation {turned:.4g} µrad and scale {grown:.4g} ppm", found.irregular))
    told = []
    with _canvas(5.3 * len(panels), 4.6) as canvas:
        for axes, (name, away) in zip(np.atleast_1d(canvas.figure.subplots(1, len(panels))), panels, strict=True):
            rms = float(np.sqrt(np.mean(np.sum(away[seen] ** 2, axis=1)))) if seen.any() else 0.0
            length = 0.08 * reach / rms if rms > 0 else 0.0
            axes.plot(*design[seen].T, ".", color=LINE, markersize=3)
            axes.plot(*design[~seen].T, "x", color=SERIES[1], markersize=6)
            if length:
                axes.quiver(
                    *design[seen].T, *(away[seen] * length).T,
                    angles="xy", scale_units="xy", scale=1, color=SERIES[0], width=0.004,
                )  # fmt: skip
            told.append(f"{name}: {rms * UM:.3g} µm rms")
            axes.set_title(told[-1], color=INK)
            axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
            axes.margins(0.12)
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
    lost = f"; {np.count_nonzero(~seen)} lenslets were not found" if not seen.all() else ""
    return Picture(canvas.svg, f"Dislocations of {seen.size} lenslets, {', '.join(told)}{lost}.")
