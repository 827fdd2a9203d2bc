"""Uncut chip thickness and forces of the passes of a job, and whether the cut stays in the ductile regime."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from turnwright._arrays import Ints
from turnwright.access import Access
from turnwright.cutting import ChipMap, DuctileCheck, check_ductile, chip_map, predict_chips
from turnwright.errors import InputError
from turnwright.job.schema import Job, PassTable
from turnwright.path import Motion
from turnwright.progress import Progress
from turnwright.units import say_length

__all__ = ["PassChips", "chips_of", "predicted_chips"]

MAX_POINTS = 20_000
"""Points of a pass at which the chip is computed, spread evenly over the area. Eight times as many change the largest
chip thickness of the infrared lens and of an array of lenses by less than 0.1 %."""

FIRST_REV_POINTS = 72
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""Azimuth between successive points of a sunflower pattern, which has no gaps and no rows. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PassChips:
    """Summary of the uncut chip thickness and the forces of a pass; ``None`` where the material has no data."""

    thickest: float  # largest chip thickness within the clear aperture [mm]
    typical: float  # the median [mm]
    entering: float  # largest chip thickness while the tool enters at the rim [mm]
    where: tuple[float, float]  # position of the largest chip thickness [mm]
    rake_range: tuple[float, float]  # lowest and highest effective rake angle [rad]
    axial: float | None  # largest thrust force along Z [N]
    cutting: float | None  # largest cutting force [N]
    critical: float | None = None  # critical chip thickness where the margin is smallest [mm]
    margin: float | None = None  # the smallest
    margin_uncertainty: float | None = None  # at 95 %
    share: float = 0.0  # fraction of the area where the chip is thicker than the critical thickness
    fracture: float | None = None  # depth of cracks below the surface that the pass leaves [mm]
    largest_feed: float | None = None  # in the ductile regime; None where every feed is [mm/rev]
    verdict: Literal["ductile", "uncertain", "brittle"] = "ductile"  # uncertain: margin below its uncertainty
    ok: bool = True  # whether the pass is ductile, or later passes remove the cracked layer
    sentence: str = ""


def chips_of(
    job: Job, motion: Motion, before: Motion | None, allowance: float, depth: float, update: Progress
) -> tuple[PassChips, ChipMap] | str:
    """Return the chips of a pass, or the reason why they cannot be computed.

    Without a motion ``before`` the stock is the finished surface raised by allowance and depth.
    """
    material, part = job.part.substance, job.part
    if before is None and not part.stock > 0:
        return "chip thickness of the first pass needs the stock, the part states none: add part.stock"
    try:
        chips = chip_map(
            motion, job.tool, part, before=before, stock=allowance + depth if before is None else None,
            material=material, points=_spread(motion), progress=update,
        )  # fmt: skip
    except InputError as error:
        return f"chip thickness cannot be computed: {error}"
    inside = chips.inside
    report = PassChips(
        thickest=chips.thickest,
        typical=float(np.median(chips.thickness[inside])) if inside.any() else 0.0,
        entering=chips.entering,
        where=chips.where,
        rake_range=(float(chips.rake.min()), float(chips.rake.max())),
        axial=None if chips.axial is None else float(chips.axial[inside].max(initial=0.0)),
        cutting=None if chips.cutting is None else float(chips.cutting[inside].max(initial=0.0)),
    )
    if material is None or material.critical is None:
        return replace(report, sentence="ductile at any chip thickness, the material has no critical thickness"), chips
    gate = check_ductile(chips, material, job.tool, allowance=allowance)
    report = replace(
        report,
        critical=float(gate.critical[gate.worst]), margin=float(gate.margin[gate.worst]),
        margin_uncertainty=gate.uncertainty,
        share=gate.share, fracture=gate.fracture,
        largest_feed=gate.largest_feed if np.isfinite(gate.largest_feed) else None,
        verdict=gate.verdict, ok=gate.ok, sentence=gate.sentence,
    )  # fmt: skip
    return _with_first_revolution(report, chips, gate, part.reach), chips


def _with_first_revolution(report: PassChips, chips: ChipMap, gate: DuctileCheck, radius: float) -> PassChips:
    """Add the chips of the first revolution, if it begins within the clear aperture."""
    away = np.hypot(chips.x, chips.y)
    first = ~chips.inside & (away <= radius)
    cracked = float(chips.fracture[first].max(initial=0.0))
    harmless = gate.fracture is not None and (cracked == 0 or cracked < gate.allowance)
    if harmless or not (gate.margin[first] < 0).any():
        return report
    sentence = (
        f"{report.sentence}; but the first revolution cuts into uncut stock within the clear aperture, its chip is "
        f"{say_length(float(chips.thickness[first].max()))} thick"
    )
    if away[first].max() > radius / 2:
        sentence += ": increase lead_in, so that this revolution lies outside"
    return replace(report, ok=False, sentence=sentence)


def _spread(motion: Motion) -> Ints:
    """Return indices of points spread over the area, and of some of the first revolution, in order. (n,)."""
    size = motion.time.size
    if size <= MAX_POINTS:
        return np.arange(size)
    c, x = motion.axes["C"] * motion.sense, np.abs(motion.axes["X"])
    # C where the motion reaches each radius of the pattern, then the nearest C at the azimuth of the pattern.
    step = slice(None, None, max(size // MAX_POINTS, 1))
    order = np.argsort(x[step], kind="stable")
    k = np.arange(MAX_POINTS)
    near = np.interp(x.max() * np.sqrt((k + 0.5) / MAX_POINTS), x[step][order], c[step][order])
    pattern = near + np.mod(k * GOLDEN_ANGLE - near + np.pi, 2 * np.pi) - np.pi
    entry = c[0] + 2 * np.pi * np.arange(FIRST_REV_POINTS) / FIRST_REV_POINTS
    return np.unique(np.minimum(np.searchsorted(c, np.concatenate((entry, pattern))), size - 1))


def predicted_chips(job: Job, access: Access, cut: PassTable, feed: float, stock: float) -> str:
    """Predict the chips of a pass in words, before its path is computed; empty if that is impossible."""
    material, part = job.part.substance, job.part
    if material is None or material.critical is None or not stock > 0:
        return ""
    radius, angle = np.meshgrid(part.reach * np.linspace(0.02, 1, 40), np.linspace(0, 2 * np.pi, 72, endpoint=False))
    x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    cosine, sine = np.cos(angle).ravel(), np.sin(angle).ravel()
    on = part.covers(x, y)
    x, y, cosine, sine = x[on], y[on], cosine[on], sine[on]
    _, zx, zy, zxx, zxy, zyy = part.surface.evaluate(x, y, 2)
    bend = zxx * cosine**2 + 2 * zxy * sine * cosine + zyy * sine**2
    bend = bend / (1 + (zx * cosine + zy * sine) ** 2) ** 1.5
    depth = (stock - cut.allowance) / cut.repeats(stock)
    try:
        return predict_chips(
            job.tool_of(cut), material, feed=feed, depth=depth, bend=float(bend.min()), rakes=access.rake_range,
            allowance=cut.allowance,
        )  # fmt: skip
    except InputError as error:
        return f"chip thickness is not predicted before a run: {error}"
