"""What a job's material says of its passes: the chips along them, and whether they stay ductile."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright.cutting import chip_map, ductile_gate, predict_chips
from turnwright.errors import InputError
from turnwright.units import say_length

if TYPE_CHECKING:
    from turnwright._arrays import Ints
    from turnwright.access import Access
    from turnwright.cutting import ChipMap, DuctileGate
    from turnwright.job.schema import Job, PassTable
    from turnwright.path import Motion
    from turnwright.progress import Progress

__all__ = ["PassChips", "chips_of", "predicted_chips"]

MOST = 20_000
"""Points of a pass whose chips are found, as many on every part of the area. Eight times as many change the thickest
chip of the infrared lens and of an array of lenses by less than 0.1 %."""

FIRST = 72
"""Points of the first turn among them."""

GOLDEN = np.pi * (3 - np.sqrt(5))
"""Angle by which the seeds of a sunflower follow each other: it leaves no gaps and no rows. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PassChips:
    """The chips of a pass, as a report tells them.

    Parameters
    ----------
    thickest, typical
        The thickest chip within the clear radius, and the median of all. [mm]
    entering
        The thickest while the tool enters at the rim. [mm]
    where
        Where the chip is thickest (x, y). [mm]
    rake_range
        Lowest and highest effective rake. [rad]
    axial, cutting
        Largest forces out of the part and against the cut; ``None`` without coefficients. [N]
    critical
        Critical thickness where the margin is least; ``None`` for a material without one. [mm]
    margin, margin_uncertainty
        The least margin, and how far it may be off in 95 of 100 cases; ``None`` where that is not stated.
    share
        Part of the area beyond the critical thickness.
    fracture
        How deep cracks may reach below what the pass leaves. [mm]
    largest_feed
        Feed that would stay ductile; ``None`` where any would. [mm/rev]
    verdict, ok
        "ductile", "brittle", or "uncertain" where the margin lies inside its uncertainty; whether it is ductile or
        later passes take off what it may crack.
    sentence
        All that in words.
    """

    thickest: float
    typical: float
    entering: float
    where: tuple[float, float]
    rake_range: tuple[float, float]
    axial: float | None
    cutting: float | None
    critical: float | None = None
    margin: float | None = None
    margin_uncertainty: float | None = None
    share: float = 0.0
    fracture: float | None = None
    largest_feed: float | None = None
    verdict: Literal["ductile", "uncertain", "brittle"] = "ductile"
    ok: bool = True
    sentence: str = ""


def chips_of(
    job: Job, motion: Motion, before: Motion | None, allowance: float, tell: Progress
) -> tuple[PassChips, ChipMap] | str:
    """Return the chips of a pass, or why they are not found."""
    material, part = job.part.substance, job.part
    if before is None and not part.stock > 0:
        return "the chips of the first pass are not found, since the part states no stock: add part.stock"
    try:
        chips = chip_map(
            motion, job.tool, part, before=before, material=material, points=_spread(motion), progress=tell
        )
    except InputError as error:
        return f"the chips are not found: {error}"
    inside = chips.inside
    told = PassChips(
        thickest=chips.thickest,
        typical=float(np.median(chips.thickness[inside])) if inside.any() else 0.0,
        entering=chips.entering,
        where=chips.where,
        rake_range=(float(chips.rake.min()), float(chips.rake.max())),
        axial=None if chips.axial is None else float(chips.axial[inside].max(initial=0.0)),
        cutting=None if chips.cutting is None else float(chips.cutting[inside].max(initial=0.0)),
    )
    if material is None or material.critical is None:
        return replace(told, sentence="ductile however thick the chip, as far as the material says"), chips
    gate = ductile_gate(chips, material, job.tool, allowance=allowance)
    told = replace(
        told,
        critical=float(gate.critical[gate.worst]), margin=float(gate.margin[gate.worst]),
        margin_uncertainty=gate.uncertainty,
        share=gate.share, fracture=gate.fracture,
        largest_feed=gate.largest_feed if np.isfinite(gate.largest_feed) else None,
        verdict=gate.verdict, ok=gate.ok, sentence=gate.sentence,
    )  # fmt: skip
    return _with_first_turn(told, chips, gate, part.radius), chips


def _with_first_turn(told: PassChips, chips: ChipMap, gate: DuctileGate, radius: float) -> PassChips:
    """Add what the first turn does to the part, if it begins within the clear radius."""
    away = np.hypot(chips.x, chips.y)
    first = ~chips.inside & (away <= radius)
    cracked = float(chips.fracture[first].max(initial=0.0))
    harmless = gate.fracture is not None and (cracked == 0 or cracked < gate.allowance)
    if harmless or not (gate.margin[first] < 0).any():
        return told
    said = (
        f"{told.sentence}; but the first turn, which none before bounds, takes a chip of "
        f"{say_length(float(chips.thickness[first].max()))} within the clear radius"
    )
    if away[first].max() > radius / 2:
        said += ": give a longer lead_in, so that it stands outside"
    return replace(told, ok=False, sentence=said)


def _spread(motion: Motion) -> Ints:
    """Return points spread over the area, and some of the first turn, in the order of the motion; all if few. (n,)."""
    size = motion.time.size
    if size <= MOST:
        return np.arange(size)
    c, x = motion.axes["C"] * motion.sense, np.abs(motion.axes["X"])
    # Where along the motion each distance from the axis is reached, and the nearest turn to the azimuth wanted there.
    few = slice(None, None, max(size // MOST, 1))
    order = np.argsort(x[few], kind="stable")
    k = np.arange(MOST)
    near = np.interp(x.max() * np.sqrt((k + 0.5) / MOST), x[few][order], c[few][order])
    wanted = near + np.mod(k * GOLDEN - near + np.pi, 2 * np.pi) - np.pi
    entry = c[0] + 2 * np.pi * np.arange(FIRST) / FIRST
    return np.unique(np.minimum(np.searchsorted(c, np.concatenate((entry, wanted))), size - 1))


def predicted_chips(job: Job, access: Access, cut: PassTable, feed: float, stock: float) -> str:
    """Return what the chips of a pass will be like before any path is placed; empty if nothing can be said."""
    material, part = job.part.substance, job.part
    if material is None or material.critical is None or not stock > 0:
        return ""
    radius, angle = np.meshgrid(part.radius * np.linspace(0.02, 1, 40), np.linspace(0, 2 * np.pi, 72, endpoint=False))
    x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    cosine, sine = np.cos(angle).ravel(), np.sin(angle).ravel()
    _, zx, zy, zxx, zxy, zyy = part.surface.evaluate(x, y, 2)
    bend = zxx * cosine**2 + 2 * zxy * sine * cosine + zyy * sine**2
    bend = bend / (1 + (zx * cosine + zy * sine) ** 2) ** 1.5
    depth = (stock - cut.allowance) / cut.repeats(stock)
    try:
        return predict_chips(
            job.tool, material, feed=feed, depth=depth, bend=float(bend.min()), rakes=access.rake_range,
            allowance=cut.allowance,
        )  # fmt: skip
    except InputError as error:
        return f"what its chips will be is not predicted, a run finds them: {error}"
