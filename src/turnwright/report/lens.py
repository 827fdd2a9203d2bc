"""Picture of a surface of a lens file: its section with the material, and the part seen from the tool with a mark."""

from __future__ import annotations

from pathlib import Path as File
from typing import TYPE_CHECKING

import numpy as np

from turnwright.report.figures import (
    HEIGHTS,
    PLAIN_STYLE,
    _arrow,
    _bar,
    _Canvas,
    _length,
    _plan,
    _show_sag,
    _styled,
)

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.axes import Axes

    from turnwright.files import LensSide, LensSurface
    from turnwright.part import Part

__all__ = ["write_lens_picture"]

MATERIAL, LIGHT, TOOL = "0.75", "tab:orange", "tab:blue"

PLAIN = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
"""Ground of a word that may stand on the hatching."""

MARK = np.array([(-0.12, 0.42), (-0.12, -0.28), (0.22, -0.28)])
"""The letter L in the frame of the lens file: its long leg along +y, its foot along +x, in fractions of the part."""


def write_lens_picture(part: Part, surface: LensSurface, side: LensSide, path: str | PathLike[str]) -> None:
    """Write a picture of the surface that is cut, as ``.png``, ``.svg`` or ``.pdf`` by the suffix of the file.

    Left the section x = 0 in the frame of the lens file, with the material, the arriving light and the tool; right the
    heights of the part as the tool sees it, with an L that reads as an L in the frame of the lens file.
    """
    with _styled(PLAIN_STYLE):
        canvas = _Canvas(9.2, 4.4, 160)
        section, plan = canvas.figure.subplots(1, 2, width_ratios=(1, 1.25))
        _draw_section(section, part, surface, side)
        _, sag = _show_sag(part)
        factor, unit = _length(float(np.nanmax(sag) - np.nanmin(sag)))
        image = _plan(plan, sag * factor, part.border, cmap=HEIGHTS)
        x_low, x_high, y_low, y_high = part.border.box
        turned = np.array([-1.0 if side.is_turned else 1.0, 1.0])
        mark = MARK * turned * min(x_high - x_low, y_high - y_low) / 2 + ((x_low + x_high) / 2, (y_low + y_high) / 2)
        plan.plot(*mark.T, color="white", linewidth=3.2, solid_joinstyle="miter")
        plan.plot(*mark.T, color="black", linewidth=1.4, solid_joinstyle="miter")
        plan.set(
            title="part from the tool; L: leg +y, foot +x of the lens file", xlabel="part x [mm]", ylabel="part y [mm]"
        )
        _bar(canvas, plan, image, f"part z [{unit}]")
        canvas.figure.suptitle(side.sentence.replace("; ", "\n"), fontsize=8.5)
        canvas.write(File(path))


def _draw_section(axes: Axes, part: Part, surface: LensSurface, side: LensSide) -> None:
    """Draw the section through the middle of the part, z of the lens file to the right."""
    x_low, x_high, low, high = part.border.box
    y = np.linspace(low, high, 401)
    across = np.full_like(y, (x_low + x_high) / 2)
    z = part.heights(across, y) * (-1.0 if side.is_turned else 1.0)
    depth = side.toward * max(0.35 * (high - low), 1.2 * float(np.nanmax(z) - np.nanmin(z)))
    base = np.nanmax(z) if side.toward > 0 else np.nanmin(z)
    axes.fill_betweenx(y, z, base + depth, facecolor=MATERIAL, hatch="///", edgecolor="0.45", linewidth=0)
    axes.plot(z, y, color="black", linewidth=1.6)
    middle = float(z[len(z) // 2]) if np.isfinite(z[len(z) // 2]) else float(np.nanmean(z))
    level = (low + high) / 2
    tip = middle - 0.06 * depth
    _arrow(axes, (middle - 0.75 * depth, level), (tip, level), TOOL)
    axes.text(middle - 0.78 * depth, level, "tool", color=TOOL, ha="right" if depth > 0 else "left", va="center")
    if surface.heading:
        above = level + 0.32 * (high - low)
        start = middle - surface.heading * 0.75 * abs(depth)
        _arrow(axes, (start, above), (start + surface.heading * 0.5 * abs(depth), above), LIGHT)
        axes.text(start, above + 0.03 * (high - low), "light", color=LIGHT, ha="center", va="bottom", bbox=PLAIN)
    ends = sorted((middle - 1.1 * depth, base + 1.1 * depth))
    axes.set(xlim=ends, ylim=(low - 0.06 * (high - low), high + 0.06 * (high - low)))
    axes.set_aspect("equal")
    axes.set(
        title=f"surface {side.number}, {side.material or 'material'} hatched",
        xlabel="z of the lens file [mm]", ylabel="y of the lens file [mm]",
    )  # fmt: skip
