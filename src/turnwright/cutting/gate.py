r"""The ductile gate: whether the material bears the chip.

Every place of a pass has its thickest chip and, by the rake that the surface leaves the tool there, its critical one;
the margin is :math:`1 - t / t_c`. Beyond it the material fractures, on the shoulder first, well above what the pass
leaves [Blackley1991]_. What counts is whether the cracks end within what later passes take off.

Where the critical thickness has a standard uncertainty u, the margin, which is how far the chip stays below it as a
share of it, is uncertain by :math:`2u / t_c` in 95 of 100 cases. A pass is ductile where no chip is above
:math:`t_c - 2u` and brittle where one is above :math:`t_c + 2u`; in between it cannot be told, and such a pass is held
to what a brittle one is. So below, t_c counts as :math:`t_c - 2u`, or as nothing where that is below zero.

A feed that holds is found from each place's own chip: on a nose of radius R its thickest place stands at

.. math:: s = \frac{R^2 + f^2 - (R - t)^2}{2 f}, \qquad f_c = s - \sqrt{s^2 - R^2 + (R - t_c)^2} .
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from turnwright._arrays import Bools, Floats
from turnwright.cutting.chip import RoundChip
from turnwright.errors import InputError
from turnwright.units import say_length

if TYPE_CHECKING:
    from turnwright.cutting.chip import ChipMap
    from turnwright.material import CriticalThickness, Material
    from turnwright.tool import Tool

__all__ = ["DuctileGate", "ductile_gate", "foretell"]

STEEPEST = np.deg2rad(-45)
"""Rake down to which one that helps is looked for. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DuctileGate:
    """Whether a pass stays ductile, and whether its cracks are taken off later.

    Parameters
    ----------
    chips
        The chips of the pass.
    critical
        Critical thickness at each of its points, by the effective rake. (n,) [mm]
    margin
        1 - thickness / critical, negative where the material fractures. (n,) [1]
    uncertainty
        How far the margin may be off in 95 of 100 cases; ``None`` where the material states no uncertainty. [1]
    share
        Part of the area, within the clear radius, that is cut beyond the critical thickness.
    doubtful
        Part of it whose margin lies inside its uncertainty.
    fracture
        How deep cracks may reach below what the pass leaves; ``None`` where the material does not say. [mm]
    allowance
        Material that later passes take off. [mm]
    feed
        Of the pass. [mm/rev]
    largest_feed
        The largest that would stay ductile everywhere; infinite where the depth alone keeps it so. [mm/rev]
    rake
        The rake nearest to the tool's that would stay ductile at this feed; ``None`` where none is known. [rad]
    """

    chips: ChipMap
    critical: Floats
    margin: Floats
    uncertainty: float | None
    share: float
    doubtful: float
    fracture: float | None
    allowance: float
    feed: float
    largest_feed: float
    rake: float | None

    @property
    def worst(self) -> int:
        """Number of the point within the clear radius whose margin is least."""
        return int(np.argmin(np.where(self.chips.inside, self.margin, np.inf)))

    @property
    def verdict(self) -> Literal["ductile", "uncertain", "brittle"]:
        """Whether the least margin lies above zero, around it or below it, by more than its uncertainty."""
        if not self.chips.inside.any():
            return "ductile"
        margin = self.margin[self.worst]
        band = self.uncertainty or 0.0
        return "ductile" if margin >= band else "brittle" if margin < -band else "uncertain"

    @property
    def ductile(self) -> bool:
        """Whether every place is below its critical thickness, beyond the doubt that the material states."""
        return self.verdict == "ductile"

    @property
    def ok(self) -> bool:
        """Whether the pass is ductile, or what it may crack is taken off later."""
        return self.ductile or self.fracture == 0.0 or (self.fracture is not None and self.fracture < self.allowance)

    @property
    def sentence(self) -> str:
        """What a report says of it."""
        at = self.worst
        x, y = (round(float(one[at]), 6) + 0.0 for one in (self.chips.x, self.chips.y))
        said = f"the chip is up to {say_length(self.chips.thickness[at])} thick at ({x:.3g}, {y:.3g}) mm"
        said += f", the limit there is {say_length(self.critical[at])}"
        margin = f"margin of {_percent(self.margin[at])}"
        if self.uncertainty is not None:
            margin += f" +- {_percent(self.uncertainty)}"
        if self.ductile:
            return f"ductile, with a {margin}: {said}"
        if self.verdict == "brittle":
            said = f"brittle: {said}, and {100 * self.share:.3g} % of the area is beyond it"
        else:
            said = (
                f"not certainly ductile: it cannot be told, the {margin} is inside its uncertainty on "
                f"{100 * self.doubtful:.3g} % of the area; {said}"
            )
        if self.fracture == 0.0:
            return f"{said}; cracks end above what it leaves"
        if self.ok and self.fracture is not None:
            later = f"within the {say_length(self.allowance)} that later passes take off"
            return f"{said}; cracks may reach {say_length(self.fracture)} deep, {later}"
        depth = "" if self.fracture is None else f"; cracks may reach {say_length(self.fracture)} deep"
        remedies = _slower(self.largest_feed)
        if self.rake is not None:
            remedies.append(f"a rake of {np.rad2deg(self.rake):.3g} deg")
        if self.fracture is not None:
            remedies.append(f"later passes that take off more than {say_length(self.fracture)}")
        use = ", or ".join(remedies) or "a material whose limit is better known"
        return f"{said}{depth}, and later passes take off {say_length(self.allowance)}: use {use}"


def _slower(feed: float) -> list[str]:
    """Return the remedy of a feed, none where the limit is so uncertain that no feed is safe."""
    return [f"feed at most {feed * 1e3:.3g} um/rev"] if feed > 0 else []


def _percent(share: float) -> str:
    """Return a share in percent, two digits of it at least."""
    return f"{100 * share:.0f} %" if abs(share) >= 0.1 else f"{100 * share:.2g} %"


def ductile_gate(chips: ChipMap, material: Material, tool: Tool, *, allowance: float = 0.0) -> DuctileGate:
    """Judge the chips of a pass.

    Parameters
    ----------
    chips
        As found with the same material; how deep it cracks was found then.
    material
        Whose critical thickness counts.
    tool
        What cuts.
    allowance
        Material that later passes take off. [mm]

    Raises
    ------
    InputError
        If the material states no critical thickness, since it is then ductile however thick the chip.

    Sources
    -------
    [Troutman2016]_ chs. 4-5, [Blackley1991]_. Oracle of the feed: the chips at that feed.
    """
    if material.critical is None:
        raise InputError(
            f"material {material.name!r} states no critical thickness, a gate needs 1: give one, or cut it as ductile"
        )
    critical = material.critical.at(rake=chips.rake, angle=chips.angle)
    margin = 1 - chips.thickness / critical
    doubt = material.critical.doubt
    inside = chips.inside
    weight = np.hypot(chips.x, chips.y) * np.abs(np.gradient(chips.angle) if chips.angle.size > 1 else np.ones(1))
    total = float(weight[inside].sum())

    def share(where: Bools) -> float:
        part = float(weight[inside & where].sum()) / total if total > 0 else 0.0
        return max(part, np.finfo(float).tiny) if (inside & where).any() else 0.0

    fracture = None
    if material.fracture_ratio is not None:
        fracture = float(chips.fracture[inside].max(initial=0.0))
    return DuctileGate(
        chips=chips, critical=critical, margin=margin, share=share(margin < 0),
        uncertainty=None if material.critical.uncertainty is None else doubt,
        doubtful=share((margin < doubt) & (margin >= -doubt)),
        fracture=fracture, allowance=float(allowance),
        feed=chips.feed, largest_feed=_largest_feed(chips, critical * material.critical.safe, tool),
        rake=_helpful_rake(chips, material.critical, tool),
    )  # fmt: skip


def _largest_feed(chips: ChipMap, critical: Floats, tool: Tool) -> float:
    """Return the largest feed at which the chip is beyond the limit nowhere. [mm/rev]."""
    cut = chips.inside & (chips.thickness > 0)
    if not cut.any():
        return float("inf")
    radius, feed = tool.actual_radius / np.cos(tool.rake), chips.feed
    t, limit = chips.thickness[cut], np.minimum(critical[cut], radius)
    side = (feed**2 + t * (2 * radius - t)) / (2 * feed)
    square = side**2 - limit * (2 * radius - limit)
    feeds = np.where(square >= 0, side - np.sqrt(np.maximum(square, 0.0)), np.inf)
    return float(feeds.min())


def _helpful_rake(chips: ChipMap, critical: CriticalThickness, tool: Tool) -> float | None:
    """Return the rake nearest to the tool's at which every chip is ductile, or ``None`` where none is known."""
    if critical.rake is None:
        return None
    low, high = max(critical.rake[0][0], STEEPEST), critical.rake[0][-1]
    inside = chips.inside
    for turned in sorted(np.deg2rad(np.arange(-45, 46)), key=abs):
        rake = tool.rake + turned
        if not low - 1e-9 <= rake <= high + 1e-9:
            continue
        limit = critical.at(rake=chips.rake[inside] + turned, angle=chips.angle[inside]) * critical.safe
        if (chips.thickness[inside] <= limit).all():
            return float(rake)
    return None


def foretell(
    tool: Tool,
    material: Material,
    *,
    feed: float,
    depth: float,
    bend: float,
    rakes: tuple[float, float],
    allowance: float,
) -> str:
    """Return what to expect of a pass before its path is known, with the feed and the rake that would hold.

    Parameters
    ----------
    tool, material
        What cuts, and what is cut.
    feed, depth
        Of the pass. [mm/rev], [mm]
    bend
        Least curvature of the surface along the radius, negative where it is convex: there the chip is thickest. [1/mm]
    rakes
        Lowest and highest effective rake. [rad]
    allowance
        Material that later passes take off. [mm]

    Raises
    ------
    InputError
        If the material states no critical thickness, or turns do not meet below the stock.
    """
    if material.critical is None:
        raise InputError(f"material {material.name!r} states no critical thickness, a gate needs 1: give one")
    flat = tool.actual_radius / np.cos(tool.rake)
    relative = 1 / flat - bend
    # Where the surface is as hollow as the nose, the chip is as thick as the cut is deep and no wider curve matters.
    radius = 1 / max(relative, 1 / (1e3 * flat))
    chip = RoundChip(nose_radius=radius, feed=feed, depth=depth)
    around = np.linspace(0, 2 * np.pi, 73)[:-1]

    def limit(turned: float) -> float:
        places = np.linspace(rakes[0], rakes[1], 33) + turned
        return float(material.critical.at(rake=places[:, None], angle=around).min()) if material.critical else 0.0

    bears, doubt = limit(0.0), material.critical.doubt
    safe = bears * material.critical.safe
    said = f"the chip will be about {say_length(chip.thickest)} thick, the limit is {say_length(bears)}"
    if doubt:
        said += f" +- {say_length(doubt * bears)}"
    side = np.sqrt(depth * (2 * radius - depth))
    square = side**2 - safe * (2 * radius - safe)
    largest = side - np.sqrt(square) if square > 0 else float("inf")
    held = f"ductile up to a feed of {largest * 1e3:.3g} um/rev" if np.isfinite(largest) else "ductile at any feed"
    if chip.thickest <= safe:
        return f"{said}: {held}"
    remedies = _slower(largest)
    if material.critical.rake is not None:
        low, high = max(material.critical.rake[0][0], STEEPEST), material.critical.rake[0][-1]
        turns = sorted(np.deg2rad(np.arange(-45, 46)), key=abs)
        helps = [
            one
            for one in turns
            if low <= tool.rake + one <= high and limit(one) * material.critical.safe >= chip.thickest
        ]
        remedies += [f"a rake of {np.rad2deg(tool.rake + one):.3g} deg" for one in helps[:1]]
    else:
        remedies.append("a more negative rake, whose help this material does not state")
    left = _left(chip, safe, material.fracture_ratio, allowance)
    certain = chip.thickest > bears * (1 + doubt)
    verdict = "brittle" if certain else "not certainly ductile, the margin is inside its uncertainty"
    return f"{verdict}: {said}; {left}; to stay ductile use {', or '.join(remedies)}"


def _left(chip: RoundChip, safe: float, ratio: float | None, allowance: float) -> str:
    """Return what becomes of cracks, which begin at the lowest place of the edge that is beyond the limit."""
    later = f"later passes take off {say_length(allowance)}"
    if ratio is None:
        return f"{later}, to take off cracks they need enough"
    sweep = np.linspace(0.0, chip.sweep[1], 4001)
    begins = float(sweep[np.argmax(chip.thickness(sweep) > safe)])
    deep = ratio * chip.thickest - chip.nose_radius * (1 - np.cos(begins))
    if deep <= 0:
        return "cracks end above what it leaves"
    needed = "" if deep < allowance else ", which is not enough"
    return f"cracks may reach {say_length(deep)} deep, {later}{needed}"
