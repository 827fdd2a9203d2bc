"""Picture of the lenslet dislocations of a lens array."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from turnwright.report.figures import INK, LINE, SERIES, Picture, _canvas

if TYPE_CHECKING:
    from turnwright.metrology import Lenslets

__all__ = ["dislocation_map"]

UM = 1e3


def dislocation_map(found: Lenslets) -> Picture:
    """Draw the dislocations with their mean removed, and the residual after shift, rotation and scale.

    Each panel scales its arrows by its own root mean square, given in the title. A cross is a lenslet that could not
    be fitted.
    """
    design, is_measured = found.design, found.measured
    reach = float(np.ptp(design, axis=0).max()) or 1.0
    panels = [("mean removed", found.centred)]
    if found.alignment is not None:
        rotation, scale = found.alignment.rotation * 1e6, found.alignment.scale * 1e6
        panels.append((f"without rotation {rotation:.4g} µrad and scale {scale:.4g} ppm", found.irregular))
    titles = []
    with _canvas(5.3 * len(panels), 4.6) as canvas:
        for axes, (name, dislocation) in zip(
            np.atleast_1d(canvas.figure.subplots(1, len(panels))), panels, strict=True
        ):
            rms = float(np.sqrt(np.mean(np.sum(dislocation[is_measured] ** 2, axis=1)))) if is_measured.any() else 0.0
            length = 0.08 * reach / rms if rms > 0 else 0.0
            axes.plot(*design[is_measured].T, ".", color=LINE, markersize=3)
            axes.plot(*design[~is_measured].T, "x", color=SERIES[1], markersize=6)
            if length:
                axes.quiver(
                    *design[is_measured].T, *(dislocation[is_measured] * length).T,
                    angles="xy", scale_units="xy", scale=1, color=SERIES[0], width=0.004,
                )  # fmt: skip
            titles.append(f"{name}: {rms * UM:.3g} µm rms")
            axes.set_title(titles[-1], color=INK)
            axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
            axes.margins(0.12)
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
    lost = f"; {np.count_nonzero(~is_measured)} lenslets could not be fitted" if not is_measured.all() else ""
    return Picture(canvas.svg, f"Dislocations of {is_measured.size} lenslets, {', '.join(titles)}{lost}.")
